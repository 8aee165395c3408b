//! Links between chassis: what crosses them, and the one trait that every kind of link implements.

pub(crate) mod simulated;
pub(crate) mod tcp;

use bytes::{Buf, BufMut, Bytes, BytesMut};

use crate::message::Header;

/// The largest frame that is sent or accepted, bytes.
pub(crate) const FRAME_LIMIT: usize = 64 * 1024 * 1024;

/// Bytes in front of the data: the header, the call's number, the trace id, the time left.
pub(crate) const FRAME_FIXED: usize = Header::BYTES + 3 * 8;

/// The most data that one message carries between chassis, bytes.
pub(crate) const BODY_LIMIT: usize = FRAME_LIMIT - FRAME_FIXED;

/// A message on its way between two chassis: the 16-byte header, what a message needs besides it to
/// be answered, followed and given up in time, and the data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Frame {
    pub(crate) header: Header,
    /// The caller's number for the call; the reply carries it back.
    pub(crate) call: u64,
    /// Shared by all messages that follow from one another.
    pub(crate) trace: u64,
    /// How long the sender still waits, ns; clocks of two hosts need not agree. [`NO_DEADLINE`] when
    /// it does not wait.
    pub(crate) left_ns: u64,
    pub(crate) body: Vec<u8>,
}

/// Nobody waits for the answer to this frame.
pub(crate) const NO_DEADLINE: u64 = u64::MAX;

/// A frame that cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FrameError {
    /// Shorter than its fixed part.
    #[error("a frame of {0} bytes is too short")]
    Short(usize),
    /// The header announces another size.
    #[error("a frame announces {announced} bytes of data and carries {carried}")]
    Size { announced: u32, carried: usize },
}

impl Frame {
    /// Header, call number, trace id, time left, data.
    pub(crate) fn encode(&self) -> Bytes {
        let mut bytes = BytesMut::with_capacity(FRAME_FIXED + self.body.len());
        bytes.put_slice(&self.header.encode());
        bytes.put_u64_le(self.call);
        bytes.put_u64_le(self.trace);
        bytes.put_u64_le(self.left_ns);
        bytes.put_slice(&self.body);
        bytes.freeze()
    }

    /// Reads what [`Self::encode`] wrote.
    pub(crate) fn decode(mut bytes: &[u8]) -> Result<Self, FrameError> {
        let length = bytes.len();
        let Some((header, rest)) = bytes.split_first_chunk::<{ Header::BYTES }>() else {
            return Err(FrameError::Short(length));
        };
        let header = Header::decode(header);
        bytes = rest;
        if bytes.len() < FRAME_FIXED - Header::BYTES {
            return Err(FrameError::Short(length));
        }
        let call = bytes.get_u64_le();
        let trace = bytes.get_u64_le();
        let left_ns = bytes.get_u64_le();
        if u64::from(header.size) != bytes.len() as u64 {
            return Err(FrameError::Size {
                announced: header.size,
                carried: bytes.len(),
            });
        }
        Ok(Self {
            header,
            call,
            trace,
            left_ns,
            body: bytes.to_vec(),
        })
    }
}

/// A way to another chassis. Frames posted by one thread arrive in their order.
///
/// Posting never waits: what is under way is bounded by the tasks that wait for an answer or an
/// acceptance, one frame each.
pub(crate) trait Link: Send + Sync {
    /// Sends a frame. A link that is down drops it; its calls end when the chassis learns so.
    fn post(&self, frame: Frame);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::{Flags, Tid};

    proptest! {
        #[test]
        fn a_frame_survives_the_wire(
            to: u32, from: u32, command: u16, flags: u16, call: u64, trace: u64, left_ns: u64,
            body in proptest::collection::vec(any::<u8>(), 0..200)
        ) {
            let frame = Frame {
                header: Header {
                    to: Tid::from_bits(to),
                    from: Tid::from_bits(from),
                    command,
                    flags: Flags::from_bits(flags),
                    size: body.len() as u32,
                },
                call,
                trace,
                left_ns,
                body,
            };
            prop_assert_eq!(Frame::decode(&frame.encode()).unwrap(), frame);
        }

        #[test]
        fn rubbish_is_an_error_and_never_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100)) {
            if let Ok(frame) = Frame::decode(&bytes) {
                prop_assert_eq!(frame.body.len() + FRAME_FIXED, bytes.len());
            }
        }
    }
}
