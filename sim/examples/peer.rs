//! The arm of a cell for a control layer in another process: the peer of the channel driver `mcs.remote`.
//!
//! ```console
//! $ cargo run --release -p sim --example peer -- configs/cell.toml udp:127.0.0.1:4560
//! $ ctos boot configs/remote.toml
//! ```

use std::{path::Path, sync::atomic::AtomicBool};

use ctos::time::Clock;
use mcs_remote::socket::{Address, PeerSocket};
use sim::{cell::Cell, served::Served};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let (Some(cell), Some(address)) = (words.next(), words.next()) else {
        return Err("usage: peer CELL ADDRESS, as in configs/cell.toml udp:127.0.0.1:4560".into());
    };
    let cell = Cell::read(Path::new(&cell))?;
    let address: Address = address.parse()?;
    // Of the time since the host was started: no other start has the same.
    let own = Clock::real_from(0).now().as_nanos() as u32 ^ std::process::id();
    let mut served = Served::new(&cell, 0, own).ok_or("the cell has no arm")?;
    Ok(served.serve(&PeerSocket::bind(&address)?, &AtomicBool::new(false))?)
}
