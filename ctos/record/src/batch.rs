//! What has been noted and not yet written: stretches of what happened to messages, and lines between
//! them, in the order in which it came.

use std::borrow::Cow;

use super::{event::Traffic, lines::Schema, parts::Line, traffic::Coder};

/// A stretch of events ends at this size, bytes: a file that breaks off lacks no more than is in one chunk.
const STRETCH: usize = 64 * 1024;
/// And so long after its first event, ns: who looks for a moment finds the stretches around it.
const STRETCH_NS: u64 = 1_000_000_000;
/// Space that is kept for the next time, bytes; what a burst took beyond it is given back.
const KEPT: usize = 1024 * 1024;

/// A line, or a stretch of events, as it stands in the bytes.
struct Piece {
    topic: Cow<'static, str>,
    schema: Schema,
    start: usize,
    events: u64,
    /// The moment of its first event.
    at: u64,
}

/// Notes, in order.
#[derive(Default)]
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

    /// Adds what happened to a message; `data` writes what follows it. False when it cannot be encoded;
    /// nothing is added then.
    pub(crate) fn traffic(
        &mut self,
        event: Traffic,
        data: impl FnOnce(&mut Vec<u8>) -> bool,
    ) -> bool {
        let (start, at) = (self.bytes.len(), event.at);
        let goes_on = |last: &Piece| {
            let is_short = start - last.start < STRETCH && at.saturating_sub(last.at) < STRETCH_NS;
            last.schema == Schema::Events && is_short
        };
        if !self.pieces.last().is_some_and(goes_on) {
            self.coder.restart();
            self.pieces.push(Piece {
                topic: Cow::Borrowed("/events"),
                schema: Schema::Events,
                start,
                events: 0,
                at,
            });
        }
        let added = self.coder.put(&mut self.bytes, event, data).is_ok();
        match self.pieces.last_mut() {
            Some(piece) if added => piece.events += 1,
            _ => self.bytes.truncate(start),
        }
        added
    }

    /// Adds a line of a channel; `json` writes it. False when it cannot; nothing is added then.
    pub(crate) fn line(
        &mut self,
        at: u64,
        topic: String,
        schema: Schema,
        json: impl FnOnce(&mut Vec<u8>) -> bool,
    ) -> bool {
        let start = self.bytes.len();
        let added = json(&mut self.bytes);
        if added {
            self.pieces.push(Piece {
                topic: topic.into(),
                schema,
                start,
                events: 1,
                at,
            });
        } else {
            self.bytes.truncate(start);
        }
        added
    }

    /// [`Self::line`] of a value.
    pub(crate) fn json(
        &mut self,
        at: u64,
        topic: String,
        schema: Schema,
        value: &serde_json::Value,
    ) -> bool {
        self.line(at, topic, schema, |buffer| {
            serde_json::to_writer(buffer, value).is_ok()
        })
    }

    /// What is in it.
    pub(crate) fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        let ends = self.pieces.iter().skip(1).map(|next| next.start);
        let ends = ends.chain([self.bytes.len()]);
        self.pieces.iter().zip(ends).filter_map(|(piece, end)| {
            Some(Line {
                topic: &piece.topic,
                schema: &piece.schema,
                at: piece.at,
                bytes: self.bytes.get(piece.start..end)?,
                lines: piece.events,
            })
        })
    }

    /// Empties it, and keeps its space.
    pub(crate) fn clear(&mut self) {
        self.bytes.clear();
        self.bytes.shrink_to(KEPT);
        self.pieces.clear();
        self.pieces.shrink_to(KEPT / STRETCH);
        self.coder = Coder::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        event::{Key, Side, Step},
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

    #[test]
    fn what_is_noted_comes_out_in_its_order_in_stretches_that_stand_by_themselves() {
        let mut batch = Batch::default();
        for round in 0..2 {
            batch.clear();
            let mut expected = Vec::new();
            for id in 0..500_u64 {
                if id % 7 == 3 || id == round {
                    batch.line(id, "/x".to_owned(), Schema::Value, |json| {
                        json.push(1);
                        true
                    });
                } else {
                    let length = usize::try_from(id * 8).unwrap();
                    batch.traffic(sent(id), |data| {
                        data.resize(data.len() + length, 5);
                        true
                    });
                }
                expected.push(id);
            }
            let mut got = Vec::new();
            for Line {
                schema,
                at,
                bytes,
                lines: events,
                ..
            } in batch.lines()
            {
                match schema {
                    Schema::Value => {
                        assert_eq!(bytes, [1]);
                        got.push(at);
                    }
                    _ => {
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
