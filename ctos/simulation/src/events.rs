//! The event log of a simulated app: a line for every delivery and for everything that goes wrong.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, Weak},
};

use ctos_core::{chassis::Chassis, envelope::Message, task_record::TaskRecord};
use ctos_message::{ChassisNumber, Tid};
use ctos_time::{Clock, Instant, lock::lock};

/// Takes the lines of an event log, without their ends.
pub type EventSink = Arc<dyn Fn(&str) + Send + Sync>;

/// Writes the lines, each with the true time in front.
#[derive(Clone)]
pub(crate) struct EventLog {
    sink: Option<EventSink>,
    clock: Clock,
    /// The chassis that are watched: weak, because each owns what tells of it.
    all: Arc<Mutex<BTreeMap<ChassisNumber, Weak<Chassis>>>>,
}

impl EventLog {
    pub(crate) fn new(sink: Option<EventSink>, clock: Clock) -> Self {
        let all = Arc::default();
        Self { sink, clock, all }
    }

    /// Writes a line, if anybody reads it.
    pub(crate) fn note(&self, text: impl FnOnce() -> String) {
        if let Some(sink) = &self.sink {
            sink(&format!("{} {}", stamp(self.clock.now()), text()));
        }
    }

    /// Lets `chassis` tell of every message that one of its tasks begins to handle.
    pub(crate) fn watch(&self, chassis: &Arc<Chassis>) {
        if self.sink.is_none() {
            return;
        }
        lock(&self.all).insert(chassis.index(), Arc::downgrade(chassis));
        let (log, home) = (self.clone(), chassis.name().to_owned());
        chassis.on_delivery(Box::new(move |task: &TaskRecord, message: &Message| {
            log.note(|| {
                let header = message.header();
                format!(
                    "deliver {home}/{} from {} command={:#06x} flags={:#06x} trace={:#x}",
                    task.name,
                    log.name_of(header.from),
                    header.command,
                    header.flags.bits(),
                    message.trace()
                )
            });
        }));
    }

    fn name_of(&self, tid: Tid) -> String {
        let chassis = lock(&self.all).get(&tid.chassis()).and_then(Weak::upgrade);
        let named = chassis.and_then(|one| Some(format!("{}/{}", one.name(), one.task_name(tid)?)));
        named.unwrap_or_else(|| tid.to_string())
    }
}

/// `0.001234567`
fn stamp(moment: Instant) -> String {
    let time = moment.since_start();
    format!("{}.{:09}", time.as_secs(), time.subsec_nanos())
}
