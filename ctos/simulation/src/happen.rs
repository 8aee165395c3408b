//! What a fault does to the machines and links of a simulated app, and when the given ones happen.

use std::collections::BTreeMap;

use crate::{
    fault::{Fault, FaultKind, Site},
    injured,
    run::Simulation,
};
use ctos_bootstrap::bootstrap::BootError;
use ctos_core::{chassis::BOOT_CHASSIS, system};
use ctos_time::{Drift, Instant};

impl Simulation {
    fn index(&self, name: &str) -> Option<usize> {
        // Machines stand in the order of the numbers of their chassis.
        let number = self.machines.first()?.chassis.number_of(name)?;
        Some(usize::from(number))
    }

    pub(super) fn happen(&mut self, fault: Fault) {
        self.events.note(|| format!("fault {fault}"));
        match &fault.site {
            Site::Chassis(name) => {
                if let Some(index) = self.index(name) {
                    self.happen_to(index, &fault);
                }
            }
            Site::Link(one, other) => {
                if let (Some(one), Some(other)) = (self.index(one), self.index(other)) {
                    self.happen_between(one, other, &fault);
                }
            }
        }
        // A repetition of the run has the configuration anyway.
        if !self.injuries.contains(&fault) {
            self.happened.push(fault);
        }
    }

    fn happen_to(&mut self, index: usize, fault: &Fault) {
        let Some(machine) = self.machines.get_mut(index) else {
            return;
        };
        let number = machine.chassis.index();
        let until = fault.until.unwrap_or(Instant::LAST);
        match fault.kind {
            FaultKind::Kill => self.kill(number),
            FaultKind::Restart => self.tell_boot(system::RestartChassis { chassis: number }),
            FaultKind::Freeze if !machine.gone => {
                machine.freeze(until);
                self.rouse(index);
                self.network.freeze(number, until);
            }
            FaultKind::Slow { per_step } => machine.slow(until, per_step),
            _ => {}
        }
    }

    fn happen_between(&self, one: usize, other: usize, fault: &Fault) {
        let (Some(first), Some(second)) = (self.machines.get(one), self.machines.get(other)) else {
            return;
        };
        let ends = (first.chassis.index(), second.chassis.index());
        let until = fault.until.unwrap_or(Instant::LAST);
        match fault.kind {
            FaultKind::Cut => {
                self.network.cut(ends);
                first.chassis.link_down(ends.1);
                second.chassis.link_down(ends.0);
            }
            FaultKind::Break | FaultKind::Stall => {
                let breaks = fault.kind == FaultKind::Break;
                self.network.silence(ends, until, breaks);
            }
            kind => {
                if let Some(disturbance) = injured::disturbance(kind, until) {
                    self.network.disturb(ends, disturbance);
                }
            }
        }
    }
}

/// Faults by the moment at which they happen; those of clocks, which are wrong from the start, take the
/// place of those that were drawn.
pub(super) fn schedule(
    names: &[String],
    given: Vec<Fault>,
    drifts: &mut Vec<Fault>,
) -> Result<BTreeMap<Instant, Vec<Fault>>, BootError> {
    let mut script: BTreeMap<Instant, Vec<Fault>> = BTreeMap::new();
    for fault in given {
        let ended = matches!(fault.kind, FaultKind::Kill | FaultKind::Restart);
        let known = |name: &String| names.contains(name) && !(ended && name == BOOT_CHASSIS);
        if let Some(chassis) = fault.site.chassis().find(|name| !known(name)) {
            return Err(BootError::NoChassis {
                chassis: chassis.clone(),
                what: fault.kind.called(),
            });
        }
        if let FaultKind::Drift { .. } = fault.kind {
            drifts.retain(|other| other.site != fault.site);
            drifts.push(fault);
        } else {
            script.entry(fault.at).or_default().push(fault);
        }
    }
    Ok(script)
}

pub(super) fn drift_of(name: &str, drifts: &[Fault]) -> Drift {
    let found = drifts
        .iter()
        .find_map(|fault| match (fault.kind, &fault.site) {
            (FaultKind::Drift { ahead, rate_ppb }, Site::Chassis(chassis)) if chassis == name => {
                Some(Drift {
                    offset_ns: u64::try_from(ahead.as_nanos()).unwrap_or(0),
                    rate_ppb,
                })
            }
            _ => None,
        });
    found.unwrap_or_default()
}
