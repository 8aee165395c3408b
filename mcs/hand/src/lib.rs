//! Grippers and hands, as more joints of the same model tree (`mcs::model`) behind servos of their own (`mcs::servo`).
//!
//! [`fingers`] tells where fingertips are and how to get there. [`grip`] is the control law that closes with a force until
//! what moves stands still. [`gripper`] is the event handler that has a gripper close and open, and tells whether it holds
//! something; [`hand`] is that of a hand. With [`carry`], two arms carry one thing between them. [`command`] is what is asked of them, [`services`] the same as service objects.
//! Knows no simulator: what presses on a fingertip is told by whoever has the sensors.

pub mod carry;
pub mod command;
pub mod fingers;
pub mod grip;
pub mod gripper;
pub mod hand;
pub mod services;

use ctos::registry::Registry;
use mcs::control::LawRegistry;

/// Registers the event handlers, and the control laws with those of MCS.
pub fn register(registry: &mut Registry, laws: &mut LawRegistry) {
    let grips = grip::Grips::default();
    grips.register(laws);
    gripper::register(registry, &grips);
    hand::register(registry, &grips);
    let carries = carry::Carries::default();
    carries.register(laws);
    carry::register(registry, &carries);
}
