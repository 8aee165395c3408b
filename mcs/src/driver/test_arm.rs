//! An arm for tests that obeys the equations of motion, with faults to be had.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::{ChannelDriver, DriverError, Power, SlotReading};
use crate::arm::{ArmModel, DOF, DynamicsOptions, Joints};

/// Where it stands at first, rad.
pub(crate) const START: Joints = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const SUBSTEPS: u32 = 3;

/// Faults to be had from the arm: 1 read error, 2 write error, 3 not a number, 4 joint 1 held fast.
#[derive(Default)]
pub(crate) struct Knobs {
    pub(crate) fault: AtomicU8,
    pub(crate) writes_under_power: AtomicU64,
    pub(crate) last_write: Mutex<Option<(Power, Joints)>>,
    /// Largest joint speed at the moment when the brakes closed, rad/s.
    pub(crate) speed_at_power_off: Mutex<Option<f64>>,
    /// How often the task that moves it was begun.
    pub(crate) lives: AtomicU64,
    /// What somebody who moved it was told.
    pub(crate) told: Mutex<Option<String>>,
}

/// The stand-in.
pub(crate) struct TestArm {
    model: ArmModel,
    friction: bool,
    q: Joints,
    qd: Joints,
    knobs: Arc<Knobs>,
}

impl TestArm {
    pub(crate) fn new(model: ArmModel, friction: bool, knobs: &Arc<Knobs>) -> Self {
        Self {
            model,
            friction,
            q: START,
            qd: [0.0; DOF],
            knobs: Arc::clone(knobs),
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
        DOF
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
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
        let torques: Joints = torques.try_into().unwrap();
        *self.knobs.last_write.lock().unwrap() = Some((power, torques));
        if power != Power::Released {
            let speed = self.qd.iter().fold(0.0_f64, |most, qd| most.max(qd.abs()));
            if speed > 0.0 {
                *self.knobs.speed_at_power_off.lock().unwrap() = Some(speed);
            }
            assert!(torques.iter().all(|torque| *torque == 0.0));
            self.qd = [0.0; DOF];
            return Ok(());
        }
        self.knobs
            .writes_under_power
            .fetch_add(1, Ordering::Relaxed);
        let h = period.as_secs_f64() / f64::from(SUBSTEPS);
        for _ in 0..SUBSTEPS {
            let frictionless = DynamicsOptions::WITH_ROTORS;
            let qdd = self
                .model
                .forward_dynamics(&self.q, &self.qd, &torques, frictionless)
                .unwrap();
            let inertia = self.model.mass_matrix(&self.q, frictionless);
            for index in 0..DOF {
                self.qd[index] += h * qdd[index];
                if self.friction {
                    // Dry friction slows down and holds; it never turns a motion round.
                    let motor = &self.model.motors[index];
                    let torque = motor.friction_torque(self.qd[index]).abs();
                    let slowed = self.qd[index].abs() - h * torque / inertia[(index, index)];
                    self.qd[index] = slowed.max(0.0).copysign(self.qd[index]);
                }
                self.q[index] += h * self.qd[index];
            }
            if self.knobs.fault.load(Ordering::Relaxed) == 4 {
                self.qd[0] = 0.0;
                self.q[0] = START[0];
            }
        }
        match self.knobs.fault.load(Ordering::Relaxed) {
            2 => Err(fault()),
            _ => Ok(()),
        }
    }
}
