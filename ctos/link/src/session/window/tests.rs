//! Two ends joined by streams that lose, break and are had anew, as pure state machines through memory.

use std::io::IoSlice;

use proptest::prelude::*;

use super::{
    super::{packet::*, tests::sample},
    *,
};
use crate::config::InjuryConfig;

const MANY: usize = 1 << 30;

/// What happens between the two ends, one step at a time.
#[derive(Debug, Clone)]
enum Step {
    /// One end posts a frame of this size.
    Post(usize, usize),
    /// The stream takes so many bytes from one end.
    Write(usize, usize),
    /// So many bytes arrive at one end.
    Read(usize, usize),
    /// The stream breaks; whatever is under way in it is lost.
    Break,
    /// One end gives a sign of life.
    Pulse(usize),
}

fn step() -> impl Strategy<Value = Step> {
    let end = 0..2_usize;
    prop_oneof![
        4 => (end.clone(), prop_oneof![0..50_usize, 5_000..20_000_usize])
            .prop_map(|(end, size)| Step::Post(end, size)),
        6 => (end.clone(), 1..30_000_usize).prop_map(|(end, most)| Step::Write(end, most)),
        6 => (end.clone(), 1..30_000_usize).prop_map(|(end, most)| Step::Read(end, most)),
        1 => Just(Step::Break),
        1 => end.prop_map(Step::Pulse),
    ]
}

/// One end, without a session around it.
struct End {
    outgoing: Outgoing,
    incoming: Incoming,
    decoder: Decoder,
    /// On their way to the other end.
    wire: VecDeque<u8>,
    posted: u64,
    /// The numbers of the frames that were handed over.
    heard: Vec<u64>,
}

impl End {
    fn new(injury: Option<Injury>) -> Self {
        Self {
            outgoing: Outgoing::new(MANY, injury),
            incoming: Incoming::default(),
            decoder: Decoder::default(),
            wire: VecDeque::new(),
            posted: 0,
            heard: Vec::new(),
        }
    }

    fn post(&mut self, size: usize) {
        self.posted += 1;
        let mut frame = sample::request(vec![self.posted as u8; size]);
        frame.call = self.posted;
        self.outgoing.put_frame(frame, Lane::Data, Instant::START);
    }

    /// False when the stream breaks.
    fn write(&mut self, most: usize) -> bool {
        let mut room = most;
        let wire = &mut self.wire;
        let write = |slices: &[IoSlice<'_>]| {
            let mut taken = 0;
            for slice in slices {
                let now = slice.len().min(room);
                wire.extend(&slice[..now]);
                room -= now;
                taken += now;
            }
            if taken == 0 {
                Err(io::ErrorKind::WouldBlock.into())
            } else {
                Ok(taken)
            }
        };
        let received = self.incoming.received();
        self.outgoing.pump(received, Instant::START, write).is_ok()
    }

    fn read(&mut self, bytes: &[u8]) {
        let mut bytes = bytes;
        while let Some(packet) = self.decoder.feed(&mut bytes).unwrap() {
            self.take(packet);
        }
    }

    fn take(&mut self, packet: Packet) {
        self.outgoing.acknowledge(packet.received).unwrap();
        if packet.kind == Kind::Again {
            self.outgoing.again();
        }
        if !packet.kind.is_numbered() {
            if packet.number > self.incoming.received() {
                self.outgoing.pulse(Kind::Again);
            }
            return;
        }
        match self.incoming.take(packet.number, packet.content.size()) {
            Arrival::Next => {
                let Content::Frame(frame) = packet.content else {
                    panic!("no frame")
                };
                let body = frame.body.into_vec();
                assert!(body.iter().all(|byte| *byte == frame.call as u8));
                self.heard.push(frame.call);
            }
            Arrival::Early if self.incoming.must_ask() => self.outgoing.pulse(Kind::Again),
            Arrival::Early | Arrival::Old => {}
        }
    }
}

struct Pair {
    ends: [End; 2],
}

impl Pair {
    fn both(&mut self, index: usize) -> (&mut End, &mut End) {
        let [one, other] = &mut self.ends;
        if index == 0 {
            (one, other)
        } else {
            (other, one)
        }
    }

