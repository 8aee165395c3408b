//! Watching a running app: lints, which are warnings about what it does, and metrics for Prometheus.
//!
//! A chassis looks at itself from its system processor, on which no handler of the app runs: one that
//! never returns is still seen. In virtual time the simulation lets it look at the same intervals. The
//! page `docs/watching.md` lists what is told.

mod lint;
mod meter;
mod metrics;
mod server;
mod text;

use std::time::Duration;

use crate::{
    chassis::Chassis,
    context::Context,
    time::{Clock, Instant},
};

pub use lint::{Lint, LintCode};

pub(crate) use lint::Watch;
pub(crate) use meter::{CommandCount, TaskMeter};
pub(crate) use metrics::{Gather, gather_here};
pub(crate) use server::serve;

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
            chassis.watch.look(&chassis, watcher.now());
        }
    });
}

/// The virtual clock is about to jump to `moment`: what the chassis would see on the way, when they would.
pub(crate) fn look_until<'a>(
    clock: &Clock,
    chassis: impl Iterator<Item = &'a std::sync::Arc<Chassis>>,
    moment: Instant,
) {
    let mut looks: Vec<_> = chassis
        .map(|one| {
            let step = (moment.since(one.watch.last_look()) / LOOKS).max(INTERVAL);
            (one.watch.last_look() + step, step, one)
        })
        .collect();
    while let Some((due, step, one)) = looks.iter_mut().min_by_key(|(due, _, _)| *due) {
        if *due >= moment {
            return;
        }
        clock.advance_to(*due);
        one.watch.look(one, *due);
        *due = *due + *step;
    }
}

impl Chassis {
    /// What is wrong with this chassis at present.
    #[must_use]
    pub fn lints(&self) -> Vec<Lint> {
        self.watch.lints()
    }
}

#[cfg(test)]
mod tests;
