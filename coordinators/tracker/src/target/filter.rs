//! One filter of a target: how it believes that targets move, where that target is, and how well it foretold it so far.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use vss::tracking::{Gains, Track};

/// No interval counts as longer in the gains, s: beyond that the last measurement says everything.
const LONGEST_INTERVAL: f64 = 1.0;

/// Measurements after a beginning during which the gains are those of a growing memory.
const FADING: u32 = 12;

/// States that are kept for a look back.
const KEPT: usize = 128;

/// What was foretold is forgotten with this time constant, s: by errors, and by the worth.
const MEMORY: [f64; 2] = [1.0, 3.0];

/// What motions are worth before any was seen, and the way that counts as one, m.
const BEFORE: (f64, f64) = (0.6, 0.003);

/// How a target moves.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manner {
    /// How fast the acceleration changes: its standard deviation after 1 s, m/s^2. It goes with the root of the time.
    pub agility: f64,
    /// For how long the acceleration is believed to go on: its time constant in a prediction, s.
    pub manoeuvre_s: f64,
}

impl Manner {
    /// The gains for an interval, s, with measurements that have this standard deviation, m.
    fn gains(&self, interval: f64, sigma: f64) -> Option<Gains> {
        let interval = interval.min(LONGEST_INTERVAL);
        let change = self.agility * interval.sqrt();
        Gains::of(change * interval * interval / sigma)
    }

    /// The way of a target until so much later, m, and how fast it is then, m/s. The acceleration decays, so both are its integrals.
    pub(super) fn ahead(&self, tracks: &[Track; 3], later: f64) -> [Vector3<f64>; 2] {
        let [velocity, acceleration] = [|track: &Track| track.v, |track: &Track| track.a]
            .map(|pick| Vector3::from(tracks.each_ref().map(pick)));
        let lasts = self.manoeuvre_s;
        let gone = lasts * (1.0 - (-later / lasts).exp());
        [
            velocity * later + acceleration * (lasts * (later - gone)),
            velocity + acceleration * gone,
        ]
    }
}

/// Where a state is.
pub(super) fn place(tracks: &[Track; 3]) -> Point3<f64> {
    Point3::from(tracks.map(|track| track.x))
}

/// A filter.
#[derive(Debug, Clone)]
pub(super) struct Filter {
    pub(super) manner: Manner,
    pub(super) tracks: [Track; 3],
    /// States after earlier measurements, with their moments, s.
    before: VecDeque<(f64, [Track; 3])>,
    /// Mean square of what it foretold less what came, m^2.
    pub(super) error: f64,
    /// Products of the ways that it foretold: with those that the target went, and with themselves, m^2.
    went: [f64; 2],
}

impl Filter {
    /// Of a target at rest.
    pub(super) fn new(manner: Manner) -> Self {
        let (worth, way) = BEFORE;
        Self {
            manner,
            tracks: [Track::at_rest(0.0); 3],
            before: VecDeque::new(),
            error: 0.0,
            went: [worth * way * way, way * way],
        }
    }

    /// The target is there, at rest. How well it was foretold before still counts.
    pub(super) fn begin(&mut self, at: f64, place: &Point3<f64>) {
        for (track, x) in self.tracks.iter_mut().zip(place.iter()) {
            *track = Track::at_rest(*x);
        }
        self.before.clear();
        self.before.push_back((at, self.tracks));
    }

    /// Where it expects the target after an interval, s.
    pub(super) fn expected(&self, interval: f64) -> Point3<f64> {
        place(&self.tracks.map(|track| track.predicted(interval)))
    }

    /// Takes a measurement in, which is the `taken`-th after a beginning, an interval after the one before, s.
    pub(super) fn correct(&mut self, z: &Point3<f64>, interval: f64, sigma: f64, taken: u32) {
        let Some(gains) = self.manner.gains(interval, sigma) else {
            return;
        };
        let gains = faded(gains, taken);
        for (track, z) in self.tracks.iter_mut().zip(z.iter()) {
            *track = track.predicted(interval).corrected(*z, gains, interval);
        }
    }

    /// Looks back from a measurement: what was foretold `ahead` of it, and what motions `further` ahead were worth, s.
    pub(super) fn look_back(&mut self, at: f64, z: &Point3<f64>, interval: f64, ahead: [f64; 2]) {
        let [ahead, further] = ahead.map(|ahead| at - ahead + 1e-9);
        if let Some((since, tracks)) = self.known(ahead) {
            let [way, _] = self.manner.ahead(tracks, at - since);
            let error = (place(tracks) + way - z).norm_squared();
            let share = 1.0 - (-interval / MEMORY[0]).exp();
            self.error += (error - self.error) * share;
        }
        if let Some((since, tracks)) = self.known(further) {
            let ([way, _], went) = (self.manner.ahead(tracks, at - since), z - place(tracks));
            let kept = (-interval / MEMORY[1]).exp();
            let (worth, usual) = BEFORE;
            let new = usual * usual * (1.0 - kept);
            let products = [worth * new + way.dot(&went), new + way.norm_squared()];
            for (sum, product) in self.went.iter_mut().zip(products) {
                *sum = *sum * kept + product;
            }
        }
        while self.before.len() >= KEPT
            || self.before.get(1).is_some_and(|(next, _)| *next <= further)
        {
            self.before.pop_front();
        }
        self.before.push_back((at, self.tracks));
    }

    /// The newest state of a moment not after that, s.
    fn known(&self, until: f64) -> Option<&(f64, [Track; 3])> {
        self.before.iter().rev().find(|(at, _)| *at <= until)
    }

    /// The part of the motion it foretells that comes, by least squares; from 0 to 1.
    pub(super) fn worth(&self) -> f64 {
        let [went, foretold] = self.went;
        (went / foretold).clamp(0.0, 1.0)
    }
}

/// The gains of a memory that grows from the beginning (E. Brookner, Tracking and Kalman Filtering Made Easy, 1998, section 6),
/// until those of the steady state are larger.
fn faded(steady: Gains, taken: u32) -> Gains {
    let n = f64::from(taken);
    match taken {
        0 | FADING.. => steady,
        // Two places tell a speed, and nothing of the acceleration.
        1 => Gains {
            alpha: 1.0,
            beta: 1.0,
            gamma: 0.0,
        },
        _ => {
            let all = (n + 3.0) * (n + 2.0) * (n + 1.0);
            Gains {
                alpha: steady.alpha.max(3.0 * (3.0 * n * n + 3.0 * n + 2.0) / all),
                beta: steady.beta.max(18.0 * (2.0 * n + 1.0) / all),
                gamma: steady.gamma.max(60.0 / all),
            }
        }
    }
}
