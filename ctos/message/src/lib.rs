//! Messages: a 20-byte header (receiver, sender, command, flags, data size) and data; what becomes of them.
//!
//! The header is the report's (CIRSSE report 108, section 3). Inside a chassis the data moves as a
//! typed pointer and is never encoded; between chassis it is postcard behind the header. Knows nothing of who
//! carries a message, and nothing of tasks.

#[cfg(test)]
extern crate self as ctos;

/// For the code that [`command!`] writes.
#[doc(hidden)]
pub use serde;

pub mod blob;
pub mod fault;
pub mod frame;

mod command;
mod data;
mod fields;
mod header;
mod shape;
mod trace;

pub use command::{Command, CommandInfo, DataType, FENCE, SYSTEM_COMMANDS, trimmed};
pub use data::{Data, Payload, PayloadError, append};
pub use header::{ChassisNumber, Flags, Header, Tid};
pub use shape::{Kind as ShapeKind, Shape};
