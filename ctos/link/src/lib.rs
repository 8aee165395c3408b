//! Links between chassis: sessions over streams, what carries these, shared memory, and the keys of their ends.
//!
//! Knows no task, no processor, no chassis and no simulation.

#![allow(
    missing_docs,
    reason = "inside the runtime; what users reach of it through `ctos` is documented"
)]

use ctos_config as config;
use ctos_message::{self as message, blob, frame};
use ctos_time::{self as time, lock, park, seed};

pub mod address;
pub mod handshake;
pub mod injure;
mod noise;
pub mod reactor;
pub mod security;
pub mod session;
pub mod shared_memory;
pub mod shm;
pub mod transport;
#[cfg(feature = "zenoh")]
pub mod zenoh;
#[cfg(not(feature = "zenoh"))]
#[path = "no_zenoh.rs"]
pub mod zenoh;
