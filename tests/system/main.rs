//! Tests of the whole system: the real program on the real configuration, copied into a folder of its
//! own. Processes are real where they matter; elsewhere the tests run in virtual time.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "all of this is test code, helpers too, which fails by panicking"
)]

mod bad_input;
mod cameras;
mod carry;
mod clients;
mod control;
mod determinism;
mod display;
mod displays;
#[allow(
    clippy::print_stdout,
    reason = "how each disturbed run ended is shown when one fails"
)]
mod disturbed;
mod documents;
mod doors;
mod drivers;
mod durable;
mod faults;
mod full_disk;
mod grasp;
mod half_open;
mod harness;
mod hosts;
mod inspector;
mod keys;
mod kills;
mod machine;
mod main_job;
mod manners;
mod moving;
mod nets;
mod recording;
mod remote;
mod restarts;
#[cfg(feature = "ros2")]
mod ros2;
mod runaways;
mod scenes;
#[cfg(feature = "zenoh")]
mod sites;
mod startup;
mod stepped_clock;
mod structure;
mod testbed;
mod traces;
mod tracker;
mod viewers;
mod vision;
mod ways;
