//! Computed torque on two processors: a law whose half that knows the model runs in a task of its own (CIRSSE report 108,
//! section 3: a control algorithm that executes on multiple processors).
//!
//! In each tick the law posts where the joints are and how fast. Its other half, [`Half`], answers with the mass matrix there
//! and with the torques that keep the joints at their speeds. The tick is the barrier: the law counts with the answer to the
//! tick before, whichever processor was first, and so with the same bits on two processors as on one. It waits for nobody.
//! While an answer is late it goes on with the one before, for [`PATIENCE`] ticks; then it gives up.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use ctos::task::Context;

use super::ControlLaw;
use super::integral::Integral;
use crate::driver::SlotReading;
use crate::guard::Words;
use crate::latest::Latest;
use crate::model::{Data, DynamicsOptions, Model};
use crate::trajectory::Setpoint;
use crate::words;

/// Name of the law.
pub const SPLIT_TORQUE: &str = "split_torque";

/// So many ticks an answer may be late.
pub const PATIENCE: u32 = 3;

/// What both halves of a law share: a question and an answer, each the latest of its side.
#[derive(Debug)]
pub struct Exchange {
    joints: usize,
    /// Number, positions, speeds.
    asked: Latest,
    /// Number, mass matrix, torques.
    answered: Latest,
}

impl Exchange {
    /// Of an arm with so many joints.
    #[must_use]
    pub fn new(joints: usize) -> Arc<Self> {
        Arc::new(Self {
            joints,
            asked: Latest::new(&vec![0.0; 1 + 2 * joints]),
            answered: Latest::new(&vec![0.0; answer_length(joints)]),
        })
    }

    /// The one of the law of the servo task called `servo` on this chassis, for an arm with so many joints.
    #[must_use]
    pub fn of(cx: &Context, servo: &str, joints: usize) -> Arc<Self> {
        let key = format!("mcs.split_torque/{servo}");
        let known = cx.shared::<Self>(&key);
        known.filter(|one| one.joints == joints).unwrap_or_else(|| {
            let new = Self::new(joints);
            cx.share(&key, Arc::clone(&new));
            new
        })
    }
}

fn answer_length(joints: usize) -> usize {
    1 + joints * joints + joints
}

/// The half of the law that computes what the model says.
#[derive(Debug)]
pub struct Half {
    exchange: Arc<Exchange>,
    model: Arc<Model>,
    data: Data,
    asked: Vec<f64>,
    answer: Vec<f64>,
    still: Vec<f64>,
}

impl Half {
    /// One that answers at `exchange`.
    #[must_use]
    pub fn new(model: Arc<Model>, exchange: Arc<Exchange>) -> Self {
        let n = model.dof();
        Self {
            exchange,
            data: model.data(),
            asked: vec![0.0; 1 + 2 * n],
            answer: vec![0.0; answer_length(n)],
            still: vec![0.0; n],
            model,
        }
    }

    /// Answers the latest question, unless it has. Neither allocates, locks nor waits.
    pub fn tick(&mut self) {
        let before = self.asked.first().copied();
        self.exchange.asked.read(&mut self.asked);
        if self.asked.first().copied() != before {
            self.compute();
            let answer = self.answer.iter().copied();
            self.exchange.answered.write(answer);
        }
    }

    fn compute(&mut self) {
        let options = DynamicsOptions::WITH_ROTORS;
        let n = self.still.len();
        let (number, state) = self.asked.split_at(1);
        let (position, velocity) = state.split_at(n);
        let (own, rest) = self.answer.split_at_mut(1);
        let (matrix, torques) = rest.split_at_mut(n * n);
        own.copy_from_slice(number);
        let mass = self.model.mass_matrix(&mut self.data, position, options);
        matrix.copy_from_slice(mass.as_slice());
        let (data, still) = (&mut self.data, &self.still);
        let keep = self
            .model
            .inverse_dynamics(data, position, velocity, still, options);
        torques.copy_from_slice(keep);
    }
}

