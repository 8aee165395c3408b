//! Motion Control System: slots, control laws, planning, state manager, client interface.
//!
//! The layers of CIRSSE report 108, section 4, from the bottom: [`driver`] is the testbed interface
//! (slots over channel drivers), [`control`] the laws that turn setpoints into torques, [`trajectory`]
//! the planning of segments, [`servo`] the synchronous function that runs all three at the servo
//! rate, [`guard`] what watches its motions, [`state`] the rules of the state manager, [`client`] what
//! users ask and get. [`model`] is any arm as data with its kinematics and dynamics, [`joints`] a vector
//! of as many numbers as it has joints; the tasks put everything behind event handlers, registered by
//! [`register`], and [`partition`] makes them out of a list of manipulators.
//!
//! Names no simulator and no hardware: whoever has one implements [`driver::ChannelDriver`] and
//! registers it in a [`driver::DriverRegistry`]. A control law of one's own goes into a [`control::LawRegistry`], a
//! guard into a [`guard::GuardRegistry`], a path planner or a solver of inverse kinematics into a
//! [`trajectory::PlanningRegistry`].

pub mod client;
pub mod partition;
pub mod services;
pub mod state;
mod tasks;

pub use mcs_model::{self as model, Joints, MAX_SLOTS, joints};
use mcs_servo::args;
pub use mcs_servo::{
    args::{arm, manipulator, planner},
    control, driver, guard, latest, servo, words,
};
pub use mcs_trajectory as trajectory;
pub use tasks::{CLIENT, register, register_with};

/// The pages of the book whose examples must run.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/guards.md")]
    mod guards {}
}
