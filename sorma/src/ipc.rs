//! The IPC service classes: snapshot buffers in shared memory (`shmem_w`, `shmem_r`, `flight`; of other hosts `shmem_far`,
//! with `stamp`), and queues,
//! counting semaphores and blackboards (SORMA technical report, sections 1.7.1 and 1.7.2).
//!
//! None of them waits in EXEC: a call that cannot be done now says `not yet` at once and is asked again, so
//! that whoever waits keeps no other caller of the object, or of its manager, from it. `docs/snapshots.md`
//! and `docs/ipc.md` say what each understands.

pub mod blackboard;
pub mod flight;
pub mod queue;
pub mod semaphore;
mod shmem_far;
mod shmem_r;
mod shmem_w;
mod stamp;
mod tickets;

use crate::class::Class;
use crate::description::ClassInfo;
use crate::object::ServiceObject;
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::snapshot::{Place, SnapshotError};
use crate::sorm::Sorm;
use crate::transport::Transport;
use crate::words;
use blackboard::Board;
use ctos::time::{Clock, Instant};
use flight::Flight;
use queue::Queue;
use semaphore::SemaphoreObject;
use shmem_far::ShmemFar;
use shmem_r::ShmemR;
use shmem_w::ShmemW;
use stamp::Stamp;
use std::path::PathBuf;
use std::time::Duration;

crate::prototypes! {
    /// The codes of the reports of these classes.
    pub mod code {
        BUFFER = 180, Error, "a snapshot buffer cannot be made, opened, written or read",
            "the text says which and why; `shmem_r.NAME EXEC status` tells about a buffer";
        SUCCEEDED = 181, Warning, "another writer has taken over a buffer, or it was made anew",
            "go on; the numbers of the records begin again only when it was made anew";
        LOST = 182, Warning, "records were overwritten before they were read",
            "read more often, or give the buffer more slots";
        FILE = 183, Error, "a file of a flight recorder cannot be written",
            "choose another -file, or make room";
        FULL = 184, Error, "a queue, a blackboard or a line of those who wait is full",
            "try again later, or set -capacity";
        UNKNOWN = 185, Error, "no such key or hold", "see EXEC keys, EXEC holders";
        LATE = 186, Error, "the time for which one wanted to wait is over", "ask anew, for longer";
        CONFLICT = 187, Error, "a value has another version than the one that was to be replaced",
            "get it again, and decide anew";
        CLOCK = 188, Warning, "the clock of another host was set, or drifts faster than was said",
            "set -drift of shmem_far, if it comes again and again";
    }
}

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What EXEC answers, as text, when the caller is to ask again.
pub const NOT_YET: &str = "not yet";

/// What the objects of these classes need to know.
#[derive(Debug, Clone)]
pub struct Host {
    /// The app, in whose folder the segments lie.
    pub app: String,
    /// The app's clock.
    pub clock: Clock,
    /// Under which folder; the usual one in shared memory when `None`.
    pub root: Option<PathBuf>,
}

impl Host {
    /// The app of that name, with its segments at the usual place.
    #[must_use]
    pub fn new(app: impl Into<String>, clock: Clock) -> Self {
        Self {
            app: app.into(),
            clock,
            root: None,
        }
    }

    /// The folder of the app's segments.
    ///
    /// # Errors
    /// It is not this user's alone, or cannot be made.
    pub fn place(&self) -> Result<Place, SnapshotError> {
        self.place_of("")
    }

    /// The folder of another app's segments; of this one's when it has no name.
    fn place_of(&self, app: &str) -> Result<Place, SnapshotError> {
        let app = if app.is_empty() { &self.app } else { app };
        match &self.root {
            Some(root) => Place::under(root, app),
            None => Place::of_app(app),
        }
    }

    fn now(&self) -> Instant {
        self.clock.now()
    }
}

