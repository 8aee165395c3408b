//! How long the steps of a net took over several commands: a table of its transitions whose actions take time.

use std::{
    collections::{BTreeMap, HashMap},
    time::Duration,
};

use ctos::time::Instant;
use pnt::task::FiringEvent;

/// Steps that never took so long are left out.
const SHORT: Duration = Duration::from_millis(10);

/// What a step took.
#[derive(Debug, Default, PartialEq)]
struct Took {
    /// When it ended first, by which steps are ordered, ns.
    first_ns: u64,
    times: u32,
    sum: Duration,
    most: Duration,
}

/// What all steps took so far.
#[derive(Debug, Default)]
pub(super) struct Phases(BTreeMap<String, Took>);

impl Phases {
    /// Counts the steps that began at a moment or later.
    pub(super) fn add(&mut self, events: &[FiringEvent], from: Instant) {
        let mut begun: HashMap<&str, u64> = HashMap::new();
        let events = events.iter().filter(|event| event.at_ns >= from.as_nanos());
        for event in events {
            let (at_ns, (step, begins)) = (event.at_ns, part(event));
            if begins {
                begun.insert(step, at_ns);
            } else if let Some(began) = begun.remove(step) {
                let took = self.0.entry(step.to_owned()).or_insert_with(|| Took {
                    first_ns: at_ns,
                    ..Took::default()
                });
                let time = Duration::from_nanos(at_ns.saturating_sub(began));
                took.times += 1;
                took.sum += time;
                took.most = took.most.max(time);
            }
        }
    }

    /// The table, in the order of the steps: how often each was done, and how long that took, s.
    pub(super) fn table(&self) -> String {
        let mut steps: Vec<(&String, &Took)> = self.0.iter().collect();
        steps.retain(|(_, took)| took.most >= SHORT);
        steps.sort_by_key(|(_, took)| took.first_ns);
        let rows = steps.into_iter().map(|(step, took)| {
            let mean = took.sum.as_secs_f64() / f64::from(took.times.max(1));
            let (times, most) = (took.times, took.most.as_secs_f64());
            format!("\n{step:<16} {times:>4} {mean:>7.2} {most:>7.2}")
        });
        let head = format!(
            "{:<16} {:>4} {:>7} {:>7}",
            "step", "done", "mean s", "most s"
        );
        std::iter::once(head).chain(rows).collect()
    }
}

/// The transition as the author wrote it, and whether it begins: a request is a transition that asks and one that takes the answer.
fn part(event: &FiringEvent) -> (&str, bool) {
    let name = event.transition.as_str();
    let ends = ["end_", "fail_"];
    match event.phase.as_str() {
        "fired" => match name.strip_prefix("start_") {
            Some(step) => (step, true),
            None => {
                let step = ends.iter().find_map(|end| name.strip_prefix(end));
                (step.unwrap_or(name), false)
            }
        },
        phase => (name, phase == "started"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(at_ms: u64, transition: &str, phase: &str) -> FiringEvent {
        FiringEvent {
            at_ns: at_ms * 1_000_000,
            transition: transition.to_owned(),
            phase: phase.to_owned(),
            text: String::new(),
        }
    }

    #[test]
    fn each_step_is_counted_with_its_mean_and_its_longest_time_in_the_order_of_the_steps() {
        let mut phases = Phases::default();
        let earlier = [event(1, "lift", "started"), event(900, "lift", "completed")];
        let first = [
            event(1000, "lift", "started"),
            event(1200, "start_approach", "fired"),
            event(2000, "lift", "completed"),
            event(2001, "judge", "started"),
            event(2002, "judge", "completed"),
            event(2700, "fail_approach", "fired"),
        ];
        let second = [
            event(3000, "lift", "started"),
            event(5000, "lift", "completed"),
        ];
        phases.add(
            &[&earlier[..], &first[..]].concat(),
            Instant::from_nanos(1_000_000_000),
        );
        phases.add(&second, Instant::from_nanos(3_000_000_000));
        let table = phases.table();
        let rows: Vec<Vec<&str>> = table
            .lines()
            .map(|line| line.split_whitespace().collect())
            .collect();
        assert_eq!(
            rows[1..],
            [
                vec!["lift", "2", "1.50", "2.00"],
                vec!["approach", "1", "1.50", "1.50"]
            ]
        );
    }
}
