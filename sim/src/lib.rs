//! Rapier stand-in for the testbed: PUMA 560, wrist lamp, ceiling cameras.
//!
//! [`world`] moves the arm, [`driver`] shows it to the control layer as slots, [`cell`] reads the
//! file that describes arm, lamp, cameras and room, [`camera`] takes the pictures. The control and
//! vision layers know none of these: they see a channel driver and a frame source.

pub mod camera;
pub mod cell;
pub mod driver;
pub mod handlers;
pub mod puma560;
pub mod scene;
pub mod shapes;
pub mod world;

pub use handlers::register;
