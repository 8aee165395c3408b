//! Where the target is: an alpha-beta-gamma filter for each axis, with measurements that come late, at irregular times, or not at all
//! (SORMA technical report, sections 2.2.6 and 2.2.8). Knows no tasks and no clocks: times are seconds of one clock.
//!
//! The state belongs to the moment of the last measurement, the exposure. Whoever asks where the target is gets a prediction from
//! there. When nothing has been measured for a while the predicted motion decays, so that who follows it comes to rest smoothly.

use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use vss::tracking::{Gains, Track};

/// Measurements after a beginning during which the gains are those of a growing memory.
const FADING: u32 = 12;

/// No interval counts as longer in the gains, s: beyond that the last measurement says everything.
const LONGEST_INTERVAL: f64 = 1.0;

/// What is known of a target beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TargetArgs {
    /// Standard deviation of a measurement along an axis, m.
    pub sigma_m: f64,
    /// How fast the acceleration changes: its standard deviation after 1 s, m/s^2. It goes with the root of the time.
    pub agility: f64,
    /// A motion slower than this, m/s, counts as little as it is slower: a target that is held still does not tremble.
    pub still_m_s: f64,
    /// A measurement further than this from what was expected is none of this target, m.
    pub gate_m: f64,
    /// After this time without a measurement the target has expired, s.
    pub expiry_s: f64,
    /// What is left of its motion then decays with this time constant, s.
    pub decay_s: f64,
    /// For how long the acceleration is believed to go on: its time constant in a prediction, s.
    pub manoeuvre_s: f64,
}

impl Default for TargetArgs {
    fn default() -> Self {
        Self {
            sigma_m: 0.000_5,
            agility: 3.0,
            still_m_s: 0.01,
            gate_m: 0.15,
            expiry_s: 0.5,
            decay_s: 0.15,
            manoeuvre_s: 0.25,
        }
    }
}

impl TargetArgs {
    /// The first number that cannot be, by its key.
    #[must_use]
    pub fn wrong(&self) -> Option<(&'static str, f64)> {
        let all = [
            ("sigma_m", self.sigma_m),
            ("agility", self.agility),
            ("still_m_s", self.still_m_s),
            ("gate_m", self.gate_m),
            ("expiry_s", self.expiry_s),
            ("decay_s", self.decay_s),
            ("manoeuvre_s", self.manoeuvre_s),
        ];
        let wrong = |(_, value): &(_, f64)| !(*value > 0.0 && *value <= 1e3);
        all.into_iter().find(wrong)
    }

    /// The gains for an interval, s.
    fn gains(&self, interval: f64) -> Option<Gains> {
        let change = self.agility * interval.sqrt();
        Gains::of(change * interval * interval / self.sigma_m)
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
    /// How old what it is predicted from is, s.
    pub age: f64,
    /// Nothing has been measured for so long that it has expired.
    pub expired: bool,
}

/// A target.
#[derive(Debug, Clone)]
pub struct Target {
    args: TargetArgs,
    /// When the last measurement was taken, and the state then.
    state: Option<(f64, [Track; 3])>,
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
            state: None,
            taken: 0,
            far_since: None,
        }
    }

    /// Forgets it.
    pub fn forget(&mut self) {
        *self = Self::new(self.args);
    }

    /// When it was measured last, s.
    #[must_use]
    pub fn measured(&self) -> Option<f64> {
        self.state.as_ref().map(|(at, _)| *at)
    }

    /// Takes a measurement of its place in, m, taken at a moment, s. One that comes after an expiry begins anew, and so do those that
    /// are too far for as long as an expiry takes: it is somewhere else then.
    pub fn measure(&mut self, at: f64, place: &Point3<f64>) -> Taken {
        if !at.is_finite() || place.iter().any(|number| !number.is_finite()) {
            return Taken::Wrong;
        }
        let Some((before, tracks)) = &self.state else {
            return self.begin(at, place);
        };
        let interval = at - before;
        if interval <= 0.0 {
            return Taken::Late;
        }
        let (before, gains) = (*before, self.args.gains(interval.min(LONGEST_INTERVAL)));
        let expected = tracks.map(|track| track.predicted(interval));
        let Some(gains) = gains.filter(|_| interval <= self.args.expiry_s) else {
            return self.begin(at, place);
        };
        let off = |(track, z): (&Track, &f64)| (z - track.x).powi(2);
        let far = expected
            .iter()
            .zip(place.iter())
            .map(off)
            .sum::<f64>()
            .sqrt();
        if far > self.args.gate_m {
            let since = *self.far_since.get_or_insert(before);
            if at - since > self.args.expiry_s {
                return self.begin(at, place);
            }
            return Taken::Far;
        }
        self.far_since = None;
        let gains = self.faded(gains);
        let mut corrected = expected;
        for (track, z) in corrected.iter_mut().zip(place.iter()) {
            *track = track.corrected(*z, gains, interval);
        }
        self.state = Some((at, corrected));
        self.taken = self.taken.saturating_add(1);
        Taken::Used
    }

    fn begin(&mut self, at: f64, place: &Point3<f64>) -> Taken {
        let mut tracks = [Track::at_rest(0.0); 3];
        for (track, x) in tracks.iter_mut().zip(place.iter()) {
            track.x = *x;
        }
        (self.state, self.taken, self.far_since) = (Some((at, tracks)), 1, None);
        Taken::Begun
    }

    /// The gains of a memory that grows from the beginning (E. Brookner, Tracking and Kalman Filtering Made Easy, 1998, section 6),
    /// until those of the steady state are larger.
    fn faded(&self, steady: Gains) -> Gains {
        let n = f64::from(self.taken);
        match self.taken {
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

    /// Where it is at a moment, s; `None` as long as nothing is known.
    #[must_use]
    pub fn at(&self, now: f64) -> Option<Predicted> {
        let (at, tracks) = self.state.as_ref()?;
        let age = (now - at).max(0.0);
        let axis = |pick: fn(&Track) -> f64| {
            let [x, y, z] = tracks.each_ref().map(pick);
            Vector3::new(x, y, z)
        };
        let (place, velocity, acceleration) = (
            axis(|track| track.x),
            axis(|track| track.v),
            axis(|track| track.a),
        );
        let counts = moves(velocity.norm(), self.args.still_m_s);
        let (velocity, acceleration) = (velocity * counts, acceleration * counts);
        let expiry = self.args.expiry_s;
        let (going, after) = (age.min(expiry), (age - expiry).max(0.0));
        // The acceleration decays, so velocity and place are its integrals.
        let (lasts, left) = (
            self.args.manoeuvre_s,
            (-going / self.args.manoeuvre_s).exp(),
        );
        let speed = velocity + acceleration * (lasts * (1.0 - left));
        let there =
            place + velocity * going + acceleration * (lasts * (going - lasts * (1.0 - left)));
        let decay = self.args.decay_s;
        let left = (-after / decay).exp();
        Some(Predicted {
            place: Point3::from(there + speed * (decay * (1.0 - left))),
            velocity: speed * left,
            age,
            expired: age > expiry,
        })
    }

    /// Where it was measured last, m, whatever moves; for a comparison without prediction.
    #[must_use]
    pub fn last(&self, now: f64) -> Option<Predicted> {
        let (at, tracks) = self.state.as_ref()?;
        let [x, y, z] = tracks.each_ref().map(|track| track.x);
        let age = (now - at).max(0.0);
        Some(Predicted {
            place: Point3::new(x, y, z),
            velocity: Vector3::zeros(),
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
