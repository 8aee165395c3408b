//! MCS as event handlers: the servo's task, the state manager, the planner and the client interface.
//!
//! The servo's task owns the synchronous function and shares a [`Link`] to it on its chassis; state
//! manager and planner use that link and so live on the same chassis (any processor of it). The
//! client interface only exchanges messages and may live anywhere.

pub mod args;
pub mod client;
mod drawn;
mod guards;
pub mod planner;
mod records;
mod retreat;
pub mod servo;
mod slots;
mod split_torque;
mod stands;
pub mod state;
mod streams;
mod ways;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use ctos::config::{App, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use ctos::message::Tid;
use ctos::registry::Registry;
use ctos::task::{Context, HandlerError};
use nalgebra::Isometry3;

pub use crate::args::SERVO;
use crate::args::StandsArgs;
use crate::client::{MotionError, Outcome};
use crate::control::LawRegistry;
use crate::driver::{DriverRegistry, Power, Sensor};
use crate::guard::GuardRegistry;
use crate::servo::{Fault, ServoCommand, ServoConfig, ServoPort, ServoStatus};
use crate::trajectory::{Planner, PlanningRegistry};

/// Registered name of the state manager's event handler.
pub const STATE: &str = "mcs.state";
/// Registered name of the planner's event handler.
pub const PLANNER: &str = "mcs.planner";
/// Registered name of the client interface's event handler.
pub const CLIENT: &str = "mcs.client";

/// Registers the event handlers of MCS, which find their channel drivers in `drivers`, alone or several as one
/// ([`TESTBED`](crate::driver::TESTBED)), their control laws in `laws` and their kinds of guard in `guards`.
pub fn register(
    registry: &mut Registry,
    drivers: DriverRegistry,
    laws: LawRegistry,
    guards: GuardRegistry,
) {
    register_with(registry, drivers, laws, guards, PlanningRegistry::new());
}

/// As [`register`], with path planners and solvers of inverse kinematics of one's own.
pub fn register_with(
    registry: &mut Registry,
    drivers: DriverRegistry,
    laws: LawRegistry,
    guards: GuardRegistry,
    planning: PlanningRegistry,
) {
    servo::register(
        registry,
        Arc::new(drivers.with_testbed()),
        Arc::new(laws),
        Arc::new(guards),
        Arc::new(planning),
    );
    state::register(registry);
    planner::register(registry);
    client::register(registry);
    split_torque::register(registry);
}

/// What the tasks of one manipulator share on its chassis.
pub struct Link {
    /// The way to the servo and back.
    pub port: ServoPort,
    /// The planner for this manipulator, with its limits and tool. Who plans takes a copy, which has scratch of its own.
    pub planner: Planner,
    /// Rates of the servo.
    pub config: ServoConfig,
    /// The recipes of its guards.
    guards: guards::Recipes,
    /// The motions that were ordered and have not ended, for viewers.
    ways: ways::Ways,
    /// The slots that are no joints.
    sensors: Vec<Sensor>,
    /// Where viewers see the arm, and what its sensors read.
    stands: Option<StandsArgs>,
    sensor_frames: BTreeMap<String, String>,
}

impl Link {
    fn key(servo: &str) -> String {
        format!("mcs.servo/{servo}")
    }

    /// The link of the servo task called `servo`, for tasks of its chassis.
    ///
    /// # Errors
    /// A text that says what to change when it is not on this chassis.
    pub fn find(cx: &Context, servo: &str) -> Result<Arc<Self>, HandlerError> {
        cx.shared(&Self::key(servo)).ok_or_else(|| {
            HandlerError::new(format!(
                "`{}` finds no servo task `{servo}` on its chassis; place both on the same chassis",
                cx.name()
            ))
        })
    }

    /// How often to look at the servo while waiting for it.
    fn look(&self) -> Duration {
        self.config.period * self.config.setpoint_every.max(1)
    }

    /// Waits until `done` says so of the servo's status, at most `patience` by the servo's own count
    /// of periods.
    ///
    /// # Errors
    /// A text when the patience is over or the servo has stopped ticking.
    async fn wait(
        &self,
        cx: &Context,
        what: &str,
        patience: Duration,
        done: impl Fn(&ServoStatus) -> bool,
    ) -> Result<ServoStatus, HandlerError> {
        let first = self.port.status().ticks;
        let limit = patience.as_secs_f64() / self.config.period.as_secs_f64();
        let mut last = first;
        let mut silent = 0_u32;
        loop {
            let status = self.port.status();
            if done(&status) {
                return Ok(status);
            }
            silent = if status.ticks == last { silent + 1 } else { 0 };
            if silent > SILENT_LOOKS || (status.ticks - first) as f64 > limit {
                return Err(format!(
                    "the servo did not {what} within {} ticks (power {:?}, at rest: {})",
                    status.ticks - first,
                    status.power,
                    status.at_rest
                )
                .into());
            }
            last = status.ticks;
            cx.sleep(self.look()).await;
        }
    }

