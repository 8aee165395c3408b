//! The IPC service classes (SORMA technical report, sections 1.7.1 and 1.7.2). They are snapshot buffers in shared memory
//! (`shmem_w`, `shmem_r`, `flight`; of other hosts `shmem_far`, with `stamp`), queues, counting semaphores and
//! blackboards.
//!
//! None of them waits in EXEC: a call that cannot be done now says `not yet` at once and is asked again. So
//! a waiting caller blocks no other caller of the object, or of its manager. `docs/snapshots.md` and
//! `docs/ipc.md` say what each understands.

pub(crate) mod answer;
pub mod blackboard;
pub mod flight;
mod host;
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
use crate::sorm::Sorm;
use blackboard::Board;
use ctos::time::Clock;
use flight::Flight;
use queue::Queue;
use semaphore::SemaphoreObject;
use shmem_far::ShmemFar;
use shmem_r::ShmemR;
use shmem_w::ShmemW;
use stamp::Stamp;

pub use answer::{NOT_YET, code};
pub use host::Host;

/// Version of the classes.
const VERSION: &str = env!("CARGO_PKG_VERSION");

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

#[cfg(test)]
mod tests;
