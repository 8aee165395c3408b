//! Draws the faults of a profile from the seed, one after the other, as far as the app runs.
//!
//! Each kind of fault at each place is a Poisson process with a generator of its own: what the app
//! does, and which other faults there are, changes nothing in it.

use std::time::Duration;

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    fault::{Fault, KINDS, Kind},
    profile::{Faults, Rate},
    reader::nanos,
};
use ctos_config::App;
use ctos_time::{Instant, seed::mix};

/// One kind of fault at one place.
struct Stream {
    kind: &'static str,
    /// On the one chassis, or between both.
    place: (String, String),
    rate: Rate,
    rng: ChaCha8Rng,
    next: Option<Instant>,
}

impl Stream {
    fn new(kind: &Kind, place: (String, String), rate: Rate, seed: u64) -> Self {
        let words = ["fault", kind.seed, &place.0, &place.1];
        let mut stream = Self {
            kind: kind.word,
            rng: ChaCha8Rng::seed_from_u64(mix(seed, &words)),
            place,
            rate,
            next: None,
        };
        stream.step(Instant::START);
        stream
    }

    /// Draws the moment of the next one after `from`.
    fn step(&mut self, from: Instant) {
        self.next = (self.rate.per_s > 0.0).then(|| {
            let uniform: f64 = self.rng.random();
            let wait_s = -(1.0 - uniform).ln() / self.rate.per_s;
            from + nanos(wait_s.min(1e9))
        });
    }

    fn pop(&mut self) -> Option<Fault> {
        let at = self.next?;
        let lasts = drawn(&mut self.rng, self.rate.lasts_s);
        let extent = drawn(&mut self.rng, self.rate.extent);
        let until = at + nanos(lasts);
        // The next one begins after the present one is over.
        self.step(until);
        Fault::new(self.kind, self.place.clone(), at, until, extent)
    }
}

fn drawn(rng: &mut ChaCha8Rng, (least, most): (f64, f64)) -> f64 {
    let uniform: f64 = rng.random();
    least + (most - least) * uniform
}

/// The faults of a profile for one app and one seed.
pub(crate) struct Drawn {
    streams: Vec<Stream>,
    /// The stream that comes next, and when.
    first: Option<(Instant, usize)>,
}

impl Drawn {
    pub(crate) fn new(faults: &Faults, app: &App, names: &[String]) -> Self {
        let mut streams = Vec::new();
        let mut add = |on_link: bool, place: (&String, &String), boots: bool| {
            // The chassis that boots is the one that tells how it ended: it is not killed.
            let fits = |kind: &Kind| kind.on_link == on_link && !(boots && kind.word == "kill");
            for kind in KINDS.into_iter().filter(fits) {
                let rate = faults.rates.get(kind.word);
                let place = (place.0.clone(), place.1.clone());
                streams.extend(rate.map(|rate| Stream::new(&kind, place, *rate, app.seed)));
            }
        };
        for (index, one) in names.iter().enumerate() {
            for other in names.iter().skip(index + 1) {
                add(true, (one, other), false);
            }
            add(false, (one, &String::new()), index == 0);
        }
        let mut drawn = Self {
            streams,
            first: None,
        };
        drawn.find_first();
        drawn
    }

    /// How wrong each clock is.
    pub(crate) fn drifts(faults: &Faults, app: &App, names: &[String]) -> Vec<Fault> {
        if faults.drift_ppm <= 0.0 && faults.ahead_s <= 0.0 {
            return Vec::new();
        }
        let drift = |name: &String| {
            let seed = mix(app.seed, &["fault", "Drift", name]);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let ahead: Duration = nanos(drawn(&mut rng, (0.0, faults.ahead_s)));
            let ppm = drawn(&mut rng, (-faults.drift_ppm, faults.drift_ppm));
            Fault::Drift {
                chassis: name.clone(),
                ahead,
                rate_ppb: (ppm * 1e3).round() as i32,
            }
        };
        names.iter().map(drift).collect()
    }

    fn find_first(&mut self) {
        let next = self.streams.iter().enumerate();
        self.first = next
            .filter_map(|(index, stream)| Some((stream.next?, index)))
            .min();
    }

    /// When the next one happens.
    pub(crate) fn next(&self) -> Option<Instant> {
        self.first.map(|(moment, _)| moment)
    }

    /// The next one that happens until `now`.
    pub(crate) fn pop(&mut self, now: Instant) -> Option<Fault> {
        let (moment, index) = self.first?;
        if moment > now {
            return None;
        }
        let fault = self.streams.get_mut(index).and_then(Stream::pop);
        self.find_first();
        fault
    }
}
