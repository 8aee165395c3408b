//! Draws the faults of a profile from the seed, one after the other, as far as the app runs.
//!
//! Each kind of fault at each place is a Poisson process with a generator of its own. Neither the
//! app nor other faults change it.

use std::{collections::BTreeSet, time::Duration};

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    fault::{Fault, FaultKind, KINDS, Kind, Site},
    profile::{Faults, Rate},
    reader::nanos,
};
use ctos_config::App;
use ctos_time::{Instant, seed::mix};

/// One kind of fault at one place.
struct Stream {
    kind: &'static Kind,
    site: Site,
    rate: Rate,
    rng: ChaCha8Rng,
    next: Option<Instant>,
}

impl Stream {
    fn new(kind: &'static Kind, site: Site, rate: Rate, seed: u64) -> Self {
        let (one, other) = match &site {
            Site::Chassis(one) => (one.as_str(), ""),
            Site::Link(one, other) => (one.as_str(), other.as_str()),
        };
        let seed = mix(seed, &["fault", kind.seed, one, other]);
        let mut stream = Self {
            kind,
            rng: ChaCha8Rng::seed_from_u64(seed),
            site,
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
        Some(Fault {
            kind: FaultKind::of(self.kind.word, extent)?,
            site: self.site.clone(),
            at,
            until: self.kind.lasts.then_some(until),
        })
    }
}

fn drawn(rng: &mut ChaCha8Rng, (least, most): (f64, f64)) -> f64 {
    let uniform: f64 = rng.random();
    least + (most - least) * uniform
}

/// The faults of a profile for one app and one seed.
pub(crate) struct Drawn {
    streams: Vec<Stream>,
    /// When the next of each happens, and its place.
    next: BTreeSet<(Instant, usize)>,
}

impl Drawn {
    pub(crate) fn new(faults: &Faults, app: &App, names: &[String]) -> Self {
        let mut streams = Vec::new();
        let mut add = |site: Site, boots: bool| {
            let on_link = matches!(site, Site::Link(..));
            // The chassis that boots is the one that tells how it ended: it is not killed.
            let fits = |kind: &&Kind| kind.on_link == on_link && !(boots && kind.word == "kill");
            for kind in KINDS.iter().filter(fits) {
                let rate = faults.rates.get(kind.word);
                let stream = |rate: &Rate| Stream::new(kind, site.clone(), *rate, app.seed);
                streams.extend(rate.map(stream));
            }
        };
        let is_wanted = |kind: &Kind| kind.on_link && faults.rates.contains_key(kind.word);
        // All pairs are many.
        let pairs = if KINDS.iter().any(is_wanted) {
            names.len()
        } else {
            0
        };
        for (index, one) in names.iter().enumerate() {
            for other in names.iter().take(pairs).skip(index + 1) {
                add(Site::Link(one.clone(), other.clone()), false);
            }
            add(Site::Chassis(one.clone()), index == 0);
        }
        let next = streams.iter().enumerate();
        Self {
            next: next
                .filter_map(|(place, one)| Some((one.next?, place)))
                .collect(),
            streams,
        }
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
            let rate_ppb = (ppm * 1e3).round() as i32;
            Fault::on(name, FaultKind::Drift { ahead, rate_ppb }, Instant::START)
        };
        names.iter().map(drift).collect()
    }

    /// When the next one happens.
    pub(crate) fn next(&self) -> Option<Instant> {
        self.next.first().map(|(at, _)| *at)
    }

    /// The next one that happens until `now`.
    pub(crate) fn pop(&mut self, now: Instant) -> Option<Fault> {
        self.next().filter(|next| *next <= now)?;
        let (_, place) = self.next.pop_first()?;
        let stream = self.streams.get_mut(place)?;
        let fault = stream.pop();
        self.next.extend(stream.next.map(|at| (at, place)));
        fault
    }
}
