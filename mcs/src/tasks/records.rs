//! State records: what each servo tick left, as a record of a snapshot buffer (SORMA report, sections 1.7.2 and 2.1.3).
//!
//! The servo's task makes the buffer and frees it; the tick only writes, which takes no lock and allocates nothing.

use std::fmt::Write as _;
use std::sync::Arc;

use crossbeam_queue::ArrayQueue;
use ctos::time::Clock;
use sorma::snapshot::{Layout, Place, SnapshotError, Writer};

use crate::driver::{Sensor, SensorKind};
use crate::model::Model;
use crate::servo::ServoStatus;

/// How many records a buffer keeps: 9 s at 4.5 ms.
const SLOTS: usize = 2000;
/// The vectors of a record; each has a number for every joint. What the slots that are no joints read comes after them.
const VECTORS: [&str; 4] = ["position", "velocity", "setpoint", "torque"];

/// The task's side: which buffer is written.
pub struct Records {
    /// The buffer's name.
    buffer: Option<String>,
    orders: Arc<ArrayQueue<Option<Writer>>>,
    retired: Arc<ArrayQueue<Writer>>,
    /// The slots that are no joints.
    sensors: Vec<Sensor>,
}

/// The tick's side.
pub struct Recorder {
    orders: Arc<ArrayQueue<Option<Writer>>>,
    retired: Arc<ArrayQueue<Writer>>,
    writer: Option<Writer>,
    floats: Vec<f64>,
}

/// How many numbers the slots that are no joints have.
fn width(sensors: &[Sensor]) -> usize {
    sensors.iter().map(|sensor| sensor.kind.width()).sum()
}

/// Both sides, for an arm of so many joints, with these slots besides.
pub fn records(joints: usize, sensors: &[Sensor]) -> (Records, Recorder) {
    let (orders, retired) = (Arc::new(ArrayQueue::new(1)), Arc::new(ArrayQueue::new(2)));
    let recorder = Recorder {
        orders: Arc::clone(&orders),
        retired: Arc::clone(&retired),
        writer: None,
        floats: Vec::with_capacity(VECTORS.len() * joints + width(sensors)),
    };
    let records = Records {
        buffer: None,
        orders,
        retired,
        sensors: sensors.to_vec(),
    };
    (records, recorder)
}

/// What the floats of a record are, a line for each.
fn description(model: &Model, sensors: &[Sensor]) -> String {
    let mut text = String::new();
    for vector in VECTORS {
        for joint in model.joints() {
            let unit = joint.kind.unit();
            let unit = match vector {
                "velocity" => format!("{unit}/s"),
                "torque" => joint.kind.effort_unit().to_owned(),
                _ => unit.to_owned(),
            };
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{vector}.{} {unit}", joint.name);
        }
    }
    for Sensor { name, kind } in sensors {
        for number in 1..=kind.width() {
            let unit = match (kind, number) {
                (SensorKind::ForceTorque, ..=3) => "N",
                (SensorKind::ForceTorque, _) => "N m",
                _ => kind.unit(),
            };
            let _ = writeln!(text, "slot.{name}.{number} {unit}");
        }
    }
    text
}

impl Records {
    /// From the next tick on every tick writes a record to the buffer `name` of the app, instead of to the one before; to
    /// none, without a name.
    ///
    /// # Errors
    /// Another process writes it, the name cannot be, or the system refuses; the buffer before is written on.
    pub fn write_to(
        &mut self,
        (app, name): (&str, Option<&str>),
        model: &Model,
        clock: &Clock,
    ) -> Result<(), SnapshotError> {
        if self.buffer.as_deref() == name {
            return Ok(());
        }
        let writer = match name {
            Some(name) => {
                let place = Place::of_app(app)?;
                let floats = VECTORS.len() * model.dof() + width(&self.sensors);
                let layout = Layout::new(SLOTS, floats);
                let layout = layout.described(description(model, &self.sensors));
                Some(Writer::create(&place, name, layout, clock)?)
            }
            None => None,
        };
        self.orders.force_push(writer);
        self.buffer = name.map(str::to_owned);
        Ok(())
    }

    /// Frees the buffer that the tick has done with.
    pub fn free(&self) {
        while self.retired.pop().is_some() {}
    }
}

impl Recorder {
    /// Writes a record of what a tick left, where one is wanted.
    pub fn write(&mut self, status: &ServoStatus) {
        if let Some(writer) = self.orders.pop() {
            let before = std::mem::replace(&mut self.writer, writer);
            // The task frees it; were its queue full, it would be freed here, late.
            let _ = before.map(|before| self.retired.push(before));
        }
        let Some(writer) = &mut self.writer else {
            return;
        };
        self.floats.clear();
        for vector in [
            &status.position,
            &status.velocity,
            &status.setpoint,
            &status.torque,
            &status.sensors,
        ] {
            self.floats.extend_from_slice(vector);
        }
        // The layout was made for this arm, so the count fits.
        let _ = writer.write(&self.floats, &[]);
    }
}
