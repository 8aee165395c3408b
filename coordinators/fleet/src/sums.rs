//! What the company knows of its sites, and sums up for displays. Data and rules only.

use std::collections::{BTreeMap, VecDeque};

use ctos::time::Instant;
use scene_summary::{Fact, Item, Mark, Question, Step, Summary, Tone};

use crate::{
    rollout::{Plan, Rollout, Stage},
    table,
    wire::{CellState, Counts, JobNumber, Overdue, Overview},
};

/// Jobs that ended within this time before tell how many end in an hour, s.
const WINDOW_S: f64 = 60.0;

/// So many questions are told at a time.
const MOST_QUESTIONS: usize = 20;

/// What may be decided about a job whose cell does not say how it ended.
const CHOICES: [&str; 2] = ["carried", "not_carried"];

/// What an operator has told.
#[derive(Debug, Default)]
struct Site {
    mark: Option<Mark>,
    counts: Counts,
    cells: BTreeMap<String, CellState>,
    overdue: Vec<Overdue>,
}

/// What is known of all sites; found again after a kill.
#[derive(Debug, Default)]
pub(crate) struct Sums {
    sites: BTreeMap<String, Site>,
    /// When jobs ended within the last minute.
    ends: VecDeque<Instant>,
    /// The net of each cell, by its agent.
    nets: BTreeMap<String, String>,
    summary: Summary,
}

/// What the company's own book says.
pub(crate) struct Jobs<'b> {
    pub(crate) issued: u64,
    pub(crate) open: usize,
    pub(crate) carried: u64,
    pub(crate) failed: u64,
    pub(crate) rollout: Option<(&'b Plan, &'b Rollout)>,
}

impl Sums {
    /// Of a company that begins now, whose cells have these nets, by their agents.
    pub(crate) fn new(now: Instant, nets: BTreeMap<String, String>) -> Self {
        Self {
            nets,
            summary: Summary::new(now.as_nanos()),
            ..Self::default()
        }
    }

    /// What to ask an operator from next.
    pub(crate) fn mark(&self, site: &str) -> Option<Mark> {
        self.sites.get(site).and_then(|site| site.mark)
    }

    /// An operator has told how its cells stand.
    pub(crate) fn take(&mut self, site: &str, overview: Overview) {
        let known = self.sites.entry(site.to_owned()).or_default();
        known.mark = Some(overview.mark);
        known.counts = overview.counts;
        known.overdue = overview.overdue;
        // An operator that was killed meets its cells anew; they are there all the same.
        known.cells.extend(overview.cells);
    }

    /// A job has ended.
    pub(crate) fn ended(&mut self, now: Instant) {
        self.ends.push_back(now);
        self.forget(now);
    }

    fn forget(&mut self, now: Instant) {
        let old = |end: &Instant| now.since(*end).as_secs_f64() > WINDOW_S;
        while self.ends.front().is_some_and(old) {
            self.ends.pop_front();
        }
    }

    /// The site of each cell that was heard of.
    pub(crate) fn cells(&self) -> BTreeMap<String, String> {
        let each = self.sites.iter();
        let each = each.flat_map(|(site, known)| known.cells.keys().map(move |cell| (cell, site)));
        each.map(|(cell, site)| (cell.clone(), site.clone()))
            .collect()
    }

