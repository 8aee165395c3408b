//! Sessions whose peer is silent, frozen, gone or a liar, in memory and in virtual time. Also two sessions
//! joined by streams that lose, break and are cut.

use std::collections::VecDeque;

use bytes::BytesMut;
use proptest::prelude::*;

use super::{
    super::{
        packet::{PACKET_HEAD, put_head},
        tests::sample,
    },
    *,
};
use crate::{config::InjuryConfig, frame::FRAME_FIXED, message::FENCE};

const TIMEOUT: Duration = Duration::from_secs(2);
const MOST: usize = 1 << 20;
const PIECE: usize = 1 << 20;

/// One end, with what it told its receiver.
struct End {
    core: Core,
    now: Instant,
    frames: Vec<u64>,
    downs: Vec<DownReason>,
}

impl End {
    fn new() -> Self {
        Self::with(None)
    }

    fn with(injury: Option<Injury>) -> Self {
        let limits = Limits {
            timeout: TIMEOUT,
            unacknowledged: MOST,
        };
        Self {
            core: Core::new(limits, injury, Instant::START),
            now: Instant::START,
            frames: Vec::new(),
            downs: Vec::new(),
        }
    }

    /// One with a stream, and its number.
    fn attached() -> (Self, u64) {
        let mut end = Self::new();
        let stream = end.attach().unwrap();
        (end, stream)
    }

    fn attach(&mut self) -> Result<u64, AttachError> {
        let attached = self.core.attach(0, PIECE, self.now)?;
        Ok(attached)
    }

    fn changed(&mut self, changed: bool) {
        if changed {
            self.downs.extend(self.core.take_reason());
        }
    }

    fn event(&mut self, event: Event, reason: DownReason) {
        let changed = self.core.event(event, reason);
        self.changed(changed);
    }

    fn lost(&mut self, stream: u64) {
        let changed = self.core.lost(stream);
        self.changed(changed);
    }

    fn close(&mut self) {
        let changed = self.core.close(self.now);
        self.changed(changed);
    }

    fn keep_after(&mut self, pause: Duration) {
        self.now = self.now + pause;
        let changed = self.core.keep(self.now);
        self.changed(changed);
    }

    fn post(&mut self, frame: Frame) -> Result<(), Full> {
        self.core.post(frame, self.now)
    }

    /// Bytes come over a stream; whether more may.
    fn read(&mut self, stream: u64, mut bytes: &[u8]) -> bool {
        loop {
            let heard = self.core.read(stream, &mut bytes, self.now);
            if let Content::Frame(frame) = &heard.content {
                self.frames.push(frame.call);
            }
            self.changed(heard.changed);
            if bytes.is_empty() || !heard.goes_on {
                return heard.goes_on;
            }
        }
    }

    /// What it writes, at most `most` bytes; `None` when its stream breaks.
    fn write(&mut self, most: usize) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        let pumped = self.core.pump(self.now, |slices| {
            let before = bytes.len();
            for slice in slices {
                let left = most - bytes.len();
                bytes.extend_from_slice(&slice[..slice.len().min(left)]);
            }
            match bytes.len() - before {
                0 => Err(io::ErrorKind::WouldBlock.into()),
                taken => Ok(taken),
            }
        });
        pumped.ok().map(|_| bytes)
    }
}

/// Lets two ends exchange what they have to write, until both are silent.
fn exchange((one, to_one): (&mut End, u64), (other, to_other): (&mut End, u64)) {
    loop {
        let there = one.write(PIECE).unwrap();
        let back = other.write(PIECE).unwrap();
        if there.is_empty() && back.is_empty() {
            return;
        }
        other.read(to_other, &there);
        one.read(to_one, &back);
    }
}

