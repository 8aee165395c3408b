//! Several channel drivers as one, so that a manipulator may have joints behind several of them.

use std::ops::Range;
use std::time::Duration;

use ctos::config::{App, Node, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use ctos::task::{Context, HandlerError};
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::{ChannelDriver, DRIVES, DriverError, DriverRegistry, Mode, Power, Sensor, SlotReading};

/// Name of the driver that is made of others.
pub const TESTBED: &str = "mcs.testbed";

/// Arguments of the driver.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TestbedArgs {
    /// The drivers, in the order of their slots.
    parts: Vec<Part>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Part {
    #[serde(rename = "driver")]
    _driver: String,
    #[serde(default, rename = "driver_args")]
    _driver_args: Option<IgnoredAny>,
}

/// A driver that a servo uses, by name, with its own arguments (an empty table when there are none).
#[derive(Debug, Clone)]
pub struct NamedDriver {
    /// Its registered name.
    pub name: String,
    /// Its arguments.
    pub args: Node,
}

impl NamedDriver {
    /// The driver that the arguments of a servo, or of a part of [`TESTBED`], name.
    #[must_use]
    pub fn of(args: &Node) -> Option<Self> {
        Some(Self {
            name: args.get("driver")?.as_str()?.to_owned(),
            args: args.get("driver_args").cloned().unwrap_or_else(Node::table),
        })
    }

    /// The drivers behind that of a servo with these arguments: those that [`TESTBED`] and [`DRIVES`] are made of, in the
    /// order of their slots, or the one driver.
    #[must_use]
    pub fn all_of(args: &Node) -> Vec<Self> {
        match Self::of(args) {
            Some(testbed) if testbed.name == TESTBED => {
                let parts = testbed.args.get("parts").map_or(&[][..], Node::elements);
                parts.iter().flat_map(Self::all_of).collect()
            }
            Some(drives) if drives.name == DRIVES => Self::all_of(&drives.args),
            one => one.into_iter().collect(),
        }
    }
}

fn parts(args: &Node) -> Vec<NamedDriver> {
    let parts = args.get("parts").map_or(&[][..], Node::elements);
    parts.iter().filter_map(NamedDriver::of).collect()
}

/// Adds [`TESTBED`], made of any drivers that are registered by now.
pub(super) fn register(drivers: &mut DriverRegistry) {
    let known = drivers.clone();
    let (counted, checked) = (known.clone(), known.clone());
    let kind = drivers.driver(TESTBED, move |cx, args| open(&known, cx, args));
    kind.slots(move |app, args| {
        let counts = parts(args).into_iter().map(|part| {
            let kind = counted.kind(&part.name)?;
            kind.count_slots(app, &part.args)
        });
        counts.sum()
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
    let Some(parsed) = findings.keep(args.parse::<TestbedArgs>()) else {
        return;
    };
    if parsed.parts.is_empty() {
        let text = format!("the driver of task `{}` is made of no drivers", task.name);
        let finding = Finding::error("mcs::testbed::empty", text).at(at("parts"));
        findings.push(finding.help("name at least one: parts = [{ driver = \"sim.arm\" }]"));
    }
    for (index, part) in parts(args).iter().enumerate() {
        match drivers.find(&part.name, &task.name) {
            Ok(kind) => kind.run_check(task, app, &part.args, findings),
            Err(finding) => findings.push(finding.at(at(&format!("parts.{index}.driver")))),
        }
    }
}

fn open(
    drivers: &DriverRegistry,
    cx: &Context,
    args: &Node,
) -> Result<Box<dyn ChannelDriver>, HandlerError> {
    let _: TestbedArgs = args.parse()?;
    let opened = parts(args).into_iter().map(|part| {
        let kind = drivers.find(&part.name, cx.name())?;
        kind.build(cx, &part.args)
    });
    Ok(Box::new(Testbed::new(opened.collect::<Result<_, _>>()?)))
}

/// One of several drivers: its slots among those of all, and the numbers of its sensors among those of all.
struct Own {
    driver: Box<dyn ChannelDriver>,
    slots: Range<usize>,
    sensed: Range<usize>,
}

/// Several drivers, with the sensors and modes of all.
struct Testbed {
    parts: Vec<Own>,
    sensors: Vec<Sensor>,
    modes: Vec<Mode>,
}

impl Testbed {
    fn new(drivers: Vec<Box<dyn ChannelDriver>>) -> Self {
        let (mut slots, mut sensed) = (0..0, 0..0);
        let (mut sensors, mut modes) = (Vec::new(), Vec::new());
        let parts = drivers.into_iter().map(|driver| {
            let width: usize = driver
                .sensors()
                .iter()
                .map(|sensor| sensor.kind.width())
                .sum();
            slots = slots.end..slots.end + driver.slots();
            sensed = sensed.end..sensed.end + width;
            sensors.extend_from_slice(driver.sensors());
            modes.extend_from_slice(driver.modes());
            modes.resize(slots.end, Mode::Torque);
            Own {
                driver,
                slots: slots.clone(),
                sensed: sensed.clone(),
            }
        });
        Self {
            parts: parts.collect(),
            sensors,
            modes,
        }
    }

    fn count(&self, what: &str, given: usize) -> Result<(), DriverError> {
        if given == self.slots() {
            return Ok(());
        }
        let slots = self.slots();
        Err(DriverError::Fault {
            driver: TESTBED.to_owned(),
            reason: format!("was given {given} {what} for {slots} slots"),
        })
    }
}

impl ChannelDriver for Testbed {
    fn slots(&self) -> usize {
        self.parts.last().map_or(0, |own| own.slots.end)
    }

    /// Reads all of them, whatever becomes of one; the first error counts.
    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        self.count("readings", readings.len())?;
        let read = |own: &mut Own| own.driver.read(&mut readings[own.slots.clone()]);
        self.parts.iter_mut().map(read).fold(Ok(()), Result::and)
    }

    fn silence(&self, slot: usize) -> Option<(Duration, DriverError)> {
        let own = self.parts.iter().find(|own| own.slots.contains(&slot))?;
        own.driver.silence(slot - own.slots.start)
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn modes(&self) -> &[Mode] {
        &self.modes
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        let sense = |own: &mut Own| match numbers.get_mut(own.sensed.clone()) {
            Some(numbers) => own.driver.sense(numbers),
            None => Ok(()),
        };
        self.parts.iter_mut().map(sense).fold(Ok(()), Result::and)
    }

    fn ages(&mut self, ages: &mut [f64]) {
        let mut rest = ages;
        for own in &mut self.parts {
            let count = own.driver.sensors().len();
            let Some((those, others)) = rest.split_at_mut_checked(count) else {
                return;
            };
            own.driver.ages(those);
            rest = others;
        }
    }

    fn actuate(&mut self, numbers: &[f64]) -> Result<(), DriverError> {
        let actuate = |own: &mut Own| match numbers.get(own.sensed.clone()) {
            Some(numbers) => own.driver.actuate(numbers),
            None => Ok(()),
        };
        self.parts.iter_mut().map(actuate).fold(Ok(()), Result::and)
    }

    /// Writes to all of them, so that the others brake when one fails; the first error counts.
    fn write(
        &mut self,
        commands: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        self.count("commands", commands.len())?;
        let write = |own: &mut Own| {
            own.driver
                .write(&commands[own.slots.clone()], power, period)
        };
        self.parts.iter_mut().map(write).fold(Ok(()), Result::and)
    }
}

#[cfg(test)]
mod tests;
