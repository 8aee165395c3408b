//! The form in which events of messages are noted, buffered and stored in a file. It is a sequence of
//! events, each written as its difference from the one before.
//!
//! Messages mostly go to and fro between the same tasks, with numbers and moments that grow. So an event
//! takes ten bytes where nothing but these changes. `schemas/events.txt` describes the form for others who
//! want to read it.

use serde::{Deserialize, Serialize};

use ctos_message::{ChassisNumber, Tid, append};

use super::event::{Key, Step, Traffic};

/// An event as it stands in the form, before its data. Numbers are differences from the event before.
#[derive(Serialize, Deserialize)]
struct Packed {
    at: i64,
    id: i64,
    trace: i64,
    /// Who has to do with the message: chassis, task, peer and command. Unless all of it is as before.
    ends: Option<Ends>,
    step: Step,
    /// The length of the data that follows.
    length: usize,
}

type Ends = (ChassisNumber, Tid, Tid, u16);

/// What writer and reader of a sequence know of what came before.
#[derive(Clone, Default)]
struct Last {
    at: u64,
    id: u64,
    trace: u64,
    ends: Ends,
}

fn change(old: &mut u64, new: u64) -> i64 {
    new.wrapping_sub(std::mem::replace(old, new)) as i64
}

fn changed(old: &mut u64, change: i64) -> u64 {
    *old = old.wrapping_add_signed(change);
    *old
}

/// Writes a sequence.
#[derive(Default)]
pub(crate) struct Coder {
    last: Last,
    /// Kept for its space.
    data: Vec<u8>,
}

impl Coder {
    /// Begins another sequence.
    pub(crate) fn restart(&mut self) {
        self.last = Last::default();
    }

    /// Appends `event` to `buffer`; `data` writes what follows it. When that fails, the event is there
    /// without data.
    ///
    /// # Errors
    /// When it cannot be encoded.
    pub(crate) fn put(
        &mut self,
        buffer: &mut Vec<u8>,
        event: Traffic,
        data: impl FnOnce(&mut Vec<u8>) -> bool,
    ) -> Result<(), postcard::Error> {
        self.data.clear();
        if !data(&mut self.data) {
            self.data.clear();
        }
        let Traffic { key, step, .. } = event;
        let ends = (event.chassis, key.task, key.peer, key.command);
        let mut last = self.last.clone();
        // What happened within a task has no message.
        let (id, trace) = match step.is_within() {
            true => (last.id, last.trace),
            false => (key.id, key.trace),
        };
        let packed = Packed {
            at: change(&mut last.at, event.at),
            id: change(&mut last.id, id),
            trace: change(&mut last.trace, trace),
            ends: (ends != last.ends).then_some(ends),
            step,
            length: self.data.len(),
        };
        last.ends = ends;
        append(&packed, buffer)?;
        self.last = last;
        buffer.extend_from_slice(&self.data);
        Ok(())
    }
}

/// The events of a sequence, each with its data and its length there. Ends at anything that is none.
pub(crate) struct Events<'a> {
    bytes: &'a [u8],
    last: Last,
}

/// An event, its data, and how many bytes both take.
pub(crate) type Found<'a> = (Traffic, &'a [u8], usize);

impl<'a> Events<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let last = Last::default();
        Self { bytes, last }
    }

    /// Whether all has been read.
    pub(crate) fn is_at_end(&self) -> bool {
        self.bytes.is_empty()
    }
}

impl<'a> Iterator for Events<'a> {
    type Item = Found<'a>;

    fn next(&mut self) -> Option<Found<'a>> {
        let (packed, rest) = postcard::take_from_bytes::<Packed>(self.bytes).ok()?;
        let (data, rest) = rest.split_at_checked(packed.length)?;
        let last = &mut self.last;
        last.ends = packed.ends.unwrap_or(last.ends);
        let (chassis, task, peer, command) = last.ends;
        let mut key = Key {
            id: changed(&mut last.id, packed.id),
            task,
            peer,
            command,
            trace: changed(&mut last.trace, packed.trace),
        };
        if packed.step.is_within() {
            (key.id, key.trace) = (0, 0);
        }
        let event = Traffic {
            at: changed(&mut last.at, packed.at),
            chassis,
            key,
            step: packed.step,
        };
        let length = self.bytes.len() - rest.len();
        self.bytes = rest;
        Some((event, data, length))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::event::Side;
    use ctos_core::{report::Ending, tap::Came};
    use ctos_message::fault::Fault;

    fn side() -> impl Strategy<Value = Side> {
        prop_oneof![Just(Side::Here), Just(Side::Sender), Just(Side::Receiver)]
    }

