//! The other end of the stream: the net as it is after each event, for followers.

use std::collections::BTreeMap;

use thiserror::Error;

use super::{Event, EventPhase, NetView, Running, State};

/// An event that does not fit what came before. The replica is as it was; ask for a new state.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ReplicaError {
    /// Events are missing, or come again.
    #[error("net `{net}`: event {found} came where {expected} was expected")]
    Gap {
        /// The net.
        net: String,
        /// The number of the next event.
        expected: u64,
        /// What came.
        found: u64,
    },
    /// The event names what the net does not have: it is another net's, or of another version.
    #[error("net `{net}` has no {what} `{name}`, which event {seq} names")]
    Unknown {
        /// The net.
        net: String,
        /// Place or transition.
        what: &'static str,
        /// Its name.
        name: String,
        /// The event.
        seq: u64,
    },
    /// More tokens were taken than there were.
    #[error("net `{net}`: event {seq} takes {tokens} tokens from `{place}`, which has {found}")]
    TooFew {
        /// The net.
        net: String,
        /// The place.
        place: String,
        /// How many were taken.
        tokens: u32,
        /// How many there were.
        found: u32,
        /// The event.
        seq: u64,
    },
    /// The state is of a net with other places or transitions.
    #[error("a state of net `{found}` does not fit net `{net}`")]
    Other {
        /// The net.
        net: String,
        /// Whose state it is.
        found: String,
    },
}

/// A net that follows another one's stream.
#[derive(Debug, Clone)]
pub struct Replica {
    net: String,
    places: BTreeMap<String, usize>,
    data: BTreeMap<String, usize>,
    transitions: BTreeMap<String, usize>,
    state: State,
}

impl Replica {
    /// The net of `view` in `state`.
    ///
    /// # Errors
    /// [`ReplicaError::Other`].
    pub fn new(view: &NetView, state: State) -> Result<Self, ReplicaError> {
        let places = view.places.iter().enumerate();
        let transitions = view.transitions.iter().enumerate();
        let mut replica = Self {
            net: view.name.clone(),
            places: places
                .map(|(index, one)| (one.name.clone(), index))
                .collect(),
            data: (view.data.iter().enumerate())
                .map(|(index, one)| (one.name.clone(), index))
                .collect(),
            transitions: transitions
                .map(|(index, one)| (one.name.clone(), index))
                .collect(),
            state: State::initial(view),
        };
        replica.set(state)?;
        Ok(replica)
    }

    /// The net now.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Goes to a state, wherever it was.
    ///
    /// # Errors
    /// [`ReplicaError::Other`].
    pub fn set(&mut self, state: State) -> Result<(), ReplicaError> {
        let counts = [state.ended.len(), state.failed.len(), state.busy_ns.len()];
        let fits = state.net == self.net
            && state.places.len() == self.places.len()
            && state.data.len() == self.data.len()
            && counts.iter().all(|count| *count == self.transitions.len());
        if !fits {
            return Err(ReplicaError::Other {
                net: self.net.clone(),
                found: state.net,
            });
        }
        self.state = state;
        Ok(())
    }

    /// Follows one event.
    ///
    /// # Errors
    /// It is not the next one, or does not fit the net.
    pub fn apply(&mut self, event: &Event) -> Result<(), ReplicaError> {
        let expected = self.state.seq + 1;
        if event.seq != expected {
            return Err(ReplicaError::Gap {
                net: self.net.clone(),
                expected,
                found: event.seq,
            });
        }
        let transition = match event.transition.as_str() {
            "" => None,
            name => Some(
                *self
                    .transitions
                    .get(name)
                    .ok_or_else(|| self.unknown("transition", name, event.seq))?,
            ),
        };
        let places = self.moved(event)?;
        for (name, value) in &event.data {
            let there = self.data.get(name);
            let there = there.and_then(|index| self.state.data.get_mut(*index));
            match there {
                Some(there) => there.clone_from(value),
                None => return Err(self.unknown("data", name, event.seq)),
            }
        }
        self.state.places = places;
        self.state.seq = event.seq;
        self.state.at_ns = event.at_ns;
        if let Some(index) = transition {
            self.fired(event, index);
        }
        match event.phase {
            EventPhase::Asked => self.state.tape.extend(event.read.clone()),
            EventPhase::Paused => self.state.paused = Some(event.text.clone()),
            EventPhase::Resumed => self.state.paused = None,
            EventPhase::Stopped => self.state.stopped = Some(event.text.clone()),
            _ => {}
        }
        Ok(())
    }

    fn unknown(&self, what: &'static str, name: &str, seq: u64) -> ReplicaError {
        ReplicaError::Unknown {
            net: self.net.clone(),
            what,
            name: name.to_owned(),
            seq,
        }
    }

    /// The tokens after an event.
    fn moved(&self, event: &Event) -> Result<Vec<u32>, ReplicaError> {
        let mut places = self.state.places.clone();
        let taken = event.consumed.iter().map(|tokens| (tokens, false));
        let put = event.produced.iter().map(|tokens| (tokens, true));
        for ((name, tokens), put) in taken.chain(put) {
            let index = self.places.get(name);
            let place = index.and_then(|index| places.get_mut(*index));
            let place = place.ok_or_else(|| self.unknown("place", name, event.seq))?;
            if put {
                *place = place.saturating_add(*tokens);
            } else {
                *place = place
                    .checked_sub(*tokens)
                    .ok_or_else(|| ReplicaError::TooFew {
                        net: self.net.clone(),
                        place: name.clone(),
                        tokens: *tokens,
                        found: *place,
                        seq: event.seq,
                    })?;
            }
        }
        Ok(places)
    }

    fn fired(&mut self, event: &Event, index: usize) {
        let state = &mut self.state;
        match (event.phase, event.firing) {
            (EventPhase::Started, Some(firing)) => state.running.push(Running {
                transition: event.transition.clone(),
                firing,
                since_ns: event.at_ns,
            }),
            (_, Some(firing)) => {
                let found = state.running.iter().position(|one| one.firing == firing);
                if let Some(found) = found {
                    let since = state.running.remove(found).since_ns;
                    if let Some(busy) = state.busy_ns.get_mut(index) {
                        *busy += event.at_ns.saturating_sub(since);
                    }
                }
            }
            _ => {}
        }
        let counted = match event.phase {
            EventPhase::Fired | EventPhase::Completed => state.ended.get_mut(index),
            EventPhase::Failed => state.failed.get_mut(index),
            _ => None,
        };
        if let Some(counted) = counted {
            *counted += 1;
        }
        let back = matches!(event.phase, EventPhase::Failed | EventPhase::Cancelled);
        match &event.read {
            Some(symbol) if back => {
                state.in_progress = None;
                state.tape.insert(0, symbol.clone());
            }
            Some(_) if !state.tape.is_empty() => {
                state.in_progress = Some(state.tape.remove(0));
            }
            _ => {}
        }
        if event.wrote.is_some() {
            state.in_progress = None;
        }
    }
}
