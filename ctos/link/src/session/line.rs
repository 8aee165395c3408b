//! The line of requests that wait for credits of a link, as senders wait for a credit of a mailbox. They wait
//! here, in their order, until there are some or they give up. Pure: knows no stream and no clock.

use std::{collections::VecDeque, time::Duration};

use super::window::{Lane, Outgoing};
use crate::{
    frame::{Frame, Full, NO_DEADLINE},
    message::{FENCE, Flags},
    time::Instant,
};

/// How many requests may wait.
const MOST: usize = 1024;

/// Requests for which there are no credits yet.
pub(super) struct Line {
    waiting: VecDeque<(Frame, Instant)>,
    bytes: usize,
    /// How many bytes may wait.
    credits: usize,
}

impl Line {
    pub(super) fn new(credits: usize) -> Self {
        Self {
            waiting: VecDeque::new(),
            bytes: 0,
            credits,
        }
    }

    /// Sends a request, or lets it wait for credits. Nothing overtakes those that wait, but one of high priority
    /// overtakes those of normal priority.
    ///
    /// # Errors
    /// [`Full`] when too many wait already; a [`FENCE`] is always taken.
    pub(super) fn send(
        &mut self,
        frame: Frame,
        outgoing: &mut Outgoing,
        now: Instant,
    ) -> Result<(), Full> {
        let lane = lane_of_request(&frame);
        let waits = |(other, _): &(Frame, Instant)| {
            lane == Lane::Data || lane_of_request(other) == Lane::Urgent
        };
        match outgoing.admits(lane, frame.body.len()) {
            Ok(()) if !self.waiting.iter().any(waits) => {
                outgoing.put_frame(frame, lane, now);
                Ok(())
            }
            Ok(()) => self.join(frame, now, outgoing.bytes()),
            Err(Full { bytes }) => self.join(frame, now, bytes),
        }
    }

    fn join(&mut self, frame: Frame, now: Instant, bytes: usize) -> Result<(), Full> {
        let size = frame.body.len();
        let too_much = self.bytes > 0 && self.bytes.saturating_add(size) > self.credits;
        if (self.waiting.len() >= MOST || too_much) && !is_fence(&frame) {
            return Err(Full { bytes });
        }
        self.bytes += size;
        self.waiting.push_back((frame, now));
        Ok(())
    }

    /// Takes out a request whose sender has given up; whether it still waited.
    pub(super) fn withdraw(&mut self, call: u64) -> bool {
        let place = self
            .waiting
            .iter()
            .position(|(frame, _)| frame.call == call);
        let taken = place.and_then(|place| self.waiting.remove(place));
        if let Some((frame, _)) = &taken {
            self.bytes -= frame.body.len();
        }
        taken.is_some()
    }

    /// Sends those for which there are credits now; whether there were any. The time that they waited is no
    /// longer theirs.
    pub(super) fn advance(&mut self, outgoing: &mut Outgoing, now: Instant) -> bool {
        let mut any = false;
        while let Some((frame, _)) = self.waiting.front() {
            let lane = lane_of_request(frame);
            if outgoing.admits(lane, frame.body.len()).is_err() {
                return any;
            }
            let Some((mut frame, since)) = self.waiting.pop_front() else {
                return any;
            };
            self.bytes -= frame.body.len();
            if frame.left_ns != NO_DEADLINE {
                let left = Duration::from_nanos(frame.left_ns).saturating_sub(now.since(since));
                frame.left_ns = u64::try_from(left.as_nanos()).unwrap_or(NO_DEADLINE - 1);
            }
            outgoing.put_frame(frame, lane, now);
            any = true;
        }
        any
    }
}

pub(super) fn lane_of_request(frame: &Frame) -> Lane {
    if frame.header.flags.contains(Flags::HIGH_PRIORITY) && !is_fence(frame) {
        Lane::Urgent
    } else {
        Lane::Data
    }
}

/// Whether this follows requests to where a task was: it must not overtake them.
pub(super) fn is_fence(frame: &Frame) -> bool {
    frame.header.command == FENCE
}

