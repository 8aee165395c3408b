//! Nets of the literature with known answers, for tests.

use std::{fmt::Write as _, sync::Arc};

use ctos::diagnostic::Source;

use proptest::prelude::*;

use super::model::{Model, Place, Transition};
use crate::compose::System;
use pnt_language::{compile, net::Net};

pub(crate) fn net(text: &str) -> Arc<Net> {
    let source = Source::new("test.net", text);
    Arc::new(compile::net(&source).unwrap_or_else(|f| panic!("{f}")))
}

/// The model of a net, composed with its own tape.
pub(crate) fn model(text: &str) -> Model {
    let (system, findings) = System::compose(&[net(text)]);
    assert!(!findings.has_errors(), "{findings}");
    Model::of_system(&system)
}

/// Philosophers who take either fork first (model Philosophers of the Model Checking Contest).
/// 3^n markings: each fork is free or with one of its two neighbours, which decides all else.
/// Two deadlocks: all hold their left forks, or all their right ones.
pub(crate) fn philosophers(count: usize) -> Model {
    let mut text = String::from("net philosophers\n");
    for i in 0..count {
        let next = (i + 1) % count;
        let _ = write!(
            text,
            "place think{i} = 1, fork{i} = 1, left{i}, right{i}, eat{i}
transition take_left{i}
  in think{i}, fork{i}
  out left{i}
transition then_right{i}
  in left{i}, fork{next}
  out eat{i}
transition take_right{i}
  in think{i}, fork{next}
  out right{i}
transition then_left{i}
  in right{i}, fork{i}
  out eat{i}
transition end{i}
  in eat{i}
  out think{i}, fork{i}, fork{next}
"
        );
    }
    model(&text)
}

/// Four-cell Kanban system (Ciardo and Tilgner 1996; model Kanban of the Model Checking Contest).
pub(crate) fn kanban(cards: u32) -> Model {
    let mut text = String::from("net kanban\n");
    for i in 1..=4 {
        let _ = write!(
            text,
            "place pm{i}, pback{i}, pout{i}, pkan{i} = {cards}
transition tok{i}\n  in pm{i}\n  out pout{i}
transition tredo{i}\n  in pm{i}\n  out pback{i}
transition tback{i}\n  in pback{i}\n  out pm{i}\n"
        );
    }
    text.push_str(
        "transition tin1\n  in pkan1\n  out pm1
transition tsynch1\n  in pout1, pkan2, pkan3\n  out pkan1, pm2, pm3
transition tsynch2\n  in pout2, pout3, pkan4\n  out pkan2, pkan3, pm4
transition tout4\n  in pout4\n  out pkan4\n",
    );
    model(&text)
}

/// Markings of [`kanban`] with 1 to 6 cards (published by the Model Checking Contest and before).
pub(crate) const KANBAN: [u64; 6] = [160, 4_600, 58_400, 454_475, 2_546_432, 11_261_376];

/// A producer and a consumer with two states each around a buffer: 4 (n + 1) markings.
pub(crate) fn buffer(items: u32) -> Model {
    model(&format!(
        "net pc
place ready = 1, made, idle = 1, got, items, room = {items}
transition make\n  in ready\n  out made
transition put\n  in made, room\n  out ready, items
transition get\n  in idle, items\n  out got, room
transition use\n  in got\n  out idle\n"
    ))
}

/// Small nets of any kind: weights, read, inhibitor and reset arcs, capacities.
pub(crate) fn random_model() -> impl Strategy<Value = Model> {
    let places = prop::collection::vec((0_u32..3, prop::option::weighted(0.5, 1_u32..5)), 1..6);
    places.prop_flat_map(|places| {
        let count = u32::try_from(places.len()).unwrap_or(1);
        let arcs = |most| {
            let arcs = prop::collection::btree_map(0..count, 1_u32..3, 0..=most);
            arcs.prop_map(|arcs| arcs.into_iter().collect::<Vec<_>>())
        };
        let rare = prop::collection::btree_set(0..count, 0..=1);
        let rare =
            prop_oneof![6 => Just(Vec::new()), 1 => rare.prop_map(|set| set.into_iter().collect())];
        let reads = prop_oneof![4 => Just(Vec::new()), 1 => arcs(1)];
        let inhibitors = prop_oneof![4 => Just(Vec::new()), 1 => arcs(1)];
        let transition = (arcs(2), arcs(2), reads, inhibitors, rare);
        let transitions = prop::collection::vec(transition, 1..7);
        transitions.prop_map(move |transitions| Model {
            places: (0..)
                .zip(&places)
                .map(|(number, (tokens, capacity))| Place {
                    name: format!("p{number}"),
                    tokens: *tokens,
                    capacity: capacity.map(|capacity| capacity.max(*tokens)),
                })
                .collect(),
            transitions: (0..)
                .zip(transitions)
                .map(
                    |(number, (takes, puts, reads, inhibitors, resets))| Transition {
                        name: format!("t{number}"),
                        takes,
                        reads,
                        inhibitors,
                        resets,
                        puts,
                        label: Some(number),
                        ..Transition::default()
                    },
                )
                .collect(),
        })
    })
}
