//! The Vision Module Manager (VMM): grants the hardware behind Vision Modules to one Tool at a time, in the order in
//! which they asked. A holder that dies, or keeps it too long while others wait, loses it.

mod arbiter;

use std::{cell::RefCell, collections::BTreeMap, rc::Rc, time::Duration};

use ctos::{
    message::{ChassisNumber, Command, CommandInfo, Message, Replier, Tid},
    task::{Context, EventHandler, Handled, HandlerError},
};
use serde::Deserialize;

use crate::command::{AcquireVm, ReleaseVm};
use arbiter::{Arbiter, Turn};

/// The commands it takes.
pub const COMMANDS: &[CommandInfo] = &[AcquireVm::INFO, ReleaseVm::INFO];

/// Its arguments; the catalog writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct VmmArgs {
    /// Vision Module task to the name of the hardware it drives.
    hardware: BTreeMap<String, String>,
    /// How long a Tool may hold hardware that others wait for, s.
    #[serde(default = "default_hold_limit")]
    hold_limit_s: Duration,
}

fn default_hold_limit() -> Duration {
    Duration::from_secs(5)
}

type Waiter = Replier<AcquireVm>;

/// The Vision Module Manager.
pub struct ModuleManager {
    hardware: BTreeMap<String, String>,
    limit: Duration,
    arbiter: Rc<RefCell<Arbiter<Waiter>>>,
}

impl ModuleManager {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: VmmArgs = cx.args()?;
        let now = u64::try_from(cx.now().since_start().as_nanos()).unwrap_or(u64::MAX >> 1);
        Ok(Self {
            hardware: args.hardware,
            limit: args.hold_limit_s,
            // Grants of a manager that began anew are larger than all before, for scanners refuse older ones.
            arbiter: Rc::new(RefCell::new(Arbiter::after(now))),
        })
    }

    fn acquire(&self, cx: &Context, message: Message) -> Handled {
        let from = message.from();
        let (AcquireVm { vm }, reply) = message.open::<AcquireVm>()?;
        let Some(hardware) = self.hardware.get(&vm) else {
            let known: Vec<&str> = self.hardware.keys().map(String::as_str).collect();
            return reply.fail(format!(
                "no Vision Module is called `{vm}`; there are: {}",
                known.join(", ")
            ));
        };
        let turn = self.arbiter.borrow_mut().acquire(hardware, from, reply);
        match turn {
            Some(turn) => {
                tracing::debug!(hardware, grant = turn.grant, "granted");
                grant(turn);
            }
            None => self.watch(cx, hardware.clone()),
        }
        Ok(())
    }

    /// Sees to it that the holder of `hardware`, for which somebody waits now, does not keep it for ever.
    fn watch(&self, cx: &Context, hardware: String) {
        let Some(holder) = self.arbiter.borrow().holder(&hardware) else {
            return;
        };
        let (cx, arbiter, limit) = (cx.clone(), self.arbiter.clone(), self.limit);
        let child = cx.clone();
        child.spawn(async move {
            cx.sleep(limit).await;
            // A holder that gave it back in time has another number.
            if arbiter.borrow().holder(&hardware) == Some(holder) {
                tracing::warn!(hardware, "its holder kept it for too long and lost it");
                let turn = arbiter.borrow_mut().release(holder);
                turn.into_iter().for_each(grant);
            }
        });
    }

    fn revoke(&self, chassis: ChassisNumber) {
        let turns = self
            .arbiter
            .borrow_mut()
            .revoke(|tid: Tid| tid.chassis() == chassis);
        turns.into_iter().for_each(grant);
    }
}

fn grant(turn: Turn<Waiter>) {
    // Answering never fails; its result exists to end a handler with.
    let _ = turn.waiter.ok(turn.grant);
}

/// The number of a chassis in task ids.
pub(crate) fn number_of(cx: &Context, chassis: &str) -> Option<ChassisNumber> {
    // Chassis 0 is the boot itself; the app's own count from 1 in the order of the configuration.
    let mut all = cx.app().chassis.iter();
    let position = all.position(|config| config.name == chassis)?;
    ChassisNumber::try_from(position + 1).ok()
}

impl arbiter::Waits for Waiter {
    fn still_waits(&self) -> bool {
        !self.is_abandoned()
    }
}

impl EventHandler for ModuleManager {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            AcquireVm::CODE => self.acquire(cx, message),
            ReleaseVm::CODE => {
                let (ReleaseVm { grant: number }, reply) = message.open::<ReleaseVm>()?;
                let turn = self.arbiter.borrow_mut().release(number);
                turn.into_iter().for_each(grant);
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        if let Some(index) = number_of(cx, chassis) {
            tracing::debug!(chassis, "what it held is taken back");
            self.revoke(index);
        }
        Ok(())
    }
}
