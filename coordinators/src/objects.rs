//! The data objects that the coordinators exchange through the DOM, by name and type.

use mcs::{
    Joints,
    client::{PathKind, Target},
};
use serde::{Deserialize, Serialize};
use vss::{
    calibrate::{Calibration, LightPoint},
    command::SpotReport,
};

use crate::outcome::Failure;

/// Where the lamp shall go next: written by the Dispatcher, read by the Motion Coordinator.
pub const DESTINATION: &str = "destination";
/// A path prepared beforehand for one destination: written by whoever prepared it, validated by the
/// Motion Coordinator instead of planning.
pub const GIVEN_PATH: &str = "given_path";
/// How the manipulator gets there: written by path planning, read by `move_manip`.
pub const PATH: &str = "path";
/// What the cameras saw at this position: written by the Vision Coordinator.
pub const SPOTS: &str = "spots";
/// Where the manipulator really is: written by the Motion Coordinator.
pub const POSITION: &str = "position";
/// Why the Motion Coordinator could not do its latest failed request.
pub const PROBLEM: &str = "problem";
/// How all motions of a command went: kept by the Motion Coordinator.
pub const MOTIONS: &str = "motions";
/// The table of all points of a calibration: kept by the Dispatcher.
pub const OBSERVATIONS: &str = "observations";
/// The result: one calibration per camera.
pub const CALIBRATIONS: &str = "calibrations";

/// What belongs to the same position of the same command has the same stamp, so that nothing left over
/// from an earlier one is taken for new.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Number of the command since the Dispatcher started, from 1.
    pub command: u32,
    /// Number of the position in its file, from 0.
    pub index: usize,
}

/// [`DESTINATION`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Destination {
    /// Which position of which command it is.
    pub stamp: Stamp,
    /// `base_t_tool`, row by row, m.
    pub base_t_tool: [f64; 16],
}

/// [`GIVEN_PATH`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GivenPath {
    /// The destination that it leads to, `base_t_tool`, row by row, m.
    pub base_t_tool: [f64; 16],
    /// Its end.
    pub target: Target,
    /// Which way.
    pub kind: PathKind,
    /// Fraction of full speed.
    pub speed: f64,
}

/// [`PATH`]: a motion that the client interface has accepted for planning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PathSpec {
    /// Joint positions at the end, rad or m.
    pub target: Target,
    /// Which way.
    pub kind: PathKind,
    /// Fraction of full speed.
    pub speed: f64,
    /// Expected duration, s.
    pub duration_s: f64,
}

/// [`SPOTS`]: one entry per camera of the app, in the order of its configuration.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Spots {
    /// The destination's stamp.
    pub stamp: Stamp,
    /// Camera and what it saw.
    pub seen: Vec<(String, Option<SpotReport>)>,
    /// Camera and why it saw nothing.
    pub reasons: Vec<(String, String)>,
    /// Set when the vision system itself failed, which no other position will mend.
    pub failure: Option<Failure>,
}

/// [`POSITION`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ReachedPosition {
    /// The destination's stamp.
    pub stamp: Stamp,
    /// Joint positions as read back, rad or m.
    pub joints: Joints,
    /// Origin of the tool frame (the lamp) in the base frame, m.
    pub lamp: [f64; 3],
}

/// [`PROBLEM`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// The destination's stamp.
    pub stamp: Stamp,
    /// The transition that failed.
    pub transition: String,
    /// Why.
    pub failure: Failure,
}

/// [`MOTIONS`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionLog {
    /// Motions completed.
    pub moves: u32,
    /// Largest distance of a joint that turns from its setpoint, rad.
    pub max_tracking_error_rad: f64,
    /// Largest distance of a joint that turns from its target after settling, rad.
    pub max_final_error_rad: f64,
}

/// One camera's share of [`OBSERVATIONS`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraTable {
    /// The camera's name.
    pub camera: String,
    /// Picture width, px; 0 until it has seen a spot.
    pub width: usize,
    /// Picture height, px.
    pub height: usize,
    /// Lamp positions and their spots.
    pub points: Vec<LightPoint>,
    /// Positions at which the lamp stood and it saw nothing that could be used.
    pub missed: u32,
    /// Why it saw nothing at the latest of them.
    pub last_miss: String,
}

/// A position that no camera's table has a point of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnusedPosition {
    /// Its line in the file of positions, from 1.
    pub line: usize,
    /// Why.
    pub reason: String,
}

/// [`OBSERVATIONS`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Observations {
    /// Positions in the file.
    pub wanted: u32,
    /// Positions at which each camera must have seen the lamp.
    pub enough: u32,
    /// Positions at which the arm stood and was read back.
    pub reached: u32,
    /// Positions that were out of the arm's reach.
    pub out_of_reach: u32,
    /// Why the latest of them was.
    pub last_out_of_reach: String,
    /// One table per camera. In each, points and misses together are the reached positions.
    pub cameras: Vec<CameraTable>,
    /// Positions at which nothing could be used: out of the arm's reach, or seen by no camera.
    pub unused: Vec<UnusedPosition>,
}

/// [`CALIBRATIONS`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibrations {
    /// Camera and its calibration.
    pub cameras: Vec<(String, Calibration)>,
}
