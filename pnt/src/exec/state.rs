//! The whole state of an execution as data, to be stored and taken up again.

use std::{collections::BTreeMap, sync::Arc};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Enabling, Execution, FiringId, Running, Tape, wiring::Wiring};
use crate::net::{CommandId, Net, TransitionId};

/// A net's marking, tape and firings between start and end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// Tokens of every place, in order of place number.
    pub marking: Vec<u32>,
    tape: Tape,
    running: Vec<(FiringId, TransitionId, Option<u64>)>,
    firings: u64,
}

/// Why a state does not fit a net.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("the state is not one of net `{net}`: {what}")]
pub struct StateError {
    /// The net.
    pub net: String,
    /// What does not fit.
    pub what: String,
}

impl Execution {
    /// The state as it is now.
    #[must_use]
    pub fn state(&self) -> State {
        let running = self.running.iter();
        State {
            marking: self.marking().to_vec(),
            tape: self.tape.clone(),
            running: running
                .map(|(id, running)| (*id, running.transition, running.command))
                .collect(),
            firings: self.firings,
        }
    }

    /// A net in a state that [`Self::state`] gave.
    ///
    /// # Errors
    /// When the state is that of another net.
    pub fn restore(net: Arc<Net>, state: State) -> Result<Self, StateError> {
        let wrong = |what: String| StateError {
            net: net.name().to_owned(),
            what,
        };
        let (places, stored) = (net.places().len(), state.marking.len());
        if places != stored {
            return Err(wrong(format!("it has {stored} places, the net {places}")));
        }
        let known = |id: &TransitionId| id.index() < net.transitions().len();
        if !state.running.iter().all(|(_, id, _)| known(id)) {
            return Err(wrong("a transition is running that it has not".to_owned()));
        }
        let taken = |on_tape: &super::OnTape| on_tape.command.index() < net.commands().len();
        if !(state.tape.waiting().all(taken) && state.tape.current().is_none_or(taken)) {
            return Err(wrong(
                "a command is on its tape that it does not take".to_owned(),
            ));
        }
        let wiring = Arc::new(Wiring::new(&net));
        let running: BTreeMap<_, _> = state
            .running
            .into_iter()
            .map(|(id, transition, command)| {
                let running = Running {
                    transition,
                    command,
                };
                (id, running)
            })
            .collect();
        let mut execution = Self {
            enabling: Enabling::at(&net, &wiring, state.marking),
            tape: Tape::default(),
            running,
            firings: state.firings,
            wiring,
            net,
        };
        execution.with_tape(|tape| *tape = state.tape);
        Ok(execution)
    }
}

impl State {
    /// The state of a net in which nothing has happened yet.
    #[must_use]
    pub fn initial(net: &Net) -> Self {
        Self {
            marking: net.places().iter().map(|place| place.tokens).collect(),
            tape: Tape::default(),
            running: Vec::new(),
            firings: 0,
        }
    }

    /// This state carried over from one net to another: tokens by the names of places, commands by their
    /// symbols. Places that are new begin as the new net says.
    ///
    /// # Errors
    /// When an action is running, or something would be lost: tokens of a place, or a command on the
    /// tape, that the new net does not have.
    pub fn carried(mut self, from: &Net, to: &Net) -> Result<Self, StateError> {
        let wrong = |what: String| StateError {
            net: to.name().to_owned(),
            what,
        };
        if let Some((_, id, _)) = self.running.first() {
            let name = from.transitions().get(id.index());
            let name = name.map_or("", |transition| transition.name.as_str());
            return Err(wrong(format!("transition `{name}` is in action")));
        }
        let mut marking: Vec<u32> = to.places().iter().map(|place| place.tokens).collect();
        for (place, tokens) in from.places().iter().zip(&self.marking) {
            let there = to.place(&place.name);
            match there.and_then(|id| marking.get_mut(id.index())) {
                Some(there) => *there = *tokens,
                None if *tokens == 0 => {}
                None => {
                    let name = &place.name;
                    return Err(wrong(format!(
                        "it has no place `{name}`, which holds {tokens}"
                    )));
                }
            }
        }
        self.marking = marking;
        let renumbered = |command: CommandId| {
            let symbol = &from[command].symbol;
            let lost = || {
                wrong(format!(
                    "it takes no command `{symbol}`, which is on the tape"
                ))
            };
            to.command(symbol).ok_or_else(lost)
        };
        self.tape.renumber(renumbered)?;
        Ok(self)
    }
}
