//! A six-axis force-torque sensor at a frame of an arm: what its electronics make of what acts on it.
//!
//! A wrench is a force (N) and a moment (N m) about the sensor's origin, in the sensor's frame: that which what hangs behind
//! the sensor, and whatever touches that, exert on it. Hanging still, 1 kg reads as 9.81 N downwards. Knows no engine.

use std::{f64::consts::TAU, time::Duration};

use nalgebra::{Rotation3, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

use crate::engine::GRAVITY;

/// A force (N), then a moment (N m).
pub type Wrench = [f64; 6];

/// A mass on a point, in the sensor's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// kg.
    pub mass: f64,
    /// m.
    pub centre: Vector3<f64>,
}

impl Default for Load {
    fn default() -> Self {
        Self {
            mass: 0.0,
            centre: Vector3::zeros(),
        }
    }
}

impl Load {
    /// The wrench of a load at rest where things fall with `gravity` (m/s^2, sensor's frame).
    #[must_use]
    pub fn weight(&self, gravity: &Vector3<f64>) -> Wrench {
        let force = gravity * self.mass;
        let moment = self.centre.cross(&force);
        [force.x, force.y, force.z, moment.x, moment.y, moment.z]
    }
}

/// What the electronics of a sensor do.
#[derive(Debug, Clone, PartialEq)]
pub struct Electronics {
    /// Read with nothing on it, N and N m.
    pub bias: Wrench,
    /// Standard deviation of the noise of each sample, N and N m.
    pub noise: [f64; 2],
    /// Corner of the filter of first order, Hz; infinite for none.
    pub filter_hz: f64,
    /// Of the noise.
    pub seed: u64,
}

impl Default for Electronics {
    fn default() -> Self {
        Self {
            bias: [0.0; 6],
            noise: [0.0; 2],
            filter_hz: f64::INFINITY,
            seed: 1,
        }
    }
}

/// A sensor with its state.
#[derive(Debug, Clone)]
pub struct Wrist {
    electronics: Electronics,
    random: ChaCha8Rng,
    filtered: Option<Wrench>,
}

impl Wrist {
    /// A sensor that has sampled nothing.
    #[must_use]
    pub fn new(electronics: Electronics) -> Self {
        Self {
            random: ChaCha8Rng::seed_from_u64(electronics.seed),
            electronics,
            filtered: None,
        }
    }

    /// What it reads `period` after the sample before, when `wrench` acts on it and it stands so in the world. The weight
    /// of what it knows to hang on it is taken off.
    pub fn sample(
        &mut self,
        wrench: &Wrench,
        world: &Rotation3<f64>,
        known: &Load,
        period: Duration,
    ) -> Wrench {
        let gravity = world.inverse() * Vector3::new(0.0, 0.0, -GRAVITY);
        let own = known.weight(&gravity);
        let sample: Wrench = std::array::from_fn(|axis| {
            let unit: f64 = StandardNormal.sample(&mut self.random);
            let noise = unit * self.electronics.noise[axis / 3];
            wrench[axis] + self.electronics.bias[axis] + noise - own[axis]
        });
        let corner = self.electronics.filter_hz;
        let share = match corner.is_finite() {
            true => 1.0 - (-TAU * corner * period.as_secs_f64()).exp(),
            false => 1.0,
        };
        // The first sample has nothing before it that it could be mixed with.
        let before = self.filtered.unwrap_or(sample);
        let now = std::array::from_fn(|axis| before[axis] + share * (sample[axis] - before[axis]));
        self.filtered = Some(now);
        now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_micros(4500);

    #[test]
    fn a_known_weight_reads_as_itself_in_any_turn_of_the_sensor() {
        let load = Load {
            mass: 2.0,
            centre: Vector3::new(0.0, 0.0, 0.1),
        };
        for turn in [[0.0, 0.0, 0.0], [1.2, -0.4, 2.0], [3.1, 0.2, -1.0]] {
            let world = Rotation3::from_euler_angles(turn[0], turn[1], turn[2]);
            let gravity = world.inverse() * Vector3::new(0.0, 0.0, -GRAVITY);
            let acts = load.weight(&gravity);
            let mut wrist = Wrist::new(Electronics::default());
            let read = wrist.sample(&acts, &world, &Load::default(), PERIOD);
            let force = world * Vector3::new(read[0], read[1], read[2]);
            assert!((force - Vector3::new(0.0, 0.0, -2.0 * GRAVITY)).norm() < 1e-12);
            // What is taken off leaves nothing.
            let read = wrist.sample(&acts, &world, &load, PERIOD);
            assert!(read.iter().all(|number| number.abs() < 1e-12), "{read:?}");
        }
    }

    #[test]
    fn noise_comes_from_its_seed_and_has_its_deviation_and_bias_stays() {
        let electronics = Electronics {
            bias: [1.0, 0.0, -2.0, 0.1, 0.0, 0.0],
            noise: [0.5, 0.02],
            ..Electronics::default()
        };
        let sample = |seed: u64| -> Vec<Wrench> {
            let mut wrist = Wrist::new(Electronics {
                seed,
                ..electronics.clone()
            });
            let level = Rotation3::identity();
            (0..4000)
                .map(|_| wrist.sample(&[0.0; 6], &level, &Load::default(), PERIOD))
                .collect()
        };
        let one = sample(7);
        assert_eq!(one, sample(7));
        assert_ne!(one, sample(8));
        for axis in 0..6 {
            let mean = one.iter().map(|wrench| wrench[axis]).sum::<f64>() / 4000.0;
            let square = one.iter().map(|wrench| (wrench[axis] - mean).powi(2));
            let deviation = (square.sum::<f64>() / 4000.0).sqrt();
            let expected = electronics.noise[axis / 3];
            // Five deviations of the mean, and of the deviation.
            assert!(
                (mean - electronics.bias[axis]).abs() < 5.0 * expected / 63.0,
                "{axis}"
            );
            assert!((deviation / expected - 1.0).abs() < 5.0 / 89.0, "{axis}");
        }
    }

    #[test]
    fn a_sensor_without_a_filter_reads_at_once_whatever_the_period() {
        let mut wrist = Wrist::new(Electronics::default());
        let level = Rotation3::identity();
        for (count, period) in [(0.0, Duration::ZERO), (1.0, PERIOD), (2.0, Duration::ZERO)] {
            assert_eq!(
                wrist.sample(&[count; 6], &level, &Load::default(), period),
                [count; 6]
            );
        }
    }

    #[test]
    fn a_step_has_come_through_the_filter_by_the_known_share() {
        let mut wrist = Wrist::new(Electronics {
            filter_hz: 10.0,
            ..Electronics::default()
        });
        let level = Rotation3::identity();
        wrist.sample(&[0.0; 6], &level, &Load::default(), PERIOD);
        for count in 1..100 {
            let read = wrist.sample(&[1.0; 6], &level, &Load::default(), PERIOD);
            let expected = 1.0 - (-TAU * 10.0 * 4.5e-3 * f64::from(count)).exp();
            assert!((read[2] - expected).abs() < 1e-12);
        }
    }
}
