//! Packets: what a session writes on a stream, and how they are read from one.
//!
//! A packet is its length (4 bytes, little-endian, of all that follows), its kind (1 byte), two
//! numbers (8 bytes each) and, for a frame, the frame: the 16-byte header exactly as it is, the call
//! number and whatever else travels with it, and the data. Lengths are believed only up to the limit,
//! and memory is reserved only as bytes arrive.

use std::sync::Arc;

use bytes::{Buf, BufMut, Bytes, BytesMut};

use crate::{
    blob::Body,
    link::{FRAME_FIXED, FRAME_LIMIT, Frame, FrameError, shm::pool::Foreign},
};

/// Length, kind, two numbers.
pub(crate) const PACKET_HEAD: usize = 4 + 1 + 8 + 8;

/// The most data of a message of the mesh, bytes.
pub(crate) const NOTICE_LIMIT: usize = 64 * 1024;

/// How much memory an announced length reserves before any of it has come, bytes.
const RESERVE: usize = 64 * 1024;

/// How much more of it is reserved at once when half of [`LARGE`] bytes of it have come, at least, bytes. What is
/// not written to costs addresses, not memory.
const RESERVE_MORE: usize = 1024 * 1024;

/// Data of which less is missing goes the way of small packets, bytes.
const LARGE: usize = 16 * 1024;

/// What a packet is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
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
    /// As a frame, with data that stays where it is and is lent: behind the frame's fixed part stand how
    /// many pieces are lent (4 bytes), for each where it belongs (see [`Place::put`]), and the other data.
    Lent = 7,
    /// The next bytes of the data of a large frame, which others may come between. The first number: how
    /// many bytes of it came before.
    Piece = 8,
    /// A frame with the last bytes of its data; the others have come in pieces.
    Last = 9,
}

/// The most pieces of one frame that are lent.
pub(crate) const MOST_LENT: usize = 16;

/// Where data stands that is lent to a peer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// Under which number it is lent.
    pub(crate) slot: u32,
    /// Where it begins in the lender's pool, bytes.
    pub(crate) offset: u64,
    /// How many bytes it is.
    pub(crate) length: u64,
}

impl Place {
    /// Bytes of a place in a packet.
    const BYTES: usize = 4 + 4 + 8 + 8;

    /// Writes it: before which of the other data it belongs, its slot, offset and length.
    pub(crate) fn put(&self, into: &mut BytesMut, before: usize) {
        // Other data is less than a frame may be.
        into.put_u32_le(u32::try_from(before).unwrap_or(u32::MAX));
        into.put_u32_le(self.slot);
        into.put_u64_le(self.offset);
        into.put_u64_le(self.length);
    }

    fn get(bytes: &mut &[u8]) -> Option<(usize, Self)> {
        let before = bytes.try_get_u32_le().ok()?;
        let place = Self {
            slot: bytes.try_get_u32_le().ok()?,
            offset: bytes.try_get_u64_le().ok()?,
            length: bytes.try_get_u64_le().ok()?,
        };
        Some((usize::try_from(before).ok()?, place))
    }
}

/// Who lends data to the other end of a stream, so that only its place crosses it.
pub(crate) trait Lend: Send {
    /// Keeps `bytes` for the other end until it gives them back. `None` when they must be copied.
    fn lend(&mut self, bytes: &Bytes) -> Option<Place>;

    /// Takes back what was given back.
    fn collect(&mut self);
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
            Self::Lent,
            Self::Piece,
            Self::Last,
        ]
        .into_iter()
        .find(|kind| *kind as u8 == byte)
    }

    /// Whether packets of this kind are numbered, kept until acknowledged and sent again when lost.
    pub(crate) fn is_numbered(self) -> bool {
        matches!(
            self,
            Self::Frame | Self::Notice | Self::Bye | Self::Lent | Self::Last
        )
    }

    /// The bytes that must, and those that may, follow the packet's head.
    fn sizes(self) -> std::ops::RangeInclusive<usize> {
        match self {
            Self::Frame | Self::Last => FRAME_FIXED..=FRAME_LIMIT,
            Self::Piece => 1..=FRAME_LIMIT,
            Self::Lent => FRAME_FIXED + 4..=FRAME_LIMIT + 4 + MOST_LENT * Place::BYTES,
            Self::Notice => 0..=NOTICE_LIMIT,
            Self::Bye | Self::Pulse | Self::Again | Self::GivenUp => 0..=0,
        }
    }
}

/// A packet that was read.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Packet {
    pub(crate) kind: Kind,
    /// Its number, or the last number that was sent.
    pub(crate) number: u64,
    /// The last number that the sender has received.
    pub(crate) received: u64,
    pub(crate) content: Content,
}

/// What a packet carries.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Nothing,
    Frame(Frame),
    Notice(Vec<u8>),
}

