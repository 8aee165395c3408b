//! The client interface: what anybody who uses the manipulator asks of it, and what comes back.
//!
//! These types travel as messages; the tasks that answer them are private to the crate.

use std::time::Duration;

use ctos::call::{CallError, Fault};
use ctos::task::{Context, HandlerError, NameError, TaskRef};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

pub use crate::driver::{Sensor, SensorKind};
use crate::guard::{GuardReport, Reaction};
use crate::joints::Joints;
use crate::model::JointKind;
use crate::model::inverse::Elbow;
use crate::servo::MotionPhase;
pub use crate::servo::StreamKind;
use crate::state::State;
pub use crate::trajectory::{Blend, PathKind};
use crate::trajectory::{Goal, Pace, Route};

/// How far the rotation of a target pose may be from a rotation, per entry.
const ROTATION_ROUNDING: f64 = 1e-6;

/// Where to move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// Joint positions, rad or m.
    Joints(Joints),
    /// `base_t_tool`: a homogeneous 4 by 4 matrix, row by row, lengths in m.
    Pose([f64; 16]),
}

/// What kept the manipulator from doing what was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Outcome {
    /// The target, or the way to it, is out of reach. The arm has not moved; another target may do.
    Unreachable,
    /// A protective stop, which holds until somebody resumes, or the end of the app.
    Stopped,
    /// An emergency stop, or a controlled one: drive power is off until a reset and a new reservation.
    Estopped,
    /// A guard ended the motion.
    Guard,
    /// Hardware, control or a calculation failed.
    Fault,
    /// A task on the way to the manipulator is gone or does not answer. Whether the arm moves is unknown.
    Lost,
    /// The request does not fit: another task holds the manipulator, or a number makes no sense.
    Refused,
}

/// Why the manipulator did not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{reason}")]
pub struct MotionError {
    /// Which kind of thing.
    pub outcome: Outcome,
    /// In words.
    pub reason: String,
}

impl MotionError {
    /// An error of a kind, in words.
    #[must_use]
    pub fn new(outcome: Outcome, reason: impl ToString) -> Self {
        Self {
            outcome,
            reason: reason.to_string(),
        }
    }
}

impl From<CallError> for MotionError {
    fn from(error: CallError) -> Self {
        let outcome = match &error.fault {
            Fault::Refused { .. } | Fault::BadPayload { .. } | Fault::UnknownCommand { .. } => {
                Outcome::Refused
            }
            _ => Outcome::Lost,
        };
        Self::new(outcome, error.reason())
    }
}

impl From<NameError> for MotionError {
    fn from(error: NameError) -> Self {
        Self::new(Outcome::Lost, error)
    }
}

/// A manipulator as a task sees it: its client interface, with one type of error for what the
/// interface refuses and for what becomes of a call.
#[derive(Debug, Clone)]
pub struct Manipulator {
    cx: Context,
    client: TaskRef,
}

impl Manipulator {
    /// The manipulator behind the task `client`, for the task of `cx`.
    ///
    /// # Errors
    /// [`Outcome::Lost`] when no such task is found.
    pub async fn find(cx: &Context, client: &str) -> Result<Self, MotionError> {
        Ok(Self {
            cx: cx.clone(),
            client: cx.task(client).await?,
        })
    }

