//! What makes a byte stream of numbered chunks: offsets that show a gap, credit so that nobody has to
//! wait in the network for a reader, and an end that is told.
//!
//! A zenoh network gives way to congestion in its own manner: what does not fit is dropped, or the whole
//! connection stands still, and with it the streams of all others. So no end ever sends more than the
//! other one has credits for. Knows no network: chunks go in and come out as bytes.

use bytes::{Buf, BytesMut};

/// How much may be on its way and not read, bytes. Small enough that the queues along the way hold what a
/// few streams send to a process that stands still.
pub(super) const WINDOW: u64 = 512 * 1024;

/// The most data of a chunk, bytes: with its head it fits into one batch of zenoh's.
pub(super) const CHUNK: usize = 60 * 1024;

/// How much may be written and not sent, bytes.
const UNSENT: usize = 256 * 1024;

/// The other end is told what was read when it is this much, bytes.
const TELL: u64 = WINDOW / 4;

/// In front of a chunk's data: whether it is the last, its offset, up to which one the sender has read.
const HEAD: usize = 1 + 8 + 8;

const LAST: u8 = 1;

/// Why a stream is of no use any more.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum Broken {
    #[error("a chunk of {0} bytes is too short")]
    Short(usize),
    #[error("byte {expected} should have come, and {found} did: the network lost something")]
    Gap { expected: u64, found: u64 },
    #[error("the other end sends more than it may")]
    Credit,
    #[error("the other end has read what was never sent")]
    Acknowledged,
    #[error("the other end is gone")]
    Gone,
    #[error("the network does not take it: {0}")]
    Network(String),
}

/// One end of a stream.
#[derive(Debug, Default)]
pub(super) struct Pipe {
    /// Arrived and not read.
    arrived: BytesMut,
    /// The offset of the byte that arrives next.
    expected: u64,
    /// The offset up to which the other end knows that it was read.
    told: u64,
    last_heard: bool,
    /// Whoever read here does not any more: what arrives counts as read.
    deaf: bool,
    /// Written and not sent.
    waiting: BytesMut,
    /// The offset of the byte that is sent next.
    sent: u64,
    /// The offset up to which the other end has read.
    acknowledged: u64,
    closed: bool,
    last_sent: bool,
    /// Whether the other end listens: nothing is sent before, it would be lost.
    heard: bool,
    broken: Option<Broken>,
}

/// What comes of an attempt to read.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Read {
    Bytes(usize),
    Nothing,
    End,
}

impl Pipe {
    fn read_up_to(&self) -> u64 {
        self.expected - self.arrived.len() as u64
    }

    /// Takes a chunk that arrived.
    pub(super) fn arrive(&mut self, chunk: &[u8]) {
        if self.broken.is_none()
            && let Err(broken) = self.take(chunk)
        {
            self.broken = Some(broken);
        }
    }

    fn take(&mut self, chunk: &[u8]) -> Result<(), Broken> {
        let short = || Broken::Short(chunk.len());
        let (flags, rest) = chunk.split_first().ok_or_else(short)?;
        let (offset, rest) = rest.split_first_chunk::<8>().ok_or_else(short)?;
        let (read, data) = rest.split_first_chunk::<8>().ok_or_else(short)?;
        let (offset, read) = (u64::from_le_bytes(*offset), u64::from_le_bytes(*read));
        if offset != self.expected || self.last_heard {
            return Err(Broken::Gap {
                expected: self.expected,
                found: offset,
            });
        }
        if read > self.sent {
            return Err(Broken::Acknowledged);
        }
        // What is said of reading goes with data in its order, so it never falls back.
        self.acknowledged = self.acknowledged.max(read);
        if self.arrived.len() + data.len() > usize::try_from(WINDOW).unwrap_or(usize::MAX) {
            return Err(Broken::Credit);
        }
        self.expected += data.len() as u64;
        if !self.deaf {
            self.arrived.extend_from_slice(data);
        }
        self.last_heard = flags & LAST != 0;
        Ok(())
    }

    /// Reads what is there, at most as much as fits.
    pub(super) fn read(&mut self, into: &mut [u8]) -> Read {
        let count = self.arrived.len().min(into.len());
        if count == 0 && (self.last_heard || self.broken.is_some()) {
            return Read::End;
        }
        if count == 0 {
            return Read::Nothing;
        }
        let read = self.arrived.split_to(count);
        if let Some(place) = into.get_mut(..count) {
            place.copy_from_slice(&read);
        }
        Read::Bytes(count)
    }

