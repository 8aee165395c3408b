//! Service objects with EXEC, CTRL and DBX, reached by one line of text.
//!
//! The core of SORMA (Walter and Ritter, technical report SFB360-TR-96-3, chapter 1): names,
//! the transport structure, textual requests, option tables, the dictionary of recipes, and the
//! manager that builds objects from their names. One process; nothing here knows a network.

pub mod clock;
pub mod dictionary;
pub mod ipc;
pub mod name;
pub mod object;
pub mod options;
pub mod process;
pub mod report;
pub mod request;
pub mod snapshot;
pub mod sorm;
pub mod transport;
pub mod words;

pub use dictionary::Dictionary;
pub use name::{Location, NameError, ObjectName};
pub use object::{Context, Outcome, ServiceObject};
pub use options::OptionTable;
pub use report::{Report, Severity};
pub use request::{Method, Reply, Request, RequestError};
pub use sorm::{Handle, Sorm};
pub use transport::Transport;

/// The pages of `docs` whose examples are run as tests.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/snapshots.md")]
    mod snapshots {}
}
