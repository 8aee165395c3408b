use nalgebra::{Matrix3, RowVector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

const PERIOD: f64 = 0.04;

/// How far ahead predictions are held against what came, s.
const AHEAD: [f64; 2] = [0.1, 0.3];

/// A Kalman filter of one axis with a random walk of the acceleration, which knows stamps and statistics: nothing of it is in
/// what it is compared with.
struct Kalman {
    state: Vector3<f64>,
    spread: Matrix3<f64>,
    at: f64,
    agility: f64,
    sigma: f64,
}

impl Kalman {
    fn new(at: f64, z: f64, agility: f64, sigma: f64) -> Self {
        Self {
            state: Vector3::new(z, 0.0, 0.0),
            spread: Matrix3::from_diagonal(&Vector3::new(sigma * sigma, 1.0, 10.0)),
            at,
            agility,
            sigma,
        }
    }

    fn step(dt: f64) -> Matrix3<f64> {
        Matrix3::new(1.0, dt, 0.5 * dt * dt, 0.0, 1.0, dt, 0.0, 0.0, 1.0)
    }

    fn measure(&mut self, at: f64, z: f64) {
        let dt = at - self.at;
        let step = Self::step(dt);
        // The integral of white jerk.
        let (q, t) = (self.agility * self.agility, dt);
        let noise = Matrix3::new(
            t.powi(5) / 20.0,
            t.powi(4) / 8.0,
            t.powi(3) / 6.0,
            t.powi(4) / 8.0,
            t.powi(3) / 3.0,
            t * t / 2.0,
            t.powi(3) / 6.0,
            t * t / 2.0,
            t,
        ) * q;
        self.state = step * self.state;
        self.spread = step * self.spread * step.transpose() + noise;
        let see = RowVector3::new(1.0, 0.0, 0.0);
        let gain = self.spread * see.transpose() / (self.spread[(0, 0)] + self.sigma * self.sigma);
        self.state += gain * (z - self.state.x);
        self.spread = (Matrix3::identity() - gain * see) * self.spread;
        self.at = at;
    }

    fn ahead(&self, now: f64) -> f64 {
        (Self::step(now - self.at) * self.state).x
    }
}

/// Places of a ball over time: along one axis.
fn circle(t: f64) -> f64 {
    0.15 * (0.2 / 0.15 * t).sin()
}

fn sweep(t: f64) -> f64 {
    0.2 * (2.5 * t).sin()
}

/// To and fro with 2 m/s^2, and stops.
fn saccade(t: f64) -> f64 {
    let (way, half) = (0.2, (0.2_f64 / 2.0).sqrt());
    let cycle = 4.0 * half + 1.0;
    let t = t.rem_euclid(cycle);
    let go = |t: f64| {
        let share = (t / (2.0 * half)).clamp(0.0, 1.0);
        way * if share < 0.5 {
            2.0 * share * share
        } else {
            1.0 - 2.0 * (1.0 - share).powi(2)
        }
    };
    if t < 2.0 * half + 0.5 {
        go(t)
    } else {
        way - go(t - 2.0 * half - 0.5)
    }
}

/// Root mean squares of the error of the filter, of the Kalman filter, and without prediction, at moments between measurements
/// that arrive late.
fn errors(motion: fn(f64) -> f64, latency: [f64; 2], agility: f64, seed: u64) -> [f64; 3] {
    let sigma = 0.000_5;
    let args = TargetArgs {
        sigma_m: sigma,
        manners: [Manner {
            agility,
            manoeuvre_s: 0.25,
        }; 3],
        ..TargetArgs::default()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let mut arrivals = Vec::new();
    for step in 0..750 {
        let at = f64::from(step) * PERIOD;
        let late = latency[0] + latency[1] * normal().clamp(-2.0, 2.0);
        arrivals.push((at + late.max(0.0), at, motion(at) + sigma * normal()));
    }
    arrivals.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut target = Target::new(args);
    let mut kalman: Option<Kalman> = None;
    let mut sums = [0.0; 3];
    let (mut next, mut count) = (0, 0.0);
    for tick in 0..6600 {
        let now = f64::from(tick) * 0.0045;
        while let Some((_, at, z)) = arrivals.get(next).filter(|arrival| arrival.0 <= now) {
            next += 1;
            if target.measure(*at, &Point3::new(*z, 0.0, 0.0), AHEAD) == Taken::Late {
                continue;
            }
            match &mut kalman {
                Some(kalman) => kalman.measure(*at, *z),
                None => kalman = Some(Kalman::new(*at, *z, agility, sigma)),
            }
        }
        if now < 3.0 {
            continue;
        }
        let truth = motion(now);
        let ours = target.at(now).unwrap().place.x - truth;
        let theirs = kalman.as_ref().unwrap().ahead(now) - truth;
        let last = target.last(now).unwrap().place.x - truth;
        for (sum, error) in sums.iter_mut().zip([ours, theirs, last]) {
            *sum += error * error;
        }
        count += 1.0;
    }
    sums.map(|sum: f64| (sum / count).sqrt())
}

#[test]
#[allow(clippy::print_stdout, reason = "what was measured is told, too")]
fn the_estimate_is_as_good_as_a_kalman_filters_and_far_better_than_none() {
    type Motion = (&'static str, fn(f64) -> f64, f64);
    let motions: [Motion; 3] = [
        ("circle", circle, 1.0),
        ("sweep", sweep, 3.0),
        ("saccade", saccade, 8.0),
    ];
    for (name, motion, agility) in motions {
        for latency in [[0.04, 0.0], [0.11, 0.02], [0.2, 0.0]] {
            let mut sums = [0.0; 3];
            for seed in 0..20 {
                let found = errors(motion, latency, agility, seed);
                for (sum, error) in sums.iter_mut().zip(found) {
                    *sum += error * error / 20.0;
                }
            }
            let [ours, kalman, last] = sums.map(f64::sqrt);
            println!("{name} {latency:?}: {ours:.5} m, Kalman {kalman:.5}, without {last:.5}");
            assert!(
                ours <= 1.15 * kalman,
                "{name} {latency:?}: {ours} and {kalman}"
            );
            // A jump that nobody can foresee costs about as much as it is late.
            let least = if name == "saccade" { 1.3 } else { 2.0 };
            assert!(
                last >= least * ours,
                "{name} {latency:?}: {ours} and {last}"
            );
        }
    }
}

fn at(x: f64) -> Point3<f64> {
    Point3::new(x, 0.0, 0.0)
}

/// A target that moves evenly along x, measured until 1 s.
fn moving() -> Target {
    let mut target = Target::new(TargetArgs::default());
    for step in 0..=25 {
        let time = f64::from(step) * PERIOD;
        target.measure(time, &at(0.3 * time), AHEAD);
    }
    target
}

#[test]
fn an_even_motion_is_predicted_without_an_error() {
    let found = moving().at(1.1).unwrap();
    assert!((found.place - at(0.33)).norm() < 1e-6, "{found:?}");
    assert!((found.velocity.x - 0.3).abs() < 1e-5 && !found.expired);
}

#[test]
fn after_the_expiry_the_motion_decays_without_a_step_of_speed() {
    let target = moving();
    let mut before = target.at(1.0).unwrap();
    for step in 1..1000 {
        let now = 1.0 + f64::from(step) * 0.001;
        let found = target.at(now).unwrap();
        let change = (found.velocity - before.velocity).norm();
        assert!(change < 0.3 / 0.15 * 0.001 + 1e-6, "{now}: {change}");
        assert!((found.place - before.place).norm() < 0.31 * 0.001);
        assert_eq!(found.expired, now > 1.5 + 1e-9, "{now}");
        before = found;
    }
    assert!(target.at(3.0).unwrap().velocity.norm() < 1e-4);
}

#[test]
fn what_comes_out_of_order_or_twice_or_is_no_number_changes_nothing() {
    let mut target = moving();
    let before = target.at(1.1);
    assert_eq!(target.measure(0.96, &at(0.0), AHEAD), Taken::Late);
    assert_eq!(target.measure(1.0, &at(0.3), AHEAD), Taken::Late);
    assert_eq!(target.measure(1.04, &at(f64::NAN), AHEAD), Taken::Wrong);
    assert_eq!(target.measure(f64::NAN, &at(0.3), AHEAD), Taken::Wrong);
    assert_eq!(target.measure(1.04, &at(0.9), AHEAD), Taken::Far);
    assert_eq!(target.at(1.1), before);
}

#[test]
fn a_target_that_is_elsewhere_for_long_is_taken_there() {
    let mut target = moving();
    let mut taken = Vec::new();
    for step in 1..20 {
        taken.push(target.measure(1.0 + f64::from(step) * PERIOD, &at(0.9), AHEAD));
    }
    assert_eq!(taken[0], Taken::Far);
    assert!(taken.contains(&Taken::Begun), "{taken:?}");
    assert!((target.at(1.8).unwrap().place - at(0.9)).norm() < 0.01);
}

#[test]
fn a_target_that_comes_back_after_an_expiry_begins_at_rest() {
    let mut target = moving();
    assert_eq!(target.measure(2.0, &at(0.1), AHEAD), Taken::Begun);
    let found = target.at(2.0).unwrap();
    assert_eq!((found.place, found.velocity), (at(0.1), Vector3::zeros()));
}

#[test]
fn a_target_that_is_held_still_does_not_tremble() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut speeds = |still: f64| {
        let args = TargetArgs {
            still_m_s: still,
            manners: [Manner {
                agility: 1.0,
                manoeuvre_s: 0.25,
            }; 3],
            ..TargetArgs::default()
        };
        let mut target = Target::new(args);
        let mut sum = 0.0;
        for step in 0..500 {
            let noise: f64 = StandardNormal.sample(&mut rng);
            let time = f64::from(step) * PERIOD;
            target.measure(time, &at(0.000_3 * noise), AHEAD);
            sum += target.at(time + 0.02).unwrap().velocity.norm();
        }
        sum / 500.0
    };
    let (free, damped) = (speeds(1e-6), speeds(0.03));
    assert!(damped < 0.5 * free, "{damped} and {free}");
}

proptest! {
    #[test]
    fn whatever_comes_every_prediction_is_finite(seed in 0..1000_u64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut target = Target::new(TargetArgs::default());
        let mut now = 0.0;
        for _ in 0..200 {
            now += rng.random_range(-0.05..0.4);
            let place = at(rng.random_range(-0.2..0.2));
            target.measure(now, &place, AHEAD);
            let found = target.at(now + rng.random_range(0.0..2.0));
            let finite = found.is_none_or(|found| {
                let mut numbers = found.place.iter().chain(found.velocity.iter());
                numbers.all(|number| number.is_finite())
            });
            prop_assert!(finite);
        }
    }
}
