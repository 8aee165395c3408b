//! Which transitions depend on a place or on a tape symbol, and in which order transitions are
//! chosen. Fixed for a net.

use std::{cmp::Reverse, collections::BTreeMap};

use crate::net::{Net, PlaceId, TransitionId};

/// A transition's condition on a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Watch {
    pub(super) transition: TransitionId,
    /// The condition is about holding this many tokens.
    pub(super) weight: u32,
    /// Whether the place must hold them (input, read arc) or must not (inhibitor arc).
    pub(super) wanted: bool,
}

#[derive(Debug)]
pub(super) struct Wiring {
    /// Per place.
    pub(super) around: Vec<Vec<Watch>>,
    /// Per command, the transitions that read it.
    pub(super) readers: Vec<Vec<TransitionId>>,
    /// Per transition, its position by priority and declared order.
    pub(super) ranks: Vec<usize>,
    /// The inverse of `ranks`.
    pub(super) at_rank: Vec<TransitionId>,
    pub(super) place_names: BTreeMap<String, PlaceId>,
}

impl Wiring {
    pub(super) fn new(net: &Net) -> Self {
        let mut around = vec![Vec::new(); net.places().len()];
        let mut readers = vec![Vec::new(); net.commands().len()];
        let ids = || (0..).map(TransitionId).zip(net.transitions());
        for (id, transition) in ids() {
            let wanted = transition
                .inputs
                .iter()
                .chain(&transition.reads)
                .map(|arc| (arc, true));
            let unwanted = transition.inhibitors.iter().map(|arc| (arc, false));
            for (arc, wanted) in wanted.chain(unwanted) {
                around[arc.place.index()].push(Watch {
                    transition: id,
                    weight: arc.weight,
                    wanted,
                });
            }
            if let Some(command) = transition.tape {
                readers[command.index()].push(id);
            }
        }
        let mut at_rank: Vec<TransitionId> = ids().map(|(id, _)| id).collect();
        at_rank.sort_by_key(|id| Reverse(net[*id].priority));
        let mut ranks = vec![0; at_rank.len()];
        for (rank, id) in at_rank.iter().enumerate() {
            ranks[id.index()] = rank;
        }
        Self {
            around,
            readers,
            ranks,
            at_rank,
            place_names: (0..)
                .map(PlaceId)
                .zip(net.places())
                .map(|(id, place)| (place.name.clone(), id))
                .collect(),
        }
    }
}
