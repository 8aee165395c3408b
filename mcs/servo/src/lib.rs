//! The servo level of the Motion Control System (CIRSSE report 108, section 4): what runs once in a servo period.
//!
//! [`driver`] is the testbed interface: slots over channel drivers. [`control`] has the laws that turn setpoints into torques,
//! and [`guard`] what watches motions. [`servo`] is the synchronous function that runs them with the planned segments. [`args`]
//! reads a servo's arguments from the configuration. Knows no event handler, and nothing above the servo.

pub mod args;
pub mod control;
pub mod driver;
pub mod guard;
pub mod latest;
pub mod servo;

pub use mcs_model::{self as model, Joints, MAX_SLOTS, joints};
pub use mcs_trajectory as trajectory;
