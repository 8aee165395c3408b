//! A new version of a net, or of a task's arguments, goes out to more and more cells, and comes back by itself when it does
//! worse. Data and rules only.
//!
//! The test is Wald's sequential probability ratio test (A. Wald, Sequential Tests of Statistical Hypotheses, 1945): the
//! share of attempts that succeed is as before, against that share less `worse`. Both errors have the same bound. Each
//! stage of the rollout ends with a verdict of its own.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::wire::{Attempt, Outcome};

/// Shares nearer to 0 or 1 are not believed: a test would end with the first attempt.
const SHARES: (f64, f64) = (0.02, 0.98);

/// What is rolled out, and how it is judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The net, relative to the configuration's folder.
    pub net: Option<String>,
    /// The net that goes back in, the same way.
    pub before: Option<String>,
    /// The task of each cell that gets other arguments.
    pub task: Option<String>,
    /// The file with those that are other than the app's, relative to the configuration's folder.
    pub args: Option<String>,
    /// So many attempts before it tell how good the present version is.
    #[serde(default = "baseline")]
    pub baseline: u64,
    /// So much smaller a share of successes counts as worse, of that before.
    #[serde(default = "worse")]
    pub worse: f64,
    /// The chance that a verdict is wrong, at most.
    #[serde(default = "error")]
    pub error: f64,
    /// In so many cells it goes first; in twice as many more in each stage after.
    #[serde(default = "first")]
    pub first: usize,
}

/// What goes out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum What<'p> {
    /// A net, in place of another one.
    Net {
        /// Its file.
        new: &'p str,
        /// That of the other one.
        before: &'p str,
    },
    /// Arguments of a task of each cell, in place of the app's.
    Args {
        /// The task, without the name of its cell.
        task: &'p str,
        /// Their file.
        file: &'p str,
    },
}

impl Plan {
    /// What goes out; `None` where the plan does not say so.
    #[must_use]
    pub fn what(&self) -> Option<What<'_>> {
        let keys = [&self.net, &self.before, &self.task, &self.args];
        match keys.map(Option::as_deref) {
            [Some(new), Some(before), None, None] => Some(What::Net { new, before }),
            [None, None, Some(task), Some(file)] => Some(What::Args { task, file }),
            _ => None,
        }
    }

    /// What goes out, in words.
    #[must_use]
    pub fn words(&self) -> String {
        match self.what() {
            Some(What::Net { new, .. }) => new.to_owned(),
            Some(What::Args { task, file }) => format!("{file} of {task}"),
            None => String::new(),
        }
    }
}

fn baseline() -> u64 {
    60
}

fn worse() -> f64 {
    0.25
}

fn error() -> f64 {
    0.001
}

fn first() -> usize {
    2
}

/// How far it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stage {
    /// It is counted how good the present version is.
    Before,
    /// It goes to cells, and is watched there.
    Spreads,
    /// It goes back.
    Returns,
    /// All cells have it.
    Reached,
    /// No cell has it.
    RolledBack,
}

/// A rollout under way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rollout {
    /// How far it is.
    pub stage: Stage,
    /// The new version.
    pub version: u64,
    /// The last order that was given.
    pub order: u64,
    /// Cells that have the new version, or may have it.
    pub cells: BTreeSet<String>,
    /// Cells of those whose order was followed.
    pub followed: BTreeSet<String>,
    /// Successes and attempts of the present version.
    before: (u64, u64),
    /// The same of the new one, since this stage began.
    after: (u64, u64),
    /// In how many cells it was at most.
    pub most: usize,
    /// Why it went back.
    pub why: String,
}

/// What a sequential test says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Not enough was seen.
    Open,
    /// As good as before.
    AsGood,
    /// Worse.
    Worse,
}

/// Wald's test of `successes` among `attempts`: share `good` against `bad`, both errors at most `error`.
#[must_use]
pub fn verdict((successes, attempts): (u64, u64), good: f64, bad: f64, error: f64) -> Verdict {
    let (ratio, bound) = (ratio((successes, attempts), good, bad), bound(error));
    if ratio >= bound {
        Verdict::Worse
    } else if ratio <= -bound {
        Verdict::AsGood
    } else {
        Verdict::Open
    }
}

/// The statistic of the test: the logarithm of how much better `bad` explains what was seen than `good` does.
fn ratio((successes, attempts): (u64, u64), good: f64, bad: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "counts of attempts are small")]
    let (won, lost) = (successes as f64, (attempts - successes) as f64);
    won * (bad / good).ln() + lost * ((1.0 - bad) / (1.0 - good)).ln()
}

