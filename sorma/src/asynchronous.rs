//! Asynchronous invocation by text. The classes are `later` (deferred, one-way, callback), `fork` (several at once; with
//! `-object` one object asked without waiting), `stream` (another object's results) and `event` (notification). In code it
//! is [`Sorm::ask_later`], [`Sorm::fork`], [`Sorm::subscribe`] and their like.
//!
//! None of them keeps its caller waiting for longer than it was asked to. What is not there yet is answered
//! with [`NOT_YET`](crate::ipc::NOT_YET), as by the other classes for communication.

mod answer;
mod event;
mod fork;
mod later;
mod stream;
mod tickets;

use crate::class::Class;
use crate::description::ClassInfo;
use crate::object::ServiceObject;
use crate::options::OptionTable;
use crate::sorm::Sorm;
use event::Event;
use fork::ForkObject;
use later::LaterObject;
use stream::StreamObject;

pub use answer::code;

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
        class("fork", &fork::OPTIONS, || Box::new(ForkObject::default())).waits(),
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
