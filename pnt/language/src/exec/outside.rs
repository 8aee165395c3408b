//! What comes into a net from outside: tokens and commands.

use super::{
    error::{self, FireError},
    events::{Entry, Kind},
    execution::Execution,
};
use smallvec::{SmallVec, smallvec};

use crate::net::PlaceId;

/// Places, with so many tokens each. Mostly one: then it needs no memory besides.
pub type Tokens = SmallVec<[(PlaceId, u32); 1]>;

impl Execution {
    /// Takes commands that have not been read off the tape, but for those whose numbers `keeps` says.
    pub fn retain_waiting(&mut self, keeps: impl FnMut(u64) -> bool) {
        self.with_tape(|tape| tape.retain_waiting(keeps));
    }

    /// Puts tokens that came from another net, all or none. Returns what each place got.
    ///
    /// # Errors
    /// The net has no such place, or it would overflow.
    pub fn put_all(&mut self, tokens: &[(String, u32)]) -> Result<Vec<(PlaceId, u32)>, FireError> {
        self.put_each(tokens).map(SmallVec::into_vec)
    }

    /// [`Self::put_all`], without memory for one place.
    ///
    /// # Errors
    /// As there.
    #[inline]
    pub fn put_each(&mut self, tokens: &[(String, u32)]) -> Result<Tokens, FireError> {
        let added = self.added(tokens)?;
        for (place, count) in &added {
            self.require_room_for(*place, *count)?;
        }
        for (place, count) in &added {
            self.change(*place, *count);
            self.log(|| Entry::new(Kind::Put, place.0, u64::from(*count)));
        }
        Ok(added)
    }

    /// What each place gets, once each.
    #[inline]
    fn added(&self, tokens: &[(String, u32)]) -> Result<Tokens, FireError> {
        if let [(place, count)] = tokens {
            return Ok(smallvec![(self.place(place)?, *count)]);
        }
        let known = tokens
            .iter()
            .map(|(place, count)| Ok((self.place(place)?, *count)));
        let mut known: Vec<(PlaceId, u32)> = known.collect::<Result<_, FireError>>()?;
        known.sort_unstable_by_key(|(place, _)| *place);
        let mut added = Tokens::with_capacity(known.len());
        for (place, count) in known {
            match added.last_mut() {
                Some((last, sum)) if *last == place => {
                    let name = || FireError::TooManyTokens(self.net[place].name.clone());
                    *sum = sum.checked_add(count).ok_or_else(name)?;
                }
                _ => added.push((place, count)),
            }
        }
        Ok(added)
    }

    /// Puts tokens into one place, as [`Self::put_all`].
    ///
    /// # Errors
    /// The net has no such place, or it would overflow.
    pub fn put_tokens(&mut self, place: &str, count: u32) -> Result<(), FireError> {
        self.put_all(&[(place.to_owned(), count)]).map(|_| ())
    }

    /// Takes tokens out of a place by hand.
    ///
    /// # Errors
    /// The net has no such place, or it holds fewer.
    pub fn take_tokens(&mut self, place: &str, count: u32) -> Result<(), FireError> {
        let id = self.place(place)?;
        let tokens = self.enabling.counter(id.0);
        if tokens < count {
            return Err(FireError::TooFewTokens {
                place: place.to_owned(),
                tokens,
                wanted: count,
            });
        }
        self.change(id, count.wrapping_neg());
        self.log(|| Entry::new(Kind::Taken, id.0, u64::from(count)));
        Ok(())
    }

    /// Puts a symbol at the end of the input tape and returns its number. A symbol becomes readable
    /// when all before it are read and answered.
    ///
    /// # Errors
    /// The symbol is not one of the net's commands, or the tape is full.
    pub fn put_symbol(&mut self, symbol: &str, arguments: Vec<String>) -> Result<u64, FireError> {
        let command = self
            .net
            .command(symbol)
            .ok_or_else(|| error::unknown_symbol(&self.net, symbol))?;
        error::fitting(&self.net, &self.net[command], &arguments)?;
        if self.tape.len() >= self.tape_room {
            return Err(FireError::TapeFull {
                net: self.net.name().to_owned(),
                room: self.tape_room,
            });
        }
        let number = self.with_tape(|tape| tape.put(command, arguments));
        self.log(|| Entry::new(Kind::Symbol, command.0, number));
        Ok(number)
    }

    #[inline]
    fn place(&self, name: &str) -> Result<PlaceId, FireError> {
        let id = self.wiring.place_names.get(name).copied();
        id.ok_or_else(|| FireError::UnknownPlace {
            net: self.net.name().to_owned(),
            place: name.to_owned(),
        })
    }

    #[inline]
    fn require_room_for(&self, place: PlaceId, more: u32) -> Result<(), FireError> {
        let name = || self.net[place].name.clone();
        let Some(Some(capped)) = self.wiring.capped.get(place.index()) else {
            let sum = self.enabling.counter(place.0).checked_add(more);
            return sum
                .map(|_| ())
                .ok_or_else(|| FireError::TooManyTokens(name()));
        };
        let tokens = self.enabling.counter(capped.filled);
        if capped.capacity.saturating_sub(tokens) >= more {
            return Ok(());
        }
        Err(FireError::Full {
            place: name(),
            tokens,
            capacity: capped.capacity,
            more,
        })
    }

    /// Adds tokens to a place, modulo 2^32.
    #[inline]
    fn change(&mut self, place: PlaceId, by: u32) {
        self.enabling.add(&self.wiring, place.0, by);
        if let Some(Some(capped)) = self.wiring.capped.get(place.index()) {
            self.enabling.add(&self.wiring, capped.filled, by);
        }
    }
}
