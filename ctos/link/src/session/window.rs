//! What a session keeps: packets until the other end has acknowledged them, and the number up to which
//! the other end's packets have come. Pure: knows no stream, no clock and no task.

use std::{collections::VecDeque, io, io::IoSlice};

use bytes::{Buf, BufMut, Bytes, BytesMut};

use super::packet::{Kind, PACKET_HEAD, PacketError, put_head};
use crate::{
    blob::Body,
    frame::{FRAME_FIXED, Frame, Full},
    injure::Injury,
    time::Instant,
};

/// Bodies up to this size, bytes, are copied behind their heads, so that many small packets leave
/// with one system call. Larger ones are written from where they are.
const COPIED: usize = 4 * 1024;

/// How many bytes are made ready for the stream at a time, at least.
const BATCH: usize = 64 * 1024;

/// Frames with more data than this, bytes, are cut, so that signs of life and messages of high priority
/// come between their pieces. On a line of 1 Gbit/s a piece takes 2 ms.
pub const PIECE: usize = 256 * 1024;

/// The same between processes of one host, where a piece takes a tenth of a ms, and to begin each one a tenth of that.
pub const PIECE_NEARBY: usize = 1024 * 1024;

/// How many slices one write takes.
const SLICES: usize = 32;

/// Which credits a packet takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lane {
    /// Requests of tasks.
    Data,
    /// Requests of high priority: they overtake those that have not left yet.
    Urgent,
    /// Answers, and everything of the runtime: never kept out by requests.
    Control,
}

impl Lane {
    const COUNT: usize = 3;
}

/// A packet that may have to be sent again.
struct Kept {
    kind: Kind,
    /// The fixed part of a frame.
    head: Option<[u8; FRAME_FIXED]>,
    /// What follows: shared where it is much.
    body: Body,
    lane: Lane,
    /// How much of its data has left in pieces on this stream.
    cut: usize,
    /// Not to be sent before (injured links only).
    ready: Instant,
}

impl Kept {
    /// The fixed part of a frame; nothing for others.
    fn head(&self) -> &[u8] {
        self.head.as_ref().map_or(&[], |head| head)
    }

    fn size(&self) -> usize {
        PACKET_HEAD + self.head().len() + self.body.len()
    }

    /// The next `size` bytes of shared data, of which `cut` have left before.
    fn next_data(&self, size: usize) -> impl Iterator<Item = Bytes> {
        let (mut skip, mut left) = (self.cut, size);
        self.body.parts().iter().filter_map(move |part| {
            let begin = skip.min(part.len());
            skip -= begin;
            let end = begin + left.min(part.len() - begin);
            left -= end - begin;
            (end > begin).then(|| part.slice(begin..end))
        })
    }
}

/// The sending half.
pub struct Outgoing {
    /// Those from `acked + 1` on.
    kept: VecDeque<Kept>,
    acked: u64,
    /// The next number that goes to the stream.
    next: u64,
    /// The last number that ever went to a stream: the other end may know its packet by it.
    known: u64,
    /// How large the data of a frame may be before it is cut.
    piece: usize,
    /// Bytes on their way into the stream.
    staged: VecDeque<Bytes>,
    /// Where small packets are made ready; the memory is used again when they have left. What is in it follows
    /// on what is staged.
    small: BytesMut,
    /// An unnumbered packet that goes before the next numbered one.
    pulse: Option<Kind>,
    /// How many bytes of each lane may be under way, and are.
    credits: usize,
    held: [usize; Lane::COUNT],
    injury: Option<Injury>,
}

impl Outgoing {
    /// With credits of so many bytes for each lane.
    pub fn new(credits: usize, injury: Option<Injury>) -> Self {
        Self {
            kept: VecDeque::new(),
            acked: 0,
            next: 1,
            known: 0,
            piece: PIECE,
            staged: VecDeque::new(),
            small: BytesMut::new(),
            pulse: None,
            credits,
            held: [0; Lane::COUNT],
            injury,
        }
    }

    /// From now on frames with more data than `piece` bytes are cut.
    pub fn cut_into(&mut self, piece: usize) {
        self.piece = piece;
    }

    /// Whether there are credits for `size` more bytes. A lane that is empty takes a packet of any size.
    pub fn admits(&self, lane: Lane, size: usize) -> Result<(), Full> {
        let bytes = self.held[lane as usize];
        if bytes > 0 && bytes.saturating_add(size) > self.credits {
            return Err(Full { bytes });
        }
        Ok(())
    }

