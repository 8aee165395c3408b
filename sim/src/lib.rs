//! The simulated testbed: arms, lamps, cameras and objects of one cell, by Rapier and the arms' own dynamics.
//!
//! [`cell`] reads the file that describes it, [`world`] moves it, [`world_task`] owns it in an app. [`driver`] shows
//! joints to the control layer as slots, and [`camera`] takes the pictures. The control and
//! vision layers know none of these: they see a channel driver and a frame source. [`served`] is an arm for a control
//! layer in another process.

mod arm;
pub mod camera;
pub mod cell;
pub mod driver;
mod engine;
pub mod hand;
pub mod handlers;
pub mod port;
pub mod scene;
mod scene_truth;
pub mod scenes;
pub mod served;
pub mod simulation;
pub mod source;
pub mod world;
pub mod world_task;
pub mod wrist;

pub use handlers::register;
pub use sim_drawing::shapes;
