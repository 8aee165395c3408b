//! What a mishap does to the machines and links of a simulated app, and when the given ones happen.

use std::collections::BTreeMap;

use crate::{
    mishap::{Mishap, Site},
    run::Simulation,
};
use ctos_bootstrap::bootstrap::BootError;
use ctos_core::{chassis::BOOT_CHASSIS, system};
use ctos_time::{Drift, Instant};

impl Simulation {
    fn index(&self, name: &str) -> Option<usize> {
        let mut machines = self.machines.iter();
        machines.position(|machine| machine.chassis.name() == name)
    }

    pub(super) fn happen(&mut self, mishap: Mishap) {
        self.events.note(|| format!("fault {mishap}"));
        match mishap.site() {
            Site::Chassis(name) => {
                if let Some(index) = self.index(name) {
                    self.happen_to(index, &mishap);
                }
            }
            Site::Link(one, other) => {
                if let (Some(one), Some(other)) = (self.index(one), self.index(other)) {
                    self.happen_between(one, other, &mishap);
                }
            }
        }
        // Whoever makes the run again has the configuration anyway.
        if !self.injuries.contains(&mishap) {
            self.happened.push(mishap);
        }
    }

    fn happen_to(&mut self, index: usize, mishap: &Mishap) {
        let Some(machine) = self.machines.get_mut(index) else {
            return;
        };
        let number = machine.chassis.index();
        match mishap {
            Mishap::Kill { .. } => self.kill(number),
            Mishap::Restart { .. } => {
                if let Some(boot) = self.machines.first() {
                    let restart = system::RestartChassis { chassis: number };
                    boot.chassis.post_system(system::BOOTSTRAP, restart);
                }
            }
            Mishap::Freeze { until, .. } if !machine.gone => {
                machine.freeze(*until);
                for other in self.machines.iter().filter(|other| !other.gone) {
                    let peer = other.chassis.index();
                    if peer != number {
                        self.network.freeze(number, (peer, other.clock()), *until);
                    }
                }
            }
            Mishap::Slow {
                until, per_step, ..
            } => machine.slow(*until, *per_step),
            _ => {}
        }
    }

    pub(super) fn happen_between(&self, one: usize, other: usize, mishap: &Mishap) {
        let (Some(first), Some(second)) = (self.machines.get(one), self.machines.get(other)) else {
            return;
        };
        let ends = (first.chassis.index(), second.chassis.index());
        let clocks = || ((ends.0, first.clock()), (ends.1, second.clock()));
        match mishap {
            Mishap::Cut { .. } => {
                self.network.cut(ends.0, ends.1);
                first.chassis.link_down(ends.1);
                second.chassis.link_down(ends.0);
            }
            Mishap::Break { until, .. } => {
                let (one, other) = clocks();
                self.network.silence(one, other, *until, true);
            }
            Mishap::Stall { until, .. } => {
                let (one, other) = clocks();
                self.network.silence(one, other, *until, false);
            }
            Mishap::Loss {
                until, share_ppm, ..
            } => self.network.lose(ends.0, ends.1, *until, *share_ppm),
            Mishap::Delay { until, extra, .. } => {
                self.network.delay(ends.0, ends.1, *until, *extra);
            }
            _ => {}
        }
    }
}

/// Faults by the moment at which they happen; those of clocks, which are wrong from the start, take the
/// place of those that were drawn.
pub(super) fn schedule(
    names: &[String],
    given: Vec<Mishap>,
    drifts: &mut Vec<Mishap>,
) -> Result<BTreeMap<Instant, Vec<Mishap>>, BootError> {
    let check = |name: &str, mishap: &Mishap| {
        let ended = matches!(mishap, Mishap::Kill { .. } | Mishap::Restart { .. });
        if names.iter().any(|known| known == name) && !(ended && name == BOOT_CHASSIS) {
            return Ok(());
        }
        Err(BootError::NoChassis {
            chassis: name.to_owned(),
            what: mishap.called(),
        })
    };
    let mut script: BTreeMap<Instant, Vec<Mishap>> = BTreeMap::new();
    for mishap in given {
        match mishap.site() {
            Site::Chassis(chassis) => check(chassis, &mishap)?,
            Site::Link(one, other) => {
                check(one, &mishap)?;
                check(other, &mishap)?;
            }
        }
        if let Mishap::Drift { chassis, .. } = &mishap {
            drifts.retain(|other| !matches!(other.site(), Site::Chassis(name) if name == chassis));
            drifts.push(mishap);
        } else {
            script.entry(mishap.at()).or_default().push(mishap);
        }
    }
    Ok(script)
}

pub(super) fn drift_of(name: &str, drifts: &[Mishap]) -> Drift {
    let found = drifts.iter().find_map(|mishap| match mishap {
        Mishap::Drift {
            chassis,
            ahead,
            rate_ppb,
        } if chassis == name => Some(Drift {
            offset_ns: u64::try_from(ahead.as_nanos()).unwrap_or(0),
            rate_ppb: *rate_ppb,
        }),
        _ => None,
    });
    found.unwrap_or_default()
}
