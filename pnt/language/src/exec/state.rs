//! The state of an execution as one value that can be stored and taken up again. Taking it up checks
//! it against the net, since it may come from a file.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{execution::Execution, running::FiringId, tape::Tape};
use crate::net::{Net, TransitionId};

/// A firing that was going on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunningFiring {
    /// Its number.
    pub firing: FiringId,
    /// Of which transition.
    pub transition: TransitionId,
    /// The command that it read from the tape.
    pub command: Option<u64>,
    /// When its action's time is over, in ns of the execution's time.
    pub deadline_ns: Option<u64>,
}

/// All that an execution is beside its net. Numbers of places, transitions and commands are those of
/// the net, so it belongs to that net only.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// The net's name.
    pub net: String,
    /// Tokens per place.
    pub marking: Vec<u32>,
    /// The input tape.
    pub tape: Tape,
    /// Firings between start and end, oldest first.
    pub running: Vec<RunningFiring>,
    /// Number of the next firing.
    pub firings: u64,
    /// Number of the next event.
    pub events: u64,
    /// The time that the execution was last told.
    pub now_ns: u64,
}

/// Why a state cannot be taken up.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum RestoreError {
    /// It belongs to another net.
    #[error("the state is one of net `{state}`, not of `{net}`")]
    OtherNet {
        /// The net that was given.
        net: String,
        /// The net that the state names.
        state: String,
    },
    /// The net has changed since.
    #[error("the state has {state} places and net `{net}` has {places}: the net has changed since")]
    Places {
        /// The net.
        net: String,
        /// Its places.
        places: usize,
        /// The state's.
        state: usize,
    },
    /// A place holds more than it can.
    #[error("the state has {tokens} tokens in place `{place}`, which holds {capacity}")]
    OverCapacity {
        /// The place.
        place: String,
        /// Tokens and what running firings may put there.
        tokens: u64,
        /// Its capacity.
        capacity: u32,
    },
    /// It names what the net does not have, or numbers out of order.
    #[error("the state of net `{net}` is broken: {what}")]
    Broken {
        /// The net.
        net: String,
        /// What is wrong.
        what: &'static str,
    },
}

impl Execution {
    /// The state as it is now.
    #[must_use]
    pub fn state(&self) -> State {
        State {
            net: self.net.name().to_owned(),
            marking: self.marking().to_vec(),
            tape: self.tape.clone(),
            running: self
                .running
                .iter()
                .map(|running| RunningFiring {
                    firing: running.firing,
                    transition: running.transition,
                    command: running.command,
                    deadline_ns: running.deadline_ns,
                })
                .collect(),
            firings: self.firings,
            events: self.log.as_ref().map_or(self.events, |log| log.next),
            now_ns: self.now_ns,
        }
    }

    /// An execution that goes on from a state. It records no events until told to.
    ///
    /// # Errors
    /// The state is not one of this net, or is broken.
    pub fn restore(net: Arc<Net>, state: State) -> Result<Self, RestoreError> {
        check(&net, &state)?;
        let mut execution = Self::new(net);
        let wiring = Arc::clone(&execution.wiring);
        for (place, tokens) in (0..).zip(&state.marking) {
            execution.enabling.set(&wiring, place, *tokens);
        }
        for (capped, tokens) in wiring.capped.iter().zip(&state.marking) {
            if let Some(capped) = capped {
                execution.enabling.set(&wiring, capped.filled, *tokens);
            }
        }
        for running in &state.running {
            // What a start does, but for the tokens, which are no longer there.
            execution.claim_again(running)?;
            execution.running.push(
                running.firing,
                running.transition,
                running.command,
                running.deadline_ns,
            );
        }
        execution.with_tape(|tape| *tape = state.tape);
        execution.firings = state.firings;
        execution.events = state.events;
        execution.now_ns = state.now_ns;
        Ok(execution)
    }

    /// Reserves the capacity for a firing that goes on, as its start did.
    fn claim_again(&mut self, running: &RunningFiring) -> Result<(), RestoreError> {
        let wiring = Arc::clone(&self.wiring);
        let Some(phases) = wiring.phases.get(running.transition.index()) else {
            return Ok(());
        };
        let capped = || wiring.capped.iter().zip(self.net.places());
        let before: Vec<u32> = capped()
            .filter_map(|(capped, _)| Some(self.enabling.counter(capped.as_ref()?.filled)))
            .collect();
        self.enabling.apply(&wiring, phases.claim);
        let places = capped().filter_map(|(capped, place)| Some((capped.as_ref()?, place)));
        for ((capped, place), before) in places.zip(before) {
            let after = self.enabling.counter(capped.filled);
            // A claim that counts round lands below where it began.
            if after < before || after > capped.capacity {
                return Err(RestoreError::OverCapacity {
                    place: place.name.clone(),
                    tokens: u64::from(before) + u64::from(after.wrapping_sub(before)),
                    capacity: capped.capacity,
                });
            }
        }
        Ok(())
    }
}

/// Numbers at which counting would come to its end: no execution gets there.
const MOST: u64 = u64::MAX / 2;

fn check(net: &Net, state: &State) -> Result<(), RestoreError> {
    let broken = |what| RestoreError::Broken {
        net: net.name().to_owned(),
        what,
    };
    if state.net != net.name() {
        return Err(RestoreError::OtherNet {
            net: net.name().to_owned(),
            state: state.net.clone(),
        });
    }
    if state.marking.len() != net.places().len() {
        return Err(RestoreError::Places {
            net: net.name().to_owned(),
            places: net.places().len(),
            state: state.marking.len(),
        });
    }
    for (place, tokens) in net.places().iter().zip(&state.marking) {
        if let Some(capacity) = place.capacity.filter(|capacity| tokens > capacity) {
            return Err(RestoreError::OverCapacity {
                place: place.name.clone(),
                tokens: u64::from(*tokens),
                capacity,
            });
        }
    }
    if state.firings > MOST || state.events > MOST {
        return Err(broken("it has counted further than anything can"));
    }
    let mut least = 0;
    for running in &state.running {
        if running.transition.index() >= net.transitions().len() {
            return Err(broken("a running firing is of no transition of the net"));
        }
        if running.firing.0 < least || running.firing.0 >= state.firings {
            return Err(broken(
                "its running firings are not numbered as they started",
            ));
        }
        least = running.firing.0 + 1;
    }
    if !state.tape.is_sound(net.commands().len(), MOST) {
        return Err(broken("its tape holds what no one can have put there"));
    }
    Ok(())
}
