//! One servo period (4.5 ms) of the physics, read and write of the channel driver included.

use std::time::Duration;

use ctos::diagnostic::Source;
use divan::Bencher;
use mcs::driver::{ChannelDriver, Power, SlotReading};
use sim::{cell::Cell, driver::SimArm};

fn main() {
    divan::main();
}

#[divan::bench(args = [Power::Released, Power::Braked])]
fn servo_period(bencher: Bencher, power: Power) {
    let text = include_str!("../../configs/cell.toml");
    let Ok(cell) = Cell::parse(&Source::new("cell.toml", text)) else {
        return;
    };
    let Ok((mut arm, _scene)) = SimArm::new("puma", &cell) else {
        return;
    };
    let mut readings = [SlotReading::default(); 6];
    bencher.bench_local(|| {
        // A soft hold keeps the arm in mid-range however long this runs.
        let read = arm.read(&mut readings);
        let torques: [f64; 6] = std::array::from_fn(|i| {
            400.0 * (cell.start[i] - readings[i].position) - 40.0 * readings[i].velocity
        });
        let write = arm.write(&torques, power, Duration::from_micros(4500));
        (read, write)
    });
}
