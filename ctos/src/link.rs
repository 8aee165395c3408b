//! Links between chassis: what crosses them, and the one trait that every kind of link implements.

pub(crate) mod simulated;
pub(crate) mod tcp;

use bytes::{Buf, BufMut, Bytes, BytesMut};

use crate::message::Header;

/// The largest frame that is sent or accepted, bytes.
pub(crate) const FRAME_LIMIT: usize = 64 * 1024 * 1024;

/// The most data that one message carries between chassis, bytes.
pub(crate) const BODY_LIMIT: usize = FRAME_LIMIT - Header::BYTES - 8;

/// A message on its way between two chassis: the 16-byte header, the number of the call it asks or
/// answers, and the data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Frame {
    pub(crate) header: Header,
    /// The caller's number for the call; the reply carries it back.
    pub(crate) call: u64,
    pub(crate) body: Vec<u8>,
}

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
    /// Header, call number, data.
    pub(crate) fn encode(&self) -> Bytes {
        let mut bytes = BytesMut::with_capacity(Header::BYTES + 8 + self.body.len());
        bytes.put_slice(&self.header.encode());
        bytes.put_u64_le(self.call);
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
        if bytes.len() < 8 {
            return Err(FrameError::Short(length));
        }
        let call = bytes.get_u64_le();
        if u64::from(header.size) != bytes.len() as u64 {
            return Err(FrameError::Size {
                announced: header.size,
                carried: bytes.len(),
            });
        }
        Ok(Self {
            header,
            call,
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
            to: u32, from: u32, command: u16, flags: u16, call: u64,
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
                body,
            };
            prop_assert_eq!(Frame::decode(&frame.encode()).unwrap(), frame);
        }

        #[test]
        fn rubbish_is_an_error_and_never_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100)) {
            if let Ok(frame) = Frame::decode(&bytes) {
                prop_assert_eq!(frame.body.len() + Header::BYTES + 8, bytes.len());
            }
        }
    }
}