/// Where the test ends: above it worse, below its negative as good.
fn bound(error: f64) -> f64 {
    ((1.0 - error) / error).ln()
}

impl Rollout {
    /// Of this version, after `order`.
    #[must_use]
    pub fn new(version: u64) -> Self {
        Self {
            stage: Stage::Before,
            version,
            order: 0,
            cells: BTreeSet::new(),
            followed: BTreeSet::new(),
            before: (0, 0),
            after: (0, 0),
            most: 0,
            why: String::new(),
        }
    }

    /// An attempt has ended.
    pub fn saw(&mut self, attempt: &Attempt) {
        let succeeded = match attempt.outcome {
            Outcome::Carried => 1,
            Outcome::NotCarried => 0,
            // What the board was like says nothing of the version.
            _ => return,
        };
        // A person has seen how it ended; that says nothing of it either.
        if attempt.version == 0 {
            return;
        }
        let counted = match (attempt.version == self.version, self.stage) {
            (true, _) => &mut self.after,
            (false, Stage::Before) => &mut self.before,
            _ => return,
        };
        counted.0 += succeeded;
        counted.1 += 1;
    }

    /// A cell has followed its order, or says why it does not.
    pub fn installed(&mut self, cell: &str, installed: Result<u64, String>) {
        match (self.stage, installed) {
            (Stage::Spreads, Ok(version)) if version == self.version => {
                self.followed.insert(cell.to_owned());
            }
            (Stage::Returns, Ok(version)) if version != self.version => {
                self.cells.remove(cell);
                self.followed.remove(cell);
            }
            (Stage::Spreads, Err(why)) => self.go_back(format!("{cell} refused it: {why}")),
            _ => {}
        }
    }

    /// Goes on: to the next cells of all that there are, back, or to the end.
    pub fn step(&mut self, all: &BTreeSet<String>, plan: &Plan) {
        match self.stage {
            Stage::Before if self.before.1 >= plan.baseline && !all.is_empty() => {
                self.stage = Stage::Spreads;
                self.spread(all, plan.first);
            }
            Stage::Spreads => self.watch(all, plan),
            Stage::Returns if self.cells.is_empty() => self.stage = Stage::RolledBack,
            _ => {}
        }
    }

    /// The share that succeeded before, as the test takes it, and the share that is worse.
    fn shares(&self, plan: &Plan) -> (f64, f64) {
        #[expect(clippy::cast_precision_loss, reason = "counts of attempts are small")]
        let share = self.before.0 as f64 / self.before.1.max(1) as f64;
        let good = share.clamp(SHARES.0, SHARES.1);
        let bad = (share * (1.0 - plan.worse)).clamp(SHARES.0 / 2.0, good * 0.99);
        (good, bad)
    }

    /// How far it is, in words with the statistic of the test.
    #[must_use]
    pub fn words(&self, plan: &Plan) -> String {
        let (won, tried) = self.before;
        let (successes, attempts) = self.after;
        match self.stage {
            Stage::Before => format!(
                "counts attempts before it: {won} of {tried} succeeded, {} are wanted",
                plan.baseline
            ),
            Stage::Spreads => {
                let (good, bad) = self.shares(plan);
                format!(
                    "in {} cells, {successes} of {attempts} attempts succeeded; test {:+.1}, worse at {:+.1}, as good at {:+.1}",
                    self.followed.len(),
                    ratio(self.after, good, bad),
                    bound(plan.error),
                    -bound(plan.error),
                )
            }
            Stage::Returns => format!("goes back from {} cells: {}", self.cells.len(), self.why),
            Stage::Reached => "is in all cells".to_owned(),
            Stage::RolledBack => format!("was rolled back: {}", self.why),
        }
    }

    fn watch(&mut self, all: &BTreeSet<String>, plan: &Plan) {
        let (good, bad) = self.shares(plan);
        match verdict(self.after, good, bad, plan.error) {
            Verdict::Worse => {
                let (won, tried) = self.before;
                let before = format!("{won} of {tried}");
                let (won, tried) = self.after;
                let why = format!("{won} of {tried} attempts succeeded, before it {before}");
                self.go_back(why);
            }
            Verdict::AsGood if self.followed == self.cells => {
                self.after = (0, 0);
                if self.cells.is_superset(all) {
                    self.stage = Stage::Reached;
                } else {
                    self.spread(all, self.cells.len() * 2);
                }
            }
            Verdict::AsGood | Verdict::Open => {}
        }
    }