    /// Takes a frame; the caller has asked whether there are credits.
    pub fn put_frame(&mut self, frame: Frame, lane: Lane, now: Instant) {
        let head = frame.head();
        self.put(Kind::Frame, Some(head), frame.body, lane, now);
    }

    /// Takes a message of the mesh, or the last packet of all.
    pub fn put_control(&mut self, kind: Kind, body: Vec<u8>, now: Instant) {
        self.put(kind, None, body.into(), Lane::Control, now);
    }

    fn put(
        &mut self,
        kind: Kind,
        head: Option<[u8; FRAME_FIXED]>,
        body: Body,
        lane: Lane,
        now: Instant,
    ) {
        let earliest = self.kept.back().map_or(Instant::START, |last| last.ready);
        let ready = match &mut self.injury {
            Some(injury) => injury.delayed(now).max(earliest),
            None => Instant::START,
        };
        let small = body.len() <= COPIED.min(self.piece);
        let kept = Kept {
            kind,
            head,
            body: if small { body } else { body.shared() },
            lane,
            cut: 0,
            ready,
        };
        self.held[lane as usize] += kept.size();
        // On an injured link everything keeps its place: what is late is late in its order.
        if lane == Lane::Urgent && self.injury.is_none() {
            let first =
                usize::try_from(self.known.saturating_sub(self.acked)).unwrap_or(usize::MAX);
            let mut later = self.kept.iter().skip(first);
            let overtaken = later.position(|kept| kept.lane != Lane::Urgent);
            let place = overtaken.map_or(self.kept.len(), |place| first + place);
            self.kept.insert(place, kept);
        } else {
            self.kept.push_back(kept);
        }
    }

    /// Asks for a packet without a number.
    pub fn pulse(&mut self, kind: Kind) {
        // What asks for more must not be replaced by what asks for less.
        if self.pulse.is_none_or(|now| now == Kind::Pulse) || kind == Kind::GivenUp {
            self.pulse = Some(kind);
        }
    }

    /// The last number that was given out.
    pub fn last(&self) -> u64 {
        self.acked + self.kept.len() as u64
    }

    /// Whether the other end has acknowledged everything.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// Whether the stream is cut on purpose at this moment.
    pub fn is_cut(&self, now: Instant) -> bool {
        let injury = self.injury.as_ref();
        injury.is_some_and(|injury| injury.is_cut(now))
    }

    /// Bytes under way.
    pub fn bytes(&self) -> usize {
        self.held.iter().sum()
    }

    /// The other end has received everything up to `received`.
    ///
    /// # Errors
    /// When that was never sent.
    pub fn acknowledge(&mut self, received: u64) -> Result<(), PacketError> {
        if received > self.last() {
            let sent = self.last();
            return Err(PacketError::Acknowledges { received, sent });
        }
        while self.acked < received {
            let Some(kept) = self.kept.pop_front() else {
                break;
            };
            self.held[kept.lane as usize] -= kept.size();
            self.acked += 1;
        }
        // What was acknowledged on an earlier stream need not be written on this one.
        self.next = self.next.max(self.acked + 1);
        Ok(())
    }

    /// Begins again after the last acknowledged packet.
    pub fn again(&mut self) {
        self.next = self.acked + 1;
        self.kept.iter_mut().for_each(|kept| kept.cut = 0);
    }

    /// A new stream whose other end has received everything up to `received`.
    ///
    /// # Errors
    /// As [`Self::acknowledge`].
    pub fn restart(&mut self, received: u64) -> Result<(), PacketError> {
        self.acknowledge(received)?;
        self.staged.clear();
        self.small.clear();
        self.pulse = None;
        self.again();
        if let Some(injury) = &mut self.injury {
            injury.restarted();
        }
        Ok(())
    }

