//! One servo period (4.5 ms) of the world, with read and write of its channel drivers.

use std::{sync::Arc, time::Duration};

use ctos::diagnostic::Source;
use divan::Bencher;
use mcs::driver::{ChannelDriver, Power, SlotReading};
use sim::{cell::Cell, driver::SimArm, port::Port, simulation::Simulation};

fn main() {
    divan::main();
}

const PERIOD: Duration = Duration::from_micros(4500);

/// An arm on its own, and the two of CIRSSE's testbed.
const CELLS: [&str; 2] = [
    "[[arm]]\nname = 'one'\nmodel = 'puma560'\nstart = [0, 45, -90, 0, 45, 0]\n",
    "[[arm]]\nname = 'left'\nmodel = 'testbed9'\nstart = [0, 0, 0, 0, 45, -90, 0, 45, 0]\n\
     [[arm]]\nname = 'right'\nmodel = 'testbed9'\nbase = { xyz = [0, 1.2, 0] }\nstart = [0, 0, 0, 0, 45, -90, 0, 45, 0]\n",
];

#[divan::bench(args = [(0, Power::Released), (0, Power::Braked), (1, Power::Released)])]
fn servo_period(bencher: Bencher, (cell, power): (usize, Power)) {
    let Ok(cell) = Cell::parse(&Source::new("cell.toml", CELLS[cell])) else {
        return;
    };
    let port = Arc::new(Port::new(&cell));
    let mut simulation = Simulation::new(&cell, Arc::clone(&port));
    let mut arms = Vec::new();
    for (index, arm) in cell.arms.iter().enumerate() {
        let joints: Vec<usize> = (0..arm.start.len()).collect();
        let driver = SimArm::new(&arm.name, ("world", &port, &cell), index, &joints);
        arms.extend(driver.map(|driver| (driver, arm.start.clone())));
    }
    bencher.bench_local(|| {
        for (arm, start) in &mut arms {
            let mut readings = vec![SlotReading::default(); start.len()];
            let _ = arm.read(&mut readings);
            // A soft hold keeps the arm in mid-range however long this runs.
            let hold = start.iter().zip(&readings);
            let torques: Vec<f64> = hold
                .map(|(start, at)| 400.0 * (start - at.position) - 40.0 * at.velocity)
                .collect();
            let _ = arm.write(&torques, power, PERIOD);
        }
        simulation.tick(PERIOD, 0, Duration::ZERO)
    });
}
