//! One net in motion: marking, input tape, two-phase firing (architecture report, section 6). A
//! transition takes its tokens when it starts and puts tokens when its action is complete or has
//! failed. The caller runs actions, calls enabling functions and carries tokens to other nets; this
//! module only says which. It knows no clock and no task.
//!
//! Only transitions around a changed place are looked at again, so a firing costs the same in a net
//! of ten transitions and in one of ten thousand.

mod tape;
mod wiring;

#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, sync::Arc};

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{
    net::{Net, Outputs, PlaceId, RemoteArc, TransitionId, When},
    ready::ReadySet,
};
pub use tape::{OnTape, Tape};
use wiring::Wiring;

/// Number of one firing of a transition, counted from the start of the execution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FiringId(u64);

/// Why nothing was fired or put. The execution is as it was before.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum FireError {
    /// The transition's inputs, inhibitors or tape do not allow it.
    #[error("transition `{0}` is not enabled")]
    NotEnabled(String),
    /// The transition has an action and cannot fire in one step.
    #[error("transition `{0}` has an action: start it and complete it")]
    HasAction(String),
    /// No such firing is going on.
    #[error("no firing {0} is going on")]
    NotRunning(u64),
    /// A place would hold more tokens than can be counted.
    #[error("place `{0}` would hold more than {max} tokens", max = u32::MAX)]
    TooManyTokens(String),
    /// The symbol is not in the net's input alphabet.
    #[error("net `{net}` takes no command `{symbol}`; it takes: {accepted}")]
    UnknownSymbol {
        /// The net.
        net: String,
        /// What was put.
        symbol: String,
        /// What could be put, with commas.
        accepted: String,
    },
    /// The place is not in the net.
    #[error("net `{net}` has no place `{place}`")]
    UnknownPlace {
        /// The net.
        net: String,
        /// What was asked for.
        place: String,
    },
}

/// What a transition wrote to the output tape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Written {
    /// The answer to the command in progress.
    Answer {
        /// Which command, as numbered by [`Execution::put_symbol`].
        command: u64,
        /// The output symbol.
        symbol: String,
    },
    /// A symbol that answers no command in progress; a checked net never does this.
    Unasked {
        /// The output symbol.
        symbol: String,
    },
}

/// What the caller must do after a firing.
#[derive(Debug, PartialEq)]
pub struct Effects<'a> {
    /// Tokens to carry to other nets.
    pub remote: &'a [RemoteArc],
    /// What was written to the output tape.
    pub written: Option<Written>,
}

impl PartialEq for RemoteArc {
    fn eq(&self, other: &Self) -> bool {
        (&self.net, &self.place, self.weight) == (&other.net, &other.place, other.weight)
    }
}

/// Who wins when several transitions of the same priority are enabled.
#[derive(Debug, Clone)]
pub enum Conflicts {
    /// The one declared first.
    Declared,
    /// Each with the same probability.
    Random(Box<ChaCha8Rng>),
}

/// A firing between start and end.
#[derive(Debug, Clone)]
struct Running {
    transition: TransitionId,
    /// The command that it read from the tape.
    command: Option<u64>,
}

/// A net, its marking and its tape.
#[derive(Debug, Clone)]
pub struct Execution {
    net: Arc<Net>,
    wiring: Arc<Wiring>,
    marking: Vec<u32>,
    /// Conditions that each transition still lacks.
    lacking: Vec<u32>,
    /// Ranks of the transitions that lack nothing.
    ready: ReadySet,
    tape: Tape,
    running: BTreeMap<FiringId, Running>,
    firings: u64,
}

impl Execution {
    /// A net at its initial marking.
    #[must_use]
    pub fn new(net: Arc<Net>) -> Self {
        let wiring = Arc::new(Wiring::new(&net));
        let mut execution = Self {
            marking: net.places().iter().map(|place| place.tokens).collect(),
            lacking: vec![0; net.transitions().len()],
            ready: ReadySet::new(net.transitions().len()),
            tape: Tape::default(),
            running: BTreeMap::new(),
            firings: 0,
            wiring,
            net,
        };
        for (index, transition) in execution.net.transitions().iter().enumerate() {
            let holds = |arc: &crate::net::Arc| execution.marking[arc.place.index()] >= arc.weight;
            let needed = transition.inputs.iter().chain(&transition.reads);
            let lacking = needed.filter(|arc| !holds(arc)).count()
                + transition
                    .inhibitors
                    .iter()
                    .filter(|arc| holds(arc))
                    .count()
                + usize::from(transition.tape.is_some());
            execution.lacking[index] = u32::try_from(lacking).unwrap_or(u32::MAX);
            if lacking == 0 {
                execution.ready.insert(execution.wiring.ranks[index]);
            }
        }
        execution
    }

    /// The net.
    #[must_use]
    pub fn net(&self) -> &Arc<Net> {
        &self.net
    }

    /// Tokens of every place, in order of place number.
    #[must_use]
    pub fn marking(&self) -> &[u32] {
        &self.marking
    }

