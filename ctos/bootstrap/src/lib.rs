//! Brings an app up in three acknowledged phases, watches it, and takes it down in order. Every host of an app does
//! that, whether its chassis are processes or simulated.
//!
//! It knows no socket and starts no process: that is the business of the hosts.

extern crate ctos_core as ctos;

#[doc(hidden)]
pub mod agent;
pub mod bootstrap;
pub mod refusals;
#[doc(hidden)]
pub mod survey;
pub mod watch;
