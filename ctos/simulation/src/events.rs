//! The event log of a simulated app: a line for every delivery and for everything that goes wrong.

use std::{
    fmt::Write as _,
    sync::{Arc, Weak},
};

use ctos_core::{chassis::Chassis, envelope::Message, task_record::TaskRecord};
use ctos_message::Tid;
use ctos_time::{Clock, Instant};

/// Takes the lines of an event log, without their ends.
pub type EventSink = Arc<dyn Fn(&str) + Send + Sync>;

/// Writes the lines, each with the true time in front.
#[derive(Clone)]
pub(crate) struct EventLog {
    sink: Option<EventSink>,
    clock: Clock,
}

impl EventLog {
    pub(crate) fn new(sink: Option<EventSink>, clock: Clock) -> Self {
        Self { sink, clock }
    }

    /// Writes a line, if anybody reads it.
    pub(crate) fn note(&self, text: impl FnOnce() -> String) {
        if let Some(sink) = &self.sink {
            sink(&format!("{} {}", stamp(self.clock.now()), text()));
        }
    }

    /// Lets `chassis` tell of every message that one of its tasks begins to handle.
    pub(crate) fn watch(&self, chassis: &Arc<Chassis>, all: &[Arc<Chassis>]) {
        if self.sink.is_none() {
            return;
        }
        // Weak, because the chassis owns what is made here.
        let all: Vec<Weak<Chassis>> = all.iter().map(Arc::downgrade).collect();
        let (log, home) = (self.clone(), Arc::downgrade(chassis));
        chassis.on_delivery(Box::new(move |task: &TaskRecord, message: &Message| {
            log.note(|| {
                let header = message.header();
                let mut line = String::from("deliver ");
                let home = home.upgrade();
                let home = home.as_ref().map_or("?", |chassis| chassis.name());
                // Writing to a string does not fail.
                let _ = write!(line, "{home}/{} from ", task.name);
                write_task(&mut line, &all, header.from);
                let _ = write!(
                    line,
                    " command={:#06x} flags={:#06x} trace={:#x}",
                    header.command,
                    header.flags.bits(),
                    message.trace()
                );
                line
            });
        }));
    }
}

fn write_task(line: &mut String, all: &[Weak<Chassis>], tid: Tid) {
    let chassis = all.get(usize::from(tid.chassis())).and_then(Weak::upgrade);
    let name = chassis.as_ref().and_then(|chassis| chassis.task_name(tid));
    let _ = match (chassis, name) {
        (Some(chassis), Some(name)) => write!(line, "{}/{name}", chassis.name()),
        _ => write!(line, "{tid}"),
    };
}

/// `0.001234567`
fn stamp(moment: Instant) -> String {
    let time = moment.since_start();
    format!("{}.{:09}", time.as_secs(), time.subsec_nanos())
}