#[test]
fn a_fence_that_is_posted_comes_after_all_requests_that_were_posted_before_it() {
    let ((mut one, to_one), (mut other, to_other)) = (End::attached(), End::attached());
    let mut posted = Vec::new();
    // Most of them wait for credits of the link when the fence comes.
    for call in 1.. {
        let mut request = sample::request(vec![0; MOST / 8]);
        request.call = call;
        if one.post(request).is_err() {
            break;
        }
        posted.push(call);
    }
    let mut fence = sample::request(vec![0]);
    fence.call = u64::MAX;
    fence.header.command = FENCE;
    fence.header.flags = Flags::HIGH_PRIORITY;
    one.post(fence).unwrap();
    posted.push(u64::MAX);
    assert!(posted.len() > 10, "{posted:?}");
    exchange((&mut one, to_one), (&mut other, to_other));
    assert_eq!(other.frames, posted);
}

fn packet(kind: Kind, number: u64, received: u64, rest: &[u8]) -> Vec<u8> {
    let mut bytes = BytesMut::new();
    put_head(&mut bytes, kind, [number, received], rest.len());
    bytes.extend_from_slice(rest);
    bytes.to_vec()
}

fn frame(number: u64) -> Vec<u8> {
    frame_after(number, 0)
}

fn frame_after(number: u64, received: u64) -> Vec<u8> {
    let mut frame = sample::request(vec![1]);
    frame.call = number;
    packet(Kind::Frame, number, received, &sample::bytes_of(&frame))
}

fn pulse() -> Vec<u8> {
    packet(Kind::Pulse, 0, 0, &[])
}

#[test]
fn a_peer_that_is_silent_is_down_after_the_limit_and_told_once() {
    let (mut end, stream) = End::attached();
    let pause = end.core.pulse_every();
    for _ in 0..3 {
        end.keep_after(pause);
    }
    assert_eq!(end.core.state(), State::Up);
    assert!(end.read(stream, &pulse()));
    for _ in 0..3 {
        end.keep_after(pause);
    }
    assert_eq!(end.core.state(), State::Up);
    for _ in 0..3 {
        end.keep_after(pause);
    }
    assert_eq!(end.core.state(), State::Down);
    assert_eq!(end.downs, [DownReason::Silence(TIMEOUT)]);
    assert!(!end.read(stream, &frame(1)));
    assert!(end.attach().is_err());
}

#[test]
fn every_part_of_a_large_frame_is_a_sign_of_life() {
    let (mut end, stream) = End::attached();
    let bytes = packet(
        Kind::Frame,
        1,
        0,
        &sample::bytes_of(&sample::request(vec![0; 100_000])),
    );
    let pause = end.core.pulse_every();
    for part in bytes.chunks(10_000) {
        assert!(end.read(stream, part));
        for _ in 0..3 {
            end.keep_after(pause);
        }
    }
    assert_eq!((end.core.state(), end.frames.len()), (State::Up, 1));
}

#[test]
fn a_chassis_that_stood_still_itself_does_not_blame_its_peers() {
    let (mut end, stream) = End::attached();
    end.keep_after(Duration::ZERO);
    end.keep_after(10 * TIMEOUT);
    assert_eq!(end.core.state(), State::Up);
    // What the peer said meanwhile is read now.
    assert!(end.read(stream, &frame(1)));
    assert_eq!(end.frames, [1]);
}

#[test]
fn memory_under_way_to_a_frozen_peer_is_bounded_and_answers_still_pass() {
    let (mut end, _) = End::attached();
    let mut posted = 0;
    let full = loop {
        match end.post(sample::request(vec![0; 10_000])) {
            Ok(()) => posted += 10_000,
            Err(full) => break full,
        }
    };
    assert!(
        full.bytes <= MOST && posted > MOST - 20_000,
        "{full:?}, {posted} bytes posted"
    );
    let mut reply = sample::request(vec![0; 10_000]);
    reply.header.flags = Flags::REPLY;
    for _ in 0..1_000 {
        end.post(reply.clone()).unwrap();
    }
    // Large answers have become small faults.
    let held = end.core.counts().bytes_under_way;
    assert!(held < 3 * MOST as u64, "{held} bytes");
    let mut system = sample::request(Vec::new());
    system.header.command = SYSTEM_COMMANDS;
    end.post(system).unwrap();
}