    /// The input tape.
    #[must_use]
    pub fn tape(&self) -> &Tape {
        &self.tape
    }

    /// Firings between start and end, oldest first.
    pub fn running(&self) -> impl Iterator<Item = (FiringId, TransitionId)> {
        self.running
            .iter()
            .map(|(id, running)| (*id, running.transition))
    }

    /// Transitions whose tokens and tape symbol are there, in the order in which they would be
    /// chosen; their enabling functions are not asked.
    pub fn enabled(&self) -> impl Iterator<Item = TransitionId> {
        let mut from = 0;
        std::iter::from_fn(move || {
            let rank = self.ready.next(from)?;
            from = rank + 1;
            self.wiring.at_rank.get(rank).copied()
        })
    }

    /// The transition to fire next: of the highest priority among the enabled ones, by declared
    /// order or at random. `asks` evaluates an enabling function (not its negation).
    pub fn choose(
        &self,
        conflicts: &mut Conflicts,
        mut asks: impl FnMut(&When) -> bool,
    ) -> Option<TransitionId> {
        let mut allowed = self.enabled().filter(|id| {
            let when = self.net[*id].when.as_ref();
            when.is_none_or(|when| asks(when) != when.negated)
        });
        let first = allowed.next()?;
        let Conflicts::Random(rng) = conflicts else {
            return Some(first);
        };
        let priority = self.net[first].priority;
        let mut equals = vec![first];
        equals.extend(allowed.take_while(|id| self.net[*id].priority == priority));
        let index = rng.random_range(0..equals.len());
        equals.get(index).copied()
    }

    fn require_enabled(&self, id: TransitionId) -> Result<(), FireError> {
        if self.lacking.get(id.index()) == Some(&0) {
            return Ok(());
        }
        let name = self
            .net
            .transitions()
            .get(id.index())
            .map(|t| t.name.clone());
        Err(FireError::NotEnabled(
            name.unwrap_or_else(|| format!("number {}", id.index())),
        ))
    }

