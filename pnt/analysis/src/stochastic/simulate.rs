//! Simulation of a model with the executor's token game and race: virtual time, seeded chance, and
//! confidence intervals by batch means.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::{
    error::PerfError,
    model::{Busy, Model},
    report::{Interval, Options, Simulated},
    student,
};
use pnt_language::{
    exec::{Conflicts, Execution, Race},
    net::TransitionId,
};

/// The longest time that can be simulated: nanoseconds are counted in 64 bits.
pub(super) const MOST_SECONDS: f64 = 1e9;

/// Equal parts of the simulated time. Their means are nearly independent when each part is long.
const BATCHES: u32 = 30;

/// Parts of the same length at the beginning that are not counted: the net forgets how it began.
const WARM_UP: u32 = 3;

/// Firings of timed transitions that are simulated when no time is given.
const FIRINGS: u64 = 1_000_000;

/// Firings from which it is estimated how long those take.
const PILOT: u64 = 10_000;

/// Firings in a row without time after which the net is taken to run in a circle.
const MOST_AT_ONCE: u32 = 1_000_000;

/// The intervals of one run.
#[derive(Debug)]
pub(super) struct Run {
    pub(super) simulated: Simulated,
    /// Per place of the model.
    pub(super) tokens: Vec<Interval>,
    pub(super) marked: Vec<Interval>,
    /// Per transition of the nets.
    pub(super) throughput: Vec<Interval>,
    pub(super) busy: Vec<Interval>,
}

pub(super) fn simulate(model: &Model, options: &Options) -> Result<Run, PerfError> {
    let time_s = match options.time_s {
        Some(time_s) => time_s,
        None => {
            let mut pilot = Game::new(model, options.seed ^ 1);
            while pilot.timed < PILOT && pilot.step(u64::MAX)? {}
            #[allow(clippy::cast_precision_loss, reason = "an estimate")]
            let seconds = pilot.execution.now_ns() as f64 / 1e9 * FIRINGS as f64 / PILOT as f64;
            seconds.clamp(1e-6, MOST_SECONDS)
        }
    };
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "bounded by MOST_SECONDS"
    )]
    let batch_ns = ((time_s * 1e9 / f64::from(BATCHES)) as u64).max(1);
    let mut game = Game::new(model, options.seed);
    game.run_until(batch_ns * u64::from(WARM_UP))?;
    let before = game.timed;
    let mut batches = Vec::new();
    for batch in 1..=BATCHES {
        game.sums.clear();
        game.run_until(batch_ns * u64::from(WARM_UP + batch))?;
        batches.push(game.sums.clone());
    }
    #[allow(clippy::cast_precision_loss, reason = "a length of time")]
    let batch_s = batch_ns as f64 / 1e9;
    let t = student::quantile(options.confidence, BATCHES - 1);
    let time_s = batch_s * f64::from(BATCHES);
    let firings = game.timed - before;
    let unseen = unseen(options.confidence, firings);
    #[allow(clippy::cast_precision_loss, reason = "a count of firings")]
    let unseen_per_s = unseen * firings.max(1) as f64 / time_s;
    let intervals = |of: &dyn Fn(&Sums) -> &Vec<f64>, unseen: f64| -> Vec<Interval> {
        let count = batches.first().map_or(0, |sums| of(sums).len());
        let values =
            (0..count).map(|index| batches.iter().map(move |sums| of(sums)[index] / batch_s));
        values.map(|values| interval(values, t, unseen)).collect()
    };
    Ok(Run {
        simulated: Simulated {
            time_s,
            firings,
            batches: BATCHES as usize,
            confidence: options.confidence,
            seed: options.seed,
        },
        tokens: intervals(&|sums| &sums.tokens, unseen),
        marked: intervals(&|sums| &sums.marked, unseen),
        throughput: intervals(&|sums| &sums.ends, unseen_per_s),
        busy: intervals(&|sums| &sums.busy, unseen),
    })
}

/// The part of all firings that something may take with so many firings none of which showed it: the
/// "rule of three". Batches that are all the same would else say that the value is known exactly.
fn unseen(confidence: f64, firings: u64) -> f64 {
    #[allow(clippy::cast_precision_loss, reason = "a count of firings")]
    let firings = firings.max(1) as f64;
    (-(1.0 - confidence).ln() / firings).min(1.0)
}

/// The mean, and an interval that is not narrower than what may have stayed unseen.
fn interval(values: impl Iterator<Item = f64> + Clone, t: f64, unseen: f64) -> Interval {
    let count = f64::from(BATCHES);
    let mean = values.clone().sum::<f64>() / count;
    let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
    Interval {
        mean,
        half_width: (t * (squares / (count - 1.0) / count).sqrt()).max(unseen),
    }
}

/// Integrals over time, and firings, of one batch.
#[derive(Debug, Clone)]
struct Sums {
    tokens: Vec<f64>,
    marked: Vec<f64>,
    ends: Vec<f64>,
    busy: Vec<f64>,
}

impl Sums {
    fn clear(&mut self) {
        for sums in [
            &mut self.tokens,
            &mut self.marked,
            &mut self.ends,
            &mut self.busy,
        ] {
            sums.fill(0.0);
        }
    }
}

