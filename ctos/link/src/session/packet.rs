//! Packets: what a session writes on a stream, and how they are read from one.
//!
//! A packet is its length (4 bytes, little-endian, of all that follows), its kind (1 byte), two
//! numbers (8 bytes each) and possibly a frame. A frame is the 20-byte header exactly as it is, the
//! call number and whatever else travels with it, and the data. Lengths are believed only up to the
//! limit, and memory is reserved only as bytes arrive.

use bytes::{Buf, BufMut, BytesMut};

use crate::{
    frame::{FRAME_FIXED, FRAME_LIMIT, Frame, FrameError},
    message::Header,
};

/// Length, kind, two numbers.
pub const PACKET_HEAD: usize = 4 + 1 + 8 + 8;

/// The most data of a message of the mesh, bytes.
pub const NOTICE_LIMIT: usize = 64 * 1024;

/// How much memory an announced length reserves before any of it has come, bytes.
const RESERVE: usize = 64 * 1024;

/// What a packet is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A frame of a task. The numbers: its own, and the last one received from the other end.
    Frame = 1,
    /// A message of the mesh to the mesh; numbered as frames are.
    Notice = 2,
    /// The last packet of an end that ends; numbered as frames are.
    Bye = 3,
    /// A sign of life. The numbers: the last one sent, the last one received.
    Pulse = 4,
    /// As a pulse, and something is missing: send again what comes after the last one received.
    Again = 5,
    /// The other end has been given up.
    GivenUp = 6,
    /// The next bytes of the data of a large frame, which others may come between. The first number: how
    /// many bytes of it came before. The last ones come with the frame.
    Piece = 7,
}

impl Kind {
    fn from_byte(byte: u8) -> Option<Self> {
        [
            Self::Frame,
            Self::Notice,
            Self::Bye,
            Self::Pulse,
            Self::Again,
            Self::GivenUp,
            Self::Piece,
        ]
        .into_iter()
        .find(|kind| *kind as u8 == byte)
    }

    /// Whether packets of this kind are numbered, kept until acknowledged and sent again when lost.
    pub fn is_numbered(self) -> bool {
        matches!(self, Self::Frame | Self::Notice | Self::Bye)
    }

    /// Bytes between the packet's head and its data.
    fn fixed(self) -> usize {
        if self == Self::Frame { FRAME_FIXED } else { 0 }
    }

    /// The bytes that must, and those that may, follow the packet's head.
    fn sizes(self) -> std::ops::RangeInclusive<usize> {
        match self {
            Self::Frame => FRAME_FIXED..=FRAME_LIMIT,
            Self::Piece => 1..=FRAME_LIMIT,
            Self::Notice => 0..=NOTICE_LIMIT,
            Self::Bye | Self::Pulse | Self::Again | Self::GivenUp => 0..=0,
        }
    }
}

/// A packet that was read.
#[derive(Debug, PartialEq, Eq)]
pub struct Packet {
    pub kind: Kind,
    /// Its number, or the last number that was sent.
    pub number: u64,
    /// The last number that the sender has received.
    pub received: u64,
    pub content: Content,
}

/// What a packet carries.
#[derive(Debug, Default, PartialEq, Eq)]
pub enum Content {
    #[default]
    Nothing,
    Frame(Frame),
    Notice(Vec<u8>),
}

impl Content {
    /// How many bytes of data it is.
    pub fn size(&self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Frame(frame) => frame.body.len(),
            Self::Notice(bytes) => bytes.len(),
        }
    }
}

/// What no peer may send.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    #[error("a packet of unknown kind {0}")]
    Kind(u8),
    #[error(
        "a packet of kind {kind:?} announces {length} bytes; between {least} and {most} are allowed"
    )]
    Length {
        kind: Kind,
        length: usize,
        least: usize,
        most: usize,
    },
    #[error("a piece of a frame begins at byte {at} of its data, of which {come} have come")]
    Piece { at: u64, come: usize },
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error("a packet acknowledges number {received} and only {sent} were sent")]
    Acknowledges { received: u64, sent: u64 },
}

