//! One net in motion: marking, input tape, two-phase firing (architecture report, section 6). A
//! transition takes its tokens when it starts and puts tokens when its action is complete or has
//! failed. The caller runs actions, calls enabling functions and carries tokens to other nets; this
//! module only says which. It knows no clock and no task.
//!
//! Only transitions around a changed place are looked at again, so a firing costs the same in a net
//! of ten transitions and in one of ten thousand.

mod enabling;
mod tape;
mod wiring;

#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, sync::Arc};

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::net::{Net, PlaceId, RemoteArc, TransitionId, When};
use enabling::Enabling;
pub use tape::{OnTape, Tape};
use wiring::Wiring;

/// Number of one firing of a transition, counted from the start of the execution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FiringId(u64);

impl FiringId {
    /// The number.
    #[must_use]
    pub fn number(self) -> u64 {
        self.0
    }
}

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
    enabling: Enabling,
    tape: Tape,
    running: BTreeMap<FiringId, Running>,
    firings: u64,
}

impl Execution {
    /// A net at its initial marking.
    #[must_use]
    pub fn new(net: Arc<Net>) -> Self {
        let wiring = Arc::new(Wiring::new(&net));
        Self {
            enabling: Enabling::new(&net, &wiring),
            tape: Tape::default(),
            running: BTreeMap::new(),
            firings: 0,
            wiring,
            net,
        }
    }

    /// The net.
    #[must_use]
    pub fn net(&self) -> &Arc<Net> {
        &self.net
    }

    /// Tokens of every place, in order of place number.
    #[must_use]
    pub fn marking(&self) -> &[u32] {
        &self.enabling.marking
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
            let rank = self.enabling.ready.next(from)?;
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
        if self.enabling.is_enabled(id) {
            return Ok(());
        }
        let name = self.net.transitions().get(id.index());
        let name = name.map_or_else(|| format!("number {}", id.index()), |t| t.name.clone());
        Err(FireError::NotEnabled(name))
    }

    /// Fires a transition that has no action, in one step.
    ///
    /// # Errors
    /// It is not enabled, has an action, or would overflow a place.
    pub fn fire(&mut self, id: TransitionId) -> Result<Effects<'_>, FireError> {
        self.require_enabled(id)?;
        let transition = &self.net[id];
        if transition.action.is_some() {
            return Err(FireError::HasAction(transition.name.clone()));
        }
        self.require_room(&transition.outputs.local)?;
        self.take(id);
        Ok(self.put(id))
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
        let running = Running {
            transition: id,
            command,
        };
        self.running.insert(firing, running);
        Ok(firing)
    }

    /// Puts the tokens of a firing whose action is complete.
    ///
    /// # Errors
    /// No such firing is going on, or a place would overflow; then the firing still goes on.
    pub fn complete(&mut self, firing: FiringId) -> Result<Effects<'_>, FireError> {
        let transition = self.running_transition(firing)?;
        self.require_room(&self.net[transition].outputs.local)?;
        self.running.remove(&firing);
        Ok(self.put(transition))
    }

    /// Ends a firing whose action has failed: its failure branch, or else everything goes back.
    ///
    /// # Errors
    /// No such firing is going on, or a place would overflow; then the firing still goes on.
    pub fn fail(&mut self, firing: FiringId) -> Result<Effects<'_>, FireError> {
        let id = self.running_transition(firing)?;
        let transition = &self.net[id];
        let back = match &transition.fail {
            Some(branch) => &branch.local,
            None => &transition.inputs,
        };
        self.require_room(back)?;
        self.enabling.put(&self.wiring, back);
        let command = self
            .running
            .remove(&firing)
            .and_then(|running| running.command);
        if let (None, Some(command)) = (&self.net[id].fail, command) {
            self.with_tape(|tape| tape.unread(command));
        }
        let branch = self.net[id].fail.as_ref();
        Ok(Effects {
            remote: branch.map_or(&[], |branch| &branch.remote),
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
        self.enabling.put(&self.wiring, &arcs);
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
        match self.enabling.without_room(arcs) {
            Some(place) => Err(FireError::TooManyTokens(self.net[place].name.clone())),
            None => Ok(()),
        }
    }

    /// Takes what an enabled transition takes; returns the number of the command that it read.
    fn take(&mut self, id: TransitionId) -> Option<u64> {
        let transition = &self.net[id];
        self.enabling.take(&self.wiring, &transition.inputs);
        transition.tape?;
        self.with_tape(Tape::read)
    }

    /// Puts what a completed transition puts, and says what it leaves to the caller.
    fn put(&mut self, id: TransitionId) -> Effects<'_> {
        self.enabling.put(&self.wiring, &self.net[id].outputs.local);
        let written = self.net[id].write.clone().map(|symbol| self.write(symbol));
        Effects {
            remote: &self.net[id].outputs.remote,
            written,
        }
    }

    fn write(&mut self, symbol: String) -> Written {
        let net = Arc::clone(&self.net);
        let answered =
            self.with_tape(|tape| tape.answer(|command| net[command].answers.contains(&symbol)));
        match answered {
            Some(command) => Written::Answer { command, symbol },
            None => Written::Unasked { symbol },
        }
    }

    /// Changes the tape and what the transitions that read it lack.
    fn with_tape<T>(&mut self, change: impl FnOnce(&mut Tape) -> T) -> T {
        let before = self.tape.head();
        let result = change(&mut self.tape);
        let after = self.tape.head();
        if before != after {
            for (head, met) in [(before, false), (after, true)] {
                let readers = head.and_then(|command| self.wiring.readers.get(command.index()));
                for transition in readers.into_iter().flatten() {
                    self.enabling.condition(&self.wiring, *transition, met);
                }
            }
        }
        result
    }
}
