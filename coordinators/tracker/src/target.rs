//! Where the target is: alpha-beta-gamma filters for each axis, with measurements that come late, at irregular times, or not at all
//! (SORMA technical report, sections 2.2.6 and 2.2.8). Knows no tasks and no clocks: times are seconds of one clock.
//!
//! Several filters run side by side, for smooth and for sudden motions. The one that foretold the target best of late counts.
//!
//! The state belongs to the moment of the last measurement, the exposure. Whoever asks where the target is gets a prediction from
//! there. When nothing has been measured for a while the predicted motion decays, so that who follows it comes to rest smoothly.

mod filter;

use nalgebra::{Point3, Vector3};
use serde::Deserialize;

pub use filter::Manner;
use filter::{Filter, place};

/// Another filter counts only when it is better by this part, so that they do not take turns.
const BETTER: f64 = 0.95;

/// What is known of a target beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetArgs {
    /// Standard deviation of a measurement along an axis, m.
    pub sigma_m: f64,
    /// How it may move: from the smoothest to the most sudden.
    pub manners: [Manner; 3],
    /// A motion slower than this, m/s, counts as little as it is slower: a target that is held still does not tremble.
    pub still_m_s: f64,
    /// A measurement further than this from what was expected is none of this target, m.
    pub gate_m: f64,
    /// After this time without a measurement the target has expired, s.
    pub expiry_s: f64,
    /// What is left of its motion then decays with this time constant, s.
    pub decay_s: f64,
}

impl Default for TargetArgs {
    fn default() -> Self {
        Self {
            sigma_m: 0.000_5,
            manners: [(0.3, 0.25), (1.0, 0.25), (3.0, 0.05)].map(|(agility, manoeuvre_s)| Manner {
                agility,
                manoeuvre_s,
            }),
            still_m_s: 0.01,
            gate_m: 0.15,
            expiry_s: 0.5,
            decay_s: 0.15,
        }
    }
}

impl TargetArgs {
    /// The first number that cannot be, by its key.
    #[must_use]
    pub fn wrong(&self) -> Option<(&'static str, f64)> {
        let all = [
            ("sigma_m", self.sigma_m),
            ("still_m_s", self.still_m_s),
            ("gate_m", self.gate_m),
            ("expiry_s", self.expiry_s),
            ("decay_s", self.decay_s),
        ];
        let manners = self.manners.into_iter().flat_map(|manner| {
            [
                ("manners.agility", manner.agility),
                ("manners.manoeuvre_s", manner.manoeuvre_s),
            ]
        });
        let wrong = |(_, value): &(_, f64)| !(*value > 0.0 && *value <= 1e3);
        all.into_iter().chain(manners).find(wrong)
    }
}

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// The target is known from this one on, or anew.
    Begun,
    /// It was filtered in.
    Used,
    /// It is not later than the one before.
    Late,
    /// It is too far from what was expected.
    Far,
    /// It has a number that is none.
    Wrong,
}

/// Where a target is, and how fast it goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// Its place, m.
    pub place: Point3<f64>,
    /// Its velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Which part of a motion that is predicted came so far, from 0 to 1.
    pub worth: f64,
    /// How old what it is predicted from is, s.
    pub age: f64,
    /// Nothing has been measured for so long that it has expired.
    pub expired: bool,
}

/// A target.
#[derive(Debug, Clone)]
pub struct Target {
    args: TargetArgs,
    filters: [Filter; 3],
    /// Which of them counts.
    best: usize,
    /// When the last measurement was taken.
    measured: Option<f64>,
    /// Measurements since the beginning.
    taken: u32,
    /// Since when measurements are too far, if they are.
    far_since: Option<f64>,
}

impl Target {
    /// Of which nothing is known yet.
    #[must_use]
    pub fn new(args: TargetArgs) -> Self {
        Self {
            args,
            filters: args.manners.map(Filter::new),
            best: 0,
            measured: None,
            taken: 0,
            far_since: None,
        }
    }

