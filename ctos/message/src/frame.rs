//! What goes from chassis to chassis: a frame, and the one trait that every kind of link implements.
//!
//! Knows how a frame is laid out; who carries it, and what becomes of it, is decided elsewhere.

use crate::{Header, blob::Body};

/// The largest frame that is sent or accepted, bytes.
pub const FRAME_LIMIT: usize = 64 * 1024 * 1024;

/// Bytes in front of the data: the header, the call's number, the trace id, the time left.
pub const FRAME_FIXED: usize = Header::BYTES + 3 * 8;

/// The most data that one message carries between chassis, bytes.
pub const BODY_LIMIT: usize = FRAME_LIMIT - FRAME_FIXED;

/// A message on its way between two chassis: the 20-byte header and the data. It also has what a
/// message needs to be answered, followed and given up in time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// Who asks whom for what.
    pub header: Header,
    /// The caller's number for the call; the reply carries it back.
    pub call: u64,
    /// Shared by all messages that follow from one another.
    pub trace: u64,
    /// How long the sender still waits, ns; clocks of two hosts need not agree. [`NO_DEADLINE`] when
    /// it does not wait.
    pub left_ns: u64,
    /// The data.
    pub body: Body,
}

/// Nobody waits for the answer to this frame.
pub const NO_DEADLINE: u64 = u64::MAX;

/// A frame that cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Shorter than its fixed part.
    #[error("a frame of {0} bytes is too short")]
    Short(usize),
    /// The header announces another size.
    #[error("a frame announces {announced} bytes of data and carries {carried}")]
    Size {
        /// Bytes by the header.
        announced: u32,
        /// Bytes that came.
        carried: usize,
    },
}

impl Frame {
    /// Header, call number, trace id, time left.
    pub fn head(&self) -> [u8; FRAME_FIXED] {
        let mut bytes = [0; FRAME_FIXED];
        let (header, rest) = bytes.split_at_mut(Header::BYTES);
        header.copy_from_slice(&self.header.encode());
        let numbers = [self.call, self.trace, self.left_ns];
        for (place, number) in rest.chunks_exact_mut(8).zip(numbers) {
            place.copy_from_slice(&number.to_le_bytes());
        }
        bytes
    }

    /// Reads what [`Self::head`] wrote, and takes the data that followed it.
    ///
    /// # Errors
    /// When the head is too short, or announces another size than the data has.
    pub fn from_parts(head: &[u8], body: Body) -> Result<Self, FrameError> {
        let short = FrameError::Short(head.len());
        let (header, rest) = head.split_first_chunk::<{ Header::BYTES }>().ok_or(short)?;
        let header = Header::decode(header);
        let (numbers, _) = rest.as_chunks::<8>();
        let &[call, trace, left_ns] = numbers else {
            return Err(short);
        };
        if u64::from(header.size) != body.len() as u64 {
            return Err(FrameError::Size {
                announced: header.size,
                carried: body.len(),
            });
        }
        Ok(Self {
            header,
            call: u64::from_le_bytes(call),
            trace: u64::from_le_bytes(trace),
            left_ns: u64::from_le_bytes(left_ns),
            body,
        })
    }
}

/// For the tests of those who carry frames.
/// A link that takes no more for the moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Full {
    /// Bytes that are under way already.
    pub bytes: usize,
}

/// What went over a link so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Frames posted.
    pub frames_out: u64,
    /// Their data, bytes.
    pub bytes_out: u64,
    /// Frames received.
    pub frames_in: u64,
    /// Their data, bytes.
    pub bytes_in: u64,
    /// Streams it has had; all but the first are reconnections.
    pub streams: u64,
    /// Frames for which there were no credits.
    pub refused: u64,
    /// Bytes that are under way and not acknowledged.
    pub bytes_under_way: u64,
}

/// A way to another chassis. Frames posted by one thread arrive in their order.
///
/// Posting never waits: what is under way is bounded, and a request beyond that is refused. Answers and
/// messages of the runtime have credits of their own and are never refused.
pub trait Link: Send + Sync {
    /// Sends a frame. A link that is down drops it; its calls end when the chassis learns so.
    ///
    /// # Errors
    /// [`Full`] when too much is under way already: the peer does not read, or not fast enough.
    fn post(&self, frame: Frame) -> Result<(), Full>;

    /// What went over it.
    fn counts(&self) -> Counts {
        Counts::default()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Flags, Tid};

    proptest! {
        #[test]
        fn a_frame_survives_the_wire(
            to: u64, from: u64, command: u16, flags: u16, call: u64, trace: u64, left_ns: u64,
            body in proptest::collection::vec(any::<u8>(), 0..200)
        ) {
            let frame = Frame {
                header: Header {
                    to: Tid::from_bits(to),
                    from: Tid::from_bits(from),
                    command,
                    flags: Flags::from_bits_retain(flags),
                    size: body.len() as u32,
                },
                call,
                trace,
                left_ns,
                body: body.into(),
            };
            let read = Frame::from_parts(&frame.head(), frame.body.clone());
            prop_assert_eq!(read.unwrap(), frame);
        }

        #[test]
        fn rubbish_is_an_error_and_never_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100)) {
            let (head, body) = bytes.split_at(FRAME_FIXED.min(bytes.len()));
            if let Ok(frame) = Frame::from_parts(head, body.to_vec().into()) {
                prop_assert_eq!(frame.body.len() + FRAME_FIXED, bytes.len());
            }
        }
    }
}