    /// Takes what there is space for; how much that was. `None` when nothing will be sent any more.
    pub(super) fn write(&mut self, bytes: &[u8]) -> Option<usize> {
        if self.broken.is_some() || self.closed {
            return None;
        }
        let space = UNSENT.saturating_sub(self.waiting.len());
        let taken = bytes.get(..space).unwrap_or(bytes);
        self.waiting.extend_from_slice(taken);
        Some(taken.len())
    }

    /// Nothing more will be written.
    pub(super) fn close(&mut self) {
        self.closed = true;
    }

    /// Nothing more will be read.
    pub(super) fn forget(&mut self) {
        self.deaf = true;
        self.arrived.clear();
    }

    /// The other end listens, or does not any more.
    pub(super) fn listened_to(&mut self, listens: bool) {
        if self.heard && !listens {
            self.fail(Broken::Gone);
        }
        self.heard |= listens;
    }

    /// Nothing more can come, or be sent.
    pub(super) fn fail(&mut self, broken: Broken) {
        self.broken.get_or_insert(broken);
    }

    /// The next chunk to send, if one may be.
    pub(super) fn next(&mut self) -> Option<Vec<u8>> {
        if !self.heard || self.broken.is_some() {
            return None;
        }
        let credit = WINDOW.saturating_sub(self.sent - self.acknowledged);
        let most = usize::try_from(credit).unwrap_or(usize::MAX).min(CHUNK);
        let count = self.waiting.len().min(most);
        let last = self.closed && !self.last_sent && count == self.waiting.len();
        let unread = self.read_up_to() - self.told;
        let telling = unread >= TELL || (self.last_heard && unread > 0);
        if count == 0 && !last && !telling {
            return None;
        }
        let mut chunk = Vec::with_capacity(HEAD + count);
        chunk.push(if last { LAST } else { 0 });
        chunk.extend_from_slice(&self.sent.to_le_bytes());
        chunk.extend_from_slice(&self.read_up_to().to_le_bytes());
        chunk.extend_from_slice(self.waiting.get(..count).unwrap_or_default());
        self.waiting.advance(count);
        self.sent += count as u64;
        self.told = self.read_up_to();
        self.last_sent |= last;
        Some(chunk)
    }

    /// Whether reading has changed what the other end should be told, or writing what it should get.
    pub(super) fn is_idle(&self) -> bool {
        let unread = self.read_up_to() - self.told;
        self.waiting.is_empty() && unread < TELL && !self.closed
    }

    /// Whether nothing more will be written.
    pub(super) fn is_closed(&self) -> bool {
        self.closed
    }

    /// Whether nothing is left to do: everything has been sent and read, or nothing can be.
    pub(super) fn is_over(&self) -> bool {
        let sent = self.last_sent && self.acknowledged == self.sent;
        let told = !self.last_heard || self.told == self.read_up_to();
        self.broken.is_some() || self.deaf && sent && told
    }

