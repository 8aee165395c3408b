//! A processor: one thread that runs tasks, their timers and their synchronous functions.
//!
//! The executor knows nothing of what messages mean. It polls futures that were woken, fires timers,
//! and hands over what other threads brought to its inbox. It calls cyclic functions at their
//! deadlines, which come before everything else. In real time each processor has a thread of its own
//! (`Processor::run`). In virtual time the simulation polls all processors from one thread, through
//! the small steps of `run`.
//!
//! What stays on the processor needs no lock: queues of its tasks, calls that its tasks wait for, futures that
//! are ready. The clock is read after each handler and after each poll; that moment counts as the beginning of
//! whatever comes next.

mod alarm;
mod calls;
mod core;
mod futures;
mod handle;
mod poll;
mod ready;
mod run;
pub(crate) mod wake;
mod yielding;

pub(crate) use self::handle::Item;
pub use self::{
    core::{Inlet, Processor},
    handle::ProcessorHandle,
};

#[cfg(test)]
mod tests;
