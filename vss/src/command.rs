//! The commands of the Vision Services System: what the user asks of the Services Manager, and what Services, Tools,
//! the Vision Module Manager and Vision Modules ask of each other.

use std::time::Duration;

use ctos::{
    call::{CallError, Fault},
    task::NameError,
};
pub use scene::Drawing;
use serde::{Deserialize, Serialize};

use crate::{
    calibrate::{Calibration, LightPoint},
    camera::Camera,
    frame::{Carried, Frame},
    laser::LaserOrder,
    pose::TargetPose,
    spot::{NoSpot, Spot, SpotFlags},
    visual_jacobian::{Correction, Seen},
};

ctos::command! {
    /// Takes a picture and finds the bright spot in it.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SpotFind {
        /// The camera's name.
        pub camera: String,
    } => Result<SpotReport, VisionError>, 0x0401, "spot_find"

    /// Computes a camera from light positions and their spots.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Calibrate {
        /// The camera's name, for messages.
        pub camera: String,
        /// Picture width, px.
        pub width: usize,
        /// Picture height, px.
        pub height: usize,
        /// The table of lights.
        pub points: Vec<LightPoint>,
        /// Seeds the random samples of the start; same table and seed, same result.
        pub seed: u64,
    } => Calibration, 0x0402, "calibrate"

    /// Takes a picture with each of two cameras at once and finds the bright spot in both.
    #[derive(Debug, Clone, PartialEq)]
    pub struct FindPair {
        /// The cameras' names.
        pub cameras: [String; 2],
    } => Result<[SpotReport; 2], VisionError>, 0x0460, "find_pair"

    /// Takes a picture and finds in it where the target of known lights stands.
    #[derive(Debug, Clone, PartialEq)]
    pub struct FindTarget {
        /// The camera's name.
        pub camera: String,
    } => Result<TargetReport, VisionError>, 0x0461, "find_target"

    /// Tool: computes where the target of known lights stands in a picture.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LocateTarget {
        /// The picture.
        pub frame: Frame,
    } => Result<TargetPose, VisionError>, 0x0462, "locate_target"

    /// Takes a picture with the camera on a hand, and finds the disc before it: as an example when the gripper is known to be at
    /// an offset from where it grips the disc, else to correct the gripper.
    #[derive(Debug, Clone, PartialEq)]
    pub struct DiskOffset {
        /// The camera's name.
        pub camera: String,
        /// The known offset of the gripper, m; none to be told the correction.
        pub taught: Option<[f64; 2]>,
    } => Result<DiskReport, VisionError>, 0x0480, "disk_offset"

    /// Tool: finds the disc before the camera on a hand in a picture.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LocateDisk {
        /// The picture.
        pub frame: Frame,
        /// The known offset of the gripper, m; none to be told the correction.
        pub taught: Option<[f64; 2]>,
    } => Result<DiskSight, VisionError>, 0x0481, "locate_disk"

    /// Has a laser scanner make a spot, draw a line, or be off. The task that drives the scanner answers.
    #[derive(Debug, Clone, PartialEq)]
    pub struct OrderLaser {
        /// The scanner's name.
        pub laser: String,
        /// What it does.
        pub order: LaserOrder,
    } => (), 0x0490, "order_laser"

    /// Vision Module: has its laser scanner do something, under a grant of the manager. A grant that is older than the last one
    /// under which it was steered is refused.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SteerLaser {
        /// What `acquire_vm` answered.
        pub grant: u64,
        /// What it does.
        pub order: LaserOrder,
    } => (), 0x0491, "steer_laser"

    /// Asks the manager for the hardware behind a Vision Module; answered when it is free.
    #[derive(Debug, Clone, PartialEq)]
    pub struct AcquireVm {
        /// The Vision Module's task.
        pub vm: String,
    } => u64, 0x0410, "acquire_vm"

    /// Gives the hardware back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReleaseVm {
        /// What `acquire_vm` answered.
        pub grant: u64,
    } => (), 0x0411, "release_vm"

    /// Tool: takes a picture.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Snap {
        /// The camera's name.
        pub camera: String,
    } => Result<Frame, VisionError>, 0x0420, "snap"

    /// Tool: shows a picture on the monitor.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ShowImage {
        /// The camera's name.
        pub camera: String,
        /// Its picture.
        pub frame: Frame,
        /// What is drawn over it.
        pub drawing: Drawing,
    } => (), 0x0421, "show_image"

    /// Tool: computes where the spot of a picture is.
    #[derive(Debug, Clone, PartialEq)]
    pub struct LocateSpot {
        /// The picture.
        pub frame: Frame,
    } => Result<Spot, VisionError>, 0x0422, "locate_spot"

    /// Tool: marks a spot on top of the picture on the monitor.
    #[derive(Debug, Clone, PartialEq)]
    pub struct MarkSpot {
        /// The camera's name.
        pub camera: String,
        /// Where.
        pub mark: Mark,
    } => (), 0x0423, "mark_spot"

    /// Vision Module: makes its hardware ready. Sent once by the Services Manager.
    #[derive(Debug, Clone, PartialEq)]
    pub struct InitializeVm {} => (), 0x0430, "initialize_vm"

    /// Vision Module: takes a picture now.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SnapNow {} => Frame, 0x0431, "snap_now"

    /// Vision Module: puts a picture on the monitor.
    #[derive(Debug, Clone, PartialEq)]
    pub struct DisplayImage {
        /// The camera's name.
        pub camera: String,
        /// Its picture.
        pub frame: Frame,
        /// What is drawn over it.
        pub drawing: Drawing,
    } => (), 0x0432, "display_image"

    /// Vision Module: puts a marker on the picture that the monitor shows.
    #[derive(Debug, Clone, PartialEq)]
    pub struct DisplayMark {
        /// The camera's name.
        pub camera: String,
        /// Where.
        pub mark: Mark,
    } => (), 0x0433, "display_mark"

    /// The world's own knowledge of its cameras. Only a stand-in for the world can answer, and only a judge of
    /// results may ask; an estimator that asks is cheating.
    #[derive(Debug, Clone, PartialEq)]
    pub struct TrueCameras {} => Vec<NamedCamera>, 0x0440, "true_cameras"

    /// What the monitor shows of a camera.
    #[derive(Debug, Clone, PartialEq)]
    pub struct WhatIsShown {
        /// The camera's name.
        pub camera: String,
    } => Option<Shown>, 0x0434, "what_is_shown"
}

