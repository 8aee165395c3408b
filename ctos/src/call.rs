//! How a call ends: with a reply or with an error that names both tasks. Always.

pub(crate) use ctos_time::lock::lock;

pub use ctos_message::fault::{CallError, Fault};

pub(crate) use crate::reply::{Answer, Promise, ReplyKey, ReplySlot, Waiting};