    /// What has changed since a moment.
    pub(crate) fn since(&mut self, after: Option<Mark>, jobs: &Jobs<'_>, now: Instant) -> Step {
        self.forget(now);
        let mut all = Counts::default();
        let mut questions = Vec::new();
        for (site, known) in &self.sites {
            let of_site = &known.counts;
            all.cells += of_site.cells;
            all.working += of_site.working;
            all.silent += of_site.silent;
            all.waiting += of_site.waiting;
            all.deaths += of_site.deaths;
            let group = table::replica(site);
            self.summary.set_group(group, site_facts(of_site));
            questions.extend(known.overdue.iter().map(|one| question(site, one)));
            let stuck: Vec<&Overdue> = known.overdue.iter().collect();
            for (cell, state) in &known.cells {
                let is_new = jobs.rollout.is_some_and(|(_, rollout)| {
                    !rollout.is_over() && rollout.followed.contains(cell)
                });
                let mut item = Item {
                    is_new,
                    opens: self.nets.get(cell).cloned(),
                    ..shown(*state)
                };
                if let Some(one) = stuck.iter().find(|one| one.cell == *cell) {
                    item.state = format!("job {} overdue", one.job.number);
                }
                let name = table::replica(cell);
                self.summary.set_item(group, name, item);
            }
        }
        let facts = self.facts(&all, jobs, questions.len(), now);
        self.summary.set_facts(facts);
        questions.truncate(MOST_QUESTIONS);
        self.summary.set_questions(questions);
        self.summary.since(after)
    }

    fn facts(&self, all: &Counts, jobs: &Jobs<'_>, asked: usize, now: Instant) -> Vec<Fact> {
        let unless_none = |count: u64, tone| if count == 0 { Tone::Plain } else { tone };
        #[expect(clippy::cast_precision_loss, reason = "counts are small")]
        let an_hour = {
            let seconds = now.since_start().as_secs_f64().clamp(1.0, WINDOW_S);
            self.ends.len() as f64 * 3600.0 / seconds
        };
        let silent = unless_none(all.silent.into(), Tone::Warn);
        let mut facts = vec![
            Fact::new("cells", all.cells, Tone::Plain),
            Fact::new("working", all.working, Tone::Busy),
            Fact::new("silent", all.silent, silent),
            Fact::new("deaths", all.deaths, unless_none(all.deaths, Tone::Warn)),
            Fact::new("jobs issued", jobs.issued, Tone::Plain),
            Fact::new("open", jobs.open, Tone::Plain),
            Fact::new("waiting", all.waiting, Tone::Plain),
            Fact::new("carried", jobs.carried, Tone::Good),
            Fact::new(
                "not carried",
                jobs.failed,
                unless_none(jobs.failed, Tone::Warn),
            ),
            Fact::new("jobs an hour", format!("{an_hour:.0}"), Tone::Plain),
            Fact::new("for a person", asked, unless_none(asked as u64, Tone::Bad)),
        ];
        if let Some((plan, rollout)) = jobs.rollout {
            let tone = match rollout.stage {
                Stage::Before | Stage::Spreads => Tone::Busy,
                Stage::Reached => Tone::Good,
                Stage::Returns | Stage::RolledBack => Tone::Warn,
            };
            let words = format!("{}: {}", plan.words(), rollout.words(plan));
            let name = format!("version {}", rollout.version);
            facts.push(Fact::new(&name, words, tone));
        }
        facts
    }
}

fn site_facts(counts: &Counts) -> Vec<Fact> {
    let mut facts = vec![
        Fact::new("cells", counts.cells, Tone::Plain),
        Fact::new("working", counts.working, Tone::Busy),
        Fact::new("carried", counts.carried, Tone::Good),
    ];
    let rare = [
        ("waiting", u64::from(counts.waiting), Tone::Plain),
        ("silent", u64::from(counts.silent), Tone::Warn),
        ("deaths", counts.deaths, Tone::Warn),
        ("not carried", counts.failed, Tone::Warn),
    ];
    let rare = rare.into_iter().filter(|(_, count, _)| *count > 0);
    facts.extend(rare.map(|(name, count, tone)| Fact::new(name, count, tone)));
    facts
}

fn shown(state: CellState) -> Item {
    let (state, tone) = match state {
        CellState::Idle => ("idle", Tone::Plain),
        CellState::Working => ("working", Tone::Busy),
        CellState::Silent => ("silent", Tone::Warn),
        CellState::Overdue => ("overdue", Tone::Bad),
    };
    Item {
        state: state.to_owned(),
        tone,
        ..Item::default()
    }
}

