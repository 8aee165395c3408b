//! The task that runs a net on the runtime, and what others see of the net. From bottom to top:
//!
//! - [`library`]: the functions that a net names; [`store`]: what survives a crash;
//! - [`stream`]: what a net does, as numbered events for displays and records;
//! - [`layout`]: where its nodes are drawn;
//! - [`task`]: the event handler that runs a net.
//!
//! Knows no robot and no screen.

pub mod layout;
pub mod library;
pub mod store;
pub mod stream;
pub mod task;