/// Writes the head of a packet that `size` more bytes follow.
pub fn put_head(into: &mut BytesMut, kind: Kind, numbers: [u64; 2], size: usize) {
    // The largest frame is far below 4 GiB; what is larger was refused when it was posted.
    let length = u32::try_from(PACKET_HEAD - 4 + size).unwrap_or(u32::MAX);
    // In one piece: each `put` checks the space.
    let mut head = [0; PACKET_HEAD];
    let mut place = &mut head[..];
    place.put_u32_le(length);
    place.put_u8(kind as u8);
    place.put_u64_le(numbers[0]);
    place.put_u64_le(numbers[1]);
    into.put_slice(&head);
}

/// Reads packets out of a stream that is cut anywhere.
#[derive(Default)]
pub struct Decoder {
    /// What has come of the packet's head, and of the fixed part behind it.
    head: Vec<u8>,
    /// A packet whose head has come, and how much of its data has not.
    begun: Option<(Packet, usize)>,
    body: Vec<u8>,
    /// What has come of a frame that comes in pieces.
    pieces: Vec<u8>,
}

impl Decoder {
    /// Takes what it needs from the front of `bytes`; a packet when one is complete.
    ///
    /// # Errors
    /// [`PacketError`]; the stream is of no use afterwards.
    pub fn feed(&mut self, bytes: &mut &[u8]) -> Result<Option<Packet>, PacketError> {
        loop {
            if !fill(&mut self.head, PACKET_HEAD, bytes) {
                return Ok(None);
            }
            let (mut packet, mut missing) = match self.begun.take() {
                Some(begun) => begun,
                None => self.begin()?,
            };
            if fill(&mut self.head, PACKET_HEAD + packet.kind.fixed(), bytes) {
                let (now, later) = bytes.split_at(missing.min(bytes.len()));
                let is_piece = packet.kind == Kind::Piece;
                let into = if is_piece {
                    &mut self.pieces
                } else {
                    &mut self.body
                };
                into.extend_from_slice(now);
                missing -= now.len();
                *bytes = later;
                if missing == 0 {
                    packet.content = self.finish(packet.kind)?;
                    if is_piece {
                        continue;
                    }
                    return Ok(Some(packet));
                }
            }
            self.begun = Some((packet, missing));
            return Ok(None);
        }
    }

    /// Reads the head, which is there.
    fn begin(&mut self) -> Result<(Packet, usize), PacketError> {
        let mut head = self.head.as_slice();
        let length = usize::try_from(head.get_u32_le()).unwrap_or(usize::MAX);
        let byte = head.get_u8();
        let (number, received) = (head.get_u64_le(), head.get_u64_le());
        let kind = Kind::from_byte(byte).ok_or(PacketError::Kind(byte))?;
        let allowed = kind.sizes();
        let size = length.wrapping_sub(PACKET_HEAD - 4);
        if length < PACKET_HEAD - 4 || !allowed.contains(&size) {
            return Err(PacketError::Length {
                kind,
                length,
                least: PACKET_HEAD - 4 + allowed.start(),
                most: PACKET_HEAD - 4 + allowed.end(),
            });
        }
        let missing = size - kind.fixed();
        if kind == Kind::Piece {
            if number == 0 {
                // The first of a frame; perhaps of one that begins anew.
                self.pieces.clear();
            }
            let come = self.pieces.len();
            if number != come as u64 || come + size > FRAME_LIMIT {
                return Err(PacketError::Piece { at: number, come });
            }
        } else {
            self.body.reserve_exact(missing.min(RESERVE));
        }
        let packet = Packet {
            kind,
            number,
            received,
            content: Content::Nothing,
        };
        Ok((packet, missing))
    }

    /// What the packet carries that has come as a whole.
    fn finish(&mut self, kind: Kind) -> Result<Content, PacketError> {
        let mut body = std::mem::take(&mut self.body);
        let content = match kind {
            Kind::Frame => {
                let fixed = self.head.get(PACKET_HEAD..).unwrap_or_default();
                let header = fixed.first_chunk().map(Header::decode);
                if header.is_some_and(|header| header.size as usize > body.len()) {
                    let mut whole = std::mem::take(&mut self.pieces);
                    let come = whole.len();
                    if FRAME_FIXED + come + body.len() > FRAME_LIMIT {
                        let at = come as u64;
                        return Err(PacketError::Piece { at, come });
                    }
                    whole.append(&mut body);
                    body = whole;
                }
                Content::Frame(Frame::from_parts(fixed, body.into())?)
            }
            Kind::Notice => Content::Notice(body),
            Kind::Bye | Kind::Pulse | Kind::Again | Kind::GivenUp | Kind::Piece => Content::Nothing,
        };
        self.head.clear();
        Ok(content)
    }