/// Whether this says that a sender has given up.
pub(super) fn gives_up(frame: &Frame) -> bool {
    frame.header.flags.contains(Flags::ABANDONED)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{super::tests::sample, *};

    fn request(call: u64, size: usize) -> Frame {
        let mut frame = sample::request(vec![0; size]);
        frame.call = call;
        frame
    }

    #[test]
    fn the_time_in_the_line_is_taken_off_the_time_left() {
        let (mut outgoing, mut line) = (Outgoing::new(100, None), Line::new(1000));
        let mut late = request(2, 90);
        late.left_ns = 1000;
        line.send(request(1, 90), &mut outgoing, Instant::START)
            .unwrap();
        line.send(late, &mut outgoing, Instant::START).unwrap();
        let written = |outgoing: &mut Outgoing| {
            let mut bytes = Vec::new();
            let taken = outgoing.pump(0, Instant::START, |slices| {
                let count = slices.iter().map(|slice| slice.len()).sum();
                slices
                    .iter()
                    .for_each(|slice| bytes.extend_from_slice(slice));
                Ok(count)
            });
            taken.unwrap();
            bytes
        };
        written(&mut outgoing);
        outgoing.acknowledge(1).unwrap();
        line.advance(&mut outgoing, Instant::from_nanos(400));
        let bytes = written(&mut outgoing);
        let left =
            &bytes[super::super::packet::PACKET_HEAD + crate::message::Header::BYTES + 16..][..8];
        assert_eq!(left, 600_u64.to_le_bytes());
    }

    proptest! {
        #[test]
        fn requests_leave_in_their_order_and_those_given_up_never(
            sizes in proptest::collection::vec(0..400_usize, 1..60),
            given_up in proptest::collection::vec(any::<bool>(), 60),
        ) {
            let (mut outgoing, mut line) = (Outgoing::new(1000, None), Line::new(1_000_000));
            for (call, size) in (1..).zip(&sizes) {
                line.send(request(call, *size), &mut outgoing, Instant::START).unwrap();
            }
            let sent_at_once = outgoing.last();
            let calls = (1..=sizes.len() as u64).zip(given_up);
            let withdrawn = calls.filter(|(call, given_up)| *given_up && line.withdraw(*call)).count();
            let mut rounds = 0;
            while !line.waiting.is_empty() {
                let last = outgoing.last();
                outgoing.pump(0, Instant::START, |slices| Ok(slices.iter().map(|slice| slice.len()).sum())).unwrap();
                outgoing.acknowledge(last).unwrap();
                line.advance(&mut outgoing, Instant::START);
                rounds += 1;
                prop_assert!(rounds <= sizes.len());
            }
            prop_assert!(sent_at_once >= 1);
            prop_assert_eq!(outgoing.last() as usize, sizes.len() - withdrawn);
            prop_assert_eq!(line.bytes, 0);
        }
    }

    #[test]
    fn a_fence_goes_behind_the_requests_that_wait_however_many_they_are() {
        let (mut outgoing, mut line) = (Outgoing::new(100, None), Line::new(1000));
        let mut send =
            |line: &mut Line, frame: Frame| line.send(frame, &mut outgoing, Instant::START);
        while send(&mut line, request(1, 90)).is_ok() {}
        let mut fence = request(2, 1);
        fence.header.command = FENCE;
        fence.header.flags = Flags::HIGH_PRIORITY;
        send(&mut line, fence).unwrap();
        assert_eq!(line.waiting.back().map(|(frame, _)| frame.call), Some(2));
        let waiting = line.waiting.len();
        assert!(waiting > 10);
        let mut rounds = 0;
        while !line.waiting.is_empty() {
            assert_eq!(line.waiting.back().map(|(frame, _)| frame.call), Some(2));
            let last = outgoing.last();
            let all =
                |slices: &[std::io::IoSlice<'_>]| Ok(slices.iter().map(|slice| slice.len()).sum());
            outgoing.pump(0, Instant::START, all).unwrap();
            outgoing.acknowledge(last).unwrap();
            line.advance(&mut outgoing, Instant::START);
            rounds += 1;
        }
        assert_eq!(rounds, waiting, "each of them has all the room");
    }

    #[test]
    fn the_line_is_bounded() {
        let (mut outgoing, mut line) = (Outgoing::new(100, None), Line::new(10_000));
        let sent = (0..).take_while(|call| {
            line.send(request(*call, 90), &mut outgoing, Instant::START)
                .is_ok()
        });
        assert_eq!(sent.count(), 1 + 10_000 / 90);
    }
}
