//! What follows from the arcs alone, as a check tells it.

use std::{collections::BTreeMap, fmt::Write as _, sync::Arc};

use pnt::{
    analysis::{
        model::Model,
        structure::{
            Arcs,
            classes::{Rank, classes, rank_theorem},
            components::{MarkedGraph, cycle, marked_graphs, state_machines},
            semiflows::{place_invariants, transition_invariants},
            siphons::uncontrolled,
        },
    },
    net::Net,
    timing::Timing,
};
use serde::Serialize;

/// A check looks for so much of anything at most.
const MOST: usize = 5_000;

/// What follows from the arcs. `None` is written as `null`: there was too much of it.
#[derive(Debug, Serialize)]
pub(super) struct Structure {
    /// By name of place, its weight: no firing changes the weighted sum of tokens.
    place_invariants: Option<Vec<BTreeMap<String, u64>>>,
    /// By name of transition, how often it fires: all together change nothing.
    transition_invariants: Option<Vec<BTreeMap<String, u64>>>,
    /// Places that can run empty for good, because no trap in them is marked: what a deadlock rests on.
    uncontrolled_siphons: Option<Vec<Vec<String>>>,
    /// By the siphons alone; only ordinary nets permit that.
    deadlock_free: Option<bool>,
    state_machine: bool,
    marked_graph: bool,
    free_choice: bool,
    /// Of a free-choice net: whether some initial marking makes it live and bounded.
    well_formed: Option<bool>,
    state_machine_components: Option<usize>,
    marked_graph_components: Option<Vec<Graph>>,
}

/// A marked-graph component.
#[derive(Debug, Serialize)]
struct Graph {
    transitions: Vec<String>,
    /// By place, the transition that takes its token, where others could.
    choices: BTreeMap<String, String>,
    /// Best time from one round to the next; `None` when some circuit of it has no token.
    cycle_time_s: Option<f64>,
    /// The circuit that takes longest for each of its tokens.
    bottleneck: Vec<String>,
}

impl Structure {
    pub(super) fn new(nets: &[Arc<Net>], model: &Model) -> Self {
        let arcs = Arcs::of(model);
        let place = |number: usize| model.places[number].name.clone();
        let transition = |number: usize| model.transitions[number].name.clone();
        let named = |flows: Vec<Vec<u64>>, name: &dyn Fn(usize) -> String| {
            let one = |weights: Vec<u64>| -> BTreeMap<String, u64> {
                let pairs = weights
                    .into_iter()
                    .enumerate()
                    .filter(|(_, weight)| *weight > 0);
                pairs
                    .map(|(number, weight)| (name(number), weight))
                    .collect()
            };
            flows.into_iter().map(one).collect::<Vec<_>>()
        };
        let siphons = uncontrolled(&arcs, &model.initial(), MOST);
        let classes = classes(&arcs);
        let delays = delays(nets, model);
        let graph = |graph: MarkedGraph| {
            let cycle = cycle(model, &graph.part, &delays);
            Graph {
                transitions: graph
                    .part
                    .transitions
                    .iter()
                    .map(|t| transition(*t))
                    .collect(),
                choices: graph
                    .choices
                    .iter()
                    .map(|(p, t)| (place(*p), transition(*t)))
                    .collect(),
                cycle_time_s: cycle.as_ref().map(|cycle| cycle.time),
                bottleneck: cycle
                    .map(|cycle| cycle.bottleneck.into_iter().map(transition).collect())
                    .unwrap_or_default(),
            }
        };
        Self {
            place_invariants: place_invariants(model, MOST).map(|flows| named(flows, &place)),
            transition_invariants: transition_invariants(model, MOST)
                .map(|flows| named(flows, &transition)),
            deadlock_free: match &siphons {
                Some(siphons) if arcs.ordinary && siphons.is_empty() => Some(true),
                _ => None,
            },
            uncontrolled_siphons: siphons.map(|siphons| {
                let names = |siphon: Vec<usize>| siphon.into_iter().map(place).collect();
                siphons.into_iter().map(names).collect()
            }),
            state_machine: classes.state_machine,
            marked_graph: classes.marked_graph,
            free_choice: classes.free_choice,
            well_formed: rank_theorem(model, MOST).map(|Rank { well_formed, .. }| well_formed),
            state_machine_components: state_machines(model, MOST).map(|parts| parts.len()),
            marked_graph_components: marked_graphs(model, MOST)
                .map(|graphs| graphs.into_iter().map(graph).collect()),
        }
    }

    /// Lines for a person, each with a line break before it.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        let sums = |title: &str, flows: &Option<Vec<BTreeMap<String, u64>>>| {
            let Some(flows) = flows else {
                return format!("\n  {title}: too many");
            };
            let mut lines = format!("\n  {title}: {}", flows.len());
            for flow in flows {
                let parts: Vec<String> = flow
                    .iter()
                    .map(|(name, weight)| match weight {
                        1 => name.clone(),
                        _ => format!("{weight}*{name}"),
                    })
                    .collect();
                let _ = write!(lines, "\n    {}", parts.join(" + "));
            }
            lines
        };
        text.push_str(&sums("place invariants", &self.place_invariants));
        text.push_str(&sums("transition invariants", &self.transition_invariants));
        for siphon in self.uncontrolled_siphons.iter().flatten() {
            let _ = write!(text, "\n  siphon that can run empty: {}", siphon.join(", "));
        }
        if self.deadlock_free == Some(true) {
            text.push_str("\n  no deadlock: every siphon contains a marked trap");
        }
        let classes = [
            (self.state_machine, "state machine"),
            (self.marked_graph, "marked graph"),
            (self.free_choice, "free choice"),
            (self.well_formed == Some(true), "well formed"),
        ];
        let classes: Vec<&str> = classes
            .iter()
            .filter(|(is, _)| *is)
            .map(|(_, name)| *name)
            .collect();
        if !classes.is_empty() {
            let _ = write!(text, "\n  class: {}", classes.join(", "));
        }
        for graph in self.marked_graph_components.iter().flatten() {
            let _ = write!(text, "\n  marked graph: {}", graph.transitions.join(", "));
            if let Some(time) = graph.cycle_time_s.filter(|time| *time > 0.0) {
                let _ = write!(
                    text,
                    "; {time} s a round, held up by {}",
                    graph.bottleneck.join(", ")
                );
            }
        }
        text
    }
}

/// Mean times by transition of the model, in s.
fn delays(nets: &[Arc<Net>], model: &Model) -> Vec<f64> {
    let means: Vec<f64> = nets
        .iter()
        .flat_map(|net| net.transitions())
        .map(|transition| match transition.timing {
            Timing::Immediate => 0.0,
            Timing::Deterministic(time) => time.as_secs_f64(),
            Timing::Exponential { mean } | Timing::Normal { mean, .. } => mean.as_secs_f64(),
        })
        .collect();
    let mean = |label: Option<u32>| means.get(label? as usize).copied();
    model
        .transitions
        .iter()
        .map(|t| mean(t.label).unwrap_or(0.0))
        .collect()
}
