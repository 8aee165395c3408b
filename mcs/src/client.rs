//! The client interface: what anybody who uses the manipulator asks of it, and what comes back.
//!
//! These types travel as messages; the tasks that answer them are in [`crate::tasks`].

use serde::{Deserialize, Serialize};

use crate::arm::{Elbow, Joints};
use crate::servo::MotionPhase;
use crate::state::State;
pub use crate::trajectory::PathKind;

/// Where to move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// Joint positions, rad.
    Joints(Joints),
    /// `base_t_tool`: a homogeneous 4 by 4 matrix, row by row, lengths in m.
    Pose([f64; 16]),
}

/// How a motion ended.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MoveReport {
    /// From the first setpoint until the arm had settled, s.
    pub duration_s: f64,
    /// Largest distance of any joint from its setpoint on the way, rad.
    pub max_tracking_error_rad: f64,
    /// Largest distance of any joint from its target, settled, rad.
    pub final_error_rad: f64,
    /// Joint positions as read back at the end, rad.
    pub joints: Joints,
}

/// A motion that would be accepted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlanReport {
    /// Joint positions at the end, rad.
    pub joints: Joints,
    /// Duration of the motion without settling, s.
    pub duration_s: f64,
}

/// Where the manipulator is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Position {
    /// Joint positions as read back, rad.
    pub joints: Joints,
    /// `base_t_tool` by forward kinematics of these joints: 4 by 4, row by row, lengths in m.
    pub base_t_tool: [f64; 16],
    /// Whether nothing moves and nothing is going to.
    pub at_rest: bool,
}

/// How the manipulator is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StatusReport {
    /// State of the state manager.
    pub state: State,
    /// Task that holds the manipulator.
    pub holder: Option<String>,
    /// Why power was taken away, if it was.
    pub fault: Option<String>,
    /// The latest motion's phase.
    pub motion: MotionPhase,
    /// Servo ticks since start.
    pub ticks: u64,
    /// Servo periods skipped since start.
    pub missed: u64,
}

/// The control parameters of the manipulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ControlReport {
    /// The control law.
    pub law: String,
    /// Natural frequency of the position loop, Hz.
    pub bandwidth_hz: f64,
    /// Damping ratio of the position loop.
    pub damping: f64,
    /// A joint this far from its setpoint is an emergency, rad.
    pub following_error_rad: f64,
}

impl ControlReport {
    /// Bandwidth (Hz), damping ratio, and the following error that is an emergency (rad).
    #[must_use]
    pub fn numbers(&self) -> [f64; 3] {
        [self.bandwidth_hz, self.damping, self.following_error_rad]
    }
}

ctos::command! {
    /// Reserves the manipulator for the calling task and switches its power on.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Acquire => State, 0x0301, "acquire"
}
ctos::command! {
    /// Moves, and answers when the arm has settled at the target.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Move {
        /// Where to.
        pub target: Target,
        /// Which way.
        pub path: PathKind,
        /// Fraction of full speed, above 0 up to 1.
        pub speed: f64,
        /// Fraction of full acceleration, above 0 up to 1; as the speed when it is left out.
        pub acceleration: Option<f64>,
        /// Elbow posture at a pose, or the one nearest to the present joints.
        pub elbow: Option<Elbow>,
    } => MoveReport, 0x0302, "move"
}
ctos::command! {
    /// Checks a motion from the present position without moving.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Plan {
        /// Where to.
        pub target: Target,
        /// Which way.
        pub path: PathKind,
        /// Fraction of full speed, above 0 up to 1.
        pub speed: f64,
        /// Fraction of full acceleration, above 0 up to 1; as the speed when it is left out.
        pub acceleration: Option<f64>,
        /// Elbow posture at a pose, or the one nearest to the present joints.
        pub elbow: Option<Elbow>,
    } => PlanReport, 0x0303, "plan"
}
ctos::command! {
    /// Reads the joints back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadPosition => Position, 0x0304, "read_position"
}
ctos::command! {
    /// Protective stop: brakes along the path to rest, then holds. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Stop => (), 0x0305, "stop_motion"
}
ctos::command! {
    /// Comes to rest, switches power off and gives the manipulator back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Release => State, 0x0306, "release"
}
ctos::command! {
    /// Tells how the manipulator is.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Status => StatusReport, 0x0307, "status"
}
ctos::command! {
    /// Takes drive power away now. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct EmergencyStop => (), 0x0308, "emergency_stop"
}
ctos::command! {
    /// Leaves the estopped state; the manipulator must then be acquired anew.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Reset => State, 0x0309, "reset"
}
ctos::command! {
    /// Tells the control parameters.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadControl => ControlReport, 0x030a, "read_control"
}
ctos::command! {
    /// Sets the control parameters, until the servo's task is built anew. Refused while the arm is on its way.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetControl {
        /// Natural frequency of the position loop, Hz.
        pub bandwidth_hz: f64,
        /// Damping ratio of the position loop.
        pub damping: f64,
    } => ControlReport, 0x030b, "set_control"
}