#[test]
fn a_frame_larger_than_the_room_passes_when_nothing_else_is_under_way() {
    let (mut end, _) = End::attached();
    end.post(sample::request(vec![0; 2 * MOST])).unwrap();
    let held = end.core.counts().bytes_under_way;
    end.post(sample::request(vec![0; 10])).unwrap();
    assert_eq!(end.core.counts().bytes_under_way, held);
}

#[test]
fn a_request_that_waits_for_room_leaves_when_there_is_some_unless_its_sender_gave_up() {
    let (mut end, stream) = End::attached();
    end.post(sample::request(vec![0; MOST])).unwrap();
    for call in [7, 8] {
        let mut waits = sample::request(vec![0; 100]);
        waits.call = call;
        end.post(waits).unwrap();
    }
    let mut gives_up = sample::request(Vec::new());
    gives_up.call = 7;
    gives_up.header.flags = Flags::ABANDONED;
    end.post(gives_up).unwrap();
    assert!(end.read(stream, &packet(Kind::Pulse, 0, 1, &[])));
    let one = (PACKET_HEAD + FRAME_FIXED + 100) as u64;
    assert_eq!(end.core.counts().bytes_under_way, one);
}

#[test]
fn what_an_earlier_stream_still_brings_is_not_listened_to() {
    let (mut end, first) = End::attached();
    assert!(end.read(first, &frame(1)));
    let second = end.attach().unwrap();
    assert!(!end.read(first, &frame(2)));
    end.lost(first);
    assert_eq!(end.core.state(), State::Up);
    // Sent again, as the other end did not know how far this one had heard.
    assert!(end.read(second, &frame(1)));
    assert!(end.read(second, &frame(2)));
    assert_eq!(end.frames, [1, 2]);
}

#[test]
fn half_a_packet_of_an_earlier_stream_is_forgotten() {
    let (mut end, first) = End::attached();
    let whole = frame(1);
    assert!(end.read(first, &whole[..whole.len() - 1]));
    let second = end.attach().unwrap();
    assert!(end.read(second, &whole));
    assert_eq!(end.frames, [1]);
}

#[test]
fn a_stream_whose_other_end_claims_what_was_never_sent_is_refused_and_the_state_stays() {
    let mut end = End::new();
    assert!(end.core.attach(5, PIECE, end.now).is_err());
    assert_eq!((end.core.state(), end.core.stream()), (State::Waiting, 0));
    assert_eq!(end.core.attach(0, PIECE, end.now).unwrap(), 1);
    assert_eq!(end.core.attach(0, PIECE, end.now).unwrap(), 2);
}

#[test]
fn a_peer_whose_process_has_ended_is_read_to_its_end_and_then_down_at_once() {
    let (mut end, stream) = End::attached();
    end.event(Event::PeerEnded, DownReason::Ended);
    assert!(end.read(stream, &frame(1)));
    assert!(end.downs.is_empty());
    end.lost(stream);
    assert_eq!(
        (&end.frames[..], &end.downs[..]),
        (&[1][..], &[DownReason::Ended][..])
    );
}

#[test]
fn a_peer_that_is_gone_before_it_has_the_last_words_was_let_go() {
    let ends: [fn(&mut End, u64); 2] = [
        |end, _| end.event(Event::PeerEnded, DownReason::Ended),
        |end, stream| end.lost(stream),
    ];
    for goes in ends {
        let (mut end, stream) = End::attached();
        end.close();
        assert_eq!(end.core.state(), State::Closing);
        goes(&mut end, stream);
        assert_eq!(end.downs, [DownReason::Closed]);
    }
}

