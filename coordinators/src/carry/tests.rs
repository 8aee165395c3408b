//! The nets of `carry` in virtual time, between stand-ins for the arm, the gripper and the cameras, which know where the thing is and
//! fail on demand.

mod aside;
mod errands;
mod failures;
mod full_hands;
mod kills;
mod looks;
mod points;
mod poses;
mod strategies;
pub(crate) mod world;

pub(super) use world::errand;
