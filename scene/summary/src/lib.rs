//! What stands below a task, summed up: counts, and groups of items that each have a state. A display shows it on one page.
//!
//! A task that has many others below it answers [`SumUp`] with what has changed since the last answer, and [`Decide`] where
//! something waits for a person. It keeps a [`Summary`], sets what it knows, and answers with [`Summary::since`]. Whoever asks
//! keeps one too, and takes in each [`Step`]. So a page costs what changes, and nothing while nobody looks.
//!
//! This crate knows no task that sums up, and no screen.

use std::collections::BTreeMap;

use ctos::{Command as _, config::App, registry::Registry};
use serde::{Deserialize, Serialize};

ctos::command! {
    /// Sums up what stands below the task, as far as it has changed since a moment
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct SumUp {
        /// The moment; none: everything.
        pub after: Option<Mark>,
    } => Step, 0x04a1, "sum_up";

    /// Decides a question that waits for a person; answered in words
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Decide {
        /// The key of the question.
        pub key: String,
        /// One of its choices.
        pub choice: String,
        /// Who decides.
        pub by: String,
    } => String, 0x04a2, "decide";
}

/// The tasks of an app that sum up what stands below them.
#[must_use]
pub fn sources(app: &App, registry: &Registry) -> Vec<String> {
    let sums_up = |handler: &str| {
        let kind = registry.kind(handler);
        kind.is_some_and(|kind| kind.command(SumUp::INFO.name).is_some())
    };
    let tasks = app.tasks.iter().filter(|task| sums_up(&task.handler));
    tasks.map(|task| task.name.clone()).collect()
}

/// A moment of what one task sums up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mark {
    /// Which run: when its task began, ns since the start of the app. A restarted task begins another.
    pub run: u64,
    /// Counts the changes.
    pub seq: u64,
}

/// How something is, for its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tone {
    /// It needs no colour.
    #[default]
    Plain,
    /// It is at work.
    Busy,
    /// It is as it should be.
    Good,
    /// Somebody should know.
    Warn,
    /// Something is wrong.
    Bad,
}

/// A line of a summary.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Fact {
    /// What it is about.
    pub name: String,
    /// How that is, with its unit.
    pub value: String,
    /// How it looks.
    pub tone: Tone,
}

impl Fact {
    /// A fact.
    #[must_use]
    pub fn new(name: &str, value: impl ToString, tone: Tone) -> Self {
        Self {
            name: name.to_owned(),
            value: value.to_string(),
            tone,
        }
    }
}

/// One of many: a small mark on the page.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Item {
    /// Its state in a word or two; items of one state are counted together.
    pub state: String,
    /// How it looks.
    pub tone: Tone,
    /// Whether something about it is new: it has a ring.
    pub is_new: bool,
    /// The net that a click leads to; none leads nowhere.
    pub opens: Option<String>,
}

/// What waits for a person.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Question {
    /// Names it in [`Decide`].
    pub key: String,
    /// What is to be found out or done.
    pub text: String,
    /// What may be decided.
    pub choices: Vec<String>,
}

/// What has changed in a group.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct GroupStep {
    /// Its facts, if they have changed.
    pub facts: Option<Vec<Fact>>,
    /// The items that have changed, by name.
    pub items: BTreeMap<String, Item>,
}

/// What has changed of a summary since a [`Mark`].
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Step {
    /// What to ask from next.
    pub mark: Option<Mark>,
    /// What was known before does not count any more.
    pub whole: bool,
    /// All facts, if any has changed.
    pub facts: Option<Vec<Fact>>,
    /// All questions, if any has changed.
    pub questions: Option<Vec<Question>>,
    /// The groups in which something has changed, by name.
    pub groups: BTreeMap<String, GroupStep>,
}

impl Step {
    /// Whether it tells something.
    #[must_use]
    pub fn is_news(&self) -> bool {
        self.whole || self.facts.is_some() || self.questions.is_some() || !self.groups.is_empty()
    }
}

/// Something, and the change that it came with.
type Dated<T> = (u64, T);

#[derive(Debug, Clone, Default)]
struct Group {
    facts: Dated<Vec<Fact>>,
    items: BTreeMap<String, Dated<Item>>,
}

/// A summary as a whole.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    run: u64,
    seq: u64,
    facts: Dated<Vec<Fact>>,
    questions: Dated<Vec<Question>>,
    groups: BTreeMap<String, Group>,
}

impl Summary {
    /// An empty one. `run` tells those of one task from each other: when it began, ns.
    #[must_use]
    pub fn new(run: u64) -> Self {
        Self {
            run,
            ..Self::default()
        }
    }

    /// The facts about all.
    pub fn set_facts(&mut self, facts: Vec<Fact>) {
        set(&mut self.facts, facts, &mut self.seq);
    }

