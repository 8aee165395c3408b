//! The order of synchronous functions within a tick, derived from the data that flows between them.
//!
//! The writer of a signal runs before its readers in the same tick, and after those that read its value of the
//! tick before. Where the data leaves the order open, functions run as they were added, so the same program always
//! has the same order.

use std::collections::{BTreeMap, BTreeSet};

use petgraph::{
    Direction,
    algo::tarjan_scc,
    graph::{DiGraph, NodeIndex},
};

use super::{CyclicError, FunctionView};

/// The order in which functions run, as places in `flows`.
///
/// # Errors
/// [`CyclicError::Circle`] and [`CyclicError::TwoWriters`].
pub(super) fn order(flows: &[&FunctionView]) -> Result<Vec<usize>, CyclicError> {
    let graph = graph(flows)?;
    // A component of more than one function is a circle; a function that reads what it wrote itself is none.
    if let Some(circle) = tarjan_scc(&graph).into_iter().find(|part| part.len() > 1) {
        return Err(error(flows, &graph, circle));
    }
    let mut before: Vec<usize> = graph
        .node_indices()
        .map(|node| graph.neighbors_directed(node, Direction::Incoming).count())
        .collect();
    let mut free: BTreeSet<NodeIndex> = graph
        .node_indices()
        .filter(|node| before.get(node.index()) == Some(&0))
        .collect();
    let mut order = Vec::with_capacity(flows.len());
    while let Some(node) = free.pop_first() {
        order.push(node.index());
        for after in graph.neighbors(node) {
            if let Some(count) = before.get_mut(after.index()) {
                *count -= 1;
                if *count == 0 {
                    free.insert(after);
                }
            }
        }
    }
    Ok(order)
}

/// Functions as nodes, in the order of `flows`, and an edge from each to those that must run after it.
fn graph<'a>(flows: &[&'a FunctionView]) -> Result<DiGraph<(), &'a str>, CyclicError> {
    let mut graph = DiGraph::with_capacity(flows.len(), flows.len());
    let nodes: Vec<NodeIndex> = flows.iter().map(|_| graph.add_node(())).collect();
    let mut writers: BTreeMap<&str, (NodeIndex, &FunctionView)> = BTreeMap::new();
    for (node, flow) in nodes.iter().zip(flows) {
        for signal in &flow.writes {
            if let Some((_, first)) = writers.insert(signal, (*node, flow)) {
                return Err(CyclicError::TwoWriters {
                    signal: signal.clone(),
                    first: first.name.clone(),
                    second: flow.name.clone(),
                });
            }
        }
    }
    for (node, flow) in nodes.iter().zip(flows) {
        let reads = flow.reads.iter().map(|signal| (signal, true));
        let previous = flow.reads_previous.iter().map(|signal| (signal, false));
        for (signal, after) in reads.chain(previous) {
            let Some((writer, _)) = writers.get(signal.as_str()) else {
                continue;
            };
            let (from, to) = if after {
                (writer, node)
            } else {
                (node, writer)
            };
            if writer != node {
                graph.update_edge(*from, *to, signal.as_str());
            }
        }
    }
    Ok(graph)
}

fn error(
    flows: &[&FunctionView],
    graph: &DiGraph<(), &str>,
    mut circle: Vec<NodeIndex>,
) -> CyclicError {
    circle.sort_unstable();
    let signals: BTreeSet<&str> = graph
        .edge_indices()
        .filter_map(|edge| {
            let (from, to) = graph.edge_endpoints(edge)?;
            let inside = circle.contains(&from) && circle.contains(&to);
            graph.edge_weight(edge).filter(|_| inside).copied()
        })
        .collect();
    let functions = circle
        .iter()
        .filter_map(|node| flows.get(node.index()))
        .map(|flow| flow.name.clone());
    CyclicError::Circle {
        functions: functions.collect(),
        signals: signals.into_iter().map(str::to_owned).collect(),
    }
}

