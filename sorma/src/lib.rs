//! Service objects with EXEC, CTRL and DBX, reached by one line of text.
//!
//! The core of SORMA (Walter and Ritter, technical report SFB360-TR-96-3, chapter 1): names, the
//! transport structure, textual requests, option tables, and the dictionary of recipes. The manager
//! builds objects from their names. Other daemons are reached over the seam in [`comm`]; [`daemon`]
//! carries it by the tasks of CTOS.
//!
//! A file may use files of its own layer and of the layers before it:
//!
//! 1. text: `words`, `name`, `report`
//! 2. data: `opaque`, `transport`, `request`, `results`, `layout`, `description`, `reserve`, `meter`, `meta`
//! 3. parts that know no object: `options`, `dictionary`, `trade/wanted`, `trade/market`, `watching`, `comm`, `clock`;
//!    the crate `sorma-snapshot`
//! 4. what an object is and where it stands, the one circle: `object`, `class`, `sorm`
//! 5. calls by reference: `dbx`, `slot`
//! 6. objects by their names: `plant`, `together`, `trade`
//! 7. requests by their names: `waiting`, `dispatch`, `later`, `stream`
//! 8. classes: `dictionary/object`, `manager`, `watching/object`, `builtin`, `asynchronous`, `ipc`, `demo`
//! 9. tasks of CTOS: `daemon`

mod arrival;
pub mod asynchronous;
mod builtin;
pub mod class;
pub mod clock;
pub mod comm;
pub mod daemon;
mod dbx;
pub mod demo;
mod description;
pub mod dictionary;
mod dispatch;
pub mod ipc;
pub mod later;
mod layout;
mod manager;
mod meta;
mod meter;
pub mod name;
pub mod object;
pub mod opaque;
pub mod options;
mod plant;
mod relay;
pub mod report;
pub mod request;
mod reserve;
pub mod results;
mod slot;
pub mod sorm;
pub mod sound;
pub mod stream;
pub mod together;
pub mod trade;
pub mod transport;
mod waiting;
pub mod watching;
pub mod words;
mod workers;

pub use class::Class;
pub use comm::{Alone, Comm};
pub use dbx::built;
pub use description::{ClassInfo, Form};
pub use dictionary::Dictionary;
pub use later::Deferred;
pub use name::{Location, NameError, ObjectName};
pub use object::{Context, Outcome, ServiceObject, TwoStep, Waiting};
pub use opaque::Opaque;
pub use options::OptionTable;
pub use report::{Prototype, Report, Severity};
pub use request::{Method, Reply, Request, RequestError};
pub use results::{Keep, Sample};
pub use slot::{Claim, Handle, Owned};
pub use sorm::Sorm;
pub use sorma_snapshot as snapshot;
pub use stream::Stream;
pub use transport::Transport;
pub use workers::Workers;

/// What a program may know about classes, as data.
pub mod describe {
    pub use crate::builtin::own_classes;
    pub use crate::dbx::dbx_options;
    pub use crate::description::{ClassInfo, Form, FormInfo, OptionInfo, OptionKind};
    pub use crate::layout::{Layout, Part, Shape};
}

/// The pages of `docs` whose examples are run as tests.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/service-objects.md")]
    mod service_objects {}
    #[doc = include_str!("../../docs/snapshots.md")]
    mod snapshots {}
}

#[cfg(test)]
mod tests {
    mod fuzz;
}
