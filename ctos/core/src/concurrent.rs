//! What the structures that several threads share are made of. The models of them, in
//! `tests/models.rs`, put another module in its place, which tries all interleavings.

pub(crate) use std::sync::atomic::{AtomicBool, AtomicU32, Ordering, fence};
