//! Configuration of an app: TOML files, includes, profiles and `--set`, read into checked types.
//!
//! All that is wrong is reported at once, each finding with file, line and column. Precedence:
//! default < include < file < profile < `--set`. The page `docs/configuration.md` lists every key;
//! [`DEFAULTS`] is the same list as a file.
//!
//! Knows no handler, task, socket or process. The arguments of a handler stay a [`Node`], which it reads itself.

#![allow(
    clippy::result_large_err,
    reason = "findings are made when an app is read, never on a path that repeats"
)]

pub mod diagnostic;
pub mod placement;

mod app;
mod build;
mod bundle;
mod check;
mod de;
mod expander;
mod hosts;
mod index;
mod keys;
mod links;
mod load;
mod node;
mod observe;
mod policies;
mod profiles;
mod reading;
mod schema;
mod selection;
mod settings;
#[cfg(test)]
mod tests;
mod trail;
mod variables;
mod zenoh;

pub use app::{
    App, ChassisConfig, ChassisSupervision, HostConfig, OnTaskFailure, ProcessorConfig,
    RecordConfig, SharedConfig, Start, TaskConfig, TimeMode,
};
pub use bundle::{Bundle, BundleError};
pub use expander::{Expander, GeneratedTask};
pub use links::{Cut, InjuryConfig, LinkConfig, SameHost, SecurityConfig};
pub use node::{Entry, Node, Value};
pub use reading::{load, load_texts};
pub use schema::schema;
pub use selection::Selection;
/// When the process of a chassis is started again: a failure is any end but one by itself with exit code 0.
pub use settings::When as ChassisRestart;
pub use settings::{BOOT_CHASSIS, Lead, Overrun, Policy, Scope, When, is_name};
pub use trail::Origin;
pub use zenoh::{ZenohConfig, ZenohEndpoint, ZenohEndpointError, ZenohMode, has_zenoh};

/// Every key with its default and what it means, as a TOML text.
pub const DEFAULTS: &str = include_str!("defaults.toml");
