//! Streams of setpoints and torques: where their values come from, and how they are begun (SORMA report, 2.1.3 and 1.7.2).
//!
//! Values come by a snapshot buffer of the app, which the tick reads itself, or by messages to the servo's task.

use std::sync::Arc;

use ctos::task::{Context, HandlerError};
use ctos::time::Clock;
use sorma::snapshot::{Place, Reader, Snapshot};

use super::Link;
use crate::client::{MotionError, Outcome, StreamReport, StreamSetpoints, StreamValue};
use crate::joints::MAX_SLOTS;
use crate::latest::Latest;
use crate::model::Model;
use crate::servo::{Following, Newest, ServoStatus, Source, Stream, StreamKind};

/// A value is a stamp, s, how many numbers it has, and these; no stream needs more.
const HEAD: usize = 2;
const MOST: usize = 2 * MAX_SLOTS + 2;

/// The newest record of a snapshot buffer.
struct Buffer {
    reader: Reader,
    record: Snapshot,
    clock: Clock,
}

impl Source for Buffer {
    fn newest(&mut self) -> Option<Newest<'_>> {
        // A record that the writer overtakes again and again is no newer one.
        let _ = self.reader.latest(&mut self.record);
        let record = &self.record;
        (record.count > 0).then(|| Newest {
            count: record.count,
            stamp: record.stamp_ns as f64 * 1e-9,
            age: record.age(&self.clock).as_secs_f64(),
            numbers: &record.floats,
        })
    }
}

/// The value that came by the last message.
struct Messages {
    latest: Arc<Latest>,
    row: [f64; HEAD + MOST],
    clock: Clock,
}

impl Source for Messages {
    fn newest(&mut self) -> Option<Newest<'_>> {
        let count = self.latest.read(&mut self.row);
        let [stamp, given, numbers @ ..] = &self.row;
        let numbers = numbers.get(..*given as usize)?;
        (count > 0).then(|| Newest {
            count,
            stamp: *stamp,
            age: self.clock.now().since_start().as_secs_f64() - stamp,
            numbers,
        })
    }
}

/// The servo task's side.
#[derive(Default)]
pub struct Streams {
    /// How many were begun.
    serial: u64,
    kind: Option<StreamKind>,
    /// The buffer that is followed, or nothing where values come by messages.
    buffer: Option<String>,
    messages: Option<Arc<Latest>>,
}

fn refused(reason: impl ToString) -> MotionError {
    MotionError::new(Outcome::Refused, reason)
}

impl Streams {
    /// Has the servo follow what is asked for; answers once it does.
    pub async fn begin(
        &mut self,
        cx: &Context,
        (link, model): (&Link, &Model),
        request: StreamSetpoints,
    ) -> Result<StreamReport, MotionError> {
        let fraction = |what: &str, value: f64| match value > 0.0 && value <= 1.0 {
            true => Ok(value),
            false => Err(refused(format!(
                "`{what}` is above 0 and at most 1, not {value}"
            ))),
        };
        let speed = fraction("speed", request.speed)?;
        let acceleration = request.acceleration.unwrap_or(speed);
        let pace = (speed, fraction("acceleration", acceleration)?);
        let (age, least) = (request.max_age_s, link.config.period.as_secs_f64());
        if !(least..=60.0).contains(&age) {
            let text = format!("the limit of a value's age is {least} s to 60 s, not {age}");
            return Err(refused(text));
        }
        let guards = link.guards.named(&request.guards)?;
        let clock = cx.chassis().clock().clone();
        let mut messages = None;
        let source: Box<dyn Source> = match &request.buffer {
            Some(name) => {
                let place = Place::of_app(&cx.app().name).map_err(refused)?;
                let reader = Reader::open(&place, name).map_err(refused)?;
                let floats = reader.layout().floats;
                let fit = fitting(request.kind, model.dof());
                if !fit.contains(&floats) {
                    let fit: Vec<String> = fit.iter().map(usize::to_string).collect();
                    let fit = fit.join(" or ");
                    let text =
                        format!("a record of buffer `{name}` has {floats} floats and not {fit}");
                    return Err(refused(text));
                }
                let record = Snapshot {
                    floats: Vec::with_capacity(floats),
                    opaque: Vec::with_capacity(reader.layout().bytes),
                    ..Snapshot::default()
                };
                Box::new(Buffer {
                    reader,
                    record,
                    clock,
                })
            }
            None => {
                let row = [0.0; HEAD + MOST];
                let latest = messages.insert(Arc::new(Latest::new(&row)));
                Box::new(Messages {
                    latest: Arc::clone(latest),
                    row,
                    clock,
                })
            }
        };
        self.serial += 1;
        let serial = self.serial;
        let how = Following {
            serial,
            kind: request.kind,
            max_age: age,
            pace,
            guards,
        };
        let failed = |error: HandlerError| MotionError::new(Outcome::Fault, error);
        let stream = Box::new(Stream::new(how, source, model));
        link.port
            .stream(stream)
            .map_err(|error| failed(error.into()))?;
        let begun = move |status: &ServoStatus| {
            status.stream.serial == serial
                || status
                    .stream_rejected
                    .is_some_and(|(other, _)| other == serial)
        };
        let patience = link.rest_patience();
        let status = link.wait(cx, "begin a stream", patience, begun).await;
        let status = status.map_err(failed)?;
        if status.stream.serial != serial {
            let why = status.stream_rejected.map(|(_, rejection)| rejection);
            let why = why.map_or_else(String::new, |rejection| rejection.to_string());
            return Err(link.failed().unwrap_or_else(|| refused(why)));
        }
        self.kind = Some(request.kind);
        self.buffer = request.buffer;
        self.messages = messages;
        Ok(self.report(link))
    }

    /// Hands a value to the stream under way, which the next tick sees.
    pub fn put(
        &self,
        cx: &Context,
        link: &Link,
        value: &StreamValue,
    ) -> Result<StreamReport, MotionError> {
        let report = self.report(link);
        if let Some(end) = &report.end {
            return Err(refused(format!("{end}; begin a stream anew")));
        }
        let (Some(latest), true) = (&self.messages, report.follows) else {
            let text = match &self.buffer {
                Some(name) if report.follows => format!("the arm follows buffer `{name}`"),
                _ => "no stream is under way; begin one first".to_owned(),
            };
            return Err(refused(text));
        };
        if value.numbers.len() > MOST {
            let text = format!("a value has {} numbers: too many", value.numbers.len());
            return Err(refused(text));
        }
        let now = cx.chassis().clock().now().since_start().as_secs_f64();
        let head = [now, value.numbers.len() as f64];
        latest.write(head.into_iter().chain(value.numbers.iter().copied()));
        Ok(report)
    }

    /// How the latest stream is.
    pub fn report(&self, link: &Link) -> StreamReport {
        let status = link.port.status();
        let stream = &status.stream;
        let begun = stream.serial > 0;
        let from = match &self.buffer {
            Some(name) => format!("buffer `{name}`: "),
            None => String::new(),
        };
        StreamReport {
            kind: self.kind,
            buffer: self.buffer.clone(),
            follows: begun && stream.end.is_none(),
            values: stream.values,
            age_s: stream.age,
            end: stream
                .end
                .map(|end| format!("the arm follows no more: {from}{end}")),
        }
    }
}

/// How many numbers a value of that kind has.
fn fitting(kind: StreamKind, joints: usize) -> Vec<usize> {
    match kind {
        StreamKind::Joints => vec![joints, 2 * joints],
        StreamKind::Tool => vec![6, 16],
        StreamKind::Torques { .. } => vec![joints],
    }
}
