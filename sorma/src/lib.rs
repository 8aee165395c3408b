//! Service objects with EXEC, CTRL and DBX, reached by one line of text.
//!
//! The core of SORMA (Walter and Ritter, technical report SFB360-TR-96-3, chapter 1): names,
//! the transport structure, textual requests, option tables, the dictionary of recipes, and the
//! manager that builds objects from their names. Other daemons are reached over the seam in [`comm`];
//! [`daemon`] carries it by the tasks of CTOS.

pub mod asynchronous;
pub mod class;
pub mod clock;
pub mod comm;
pub mod daemon;
mod dbx;
pub mod demo;
pub mod describe;
pub mod dictionary;
#[cfg(test)]
mod fuzz;
pub mod ipc;
pub mod later;
mod manager;
pub mod name;
pub mod object;
pub mod opaque;
pub mod options;
mod plant;
pub mod process;
pub mod report;
pub mod request;
mod reserve;
pub mod results;
mod slot;
pub mod snapshot;
pub mod sorm;
pub mod stream;
pub mod together;
pub mod trade;
pub mod transport;
pub mod waiting;
pub mod watching;
pub mod words;

pub use class::Class;
pub use comm::{Alone, Comm};
pub use describe::{ClassInfo, Form};
pub use dictionary::Dictionary;
pub use later::Deferred;
pub use name::{Location, NameError, ObjectName};
pub use object::{Context, Outcome, ServiceObject, TwoStep};
pub use opaque::Opaque;
pub use options::OptionTable;
pub use report::{Prototype, Report, Severity};
pub use request::{Method, Reply, Request, RequestError};
pub use results::{Keep, Sample};
pub use slot::{Claim, Handle, Owned};
pub use sorm::Sorm;
pub use stream::Stream;
pub use transport::Transport;
pub use waiting::Waiting;

/// The pages of `docs` whose examples are run as tests.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/service-objects.md")]
    mod service_objects {}
    #[doc = include_str!("../../docs/snapshots.md")]
    mod snapshots {}
}