/// What kept the vision system from measuring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Outcome {
    /// The picture does not show it. Another picture may.
    Unseen,
    /// A camera or a computation failed.
    Fault,
    /// A task of the vision system is gone or does not answer.
    Lost,
    /// The request does not fit: there is no such camera, for example.
    Refused,
}

/// Why the vision system did not measure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{reason}")]
pub struct VisionError {
    /// Which kind of thing.
    pub outcome: Outcome,
    /// In words.
    pub reason: String,
}

impl VisionError {
    /// An error of a kind, in words.
    #[must_use]
    pub fn new(outcome: Outcome, reason: impl ToString) -> Self {
        Self {
            outcome,
            reason: reason.to_string(),
        }
    }
}

/// A part that says no has failed; one that says nothing is lost.
impl From<CallError> for VisionError {
    fn from(error: CallError) -> Self {
        let outcome = match &error.fault {
            Fault::Refused { .. } => Outcome::Fault,
            Fault::BadPayload { .. } | Fault::UnknownCommand { .. } => Outcome::Refused,
            _ => Outcome::Lost,
        };
        Self::new(outcome, error.reason())
    }
}

impl From<NameError> for VisionError {
    fn from(error: NameError) -> Self {
        Self::new(Outcome::Lost, error)
    }
}

impl From<NoSpot> for VisionError {
    fn from(reason: NoSpot) -> Self {
        let outcome = match reason {
            NoSpot::Empty { .. } | NoSpot::WrongSize { .. } => Outcome::Fault,
            _ => Outcome::Unseen,
        };
        Self::new(outcome, reason)
    }
}

/// The spot that the Service SpotFind found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpotReport {
    /// The camera's name.
    pub camera: String,
    /// Column of the centre, px; pixel centres are at whole numbers.
    pub u: f64,
    /// Row of the centre, px.
    pub v: f64,
    /// Predicted standard deviation of `u`, px.
    pub sd_u: f64,
    /// Predicted standard deviation of `v`, px.
    pub sd_v: f64,
    /// Height above the background, grey values.
    pub amplitude: f64,
    /// Width of the fitted Gaussian (its σ), px.
    pub sigma: f64,
    /// Pixels above the threshold.
    pub area: u64,
    /// What is doubtful about it.
    pub flags: SpotFlags,
    /// The middle of the picture's exposure, since the start of the app.
    pub stamp: Duration,
    /// The number of the picture.
    pub frame: u64,
    /// Picture width, px.
    pub width: usize,
    /// Picture height, px.
    pub height: usize,
}

/// The target that the Service TargetFind found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TargetReport {
    /// The camera's name.
    pub camera: String,
    /// Where the target is.
    pub pose: TargetPose,
    /// The middle of the picture's exposure, since the start of the app.
    pub stamp: Duration,
    /// The number of the picture.
    pub frame: u64,
    /// What carried the camera then.
    pub carrier: Option<Carried>,
}

/// The disc before the camera on a hand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DiskSight {
    /// Where it is in the picture.
    pub seen: Seen,
    /// Standard deviations of its middle, px.
    pub sd_px: [f64; 2],
    /// How many examples are taught so far, of four.
    pub examples: usize,
    /// The move of the gripper to where it grips the disc; none for an example.
    pub correction: Option<Correction>,
}

/// What the Service DiskFind found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DiskReport {
    /// The camera's name.
    pub camera: String,
    /// The disc.
    pub disk: DiskSight,
    /// The middle of the picture's exposure, since the start of the app.
    pub stamp: Duration,
    /// The number of the picture.
    pub frame: u64,
}

/// A marker on a picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// Column, px.
    pub u: f64,
    /// Row, px.
    pub v: f64,
    /// Predicted standard deviations of both, px.
    pub sd: [f64; 2],
}

/// What a monitor shows of one camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// The last picture.
    pub frame: Frame,
    /// The markers on top of it.
    pub marks: Vec<Mark>,
    /// What is drawn over it.
    pub drawing: Drawing,
}

/// A camera as it truly is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NamedCamera {
    /// Its name.
    pub name: String,
    /// Its geometry.
    pub camera: Camera,
}