/// The signals that somebody reads and nobody writes.
pub(super) fn unwritten(flows: &[&FunctionView]) -> Vec<String> {
    let written: BTreeSet<&str> = flows
        .iter()
        .flat_map(|flow| &flow.writes)
        .map(String::as_str)
        .collect();
    let read = flows
        .iter()
        .flat_map(|flow| flow.reads.iter().chain(&flow.reads_previous));
    let missing: BTreeSet<&str> = read
        .map(String::as_str)
        .filter(|signal| !written.contains(signal))
        .collect();
    missing.into_iter().map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn flow(name: &str, reads: &[&str], previous: &[&str], writes: &[&str]) -> FunctionView {
        let list = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        FunctionView {
            name: name.to_owned(),
            reads: list(reads),
            reads_previous: list(previous),
            writes: list(writes),
            ..FunctionView::default()
        }
    }

    fn names(flows: &[FunctionView]) -> Vec<&str> {
        let order = order(&flows.iter().collect::<Vec<_>>()).unwrap();
        order
            .iter()
            .map(|place| flows[*place].name.as_str())
            .collect()
    }

    #[test]
    fn a_servo_loop_runs_from_the_sensor_to_the_motor() {
        let flows = [
            flow("drive", &["torque"], &[], &[]),
            flow("law", &["position", "setpoint"], &[], &["torque"]),
            flow("plan", &[], &["position"], &["setpoint"]),
            flow("sense", &[], &[], &["position"]),
        ];
        assert_eq!(names(&flows), ["plan", "sense", "law", "drive"]);
    }

    #[test]
    fn without_data_functions_run_as_they_were_added() {
        let flows = ["c", "a", "b"].map(|name| flow(name, &[], &[], &[]));
        assert_eq!(names(&flows), ["c", "a", "b"]);
    }

    #[test]
    fn a_circle_is_named_with_its_signals() {
        let flows = [
            flow("law", &["position"], &[], &["torque"]),
            flow("arm", &["torque"], &[], &["position"]),
            flow("log", &["position"], &[], &[]),
        ];
        let error = order(&flows.iter().collect::<Vec<_>>()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the data of `law`, `arm` flows in a circle (`position`, `torque`); let one of them take the value of the tick before with `reads_previous`"
        );
    }

    #[test]
    fn a_function_may_read_what_it_wrote_itself() {
        assert_eq!(names(&[flow("filter", &["x"], &["x"], &["x"])]), ["filter"]);
    }

    #[test]
    fn two_writers_of_a_signal_are_refused() {
        let flows = [flow("a", &[], &[], &["x"]), flow("b", &[], &[], &["x"])];
        let error = order(&flows.iter().collect::<Vec<_>>()).unwrap_err();
        assert!(
            error.to_string().contains("written by `a` and by `b`"),
            "{error}"
        );
    }

    proptest! {
        /// Functions that each read what earlier ones write, shuffled, come out in an order that keeps every
        /// promise, whatever the shuffle.
        #[test]
        fn every_reader_runs_after_its_writer(
            edges in proptest::collection::btree_set((0_usize..12, 0_usize..12), 0..40),
            keys in proptest::collection::vec(any::<u32>(), 12),
        ) {
            let mut flows: Vec<FunctionView> = (0..12)
                .map(|number| {
                    let sources = edges.iter().filter(|(from, to)| from < to && *to == number);
                    FunctionView {
                        name: number.to_string(),
                        reads: sources.map(|(from, _)| format!("s{from}")).collect(),
                        reads_previous: Vec::new(),
                        writes: vec![format!("s{number}")],
                        ..FunctionView::default()
                    }
                })
                .collect();
            flows.sort_by_key(|flow| keys[flow.name.parse::<usize>().unwrap()]);
            let order = order(&flows.iter().collect::<Vec<_>>()).unwrap();
            let mut sorted = order.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..12).collect::<Vec<_>>());
            let mut written = BTreeSet::new();
            for place in order {
                for signal in &flows[place].reads {
                    prop_assert!(written.contains(signal), "{signal} is read too early");
                }
                written.extend(flows[place].writes.iter().cloned());
            }
        }

        #[test]
        fn any_data_flow_is_ordered_or_refused_and_never_loops(
            edges in proptest::collection::vec((0_usize..8, 0_usize..8, any::<bool>()), 0..30),
        ) {
            let flows: Vec<FunctionView> = (0..8)
                .map(|number| {
                    let mut flow = flow(&number.to_string(), &[], &[], &[&format!("s{number}")]);
                    for (from, to, previous) in &edges {
                        if *to == number {
                            let list = if *previous { &mut flow.reads_previous } else { &mut flow.reads };
                            list.push(format!("s{from}"));
                        }
                    }
                    flow
                })
                .collect();
            if let Ok(order) = order(&flows.iter().collect::<Vec<_>>()) {
                prop_assert_eq!(order.len(), 8);
            }
        }
    }
}
