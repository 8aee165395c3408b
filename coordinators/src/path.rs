//! Going from place to place around what stands in the way: the Path-planning Coordinator (CIRSSE report 108, section 6), and a
//! Dispatcher that has it go.
//!
//! [`coordinator`] knows several ways of going: a line of the tool, joints interpolated, an arch, and ways that were planned
//! around everything. It takes the one most likely to succeed for its cost ([`crate::strategy`]), goes on with the next when
//! that failed, and passes up the reasons of all. [`dispatcher`] turns the name of a place into a [`trip`]. Both nets stand in
//! `configs/nets/path/`. `drive` leads the arm along a planned way.

pub mod coordinator;
pub mod dispatcher;
pub(crate) mod drive;
pub mod trip;

#[cfg(test)]
mod tests;

use ctos::registry::Registry;

/// Registers the event handlers.
pub(crate) fn register(registry: &mut Registry) {
    coordinator::register(registry);
    dispatcher::register(registry);
}
