//! How a hand moves what it holds: along a circle, to and fro, in jumps, or as people do. Places over time, and no tasks.
//!
//! Every motion begins at rest at its home, and its speed has no steps.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;

/// A circle or a sweep begins as softly as this, s.
const SOFT: f64 = 1.5;

/// What trembles in a hand: amplitude, m, and frequency, Hz.
const TREMOR: (f64, f64) = (0.0004, 7.0);

/// Which way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Stays at home.
    Rest,
    /// A circle through home, whose radius is the reach along y. The reaches along x and z tilt its plane.
    Circle,
    /// To and fro along a line through home.
    Sweep,
    /// From place to place with a constant acceleration and as much deceleration, and a stop at each.
    Saccade,
    /// Slow ways, fast ways, jumps and stops in any order, with a tremor.
    Hand,
}

/// Sizes of a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sizes {
    /// Speed of a circle; the largest speed of a sweep, m/s.
    pub speed: f64,
    /// Acceleration of a jump, m/s^2.
    pub acceleration: f64,
    /// How far it goes from home along x, y and z, m.
    pub reach: Vector3<f64>,
}

/// How a way from place to place is timed.
#[derive(Debug, Clone, Copy)]
enum Profile {
    /// Acceleration, then as much deceleration.
    Jump,
    /// With the least jerk (T. Flash and N. Hogan, J. Neuroscience 5, 1985).
    Smooth,
}

/// A way from place to place.
#[derive(Debug, Clone)]
struct Way {
    begin: f64,
    duration: f64,
    from: Vector3<f64>,
    to: Vector3<f64>,
    profile: Profile,
}

impl Way {
    fn at(&self, time: f64) -> Vector3<f64> {
        let share = ((time - self.begin) / self.duration).clamp(0.0, 1.0);
        let done = match self.profile {
            Profile::Jump if share < 0.5 => 2.0 * share * share,
            Profile::Jump => 1.0 - 2.0 * (1.0 - share).powi(2),
            Profile::Smooth => share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share),
        };
        self.from + (self.to - self.from) * done
    }

    fn end(&self) -> f64 {
        self.begin + self.duration
    }
}

/// A motion under way. Times ascend from call to call.
#[derive(Debug, Clone)]
pub struct Motion {
    kind: Kind,
    home: Point3<f64>,
    sizes: Sizes,
    rng: ChaCha8Rng,
    way: Way,
    /// A phase of the tremor for each axis.
    phases: [f64; 3],
}

impl Motion {
    /// At rest at `home`.
    #[must_use]
    pub fn new(kind: Kind, home: Point3<f64>, sizes: Sizes, mut rng: ChaCha8Rng) -> Self {
        let phases = std::array::from_fn(|_| TAU * rng.random::<f64>());
        Self {
            kind,
            home,
            sizes,
            rng,
            way: Way {
                begin: 0.0,
                duration: 0.5,
                from: Vector3::zeros(),
                to: Vector3::zeros(),
                profile: Profile::Smooth,
            },
            phases,
        }
    }

    /// Where it is, so many seconds after its beginning.
    pub fn at(&mut self, time: f64) -> Point3<f64> {
        let (reach, speed) = (self.sizes.reach, self.sizes.speed);
        self.home
            + match self.kind {
                Kind::Rest => Vector3::zeros(),
                Kind::Circle => {
                    let radius = reach.y.max(1e-6);
                    let (sin, cos) = (speed / radius * softly(time)).sin_cos();
                    let across = Vector3::new(reach.x, 0.0, reach.z).try_normalize(0.0);
                    let across = across.unwrap_or_else(Vector3::x);
                    radius * (across * (cos - 1.0) + Vector3::y() * sin)
                }
                Kind::Sweep => {
                    let way = reach.norm().max(1e-6);
                    reach * (speed / way * softly(time)).sin()
                }
                Kind::Saccade => self.along(time, false),
                Kind::Hand => {
                    let wave = |phase: f64| TREMOR.0 * (TAU * TREMOR.1 * time + phase).sin();
                    let [x, y, z] = self.phases.map(wave);
                    let share = (time / SOFT).min(1.0);
                    self.along(time, true) + Vector3::new(x, y, z) * share
                }
            }
    }

    /// On a way from place to place.
    fn along(&mut self, time: f64, as_people: bool) -> Vector3<f64> {
        while time > self.way.end() {
            self.way = self.next(as_people);
        }
        self.way.at(time)
    }