#[test]
fn rubbish_ends_the_session_and_says_what_it_was() {
    for (bytes, says) in [
        (frame_after(1, 5), "5"),
        (packet(Kind::Frame, 1, 0, &[]), "between"),
    ] {
        let (mut end, stream) = End::attached();
        assert!(!end.read(stream, &bytes));
        assert!(
            matches!(&end.downs[..], [DownReason::Rubbish(what)] if what.contains(says)),
            "{:?}",
            end.downs
        );
        assert!(end.frames.is_empty());
    }
}

#[test]
fn one_that_was_given_up_learns_so_and_one_that_says_goodbye_is_not_missed() {
    for (kind, number, reason) in [
        (Kind::GivenUp, 0, DownReason::GivenUp),
        (Kind::Bye, 1, DownReason::Bye),
    ] {
        let (mut end, stream) = End::attached();
        assert!(!end.read(stream, &packet(kind, number, 0, &[])));
        assert_eq!(end.downs, [reason]);
    }
}

#[test]
fn one_that_is_silent_is_told_that_it_was_given_up() {
    let (mut end, _) = End::attached();
    let pause = end.core.pulse_every();
    for _ in 0..5 {
        end.keep_after(pause);
    }
    assert_eq!(end.core.state(), State::Down);
    let (mut other, stream) = End::attached();
    other.read(stream, &end.write(usize::MAX).unwrap());
    assert_eq!(other.downs, [DownReason::GivenUp]);
}

// -- two of them ------------------------------------------------------------------------------

/// What happens between the two ends, one step at a time.
#[derive(Debug, Clone)]
enum Step {
    /// One end posts a frame of this size, as a request or as an answer.
    Post(usize, usize, bool),
    /// The stream takes so many bytes from one end.
    Write(usize, usize),
    /// So many bytes arrive at one end.
    Read(usize, usize),
    /// The stream breaks, and so many bytes of what is under way still arrive.
    Cut(usize),
    /// Time goes by, milliseconds.
    Pass(u64),
}

fn step() -> impl Strategy<Value = Step> {
    let end = 0..2_usize;
    prop_oneof![
        4 => (end.clone(), prop_oneof![0..50_usize, 5_000..400_000_usize], any::<bool>())
            .prop_map(|(end, size, answer)| Step::Post(end, size, answer)),
        6 => (end.clone(), 1..300_000_usize).prop_map(|(end, most)| Step::Write(end, most)),
        6 => (end, 1..300_000_usize).prop_map(|(end, most)| Step::Read(end, most)),
        1 => (0..50_000_usize).prop_map(Step::Cut),
        1 => (0..600_u64).prop_map(Step::Pass),
    ]
}

/// Two ends and the stream between them.
struct Pair {
    ends: [End; 2],
    /// On their way from each end to the other.
    wires: [VecDeque<u8>; 2],
    streams: [u64; 2],
    /// Calls of the requests, and of the answers, that each end has posted and that were taken.
    posted: [[Vec<u64>; 2]; 2],
    next: u64,
}

impl Pair {
    fn new(injuries: [Option<Injury>; 2]) -> Self {
        let mut pair = Self {
            ends: injuries.map(End::with),
            wires: Default::default(),
            streams: [0; 2],
            posted: Default::default(),
            next: 0,
        };
        pair.join();
        pair
    }

    /// A new stream.
    fn join(&mut self) {
        let received = self.ends.each_ref().map(|end| end.core.received());
        for index in 0..2 {
            let End { core, now, .. } = &mut self.ends[index];
            let attached = core.attach(received[1 - index], 100_000, *now);
            self.streams[index] = attached.unwrap();
            self.wires[index].clear();
        }
    }

    fn cut(&mut self, rest: usize) {
        for index in 0..2 {
            self.deliver(index, rest);
            let stream = self.streams[index];
            self.ends[index].lost(stream);
        }
        self.join();
    }

    fn deliver(&mut self, to: usize, most: usize) {
        let wire = &mut self.wires[1 - to];
        let bytes: Vec<u8> = wire.drain(..most.min(wire.len())).collect();
        let stream = self.streams[to];
        self.ends[to].read(stream, &bytes);
    }

