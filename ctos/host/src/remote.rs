//! Other hosts: the agent that waits there for boots, and the boot's link to it.
//!
//! A boot calls the agent of each host that its app names and sends it the app's files. The agent
//! starts, signals and watches the chassis of that host ([`HostAgent`]; `ctos agent` is one). Chassis
//! talk to each other without it, over links. Not to be confused with the task `agent` that each
//! chassis has, which creates the chassis's tasks.

mod agent;
mod call;
mod link;
mod loopback;
mod run;
mod unpack;
mod wire;

#[cfg(test)]
mod tests;

#[cfg(test)]
pub(crate) use tests::{corpus, fuzz};

pub use agent::{AgentError, AgentEvent, AgentObserver, AgentSetup, HostAgent};

pub use ctos_bootstrap::bootstrap::HostError;

pub(crate) use link::{HostLink, Hosts, HostsSetup};
pub(crate) use loopback::is_same_user;