    /// A stop after a way, a way after a stop.
    fn next(&mut self, as_people: bool) -> Way {
        let (begin, from) = (self.way.end(), self.way.to);
        let stood = self.way.from == self.way.to;
        if !stood {
            return Way {
                begin,
                duration: self.rng.random_range(0.15..0.8),
                from,
                to: from,
                profile: Profile::Smooth,
            };
        }
        let place = Vector3::from_fn(|_, _| self.rng.random_range(-1.0..1.0));
        let to = self.sizes.reach.component_mul(&place);
        let length = (to - from).norm();
        let jumps = !as_people || self.rng.next_u32().is_multiple_of(4);
        let (duration, profile) = if jumps {
            let duration = 2.0 * (length / self.sizes.acceleration).sqrt();
            (duration, Profile::Jump)
        } else {
            // The highest speed of such a way is 15/8 of its mean.
            let highest = self.sizes.speed * self.rng.random_range(0.2..1.0);
            (15.0 / 8.0 * length / highest, Profile::Smooth)
        };
        Way {
            begin,
            duration: duration.max(0.05),
            from,
            to,
            profile,
        }
    }
}

/// Time that begins to run softly: the integral of a share that goes from 0 to 1 within [`SOFT`].
fn softly(time: f64) -> f64 {
    if time >= SOFT {
        return time - 0.5 * SOFT;
    }
    let share = (time / SOFT).max(0.0);
    SOFT * share.powi(3) * (1.0 - 0.5 * share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    const STEP: f64 = 1e-3;

    fn places(kind: Kind, seed: u64) -> Vec<Point3<f64>> {
        let sizes = Sizes {
            speed: 0.3,
            acceleration: 2.0,
            reach: Vector3::new(0.12, 0.15, 0.06),
        };
        let home = Point3::new(0.6, -0.1, 1.5);
        let mut motion = Motion::new(kind, home, sizes, ChaCha8Rng::seed_from_u64(seed));
        (0..20_000)
            .map(|step| motion.at(f64::from(step) * STEP))
            .collect()
    }

    const ALL: [Kind; 5] = [
        Kind::Rest,
        Kind::Circle,
        Kind::Sweep,
        Kind::Saccade,
        Kind::Hand,
    ];

    #[test]
    fn every_motion_begins_at_rest_at_home_and_has_no_steps_of_its_speed() {
        for kind in ALL {
            for seed in 0..5 {
                let all = places(kind, seed);
                let speeds: Vec<Vector3<f64>> =
                    all.windows(2).map(|two| (two[1] - two[0]) / STEP).collect();
                assert!(
                    (all[0] - Point3::new(0.6, -0.1, 1.5)).norm() < 1e-12,
                    "{kind:?}"
                );
                assert!(speeds[0].norm() < 0.02, "{kind:?}: {}", speeds[0].norm());
                for two in speeds.windows(2) {
                    let change = (two[1] - two[0]).norm();
                    // A tremor of 0.4 mm at 7 Hz has 1.3 m/s^2.
                    assert!(change < 6.0 * STEP, "{kind:?}: {change}");
                }
            }
        }
    }

    #[test]
    fn circle_and_sweep_have_their_speed_and_a_jump_its_acceleration() {
        let fastest = |kind| {
            let all = places(kind, 1);
            let speeds = all.windows(2).map(|two| (two[1] - two[0]).norm() / STEP);
            speeds.fold(0.0, f64::max)
        };
        assert!((fastest(Kind::Sweep) - 0.3).abs() < 0.003);
        assert!((fastest(Kind::Circle) - 0.3).abs() < 0.003);
        let all = places(Kind::Saccade, 3);
        let changes = all
            .windows(3)
            .map(|at| ((at[2] - at[1]) - (at[1] - at[0])).norm() / (STEP * STEP));
        let largest = changes.fold(0.0, f64::max);
        assert!((1.9..4.1).contains(&largest), "{largest}");
    }

    #[test]
    fn a_seed_is_one_motion_and_nothing_leaves_its_reach() {
        for kind in ALL {
            assert_eq!(places(kind, 7), places(kind, 7));
            for place in places(kind, 7) {
                let off = place - Point3::new(0.6, -0.1, 1.5);
                assert!(off.x.abs() < 0.301 && off.y.abs() < 0.152 && off.z.abs() < 0.135);
            }
        }
        assert_ne!(places(Kind::Hand, 7), places(Kind::Hand, 8));
    }
}