    /// What waits for a person.
    pub fn set_questions(&mut self, questions: Vec<Question>) {
        set(&mut self.questions, questions, &mut self.seq);
    }

    /// The facts about a group.
    pub fn set_group(&mut self, group: &str, facts: Vec<Fact>) {
        let group = self.groups.entry(group.to_owned()).or_default();
        set(&mut group.facts, facts, &mut self.seq);
    }

    /// How an item of a group is.
    pub fn set_item(&mut self, group: &str, name: &str, item: Item) {
        let group = self.groups.entry(group.to_owned()).or_default();
        match group.items.get_mut(name) {
            Some(known) => set(known, item, &mut self.seq),
            None => {
                self.seq += 1;
                group.items.insert(name.to_owned(), (self.seq, item));
            }
        }
    }

    /// What has changed since a moment; everything, if the moment is none or one of another run.
    #[must_use]
    pub fn since(&self, after: Option<Mark>) -> Step {
        let known = after.filter(|mark| mark.run == self.run && mark.seq <= self.seq);
        let seq = known.map(|mark| mark.seq);
        let is_new = |at: u64| seq.is_none_or(|seq| at > seq);
        let groups = self.groups.iter().filter_map(|(name, group)| {
            let items = group.items.iter().filter(|(_, (at, _))| is_new(*at));
            let step = GroupStep {
                facts: is_new(group.facts.0).then(|| group.facts.1.clone()),
                items: items
                    .map(|(name, (_, item))| (name.clone(), item.clone()))
                    .collect(),
            };
            let news = step.facts.is_some() || !step.items.is_empty();
            news.then(|| (name.clone(), step))
        });
        Step {
            mark: Some(Mark {
                run: self.run,
                seq: self.seq,
            }),
            whole: known.is_none(),
            facts: is_new(self.facts.0).then(|| self.facts.1.clone()),
            questions: is_new(self.questions.0).then(|| self.questions.1.clone()),
            groups: groups.collect(),
        }
    }

    /// Takes in what has changed elsewhere.
    pub fn take(&mut self, step: Step) {
        if step.whole {
            let run = self.run;
            *self = Self::new(run);
        }
        if let Some(facts) = step.facts {
            self.set_facts(facts);
        }
        if let Some(questions) = step.questions {
            self.set_questions(questions);
        }
        for (name, group) in step.groups {
            if let Some(facts) = group.facts {
                self.set_group(&name, facts);
            }
            for (item, now) in group.items {
                self.set_item(&name, &item, now);
            }
        }
    }
}

fn set<T: PartialEq>(known: &mut Dated<T>, now: T, seq: &mut u64) {
    if known.1 != now {
        *seq += 1;
        *known = (*seq, now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn item(state: u64) -> Item {
        Item {
            state: format!("s{state}"),
            ..Item::default()
        }
    }

    /// The same summary without how it came to be.
    fn content(summary: &Summary) -> Step {
        Step {
            mark: None,
            ..summary.since(None)
        }
    }

    #[test]
    fn who_takes_in_every_change_knows_all_and_is_told_no_more_than_what_changed() {
        let mut told = Summary::new(7);
        let mut heard = Summary::default();
        let mut after = None;
        let mut number: u64 = 1;
        for round in 0..200 {
            // Any sequence of changes will do; this one is fixed.
            number = number
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            let changed = (number >> 33) % 5;
            for one in 0..changed {
                let name = format!("i{}", (number >> (40 + one)) % 30);
                told.set_item(&format!("g{}", one % 3), &name, item(round % 4));
            }
            if round % 7 == 0 {
                told.set_facts(vec![Fact::new("round", round, Tone::Plain)]);
                told.set_group("g1", vec![Fact::new("jobs", round / 14, Tone::Good)]);
            }
            // Whoever begins anew is told all.
            if round % 50 == 49 {
                (heard, after) = (Summary::default(), None);
            }
            let step = told.since(after);
            let items: usize = step.groups.values().map(|group| group.items.len()).sum();
            assert!(step.whole || items as u64 <= changed);
            after = step.mark;
            heard.take(step);
            assert_eq!(content(&heard), content(&told));
        }
        assert!(!told.since(after).is_news());
    }

    #[test]
    fn a_moment_of_another_run_is_answered_with_everything() {
        let mut old = Summary::new(1);
        old.set_item("g", "i", item(1));
        let mut new = Summary::new(2);
        new.set_item("g", "j", item(1));
        let mut heard = Summary::default();
        let step = old.since(None);
        let after = step.mark;
        heard.take(step);
        let step = new.since(after);
        assert!(step.whole);
        heard.take(step);
        assert_eq!(content(&heard), content(&new));
    }
}
