//! Vision Services System: Vision Modules, managers, Tools, Services, calibration

pub mod frame;
