//! Watching a running app: lints, which are warnings about what it does, and metrics for Prometheus.
//!
//! A chassis looks at itself from its system processor, on which no handler of the app runs: one that
//! never returns is still seen. In virtual time the simulation lets it look at the same intervals. The
//! page `docs/watching.md` lists lints and metrics.

mod lint;
mod metrics;

use std::{collections::BTreeSet, time::Duration};

use crate::bootstrap::Overview;
use ctos_core::{chassis::Chassis, context::Context};
use ctos_message::{Command, CommandInfo};
use ctos_time::{Clock, Instant};

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

/// The virtual clock is about to jump to `moment`: what the chassis would see on the way, when they would.
pub fn look_until<'a>(
    clock: &Clock,
    chassis: impl Iterator<Item = &'a std::sync::Arc<Chassis>>,
    moment: Instant,
) {
    let all: Vec<_> = chassis.collect();
    let first = all.iter().enumerate().map(|(place, one)| {
        let last = Watch::of(one).last_look();
        let step = (moment.since(last) / LOOKS).max(INTERVAL);
        (last + step, place, step)
    });
    let mut looks: BTreeSet<_> = first.collect();
    while let Some((due, place, step)) = looks.pop_first().filter(|(due, ..)| *due < moment) {
        clock.advance_to(due);
        if let Some(one) = all.get(place) {
            Watch::of(one).look(one, due);
        }
        looks.insert((due + step, place, step));
    }
}

/// Before that moment none of these chassis looks at itself again.
pub fn next_look<'a>(chassis: impl Iterator<Item = &'a std::sync::Arc<Chassis>>) -> Instant {
    let next = chassis.map(|one| Watch::of(one).last_look() + INTERVAL);
    next.min().unwrap_or(Instant::LAST)
}

/// What is wrong with a chassis at present.
#[must_use]
pub fn lints(chassis: &Chassis) -> Vec<Lint> {
    Watch::of(chassis).lints()
}

#[cfg(test)]
mod tests;
