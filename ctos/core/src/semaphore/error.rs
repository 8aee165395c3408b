//! Why a semaphore or barrier could not be had, in words that name everybody concerned.

use std::time::Duration;

use ctos_message::fault::CallError;

/// Why there is no permit, or no passage through a barrier.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SemaphoreError {
    /// All permits were held for as long as the task would wait.
    #[error(
        "`{task}` waited {:.3} s for the semaphore `{name}`, held by {}{}",
        .after.as_secs_f64(), held(.holders), line(*.before)
    )]
    Deadline {
        /// The semaphore.
        name: String,
        /// Who waited.
        task: String,
        /// How long.
        after: Duration,
        /// Who holds it, and for how long by now.
        holders: Vec<(String, Duration)>,
        /// How many others waited before it.
        before: usize,
    },
    /// Not everybody came to the barrier while the task would wait.
    #[error(
        "`{task}` waited {:.3} s at the barrier `{name}`, where {} of {parties} have arrived: {}",
        .after.as_secs_f64(), .arrived.len(), listed(.arrived)
    )]
    Missing {
        /// The barrier.
        name: String,
        /// Who waited.
        task: String,
        /// How long.
        after: Duration,
        /// Who has arrived, the task among them.
        arrived: Vec<String>,
        /// How many must.
        parties: u32,
    },
    /// Two tasks do not agree on the number.
    #[error(
        "`{name}` is for {has}, but `{task}` asks for one for {asked}; say it once, in the configuration"
    )]
    Disagree {
        /// The semaphore or barrier.
        name: String,
        /// Who asks.
        task: String,
        /// Permits, or parties, it has.
        has: u32,
        /// Permits, or parties, asked for.
        asked: u32,
    },
    /// A semaphore without permits, or a barrier for nobody.
    #[error("`{name}`, asked for by `{task}`, is for nobody: it needs a number of at least 1")]
    Nobody {
        /// The semaphore or barrier.
        name: String,
        /// Who asks.
        task: String,
    },
    /// The permit was taken away: the chassis gave no sign of life for a while.
    #[error("`{task}` has lost its permit of `{name}`: its chassis was given up meanwhile")]
    Lost {
        /// The semaphore.
        name: String,
        /// Who had it.
        task: String,
    },
    /// A request came with a permit that is not the latest.
    #[error("permit {number} is no longer good: permit {passed} has been used")]
    Outdated {
        /// The permit of the request.
        number: u64,
        /// The latest that has passed.
        passed: u64,
    },
    /// The chassis is being ended.
    #[error("`{task}` cannot wait for `{name}` any more: its chassis is being ended")]
    Ending {
        /// The semaphore or barrier.
        name: String,
        /// Who waited.
        task: String,
    },
    /// The task that keeps what all chassis share could not be asked.
    #[error(transparent)]
    Service(#[from] CallError),
}

fn listed(names: &[String]) -> String {
    let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    names.join(", ")
}

fn held(holders: &[(String, Duration)]) -> String {
    let holders = holders
        .iter()
        .map(|(name, held)| format!("`{name}` for {:.3} s", held.as_secs_f64()));
    holders.collect::<Vec<_>>().join(" and ")
}

fn line(count: usize) -> String {
    match count {
        0 => String::new(),
        1 => "; 1 other waits before it".to_owned(),
        count => format!("; {count} others wait before it"),
    }
}
