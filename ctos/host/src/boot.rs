//! The processes of an app: that which boots, and those of its chassis.

mod child;
pub(crate) mod launcher;
mod mesh;
mod parent;
pub(crate) mod processes;
pub(crate) mod spawn;

pub use child::{ChildError, run_chassis};
pub use launcher::Launcher;
pub use parent::{Setup, boot};
