//! What a task can reach: the [`Context`] its handler is called with.

mod asking;
pub(crate) mod core;
mod finding;
mod messages;
mod outside;
mod quiet;
mod services;
pub(crate) mod task_ref;

pub use self::{
    asking::Call,
    core::{Context, DEFAULT_DEADLINE, Elapsed, SHARED},
    finding::{Find, NameError},
    task_ref::TaskRef,
};
