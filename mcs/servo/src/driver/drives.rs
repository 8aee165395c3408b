//! Drives that close a loop of their own: a channel driver whose slots are commanded by position or speed, made of one that
//! takes torques. It is how an arm of the simulated world stands for a controller that knows no torques.

use std::sync::Arc;
use std::time::Duration;

use ctos::config::{App, Node, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use ctos::task::{Context, HandlerError};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::{
    ChannelDriver, DriverError, DriverRegistry, Mode, NamedDriver, Power, Sensor, SlotReading,
};
use crate::control::{ControlLaw, PidGravity};
use crate::joints::Joints;
use crate::model::Model;
use crate::trajectory::Setpoint;

/// Name of the driver.
pub const DRIVES: &str = "mcs.drives";

/// Arguments of the driver.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DrivesArgs {
    #[serde(rename = "driver")]
    _driver: String,
    #[serde(default, rename = "driver_args")]
    _driver_args: Option<IgnoredAny>,
    /// What each slot is commanded by; one for all of them, or one for each.
    modes: Vec<Mode>,
    /// Natural frequency of the drives' loop, Hz, which is critically damped.
    #[serde(default = "bandwidth_hz")]
    bandwidth_hz: f64,
}

fn bandwidth_hz() -> f64 {
    8.0
}

/// Adds [`DRIVES`], made of any driver that is registered by now.
pub(super) fn register(drivers: &mut DriverRegistry) {
    let known = drivers.clone();
    let (counted, checked) = (known.clone(), known.clone());
    let kind = drivers.driver(DRIVES, move |cx, args| open(&known, cx, args));
    kind.slots(move |app, args| {
        let inner = NamedDriver::of(args)?;
        counted.kind(&inner.name)?.count_slots(app, &inner.args)
    });
    kind.check(move |task, app, args, findings| check(&checked, (task, app), args, findings));
}

fn check(
    drivers: &DriverRegistry,
    (task, app): (&TaskConfig, &App),
    args: &Node,
    findings: &mut Findings,
) {
    let at = |key: &str| {
        let place = args.locate(key).or_else(|| args.place().cloned());
        place.unwrap_or_else(|| task.place.clone())
    };
    let Some(parsed) = findings.keep(args.parse::<DrivesArgs>()) else {
        return;
    };
    if !(0.1..=50.0).contains(&parsed.bandwidth_hz) {
        let text = format!("`bandwidth_hz` is {}", parsed.bandwidth_hz);
        let finding = Finding::error("mcs::out_of_range", text).at(at("bandwidth_hz"));
        findings.push(finding.help("give a value from 0.1 to 50"));
    }
    let Some(inner) = NamedDriver::of(args) else {
        return;
    };
    let slots = match drivers.find(&inner.name, &task.name) {
        Ok(kind) => {
            kind.run_check(task, app, &inner.args, findings);
            kind.count_slots(app, &inner.args)
        }
        Err(finding) => return findings.push(finding.at(at("driver"))),
    };
    if let Some(slots) = slots
        && Mode::for_slots(&parsed.modes, slots).is_none()
    {
        let text = format!(
            "`modes` has {} entries for {slots} slots",
            parsed.modes.len()
        );
        let finding = Finding::error("mcs::driver::modes", text).at(at("modes"));
        findings.push(finding.help("give one for all slots, or one for each: modes = [\"csp\"]"));
    }
}

fn open(
    drivers: &DriverRegistry,
    cx: &Context,
    args: &Node,
) -> Result<Box<dyn ChannelDriver>, HandlerError> {
    let parsed: DrivesArgs = args.parse()?;
    let task = cx
        .config()
        .ok_or("a channel driver needs a task of the configuration")?;
    let model = crate::args::arm(task, cx.app()).ok_or("the arm of the servo cannot be read")?;
    let inner = NamedDriver::of(args).ok_or("`driver` is missing")?;
    let inner = drivers
        .find(&inner.name, cx.name())?
        .build(cx, &inner.args)?;
    let drives = Drives::new(inner, &parsed.modes, Arc::new(model), parsed.bandwidth_hz)?;
    Ok(Box::new(drives))
}