    /// How long braking and settling may take at most.
    fn rest_patience(&self) -> Duration {
        // The hardest stop of an arm from full speed takes well under two seconds.
        Duration::from_secs(2) + self.config.period * self.config.settling.patience
    }

    /// Brings the arm to rest, brakes on, power off; returns when all that is confirmed.
    ///
    /// # Errors
    /// A text when the servo does not confirm it.
    pub async fn shut_down(&self, cx: &Context) -> Result<(), HandlerError> {
        self.port.order(ServoCommand::PowerOff)?;
        // After a fault power is off already, and a driver that failed cannot confirm rest.
        let off = |status: &ServoStatus| {
            status.power == Power::Off && (status.at_rest || status.fault.is_some())
        };
        let patience = self.rest_patience();
        self.wait(cx, "come to rest and switch off", patience, off)
            .await?;
        Ok(())
    }

    /// Why power was taken away, in the driver's words where it was the driver.
    fn fault(&self) -> Option<String> {
        let fault = self.port.status().fault?;
        match self.port.driver_error() {
            Some(error) if fault == Fault::Driver => Some(format!("{fault}: {error}")),
            _ => Some(fault.to_string()),
        }
    }

    /// The slots that read nothing, as what keeps the manipulator cold.
    fn missing(&self) -> Option<MotionError> {
        let status = self.port.status();
        let slots = slots::sensor_report(&status, &self.sensors).stale;
        let text = || {
            let names = slots.join("`, `");
            format!(
                "slot `{names}` reads nothing: see that what provides it runs, then acquire anew"
            )
        };
        (!slots.is_empty()).then(|| MotionError::new(Outcome::Refused, text()))
    }

    /// The fault as what keeps the manipulator from moving.
    fn failed(&self) -> Option<MotionError> {
        let outcome = match self.port.status().fault? {
            Fault::EmergencyStop | Fault::ControlledStop => Outcome::Estopped,
            _ => Outcome::Fault,
        };
        let fault = self.fault().unwrap_or_default();
        let reason = format!("power was taken away: {fault}; reset it, then acquire it anew");
        Some(MotionError { outcome, reason })
    }
}

/// Looks at a servo whose tick count stands still before it counts as dead (36 s at the defaults'
/// 18 ms: a loaded machine is late, not dead; calls have their own deadlines).
const SILENT_LOOKS: u32 = 2000;

/// The name of the task with id `tid`.
///
/// # Errors
/// A text when it has none.
async fn caller(cx: &Context, tid: Tid) -> Result<String, HandlerError> {
    let name = cx.name_of(tid).await?;
    name.ok_or_else(|| format!("the asking task {tid} has no name").into())
}

/// Checks that argument `key` of `task` names a task with the handler `handler`, on the same chassis
/// when `together`.
fn check_reference(
    task: &TaskConfig,
    app: &App,
    findings: &mut Findings,
    (key, name): (&str, &str),
    handler: &str,
    together: bool,
) {
    let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
    let candidates = app.tasks.iter().filter(|other| other.handler == handler);
    let Some(found) = candidates.clone().find(|other| other.name == name) else {
        let text = format!(
            "task `{}` needs `{key}`, but no task with the handler `{handler}` is called `{name}`",
            task.name
        );
        let names = candidates.map(|other| other.name.as_str());
        let finding = Finding::error("mcs::unknown_part", text).at(place);
        findings.push(finding.suggest(name, names));
        return;
    };
    if together && found.chassis != task.chassis {
        let text = format!(
            "task `{}` and its {key} `{name}` must be on one chassis, but are on `{}` and `{}`",
            task.name, task.chassis, found.chassis
        );
        let help = format!(
            "write `on = \"{}\"`, with any processor of it",
            found.chassis
        );
        let finding = Finding::error("mcs::apart", text).at(task.on_place.clone());
        findings.push(finding.help(help));
    }
}

/// Row-major 4 by 4 matrix of a pose.
fn rows(pose: &Isometry3<f64>) -> [f64; 16] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|index| matrix[(index / 4, index % 4)])
}
