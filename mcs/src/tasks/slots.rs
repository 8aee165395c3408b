//! What those who watch a manipulator are told of its slots, and why it was stopped last.

use crate::client::{JointReport, SensorReport, SlotsReport};
use crate::driver::Sensor;
use crate::guard::Reaction;
use crate::model::Model;
use crate::servo::{Fault, ServoStatus};

/// All slots of an arm.
pub fn report(
    model: &Model,
    status: &ServoStatus,
    sensors: &[Sensor],
    last_stop: Option<String>,
) -> SlotsReport {
    let at = |values: &[f64], index: usize| values.get(index).copied().unwrap_or_default();
    let joints = model.joints().iter().enumerate();
    let joints = joints.map(|(index, joint)| JointReport {
        name: joint.name.clone(),
        kind: joint.kind,
        position: at(&status.position, index),
        velocity: at(&status.velocity, index),
        setpoint: at(&status.setpoint, index),
        torque: at(&status.torque, index),
        range: [joint.limits.lower, joint.limits.upper],
        most_torque: joint.limits.torque,
    });
    SlotsReport {
        joints: joints.collect(),
        sensors: sensor_report(status, sensors),
        last_stop,
    }
}

/// What the sensors read last, and which of them are stale.
pub fn sensor_report(status: &ServoStatus, sensors: &[Sensor]) -> SensorReport {
    let named = sensors.iter().enumerate();
    let stale = named.filter(|(index, _)| status.stale >> index & 1 == 1);
    SensorReport {
        sensors: sensors.to_vec(),
        numbers: status.sensors.to_vec(),
        stale: stale.map(|(_, sensor)| sensor.name.clone()).collect(),
    }
}

/// Why the arm was stopped last, as far as this was seen.
#[derive(Debug, Default)]
pub struct LastStop {
    why: Option<String>,
    fault: Option<Fault>,
    /// The motion that a guard stopped last.
    guarded: u64,
}

impl LastStop {
    /// Somebody asks for a stop; why it is one, in words.
    pub fn asked(&mut self, why: &str) {
        self.why = Some(why.to_owned());
    }

    /// Looks whether something else has stopped it, `fault` in words; why it was stopped last.
    pub fn see(&mut self, status: &ServoStatus, fault: Option<String>) -> Option<String> {
        let found = status
            .guard
            .filter(|found| found.reaction != Reaction::Report && found.motion != self.guarded);
        if let Some(found) = found {
            self.guarded = found.motion;
            self.why = Some(format!("guard `{}`: {}", found.guard, found.measured));
        }
        if status.fault != self.fault {
            self.fault = status.fault;
            self.why = fault.or_else(|| self.why.take());
        }
        self.why.clone()
    }
}
