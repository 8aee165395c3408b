//! What is believed of the ways of a step: for each context and way how often it succeeded (beta-binomial) and what it cost.
//! Pure numbers; knows no net and no task.
//!
//! Of ways that are tried one after the other until one succeeds, the order by chance over cost is the cheapest (H. Simon and
//! J. Kadane, Optimal problem-solving search, Artificial Intelligence 6, 1975). The chance is drawn from what is believed (W.
//! Thompson, Biometrika 25, 1933), so that what has hardly been tried is tried at times. Old evidence fades: ways change.

use std::collections::BTreeMap;

use rand::Rng;
use rand_distr::{Beta, Distribution};
use serde::{Deserialize, Serialize};

/// What was seen counts so much less with each new trial of the same way: the last twenty or so make the belief.
const FADING: f64 = 0.95;
/// Contexts that are kept at most: beyond them the one that was used longest ago is forgotten.
const MOST_CONTEXTS: usize = 256;
/// No way costs less, so that a chance over a cost is a number.
const LEAST_COST: f64 = 1e-3;

/// What has been seen of one way in one context. Counts fade, and so are no whole numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Seen {
    /// Successes.
    pub succeeded: f64,
    /// Failures.
    pub failed: f64,
    /// Sum of the costs of both.
    cost: f64,
    /// Trials in all, which do not fade.
    pub trials: u64,
}

impl Seen {
    /// The mean of what is believed of its chance, from an even belief: `(s + 1) / (s + f + 2)`.
    #[must_use]
    pub fn chance(&self) -> f64 {
        (self.succeeded + 1.0) / (self.succeeded + self.failed + 2.0)
    }

    /// The mean of its costs, with what was assumed before as if it had been seen once.
    #[must_use]
    pub fn cost(&self, assumed: f64) -> f64 {
        let mean = (self.cost + assumed) / (self.succeeded + self.failed + 1.0);
        mean.max(LEAST_COST)
    }

    fn draw(&self, rng: &mut impl Rng) -> f64 {
        // Both are at least 1, and finite: faded sums of ones.
        let beta = Beta::new(self.succeeded + 1.0, self.failed + 1.0);
        beta.map_or_else(|_| self.chance(), |beta| beta.sample(rng))
    }
}

/// A way that may be taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Its name.
    pub name: String,
    /// What it is assumed to cost before it has been seen, s or any other measure that all ways share.
    pub cost: f64,
}

/// A way that was chosen, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Its name.
    pub name: String,
    /// The numbers of all ways that were open, the chosen one first.
    pub figures: Vec<Figures>,
}

/// The numbers of one way, as the log and the display have them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Its name.
    pub name: String,
    /// Trials in all.
    pub trials: u64,
    /// What is believed of its chance: the mean.
    pub chance: f64,
    /// What it costs.
    pub cost: f64,
}

impl std::fmt::Display for Figures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            name,
            trials,
            chance,
            cost,
        } = self;
        write!(f, "{name} {chance:.2} for {cost:.1} ({trials} tried)")
    }
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Context {
    ways: BTreeMap<String, Seen>,
    /// The number of the note that was taken last.
    latest: u64,
}

/// What has been seen of all ways.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Belief {
    contexts: BTreeMap<String, Context>,
    notes: u64,
}

impl Belief {
    /// What has been seen of a way.
    #[must_use]
    pub fn seen(&self, context: &str, way: &str) -> Seen {
        let context = self.contexts.get(context);
        let seen = context.and_then(|context| context.ways.get(way));
        seen.copied().unwrap_or_default()
    }

    /// Which of the ways that are open to try: the one whose chance, drawn from what is believed, is the best for its cost.
    /// `None` when none is open.
    #[must_use]
    pub fn choose(&self, context: &str, open: &[Candidate], rng: &mut impl Rng) -> Option<Choice> {
        let drawn = open.iter().map(|way| {
            let seen = self.seen(context, &way.name);
            (way, seen.draw(rng) / seen.cost(way.cost))
        });
        let drawn: Vec<(&Candidate, f64)> = drawn.collect();
        // Of equals the first: what stands first in the configuration.
        let best = drawn.iter().rev();
        let (best, _) = best.max_by(|(_, one), (_, other)| one.total_cmp(other))?;
        let figures = |way: &Candidate| {
            let seen = self.seen(context, &way.name);
            Figures {
                name: way.name.clone(),
                trials: seen.trials,
                chance: seen.chance(),
                cost: seen.cost(way.cost),
            }
        };
        let others = open.iter().filter(|way| way.name != best.name);
        Some(Choice {
            name: best.name.clone(),
            figures: std::iter::once(*best).chain(others).map(figures).collect(),
        })
    }