    /// Reserves the manipulator and switches its power on; holding it already, sees that it still does.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn acquire(&self) -> Result<State, MotionError> {
        self.cx
            .call(&self.client, Acquire {})
            .deadline(CHANGE)
            .await?
    }

    /// Comes to rest, switches power off and gives the manipulator back. Not holding it, changes nothing.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn release(&self) -> Result<State, MotionError> {
        self.cx
            .call(&self.client, Release {})
            .deadline(CHANGE)
            .await?
    }

    /// Checks a motion from the present position without moving.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn plan(&self, plan: Plan) -> Result<PlanReport, MotionError> {
        self.cx.call(&self.client, plan).await?
    }

    /// Moves, and returns when the arm has settled at the target, `within` this time.
    ///
    /// # Errors
    /// What is in the way. After [`Outcome::Lost`] nobody knows whether the arm still moves.
    pub async fn go(&self, to: Move, within: Duration) -> Result<MoveReport, MotionError> {
        self.cx.call(&self.client, to).deadline(within).await?
    }

    /// Moves the tool along the arc of a circle through a point (base frame, m): [`Self::go`] with
    /// [`PathKind::Arc`].
    ///
    /// # Errors
    /// As [`Self::go`].
    pub async fn arc(
        &self,
        through: [f64; 3],
        to: Move,
        within: Duration,
    ) -> Result<MoveReport, MotionError> {
        let path = PathKind::Arc { through };
        self.go(Move { path, ..to }, within).await
    }

    /// Moves the tool along the arc of a circle about a centre (base frame, m), the shorter way round or the longer one:
    /// [`Self::go`] with [`PathKind::ArcAbout`].
    ///
    /// # Errors
    /// As [`Self::go`].
    pub async fn arc_about(
        &self,
        (centre, longer): ([f64; 3], bool),
        to: Move,
        within: Duration,
    ) -> Result<MoveReport, MotionError> {
        let path = PathKind::ArcAbout { centre, longer };
        self.go(Move { path, ..to }, within).await
    }

    /// Moves the tool up, across and down, so far (m) above the higher end and with corners as wide as there is room:
    /// [`Self::go`] with [`PathKind::Arch`].
    ///
    /// # Errors
    /// As [`Self::go`].
    pub async fn arch(
        &self,
        height: f64,
        to: Move,
        within: Duration,
    ) -> Result<MoveReport, MotionError> {
        let path = PathKind::Arch {
            height,
            corner: None,
        };
        self.go(Move { path, ..to }, within).await
    }

    /// Ends the motion under way, as [`Cancel`] does.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn cancel(&self) -> Result<(), MotionError> {
        Ok(self.cx.call(&self.client, Cancel {}).await?)
    }

    /// Where the manipulator is.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn position(&self) -> Result<Position, MotionError> {
        Ok(self.cx.call(&self.client, ReadPosition {}).await?)
    }

    /// Goes over to another control law, as [`SetLaw`] does.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn law(&self, law: &str) -> Result<ControlReport, MotionError> {
        let law = law.to_owned();
        Ok(self.cx.call(&self.client, SetLaw { law }).await?)
    }

    /// The recipes of its guards, and what a guard found last.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn guards(&self) -> Result<GuardsReport, MotionError> {
        Ok(self.cx.call(&self.client, ReadGuards {}).await?)
    }

    /// How the manipulator is.
    ///
    /// # Errors
    /// What is in the way.
    pub async fn status(&self) -> Result<StatusReport, MotionError> {
        Ok(self.cx.call(&self.client, Status {}).await?)
    }
}

/// How long coming to rest and a change of the power state may take.
const CHANGE: Duration = Duration::from_secs(40);

/// How a motion ended.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MoveReport {
    /// From the first setpoint until the arm had settled, s.
    pub duration_s: f64,
    /// Largest distance of a joint that turns from its setpoint on the way, rad.
    pub max_tracking_error_rad: f64,
    /// The same of joints that slide, m.
    pub max_tracking_error_m: f64,
    /// Largest distance of a joint that turns from its target, settled, rad.
    pub final_error_rad: f64,
    /// The same of joints that slide, m.
    pub final_error_m: f64,
    /// Joint positions as read back at the end, rad or m.
    pub joints: Joints,
    /// The smallest singular value of the tool's Jacobian along a path of the tool, m and rad together, per rad or m.
    pub smallest_singular_value: Option<f64>,
}

/// A motion that would be accepted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlanReport {
    /// Joint positions at the end, rad or m.
    pub joints: Joints,
    /// Duration of the motion without settling, s.
    pub duration_s: f64,
    /// The smallest singular value of the tool's Jacobian along a path of the tool, m and rad together, per rad or m.
    pub smallest_singular_value: Option<f64>,
}

