//! Asynchronous invocation by text: the classes `later` (deferred, one-way, callback), `fork` (several at
//! once), `stream` (another object's results) and `event` (notification). In code it is
//! [`Sorm::ask_later`], [`Sorm::fork`], [`Sorm::subscribe`] and their like.
//!
//! None of them keeps its caller waiting for more than what it was asked to wait for: what is not there yet
//! is answered with [`NOT_YET`], as by the other classes for communication.

mod event;
mod fork;
mod later;
mod stream;

use crate::class::Class;
use crate::description::ClassInfo;
use crate::ipc::NOT_YET;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::Request;
use crate::sorm::Sorm;
use crate::transport::Transport;
use crate::words;

crate::prototypes! {
    /// The codes of the reports of these classes.
    pub mod code {
        UNKNOWN = 190, Error, "no such ticket", "see EXEC open; a ticket is collected once";
        FULL = 191, Error, "too many answers wait to be collected",
            "collect some, or raise -capacity";
        MISSED = 192, Warning, "results were made that this stream did not keep",
            "ask more often, or set -keep every and a larger -capacity";
        RESUMED = 193, Warning, "the stream was interrupted, and what was made meanwhile is lost",
            "go on; the numbers of the results may have begun again";
    }
}

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Registers all the classes of this module.
pub fn register(sorm: &Sorm) {
    let later = Class::new("later", VERSION, |_, _| {
        Ok(Box::new(later::LaterObject::default()))
    });
    let later = later.described(later::OPTIONS.class("later", VERSION));
    sorm.register(later.codes(code::PROTOTYPES).waits());
    let fork = Class::new("fork", VERSION, |_, _| {
        Ok(Box::new(fork::ForkObject::default()))
    });
    let fork = fork.described(fork::OPTIONS.class("fork", VERSION));
    sorm.register(fork.codes(code::PROTOTYPES).waits());
    let stream = Class::new("stream", VERSION, |_, _| {
        Ok(Box::new(stream::StreamObject::default()))
    });
    let stream = stream.described(stream::OPTIONS.class("stream", VERSION));
    sorm.register(stream.codes(code::PROTOTYPES).waits());
    let event = Class::new("event", VERSION, |_, _| {
        Ok(Box::new(event::EventObject::default()))
    });
    let event = event.described(event::OPTIONS.class("event", VERSION));
    sorm.register(event.codes(code::PROTOTYPES));
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![
        later::OPTIONS.class("later", VERSION),
        fork::OPTIONS.class("fork", VERSION),
        stream::OPTIONS.class("stream", VERSION),
        event::OPTIONS.class("event", VERSION),
    ]
}

/// The words of an EXEC text.
fn split(text: &str) -> Result<Vec<String>, Report> {
    let found = words::split(text).map_err(|error| raise!(general::SYNTAX, "{error}"))?;
    Ok(found.into_iter().map(|word| word.text).collect())
}

/// A request that stands as one word in the text of another one, asked by the same caller.
fn request(text: &str, from: &str) -> Result<Request, Report> {
    let mut request: Request = text
        .parse()
        .map_err(|error| raise!(general::SYNTAX, "in `{}`: {error}", begin(text)))?;
    from.clone_into(&mut request.body.from);
    Ok(request)
}

/// The beginning of a text of any length.
fn begin(text: &str) -> &str {
    const MOST: usize = 80;
    let end = text
        .char_indices()
        .nth(MOST)
        .map_or(text.len(), |(at, _)| at);
    text.get(..end).unwrap_or_default()
}

/// Makes room for the answer; reports stay.
fn empty(io: &mut Transport) {
    io.text.clear();
    io.floats.clear();
    io.ints.clear();
    io.opaque.clear();
}

/// Answers as another object has: data, code and reports.
fn mirror(io: &mut Transport, mut body: Transport) {
    io.text = body.text;
    io.floats = body.floats;
    io.ints = body.ints;
    io.opaque = body.opaque;
    io.code = body.code;
    io.reports.append(&mut body.reports);
}

fn not_yet(io: &mut Transport) {
    empty(io);
    NOT_YET.clone_into(&mut io.text);
}

/// An `i64` as IMSG carries it.
fn int(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}