impl Packet {
    /// Whether it carries something for a task.
    pub(crate) fn is_frame(&self) -> bool {
        matches!(self.content, Content::Frame(_))
    }
}

/// What no peer may send.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum PacketError {
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
    #[error("a frame lends data that is not there")]
    Lent,
    #[error("a piece of a frame begins at byte {at} of its data, of which {come} have come")]
    Piece { at: u64, come: usize },
    #[error(transparent)]
    Frame(#[from] FrameError),
    #[error("a packet acknowledges number {received} and only {sent} were sent")]
    Acknowledges { received: u64, sent: u64 },
}

/// Writes the head of a packet that `size` more bytes follow.
pub(crate) fn put_head(into: &mut BytesMut, kind: Kind, numbers: [u64; 2], size: usize) {
    // The largest frame is far below 4 GiB; what is larger was refused when it was posted.
    let length = u32::try_from(PACKET_HEAD - 4 + size).unwrap_or(u32::MAX);
    // In one piece: each that is put is looked after.
    let mut head = [0; PACKET_HEAD];
    let mut place = &mut head[..];
    place.put_u32_le(length);
    place.put_u8(kind as u8);
    place.put_u64_le(numbers[0]);
    place.put_u64_le(numbers[1]);
    into.put_slice(&head);
}

enum Stage {
    /// The head of the next packet, so far.
    Head,
    /// The rest of a packet, so far, and how long it is.
    Rest {
        kind: Kind,
        numbers: [u64; 2],
        size: usize,
        /// How much of its data came in pieces before.
        before: usize,
    },
}

impl Stage {
    /// How much data of the packet is missing, when so much of it is there.
    fn missing(&self, there: usize) -> usize {
        match self {
            Self::Head => 0,
            Self::Rest {
                kind, size, before, ..
            } => (before + size - fixed_size(*kind)).saturating_sub(there),
        }
    }
}

/// Reads packets out of a stream that is cut anywhere.
pub(crate) struct Decoder {
    stage: Stage,
    /// What has come of the packet's head, or of its fixed part behind the head.
    head: BytesMut,
    body: Vec<u8>,
    /// What has come of a frame that comes in pieces.
    pieces: Vec<u8>,
    /// The last packet was such a piece: most likely another one follows.
    between: bool,
    /// Where the other end lends data from.
    foreign: Option<Arc<Foreign>>,
}

impl Default for Decoder {
    fn default() -> Self {
        Self {
            stage: Stage::Head,
            head: BytesMut::with_capacity(PACKET_HEAD + FRAME_FIXED),
            body: Vec::new(),
            pieces: Vec::new(),
            between: false,
            foreign: None,
        }
    }
}

impl Decoder {
    /// Of a stream whose other end lends data from there.
    pub(crate) fn borrowing(foreign: Option<Arc<Foreign>>) -> Self {
        Self {
            foreign,
            ..Self::default()
        }
    }

    /// The data of a frame of which some is lent.
    fn borrow(&self, body: &[u8]) -> Option<Body> {
        let foreign = self.foreign.as_ref()?;
        let mut rest = body;
        let count = usize::try_from(rest.try_get_u32_le().ok()?).ok()?;
        if count > MOST_LENT {
            return None;
        }
        let mut blobs = Vec::with_capacity(count);
        for _ in 0..count {
            let (before, place) = Place::get(&mut rest)?;
            blobs.push((before, foreign.borrow(place)?));
        }
        Body::of_parts(rest.to_vec(), blobs)
    }

    /// Takes what it needs from the front of `bytes`; a packet when one is complete.
    ///
    /// # Errors
    /// [`PacketError`]; the stream is of no use afterwards.
    pub(crate) fn feed(&mut self, bytes: &mut &[u8]) -> Result<Option<Packet>, PacketError> {
        loop {
            match self.stage {
                Stage::Head => {
                    let head = match bytes.split_first_chunk::<PACKET_HEAD>() {
                        // Read where it stands.
                        Some((head, rest)) if self.head.is_empty() => {
                            *bytes = rest;
                            *head
                        }
                        _ => {
                            let whole = fill(&mut self.head, PACKET_HEAD, bytes);
                            match self.head.first_chunk() {
                                Some(head) if whole => *head,
                                _ => return Ok(None),
                            }
                        }
                    };
                    self.begin(&head)?;
                }
                Stage::Rest { kind, numbers, .. } => {
                    if !fill(&mut self.head, fixed_size(kind), bytes) {
                        return Ok(None);
                    }
                    let missing = self.stage.missing(self.body.len());
                    let (now, later) = bytes.split_at(missing.min(bytes.len()));
                    self.body.extend_from_slice(now);
                    *bytes = later;
                    if now.len() < missing {
                        return Ok(None);
                    }
                    if kind == Kind::Piece {
                        self.pieces = std::mem::take(&mut self.body);
                        self.between = true;
                        self.head.clear();
                        self.stage = Stage::Head;
                        continue;
                    }
                    return self.finish(kind, numbers).map(Some);
                }
            }
        }
    }

