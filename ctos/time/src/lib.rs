//! Time as a service, and the little that every crate of the runtime needs besides. That is how a thread
//! waits for a moment, how a seed becomes many, how a lock is taken. It knows no task, no socket and no
//! file.

mod clock;
mod lease;
pub mod lock;
pub mod park;
pub mod seed;

pub use clock::{Clock, Drift, Instant};
pub use lease::Lease;
