//! The log's way into the record: a layer of `tracing-subscriber` that the program adds to its
//! subscriber. The recorder attaches itself to it when it begins.

use std::sync::{Arc, Mutex};

use serde_json::{Map, Value, json};
use tracing::{Event, Level, Subscriber};
use tracing_serde::fields::AsMap;
use tracing_subscriber::layer::{Context, Layer};

use super::{lines::Schema, recorder::Recorder};
use ctos_message::{ChassisNumber, Tid};
use ctos_time::lock::lock;

#[derive(Clone)]
struct Attached {
    recorder: Arc<Recorder>,
    chassis: ChassisNumber,
}

/// Puts log lines into the records of this process, while there are any. Filter it like any other layer.
#[derive(Default)]
pub struct RecordLayer {
    attached: Mutex<Vec<Attached>>,
}

impl RecordLayer {
    /// A layer that nothing is attached to yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }
}

/// Lets the log of this thread's subscriber go to `recorder` too, if it has a [`RecordLayer`], until it is
/// detached.
pub(crate) fn attach(recorder: &Arc<Recorder>, chassis: ChassisNumber) {
    change(|attached| {
        let recorder = recorder.clone();
        attached.push(Attached { recorder, chassis });
    });
}

/// Ends what [`attach`] began.
pub(crate) fn detach(recorder: &Arc<Recorder>) {
    change(|attached| attached.retain(|one| !Arc::ptr_eq(&one.recorder, recorder)));
}

fn change(mut change: impl FnMut(&mut Vec<Attached>)) {
    tracing::dispatcher::get_default(|dispatch| {
        if let Some(layer) = dispatch.downcast_ref::<RecordLayer>() {
            change(&mut lock(&layer.attached));
        }
    });
}

impl<S: Subscriber> Layer<S> for RecordLayer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        // Not under the lock: a recorder may have something to log itself.
        let attached = lock(&self.attached).clone();
        for one in &attached {
            note(one, event);
        }
    }
}

/// Puts a line into one record.
fn note(Attached { recorder, chassis }: &Attached, event: &Event<'_>) {
    let mut fields = match serde_json::to_value(event.field_map()) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    };
    let message = take_text(&mut fields, "message").unwrap_or_default();
    let task = take_text(&mut fields, "task");
    let at = recorder.now();
    let file = event.metadata().target();
    let name = task.as_deref();
    let topic = format!("/log/{}", name.unwrap_or("ctos"));
    let json = json!({
        "timestamp": { "sec": at / 1_000_000_000, "nsec": at % 1_000_000_000 },
        "level": level_of(*event.metadata().level()),
        "message": message,
        "name": name.unwrap_or(file),
        "file": file,
        "line": 0,
        "fields": fields,
    });
    // On the runtime's own processor: which one this thread belongs to is not known here.
    recorder.note(Tid::new(*chassis, 0, 0), |batch| {
        batch.json(at, topic, Schema::Log, &json)
    });
}

/// The numbers that viewers expect.
fn level_of(level: Level) -> u8 {
    match level {
        Level::ERROR => 4,
        Level::WARN => 3,
        Level::INFO => 2,
        _ => 1,
    }
}

/// Takes out a field that is a text.
fn take_text(fields: &mut Map<String, Value>, name: &str) -> Option<String> {
    let text = fields.get(name)?.as_str()?.to_owned();
    fields.remove(name);
    Some(text)
}