    fn break_stream(&mut self) {
        let received = self.ends.each_ref().map(|end| end.incoming.received());
        for (end, received) in self.ends.iter_mut().zip([received[1], received[0]]) {
            end.wire.clear();
            end.decoder = Decoder::default();
            end.outgoing.restart(received).unwrap();
        }
    }

    fn make(&mut self, step: &Step) {
        match *step {
            Step::Post(index, size) => self.ends[index].post(size),
            Step::Write(index, most) => {
                if !self.ends[index].write(most) {
                    self.break_stream();
                }
            }
            Step::Read(index, most) => {
                let (reader, writer) = self.both(index);
                let count = most.min(writer.wire.len());
                let bytes: Vec<u8> = writer.wire.drain(..count).collect();
                reader.read(&bytes);
            }
            Step::Break => self.break_stream(),
            Step::Pulse(index) => self.ends[index].outgoing.pulse(Kind::Pulse),
        }
        for index in 0..2 {
            // At every moment what was heard is the beginning of what was posted.
            let (hearer, poster) = self.both(index);
            let heard = hearer.heard.len() as u64;
            assert!(heard <= poster.posted);
            assert_eq!(hearer.heard.last().copied().unwrap_or(0), heard);
        }
    }

    /// Lets everything arrive.
    fn settle(&mut self) {
        for _ in 0..2_000 {
            for index in 0..2 {
                self.make(&Step::Pulse(index));
                self.make(&Step::Write(index, MANY));
                self.make(&Step::Read(1 - index, MANY));
            }
            if self.ends.iter().all(|end| end.outgoing.is_empty()) {
                return;
            }
        }
        panic!("it does not settle");
    }
}

fn injury(drop: f64, break_bytes: usize, seed: u64, from: &str) -> Option<Injury> {
    let config = InjuryConfig {
        drop,
        break_bytes,
        ..InjuryConfig::default()
    };
    Injury::of(&config, seed, from, "peer")
}

fn play(steps: &[Step], drop: f64, break_bytes: usize, seed: u64) {
    let end = |name| End::new(injury(drop, break_bytes, seed, name));
    let mut pair = Pair {
        ends: [end("a"), end("b")],
    };
    for step in steps {
        pair.make(step);
    }
    pair.settle();
    for index in 0..2 {
        let (hearer, poster) = pair.both(index);
        assert_eq!(hearer.heard, (1..=poster.posted).collect::<Vec<_>>());
        assert_eq!(poster.outgoing.bytes(), 0);
    }
}

proptest! {
    #[test]
    fn streams_that_break_at_any_byte_lose_double_and_reorder_nothing(
        steps in proptest::collection::vec(step(), 0..200),
    ) {
        play(&steps, 0.0, 0, 0);
    }

    #[test]
    fn packets_that_are_lost_and_streams_that_are_injured_are_repaired(
        steps in proptest::collection::vec(step(), 0..100), drop in 0.0..0.5, seed: u64,
        break_bytes in prop_oneof![Just(0_usize), 1_000..20_000_usize],
    ) {
        play(&steps, drop, break_bytes, seed);
    }

    #[test]
    fn what_a_peer_may_not_acknowledge_is_an_error(posted in 0..10_u64, received in 11..u64::MAX) {
        let mut end = End::new(None);
        for _ in 0..posted {
            end.post(1);
        }
        prop_assert!(end.outgoing.acknowledge(received).is_err());
        prop_assert!(end.outgoing.acknowledge(posted).is_ok());
    }
}

