//! Cameras as numbers: the model of a camera and its lens, what follows from pixels and known points, and files of cameras.
//!
//! One camera is calibrated from lights ([`calibrate`]) or from views of a plane ([`plane`]). A pair is calibrated from
//! both of its calibrations ([`stereo`]), and several cameras with the lights that they share ([`bundle`]). Poses tell where
//! one sits on a tool ([`handeye`]). Known objects have poses before a camera: targets of lights ([`pose`]), and any model ([`perspective`]).
//! Knows no picture, no task and no service object.

pub mod adjust;
pub mod bundle;
pub mod calibrate;
pub mod camera;
pub mod camera_info;
pub mod handeye;
pub mod perspective;
pub mod plane;
pub mod pose;
pub mod stereo;
