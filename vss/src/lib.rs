//! Vision Services System (VSS): from pictures to numbers, as event handlers.
//!
//! The user deals with Services, through the Services Manager ([`vsm`]); a Service is a series of calls to Tools; a
//! Tool asks the Vision Module Manager ([`vmm`]) for a Vision Module, which alone touches hardware (CIRSSE report
//! 108, section 5). The list of Services in an app's configuration makes its vision tasks ([`catalog`]).
//!
//! The computations stand by themselves and know no tasks: `vss-tools` finds things in pictures, `vss-geometry` calibrates
//! cameras, `vss-image` reads files. No simulator is named here: pictures come from a [`source::FrameSource`].

#![allow(
    clippy::result_large_err,
    reason = "findings are made when an app is read, never on a path that repeats"
)]

pub mod catalog;
pub mod command;
pub mod service;
pub mod services;
pub mod source;
pub mod tool;
pub mod vm;
pub mod vmm;
pub mod vsm;

mod concurrent;
mod register;

pub use register::register;
pub use vss_geometry::{
    bundle, calibrate, camera, camera_info, handeye, perspective, plane, pose, stereo,
};
pub use vss_image::{self as image, png};
pub use vss_tools::{
    chequer, components, frame, laser, lines, marker, psom, spot, target_map, tracking,
    visual_jacobian,
};
