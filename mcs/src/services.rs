//! What this crate can do, as classes of service objects (SORMA technical report, chapter 1).
//!
//! `kin`, `dyn` and `traj` need no running app: they compute. `mvpos` and `pino` drive the arm of the app, or where there is no
//! app one that the process holds for itself, and `slots` shows its joints; `setpoint` and `torque` stream to the app's, and
//! `wspc` holds recipes of guards for it. Their texts and numbers are a fixed interface that other programs lean on: SI units,
//! rad, matrices row by row, the base frame on the floor under joint 1 and frame 6 as the DH table has it.

mod arm;
mod dynamics;
mod kinematics;
mod local;
mod mvpos;
mod pino;
mod slots;
mod streaming;
mod traj;
mod wspc;

use sorma::{Class, ClassInfo, Outcome, Report, Sorm, Transport, Waiting};

use crate::CLIENT;
use crate::client::MotionError;
use local::SharedArm;
use mvpos::MvPos;
use pino::Pino;
use streaming::Streaming;
use wspc::Wspc;

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

sorma::prototypes! {
    /// The codes of the reports of these classes.
    pub mod code {
        UNREACHABLE = 120, Error, "no joint positions reach the pose",
            "move the pose nearer, or away from joint 1's axis; the text has the distances";
        SINGULAR = 121, Error, "infinitely many joint positions reach the pose",
            "set -singular near, and -near to where joint 4 should stay";
        LIMITS = 122, Error, "every way to reach the pose has a joint outside its limits",
            "choose another orientation, or look at the solutions with -limits off";
        NO_POSE = 123, Error, "the 16 numbers are no pose",
            "write base_T_6 row by row: rotation and position in m, last row 0 0 0 1";
        TOO_LARGE = 124, Error, "the numbers are too large to compute with",
            "check the units: rad, rad/s, rad/s^2";
        NO_POSITION = 125, Error, "no position of this name, or none of a flavor's own",
            "`dict CTRL -add position.NAME 'q1 .. qn'` names one, rad or m; -to gives a flavor its own";
        MOTION = 126, Error, "the motion cannot be made", "the text says what is in the way, and where";
        MODEL = 127, Error, "the description of an arm is wrong, or odd",
            "mend it at file:line:column, which the text begins with";
        NO_INERTIA = 128, Error, "no accelerations follow from the torques",
            "give every link that is moved its mass and inertia, or set -rotor";
        MEET = 129, Warning, "the pose is singular: postures coincide, or the tip cannot move some way",
            "go there by joints; a straight line through it needs unlimited joint speeds";
    }
}

/// The recipes that are shipped with the classes.
pub const DICTIONARY: &str = "\
kin.puma560 -arm puma560
kin.puma600 -arm puma600
kin.transporter -arm transporter
kin.testbed9 -arm testbed9
kin.testbed18 -arm testbed18
dyn.puma560 -arm puma560
dyn.puma600 -arm puma600
dyn.transporter -arm transporter
dyn.testbed9 -arm testbed9
dyn.testbed18 -arm testbed18
mvpos -speed 0.3
mvpos.home -SUBST mvpos -to 0 0.7853981633974483 -3.141592653589793 0 0.7853981633974483 0
position.home 0 0.7853981633974483 -3.141592653589793 0 0.7853981633974483 0
position.ready 0 1.5707963267948966 -1.5707963267948966 0 0 0
position.side 1.5707963267948966 0.7853981633974483 -3.141592653589793 0 0.7853981633974483 0
";

/// Makes the classes known to a manager.
pub fn register(sorm: &Sorm) {
    let kin = Class::new("kin", VERSION, |_, _| {
        Ok(Box::new(kinematics::Kinematics::new()?))
    });
    let dynamics = Class::new("dyn", VERSION, |_, _| {
        Ok(Box::new(dynamics::Dynamics::new()?))
    });
    let traj = Class::new("traj", VERSION, |_, _| Ok(Box::new(traj::Traj::default())));
    let arm = SharedArm::new();
    let own = arm.clone();
    let mvpos = Class::new("mvpos", VERSION, move |_, _| Ok(Box::new(MvPos::new(&own))));
    let seen = arm.clone();
    let slots = Class::new("slots", VERSION, move |_, _| {
        Ok(Box::new(slots::Slots::new(&seen)))
    });
    let slots = slots.waits().any_flavor();
    let pino = Class::new("pino", VERSION, move |_, _| Ok(Box::new(Pino::new(&arm))));
    // A flavor of one's own has options of one's own.
    let mvpos = mvpos.waits().any_flavor();
    let pino = pino.waits().any_flavor();
    let wspc = Class::new("wspc", VERSION, |_, _| Ok(Box::new(Wspc::default())));
    let wspc = wspc.waits().any_flavor();
    let setpoint = Class::new("setpoint", VERSION, |_, _| {
        Ok(Box::new(Streaming::setpoints()))
    });
    let torque = Class::new("torque", VERSION, |_, _| Ok(Box::new(Streaming::torques())));
    let (setpoint, torque) = (setpoint.waits().any_flavor(), torque.waits().any_flavor());
    let all = [
        kin, dynamics, mvpos, pino, setpoint, slots, torque, traj, wspc,
    ];
    for (class, info) in all.into_iter().zip(classes()) {
        sorm.register(class.codes(code::PROTOTYPES).described(info));
    }
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![
        kinematics::TABLE.class("kin", VERSION),
        dynamics::TABLE.class("dyn", VERSION),
        mvpos::TABLE.class("mvpos", VERSION),
        pino::TABLE.class("pino", VERSION),
        streaming::SETPOINTS.class("setpoint", VERSION),
        slots::TABLE.class("slots", VERSION),
        streaming::TORQUES.class("torque", VERSION),
        traj::TABLE.class("traj", VERSION),
        wspc::TABLE.class("wspc", VERSION),
    ]
}

/// The first six of `floats`, which the table has counted; missing numbers would be 0.
fn six(floats: &[f64]) -> [f64; 6] {
    std::array::from_fn(|index| floats.get(index).copied().unwrap_or_default())
}

/// What keeps the app's arm from doing what was asked, as a report.
fn in_the_way(error: MotionError) -> Report {
    Report::error(code::MOTION, error.reason)
}

/// Names the manipulators that there are where an object asked for one that is not.
async fn known(cx: &Waiting<'_>, client: &str, outcome: Outcome) -> Outcome {
    let Err(report) = outcome else {
        return Ok(());
    };
    if report.code != sorma::report::code::DAEMON || !cx.is_in_app() {
        return Err(report);
    }
    let there = cx.tasks_of(CLIENT).await?;
    if there.iter().any(|name| name == client) {
        return Err(report);
    }
    let object = cx.name();
    let flavor = object.split_once('.').map_or(client, |(_, flavor)| flavor);
    let meant = |given| sorma::name::suggestion(given, there.iter().map(String::as_str));
    let hint = Some(meant(flavor)).filter(|hint| !hint.is_empty());
    let hint = hint.unwrap_or_else(|| meant(client));
    let text = format!(
        "`{object}` asks the manipulator `{client}`, and this app has none of that name: it has {}{hint}; a recipe of the \
         dictionary names one for `{object}`, and so does `{object} CTRL -client NAME`",
        there.join(", ")
    );
    Err(Report::error(report.code, text))
}

/// Ends a request: what came in must not stay there as if it were an answer.
fn ended(io: &mut Transport, outcome: Outcome) -> Outcome {
    io.text.clear();
    if outcome.is_err() {
        io.floats.clear();
        io.ints.clear();
    }
    outcome
}

#[cfg(test)]
mod tests;