    fn begin(&mut self, head: &[u8; PACKET_HEAD]) -> Result<(), PacketError> {
        let mut head = &head[..];
        // All of them are there.
        let length = usize::try_from(head.get_u32_le()).unwrap_or(usize::MAX);
        let byte = head.get_u8();
        let numbers = [head.get_u64_le(), head.get_u64_le()];
        let kind = Kind::from_byte(byte).ok_or(PacketError::Kind(byte))?;
        let allowed = kind.sizes();
        let wrong = PacketError::Length {
            kind,
            length,
            least: PACKET_HEAD - 4 + allowed.start(),
            most: PACKET_HEAD - 4 + allowed.end(),
        };
        let size = length
            .checked_sub(PACKET_HEAD - 4)
            .filter(|size| allowed.contains(size))
            .ok_or(wrong)?;
        self.head.clear();
        self.between = false;
        let before = self.body_before(kind, numbers, size)?;
        self.stage = Stage::Rest {
            kind,
            numbers,
            size,
            before,
        };
        Ok(())
    }

    /// Prepares the body of a packet: a new one, or what came in pieces before, of which it says the size.
    fn body_before(
        &mut self,
        kind: Kind,
        [at, _]: [u64; 2],
        size: usize,
    ) -> Result<usize, PacketError> {
        if !matches!(kind, Kind::Piece | Kind::Last) {
            self.body = Vec::with_capacity((size - fixed_size(kind)).min(RESERVE));
            return Ok(0);
        }
        let mut pieces = std::mem::take(&mut self.pieces);
        if kind == Kind::Piece && at == 0 {
            // The first of a frame; perhaps of one that begins anew.
            pieces.clear();
        }
        let before = pieces.len();
        let fits = kind == Kind::Last || at == before as u64;
        if !fits || before + size > FRAME_LIMIT {
            return Err(PacketError::Piece { at, come: before });
        }
        self.body = pieces;
        Ok(before)
    }

    fn finish(&mut self, kind: Kind, numbers: [u64; 2]) -> Result<Packet, PacketError> {
        self.stage = Stage::Head;
        let body = std::mem::take(&mut self.body);
        let content = match kind {
            Kind::Frame | Kind::Last => Content::Frame(Frame::from_parts(&self.head, body.into())?),
            Kind::Lent => {
                let body = self.borrow(&body).ok_or(PacketError::Lent)?;
                Content::Frame(Frame::from_parts(&self.head, body)?)
            }
            Kind::Notice => Content::Notice(body),
            Kind::Bye | Kind::Pulse | Kind::Again | Kind::GivenUp | Kind::Piece => Content::Nothing,
        };
        self.head.clear();
        let [number, received] = numbers;
        Ok(Packet {
            kind,
            number,
            received,
            content,
        })
    }

    /// Bytes that are reserved for the body of the packet that is being read.
    #[cfg(test)]
    pub(crate) fn reserved(&self) -> usize {
        self.body.capacity()
    }

    /// Whether a large packet has come in part.
    pub(crate) fn is_in_large(&self) -> bool {
        self.stage.missing(self.body.len()) >= LARGE
    }

    /// How much to read at a time at most, where that is not the data of one large frame: between its pieces only
    /// as much as stands in front of the next one, so that its data need not be copied.
    pub(crate) fn most(&self, usual: usize) -> usize {
        if self.between {
            usual.min(PACKET_HEAD + FRAME_FIXED)
        } else {
            usual
        }
    }

    /// Where the data of a large packet goes, when much of it is still to come, and how much may be read
    /// into the free place there at most: that is not copied again. [`Self::feed`], with nothing,
    /// completes the packet.
    pub(crate) fn large_body(&mut self) -> Option<(&mut Vec<u8>, usize)> {
        let Stage::Rest { kind, .. } = self.stage else {
            return None;
        };
        let missing = self.stage.missing(self.body.len());
        if self.head.len() < fixed_size(kind) || missing < LARGE {
            return None;
        }
        // Grows with what has come: an announcement alone reserves little.
        let least = if self.body.len() < LARGE / 2 {
            RESERVE
        } else {
            RESERVE_MORE
        };
        let grown = self.body.len().max(least);
        if self.body.capacity() - self.body.len() < missing.min(grown) {
            // Other pieces will follow this one, and what is there already shall not be moved for them.
            let more = if kind == Kind::Piece {
                grown
            } else {
                missing.min(grown)
            };
            self.body.reserve_exact(more);
        }
        let free = self.body.capacity() - self.body.len();
        Some((&mut self.body, missing.min(free)))
    }
}