/// The half that runs in the servo's tick: a PD on the error, through the model of the tick before.
#[derive(Debug)]
pub struct SplitTorque {
    exchange: Arc<Exchange>,
    /// Computes the first tick, before which nobody was asked.
    first: Half,
    began: bool,
    /// 1/s^2 and 1/s.
    stiffness: f64,
    damping: f64,
    integral: Integral,
    /// Counts the questions.
    number: f64,
    answer: Vec<f64>,
    newest: Vec<f64>,
    wanted: Vec<f64>,
    gave_up: Option<Words>,
}

impl SplitTorque {
    /// The law with errors that die out at `bandwidth` Hz and `damping` ratio, whose other half is at `exchange`.
    #[must_use]
    pub fn new(model: Arc<Model>, bandwidth: f64, damping: f64, exchange: Arc<Exchange>) -> Self {
        let n = model.dof();
        let answer = vec![0.0; answer_length(n)];
        let mut law = Self {
            first: Half::new(model, Arc::clone(&exchange)),
            exchange,
            began: false,
            stiffness: 0.0,
            damping: 0.0,
            integral: Integral::new(n, bandwidth),
            number: 0.0,
            newest: answer.clone(),
            answer,
            wanted: vec![0.0; n],
            gave_up: None,
        };
        law.tune(bandwidth, damping);
        law
    }

    /// Takes the newest answer, if it is one to this law, and gives up when that is too old.
    fn take(&mut self) {
        if !std::mem::replace(&mut self.began, true) {
            self.first.compute();
            self.answer.copy_from_slice(&self.first.answer);
            return;
        }
        self.exchange.answered.read(&mut self.newest);
        let newer = self.answer[0]..self.number;
        // One to a law before this may have any number.
        if newer.contains(&self.newest[0]) {
            self.answer.copy_from_slice(&self.newest);
        }
        let late = self.number - 1.0 - self.answer[0];
        if late > f64::from(PATIENCE) {
            self.gave_up = Some(words!(
                "its half on the other processor has not answered for {late} ticks; does task `mcs.split_torque` run?"
            ));
        }
    }
}

impl ControlLaw for SplitTorque {
    fn reset(&mut self, _readings: &[SlotReading]) {
        self.began = false;
        self.gave_up = None;
        self.integral.reset();
    }

    fn tune(&mut self, bandwidth: f64, damping: f64) {
        let natural = TAU * bandwidth;
        self.stiffness = natural * natural;
        self.damping = 2.0 * damping * natural;
        self.integral.tune(bandwidth);
    }

    fn gave_up(&self) -> Option<Words> {
        self.gave_up
    }

    fn torques(
        &mut self,
        setpoint: &Setpoint,
        readings: &[SlotReading],
        period: Duration,
        out: &mut [f64],
    ) {
        let n = self.wanted.len();
        self.number += 1.0;
        let asked = &mut self.first.asked;
        asked[0] = self.number;
        for (index, reading) in readings.iter().enumerate().take(n) {
            asked[1 + index] = reading.position;
            asked[1 + n + index] = reading.velocity;
            self.wanted[index] = setpoint.acceleration[index]
                + self.stiffness * (setpoint.position[index] - reading.position)
                + self.damping * (setpoint.velocity[index] - reading.velocity);
        }
        self.exchange.asked.write(asked.iter().copied());
        self.take();
        let (matrix, torques) = self.answer[1..].split_at(n * n);
        for (index, (out, torque)) in out.iter_mut().zip(torques).enumerate() {
            let columns = self.wanted.iter().enumerate();
            let own = columns.map(|(column, wanted)| matrix[column * n + index] * wanted);
            let (torque, inertia) = (own.sum::<f64>() + torque, matrix[index * n + index]);
            let error = setpoint.position[index] - self.first.asked[1 + index];
            let limit = self.first.model.joints()[index].limits.torque;
            let integral = &mut self.integral;
            *out = integral.added_to(torque, index, (inertia, error), limit, period);
        }
    }
}
