//! The difference of the clocks of two processes on different hosts, with a bound on the error (SORMA
//! technical report, section 2.2.5). It is estimated again and again from the messages that go there
//! and back.
//!
//! It sends nothing: the sender of a request feeds it the four times of request and reply. *Here* is the clock
//! of the sender, *there* the other one. The difference is there minus here.
//!
//! **The bound.** A message is not received before it is sent. So the difference was at most `t2 - t1` when the
//! request arrived, and at least `t3 - t4` when the reply left. That holds however the delay was divided between
//! the two ways. If the difference changes by no more than `max_drift` per unit of time, both hold at another
//! moment `c` too, less sharply. It is at most `t2 - t1 + max_drift |c - t1|` and at least `t3 - t4 - max_drift
//! |c - t4|`. (In both cases the end of the interval in which the unknown moment lies is the worst, because
//! `max_drift < 1`.) All exchanges together give the intersection. The true difference is in there whatever the
//! network does, as long as the clocks drift no faster. The estimate is clamped into it, and its error is the
//! distance to the farther end.
//!
//! **The estimate.** As in NTP (RFC 5905), exchanges with a short delay say most. The difference is taken from the
//! middle of the shortest, and carried on with the drift. The drift is the median of the slopes between short ones
//! (Theil and Sen), so that single bad exchanges do not count.

use ctos::time::Instant;
use std::collections::VecDeque;
use std::sync::OnceLock;
use std::time::Duration;
use thiserror::Error;

/// How many exchanges are remembered one by one.
const WINDOW: usize = 64;
/// Rounding of four clock readings to whole nanoseconds, and of the arithmetic here, ns.
const ROUNDING_NS: f64 = 4.0;
/// Two clocks of common quality differ by no more than this: 200 µs per s.
pub const USUAL_DRIFT: f64 = 200e-6;
/// No clocks that are worth comparing drift faster: 10 ms per s.
pub const MOST_DRIFT: f64 = 0.01;

/// The times of a request and its reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exchange {
    /// When the request was sent, by the clock here.
    pub t1: Instant,
    /// When it arrived, by the clock there.
    pub t2: Instant,
    /// When the reply was sent, by the clock there.
    pub t3: Instant,
    /// When it arrived, by the clock here.
    pub t4: Instant,
}

/// Why an exchange, or a drift, cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ClockError {
    /// The reply arrived before its request was sent, or was sent before that arrived.
    #[error("the times of an exchange run backwards: {0:?}")]
    Backwards(Exchange),
    /// A drift that no clock has.
    #[error("a drift is 0 to {MOST_DRIFT}, not {0}")]
    Drift(f64),
}

/// What became of an exchange.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observed {
    /// It fits to what was known.
    Used,
    /// It contradicts what was known: a clock was set, or they drift faster than was said. What was known
    /// before is forgotten, and the estimate begins anew with this exchange.
    Restarted,
}

/// The difference at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Clock there minus clock here, ns.
    pub offset_ns: i64,
    /// The most by which that is wrong, ns.
    pub error_ns: u64,
}

/// A moment of the other clock, in the time here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Corrected {
    /// When it was, by the clock here.
    pub at: Instant,
    /// The most by which that is wrong.
    pub error: Duration,
}

/// An exchange relative to the reference, ns.
#[derive(Debug, Clone, Copy)]
struct Sample {
    t1: f64,
    t4: f64,
    /// The difference was at most this when the request arrived.
    high: f64,
    /// It was at least this when the reply left.
    low: f64,
}

impl Sample {
    fn delay(&self) -> f64 {
        self.high - self.low
    }

    fn middle(&self) -> f64 {
        f64::midpoint(self.high, self.low)
    }

    fn at(&self) -> f64 {
        f64::midpoint(self.t1, self.t4)
    }

    fn high_at(&self, here: f64, drift: f64) -> f64 {
        self.high + drift * (here - self.t1).abs()
    }

    fn low_at(&self, here: f64, drift: f64) -> f64 {
        self.low - drift * (here - self.t4).abs()
    }
}

/// Where zero is, so that the numbers stay small enough for a float to hold them to the nanosecond.
#[derive(Debug, Clone, Copy)]
struct Reference {
    here: i128,
    offset: i128,
}

