//! The data objects that the nets of `carry` exchange through the DOM, by name and type.

use ctos::{task::Context, time::Instant};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    board::{Board, Field},
    thing::Thing,
};
use crate::{dom::DomStore, outcome::Failure};

/// What is to be carried from where to where: written by the Dispatcher.
pub const ERRAND: &str = "errand";
/// With which turn the arm does it: written by the Robot Coordinator.
pub const WAY: &str = "way";
/// Which ways it has gone: written by the Robot Coordinator.
pub const WAYS: &str = "ways";
/// What the Robot Coordinator could not do: [`Problems`].
pub const ROBOT_PROBLEMS: &str = "robot_problems";
/// What the Hand Coordinator could not do: [`Problems`].
pub const HAND_PROBLEMS: &str = "hand_problems";
/// What the Vision Coordinator could not do: [`Problems`].
pub const VISION_PROBLEMS: &str = "vision_problems";
/// What the Laser Coordinator could not do: [`Problems`].
pub const LASER_PROBLEMS: &str = "laser_problems";
/// What the People Coordinator could not do: [`Problems`].
pub const PEOPLE_PROBLEMS: &str = "people_problems";

/// [`ERRAND`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Errand {
    /// Number of the command since the Dispatcher started, from 1.
    pub command: u32,
    /// Where the thing is.
    pub from: Field,
    /// Where it shall be.
    pub to: Field,
    /// The board: where the configuration has it, and where it was seen once that is known.
    pub board: Board,
    /// The middle of its bottom at both, in the base frame of the arm, m.
    pub points: [Point3<f64>; 2],
    /// How the board is turned about the vertical, rad.
    pub yaw: f64,
    /// How far above the fields the gripper goes to and fro, m.
    pub clearance_m: f64,
    /// How far the fingers open round the thing, between what lies beside it at both ends, m.
    pub open_m: f64,
    /// Fraction of full speed to and fro; as the Robot Coordinator has it when it is left out.
    pub speed: Option<f64>,
    /// What is carried.
    pub thing: Thing,
}

/// Which end of the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Where the thing is taken.
    From,
    /// Where it is set down.
    To,
}

impl Errand {
    /// `base_t_tool` with the pads around the thing at an end, the gripper straight down and turned by so much about the vertical
    /// of the board (rad).
    #[must_use]
    pub fn pose(&self, end: End, turn: f64) -> Isometry3<f64> {
        let [from, to] = &self.points;
        let bottom = match end {
            End::From => from,
            End::To => to,
        };
        let at = bottom + Vector3::z() * self.thing.grasp.above_m;
        let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw + turn);
        Isometry3::from_parts(Translation3::from(at), turned * down)
    }

    /// The same, so far above that the gripper goes to and fro.
    #[must_use]
    pub fn above(&self, end: End, turn: f64) -> Isometry3<f64> {
        Translation3::new(0.0, 0.0, self.clearance_m) * self.pose(end, turn)
    }
}

/// [`WAY`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Way {
    /// The errand's command.
    pub command: u32,
    /// The gripper about the vertical of the board, rad.
    pub turn: f64,
    /// How far the thing is beside where it was seen before, along the tool's x and y axes, m, as the camera on the hand sees it.
    pub shift: Option<[f64; 2]>,
}

/// [`WAYS`].
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ways {
    /// The errand's command.
    pub command: u32,
    /// Which ways were tried, how they ended, and what is believed of all by now, line by line.
    pub lines: Vec<String>,
}

/// Something that a Coordinator could not do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Problem {
    /// When.
    pub at: Instant,
    /// What it was asked for.
    pub request: String,
    /// Why not.
    pub failure: Failure,
}

/// What a Coordinator could not do in a command, in the order of time. Each Coordinator writes its own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Problems {
    /// The errand's command.
    pub command: u32,
    /// All of them.
    pub problems: Vec<Problem>,
}

/// Adds a failure to the problems of the errand. One that cannot be told is logged.
pub(super) async fn note_problem(
    cx: &Context,
    store: &DomStore,
    object: &str,
    request: &str,
    failure: &Failure,
) {
    let noted = async {
        let errand: Errand = store.fetch(cx, ERRAND).await?;
        let before = store.fetch::<Problems>(cx, object).await.ok();
        let before = before.filter(|before| before.command == errand.command);
        let mut all = before.unwrap_or_else(|| Problems {
            command: errand.command,
            problems: Vec::new(),
        });
        all.problems.push(Problem {
            at: cx.now(),
            request: request.to_owned(),
            failure: failure.clone(),
        });
        store.store(cx, object, &all).await
    };
    if let Err(untold) = noted.await {
        tracing::warn!(%failure, %untold, "why a request failed could not be passed up");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::carry::tests::errand;

    #[test]
    fn the_gripper_points_down_with_its_pads_around_the_thing() {
        let errand = errand();
        for turn in [0.0, 0.5, -2.0] {
            let pose = errand.pose(End::To, turn);
            let approach = pose * Vector3::z();
            assert!((approach + Vector3::z()).norm() < 1e-12);
            let bottom = pose * Point3::new(0.0, 0.0, errand.thing.grasp.above_m);
            assert!((bottom - errand.points[1]).norm() < 1e-12);
            let above = errand.above(End::To, turn);
            let up = above.translation.vector - pose.translation.vector;
            assert!((up - Vector3::z() * errand.clearance_m).norm() < 1e-12);
        }
    }
}