/// Posts frames of both priorities at one end, and lets the stream take bytes and break. Returns the numbers
/// of the frames that the other end heard, in order.
fn play_lanes(frames: &[(usize, bool)], writes: &[usize], breaks: &[bool]) -> Vec<u64> {
    let mut pair = Pair {
        ends: [End::new(None), End::new(None)],
    };
    pair.ends[0].outgoing.cut_into(3_000);
    let mut heard = Vec::new();
    let mut writes = writes.iter().cycle();
    let mut breaks = breaks.iter().cycle();
    let mut frames = (1..).zip(frames);
    loop {
        let next = frames.next();
        let is_over = next.is_none() && pair.ends[0].outgoing.is_empty();
        if let Some((call, (size, urgent))) = next {
            let mut frame = sample::request(vec![call as u8; *size]);
            frame.call = call;
            let lane = if *urgent { Lane::Urgent } else { Lane::Data };
            pair.ends[0].outgoing.put_frame(frame, lane, Instant::START);
        } else {
            // Whatever is missing is asked for, and everything acknowledged.
            pair.make(&Step::Pulse(0));
            pair.make(&Step::Pulse(1));
            pair.make(&Step::Write(1, MANY));
            let back: Vec<u8> = pair.ends[1].wire.drain(..).collect();
            pair.ends[0].read(&back);
        }
        let most = writes.next().copied().unwrap_or(MANY);
        pair.ends[0].write(most.max(if next.is_none() { 50_000 } else { 1 }));
        let bytes: Vec<u8> = pair.ends[0].wire.drain(..).collect();
        pair.ends[1].read(&bytes);
        heard.append(&mut pair.ends[1].heard);
        if is_over {
            return heard;
        }
        if next.is_some() && breaks.next() == Some(&true) {
            pair.break_stream();
        }
    }
}

proptest! {
    #[test]
    fn each_priority_keeps_its_order_and_nothing_is_lost_or_doubled(
        frames in proptest::collection::vec((0..20_000_usize, any::<bool>()), 1..40),
        writes in proptest::collection::vec(1..30_000_usize, 1..20),
        breaks in proptest::collection::vec(proptest::bool::weighted(0.1), 1..40),
    ) {
        let heard = play_lanes(&frames, &writes, &breaks);
        for urgent in [false, true] {
            let of = |calls: &mut dyn Iterator<Item = u64>| -> Vec<u64> {
                calls.filter(|call| frames[*call as usize - 1].1 == urgent).collect()
            };
            let sent = of(&mut (1..=frames.len() as u64));
            prop_assert_eq!(of(&mut heard.iter().copied()), sent);
        }
    }
}

#[test]
fn an_urgent_frame_and_a_sign_of_life_come_between_the_pieces_of_a_large_one() {
    let mut end = End::new(None);
    end.outgoing.cut_into(100_000);
    let frame = |call: u64, size: usize| {
        let mut frame = sample::request(vec![call as u8; size]);
        frame.call = call;
        frame
    };
    let large = frame(1, 1_000_000);
    end.outgoing.put_frame(large, Lane::Data, Instant::START);
    end.write(25_000);
    end.outgoing
        .put_frame(frame(2, 10), Lane::Urgent, Instant::START);
    end.outgoing.pulse(Kind::Pulse);
    end.write(150_000);
    let mut other = End::new(None);
    let bytes: Vec<u8> = end.wire.drain(..).collect();
    other.read(&bytes);
    assert_eq!(other.heard, [2]);
    assert!(bytes.len() < 200_000);
    end.write(MANY);
    let bytes: Vec<u8> = end.wire.drain(..).collect();
    other.read(&bytes);
    assert_eq!(other.heard, [2, 1]);
}

#[test]
fn a_piece_that_does_not_follow_the_one_before_is_rubbish() {
    let piece = |at: u64| {
        let mut bytes = bytes::BytesMut::new();
        put_head(&mut bytes, Kind::Piece, [at, 0], 3);
        bytes.extend_from_slice(&[1, 2, 3]);
        bytes
    };
    let mut decoder = Decoder::default();
    assert_eq!(decoder.feed(&mut &piece(0)[..]), Ok(None));
    assert_eq!(decoder.feed(&mut &piece(3)[..]), Ok(None));
    assert_eq!(decoder.feed(&mut &piece(0)[..]), Ok(None));
    let wrong = decoder.feed(&mut &piece(4)[..]);
    assert_eq!(wrong, Err(PacketError::Piece { at: 4, come: 3 }));
}

#[test]
fn a_large_body_is_written_from_where_it_is() {
    let mut end = End::new(None);
    let body = vec![9; 100_000];
    let place = body.as_ptr();
    end.outgoing
        .put_frame(sample::request(body), Lane::Data, Instant::START);
    let mut seen = false;
    let write = |slices: &[IoSlice<'_>]| {
        seen |= slices
            .iter()
            .any(|slice| slice.as_ptr() == place && slice.len() == 100_000);
        Ok(slices.iter().map(|slice| slice.len()).sum())
    };
    end.outgoing.pump(0, Instant::START, write).unwrap();
    assert!(seen);
}