    /// Writes until everything is written or `write` takes no more. `received` is what this end tells
    /// the other one that it has.
    ///
    /// # Errors
    /// What `write` says, other than that it would block.
    pub fn pump(
        &mut self,
        received: u64,
        now: Instant,
        mut write: impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>,
    ) -> io::Result<()> {
        loop {
            if !self.is_staged() {
                self.stage(received, now);
            }
            if !self.is_staged() {
                return Ok(());
            }
            let most = match &self.injury {
                Some(injury) => injury.bytes_left()?,
                None => usize::MAX,
            };
            let small = self.small.get(..most).unwrap_or(&self.small);
            let mut slices = [IoSlice::new(&[]); SLICES];
            let mut count = 0;
            let staged = self.staged.iter().map(|bytes| &bytes[..]);
            let staged = staged.chain((!small.is_empty()).then_some(small));
            for (slice, bytes) in slices.iter_mut().zip(staged) {
                *slice = IoSlice::new(bytes.get(..most).unwrap_or(bytes));
                count += 1;
                if most != usize::MAX {
                    break;
                }
            }
            let (filled, _) = slices.split_at(count);
            let written = write(filled);
            match written {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => self.written(written),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Whether anything is ready to be written.
    fn is_staged(&self) -> bool {
        !self.staged.is_empty() || !self.small.is_empty()
    }

    fn written(&mut self, mut count: usize) {
        if let Some(injury) = &mut self.injury {
            injury.wrote(count);
        }
        while count > 0 {
            let Some(first) = self.staged.front_mut() else {
                if self.small.len() > count {
                    self.small.advance(count);
                } else {
                    self.small.clear();
                }
                return;
            };
            if first.len() > count {
                first.advance(count);
                return;
            }
            count -= first.len();
            self.staged.pop_front();
        }
    }

    /// Makes the next packets ready to be written, when nothing is.
    fn stage(&mut self, received: u64, now: Instant) {
        let mut size = 0;
        while size < BATCH {
            let Some(index) = usize::try_from(self.next - self.acked - 1).ok() else {
                return;
            };
            // A pulse tells what was sent before it, so it goes in between where it was asked for.
            if let Some(kind) = self.pulse.take() {
                if !self.injury.as_mut().is_some_and(Injury::loses) {
                    put_head(&mut self.small, kind, [self.next - 1, received], 0);
                    size += PACKET_HEAD;
                }
                continue;
            }
            let Some(kept) = self.kept.get_mut(index).filter(|kept| kept.ready <= now) else {
                return;
            };
            let is_cut = self.injury.is_none()
                && kept.kind == Kind::Frame
                && kept.lane != Lane::Urgent
                && kept.body.start().is_empty();
            let left = kept.body.len() - kept.cut;
            let data = if is_cut { left.min(self.piece) } else { left };
            size += PACKET_HEAD + data;
            let is_last = data == left;
            if is_last {
                let number = self.next;
                self.next += 1;
                self.known = self.known.max(number);
                if self.injury.as_mut().is_some_and(Injury::loses) {
                    continue;
                }
                let rest = kept.head().len() + data;
                put_head(&mut self.small, kept.kind, [number, received], rest);
                self.small.put_slice(kept.head());
                self.small.put_slice(kept.body.start());
            } else {
                let numbers = [kept.cut as u64, received];
                put_head(&mut self.small, Kind::Piece, numbers, data);
            }
            for part in kept.next_data(data) {
                if part.len() <= COPIED {
                    self.small.put_slice(&part);
                } else {
                    if !self.small.is_empty() {
                        self.staged.push_back(self.small.split().freeze());
                    }
                    self.staged.push_back(part);
                }
            }
            kept.cut = if is_last { 0 } else { kept.cut + data };
        }
    }
}

/// What a numbered packet is to the receiving half.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// The one that was awaited.
    Next,
    /// One that has come before.
    Old,
    /// One after another that is missing.
    Early,
}

/// The receiving half.
#[derive(Debug, Default)]
pub struct Incoming {
    received: u64,
    /// Bytes that came since the last acknowledgement left.
    unacknowledged: usize,
    /// After which number the missing ones have been asked for.
    asked: Option<u64>,
}

impl Incoming {
    /// The number up to which everything has come.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Takes a numbered packet of `size` bytes.
    pub fn take(&mut self, number: u64, size: usize) -> Arrival {
        if number <= self.received {
            return Arrival::Old;
        }
        if number > self.received + 1 {
            return Arrival::Early;
        }
        self.received = number;
        self.unacknowledged += PACKET_HEAD + FRAME_FIXED + size;
        self.asked = None;
        Arrival::Next
    }

    /// Whether the missing packets must be asked for now: once for each gap.
    pub fn must_ask(&mut self) -> bool {
        if self.asked == Some(self.received) {
            return false;
        }
        self.asked = Some(self.received);
        true
    }

    /// Whether so much has come that the other end must be told.
    pub fn must_acknowledge(&mut self, most: usize) -> bool {
        let must = self.unacknowledged >= most;
        if must {
            self.unacknowledged = 0;
        }
        must
    }
}

#[cfg(test)]
mod tests;
