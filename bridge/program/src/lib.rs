//! Event handlers that are programs of their own, in any language: [`HANDLER`] starts one and speaks JSON lines with it on its
//! standard input and output. `docs/programs.md` is the protocol.
//!
//! The program is asked and answers as any handler does. What it asks of others is typed by what these take, and only the
//! tasks that its configuration names are asked. A record holds every line that it wrote, so a replay starts no program.

mod args;
mod encode;
mod frames;
mod hello;
mod lines;
mod object;
mod process;
mod task;
mod types;

pub use args::HANDLER;
pub use encode::{encoded, told};
pub use object::{CLASS, classes, register_class};
pub use task::{AskObject, ObjectAnswer};

use ctos::{message::Command as _, registry::Registry};

/// Registers the handler.
pub fn register(registry: &mut Registry) {
    let kind = registry.handover(HANDLER, &[AskObject::INFO], task::Programmed::new);
    kind.checked_args(args::check);
    kind.declares(args::declared);
    registry.app_check("bridge::program", args::check_app);
}
