//! Pictures of solids: what a camera as it truly is sees of them, with its lens, its lamp spots and its noise.
//!
//! [`shapes`] is the outer form of things, [`truth`] a camera, and [`rays`] where its pixels look. [`raster`] is how a solid
//! looks to it, [`picture`] the light of all pixels. [`lamp`] is what shines, [`noise`] the sensor. An analytic rasteriser of
//! our own, with exact normals. Knows no cell, no physics and no task.

pub mod lamp;
pub mod noise;
pub mod picture;
pub mod raster;
pub mod rays;
pub mod shapes;
pub mod truth;
