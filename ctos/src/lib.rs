//! Event handler tasks found by symbolic name, messages, boot, time: the runtime

pub mod config;
pub mod diagnostic;
