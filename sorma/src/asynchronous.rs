//! Asynchronous invocation by text: the classes `later` (deferred, one-way, callback), `fork` (several at
//! once), `stream` (another object's results) and `event` (notification). In code it is
//! [`Sorm::ask_later`], [`Sorm::fork`], [`Sorm::subscribe`] and their like.
//!
//! None of them keeps its caller waiting for more than what it was asked to wait for: what is not there yet
//! is answered with [`NOT_YET`](crate::ipc::NOT_YET), as by the other classes for communication.

mod event;
mod fork;
mod later;
mod stream;

use crate::class::Class;
use crate::description::ClassInfo;
use crate::object::ServiceObject;
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::Request;
use crate::sorm::Sorm;
use crate::transport::Transport;
use event::Event;
use fork::Fork;
use later::LaterObject;
use stream::StreamObject;

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

/// All of them.
fn all() -> [Class; 4] {
    [
        class(
            "later",
            &later::OPTIONS,
            || Box::new(LaterObject::default()),
        )
        .waits(),
        class("fork", &fork::OPTIONS, || Box::new(Fork::default())).waits(),
        class("stream", &stream::OPTIONS, || {
            Box::new(StreamObject::default())
        })
        .waits(),
        class("event", &event::OPTIONS, || Box::new(Event)),
    ]
}

fn class<T: Clone + Default + 'static>(
    name: &'static str,
    options: &OptionTable<T>,
    make: fn() -> Box<dyn ServiceObject>,
) -> Class {
    let class = Class::new(name, VERSION, move |_, _| Ok(make()));
    class
        .described(options.class(name, VERSION))
        .codes(code::PROTOTYPES)
}

/// Registers all the classes of this module.
pub fn register(sorm: &Sorm) {
    all().into_iter().for_each(|class| sorm.register(class));
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    all()
        .iter()
        .filter_map(|class| class.info().cloned())
        .collect()
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

/// Answers as another object has: data, code and reports.
fn mirror(io: &mut Transport, mut body: Transport) {
    io.code = body.code;
    io.reports.append(&mut body.reports);
    io.take_data(body);
}