struct Game<'a> {
    model: &'a Model,
    execution: Execution,
    race: Race,
    conflicts: Conflicts,
    /// Firings of timed transitions.
    timed: u64,
    sums: Sums,
    /// Per place: since when it holds what it holds.
    since: Vec<u64>,
    /// Per transition of the model: the places that it changes.
    changes: Vec<Vec<u32>>,
    /// Per transition of the model: the origins whose busy servers it may change.
    watched: Vec<(TransitionId, usize)>,
    busy_since: u64,
}

impl<'a> Game<'a> {
    fn new(model: &'a Model, seed: u64) -> Self {
        let net = &model.net;
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(1);
        let execution = Execution::new(net.clone());
        let race = Race::new(&execution, ChaCha8Rng::seed_from_u64(seed));
        let (places, origins) = (net.places().len(), model.transitions.len());
        let changes = net.transitions().iter().map(|t| {
            let arcs = t.inputs.iter().chain(&t.outputs.local);
            let arcs = arcs.map(|arc| arc.place).chain(t.resets.iter().copied());
            let mut places: Vec<u32> = arcs.map(|place| place.0).collect();
            places.sort_unstable();
            places.dedup();
            places
        });
        let by_servers = model
            .transitions
            .iter()
            .filter(|o| o.busy == Some(Busy::Servers));
        let watched = by_servers.flat_map(|origin| {
            let parts = origin.parts.iter();
            parts.map(|(_, t)| {
                (
                    TransitionId(u32::try_from(*t).unwrap_or(u32::MAX)),
                    origin.index,
                )
            })
        });
        Self {
            execution,
            race,
            conflicts: Conflicts::Random(Box::new(chance)),
            timed: 0,
            sums: Sums {
                tokens: vec![0.0; places],
                marked: vec![0.0; places],
                ends: vec![0.0; origins],
                busy: vec![0.0; origins],
            },
            since: vec![0; places],
            changes: changes.collect(),
            watched: watched.collect(),
            busy_since: 0,
            model,
        }
    }

    fn run_until(&mut self, end_ns: u64) -> Result<(), PerfError> {
        while self.step(end_ns)? {}
        self.pass_time(end_ns);
        for place in 0..self.since.len() {
            self.count(place);
        }
        Ok(())
    }

    /// Fires what takes no time and then the winner of the race, unless that is after `end_ns`.
    fn step(&mut self, end_ns: u64) -> Result<bool, PerfError> {
        self.settle()?;
        self.race.refresh(&mut self.execution, |_| true);
        let Some(next) = self.race.next(&self.execution) else {
            let marking = self.model.words(self.execution.marking());
            return Err(PerfError::Stops { marking });
        };
        if next.due_ns > end_ns {
            return Ok(false);
        }
        self.pass_time(next.due_ns);
        if let Some(id) = self.race.pop(&self.execution) {
            self.timed += 1;
            self.fire(id)?;
        }
        Ok(true)
    }

    fn settle(&mut self) -> Result<(), PerfError> {
        let mut at_once = 0;
        while let Some(id) = self.execution.choose(&mut self.conflicts, |_| true) {
            self.fire(id)?;
            at_once += 1;
            if at_once > MOST_AT_ONCE {
                let marking = self.model.words(self.execution.marking());
                return Err(PerfError::Timeless { marking });
            }
        }
        Ok(())
    }

    /// Servers are busy at the marking as it is until time has passed.
    fn pass_time(&mut self, to_ns: u64) {
        let lasted = seconds(self.busy_since, to_ns);
        for (id, origin) in &self.watched {
            let busy = self.execution.servers_busy(*id);
            if let Some(sum) = self.sums.busy.get_mut(*origin) {
                *sum += f64::from(busy) * lasted;
            }
        }
        self.busy_since = to_ns;
        self.execution.advance_to(to_ns);
    }

    /// Adds a place's tokens since it was last looked at.
    fn count(&mut self, place: usize) {
        let now = self.execution.now_ns();
        let tokens = self.execution.marking().get(place).copied().unwrap_or(0);
        let lasted = seconds(self.since[place], now);
        self.since[place] = now;
        self.sums.tokens[place] += f64::from(tokens) * lasted;
        if tokens > 0 {
            self.sums.marked[place] += lasted;
        }
    }

    fn fire(&mut self, id: TransitionId) -> Result<(), PerfError> {
        for index in 0..self.changes[id.index()].len() {
            self.count(self.changes[id.index()][index] as usize);
        }
        let fired = self.execution.fire(id).map(|_| ());
        fired.map_err(|error| PerfError::Overflow(error.to_string()))?;
        if let Some(origin) = self.model.origin_of[id.index()] {
            let parts = &self.model.transitions[origin].parts;
            let ends = parts
                .iter()
                .any(|(part, t)| *t == id.index() && part.is_end());
            if ends {
                self.sums.ends[origin] += 1.0;
            }
        }
        Ok(())
    }
}

#[allow(clippy::cast_precision_loss, reason = "lengths of time")]
fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 / 1e9
}
