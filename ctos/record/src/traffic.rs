//! The form in which what happens to messages is noted, waits and stands in a file: a sequence of events,
//! each told by what distinguishes it from the one of its kind before.
//!
//! Messages mostly go to and fro between the same tasks, with numbers and moments that grow, so that an event
//! takes five bytes where nothing but these changes. `schemas/events.txt` describes the form for others who
//! want to read it.

use ctos_message::{Tid, append, fault::Fault};

use super::event::{Key, Side, Step, Traffic};
use ctos_core::report::Ending;

/// The kinds of events, as they are numbered in the form.
const SENT: usize = 0;
const BEGAN: usize = 1;
const ENDED: usize = 2;
const ANSWERED: usize = 3;
const KINDS: usize = 4;

/// In the first byte above the kind and the side: a deadline follows.
const DEADLINE: u8 = 1 << 4;
/// In the first byte: not `Done`, or a fault; which one follows.
const SPECIAL: u8 = 1 << 5;
/// In the first byte: answered at once.
const AT_ONCE: u8 = 1 << 6;

/// In the second byte: what differs from the last event of the kind.
const ID: u8 = 1;
const TASK: u8 = 1 << 1;
const PEER: u8 = 1 << 2;
const COMMAND: u8 = 1 << 3;
const TRACE: u8 = 1 << 4;
/// The trace is the next one.
const NEXT_TRACE: u8 = 1 << 5;
const FLAGS: u8 = 1 << 6;
const CHASSIS: u8 = 1 << 7;

/// A length of this value is followed by the true one in four bytes.
const LONG: u8 = 0xff;
const LONG_BYTES: usize = 4;

/// The last event of a kind.
#[derive(Debug, Clone, Copy)]
struct Last {
    key: Key,
    flags: u16,
    /// From the moment to the deadline, ns.
    timeout: u64,
    /// Whether its data was long.
    long: bool,
}

/// What writer and reader of a sequence know of what came before.
#[derive(Debug, Clone)]
pub(crate) struct Coder {
    at: u64,
    chassis: u8,
    last: [Last; KINDS],
}

impl Default for Coder {
    fn default() -> Self {
        let nobody = Tid::from_bits(0);
        let last = Last {
            key: Key {
                id: 0,
                task: nobody,
                peer: nobody,
                command: 0,
                trace: 0,
            },
            flags: 0,
            timeout: 0,
            long: false,
        };
        Self {
            at: 0,
            chassis: 0,
            last: [last; KINDS],
        }
    }
}

/// Seven bits in each byte, the lowest first; the highest bit says that more follow.
#[inline]
fn put_number(buffer: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        buffer.push(number as u8 | 0x80);
        number >>= 7;
    }
    buffer.push(number as u8);
}

/// By how much `new` is more than `old`, or less.
#[inline]
fn put_change(buffer: &mut Vec<u8>, old: u64, new: u64) {
    let change = new.wrapping_sub(old) as i64;
    put_number(buffer, ((change << 1) ^ (change >> 63)) as u64);
}

impl Coder {
    /// Appends `event` to `buffer`; `data` writes what follows it. When that fails, the event is there
    /// without data.
    #[inline]
    pub(crate) fn put(
        &mut self,
        buffer: &mut Vec<u8>,
        event: &Traffic,
        data: impl FnOnce(&mut Vec<u8>) -> bool,
    ) {
        let (kind, bits) = first_byte(&event.step);
        let Some(last) = self.last.get_mut(kind) else {
            return;
        };
        let start = buffer.len();
        // The second byte is known when all else is.
        buffer.extend([bits, 0]);
        let mut changed = 0;
        if event.chassis != self.chassis {
            changed |= CHASSIS;
            buffer.push(event.chassis);
            self.chassis = event.chassis;
        }
        put_change(buffer, self.at, event.at);
        self.at = event.at;
        changed |= put_key(buffer, &last.key, &event.key);
        last.key = event.key;
        match &event.step {
            Step::Sent {
                flags, deadline, ..
            } => {
                if *flags != last.flags {
                    changed |= FLAGS;
                    buffer.extend(flags.to_le_bytes());
                    last.flags = *flags;
                }
                if let Some(deadline) = deadline {
                    let timeout = deadline.wrapping_sub(event.at);
                    put_change(buffer, last.timeout, timeout);
                    last.timeout = timeout;
                }
            }
            Step::Ended { began, .. } => put_change(buffer, *began, event.at),
            Step::Began | Step::Answered { .. } => {}
        }
        if let Some(second) = buffer.get_mut(start + 1) {
            *second = changed;
        }
        match &event.step {
            Step::Ended { ending, .. } if *ending != Ending::Done => {
                put_sized(buffer, false, |buffer| append(ending, buffer).is_ok());
            }
            Step::Answered {
                fault: Some(fault), ..
            } => {
                put_sized(buffer, false, |buffer| append(fault, buffer).is_ok());
            }
            Step::Sent { .. } | Step::Answered { .. } => {
                last.long = put_sized(buffer, last.long, data);
            }
            Step::Began | Step::Ended { .. } => {}
        }
    }
}