    /// Bytes that are reserved for the body of the packet that is being read.
    #[doc(hidden)]
    pub fn reserved(&self) -> usize {
        self.body.capacity()
    }
}

/// Moves bytes into `head` until it holds `wanted`; whether it does.
fn fill(head: &mut Vec<u8>, wanted: usize, bytes: &mut &[u8]) -> bool {
    let missing = wanted.saturating_sub(head.len());
    let (now, later) = bytes.split_at(missing.min(bytes.len()));
    head.extend_from_slice(now);
    *bytes = later;
    head.len() >= wanted
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{super::tests::sample, *};

    fn bytes_of(kind: Kind, numbers: [u64; 2], rest: &[u8]) -> Vec<u8> {
        let mut bytes = BytesMut::new();
        put_head(&mut bytes, kind, numbers, rest.len());
        bytes.extend_from_slice(rest);
        bytes.to_vec()
    }

    fn read(mut bytes: &[u8], cuts: &[usize]) -> Result<Vec<Packet>, PacketError> {
        let mut decoder = Decoder::default();
        let mut packets = Vec::new();
        let mut cuts = cuts.iter().cycle();
        while !bytes.is_empty() {
            let cut = cuts.next().copied().unwrap_or(1).clamp(1, bytes.len());
            let (mut now, later) = bytes.split_at(cut);
            while let Some(packet) = decoder.feed(&mut now)? {
                packets.push(packet);
            }
            assert!(now.is_empty());
            bytes = later;
        }
        Ok(packets)
    }

    proptest! {
        #[test]
        fn packets_survive_a_stream_that_is_cut_anywhere(
            numbers: [u64; 2],
            body in proptest::collection::vec(any::<u8>(), 0..300),
            notice in proptest::collection::vec(any::<u8>(), 0..300),
            cuts in proptest::collection::vec(1_usize..40, 1..20),
        ) {
            let frame = sample::request(body);
            let stream = [
                bytes_of(Kind::Frame, numbers, &sample::bytes_of(&frame)),
                bytes_of(Kind::Pulse, numbers, &[]),
                bytes_of(Kind::Notice, numbers, &notice),
                bytes_of(Kind::Bye, numbers, &[]),
            ].concat();
            let packets = read(&stream, &cuts).unwrap();
            let kinds: Vec<Kind> = packets.iter().map(|packet| packet.kind).collect();
            prop_assert_eq!(kinds, vec![Kind::Frame, Kind::Pulse, Kind::Notice, Kind::Bye]);
            prop_assert!(packets.iter().all(|packet| [packet.number, packet.received] == numbers));
            prop_assert_eq!(&packets[0].content, &Content::Frame(frame));
            prop_assert_eq!(&packets[2].content, &Content::Notice(notice));
        }

        #[test]
        fn rubbish_is_an_error_or_waits_and_reserves_little(
            bytes in proptest::collection::vec(any::<u8>(), 0..400),
        ) {
            let mut decoder = Decoder::default();
            let mut rest = bytes.as_slice();
            while let Ok(Some(_)) = decoder.feed(&mut rest) {}
            let reserved = decoder.body.capacity().max(decoder.pieces.capacity());
            prop_assert!(reserved <= RESERVE.max(2 * bytes.len()));
        }

    }

    #[test]
    fn two_gibibytes_announced_are_refused_at_once() {
        let mut bytes = bytes_of(Kind::Frame, [1, 0], &[]);
        bytes[..4].copy_from_slice(&(1_u32 << 31).to_le_bytes());
        let error = read(&bytes, &[1]).unwrap_err();
        assert!(error.to_string().contains("2147483648"), "{error}");
    }
}