/// Where the manipulator is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Position {
    /// Joint positions as read back, rad or m.
    pub joints: Joints,
    /// `base_t_tool` by forward kinematics of these joints: 4 by 4, row by row, lengths in m.
    pub base_t_tool: [f64; 16],
    /// Joint positions as commanded, rad or m. Those read back, unless the arm is held or moved: a motion begins here.
    pub commanded: Joints,
    /// `base_t_tool` of the joints as commanded.
    pub base_t_commanded: [f64; 16],
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
    /// A protective stop holds until somebody resumes.
    pub stopped: bool,
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
    /// A joint that turns and is this far from its setpoint is an emergency, rad.
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
    /// Reserves the manipulator for the calling task and switches its power on. Holding it already, with power on,
    /// the task is told so and nothing changes.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Acquire => Result<State, MotionError>, 0x0301, "acquire"
}
ctos::command! {
    /// Moves, and answers when the arm has settled at the target, or has passed it on the way to the next one. A motion
    /// that comes while another is under way waits until that has ended, and is planned from there; at most
    /// [`crate::servo::QUEUE`] may be under way and wait. What ends one before its end ends those that wait as well.
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
        /// Elbow posture at a pose, of an arm with a closed form, or the one nearest to the present joints.
        pub elbow: Option<Elbow>,
        /// Recipes of guards that watch it, besides those that always do.
        pub guards: Vec<String>,
        /// How much of the stop before it may be left out when it follows on another motion: what lies so near to the point
        /// where both meet gives way to a bridge between them.
        pub blend: Blend,
    } => Result<MoveReport, MotionError>, 0x0302, "move"
}
ctos::command! {
    /// Checks a motion from the present position, or from where the last motion that is ordered ends, without moving.
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
        /// Elbow posture at a pose, of an arm with a closed form, or the one nearest to the present joints.
        pub elbow: Option<Elbow>,
    } => Result<PlanReport, MotionError>, 0x0303, "plan"
}
impl Plan {
    /// What is asked of a planner.
    ///
    /// # Errors
    /// The target is no pose.
    pub fn route(&self) -> Result<Route, HandlerError> {
        Ok(Route {
            goal: match &self.target {
                Target::Joints(joints) => Goal::Joints(*joints),
                Target::Pose(rows) => Goal::Pose(pose(rows)?),
            },
            path: self.path,
            pace: Pace::new(self.speed, self.acceleration),
            elbow: self.elbow,
        })
    }
}

