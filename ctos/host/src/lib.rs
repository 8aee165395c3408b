//! The host of an app in real time: its processes, on this machine and on others, and the links between them. It also
//! has the control socket, and serves people and tools.

extern crate ctos_core as ctos;

pub mod boot;
pub mod control;
pub mod doors;
mod metrics;
pub mod remote;
pub mod text;

#[cfg(test)]
mod tests {
    mod fuzz;
}
