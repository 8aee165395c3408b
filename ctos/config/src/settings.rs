//! What a configuration settles for the services of the runtime: plain values and their defaults.
//!
//! The services give these types their meaning and publish them under their own names.

use std::{fmt, time::Duration};

use serde::{Deserialize, Serialize};

/// The name of the chassis that boots the others; its number is 0.
pub const BOOT_CHASSIS: &str = "boot";

/// Whether a task, a chassis or a key can be called so.
#[must_use]
pub fn is_name(name: &str) -> bool {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-.".contains(letter);
    (1..=64).contains(&name.len()) && name.chars().all(plain)
}

/// What is restarted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum When {
    /// Nothing: it stays down.
    #[default]
    Never,
    /// What failed: a panic of the handler, of a child or of a synchronous function.
    OnFailure,
    /// What failed, and what ended in order without the app being stopped (a `shutdown`).
    Always,
}

/// `restart`, `max_restarts`, `restart_window_s` and `restart_backoff_s` of the configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy {
    /// What is restarted.
    pub when: When,
    /// How many restarts there are within the window at most.
    pub max: u32,
    /// The window.
    pub window: Duration,
    /// The wait before the first restart of a window; it doubles with each further one.
    pub backoff: Duration,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            when: When::Never,
            max: 3,
            window: Duration::from_secs(60),
            backoff: Duration::from_millis(100),
        }
    }
}

/// Who shares a semaphore or a barrier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Scope {
    /// The processors of one chassis; each chassis has its own.
    #[serde(alias = "chassis")]
    Chassis,
    /// All chassis of the app.
    #[serde(alias = "app")]
    App,
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Chassis => "chassis",
            Self::App => "app",
        })
    }
}

/// What a processor does with base ticks that it could not begin before the next one came due. They are always
/// skipped and counted, never caught up in a burst; the policies differ in the functions that were due in
/// them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overrun {
    /// They wait until they are due again.
    #[default]
    Skip,
    /// They run once, late, in the tick that comes next, however many runs they missed.
    RunLateOnce,
    /// They wait until they are due again, and the tasks of the schedule have failed. The app is stopped
    /// in order, with the schedule still running, so that hardware can come to rest.
    Stop,
}

/// How long before a tick a processor that sleeps wakes up and spins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lead {
    /// So long, and at most half a base period. Zero = it sleeps until the tick.
    Fixed(Duration),
    /// As long as its wake-ups were late: at least [`Lead::LEAST`], at most [`Lead::MOST`] and a quarter of a base
    /// period. A late one counts at once, and is forgotten over some thousands of ticks.
    Learned,
}

impl Lead {
    /// What is learned at least.
    pub const LEAST: Duration = Duration::from_micros(80);
    /// What is learned at most. A thread later than this was kept from the core for other reasons, for which no
    /// lead would be long enough.
    pub const MOST: Duration = Duration::from_micros(500);
}

impl Default for Lead {
    fn default() -> Self {
        Self::Fixed(Duration::ZERO)
    }
}
