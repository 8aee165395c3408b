//! Slots that are no joints, named in the configuration: inputs that other programs write to snapshot buffers of the app (a
//! space mouse, a switch), and outputs that they read from there (a lamp, a laser pointer).
//!
//! The tick looks at the buffers itself, without waiting. A buffer whose writer is not there yet is looked for beside it.

use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use crossbeam_queue::ArrayQueue;
use ctos::config::{App, Node, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use ctos::task::{Context, HandlerError};
use ctos::time::Clock;
use serde::Deserialize;
use sorma_snapshot::{Layout, Place, Reader, Snapshot, Writer};

use super::{ChannelDriver, DriverError, DriverRegistry, Power, Sensor, SensorKind, SlotReading};

/// Name of the driver.
pub const NAMED_SLOTS: &str = "mcs.slots";

/// Records that the buffer of an output keeps.
const KEPT: usize = 16;
/// How often a buffer that is not there, or that has another writer now, is looked for.
const LOOK: Duration = Duration::from_millis(200);

/// Arguments of the driver.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SlotsArgs {
    slots: Vec<SlotArgs>,
}

#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct SlotArgs {
    name: String,
    kind: SensorKind,
    /// The buffer that has its numbers; that of its name, where none is named.
    buffer: Option<String>,
}

impl SlotArgs {
    fn buffer(&self) -> &str {
        self.buffer.as_deref().unwrap_or(&self.name)
    }
}

/// Adds [`NAMED_SLOTS`].
pub(super) fn register(drivers: &mut DriverRegistry) {
    let kind = drivers.driver(NAMED_SLOTS, open);
    kind.slots(|_, _| Some(0)).check(check);
}

fn check(task: &TaskConfig, _: &App, args: &Node, findings: &mut Findings) {
    let Some(parsed) = findings.keep(args.parse::<SlotsArgs>()) else {
        return;
    };
    for (index, slot) in parsed.slots.iter().enumerate() {
        let before = parsed.slots.get(..index).unwrap_or_default();
        if before.iter().any(|other| other.name == slot.name) {
            let place = args.locate(&format!("slots.{index}.name"));
            let text = format!(
                "two slots of task `{}` are called `{}`",
                task.name, slot.name
            );
            let finding = Finding::error("mcs::driver::slot_twice", text);
            let finding = finding.at(place.unwrap_or_else(|| task.place.clone()));
            findings.push(finding.help("give each a name of its own"));
        }
    }
}

fn open(cx: &Context, args: &Node) -> Result<Box<dyn ChannelDriver>, HandlerError> {
    let SlotsArgs { slots } = args.parse()?;
    let place = Rc::new(Place::of_app(&cx.app().name)?);
    let clock = cx.chassis().clock().clone();
    let mut opened = Vec::new();
    for slot in &slots {
        let width = slot.kind.width();
        opened.push(match slot.kind.is_output() {
            true => {
                let layout = Layout::new(KEPT, width).described(slot.name.clone());
                End::Output(Writer::create(&place, slot.buffer(), layout, &clock)?)
            }
            false => {
                let ways = Arc::new(Ways {
                    found: ArrayQueue::new(1),
                    done: ArrayQueue::new(2),
                });
                cx.spawn(look(
                    cx.clone(),
                    Rc::clone(&place),
                    slot.clone(),
                    Arc::clone(&ways),
                ));
                End::Input(Input {
                    ways,
                    reader: None,
                    record: Snapshot {
                        floats: vec![0.0; width],
                        ..Snapshot::default()
                    },
                })
            }
        });
    }
    let sensors = slots.into_iter().map(|slot| Sensor {
        name: slot.name,
        kind: slot.kind,
    });
    Ok(Box::new(NamedSlots {
        sensors: sensors.collect(),
        ends: opened,
        clock,
    }))
}

/// Readers on their way to the tick, and those that it has done with: it frees none.
struct Ways {
    found: ArrayQueue<Reader>,
    done: ArrayQueue<Reader>,
}

/// Hands the tick a reader of the buffer that is there now, as often as that is another one.
async fn look(cx: Context, place: Rc<Place>, slot: SlotArgs, ways: Arc<Ways>) {
    let mut known: Option<Reader> = None;
    let open = || Reader::open_as(&place, slot.buffer(), slot.kind.width(), 0);
    loop {
        while ways.done.pop().is_some() {}
        let over = known.as_ref().is_none_or(Reader::is_over);
        if over && let (Ok(own), Ok(reader)) = (open(), open()) {
            ways.found.force_push(reader);
            known = Some(own);
        }
        cx.sleep(LOOK).await;
    }
}

struct Input {
    ways: Arc<Ways>,
    reader: Option<Reader>,
    record: Snapshot,
}

impl Input {
    fn read(&mut self, numbers: &mut [f64]) {
        if !self.ways.done.is_full()
            && let Some(found) = self.ways.found.pop()
            && let Some(before) = self.reader.replace(found)
        {
            // There is room: it was looked at.
            let _ = self.ways.done.push(before);
        }
        if let Some(reader) = &mut self.reader {
            // A record that its writer overtakes again and again stays the one before.
            let _ = reader.latest(&mut self.record);
        }
        // What is no number, the servo would take for a fault of the driver: it is stale and no more.
        let sound = self.record.floats.iter().all(|number| number.is_finite());
        if sound {
            numbers.copy_from_slice(&self.record.floats);
        } else {
            self.record.count = 0;
        }
    }

    fn age(&self, clock: &Clock) -> f64 {
        match self.record.count {
            0 => f64::INFINITY,
            _ => self.record.age(clock).as_secs_f64(),
        }
    }
}

enum End {
    Input(Input),
    Output(Writer),
}

/// Slots behind snapshot buffers.
struct NamedSlots {
    sensors: Vec<Sensor>,
    ends: Vec<End>,
    clock: Clock,
}

impl ChannelDriver for NamedSlots {
    fn slots(&self) -> usize {
        0
    }

    fn read(&mut self, _readings: &mut [SlotReading]) -> Result<(), DriverError> {
        Ok(())
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn sense(&mut self, numbers: &mut [f64]) -> Result<(), DriverError> {
        let mut rest = numbers;
        for (sensor, end) in self.sensors.iter().zip(&mut self.ends) {
            let Some((own, others)) = rest.split_at_mut_checked(sensor.kind.width()) else {
                return Ok(());
            };
            if let End::Input(input) = end {
                input.read(own);
            }
            rest = others;
        }
        Ok(())
    }

    fn ages(&mut self, ages: &mut [f64]) {
        for (age, end) in ages.iter_mut().zip(&self.ends) {
            *age = match end {
                End::Input(input) => input.age(&self.clock),
                End::Output(_) => 0.0,
            };
        }
    }

    fn actuate(&mut self, numbers: &[f64]) -> Result<(), DriverError> {
        let mut rest = numbers;
        for (sensor, end) in self.sensors.iter().zip(&mut self.ends) {
            let Some((own, others)) = rest.split_at_checked(sensor.kind.width()) else {
                return Ok(());
            };
            if let End::Output(writer) = end {
                // The layout was made for it, so the count fits.
                let _ = writer.write(own, &[]);
            }
            rest = others;
        }
        Ok(())
    }

    fn write(&mut self, _: &[f64], _: Power, _: Duration) -> Result<(), DriverError> {
        Ok(())
    }
}
