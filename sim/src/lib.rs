//! The simulated testbed: the world of one cell in an app.
//!
//! `sim-world` has the world itself, [`world_task`] owns it in an app. [`driver`] shows joints to the control layer as slots, and
//! [`source`] takes the pictures. The control and vision layers know none of these: they see a channel driver and a frame
//! source. [`served`] is an arm for a control layer in another process.

pub mod driver;
pub mod guide;
pub mod hand;
pub mod handlers;
pub mod port;
mod scene_truth;
pub mod scenes;
pub mod served;
pub mod simulation;
pub mod source;
mod watched;
pub mod world_task;

pub use handlers::register;
pub use sim_world::{camera, cell, hold, scene, shapes, world, wrist};