    fn step() -> impl Strategy<Value = Step> {
        let ending = prop_oneof![
            Just(Ending::Done),
            Just(Ending::Stopped),
            ".{0,300}".prop_map(Ending::Refused),
            ".{0,9}".prop_map(Ending::Panicked),
        ];
        let came = prop_oneof![Just(Came::Later), Just(Came::AtOnce), Just(Came::First)];
        let fault = prop_oneof![
            Just(None),
            Just(Some(Fault::Stopping)),
            ".{0,9}".prop_map(|text| Some(Fault::Refused { text })),
        ];
        prop_oneof![
            (any::<u16>(), any::<Option<u64>>(), side()).prop_map(|(flags, deadline, side)| {
                Step::Sent {
                    flags,
                    deadline,
                    side,
                }
            }),
            Just(Step::Began),
            (any::<u64>(), ending).prop_map(|(took, ending)| Step::Ended { took, ending }),
            (side(), came, fault).prop_map(|(side, came, fault)| Step::Answered {
                side,
                came,
                fault
            }),
            any::<u64>().prop_map(|part| Step::Polled { part }),
            (".{0,9}", any::<bool>()).prop_map(|(what, lacking)| Step::Read { what, lacking }),
        ]
    }

    /// Numbers that are mostly near to one another, as those of an app, and now and then anything.
    fn number() -> impl Strategy<Value = u64> {
        prop_oneof![4 => 0..4_u64, 1 => any::<u64>()]
    }

    fn event() -> impl Strategy<Value = (Traffic, Vec<u8>)> {
        let key = (number(), number(), number(), 0..3_u16, number());
        let data = proptest::collection::vec(any::<u8>(), 0..600);
        (number(), 0..3_u16, key, step(), data).prop_map(|(at, chassis, key, step, mut data)| {
            let (id, task, peer, command, trace) = key;
            let carries = match &step {
                Step::Sent { .. } => true,
                Step::Answered { fault, .. } => fault.is_none(),
                Step::Read { lacking, .. } => !lacking,
                Step::Began | Step::Ended { .. } | Step::Polled { .. } => false,
            };
            let (id, trace) = if step.is_within() {
                (0, 0)
            } else {
                (id, trace)
            };
            if !carries {
                data.clear();
            }
            let key = Key {
                id,
                task: Tid::from_bits(task),
                peer: Tid::from_bits(peer),
                command,
                trace,
            };
            let event = Traffic {
                at,
                chassis,
                key,
                step,
            };
            (event, data)
        })
    }

    proptest! {
        #[test]
        fn events_come_out_as_they_were_put_in(
            events in proptest::collection::vec(event(), 0..20)
        ) {
            let (mut coder, mut buffer) = (Coder::default(), Vec::new());
            for (event, data) in &events {
                coder.put(&mut buffer, event.clone(), |buffer| { buffer.extend_from_slice(data); true }).unwrap();
            }
            let mut read = Events::new(&buffer);
            let mut length = 0;
            for (event, data) in &events {
                let (got, with, bytes) = read.next().unwrap();
                prop_assert_eq!((&got, with), (event, data.as_slice()));
                length += bytes;
            }
            prop_assert!(read.next().is_none() && read.is_at_end());
            prop_assert_eq!(length, buffer.len());
        }

        #[test]
        fn what_is_cut_or_damaged_is_never_a_panic_and_before_the_cut_all_is_read(
            events in proptest::collection::vec(event(), 1..20),
            cut: prop::sample::Index,
            place: prop::sample::Index,
            byte: u8,
        ) {
            let (mut coder, mut buffer) = (Coder::default(), Vec::new());
            let mut ends = Vec::new();
            for (event, data) in &events {
                coder.put(&mut buffer, event.clone(), |buffer| { buffer.extend_from_slice(data); true }).unwrap();
                ends.push(buffer.len());
            }
            let cut = cut.index(buffer.len());
            let whole = ends.iter().filter(|end| **end <= cut).count();
            let mut read = Events::new(&buffer[..cut]);
            prop_assert_eq!(read.by_ref().count(), whole);
            prop_assert_eq!(read.is_at_end(), cut == 0 || ends.contains(&cut));
            let place = place.index(buffer.len());
            buffer[place] = byte;
            let _ = Events::new(&buffer).count();
        }

        #[test]
        fn rubbish_ends_the_events_and_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = Events::new(&bytes).count();
        }
    }

    #[test]
    fn an_event_whose_data_cannot_be_written_is_there_without_it() {
        let (mut coder, mut buffer) = (Coder::default(), Vec::new());
        let key = Key {
            id: 1,
            task: Tid::from_bits(2),
            peer: Tid::from_bits(3),
            command: 4,
            trace: 5,
        };
        let event = Traffic {
            at: 7,
            chassis: 1,
            key,
            step: Step::Answered {
                side: Side::Here,
                came: Came::AtOnce,
                fault: None,
            },
        };
        let put = coder.put(&mut buffer, event.clone(), |buffer| {
            buffer.extend_from_slice(&[1; 300]);
            false
        });
        put.unwrap();
        let out: Vec<_> = Events::new(&buffer).collect();
        assert_eq!(out, [(event, &[][..], buffer.len())]);
    }
}
