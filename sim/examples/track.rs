//! How well a servo tracks a few moves of the PUMA 560 behind a peer, or in a world of this process.
//!
//! ```console
//! $ cargo run --release -p sim --example track -- inside
//! $ cargo run --release -p sim --example track -- udp:127.0.0.1:4560 in-step
//! $ cargo run --release -p sim --example track -- udp:127.0.0.1:4560 real
//! ```
//!
//! In step, a tick waits for the answer to the command before; in real time, ticks come each 4.5 ms whatever is there.

#![allow(clippy::print_stdout, reason = "its output is what it is for")]

use std::{
    error::Error,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use ctos::time::Clock;
use mcs::{
    Joints,
    control::{ComputedTorque, ControlLaw, PidGravity},
    driver::{ChannelDriver, DriverError, Power, SlotReading},
    model::{DynamicsOptions, Model, built_in, file::Inertias},
    servo::{MotionPhase, Servo, ServoCommand, ServoConfig, ServoPort},
    trajectory::{CartesianLimits, Planner},
};
use mcs_remote::{
    driver::RemoteArm,
    session::Session,
    socket::{Address, Line},
};
use sim::{cell::Cell, driver::SimArm, port::Port, simulation::Simulation};

/// Ways of the joints, rad: up to 1.5 rad. They add up to nothing, so that the next law begins where this one did.
const WAYS: [[f64; 6]; 4] = [
    [0.8, -0.5, 0.6, 0.5, -0.4, 1.0],
    [-1.5, 0.3, -0.3, -0.5, 0.4, -1.0],
    [0.2, 0.6, -0.9, 0.9, 0.3, 0.5],
    [0.5, -0.4, 0.6, -0.9, -0.3, -0.5],
];

const PERIOD: Duration = Duration::from_micros(4500);

/// The world of this process, which goes on with each write.
struct Inside(SimArm, Simulation);

impl ChannelDriver for Inside {
    fn slots(&self) -> usize {
        self.0.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        self.0.read(readings)
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        self.0.write(torques, power, period)?;
        let ticked = self.1.tick(period, 0, Duration::ZERO);
        ticked.map_err(|error| DriverError::Fault {
            driver: "inside".to_owned(),
            reason: error.to_string(),
        })
    }
}

/// A peer, whose answer is waited for in step; how often there was none when it was read.
struct Outside(RemoteArm, bool, Arc<AtomicU64>);

impl ChannelDriver for Outside {
    fn slots(&self) -> usize {
        self.0.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        if self.1 && self.0.unanswered() > 0 {
            self.0.wait(Duration::from_secs(1));
        }
        let read = self.0.read(readings);
        self.2
            .fetch_add(u64::from(self.0.unanswered() > 0), Ordering::Relaxed);
        read
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        self.0.write(torques, power, period)
    }
}

/// Ticks the servo, in real time or as fast as it can, and how late each tick was.
struct Run {
    servo: Servo,
    port: ServoPort,
    real: bool,
    clock: Clock,
    next: ctos::time::Instant,
    late_us: Vec<f64>,
}

impl Run {
    fn tick(&mut self) -> Result<(), Box<dyn Error>> {
        let mut missed = 0;
        if self.real {
            let mut now = self.clock.now();
            while now < self.next {
                std::thread::park_timeout(self.next.since(now));
                now = self.clock.now();
            }
            let late = now.since(self.next);
            self.late_us.push(late.as_secs_f64() * 1e6);
            // Whole periods are skipped, as the synchronous functions of an app do.
            missed = late.as_nanos() / PERIOD.as_nanos();
            self.next = self.next + PERIOD * (1 + missed as u32);
        }
        self.servo.tick(missed as u64);
        match self.servo.status().fault {
            None => Ok(()),
            Some(fault) => Err(format!("{fault}: {:?}", self.port.driver_error()).into()),
        }
    }

    fn until(&mut self, done: impl Fn(&Servo) -> bool) -> Result<(), Box<dyn Error>> {
        while !done(&self.servo) {
            self.tick()?;
        }
        Ok(())
    }
}

fn driver(
    place: &str,
    in_step: bool,
    model: &Model,
    late: &Arc<AtomicU64>,
) -> Result<Box<dyn ChannelDriver>, Box<dyn Error>> {
    if place == "inside" {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/cell.toml");
        let cell = Cell::read(Path::new(folder))?;
        let port = Arc::new(Port::new(&cell));
        let world = Simulation::new(&cell, Arc::clone(&port));
        let arm = SimArm::new("track", ("world", &port, &cell), 0, &[0, 1, 2, 3, 4, 5])?;
        return Ok(Box::new(Inside(arm, world)));
    }
    let address: Address = place.parse()?;
    let speeds = model.joints().iter().map(|joint| joint.limits.velocity);
    // A number that the run before did not have.
    let own = Clock::real_from(0).now().as_nanos() as u32;
    let session = Session::new(own, speeds.collect(), Duration::from_millis(200));
    let line = Line::open(&address)?;
    let mut arm = RemoteArm::new("track", (address, line), session, Clock::real());
    arm.meet(PERIOD, Duration::from_secs(2))?;
    Ok(Box::new(Outside(arm, in_step, Arc::clone(late))))
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let place = words.first().map_or("inside", String::as_str);
    let real = words.get(1).is_some_and(|word| word == "real");
    let model = built_in::model("puma560", Inertias::Engine).ok_or("no model")??;
    let model = Arc::new(model);
    for name in ["pid", "computed_torque"] {
        let late = Arc::new(AtomicU64::new(0));
        let law: Box<dyn ControlLaw> = match name {
            "pid" => Box::new(PidGravity::new(Arc::clone(&model), 8.0, 1.0)),
            _ => Box::new(ComputedTorque::new(
                Arc::clone(&model),
                8.0,
                1.0,
                DynamicsOptions::WITH_ROTORS,
            )),
        };
        let config = ServoConfig::default();
        let driver = driver(place, !real, &model, &late)?;
        let (servo, port) = Servo::new(Arc::clone(&model), driver, law, config)?;
        let clock = Clock::real();
        let mut run = Run {
            servo,
            port,
            real,
            next: clock.now() + PERIOD,
            clock,
            late_us: Vec::new(),
        };
        run.port.order(ServoCommand::PowerOn)?;
        run.port.order(ServoCommand::ReleaseBrakes)?;
        run.until(|servo| servo.status().power == Power::Released)?;
        let planner = Planner::new(Arc::clone(&model), CartesianLimits::default(), 0.018)?;
        let (mut most, mut last) = (0.0_f64, 0.0_f64);
        for (id, way) in (1..).zip(WAYS) {
            let start = run.servo.status().setpoint;
            let goal = Joints::from_fn(6, |joint| start[joint] + way[joint]);
            let segment = planner.joint(&start, &goal, 1.0)?;
            run.port.order(ServoCommand::Move { id, segment })?;
            run.until(|servo| {
                let motion = &servo.status().motion;
                motion.id == id && motion.phase.is_over()
            })?;
            let motion = run.servo.status().motion;
            if motion.phase != MotionPhase::Done {
                return Err(format!("move {id} ended {:?}", motion.phase).into());
            }
            most = most.max(motion.max_tracking_error.turning);
            // Settled counts from 0.2 mrad on; what it comes to after one second more.
            for _ in 0..222 {
                run.tick()?;
            }
            let status = run.servo.status();
            let pairs = status.setpoint.iter().zip(&status.position);
            last = pairs.fold(last, |last, (setpoint, position)| {
                last.max((setpoint - position).abs())
            });
        }
        let ticks = run.servo.status().ticks;
        println!(
            "{name}: {:.3} mrad in motion, {:.3} mrad settled; {ticks} ticks, {} missed, {} without the answer before",
            most * 1e3,
            last * 1e3,
            run.servo.status().missed,
            late.load(Ordering::Relaxed)
        );
        run.late_us.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let index = share * (run.late_us.len().saturating_sub(1)) as f64;
            run.late_us.get(index as usize).copied().unwrap_or_default()
        };
        if real {
            println!(
                "  ticks were late by {:.0} us (p50), {:.0} (p99), {:.0} (most)",
                at(0.5),
                at(0.99),
                at(1.0)
            );
        }
    }
    Ok(())
}
