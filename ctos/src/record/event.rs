//! What is noted of an app while it runs, in the form in which it waits for the writer: a head and
//! data, as little work for the one who notes it as can be.
//!
//! Knows nothing of files and nothing of JSON.

use serde::{Deserialize, Serialize};

use crate::{
    call::Fault,
    message::{Tid, append},
    task::Phase,
};

/// On which chassis, seen from the message, something was noted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Side {
    /// Sender and receiver are here.
    Here,
    /// The sender is here, the receiver on another chassis.
    Sender,
    /// The receiver is here, the sender on another chassis.
    Receiver,
}

impl Side {
    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::Here => "here",
            Self::Sender => "sender",
            Self::Receiver => "receiver",
        }
    }
}

/// How a handler ended a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Ending {
    /// It returned `Ok`.
    Done,
    /// It returned an error.
    Refused(String),
    /// It panicked.
    Panicked(String),
    /// It was interrupted by an order to stop.
    Stopped,
}

/// One thing that happened. Moments are ns since the start of the app; numbers of messages are those
/// of this record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Happened {
    /// A message was sent, or came over a link; its data follows.
    Message {
        id: u64,
        to: Tid,
        from: Tid,
        command: u16,
        flags: u16,
        trace: u64,
        deadline: Option<u64>,
        side: Side,
    },
    /// A handler was called.
    Began {
        id: u64,
        task: Tid,
        from: Tid,
        command: u16,
        trace: u64,
    },
    /// It returned.
    Ended {
        id: u64,
        task: Tid,
        from: Tid,
        command: u16,
        trace: u64,
        began: u64,
        ending: Ending,
    },
    /// A sender has what it waited for: the reply, whose data follows, the acceptance of a one-way
    /// message, or a fault.
    Answered {
        id: u64,
        by: Tid,
        to: Tid,
        command: u16,
        trace: u64,
        side: Side,
        fault: Option<Fault>,
    },
    /// A task has entered a startup phase; without one, its handler has been built.
    Phase { task: Tid, phase: Option<Phase> },
    /// A line of the log; its fields follow as a JSON object.
    Log {
        level: u8,
        target: String,
        task: Option<String>,
        message: String,
    },
    /// A value that a task put on a channel of its own; it follows as JSON.
    Value { channel: String },
}

/// A head with its moment and the place that it came from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Head {
    pub(crate) at: u64,
    /// The chassis on which it happened.
    pub(crate) chassis: u8,
    pub(crate) what: Happened,
}

/// Bytes of the length in front of each event.
const LENGTH: usize = 4;

/// Appends an event to `buffer`; `data` writes what follows the head. When it fails, the event is
/// there without data.
pub(crate) fn push(
    buffer: &mut Vec<u8>,
    head: &Head,
    data: impl FnOnce(&mut Vec<u8>) -> bool,
) -> Result<(), postcard::Error> {
    let start = buffer.len();
    buffer.extend_from_slice(&[0; LENGTH]);
    if let Err(error) = append(head, buffer) {
        buffer.truncate(start);
        return Err(error);
    }
    let end = buffer.len();
    if !data(buffer) {
        buffer.truncate(end);
    }
    let length = u32::try_from(buffer.len() - start - LENGTH).unwrap_or(u32::MAX);
    if let Some(place) = buffer.get_mut(start..start + LENGTH) {
        place.copy_from_slice(&length.to_le_bytes());
    }
    Ok(())
}

/// The events in `bytes`, in their order, each with its data. Ends at anything that is none.
pub(crate) fn events(mut bytes: &[u8]) -> impl Iterator<Item = (Head, &[u8])> {
    std::iter::from_fn(move || {
        let (length, rest) = bytes.split_first_chunk::<LENGTH>()?;
        let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
        let (event, rest) = rest.split_at_checked(length)?;
        bytes = rest;
        postcard::take_from_bytes(event).ok()
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn head(at: u64) -> Head {
        Head {
            at,
            chassis: 1,
            what: Happened::Value {
                channel: "/x".to_owned(),
            },
        }
    }

    proptest! {
        #[test]
        fn events_come_out_as_they_were_put_in(
            events_in in proptest::collection::vec((any::<u64>(), proptest::collection::vec(any::<u8>(), 0..50)), 0..20)
        ) {
            let mut buffer = Vec::new();
            for (at, data) in &events_in {
                push(&mut buffer, &head(*at), |buffer| { buffer.extend_from_slice(data); true }).unwrap();
            }
            let out: Vec<(u64, Vec<u8>)> = events(&buffer).map(|(head, data)| (head.at, data.to_vec())).collect();
            prop_assert_eq!(out, events_in);
        }

        #[test]
        fn rubbish_ends_the_events_and_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = events(&bytes).count();
        }
    }

    #[test]
    fn an_event_whose_data_cannot_be_written_is_there_without_it() {
        let mut buffer = Vec::new();
        push(&mut buffer, &head(7), |buffer| {
            buffer.push(1);
            false
        })
        .unwrap();
        let out: Vec<_> = events(&buffer).collect();
        assert_eq!(out, [(head(7), &[][..])]);
    }
}
