//! Watching a running app: lints, which are warnings about what it does, and metrics for Prometheus.
//!
//! A chassis looks at itself from its system processor, on which no handler of the app runs: one that
//! never returns is still seen. In virtual time the simulation lets it look at the same intervals. The
//! page `docs/watching.md` lists lints and metrics.

mod lint;
mod metrics;

use std::time::Duration;

use crate::bootstrap::Overview;
use ctos_core::{chassis::Chassis, context::Context};
use ctos_message::{Command, CommandInfo};
use ctos_time::Instant;

pub use lint::{Lint, LintCode};

pub(crate) use lint::Watch;
#[doc(hidden)]
pub use metrics::{Gather, Metrics, gather_here, page};

/// Commands of the runtime that the core does not know, for records.
pub const COMMANDS: &[CommandInfo] = &[Gather::INFO, Overview::INFO];

/// How often a chassis looks at itself.
pub(crate) const INTERVAL: Duration = Duration::from_millis(500);
/// At most so many looks are taken while a virtual clock jumps once.
const LOOKS: u32 = 16;

/// Lets this chassis look at itself from now on. In virtual time the simulation does.
pub(crate) fn start(cx: &Context) {
    let chassis = cx.chassis().clone();
    if chassis.clock.origin_ns().is_none() {
        return;
    }
    let watcher = cx.clone();
    cx.spawn(async move {
        loop {
            watcher.sleep(INTERVAL).await;
            Watch::of(&chassis).look(&chassis, watcher.now());
        }
    });
}

/// When the chassis of a simulation look at themselves next, while its clock jumps from their last look to `moment`.
pub fn looks(last: Instant, moment: Instant) -> impl Iterator<Item = Instant> {
    let step = (moment.since(last) / LOOKS).max(INTERVAL);
    let next = move |due: &Instant| Some(*due + step);
    std::iter::successors(Some(last + step), next).take_while(move |due| *due < moment)
}

/// A chassis looks at itself. False when there is nothing to be seen before something runs there again.
pub fn look(chassis: &Chassis, now: Instant) -> bool {
    Watch::of(chassis).look(chassis, now)
}

/// What is wrong with a chassis at present.
#[must_use]
pub fn lints(chassis: &Chassis) -> Vec<Lint> {
    Watch::of(chassis).lints()
}

#[cfg(test)]
mod tests;