/// What exchanges that are no longer remembered say about later moments.
#[derive(Debug, Clone, Copy)]
struct Past {
    /// From this moment on.
    since: f64,
    /// The lowest of `high - drift * t1`, so that the difference at `c` is at most this plus `drift * c`.
    high: f64,
    /// The highest of `low + drift * t4`.
    low: f64,
}

/// The difference of two clocks, as far as it is known.
#[derive(Debug, Clone)]
pub struct ClockDifference {
    max_drift: f64,
    reference: Option<Reference>,
    samples: VecDeque<Sample>,
    past: Option<Past>,
    /// Found when it is asked for: a table of a million exchanges needs it once.
    drift: OnceLock<f64>,
    restarts: u64,
}

impl ClockDifference {
    /// Of clocks of which nothing is known but that their difference changes by no more than `max_drift` (s per s);
    /// [`USUAL_DRIFT`] where nobody knows better.
    ///
    /// # Errors
    /// A drift below 0, or above [`MOST_DRIFT`].
    pub fn new(max_drift: f64) -> Result<Self, ClockError> {
        if !(0.0..=MOST_DRIFT).contains(&max_drift) {
            return Err(ClockError::Drift(max_drift));
        }
        Ok(Self {
            max_drift,
            reference: None,
            samples: VecDeque::with_capacity(WINDOW),
            past: None,
            drift: OnceLock::new(),
            restarts: 0,
        })
    }

    /// Learns from a request and its reply. The exchanges come in the order of their `t4`.
    ///
    /// # Errors
    /// Times that run backwards; nothing is learnt then.
    pub fn observe(&mut self, exchange: Exchange) -> Result<Observed, ClockError> {
        let Exchange { t1, t2, t3, t4 } = exchange;
        if t4 < t1 || t3 < t2 {
            return Err(ClockError::Backwards(exchange));
        }
        let mut observed = Observed::Used;
        let mut sample = self.relative(exchange);
        if self.contradicts(&sample) {
            *self = Self {
                restarts: self.restarts + 1,
                ..Self::new(self.max_drift)?
            };
            sample = self.relative(exchange);
            observed = Observed::Restarted;
        }
        if self.samples.len() >= WINDOW
            && let Some(oldest) = self.samples.pop_front()
        {
            self.fold(&oldest);
        }
        self.samples.push_back(sample);
        self.drift = OnceLock::new();
        Ok(observed)
    }

    fn relative(&mut self, exchange: Exchange) -> Sample {
        let Exchange { t1, t2, t3, t4 } = exchange;
        let [t1, t2, t3, t4] = [t1, t2, t3, t4].map(|moment| i128::from(moment.as_nanos()));
        let reference = *self.reference.get_or_insert(Reference {
            here: t1,
            offset: t2 - t1,
        });
        Sample {
            t1: (t1 - reference.here) as f64,
            t4: (t4 - reference.here) as f64,
            high: (t2 - t1 - reference.offset) as f64,
            low: (t3 - t4 - reference.offset) as f64,
        }
    }

    /// Whether there is a moment at which the sample and the known bounds exclude each other.
    fn contradicts(&self, sample: &Sample) -> bool {
        let known = |moment: f64| self.bounds(moment);
        let at_odds = |moment: f64| {
            known(moment).is_some_and(|(low, high)| {
                sample.low_at(moment, self.max_drift) > high + ROUNDING_NS
                    || sample.high_at(moment, self.max_drift) < low - ROUNDING_NS
            })
        };
        at_odds(sample.t1) || at_odds(sample.t4)
    }

    /// Keeps of an exchange what bounds all later moments.
    fn fold(&mut self, sample: &Sample) {
        let high = sample.high - self.max_drift * sample.t1;
        let low = sample.low + self.max_drift * sample.t4;
        let past = self.past.get_or_insert(Past {
            since: sample.t4,
            high,
            low,
        });
        past.since = past.since.max(sample.t4);
        past.high = past.high.min(high);
        past.low = past.low.max(low);
    }