/// All of them. What reads or writes a buffer takes the name of its flavor.
fn all(host: &Host) -> [Class; 8] {
    [
        class(host, "shmem_w", &shmem_w::OPTIONS, |host, name| {
            Box::new(ShmemW::new(host, name))
        }),
        class(host, "shmem_r", &shmem_r::OPTIONS, |host, name| {
            Box::new(ShmemR::new(host, name))
        }),
        class(host, "flight", &flight::OPTIONS, |host, name| {
            Box::new(Flight::new(host, name))
        }),
        class(host, "queue", &queue::OPTIONS, |_, _| {
            Box::new(Queue::default())
        }),
        class(host, "semaphore", &semaphore::OPTIONS, |host, _| {
            Box::new(SemaphoreObject::new(host))
        }),
        class(host, "blackboard", &blackboard::OPTIONS, |_, _| {
            Box::new(Board::default())
        }),
        class(host, "stamp", &stamp::OPTIONS, |_, _| Box::new(Stamp)),
        // It asks a daemon.
        class(host, "shmem_far", &shmem_far::OPTIONS, |_, name| {
            Box::new(ShmemFar::new(name))
        })
        .waits(),
    ]
}

fn class<T: Clone + Default + 'static>(
    host: &Host,
    name: &'static str,
    options: &OptionTable<T>,
    make: fn(Host, String) -> Box<dyn ServiceObject>,
) -> Class {
    let host = host.clone();
    let class = Class::new(name, VERSION, move |name, _| {
        let flavor = name.flavor().unwrap_or("default");
        Ok(make(host.clone(), flavor.to_owned()))
    });
    let class = class.described(options.class(name, VERSION));
    class.codes(code::PROTOTYPES).any_flavor()
}

/// Registers all the classes of this module.
pub fn register(sorm: &Sorm, host: &Host) {
    all(host).into_iter().for_each(|class| sorm.register(class));
}

/// What a program may know about the classes.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    let all = all(&Host::new("", Clock::real()));
    all.iter()
        .filter_map(|class| class.info().cloned())
        .collect()
}

/// The name of the buffer that an object is about: what its settings say, or else its flavor.
fn buffer<'a>(said: &'a str, flavor: &'a str) -> &'a str {
    if said.is_empty() { flavor } else { said }
}

#[track_caller]
fn buffer_error(error: &SnapshotError) -> Report {
    Report::error(code::BUFFER, error.to_string())
}

#[track_caller]
fn wrong(text: impl Into<String>) -> Report {
    Report::error(general::VALUE, text)
}

/// The words of an EXEC text.
pub(crate) fn split(text: &str) -> Result<Vec<String>, Report> {
    words::texts(text).map_err(|error| raise!(general::SYNTAX, "{error}"))
}

/// A whole number that a word of EXEC says.
fn number(what: &str, word: &str) -> Result<u64, Report> {
    word.parse()
        .map_err(|_| wrong(format!("{what} is a whole number from 0 on, not `{word}`")))
}

/// The longest anybody may say to wait: a day.
const MOST_WAIT_S: f64 = 86_400.0;

/// A time that a word of EXEC says, in seconds; none is 0.
fn seconds(word: Option<&String>) -> Result<Duration, Report> {
    let Some(word) = word else {
        return Ok(Duration::ZERO);
    };
    word.parse()
        .ok()
        .filter(|seconds| (0.0..=MOST_WAIT_S).contains(seconds))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| {
            wrong(format!(
                "the time to wait is 0 to {MOST_WAIT_S} s, not `{word}`"
            ))
        })
}

/// What stands after the first `count` words of a text, as it stands; without its quotes if it is one word.
fn after(text: &str, count: usize) -> Result<String, Report> {
    let found = words::split(text).map_err(|error| raise!(general::SYNTAX, "{error}"))?;
    Ok(match found.get(count..) {
        Some([only]) => only.text.clone(),
        Some([first, ..]) => text
            .get(first.span.start..)
            .unwrap_or_default()
            .trim_end()
            .to_owned(),
        _ => String::new(),
    })
}

/// Answers that the caller is to ask again.
pub(crate) fn not_yet(io: &mut Transport) {
    io.empty();
    NOT_YET.clone_into(&mut io.text);
}

/// An `i64` as IMSG carries it.
pub(crate) fn int(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests;