fn question(site: &str, overdue: &Overdue) -> Question {
    let Overdue { job, epoch, cell } = overdue;
    let (number, from, to) = (job.number, &job.from, &job.to);
    let cell = table::replica(cell);
    Question {
        key: format!("{site} {number} {epoch}"),
        text: format!(
            "{cell} has begun job {number} (from {from} to {to}), and does not say how it ended. See that nothing moves there, and where the disc lies"
        ),
        choices: CHOICES.map(str::to_owned).to_vec(),
    }
}

/// The operator, job and epoch of a question, and whether its answer is that the job was carried.
///
/// # Errors
/// Nobody asked that.
pub(crate) fn decided(key: &str, choice: &str) -> Result<(String, JobNumber, u64, bool), String> {
    let words: Vec<&str> = key.split(' ').collect();
    let asked = match words[..] {
        [site, job, epoch] => job
            .parse()
            .ok()
            .zip(epoch.parse().ok())
            .map(|at| (site, at)),
        _ => None,
    };
    let (site, (job, epoch)) = asked.ok_or_else(|| format!("no question is called `{key}`"))?;
    let [yes, no] = CHOICES;
    let carried = match choice {
        one if one == yes => true,
        one if one == no => false,
        other => return Err(format!("`{other}` is no choice: say `{yes}` or `{no}`")),
    };
    Ok((site.to_owned(), job, epoch, carried))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn overview(seq: u64, cells: &[(&str, CellState)]) -> Overview {
        Overview {
            mark: Mark { run: 1, seq },
            counts: Counts {
                cells: 2,
                working: 1,
                ..Counts::default()
            },
            cells: cells
                .iter()
                .map(|(name, state)| ((*name).to_owned(), *state))
                .collect(),
            overdue: Vec::new(),
        }
    }

    fn jobs() -> Jobs<'static> {
        Jobs {
            issued: 9,
            open: 2,
            carried: 6,
            failed: 1,
            rollout: None,
        }
    }

    fn fact(step: &Step, name: &str) -> String {
        let facts = step.facts.iter().flatten();
        let found = facts.filter(|fact| fact.name == name);
        found.map(|fact| fact.value.clone()).collect()
    }

    #[test]
    fn sites_are_added_up_and_a_cell_is_told_again_only_when_it_stands_otherwise() {
        let mut sums = Sums::new(Instant::START, BTreeMap::new());
        let (idle, working) = (CellState::Idle, CellState::Working);
        sums.take(
            "site1.operator",
            overview(2, &[("cell1.agent", idle), ("cell2.agent", working)]),
        );
        sums.take(
            "site2.operator",
            overview(2, &[("cell3.agent", idle), ("cell4.agent", working)]),
        );
        let now = Instant::from_nanos(30_000_000_000);
        sums.ended(now);
        let whole = sums.since(None, &jobs(), now);
        assert_eq!(fact(&whole, "cells"), "4");
        assert_eq!(fact(&whole, "working"), "2");
        assert_eq!(fact(&whole, "jobs an hour"), "120");
        assert_eq!(whole.groups["site2"].items["cell3"].state, "idle");
        sums.take("site2.operator", overview(3, &[("cell3.agent", working)]));
        let step = sums.since(whole.mark, &jobs(), now);
        assert!(!step.whole && step.facts.is_none());
        let names: Vec<&str> = step.groups["site2"]
            .items
            .keys()
            .map(String::as_str)
            .collect();
        assert_eq!((step.groups.len(), names), (1, vec!["cell3"]));
        assert_eq!(sums.cells().len(), 4);
    }

    #[test]
    fn an_answer_that_nobody_asked_for_is_refused() {
        let overdue = Overdue {
            job: crate::wire::Job {
                number: 17,
                from: "1,1".into(),
                to: "2,2".into(),
            },
            epoch: 203,
            cell: "cell3.agent".to_owned(),
        };
        let asked = question("site1.operator", &overdue);
        let answer = decided(&asked.key, "carried");
        assert_eq!(answer, Ok(("site1.operator".to_owned(), 17, 203, true)));
        assert!(decided(&asked.key, "perhaps").is_err());
        assert!(decided("site1.operator 17", "carried").is_err());
    }
}
