//! Vision Services System (VSS): from pictures to numbers, as event handlers.
//!
//! The user deals with Services, through the Services Manager ([`vsm`]); a Service is a series of calls to Tools; a
//! Tool asks the Vision Module Manager ([`vmm`]) for a Vision Module, which alone touches hardware (CIRSSE report
//! 108, section 5). The list of Services in an app's configuration makes its vision tasks ([`catalog`]).
//!
//! The computations stand by themselves and know no tasks: [`spot`], [`components`], [`camera`], [`calibrate`],
//! [`camera_info`]. No simulator is named here: pictures come from a [`source::FrameSource`].

#![allow(
    clippy::result_large_err,
    reason = "findings are made when an app is read, never on a path that repeats"
)]

pub mod catalog;
pub mod chequer;
pub mod command;
pub mod components;
pub mod frame;
pub mod laser;
pub mod marker;
pub mod psom;
pub mod service;
pub mod services;
pub mod source;
pub mod spot;
pub mod target_map;
pub mod tool;
pub mod tracking;
pub mod visual_jacobian;
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
