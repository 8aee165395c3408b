//! An arm for tests that obeys the equations of motion, with faults to be had. The tests of the tasks use the same file.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::driver::{ChannelDriver, DriverError, Power, SlotReading};
use crate::joints::Joints;
use crate::model::{Data, DynamicsOptions, Model, built_in, file::Inertias};

/// Where a PUMA stands at first, rad.
pub(crate) const START: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const SUBSTEPS: u32 = 3;
const FRICTIONLESS: DynamicsOptions = DynamicsOptions::WITH_ROTORS;

/// A built-in arm with the inertias of the engine, as a servo has it.
pub(crate) fn built_in_arm(name: &str) -> Model {
    built_in::model(name, Inertias::Engine).unwrap().unwrap()
}

/// Faults to be had from the arm: 1 read error, 2 write error, 3 not a number, 4 joint 1 held fast, 5 nothing new is read.
#[derive(Default)]
pub(crate) struct Knobs {
    pub(crate) fault: AtomicU8,
    pub(crate) writes_under_power: AtomicU64,
    pub(crate) last_write: Mutex<Option<(Power, Joints)>>,
    /// The torques of all ticks under power.
    pub(crate) torques: Mutex<Vec<Joints>>,
    /// Largest joint speed at the moment when the brakes closed, rad/s or m/s.
    pub(crate) speed_at_power_off: Mutex<Option<f64>>,
    /// How often the task that moves it was begun.
    #[allow(dead_code, reason = "the tests of the tasks read it")]
    pub(crate) lives: AtomicU64,
    /// What somebody who moved it was told.
    #[allow(dead_code, reason = "the tests of the tasks read it")]
    pub(crate) told: Mutex<Option<String>>,
}

/// The stand-in.
pub(crate) struct TestArm {
    model: Model,
    data: Data,
    friction: bool,
    start: Vec<f64>,
    q: Vec<f64>,
    qd: Vec<f64>,
    period: Duration,
    silent: Duration,
    knobs: Arc<Knobs>,
}

impl TestArm {
    pub(crate) fn new(model: Model, start: &[f64], friction: bool, knobs: &Arc<Knobs>) -> Self {
        assert_eq!(model.dof(), start.len());
        Self {
            data: model.data(),
            friction,
            start: start.to_vec(),
            q: start.to_vec(),
            qd: vec![0.0; model.dof()],
            model,
            period: Duration::ZERO,
            silent: Duration::ZERO,
            knobs: Arc::clone(knobs),
        }
    }

    /// Speeds and accelerations at a state.
    fn slope(&mut self, q: &[f64], qd: &[f64], torques: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let found = self
            .model
            .forward_dynamics(&mut self.data, q, qd, torques, FRICTIONLESS);
        (qd.to_vec(), found.unwrap().to_vec())
    }

    /// One step of the classical method of Runge and Kutta, without friction.
    fn step(&mut self, torques: &[f64], h: f64) {
        let on = |from: &[f64], slope: &[f64], h: f64| -> Vec<f64> {
            from.iter().zip(slope).map(|(x, s)| x + h * s).collect()
        };
        let (q, qd) = (self.q.clone(), self.qd.clone());
        let (v1, a1) = self.slope(&q, &qd, torques);
        let half = h / 2.0;
        let (v2, a2) = self.slope(&on(&q, &v1, half), &on(&qd, &a1, half), torques);
        let (v3, a3) = self.slope(&on(&q, &v2, half), &on(&qd, &a2, half), torques);
        let (v4, a4) = self.slope(&on(&q, &v3, h), &on(&qd, &a3, h), torques);
        for index in 0..q.len() {
            let sum =
                |s: [&Vec<f64>; 4]| s[0][index] + 2.0 * (s[1][index] + s[2][index]) + s[3][index];
            self.q[index] += h / 6.0 * sum([&v1, &v2, &v3, &v4]);
            self.qd[index] += h / 6.0 * sum([&a1, &a2, &a3, &a4]);
        }
    }

    /// Dry friction slows down and holds; it never turns a motion round.
    fn rub(&mut self, h: f64) {
        let inertia = self
            .model
            .mass_matrix(&mut self.data, &self.q, FRICTIONLESS);
        for (index, joint) in self.model.joints().iter().enumerate() {
            let torque = joint.motor.friction_torque(self.qd[index]).abs();
            let slowed = self.qd[index].abs() - h * torque / inertia[(index, index)];
            self.qd[index] = slowed.max(0.0).copysign(self.qd[index]);
        }
    }
}

fn fault() -> DriverError {
    DriverError::Fault {
        driver: "arm".to_owned(),
        reason: "cable out".to_owned(),
    }
}

impl ChannelDriver for TestArm {
    fn slots(&self) -> usize {
        self.q.len()
    }

    fn silence(&self, _: usize) -> Option<(Duration, DriverError)> {
        let error = DriverError::Fault {
            driver: "arm".to_owned(),
            reason: format!("silent for {:?}", self.silent),
        };
        (!self.silent.is_zero()).then_some((self.silent, error))
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        if self.knobs.fault.load(Ordering::Relaxed) == 5 {
            self.silent += self.period;
            return Ok(());
        }
        self.silent = Duration::ZERO;
        for (index, reading) in readings.iter_mut().enumerate() {
            reading.position = self.q[index];
            reading.velocity = self.qd[index];
        }
        match self.knobs.fault.load(Ordering::Relaxed) {
            1 => return Err(fault()),
            3 => readings[4].position = f64::NAN,
            _ => {}
        }
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        let written = Joints::try_from(torques).unwrap();
        self.period = period;
        *self.knobs.last_write.lock().unwrap() = Some((power, written));
        if power != Power::Released {
            let speed = self.qd.iter().fold(0.0_f64, |most, qd| most.max(qd.abs()));
            if speed > 0.0 {
                *self.knobs.speed_at_power_off.lock().unwrap() = Some(speed);
            }
            assert!(torques.iter().all(|torque| *torque == 0.0));
            self.qd.fill(0.0);
            return Ok(());
        }
        self.knobs
            .writes_under_power
            .fetch_add(1, Ordering::Relaxed);
        self.knobs.torques.lock().unwrap().push(written);
        let h = period.as_secs_f64() / f64::from(SUBSTEPS);
        for _ in 0..SUBSTEPS {
            self.step(torques, h);
            if self.friction {
                self.rub(h);
            }
            if self.knobs.fault.load(Ordering::Relaxed) == 4 {
                self.qd[0] = 0.0;
                self.q[0] = self.start[0];
            }
        }
        match self.knobs.fault.load(Ordering::Relaxed) {
            2 => Err(fault()),
            _ => Ok(()),
        }
    }
}