fn first_byte(step: &Step) -> (usize, u8) {
    let (kind, side, more) = match step {
        Step::Sent { deadline, side, .. } => (
            SENT,
            side_bits(*side),
            if deadline.is_some() { DEADLINE } else { 0 },
        ),
        Step::Began => (BEGAN, 0, 0),
        Step::Ended { ending, .. } => (ENDED, 0, if *ending == Ending::Done { 0 } else { SPECIAL }),
        Step::Answered {
            side,
            at_once,
            fault,
        } => (
            ANSWERED,
            side_bits(*side),
            if fault.is_some() { SPECIAL } else { 0 } | if *at_once { AT_ONCE } else { 0 },
        ),
    };
    (kind, kind as u8 | side << 2 | more)
}

const fn side_bits(side: Side) -> u8 {
    match side {
        Side::Here => 0,
        Side::Sender => 1,
        Side::Receiver => 2,
    }
}

#[inline]
fn put_key(buffer: &mut Vec<u8>, last: &Key, key: &Key) -> u8 {
    let mut changed = 0;
    if key.id != last.id.wrapping_add(1) {
        changed |= ID;
        put_change(buffer, last.id, key.id);
    }
    if key.task != last.task {
        changed |= TASK;
        buffer.extend(key.task.bits().to_le_bytes());
    }
    if key.peer != last.peer {
        changed |= PEER;
        buffer.extend(key.peer.bits().to_le_bytes());
    }
    if key.command != last.command {
        changed |= COMMAND;
        buffer.extend(key.command.to_le_bytes());
    }
    if key.trace == last.trace.wrapping_add(1) {
        changed |= NEXT_TRACE;
    } else if key.trace != last.trace {
        changed |= TRACE;
        put_change(buffer, last.trace, key.trace);
    }
    changed
}

/// Appends what `write` writes, behind its length: one byte, or five if `long` or need be. Nothing when
/// it fails. Whether the long form was needed.
#[inline]
fn put_sized(buffer: &mut Vec<u8>, long: bool, write: impl FnOnce(&mut Vec<u8>) -> bool) -> bool {
    let start = buffer.len();
    // Data of a kind is mostly of a size: what was long is expected to be long again, and not moved.
    let reserved = if long { 1 + LONG_BYTES } else { 1 };
    buffer.resize(start + reserved, 0);
    if !write(buffer) {
        buffer.truncate(start + reserved);
    }
    let length = buffer.len() - start - reserved;
    match u8::try_from(length) {
        Ok(short) if short != LONG && !long => {
            if let Some(place) = buffer.get_mut(start) {
                *place = short;
            }
            return false;
        }
        _ => {}
    }
    if !long {
        buffer.splice(start..=start, [0; 1 + LONG_BYTES]);
    }
    let four = u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes();
    if let Some([first, rest @ ..]) = buffer.get_mut(start..=start + LONG_BYTES) {
        *first = LONG;
        rest.copy_from_slice(&four);
    }
    length >= usize::from(LONG)
}

/// The events of a sequence, each with its data and its length there. Ends at anything that is none.
#[derive(Debug)]
pub(crate) struct Events<'a> {
    bytes: &'a [u8],
    coder: Coder,
}

/// An event, its data, and how many bytes both take.
pub(crate) type Found<'a> = (Traffic, &'a [u8], usize);

