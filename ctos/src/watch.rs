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

use crate::{chassis::Chassis, context::Context, time::Instant};

pub use lint::{Lint, LintCode};

pub(crate) use lint::Watch;
pub(crate) use meter::TaskMeter;
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

/// The virtual clock is about to jump to `moment`: what the chassis would see on the way.
pub(crate) fn look_until<'a>(
    chassis: impl Iterator<Item = &'a std::sync::Arc<Chassis>>,
    moment: Instant,
) {
    for one in chassis {
        let step = moment.since(one.watch.last_look()) / LOOKS;
        let step = step.max(INTERVAL);
        while one.watch.last_look() + step < moment {
            one.watch.look(one, one.watch.last_look() + step);
        }
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
