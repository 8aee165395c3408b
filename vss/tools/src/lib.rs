//! What the Tools of VSS compute (CIRSSE report 108, section 5): from a [`frame`] to spots, components, corners and
//! markers; a learned map from pixels to places ([`psom`]) and what is made of it. Knows no task, no Service and no file.
//!
//! Pixel centres are at whole numbers, the first pixel is (0, 0), u runs right and v down.

pub mod chequer;
pub mod components;
pub mod frame;
pub mod laser;
pub mod lines;
pub mod marker;
pub mod psom;
pub mod spot;
pub mod target_map;
pub mod tracking;
pub mod visual_jacobian;
pub mod watch;

use vss_geometry::camera;
