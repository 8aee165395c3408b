//! Links between chassis: sessions over streams, and what carries these.

pub(crate) mod address;
pub(crate) mod handshake;
pub(crate) mod injure;
pub(crate) mod reactor;
pub(crate) mod session;
pub(crate) mod shm;
pub(crate) mod transport;
#[cfg(feature = "zenoh")]
pub(crate) mod zenoh;
#[cfg(not(feature = "zenoh"))]
#[path = "link/no_zenoh.rs"]
pub(crate) mod zenoh;
