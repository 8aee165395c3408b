//! Circles of tasks that wait for each other before they have finished their startup.
//!
//! A task handles one message at a time, and entering a startup phase is one. While it waits there
//! for another task's answer it answers nobody, so in a circle nobody would ever go on.

use std::collections::BTreeSet;

use petgraph::{
    algo::astar,
    graph::{DiGraph, NodeIndex},
    visit::NodeFiltered,
};

use crate::registry::Registry;
use ctos_config::{
    App,
    diagnostic::{Finding, Findings},
};

/// Adds a finding for each circle. `registry` says which tasks a task waits for.
pub(super) fn check(app: &App, registry: &Registry, findings: &mut Findings) {
    let position = |name: &String| app.tasks.iter().position(|task| task.name == *name);
    let waits_for: Vec<Vec<usize>> = app
        .tasks
        .iter()
        .map(|task| {
            let kind = registry.kind(&task.handler);
            let names = kind.map(|kind| kind.waits_for_names(task));
            names.iter().flatten().filter_map(position).collect()
        })
        .collect();
    for circle in circles(&waits_for) {
        let tasks: Vec<_> = circle.iter().filter_map(|at| app.tasks.get(*at)).collect();
        let Some(first) = tasks.first() else {
            continue;
        };
        let others = tasks.iter().skip(1).chain([first]);
        let others: Vec<_> = others.map(|task| format!("`{}`", task.name)).collect();
        let finding = Finding::error(
            "ctos::config::waiting_cycle",
            format!(
                "task `{}` waits in its startup for {}",
                first.name,
                others.join(", which waits for ")
            ),
        )
        .help("let one of them ask in the phase `run` without waiting there, or when it is called");
        findings.push(finding.at(first.place.clone()));
    }
}

/// Every circle once, of numbers below the length of `waits_for`: it begins with its smallest member.
/// Circles that share a member with one that is found already are left for when that is mended.
fn circles(waits_for: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let tasks = waits_for.iter().enumerate();
    let waits = tasks.flat_map(|(task, others)| others.iter().map(move |other| (task, *other)));
    let graph = DiGraph::<(), (), usize>::from_edges(waits);
    let mut done = BTreeSet::<NodeIndex<usize>>::new();
    let mut found = Vec::new();
    for start in graph.node_indices() {
        if done.contains(&start) {
            continue;
        }
        let left = NodeFiltered::from_fn(&graph, |node| !done.contains(&node));
        let closes = |last| graph.contains_edge(last, start);
        if let Some((_, circle)) = astar(&left, start, closes, |_| 1, |_| 0) {
            done.extend(&circle);
            found.push(circle.into_iter().map(NodeIndex::index).collect());
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Whether a task that waits can ever go on: those that wait for nobody do, then those that
    /// wait for these, and so on.
    fn all_go_on(waits_for: &[Vec<usize>]) -> bool {
        let mut gone_on = vec![false; waits_for.len()];
        for _ in waits_for {
            for (task, others) in waits_for.iter().enumerate() {
                gone_on[task] |= others.iter().all(|other| gone_on[*other]);
            }
        }
        gone_on.iter().all(|gone_on| *gone_on)
    }

    proptest! {
        #[test]
        fn a_circle_is_found_exactly_when_somebody_would_wait_for_ever(
            waits_for in (1_usize..8).prop_flat_map(|tasks| {
                prop::collection::vec(prop::collection::vec(0..tasks, 0..3), tasks)
            })
        ) {
            let circles = circles(&waits_for);
            prop_assert_eq!(circles.is_empty(), all_go_on(&waits_for));
            for circle in circles {
                for (at, task) in circle.iter().enumerate() {
                    let next = circle[(at + 1) % circle.len()];
                    prop_assert!(waits_for[*task].contains(&next), "{:?}", circle);
                }
            }
        }
    }
}