    /// Between what the difference is at a moment, all relative.
    fn bounds(&self, here: f64) -> Option<(f64, f64)> {
        let drift = self.max_drift;
        let mut samples = self.samples.iter();
        let first = samples.next()?;
        let mut bounds = (first.low_at(here, drift), first.high_at(here, drift));
        for sample in samples {
            bounds.0 = bounds.0.max(sample.low_at(here, drift));
            bounds.1 = bounds.1.min(sample.high_at(here, drift));
        }
        if let Some(past) = self.past.filter(|past| here >= past.since) {
            bounds.0 = bounds.0.max(past.low - drift * here);
            bounds.1 = bounds.1.min(past.high + drift * here);
        }
        Some(bounds)
    }

    /// The shorter half of the exchanges.
    fn short(&self) -> Vec<Sample> {
        let mut samples: Vec<Sample> = self.samples.iter().copied().collect();
        samples.sort_by(|a, b| a.delay().total_cmp(&b.delay()));
        samples.truncate(samples.len().div_ceil(2));
        samples
    }

    /// The median of the slopes between short exchanges, within what can be.
    fn slope(&self) -> f64 {
        let short = self.short();
        let mut slopes = Vec::with_capacity(short.len() * short.len() / 2);
        for (index, one) in short.iter().enumerate() {
            for other in short.iter().skip(index + 1) {
                let apart = other.at() - one.at();
                if apart.abs() >= 1.0 {
                    slopes.push((other.middle() - one.middle()) / apart);
                }
            }
        }
        let half = slopes.len() / 2;
        if slopes.is_empty() {
            return 0.0;
        }
        let (_, median, _) = slopes.select_nth_unstable_by(half, f64::total_cmp);
        median.clamp(-self.max_drift, self.max_drift)
    }

    /// The estimate and its error at a moment, relative.
    fn estimate(&self, here: f64) -> Option<(f64, f64)> {
        let (low, high) = self.bounds(here)?;
        // The same for all: a long delay and a long time since both make an exchange say less.
        let doubt = |sample: &Sample| {
            sample.high_at(here, self.max_drift) - sample.low_at(here, self.max_drift)
        };
        let best = self
            .samples
            .iter()
            .min_by(|a, b| doubt(a).total_cmp(&doubt(b)))?;
        let guess = best.middle() + self.drift() * (here - best.at());
        // Rounding may have turned the two round.
        let guess = guess.max(low.min(high)).min(high.max(low));
        let error = (high - guess).max(guess - low).max(0.0) + ROUNDING_NS;
        Some((guess, error))
    }

    /// The difference at a moment here, which may also be before the exchanges or after them. `None` before the
    /// first exchange.
    #[must_use]
    pub fn at(&self, here: Instant) -> Option<Difference> {
        let reference = self.reference?;
        let relative = (i128::from(here.as_nanos()) - reference.here) as f64;
        let (guess, error) = self.estimate(relative)?;
        let offset = reference.offset + guess.round() as i128;
        Some(Difference {
            offset_ns: i64::try_from(offset).unwrap_or(if offset < 0 {
                i64::MIN
            } else {
                i64::MAX
            }),
            error_ns: error.ceil() as u64,
        })
    }

    /// What a moment of the clock there is in the time here: for the stamp of a record that comes from there. `None`
    /// before the first exchange.
    #[must_use]
    pub fn correct(&self, there: Instant) -> Option<Corrected> {
        let reference = self.reference?;
        // `here + difference(here) = there`; the difference changes slowly, so this closes in at once.
        let shown = (i128::from(there.as_nanos()) - reference.here - reference.offset) as f64;
        let mut here = shown;
        for _ in 0..3 {
            here = shown - self.estimate(here)?.0;
        }
        let (guess, error) = self.estimate(here)?;
        let residue = (here + guess - shown).abs();
        // The clock there advances by at least `1 - max_drift` for each unit here.
        let error = (residue + error) / (1.0 - self.max_drift) + ROUNDING_NS;
        let at = reference.here + here.round() as i128;
        let at = u64::try_from(at).unwrap_or(if at < 0 { 0 } else { u64::MAX });
        Some(Corrected {
            at: Instant::from_nanos(at),
            error: Duration::from_nanos(error.ceil() as u64),
        })
    }

    /// How fast the difference grows, s per s, as estimated.
    #[must_use]
    pub fn drift(&self) -> f64 {
        *self.drift.get_or_init(|| self.slope())
    }

    /// How often an exchange contradicted what was known.
    #[must_use]
    pub fn restarts(&self) -> u64 {
        self.restarts
    }
}

#[cfg(test)]
mod tests;
