//! Slots in another process: the channel driver `mcs.remote`, which speaks to a simulator or a controller by datagrams.
//!
//! From the bottom: [`frame`] is the one frame of the protocol and its bytes, [`session`] the driver's side of an
//! exchange and [`peer`] the other one, both without sockets; [`socket`] has the addresses; [`driver`] is the channel
//! driver, [`register`] makes it known. `docs/remote.md` tells who sends what and when.
//!
//! Names no simulator: whoever has one speaks the protocol, in whatever language.

mod args;
pub mod driver;
pub mod frame;
#[cfg(test)]
mod fuzz;
pub mod peer;
pub mod session;
pub mod socket;

pub use args::{REMOTE, register};