impl<'a> Events<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let coder = Coder::default();
        Self { bytes, coder }
    }

    /// Whether all has been read.
    pub(crate) fn is_at_end(&self) -> bool {
        self.bytes.is_empty()
    }

    fn read(&mut self) -> Option<Found<'a>> {
        let mut bytes = Bytes(self.bytes);
        let first = bytes.byte()?;
        let changed = bytes.byte()?;
        let kind = usize::from(first & 3);
        let last = self.coder.last.get_mut(kind)?;
        if changed & CHASSIS != 0 {
            self.coder.chassis = bytes.byte()?;
        }
        self.coder.at = bytes.changed(self.coder.at)?;
        let at = self.coder.at;
        last.key = read_key(&mut bytes, changed, &last.key)?;
        let side = match first >> 2 & 3 {
            0 => Side::Here,
            1 => Side::Sender,
            2 => Side::Receiver,
            _ => return None,
        };
        let mut data: &[u8] = &[];
        let step = match kind {
            SENT => {
                if changed & FLAGS != 0 {
                    last.flags = u16::from_le_bytes(bytes.some()?);
                }
                let mut deadline = None;
                if first & DEADLINE != 0 {
                    last.timeout = bytes.changed(last.timeout)?;
                    deadline = Some(at.wrapping_add(last.timeout));
                }
                data = bytes.sized()?;
                Step::Sent {
                    flags: last.flags,
                    deadline,
                    side,
                }
            }
            BEGAN => Step::Began,
            ENDED => {
                let took = bytes.changed(0)?;
                Step::Ended {
                    began: at.wrapping_sub(took),
                    ending: match first & SPECIAL {
                        0 => Ending::Done,
                        _ => postcard::from_bytes(bytes.sized()?).ok()?,
                    },
                }
            }
            _ => {
                let mut fault: Option<Fault> = None;
                if first & SPECIAL != 0 {
                    fault = Some(postcard::from_bytes(bytes.sized()?).ok()?);
                } else {
                    data = bytes.sized()?;
                }
                Step::Answered {
                    side,
                    at_once: first & AT_ONCE != 0,
                    fault,
                }
            }
        };
        let traffic = Traffic {
            at,
            chassis: self.coder.chassis,
            key: last.key,
            step,
        };
        let length = self.bytes.len() - bytes.0.len();
        self.bytes = bytes.0;
        Some((traffic, data, length))
    }
}

impl<'a> Iterator for Events<'a> {
    type Item = Found<'a>;

    fn next(&mut self) -> Option<Found<'a>> {
        self.read()
    }
}

fn read_key(bytes: &mut Bytes<'_>, changed: u8, last: &Key) -> Option<Key> {
    let mut key = *last;
    key.id = match changed & ID {
        0 => last.id.wrapping_add(1),
        _ => bytes.changed(last.id)?,
    };
    if changed & TASK != 0 {
        key.task = Tid::from_bits(u32::from_le_bytes(bytes.some()?));
    }
    if changed & PEER != 0 {
        key.peer = Tid::from_bits(u32::from_le_bytes(bytes.some()?));
    }
    if changed & COMMAND != 0 {
        key.command = u16::from_le_bytes(bytes.some()?);
    }
    if changed & NEXT_TRACE != 0 {
        key.trace = last.trace.wrapping_add(1);
    } else if changed & TRACE != 0 {
        key.trace = bytes.changed(last.trace)?;
    }
    Some(key)
}

/// Bytes that are read from their beginning.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn byte(&mut self) -> Option<u8> {
        self.some::<1>().map(|[byte]| byte)
    }

    fn some<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (some, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*some)
    }

    fn number(&mut self) -> Option<u64> {
        let mut number = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            number |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(number);
            }
        }
        None
    }

    fn changed(&mut self, old: u64) -> Option<u64> {
        let number = self.number()?;
        let change = (number >> 1) ^ (number & 1).wrapping_neg();
        Some(old.wrapping_add(change))
    }

    fn sized(&mut self) -> Option<&'a [u8]> {
        let length = match self.byte()? {
            LONG => usize::try_from(u32::from_le_bytes(self.some()?)).ok()?,
            short => usize::from(short),
        };
        let (sized, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(sized)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

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
            (any::<u64>(), ending).prop_map(|(began, ending)| Step::Ended { began, ending }),
            (side(), any::<bool>(), fault).prop_map(|(side, at_once, fault)| Step::Answered {
                side,
                at_once,
                fault
            }),
        ]
    }

    /// Numbers that are mostly near to one another, as those of an app, and now and then anything.
    fn number() -> impl Strategy<Value = u64> {
        prop_oneof![4 => 0..4_u64, 1 => any::<u64>()]
    }

    fn event() -> impl Strategy<Value = (Traffic, Vec<u8>)> {
        let key = (number(), number(), number(), 0..3_u16, number());
        let data = proptest::collection::vec(any::<u8>(), 0..600);
        (number(), 0..3_u8, key, step(), data).prop_map(|(at, chassis, key, step, mut data)| {
            let (id, task, peer, command, trace) = key;
            let carries = match &step {
                Step::Sent { .. } => true,
                Step::Answered { fault, .. } => fault.is_none(),
                Step::Began | Step::Ended { .. } => false,
            };
            if !carries {
                data.clear();
            }
            let key = Key {
                id,
                task: Tid::from_bits(task as u32),
                peer: Tid::from_bits(peer as u32),
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
                coder.put(&mut buffer, event, |buffer| { buffer.extend_from_slice(data); true });
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
                coder.put(&mut buffer, event, |buffer| { buffer.extend_from_slice(data); true });
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
                at_once: true,
                fault: None,
            },
        };
        coder.put(&mut buffer, &event, |buffer| {
            buffer.extend_from_slice(&[1; 300]);
            false
        });
        let out: Vec<_> = Events::new(&buffer).collect();
        assert_eq!(out, [(event, &[][..], buffer.len())]);
    }
}