    /// Fires a transition that has no action, in one step.
    ///
    /// # Errors
    /// It is not enabled, has an action, or would overflow a place.
    pub fn fire(&mut self, id: TransitionId) -> Result<Effects<'_>, FireError> {
        self.require_enabled(id)?;
        let net = Arc::clone(&self.net);
        let transition = &net[id];
        if transition.action.is_some() {
            return Err(FireError::HasAction(transition.name.clone()));
        }
        self.require_room(&transition.outputs.local)?;
        self.take(id);
        self.put(&transition.outputs);
        Ok(self.effects(id))
    }

    /// Takes the tokens and the tape symbol of a transition; its action may begin.
    ///
    /// # Errors
    /// It is not enabled.
    pub fn start(&mut self, id: TransitionId) -> Result<FiringId, FireError> {
        self.require_enabled(id)?;
        let command = self.take(id);
        let firing = FiringId(self.firings);
        self.firings += 1;
        self.running.insert(
            firing,
            Running {
                transition: id,
                command,
            },
        );
        Ok(firing)
    }

    /// Puts the tokens of a firing whose action is complete.
    ///
    /// # Errors
    /// No such firing is going on, or a place would overflow; then the firing still goes on.
    pub fn complete(&mut self, firing: FiringId) -> Result<Effects<'_>, FireError> {
        let transition = self.running_transition(firing)?;
        let net = Arc::clone(&self.net);
        let outputs = &net[transition].outputs;
        self.require_room(&outputs.local)?;
        self.running.remove(&firing);
        self.put(outputs);
        Ok(self.effects(transition))
    }

    /// Ends a firing whose action has failed: its failure branch, or else everything goes back.
    ///
    /// # Errors
    /// No such firing is going on, or a place would overflow; then the firing still goes on.
    pub fn fail(&mut self, firing: FiringId) -> Result<Effects<'_>, FireError> {
        let transition = self.running_transition(firing)?;
        let net = Arc::clone(&self.net);
        let Some(branch) = &net[transition].fail else {
            self.require_room(&net[transition].inputs)?;
            let running = self.running.remove(&firing);
            for arc in &net[transition].inputs {
                self.change(arc.place, |tokens| tokens.saturating_add(arc.weight));
            }
            if let Some(command) = running.and_then(|running| running.command) {
                self.with_tape(|tape| tape.unread(command));
            }
            return Ok(Effects {
                remote: &[],
                written: None,
            });
        };
        self.require_room(&branch.local)?;
        self.running.remove(&firing);
        self.put(branch);
        Ok(Effects {
            remote: self.net[transition]
                .fail
                .as_ref()
                .map_or(&[], |outputs| &outputs.remote),
            written: None,
        })
    }

    /// Puts tokens that came from another net, all or none.
    ///
    /// # Errors
    /// The net has no such place, or it would overflow.
    pub fn put_all(&mut self, tokens: &[(String, u32)]) -> Result<(), FireError> {
        let mut added: BTreeMap<PlaceId, u32> = BTreeMap::new();
        for (place, count) in tokens {
            let Some(id) = self.wiring.place_names.get(place).copied() else {
                return Err(FireError::UnknownPlace {
                    net: self.net.name().to_owned(),
                    place: place.clone(),
                });
            };
            let sum = added.entry(id).or_default();
            *sum = sum
                .checked_add(*count)
                .ok_or_else(|| FireError::TooManyTokens(place.clone()))?;
        }
        let arcs: Vec<crate::net::Arc> = added
            .into_iter()
            .map(|(place, weight)| crate::net::Arc { place, weight })
            .collect();
        self.require_room(&arcs)?;
        for arc in arcs {
            self.change(arc.place, |tokens| tokens.saturating_add(arc.weight));
        }
        Ok(())
    }

    /// Puts tokens into one place, as [`Self::put_all`].
    ///
    /// # Errors
    /// The net has no such place, or it would overflow.
    pub fn put_tokens(&mut self, place: &str, count: u32) -> Result<(), FireError> {
        self.put_all(&[(place.to_owned(), count)])
    }

    /// Puts a symbol at the end of the input tape and returns its number. A symbol becomes readable
    /// when all before it are read and answered.
    ///
    /// # Errors
    /// The symbol is not one of the net's commands.
    pub fn put_symbol(&mut self, symbol: &str, arguments: Vec<String>) -> Result<u64, FireError> {
        let Some(command) = self.net.command(symbol) else {
            let accepted: Vec<&str> = self
                .net
                .commands()
                .iter()
                .map(|c| c.symbol.as_str())
                .collect();
            return Err(FireError::UnknownSymbol {
                net: self.net.name().to_owned(),
                symbol: symbol.to_owned(),
                accepted: if accepted.is_empty() {
                    "none".to_owned()
                } else {
                    accepted.join(", ")
                },
            });
        };
        Ok(self.with_tape(|tape| tape.put(command, arguments)))
    }

    fn running_transition(&self, firing: FiringId) -> Result<TransitionId, FireError> {
        self.running
            .get(&firing)
            .map(|running| running.transition)
            .ok_or(FireError::NotRunning(firing.0))
    }

    fn require_room(&self, arcs: &[crate::net::Arc]) -> Result<(), FireError> {
        for arc in arcs {
            if self.marking[arc.place.index()]
                .checked_add(arc.weight)
                .is_none()
            {
                return Err(FireError::TooManyTokens(self.net[arc.place].name.clone()));
            }
        }
        Ok(())
    }

    /// Takes what an enabled transition takes; returns the number of the command that it read.
    fn take(&mut self, id: TransitionId) -> Option<u64> {
        let net = Arc::clone(&self.net);
        for arc in &net[id].inputs {
            self.change(arc.place, |tokens| tokens.saturating_sub(arc.weight));
        }
        net[id].tape?;
        self.with_tape(Tape::read)
    }

    fn put(&mut self, outputs: &Outputs) {
        for arc in &outputs.local {
            self.change(arc.place, |tokens| tokens.saturating_add(arc.weight));
        }
    }

    /// What a completed transition leaves to the caller.
    fn effects(&mut self, id: TransitionId) -> Effects<'_> {
        let mut written = None;
        if let Some(symbol) = self.net[id].write.clone() {
            let net = Arc::clone(&self.net);
            let answered = self
                .with_tape(|tape| tape.answer(|command| net[command].answers.contains(&symbol)));
            written = Some(match answered {
                Some(command) => Written::Answer { command, symbol },
                None => Written::Unasked { symbol },
            });
        }
        Effects {
            remote: &self.net[id].outputs.remote,
            written,
        }
    }

    /// Changes the tokens of a place and what the transitions around it lack.
    fn change(&mut self, place: PlaceId, to: impl FnOnce(u32) -> u32) {
        let before = self.marking[place.index()];
        let after = to(before);
        self.marking[place.index()] = after;
        let wiring = Arc::clone(&self.wiring);
        for watch in &wiring.around[place.index()] {
            let held = before >= watch.weight;
            let holds = after >= watch.weight;
            if held != holds {
                self.condition(watch.transition, holds == watch.wanted);
            }
        }
    }

    /// Changes the tape and what the transitions that read it lack.
    fn with_tape<T>(&mut self, change: impl FnOnce(&mut Tape) -> T) -> T {
        let before = self.tape.head();
        let result = change(&mut self.tape);
        let after = self.tape.head();
        if before != after {
            let wiring = Arc::clone(&self.wiring);
            for (head, met) in [(before, false), (after, true)] {
                let readers = head.and_then(|command| wiring.readers.get(command.index()));
                for transition in readers.into_iter().flatten() {
                    self.condition(*transition, met);
                }
            }
        }
        result
    }

    /// One condition of a transition has changed.
    fn condition(&mut self, id: TransitionId, met: bool) {
        let rank = self.wiring.ranks[id.index()];
        let lacking = &mut self.lacking[id.index()];
        if met {
            *lacking = lacking.saturating_sub(1);
            if *lacking == 0 {
                self.ready.insert(rank);
            }
        } else {
            if *lacking == 0 {
                self.ready.remove(rank);
            }
            *lacking += 1;
        }
    }
}