/// A driver of torques behind the loops of drives.
pub struct Drives {
    inner: Box<dyn ChannelDriver>,
    modes: Vec<Mode>,
    law: PidGravity,
    readings: Vec<SlotReading>,
    setpoint: Setpoint,
    /// Where each slot is to be in the next period, rad or m, and how fast.
    next: Joints,
    speeds: Joints,
    torques: Vec<f64>,
}

impl Drives {
    /// Drives whose slots are commanded by `modes` (one for all, or one for each), of an arm whose joints are the slots.
    ///
    /// # Errors
    /// A text about a count that does not fit.
    pub fn new(
        inner: Box<dyn ChannelDriver>,
        modes: &[Mode],
        model: Arc<Model>,
        bandwidth_hz: f64,
    ) -> Result<Self, String> {
        let (slots, joints) = (inner.slots(), model.dof());
        if slots != joints {
            return Err(format!(
                "the driver behind `{DRIVES}` has {slots} slots, the arm {joints} joints"
            ));
        }
        let given = modes.len();
        let modes = Mode::for_slots(modes, slots);
        let modes =
            modes.ok_or_else(|| format!("`modes` has {given} entries for {slots} slots"))?;
        Ok(Self {
            modes,
            law: PidGravity::new(model, bandwidth_hz, 1.0),
            readings: vec![SlotReading::default(); slots],
            setpoint: Setpoint::at_rest(Joints::zeros(slots)),
            next: Joints::zeros(slots),
            speeds: Joints::zeros(slots),
            torques: vec![0.0; slots],
            inner,
        })
    }

    /// Stands where it is read to be.
    fn stand(&mut self) {
        for (position, reading) in self.next.iter_mut().zip(&self.readings) {
            *position = reading.position;
        }
        self.speeds.fill(0.0);
        self.setpoint = Setpoint::at_rest(self.next);
        self.law.reset(&self.readings);
    }

    /// What the loops are to follow within the coming `period` (s).
    fn follow(&mut self, commands: &[f64], period: f64) {
        for (slot, (command, mode)) in commands.iter().zip(&self.modes).enumerate() {
            let (from, before) = (self.next[slot], self.speeds[slot]);
            let (then, speed, now) = match mode {
                Mode::Position => (
                    *command,
                    (command - from) / period,
                    (command - from) / period,
                ),
                Mode::Velocity => (from + 0.5 * (before + command) * period, *command, before),
                Mode::Torque => (self.readings[slot].position, 0.0, 0.0),
            };
            self.setpoint.position[slot] = from;
            self.setpoint.velocity[slot] = now;
            self.setpoint.acceleration[slot] = (speed - before) / period;
            (self.next[slot], self.speeds[slot]) = (then, speed);
        }
    }
}

impl ChannelDriver for Drives {
    fn slots(&self) -> usize {
        self.readings.len()
    }

    fn modes(&self) -> &[Mode] {
        &self.modes
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        let read = self.inner.read(readings);
        for (own, reading) in self.readings.iter_mut().zip(readings) {
            *own = *reading;
        }
        read
    }

    fn silence(&self, slot: usize) -> Option<(Duration, DriverError)> {
        self.inner.silence(slot)
    }

    fn sensors(&self) -> &[Sensor] {
        self.inner.sensors()
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        self.inner.sense(numbers)
    }

    fn ages(&mut self, ages: &mut [f64]) {
        self.inner.ages(ages);
    }

    fn actuate(&mut self, numbers: &[f64]) -> Result<(), DriverError> {
        self.inner.actuate(numbers)
    }

    fn write(
        &mut self,
        commands: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        if power != Power::Released {
            self.stand();
            self.torques.fill(0.0);
            return self.inner.write(&self.torques, power, period);
        }
        self.follow(commands, period.as_secs_f64());
        self.law
            .torques(&self.setpoint, &self.readings, period, &mut self.torques);
        let pairs = self
            .torques
            .iter_mut()
            .zip(commands.iter().zip(&self.modes));
        for (torque, (command, mode)) in pairs {
            if *mode == Mode::Torque {
                *torque = *command;
            }
        }
        self.inner.write(&self.torques, power, period)
    }
}
