//! The visual and force tracker (SORMA technical report, section 2.2): an arm follows an illuminated ball that the camera on its wrist
//! sees, gives way when somebody pushes it, and is steered by a 3-D mouse.
//!
//! The mathematics knows no tasks: [`target`] is the ball's state, from pictures that come late; [`course`] the setpoint's way to it;
//! [`vector`] what forces and a mouse say; [`contact`] what the hand does at a wall, [`walls`] how fast it comes to one;
//! [`history`] where the hand was; [`arm`] the joints for a place; [`control`] puts these together for one period; [`blob`] is
//! what a picture shows; [`map`] the examples by which a blob is a place; [`judging`] holds all that against the truth.
//!
//! Four tasks run it: [`argus`] looks, [`client`] tells places from blobs, [`druide`] moves the arm, and [`application`] has them work
//! and tells how well. A net stands in front of them and decides ([`coordination`]); [`learning`] makes a map; [`grasp`] takes the ball. They exchange what is new by snapshot buffers and one message, all of them in [`wire`]. No simulator is named
//! here.

pub mod application;
pub mod argus;
pub mod arm;
pub mod blob;
pub mod client;
pub mod contact;
pub mod control;
pub mod coordination;
pub mod course;
pub mod druide;
pub mod grasp;
pub mod history;
pub mod joint_limits;
pub mod judging;
pub mod learning;
pub mod map;
pub mod mouse;
mod mover;
pub mod target;
pub mod vector;
pub mod walls;
pub mod wire;

use ctos::registry::Registry;

/// Registers the event handlers.
pub fn register(registry: &mut Registry) {
    argus::register(registry);
    client::register(registry);
    druide::register(registry);
    coordination::register(registry);
    mouse::register(registry);
    application::register(registry);
}