    fn make(&mut self, step: &Step) {
        match *step {
            Step::Post(index, size, answer) => {
                self.next += 1;
                let mut frame = sample::request(vec![0; size]);
                frame.call = self.next;
                if answer {
                    frame.header.flags = Flags::REPLY;
                }
                if self.ends[index].post(frame).is_ok() {
                    self.posted[index][usize::from(answer)].push(self.next);
                }
            }
            Step::Write(index, most) => match self.ends[index].write(most) {
                Some(bytes) => self.wires[index].extend(bytes),
                None => self.cut(0),
            },
            Step::Read(index, most) => self.deliver(index, most),
            Step::Cut(rest) => self.cut(rest),
            Step::Pass(ms) => {
                for end in &mut self.ends {
                    end.keep_after(Duration::from_millis(ms));
                }
            }
        }
        for index in 0..2 {
            self.check(index);
        }
    }

    /// At every moment what one end heard, of requests and of answers, is the beginning of what the other posted.
    fn check(&self, index: usize) {
        for posted in &self.posted[1 - index] {
            let heard = &self.ends[index].frames;
            let heard: Vec<u64> = heard
                .iter()
                .copied()
                .filter(|call| posted.contains(call))
                .collect();
            assert!(posted.starts_with(&heard), "{heard:?} of {posted:?}");
        }
        assert!(self.ends[index].downs.is_empty());
    }

    /// Lets everything arrive.
    fn settle(&mut self) {
        for _ in 0..3_000 {
            if self
                .ends
                .iter()
                .all(|end| end.core.counts().bytes_under_way == 0)
            {
                return;
            }
            self.make(&Step::Pass(20));
            for index in 0..2 {
                self.make(&Step::Write(index, usize::MAX));
                self.make(&Step::Read(1 - index, usize::MAX));
            }
        }
        panic!("it does not settle");
    }

    fn play(&mut self, steps: &[Step]) {
        for step in steps {
            // Nobody is silent for too long here: what a peer says then is another test.
            if matches!(step, Step::Pass(_)) {
                for index in 0..2 {
                    self.make(&Step::Write(index, usize::MAX));
                    self.make(&Step::Read(1 - index, usize::MAX));
                }
            }
            self.make(step);
        }
        self.settle();
        for index in 0..2 {
            let mut heard = self.ends[index].frames.clone();
            heard.sort_unstable();
            let mut posted = self.posted[1 - index].concat();
            posted.sort_unstable();
            assert_eq!(heard, posted);
        }
        // And the end of it: one says goodbye, the other one hears it.
        self.ends[0].close();
        for index in [0, 1, 0, 1] {
            if let Some(bytes) = self.ends[index].write(usize::MAX) {
                self.wires[index].extend(bytes);
            }
            self.deliver(1 - index, usize::MAX);
        }
        assert_eq!(self.ends[1].downs, [DownReason::Bye]);
        assert_eq!(self.ends[0].downs, [DownReason::Closed]);
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

proptest! {
    #[test]
    fn over_streams_that_are_cut_everything_arrives_once_and_in_order(
        steps in proptest::collection::vec(step(), 0..120),
    ) {
        Pair::new([None, None]).play(&steps);
    }

    #[test]
    fn what_is_lost_on_the_way_is_asked_for_and_sent_again(
        steps in proptest::collection::vec(step(), 0..60), seed: u64,
    ) {
        let mut pair = Pair::new(["a", "b"].map(|from| injury(0.2, 0, seed, from)));
        for step in &steps {
            if !matches!(step, Step::Pass(_)) {
                pair.make(step);
            }
        }
        pair.settle();
        for index in 0..2 {
            let mut heard = pair.ends[index].frames.clone();
            heard.sort_unstable();
            let mut posted = pair.posted[1 - index].concat();
            posted.sort_unstable();
            prop_assert_eq!(heard, posted);
        }
    }
}
