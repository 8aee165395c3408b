//! Steering a scanner of the app: a client takes it from the Vision Module Manager with its first order, keeps it, and gives it
//! back with `off`. Whoever waits for longer than the manager allows gets it, and then the first one has lost it.

use std::time::Duration;

use sorma::{Outcome, Report, Transport, Waiting};

use super::{Laser, code};
use crate::{
    catalog::{VMM, scanner_task},
    command::{AcquireVm, ReleaseVm, SteerLaser},
    laser::LaserOrder,
};

/// How long the scanner and its manager are waited for.
const DEADLINE: Duration = Duration::from_secs(10);

/// A scanner under the manager's grant.
#[derive(Debug, Clone)]
pub(super) struct Held {
    /// Its Vision Module.
    vm: String,
    grant: u64,
}

impl Laser {
    /// Has the scanner do something; it is taken first if it is not held.
    pub(super) async fn ordered(
        &mut self,
        cx: &Waiting<'_>,
        order: LaserOrder,
        io: &mut Transport,
    ) -> Outcome {
        let name = self.options.name.clone();
        let failed = |why: &str| Report::error(code::NO_LASER, format!("scanner `{name}`: {why}"));
        if !cx.is_in_app() {
            return Err(failed(
                "there is none here, for no app runs here: attach to one",
            ));
        }
        let vm = scanner_task(&name);
        // Another name than before: the other scanner is free for others.
        if let Some(held) = self.held.take_if(|held| held.vm != vm) {
            let _ = switched_off(cx, held).await;
        }
        let grant = match &self.held {
            Some(held) => held.grant,
            None => {
                let request = AcquireVm { vm: vm.clone() };
                let granted = cx.call_task(VMM, request, DEADLINE).await;
                granted.map_err(|report| {
                    failed(&format!(
                        "the manager does not grant it: {}; another client that holds it gives it back with `off`",
                        report.text
                    ))
                })?
            }
        };
        let held = Held { vm, grant };
        if order == LaserOrder::Off {
            self.held = None;
            switched_off(cx, held)
                .await
                .map_err(|report| failed(&report.text))?;
        } else {
            self.held = Some(held.clone());
            let request = SteerLaser { grant, order };
            let done = cx.call_task(&held.vm, request, DEADLINE).await;
            if let Err(report) = done {
                self.held = None;
                released(cx, &held).await;
                return Err(failed(&report.text));
            }
        }
        io.floats = match order {
            LaserOrder::Spot(command) => command.to_vec(),
            _ => Vec::new(),
        };
        Ok(())
    }
}

/// Switches a scanner off and gives it back, whatever it says.
async fn switched_off(cx: &Waiting<'_>, held: Held) -> Outcome {
    let request = SteerLaser {
        grant: held.grant,
        order: LaserOrder::Off,
    };
    let done = cx.call_task(&held.vm, request, DEADLINE).await;
    released(cx, &held).await;
    done
}

async fn released(cx: &Waiting<'_>, held: &Held) {
    let request = ReleaseVm { grant: held.grant };
    // What is not given back is taken when the next one has waited for long enough.
    if let Err(report) = cx.call_task(VMM, request, DEADLINE).await {
        tracing::warn!(vm = held.vm, "not given back: {}", report.text);
    }
}
