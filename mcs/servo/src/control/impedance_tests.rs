//! An arm that something pushes, held by a law at the servo's rate: what the tests of the impedances share.

use std::sync::{Arc, LazyLock};
use std::time::Duration;

use super::ControlLaw;
use crate::driver::SlotReading;
use crate::joints::Joints;
use crate::model::{Data, DynamicsOptions, Model, built_in, file::Inertias};
use crate::trajectory::Setpoint;

pub(super) const PERIOD: Duration = Duration::from_micros(4500);

/// Steps of integration in a period.
const STEPS: u32 = 4;

/// One model for all, because to read its file takes longer than a tick.
pub(super) fn puma() -> Arc<Model> {
    static PUMA: LazyLock<Arc<Model>> = LazyLock::new(|| {
        let model = built_in::model("puma560", Inertias::Engine);
        Arc::new(model.unwrap().unwrap())
    });
    PUMA.clone()
}

/// The PUMA without friction, its setpoint where it began.
pub(super) struct Pushed {
    model: Arc<Model>,
    data: Data,
    setpoint: Setpoint,
    pub(super) q: Vec<f64>,
    pub(super) qd: Vec<f64>,
    /// Torques from outside, N m.
    pub(super) push: Vec<f64>,
}

impl Pushed {
    pub(super) fn new(start: [f64; 6], push: [f64; 6]) -> Self {
        let model = puma();
        Self {
            data: model.data(),
            model,
            setpoint: Setpoint::at_rest(Joints::from(start)),
            q: start.to_vec(),
            qd: vec![0.0; 6],
            push: push.to_vec(),
        }
    }

    /// Goes on for so many seconds.
    pub(super) fn run(&mut self, law: &mut dyn ControlLaw, seconds: f64) {
        let h = PERIOD.as_secs_f64() / f64::from(STEPS);
        for _ in 0..(seconds / PERIOD.as_secs_f64()).round() as u64 {
            let pairs = self.q.iter().zip(&self.qd);
            let readings: Vec<SlotReading> = pairs
                .map(|(position, velocity)| SlotReading {
                    position: *position,
                    velocity: *velocity,
                })
                .collect();
            let mut torques = [0.0; 6];
            law.torques(&self.setpoint, &readings, PERIOD, &mut torques);
            let all: Vec<f64> = torques
                .iter()
                .zip(&self.push)
                .map(|(own, push)| own + push)
                .collect();
            for _ in 0..STEPS {
                let options = DynamicsOptions::WITH_ROTORS;
                let model = &self.model;
                let found =
                    model.forward_dynamics(&mut self.data, &self.q, &self.qd, &all, options);
                for (joint, rate) in found.unwrap().iter().enumerate() {
                    self.qd[joint] += h * rate;
                    self.q[joint] += h * self.qd[joint];
                }
            }
        }
    }
}