    fn spread(&mut self, all: &BTreeSet<String>, count: usize) {
        let next: Vec<String> = all.difference(&self.cells).take(count).cloned().collect();
        self.cells.extend(next);
        self.most = self.most.max(self.cells.len());
        self.order += 1;
    }

    fn go_back(&mut self, why: String) {
        self.stage = Stage::Returns;
        self.why = why;
        self.followed.clear();
        self.order += 1;
    }

    /// The cells that have not followed the last order, each with what it shall have: the new version, or not.
    #[must_use]
    pub fn orders(&self) -> BTreeMap<String, bool> {
        let open = self.cells.difference(&self.followed);
        let new = self.stage == Stage::Spreads;
        match self.stage {
            Stage::Spreads | Stage::Returns => open.map(|cell| (cell.clone(), new)).collect(),
            _ => BTreeMap::new(),
        }
    }

    /// Whether nothing is to be done any more.
    #[must_use]
    pub fn is_over(&self) -> bool {
        matches!(self.stage, Stage::Reached | Stage::RolledBack)
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    use super::*;

    /// How often so many tests in a thousand end with this verdict, when this share succeeds.
    fn ends(share: f64, wanted: Verdict) -> u32 {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut count = 0;
        for _ in 0..1000 {
            let mut seen = (0, 0);
            let ended = loop {
                let luck: f64 = rng.random();
                seen.0 += u64::from(luck < share);
                seen.1 += 1;
                match verdict(seen, 0.9, 0.6, 0.01) {
                    Verdict::Open => {}
                    ended => break ended,
                }
            };
            count += u32::from(ended == wanted);
        }
        count
    }

    #[test]
    fn the_sequential_test_errs_no_more_often_than_it_may() {
        // Wald: at most error / (1 - error) each; ten of a thousand, and chance.
        assert!(ends(0.9, Verdict::Worse) <= 20);
        assert!(ends(0.6, Verdict::AsGood) <= 20);
        assert!(ends(0.3, Verdict::Worse) == 1000);
    }

    fn plan() -> Plan {
        Plan {
            net: None,
            before: None,
            task: None,
            args: None,
            baseline: 20,
            worse: 0.25,
            error: 0.001,
            first: 2,
        }
    }

    /// Runs a rollout over 30 cells in which this share of attempts succeeds with the new version.
    fn rolled(share: f64) -> Rollout {
        let all: BTreeSet<String> = (0..30).map(|cell| format!("c{cell:02}")).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut rollout = Rollout::new(2);
        for _ in 0..2000 {
            for (cell, new) in rollout.orders() {
                rollout.installed(&cell, Ok(if new { 2 } else { 1 }));
            }
            for cell in &all {
                let new = rollout.cells.contains(cell);
                let luck: f64 = rng.random();
                let outcome = match luck < if new { share } else { 0.93 } {
                    true => Outcome::Carried,
                    false => Outcome::NotCarried,
                };
                rollout.saw(&Attempt {
                    cell: cell.clone(),
                    version: if new { 2 } else { 1 },
                    outcome,
                });
            }
            rollout.step(&all, &plan());
            if rollout.is_over() {
                break;
            }
        }
        rollout
    }

    #[test]
    fn a_version_that_is_as_good_reaches_all_and_a_worse_one_goes_back_after_few_cells() {
        let good = rolled(0.95);
        assert_eq!((good.stage, good.most), (Stage::Reached, 30));
        let bad = rolled(0.55);
        assert_eq!((bad.stage, bad.most), (Stage::RolledBack, 2));
        assert!(bad.cells.is_empty());
    }

    #[test]
    fn a_version_that_a_cell_refuses_goes_back() {
        let all: BTreeSet<String> = ["a".to_owned(), "b".to_owned()].into();
        let mut rollout = Rollout::new(2);
        rollout.before = (18, 20);
        rollout.step(&all, &plan());
        rollout.installed("a", Ok(2));
        rollout.installed("b", Err("it is not sound".to_owned()));
        assert_eq!(rollout.stage, Stage::Returns);
        for cell in ["a", "b"] {
            rollout.installed(cell, Ok(1));
        }
        rollout.step(&all, &plan());
        assert_eq!(rollout.stage, Stage::RolledBack);
    }
}
