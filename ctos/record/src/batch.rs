//! What has been noted and not yet written: stretches of what happened to messages, and what was told
//! between them, in the order in which it came.

use super::{
    event::{Told, Traffic},
    traffic::Coder,
};
use ctos_message::append;

/// A stretch of events ends at this size, bytes: a file that breaks off lacks no more than is in one chunk.
const STRETCH: usize = 64 * 1024;
/// Space that is kept for the next time, bytes; what a burst took beyond it is given back.
const KEPT: usize = 1024 * 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Traffic,
    Told,
}

/// A piece of the bytes.
#[derive(Debug)]
struct Piece {
    kind: Kind,
    end: usize,
    events: u64,
    /// The moment of its first event.
    at: u64,
}

/// A piece as the writer gets it.
#[derive(Debug)]
pub(crate) enum Noted<'a> {
    /// So many events of messages, the first of them at `at`, as [`Events`](super::traffic::Events) reads
    /// them.
    Traffic {
        bytes: &'a [u8],
        events: u64,
        at: u64,
    },
    /// Something told, with its data.
    Told(Told, &'a [u8]),
}

/// Notes, in order.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    bytes: Vec<u8>,
    pieces: Vec<Piece>,
    coder: Coder,
}

impl Batch {
    /// Bytes in it.
    #[inline]
    pub(crate) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Adds what happened to a message; `data` writes what follows it.
    #[inline]
    pub(crate) fn traffic(&mut self, event: &Traffic, data: impl FnOnce(&mut Vec<u8>) -> bool) {
        if !self.goes_on() {
            self.coder = Coder::default();
            self.pieces.push(Piece {
                kind: Kind::Traffic,
                end: 0,
                events: 0,
                at: event.at,
            });
        }
        self.coder.put(&mut self.bytes, event, data);
        if let Some(piece) = self.pieces.last_mut() {
            piece.end = self.bytes.len();
            piece.events += 1;
        }
    }

    /// Whether the last piece takes one more event.
    #[inline]
    fn goes_on(&self) -> bool {
        let (start, kind) = match self.pieces.as_slice() {
            [.., before, last] => (before.end, last.kind),
            [last] => (0, last.kind),
            [] => return false,
        };
        kind == Kind::Traffic && self.bytes.len() - start < STRETCH
    }

    /// Adds what was told; `data` writes what follows it. When that fails, it is there without.
    ///
    /// # Errors
    /// When it cannot be encoded; nothing is added then.
    pub(crate) fn told(
        &mut self,
        told: &Told,
        data: impl FnOnce(&mut Vec<u8>) -> bool,
    ) -> Result<(), postcard::Error> {
        let start = self.bytes.len();
        if let Err(error) = append(told, &mut self.bytes) {
            self.bytes.truncate(start);
            return Err(error);
        }
        let end = self.bytes.len();
        if !data(&mut self.bytes) {
            self.bytes.truncate(end);
        }
        self.pieces.push(Piece {
            kind: Kind::Told,
            end: self.bytes.len(),
            events: 1,
            at: told.at,
        });
        Ok(())
    }

    /// What is in it.
    pub(crate) fn noted(&self) -> impl Iterator<Item = Noted<'_>> {
        let mut start = 0;
        self.pieces.iter().filter_map(move |piece| {
            let bytes = self.bytes.get(start..piece.end)?;
            start = piece.end;
            match piece.kind {
                Kind::Traffic => Some(Noted::Traffic {
                    bytes,
                    events: piece.events,
                    at: piece.at,
                }),
                Kind::Told => postcard::take_from_bytes(bytes)
                    .ok()
                    .map(|(told, data)| Noted::Told(told, data)),
            }
        })
    }

    /// Empties it, and keeps its space.
    pub(crate) fn clear(&mut self) {
        self.bytes.clear();
        self.bytes.shrink_to(KEPT);
        self.pieces.clear();
        self.pieces.shrink_to(KEPT / STRETCH);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        event::{Key, Side, Step, What},
        traffic::Events,
    };
    use ctos_message::Tid;

    fn sent(id: u64) -> Traffic {
        let task = Tid::from_bits(7);
        Traffic {
            at: id,
            chassis: 1,
            key: Key {
                id,
                task,
                peer: task,
                command: 1,
                trace: id,
            },
            step: Step::Sent {
                flags: 0,
                deadline: None,
                side: Side::Here,
            },
        }
    }

    fn told(at: u64) -> Told {
        let channel = "/x".to_owned();
        Told {
            at,
            what: What::Value { channel },
        }
    }

    #[test]
    fn what_is_noted_comes_out_in_its_order_in_stretches_that_stand_by_themselves() {
        let mut batch = Batch::default();
        for round in 0..2 {
            batch.clear();
            let mut expected = Vec::new();
            for id in 0..500_u64 {
                if id % 7 == 3 || id == round {
                    batch
                        .told(&told(id), |data| {
                            data.push(1);
                            true
                        })
                        .unwrap();
                } else {
                    let length = usize::try_from(id * 8).unwrap();
                    batch.traffic(&sent(id), |data| {
                        data.resize(data.len() + length, 5);
                        true
                    });
                }
                expected.push(id);
            }
            let mut got = Vec::new();
            for noted in batch.noted() {
                match noted {
                    Noted::Told(told, data) => {
                        assert_eq!(data, [1]);
                        got.push(told.at);
                    }
                    Noted::Traffic { bytes, events, at } => {
                        assert!(bytes.len() < STRETCH + 5000, "{}", bytes.len());
                        let mut read = Events::new(bytes);
                        let ids: Vec<u64> = read.by_ref().map(|(event, ..)| event.key.id).collect();
                        assert!(read.is_at_end());
                        assert_eq!(ids.len() as u64, events);
                        assert_eq!(ids.first(), Some(&at));
                        got.extend(ids);
                    }
                }
            }
            assert_eq!(got, expected);
        }
    }
}
