//! What this crate can do, as classes of service objects (SORMA technical report, chapter 1).
//!
//! The classes here need no running app: they compute. Their texts and numbers are a fixed interface
//! that other programs lean on: SI units, rad, matrices row by row, the base frame on the floor
//! under joint 1 and frame 6 as the DH table has it.

mod dynamics;
mod kinematics;

use sorma::{ClassInfo, Outcome, Sorm, Transport};

use crate::arm::{ArmModel, Joints};

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Height of frame 0's origin to joint 2's axis, m, unless an option says otherwise.
const PEDESTAL: f64 = 0.67183;

/// The codes of the reports of these classes.
pub mod code {
    /// No joint positions reach the pose.
    pub const UNREACHABLE: i32 = 120;
    /// Infinitely many joint positions reach the pose.
    pub const SINGULAR: i32 = 121;
    /// Every way to reach the pose has a joint outside its limits.
    pub const LIMITS: i32 = 122;
    /// The 16 numbers are no pose.
    pub const NO_POSE: i32 = 123;
    /// The numbers are too large to compute with.
    pub const TOO_LARGE: i32 = 124;
}

/// The recipes that are shipped with the classes.
pub const DICTIONARY: &str = "\
kin.puma560 -arm puma560
dyn.puma560 -arm puma560
";

/// Makes the classes known to a manager.
pub fn register(sorm: &Sorm) {
    sorm.register("kin", VERSION, |_, _| {
        Ok(Box::new(kinematics::Kinematics::default()))
    });
    sorm.register("dyn", VERSION, |_, _| {
        Ok(Box::new(dynamics::Dynamics::default()))
    });
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![
        kinematics::TABLE.class("kin", VERSION),
        dynamics::TABLE.class("dyn", VERSION),
    ]
}

/// The PUMA 560 with its published inertias, or with those that physics engines accept.
fn arm(inertias: &str, pedestal: f64) -> ArmModel {
    let mut model = match inertias {
        "engine" => ArmModel::puma560(),
        _ => ArmModel::puma560_identified(),
    };
    let [first, ..] = &mut model.dh;
    first.d = pedestal;
    model
}

/// The joint vector that begins at `start` in `floats`, which the table has counted; missing numbers
/// would be 0.
fn joints(floats: &[f64], start: usize) -> Joints {
    std::array::from_fn(|index| floats.get(start + index).copied().unwrap_or_default())
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