    pub(super) fn broken(&self) -> Option<&Broken> {
        self.broken.as_ref()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn connected() -> Pipe {
        let mut pipe = Pipe::default();
        pipe.listened_to(true);
        pipe
    }

    /// Carries at most `most` chunks from one end to the other.
    fn carry(from: &mut Pipe, to: &mut Pipe, most: usize) {
        for _ in 0..most {
            let Some(chunk) = from.next() else { break };
            to.arrive(&chunk);
        }
    }

    fn read_all(pipe: &mut Pipe, most: usize, into: &mut Vec<u8>) -> bool {
        let mut part = vec![0; most];
        match pipe.read(&mut part) {
            Read::Bytes(count) => {
                into.extend_from_slice(&part[..count]);
                false
            }
            Read::Nothing => false,
            Read::End => true,
        }
    }

    proptest! {
        #[test]
        fn bytes_arrive_whole_and_in_order_however_they_are_cut_and_read(
            there in prop::collection::vec(any::<u8>(), 0..3000),
            repeat in 1..600_usize,
            steps in prop::collection::vec((1..200_000_usize, 0..5_usize, 1..200_000_usize, 0..5_usize), 1..40),
        ) {
            let bytes = there.repeat(repeat);
            let (mut a, mut b) = (connected(), connected());
            let (mut written, mut got) = (0, Vec::new());
            let mut ended = false;
            for (write, carried, read, back) in steps.into_iter().chain(std::iter::repeat((200_000, 9, 200_000, 9))) {
                let end = bytes.len().min(written + write);
                written += a.write(&bytes[written..end]).unwrap_or(0);
                if written == bytes.len() {
                    a.close();
                    a.forget();
                }
                carry(&mut a, &mut b, carried);
                ended = read_all(&mut b, read, &mut got);
                carry(&mut b, &mut a, back);
                prop_assert!(a.sent - a.acknowledged <= WINDOW && a.waiting.len() <= UNSENT);
                prop_assert!(a.broken().is_none() && b.broken().is_none());
                if ended && a.is_over() {
                    break;
                }
            }
            prop_assert!(ended && got == bytes);
        }

        #[test]
        fn rubbish_breaks_the_stream_and_never_panics(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..20)) {
            let mut pipe = connected();
            for chunk in &chunks {
                pipe.arrive(chunk);
                let _ = pipe.next();
            }
            let mut into = [0; 64];
            while let Read::Bytes(_) = pipe.read(&mut into) {}
        }
    }

    #[test]
    fn what_is_lost_or_doubled_is_noticed_and_what_came_before_is_read() {
        for (skip, again) in [(1, 0), (0, 1)] {
            let (mut a, mut b) = (connected(), connected());
            a.write(b"one").unwrap();
            let first = a.next().unwrap();
            b.arrive(&first);
            a.write(b"two").unwrap();
            let second = a.next().unwrap();
            a.write(b"three").unwrap();
            let third = a.next().unwrap();
            for _ in 0..again {
                b.arrive(&first);
            }
            if skip == 0 {
                b.arrive(&second);
            }
            b.arrive(&third);
            let mut got = Vec::new();
            while !read_all(&mut b, 10, &mut got) {}
            assert_eq!(got, b"one");
            assert!(matches!(b.broken(), Some(Broken::Gap { .. })));
            assert_eq!(b.write(b"more"), None);
        }
    }

    #[test]
    fn a_reader_that_stands_still_stops_the_sender_and_not_more() {
        let (mut a, mut b) = (connected(), connected());
        let part = vec![7; CHUNK];
        let mut carried = 0;
        while a.write(&part).unwrap() > 0 {
            while let Some(chunk) = a.next() {
                carried += chunk.len() - HEAD;
                b.arrive(&chunk);
            }
        }
        assert_eq!(carried as u64, WINDOW);
        assert!(b.broken().is_none());
        // Half of it is read: so much more may come.
        let mut got = Vec::new();
        while (got.len() as u64) < WINDOW / 2 {
            read_all(&mut b, CHUNK, &mut got);
        }
        carry(&mut b, &mut a, 9);
        assert!(a.next().is_some());
    }

    #[test]
    fn who_sends_more_than_it_may_or_claims_what_was_never_sent_is_cut_off() {
        let mut pipe = connected();
        let chunk = |offset: u64, read: u64, data: &[u8]| {
            [&[0][..], &offset.to_le_bytes(), &read.to_le_bytes(), data].concat()
        };
        pipe.arrive(&chunk(0, 0, &vec![0; WINDOW as usize]));
        assert!(pipe.broken().is_none());
        pipe.arrive(&chunk(WINDOW, 0, b"!"));
        assert_eq!(pipe.broken(), Some(&Broken::Credit));
        let mut pipe = connected();
        pipe.arrive(&chunk(0, 1, b""));
        assert_eq!(pipe.broken(), Some(&Broken::Acknowledged));
    }

    #[test]
    fn nothing_is_sent_before_the_other_end_listens_and_all_ends_when_it_stops() {
        let mut pipe = Pipe::default();
        pipe.write(b"early").unwrap();
        pipe.listened_to(false);
        assert_eq!(pipe.next(), None);
        pipe.listened_to(true);
        assert!(pipe.next().is_some());
        pipe.listened_to(false);
        assert_eq!(pipe.broken(), Some(&Broken::Gone));
        assert!(pipe.is_over());
    }
}