    /// Forgets where it is, and not how it moves.
    pub fn forget(&mut self) {
        (self.measured, self.taken, self.far_since) = (None, 0, None);
    }

    /// When it was measured last, s.
    #[must_use]
    pub fn measured(&self) -> Option<f64> {
        self.measured
    }

    /// The filter that counts.
    fn filter(&self) -> &Filter {
        let [first, ..] = &self.filters;
        self.filters.get(self.best).unwrap_or(first)
    }

    /// Takes a measurement of its place in, m, taken at a moment, s. One that comes after an expiry begins anew, and so do those that
    /// are too far for as long as an expiry takes: it is somewhere else then. A prediction is asked for so far `ahead` of a
    /// measurement, and what is done by it needs until so much further, s.
    pub fn measure(&mut self, at: f64, place: &Point3<f64>, ahead: [f64; 2]) -> Taken {
        if !at.is_finite() || place.iter().any(|number| !number.is_finite()) {
            return Taken::Wrong;
        }
        let Some(before) = self.measured else {
            return self.begin(at, place);
        };
        let interval = at - before;
        if interval <= 0.0 {
            return Taken::Late;
        }
        if interval > self.args.expiry_s {
            return self.begin(at, place);
        }
        if (self.filter().expected(interval) - place).norm() > self.args.gate_m {
            let since = *self.far_since.get_or_insert(before);
            if at - since > self.args.expiry_s {
                return self.begin(at, place);
            }
            return Taken::Far;
        }
        self.far_since = None;
        for filter in &mut self.filters {
            filter.correct(place, interval, self.args.sigma_m, self.taken);
            filter.look_back(at, place, interval, ahead);
        }
        let mut least = BETTER * self.filter().error;
        for (index, filter) in self.filters.iter().enumerate() {
            if filter.error < least {
                (self.best, least) = (index, filter.error);
            }
        }
        self.measured = Some(at);
        self.taken = self.taken.saturating_add(1);
        Taken::Used
    }

    fn begin(&mut self, at: f64, place: &Point3<f64>) -> Taken {
        for filter in &mut self.filters {
            filter.begin(at, place);
        }
        (self.measured, self.taken, self.far_since) = (Some(at), 1, None);
        Taken::Begun
    }

    /// Where it is at a moment, s; `None` as long as nothing is known.
    #[must_use]
    pub fn at(&self, now: f64) -> Option<Predicted> {
        let (at, filter) = (self.measured?, self.filter());
        let age = (now - at).max(0.0);
        let [_, speed] = filter.manner.ahead(&filter.tracks, 0.0);
        let counts = moves(speed.norm(), self.args.still_m_s);
        let expiry = self.args.expiry_s;
        let (going, after) = (age.min(expiry), (age - expiry).max(0.0));
        let [way, speed] = filter.manner.ahead(&filter.tracks, going);
        let (way, speed) = (way * counts, speed * counts);
        let decay = self.args.decay_s;
        let left = (-after / decay).exp();
        Some(Predicted {
            place: place(&filter.tracks) + way + speed * (decay * (1.0 - left)),
            velocity: speed * left,
            worth: filter.worth(),
            age,
            expired: age > expiry,
        })
    }

    /// Where it was measured last, m, whatever moves; for a comparison without prediction.
    #[must_use]
    pub fn last(&self, now: f64) -> Option<Predicted> {
        let age = (now - self.measured?).max(0.0);
        Some(Predicted {
            place: place(&self.filter().tracks),
            velocity: Vector3::zeros(),
            worth: 0.0,
            age,
            expired: age > self.args.expiry_s,
        })
    }
}

/// How much of a motion counts: nothing at rest, all from twice the speed `still` on, with no step between.
fn moves(speed: f64, still: f64) -> f64 {
    let share = (speed / (2.0 * still)).clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

#[cfg(test)]
mod tests;
