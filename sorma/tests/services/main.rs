//! Service objects as their users see them: classes, the manager, names, and daemons in other processes.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "helpers of tests stand outside test functions"
)]

mod app;
mod asynchronous;
mod demo_classes;
mod far;
mod faults;
mod kept;
mod manager;
#[path = "../../examples/market.rs"]
mod market;
mod names;
mod on_demand;
mod protected;
mod trading;
