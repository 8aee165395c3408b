//! The log's way into the record: a layer of `tracing-subscriber` that the program adds to its
//! subscriber, and to which the recorder attaches itself when it begins.

use std::{
    fmt,
    sync::{Arc, Mutex},
};

use serde_json::{Map, Value, json};
use tracing::{
    Event, Level, Subscriber,
    field::{Field, Visit},
};
use tracing_subscriber::layer::{Context, Layer};

use super::{lines::Schema, recorder::Recorder};
use ctos_message::Tid;
use ctos_time::lock::lock;

#[derive(Clone)]
struct Attached {
    recorder: Arc<Recorder>,
    chassis: u8,
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
pub(crate) fn attach(recorder: &Arc<Recorder>, chassis: u8) {
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
    let mut line = Line::default();
    event.record(&mut line);
    let at = recorder.now();
    let file = event.metadata().target();
    let name = line.task.as_deref();
    let topic = format!("/log/{}", name.unwrap_or("ctos"));
    let json = json!({
        "timestamp": { "sec": at / 1_000_000_000, "nsec": at % 1_000_000_000 },
        "level": level_of(*event.metadata().level()),
        "message": line.message,
        "name": name.unwrap_or(file),
        "file": file,
        "line": 0,
        "fields": line.fields,
    });
    // On the runtime's own processor: which one this thread belongs to is not known here.
    recorder.line(Tid::new(*chassis, 0, 0), at, topic, Schema::Log, |buffer| {
        serde_json::to_writer(buffer, &json).is_ok()
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

/// The fields of one event.
#[derive(Default)]
struct Line {
    message: String,
    task: Option<String>,
    fields: Map<String, Value>,
}

impl Line {
    fn put(&mut self, field: &Field, value: Value) {
        match (field.name(), value) {
            ("message", Value::String(text)) => self.message = text,
            ("task", Value::String(task)) => self.task = Some(task),
            (name, value) => {
                self.fields.insert(name.to_owned(), value);
            }
        }
    }
}

impl Visit for Line {
    fn record_f64(&mut self, field: &Field, value: f64) {
        self.put(field, value.into());
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.put(field, value.into());
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.put(field, value.into());
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.put(field, value.into());
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.put(field, value.into());
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.put(field, format!("{value:?}").into());
    }
}
