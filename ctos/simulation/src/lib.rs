//! A whole app in one thread on the virtual clock.
//!
//! All chassis live in this process and exchange encoded frames over simulated links. One loop polls
//! the tasks that can run, in an order drawn from the app's seed. When none can, it moves the clock to
//! the next deadline. What goes wrong meanwhile is drawn from the same seed, or given. The same seed
//! and the same faults give the same run, event for event.

extern crate ctos_core as ctos;

mod awake;
mod draw;
mod events;
mod fault;
mod happen;
mod injured;
mod machine;
mod network;
mod processes;
mod profile;
mod reader;
mod run;
mod script;
mod shrink;

pub use self::{
    events::EventSink,
    fault::{Fault, FaultKind, Site},
    network::Tamper,
    profile::Faults,
    run::{Run, Setup, run, run_shared},
    script::write_script,
    shrink::shrink,
};

/// The page on time and simulation: its example runs with the documentation's.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/time-and-simulation.md")]
struct Page;
