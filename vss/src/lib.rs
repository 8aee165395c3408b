//! Vision Services System: Vision Modules, managers, Tools, Services, calibration

pub mod calibrate;
pub mod camera;
pub mod camera_info;
pub mod components;
pub mod frame;
pub mod spot;
