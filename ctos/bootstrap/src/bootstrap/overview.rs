//! How an app and its chassis are, as the bootstrap service tells it.

use ctos_core::context::TaskRef;
use ctos_message::command;
use ctos_time::Instant;
use serde::{Deserialize, Serialize};

use super::states::{BootState, ChassisState};

command! {
    /// Asks the bootstrap service how the app and its chassis are.
    pub struct Overview => AppReport, 0xff57, "overview"
}

/// The app as its bootstrap service sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AppReport {
    /// Where it is between its first process and its last.
    pub state: BootState,
    /// The moment, on the app's clock.
    pub now: Instant,
    /// Its chassis, in declared order.
    pub chassis: Vec<MemberReport>,
}

/// A chassis as the bootstrap service sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MemberReport {
    /// Its name.
    pub name: String,
    /// Where it is in its life.
    pub state: ChassisState,
    /// Since when.
    pub since: Instant,
    /// Counts its processes from 1.
    pub incarnation: u32,
    /// Why the process before this one ended; `None` for the first.
    pub last_end: Option<String>,
    /// The tasks of this incarnation.
    pub tasks: Vec<TaskRef>,
}
