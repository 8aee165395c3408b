//! What a task can reach: the [`Context`] its handler is called with.

mod asking;
pub(crate) mod core;
mod finding;
mod messages;
mod outside;
mod quiet;
mod services;

pub use self::{
    asking::Call,
    core::{Context, DEFAULT_DEADLINE, Elapsed, SHARED},
    finding::{Find, NameError},
};
pub use crate::task_ref::TaskRef;