/// What stands between a packet's head and its data.
fn fixed_size(kind: Kind) -> usize {
    match kind {
        Kind::Frame | Kind::Lent | Kind::Last => FRAME_FIXED,
        Kind::Notice | Kind::Bye | Kind::Pulse | Kind::Again | Kind::GivenUp | Kind::Piece => 0,
    }
}

/// Moves bytes into `head` until it holds `wanted`; whether it does.
fn fill(head: &mut BytesMut, wanted: usize, bytes: &mut &[u8]) -> bool {
    let missing = wanted.saturating_sub(head.len());
    let (now, later) = bytes.split_at(missing.min(bytes.len()));
    head.extend_from_slice(now);
    *bytes = later;
    head.len() >= wanted
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

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
            let frame = Frame::of_body(body);
            let stream = [
                bytes_of(Kind::Frame, numbers, &frame.encode()),
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

        #[test]
        fn a_large_body_may_be_read_in_place(
            // So much that it is still large when what came with the head is taken off.
            size in LARGE + 100..4 * LARGE,
            step in 1..LARGE,
        ) {
            let body: Vec<u8> = (0..size).map(|index| (index % 251) as u8).collect();
            let frame = Frame::of_body(body);
            let stream = bytes_of(Kind::Frame, [1, 0], &frame.encode());
            let mut bytes = stream.as_slice();
            let mut decoder = Decoder::default();
            let mut packet = None;
            let mut in_place = 0;
            while packet.is_none() {
                let mut now: &[u8] = &[];
                if let Some((body, most)) = decoder.large_body() {
                    prop_assert!(most <= body.capacity() - body.len());
                    let count = step.min(most).min(bytes.len());
                    body.extend_from_slice(&bytes[..count]);
                    bytes = &bytes[count..];
                    in_place += count;
                } else {
                    (now, bytes) = bytes.split_at(step.min(bytes.len()).min(100));
                }
                packet = decoder.feed(&mut now).unwrap();
                prop_assert!(now.is_empty());
            }
            prop_assert!(in_place > 0 && bytes.is_empty());
            prop_assert_eq!(packet.unwrap().content, Content::Frame(frame));
        }

        #[test]
        fn the_pieces_of_a_large_body_are_read_in_place_and_never_what_follows_them(
            sizes in proptest::collection::vec(LARGE..4 * LARGE, 2..6),
            // More than is missing, too: so much lies ready in a socket.
            steps in proptest::collection::vec(1..6 * LARGE, 1..10),
        ) {
            let size: usize = sizes.iter().sum();
            let body: Vec<u8> = (0..size).map(|index| (index % 251) as u8).collect();
            let frame = Frame::of_body(body.clone());
            let mut stream = Vec::new();
            let mut ends = Vec::new();
            let mut at = 0;
            for (index, size) in sizes.iter().enumerate() {
                let part = &body[at..at + size];
                if index + 1 < sizes.len() {
                    stream.extend(bytes_of(Kind::Piece, [at as u64, 0], part));
                    ends.push(stream.len());
                } else {
                    let last = [&frame.head(), part].concat();
                    stream.extend(bytes_of(Kind::Last, [1, 0], &last));
                }
                at += size;
            }
            stream.extend(bytes_of(Kind::Pulse, [1, 0], &[]));
            let mut bytes = stream.as_slice();
            let mut decoder = Decoder::default();
            let mut packets = Vec::new();
            let mut steps = steps.iter().cycle();
            const USUAL: usize = 10_000;
            while packets.len() < 2 {
                let step = steps.next().copied().unwrap_or(1).min(bytes.len());
                let mut now: &[u8] = &[];
                if let Some((body, most)) = decoder.large_body() {
                    let count = step.min(most);
                    let capacity = body.capacity();
                    body.extend_from_slice(&bytes[..count]);
                    prop_assert_eq!(body.capacity(), capacity, "there was no place for it");
                    bytes = &bytes[count..];
                } else {
                    let most = decoder.most(USUAL);
                    let before = stream.len() - bytes.len();
                    let mut ends = ends.iter();
                    // Within the head of the piece that follows on one.
                    let between = ends.any(|end| (*end..end + PACKET_HEAD).contains(&before));
                    prop_assert_eq!(most < USUAL, between, "behind byte {}", before);
                    (now, bytes) = bytes.split_at(step.min(most).min(100));
                }
                while let Some(packet) = decoder.feed(&mut now).unwrap() {
                    packets.push(packet);
                }
                prop_assert!(now.is_empty());
            }
            prop_assert!(bytes.is_empty());
            prop_assert_eq!(&packets[0].content, &Content::Frame(frame));
            prop_assert_eq!(packets[1].kind, Kind::Pulse);
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
