//! The control plane: how a person, or a program, looks at a running app and tells it what to do.

mod logs;

pub use logs::{Level, LogLine};

pub(crate) use logs::LogStore;
