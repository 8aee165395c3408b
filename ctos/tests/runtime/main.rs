//! The runtime as its users see it, in virtual time: what a seed shows, it shows every time.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may end where it finds something wrong, and some tasks panic on purpose"
)]

mod boot;
mod compile;
mod durable;
mod finding;
mod links;
mod moving;
mod record;
mod semaphore;
mod stopping;
mod supervision;
mod tasks;
mod watch;
