//! What this crate can do, as classes of service objects (SORMA technical report, chapter 1).
//!
//! `gripper` closes and opens the gripper of an app, through its task with the handler `mcs.gripper`. `manus` moves the hand
//! of an app, through its task with the handler `mcs.hand`, or one that the process holds for itself. `squeeze` says how hard two
//! arms press on what they carry, through the task with the handler `mcs.carry`.

mod gripper;
mod manus;
mod squeeze;
#[cfg(test)]
mod tests;

use mcs::client::MotionError;
use sorma::{Class, ClassInfo, Report, Sorm};

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

sorma::prototypes! {
    /// The codes of the reports of these classes.
    pub mod code {
        NOTHING_HELD = 130, Error, "nothing is held", "the text says how wide it stands; look where the object is";
        HAND = 131, Error, "the hand or the gripper cannot do this", "the text says what is in the way";
        NO_HAND = 132, Error, "there is no gripper outside an app", "attach to an app that has one: `scott APP`";
    }
}

/// The recipes that are shipped with the classes: postures of the hand, rad, and a sequence of them.
pub const DICTIONARY: &str = "\
posture.straight 0 0 0 0 0 0 0 0 0
posture.open 0 -0.6 0.6 0 -0.6 0.6 0 -0.6 0.6
posture.tripod 0 -0.35 0.785 0 -0.35 0.785 0 -0.35 0.785
posture.fist 0 0.9 1.5 0 0.9 1.5 0 0.9 1.5
posture.point 0 0 0 0 0.9 1.5 0 0.9 1.5
sequence.greet open 1 fist 1.5 open 1.5
";

/// Makes the classes known to a manager.
pub fn register(sorm: &Sorm) {
    let gripper = Class::new("gripper", VERSION, |_, _| {
        Ok(Box::new(gripper::Gripper::default()))
    });
    // A flavor of one's own has options of one's own.
    let gripper = gripper.waits().any_flavor();
    let own = manus::SharedHand::new();
    let manus = Class::new("manus", VERSION, move |_, _| {
        Ok(Box::new(manus::Manus::new(&own)))
    });
    let manus = manus.waits().any_flavor();
    let squeeze = Class::new("squeeze", VERSION, |_, _| {
        Ok(Box::new(squeeze::Squeezing::default()))
    });
    let squeeze = squeeze.waits().any_flavor();
    for (class, info) in [gripper, manus, squeeze].into_iter().zip(classes()) {
        sorm.register(class.codes(code::PROTOTYPES).described(info));
    }
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![
        gripper::TABLE.class("gripper", VERSION),
        manus::TABLE.class("manus", VERSION),
        squeeze::TABLE.class("squeeze", VERSION),
    ]
}

/// What keeps a gripper or a hand from doing what was asked, as a report.
fn in_the_way(error: MotionError) -> Report {
    Report::error(code::HAND, error.reason)
}