    /// Notes how a trial of a way ended, and what it cost.
    pub fn note(&mut self, context: &str, way: &str, succeeded: bool, cost: f64) {
        self.notes += 1;
        let known = self.contexts.entry(context.to_owned()).or_default();
        known.latest = self.notes;
        let seen = known.ways.entry(way.to_owned()).or_default();
        for count in [&mut seen.succeeded, &mut seen.failed, &mut seen.cost] {
            *count *= FADING;
        }
        match succeeded {
            true => seen.succeeded += 1.0,
            false => seen.failed += 1.0,
        }
        if cost.is_finite() {
            seen.cost += cost.max(0.0);
        }
        seen.trials += 1;
        if self.contexts.len() > MOST_CONTEXTS {
            let oldest = self.contexts.iter();
            let oldest = oldest.min_by_key(|(_, context)| context.latest);
            if let Some(name) = oldest.map(|(name, _)| name.clone()) {
                self.contexts.remove(&name);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn way(name: &str, cost: f64) -> Candidate {
        Candidate {
            name: name.to_owned(),
            cost,
        }
    }

    /// Takes a step so many times: tries ways until one succeeds. How often each was tried first, and the cost of all.
    fn steps(
        belief: &mut Belief,
        (count, rng): (u32, &mut ChaCha8Rng),
        ways: &[(Candidate, f64)],
    ) -> (BTreeMap<String, u32>, f64) {
        let (mut first, mut paid) = (BTreeMap::new(), 0.0);
        for _ in 0..count {
            let mut open: Vec<Candidate> = ways.iter().map(|(way, _)| way.clone()).collect();
            let mut is_first = true;
            while let Some(choice) = belief.choose("step", &open, rng) {
                if std::mem::replace(&mut is_first, false) {
                    *first.entry(choice.name.clone()).or_default() += 1;
                }
                let (taken, chance) = ways
                    .iter()
                    .find(|(way, _)| way.name == choice.name)
                    .unwrap();
                let succeeded = rng.random::<f64>() < *chance;
                belief.note("step", &choice.name, succeeded, taken.cost);
                paid += taken.cost;
                if succeeded {
                    break;
                }
                open.retain(|way| way.name != choice.name);
            }
        }
        (first, paid)
    }

    #[test]
    fn a_way_that_is_made_bad_is_left_and_taken_up_again_when_it_is_mended() {
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut belief = Belief::default();
            let ways = |quick: f64| [(way("quick", 1.0), quick), (way("sure", 4.0), 0.98)];
            let (good, _) = steps(&mut belief, (60, &mut rng), &ways(0.95));
            assert!(good["quick"] > 50, "{seed}: {good:?}");
            steps(&mut belief, (150, &mut rng), &ways(0.02));
            let (bad, _) = steps(&mut belief, (60, &mut rng), &ways(0.02));
            assert!(bad["sure"] > 45, "{seed}: {bad:?}");
            steps(&mut belief, (200, &mut rng), &ways(0.95));
            let (again, _) = steps(&mut belief, (60, &mut rng), &ways(0.95));
            assert!(again["quick"] > 50, "{seed}: {again:?}");
        }
    }

    #[test]
    fn what_was_learnt_costs_less_than_any_fixed_order_of_the_same_ways_tried_blindly() {
        // By the order of chance over cost: b, c, a.
        let ways = [
            (way("a", 6.0), 0.9),
            (way("b", 1.0), 0.5),
            (way("c", 2.0), 0.8),
        ];
        let mean = |order: [usize; 3]| {
            let (mut reached, mut cost) = (1.0, 0.0);
            for index in order {
                cost += reached * ways[index].0.cost;
                reached *= 1.0 - ways[index].1;
            }
            cost
        };
        let best = mean([1, 2, 0]);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut belief = Belief::default();
        steps(&mut belief, (200, &mut rng), &ways);
        let (_, paid) = steps(&mut belief, (4000, &mut rng), &ways);
        let found = paid / 4000.0;
        assert!(found < 1.1 * best, "{found} {best}");
        assert!(found < mean([0, 1, 2]) && found < mean([2, 1, 0]));
    }

    #[test]
    fn the_chance_is_that_of_a_beta_belief_and_contexts_do_not_mix() {
        let mut belief = Belief::default();
        assert_eq!(belief.seen("here", "line").chance(), 0.5);
        belief.note("here", "line", true, 2.0);
        let seen = belief.seen("here", "line");
        assert!((seen.chance() - 2.0 / 3.0).abs() < 1e-12);
        assert!((seen.cost(4.0) - 3.0).abs() < 1e-12);
        assert_eq!(belief.seen("there", "line"), Seen::default());
        let bytes = postcard::to_stdvec(&belief).unwrap();
        assert_eq!(postcard::from_bytes::<Belief>(&bytes).unwrap(), belief);
    }

    #[test]
    fn the_same_seed_chooses_the_same_and_nothing_is_chosen_where_nothing_is_open() {
        let belief = Belief::default();
        let open = [way("a", 1.0), way("b", 1.0), way("c", 0.0)];
        let chosen = |seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            belief.choose("step", &open, &mut rng).unwrap()
        };
        assert!((0..20).all(|seed| chosen(seed) == chosen(seed)));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        assert_eq!(belief.choose("step", &[], &mut rng), None);
        assert_eq!(chosen(1).figures.len(), 3);
        assert_eq!(chosen(1).figures[0].name, chosen(1).name);
    }

    #[test]
    fn no_more_contexts_are_kept_than_there_is_room_for_and_the_oldest_goes_first() {
        let mut belief = Belief::default();
        for number in 0..=MOST_CONTEXTS {
            belief.note(&format!("context {number}"), "line", true, f64::NAN);
        }
        assert_eq!(belief.seen("context 0", "line").trials, 0);
        assert_eq!(belief.seen("context 1", "line").trials, 1);
    }
}
