//! The simulated world: arms, lamps, cameras and objects of one cell, by Rapier and the arms' own dynamics.
//!
//! [`cell`] reads the file that describes it, [`world`] moves it, [`wrist`] is what a sensor in it feels, and [`camera`] draws a
//! [`scene`] of it. Knows no task, no slot and no clock: time is what it is told to step by.

mod arm;
pub mod camera;
pub mod cell;
mod engine;
pub mod hold;
pub mod scene;
pub mod world;
pub mod wrist;

pub use sim_drawing::shapes;