/// A pose from 16 numbers, checked: a rotation, a translation and the last row of a pose.
fn pose(rows: &[f64; 16]) -> Result<Isometry3<f64>, HandlerError> {
    if let Some(index) = rows.iter().position(|value| !value.is_finite()) {
        let (row, column) = (index / 4 + 1, index % 4 + 1);
        let text = format!("row {row}, column {column} of the target pose is not a finite number");
        return Err(text.into());
    }
    let [a, b, c, x, d, e, f, y, g, h, i, z, last @ ..] = *rows;
    if last != [0.0, 0.0, 0.0, 1.0] {
        return Err(
            format!("the last row of the target pose is {last:?}; it must be 0, 0, 0, 1").into(),
        );
    }
    let matrix = Matrix3::new(a, b, c, d, e, f, g, h, i);
    let skew = (matrix * matrix.transpose() - Matrix3::identity()).amax();
    if skew > ROTATION_ROUNDING || matrix.determinant() < 0.0 {
        return Err(format!(
            "the upper left 3 by 3 part of the target pose is no rotation (off by {skew:.1e}, determinant {:.3})",
            matrix.determinant()
        )
        .into());
    }
    let rotation = Rotation3::from_matrix_unchecked(matrix);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

ctos::command! {
    /// Reads the joints back.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadPosition => Position, 0x0304, "read_position"
}
ctos::command! {
    /// Protective stop: brakes along the path to rest, then holds with power on (category 2 of IEC 60204-1) until somebody
    /// resumes. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Stop => (), 0x0305, "stop_motion"
}
ctos::command! {
    /// Comes to rest, switches power off and gives the manipulator back. Where nobody holds it, changes nothing.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Release => Result<State, MotionError>, 0x0306, "release"
}
ctos::command! {
    /// Tells how the manipulator is.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Status => StatusReport, 0x0307, "status"
}
ctos::command! {
    /// Takes drive power away now (category 0 of IEC 60204-1). Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct EmergencyStop => (), 0x0308, "emergency_stop"
}
ctos::command! {
    /// Comes to rest along the path, then takes drive power away (category 1 of IEC 60204-1), and answers when that is so.
    /// Anybody may ask. As after an emergency stop, the manipulator must be reset and acquired anew.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ControlledStop => (), 0x030e, "controlled_stop"
}
ctos::command! {
    /// Leaves the estopped state, and ends a protective stop; the manipulator must then be acquired anew.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Reset => Result<State, MotionError>, 0x0309, "reset"
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
ctos::command! {
    /// Goes over to another control law, until the servo's task is built anew. Torques go from those of the one to those
    /// of the other without a step, also while the arm is on its way.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetLaw {
        /// Its registered name.
        pub law: String,
    } => ControlReport, 0x0314, "set_law"
}
/// What sensors read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorReport {
    /// The sensors, in the order of their numbers.
    pub sensors: Vec<Sensor>,
    /// Their numbers at the servo's latest tick, one sensor after the other.
    pub numbers: Vec<f64>,
    /// The names of those that have read nothing new for too long.
    pub stale: Vec<String>,
}

ctos::command! {
    /// Reads the slots that are no joints.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadSensors => SensorReport, 0x0313, "read_sensors"
}
/// A joint as the servo's latest tick left it: rad, rad/s and N m of one that turns, m, m/s and N of one that slides.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointReport {
    /// Its name in the model.
    pub name: String,
    /// Whether it turns or slides.
    pub kind: JointKind,
    /// Where it is.
    pub position: f64,
    /// How fast it moves.
    pub velocity: f64,
    /// Where it should be.
    pub setpoint: f64,
    /// What was written to its drive.
    pub torque: f64,
    /// Its smallest and its largest position, which may be infinite.
    pub range: [f64; 2],
    /// The most of its drive, which may be infinite.
    pub most_torque: f64,
}

/// All slots of a manipulator, for those who watch it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SlotsReport {
    /// The joints, in the model's order.
    pub joints: Vec<JointReport>,
    /// What the slots read that are no joints.
    pub sensors: SensorReport,
    /// Why the arm was stopped last, since the servo's task was built; also after a reset or a resume.
    pub last_stop: Option<String>,
}

ctos::command! {
    /// Reads all slots, with the limits of the joints.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadSlots => SlotsReport, 0x0346, "read_slots"
}
ctos::command! {
    /// Sets an output, until power goes off. Only the task that holds the manipulator may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetOutput {
        /// Its name.
        pub name: String,
        /// 0 or 1; of a lamp from 0 to 1.
        pub value: f64,
    } => Result<(), MotionError>, 0x0333, "set_output"
}
ctos::command! {
    /// Ends the motion under way: brakes along the path to rest. The next one may begin at once, which it may not
    /// after a protective stop. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Cancel => (), 0x030c, "cancel"
}
ctos::command! {
    /// Ends a protective stop. What it ended must be asked for again. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Resume => (), 0x030d, "resume"
}
ctos::command! {
    /// Writes what every servo tick leaves to a snapshot buffer of the app from now on, or to none: positions, velocities,
    /// setpoints and torques of all joints, rad or m, N m or N, and what slots that are no joints read, as the buffer's description
    /// says. Until the servo's task is built anew. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct RecordStates {
        /// The buffer's name.
        pub buffer: Option<String>,
    } => (), 0x030f, "record_states"
}

