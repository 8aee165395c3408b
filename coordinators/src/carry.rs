//! The task `carry`: a thing is taken from one field of a board and set down on another (SORMA technical report, section
//! 2.1.4 and figure 2.4).
//!
//! A Dispatcher ([`dispatcher`]) has the steps done by Coordinators: [`robot`] moves the arm, [`hand`] opens and closes
//! the gripper, [`vision`] finds the board and the thing, for which it asks the Service [`eyes`]; what follows from what was seen is
//! [`sight`]. A fourth one, [`laser`], points at what was lost, and [`people`] asks
//! whether it is fetched. Their nets stand in `configs/nets/carry/`, what is carried in a file of its own ([`thing`]). The class `carry`
//! ([`service`]) gives such commands by text. A referee ([`referee`]) holds the result against the truth. No motion of a camera calibration is known here.

pub mod board;
pub mod dispatcher;
mod drawing;
pub mod errand;
pub mod eyes;
pub mod hand;
pub mod laser;
pub mod people;
pub mod referee;
pub mod robot;
pub mod service;
pub mod sight;
pub mod speaker;
pub mod thing;
pub mod vision;
mod ways;

#[cfg(test)]
pub(crate) mod tests;

use ctos::registry::Registry;

/// Registers the event handlers.
pub(crate) fn register(registry: &mut Registry) {
    dispatcher::register(registry);
    robot::register(registry);
    hand::register(registry);
    laser::register(registry);
    people::register(registry);
    eyes::register(registry);
    vision::register(registry);
    referee::register(registry);
}