/// How a stream is that an arm follows, or how the last one ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StreamReport {
    /// What is streamed; nothing before the first.
    pub kind: Option<StreamKind>,
    /// The snapshot buffer; nothing where values come by [`StreamValue`].
    pub buffer: Option<String>,
    /// Whether the arm follows it.
    pub follows: bool,
    /// How many values were taken.
    pub values: u64,
    /// How old the newest one was at the last tick, s.
    pub age_s: f64,
    /// Why it is followed no more.
    pub end: Option<String>,
}

ctos::command! {
    /// Has the arm follow a stream of setpoints or torques, and answers once it does. Only the task that holds the
    /// manipulator may ask. [`Cancel`] and every stop end the stream, and so does a value that is too old, or that cannot be
    /// followed: the arm comes to rest, and holds until a stream or a motion is asked for anew.
    #[derive(Debug, Clone, PartialEq)]
    pub struct StreamSetpoints {
        /// What is streamed.
        pub kind: StreamKind,
        /// The snapshot buffer of the app whose newest record is followed; without one, what [`StreamValue`] hands over.
        pub buffer: Option<String>,
        /// A value older than this ends the stream, s.
        pub max_age_s: f64,
        /// Fraction of full speed, above 0 up to 1. Of torques it limits nothing.
        pub speed: f64,
        /// Fraction of full acceleration, above 0 up to 1; as the speed when it is left out.
        pub acceleration: Option<f64>,
        /// Recipes of guards that watch it, besides those that always do.
        pub guards: Vec<String>,
    } => Result<StreamReport, MotionError>, 0x0330, "stream_setpoints"
}
ctos::command! {
    /// The next value of a stream that follows no buffer. Only the task that holds the manipulator may ask. What cannot be
    /// followed the next tick finds, and [`ReadStream`] tells, as does the next value.
    #[derive(Debug, Clone, PartialEq)]
    pub struct StreamValue {
        /// Numbers, as [`StreamKind`] says.
        pub numbers: Vec<f64>,
    } => Result<StreamReport, MotionError>, 0x0331, "stream_value"
}
ctos::command! {
    /// Tells how the latest stream is.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadStream => StreamReport, 0x0332, "read_stream"
}

/// A recipe of a guard that a manipulator has.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recipe {
    /// Its name.
    pub name: String,
    /// The kind of guard.
    pub kind: String,
    /// Whether it watches motions that do not name it.
    pub always: bool,
    /// What happens when it finds something.
    pub reaction: Reaction,
    /// Whether it stands in the configuration, and so stays.
    pub configured: bool,
}

/// The guards of a manipulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GuardsReport {
    /// All recipes.
    pub recipes: Vec<Recipe>,
    /// What a guard found last.
    pub last: Option<GuardReport>,
}

ctos::command! {
    /// Adds a recipe of a guard, or changes one, from the next servo tick on, also in a motion that it watches. It
    /// stays until the servo's task is built anew. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetGuard {
        /// Its name.
        pub name: String,
        /// A registered kind of guard.
        pub kind: String,
        /// Whether it watches motions that do not name it.
        pub always: bool,
        /// What happens when it finds something.
        pub reaction: Reaction,
        /// The arguments of the kind, as TOML.
        pub args: String,
    } => (), 0x0310, "set_guard"
}
ctos::command! {
    /// Takes a recipe away that a [`SetGuard`] added. Anybody may ask.
    #[derive(Debug, Clone, PartialEq)]
    pub struct RemoveGuard {
        /// Its name.
        pub name: String,
    } => (), 0x0311, "remove_guard"
}
ctos::command! {
    /// Tells the recipes that there are, and what a guard found last.
    #[derive(Debug, Clone, PartialEq)]
    pub struct ReadGuards => GuardsReport, 0x0312, "read_guards"
}
