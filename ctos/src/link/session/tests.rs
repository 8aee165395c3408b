//! Sessions whose peer is silent, frozen, gone or a liar, and two of them joined over real sockets.

use std::pin::Pin;

use tokio::io::AsyncWrite;

use super::{
    packet::{Content, PACKET_HEAD, Packet},
    *,
};
use crate::{
    link::{FRAME_FIXED, Link as _, lookout::Lookout},
    message::{Flags, SYSTEM_COMMANDS},
};

/// What a session told its receiver.
#[derive(Default)]
struct Told {
    ups: u32,
    frames: Vec<u64>,
    downs: Vec<DownReason>,
}

struct Keeps(Arc<Mutex<Told>>);

impl Receiver for Keeps {
    fn up(&self, _session: Arc<Session>) {
        lock(&self.0).ups += 1;
    }

    fn frame(&self, frame: Frame, _: Instant) {
        lock(&self.0).frames.push(frame.call);
    }

    fn notice(&self, _bytes: Vec<u8>) {}

    fn down(&self, reason: &DownReason) {
        lock(&self.0).downs.push(reason.clone());
    }
}

const TIMEOUT: Duration = Duration::from_secs(2);
const ROOM: usize = 1 << 20;

fn session(clock: &Clock) -> (Arc<Session>, Arc<Mutex<Told>>) {
    let told: Arc<Mutex<Told>> = Arc::default();
    let limits = Limits {
        timeout: TIMEOUT,
        room: ROOM,
    };
    let session = Session::new(clock.clone(), limits, None, Box::new(Keeps(told.clone())));
    (session, told)
}

/// A writer that takes nothing: the peer does not read.
fn frozen() -> Writer {
    struct Frozen;
    impl AsyncWrite for Frozen {
        fn poll_write(
            self: Pin<&mut Self>,
            _: &mut PollContext<'_>,
            _: &[u8],
        ) -> Poll<io::Result<usize>> {
            Poll::Pending
        }
        fn poll_flush(self: Pin<&mut Self>, _: &mut PollContext<'_>) -> Poll<io::Result<()>> {
            Poll::Pending
        }
        fn poll_shutdown(self: Pin<&mut Self>, _: &mut PollContext<'_>) -> Poll<io::Result<()>> {
            Poll::Pending
        }
    }
    Writer::Other(Box::new(Frozen))
}

fn advance(clock: &Clock, by: Duration) {
    clock.advance_to(clock.now() + by);
}

fn packet(kind: Kind, number: u64, content: Content) -> Packet {
    Packet {
        kind,
        number,
        received: 0,
        content,
    }
}

fn frame(number: u64) -> Packet {
    let mut frame = Frame::of_body(vec![1]);
    frame.call = number;
    packet(Kind::Frame, number, Content::Frame(frame))
}

#[test]
fn a_peer_that_is_silent_is_down_after_the_limit_and_told_once() {
    let clock = Clock::virtual_clock();
    let (session, told) = session(&clock);
    let stream = session.attach(frozen(), 0).unwrap();
    for _ in 0..3 {
        advance(&clock, session.pulse_every());
        session.keep();
    }
    assert_eq!(session.state(), State::Up);
    assert!(session.receive(
        stream,
        packet(Kind::Pulse, 0, Content::Nothing),
        session.now()
    ));
    for _ in 0..3 {
        advance(&clock, session.pulse_every());
        session.keep();
    }
    assert_eq!(session.state(), State::Up);
    for _ in 0..3 {
        advance(&clock, session.pulse_every());
        session.keep();
    }
    assert_eq!(session.state(), State::Down);
    assert_eq!(lock(&told).downs, [DownReason::Silence(TIMEOUT)]);
    assert!(!session.receive(stream, frame(1), session.now()));
    assert!(session.attach(frozen(), 0).is_err());
}

#[test]
fn a_chassis_that_stood_still_itself_does_not_blame_its_peers() {
    let clock = Clock::virtual_clock();
    let (session, told) = session(&clock);
    let stream = session.attach(frozen(), 0).unwrap();
    session.keep();
    advance(&clock, 10 * TIMEOUT);
    session.keep();
    assert_eq!(session.state(), State::Up);
    // What the peer said meanwhile is read now.
    assert!(session.receive(stream, frame(1), session.now()));
    assert_eq!(lock(&told).frames, [1]);
}

#[test]
fn memory_under_way_to_a_frozen_peer_is_bounded_and_answers_still_pass() {
    let clock = Clock::virtual_clock();
    let (session, _) = session(&clock);
    session.attach(frozen(), 0).unwrap();
    let mut posted = 0;
    let full = loop {
        match session.post(Frame::of_body(vec![0; 10_000])) {
            Ok(()) => posted += 10_000,
            Err(full) => break full,
        }
    };
    assert!(
        full.bytes <= ROOM && posted > ROOM - 20_000,
        "{full:?}, {posted} bytes posted"
    );
    let mut reply = Frame::of_body(vec![0; 10_000]);
    reply.header.flags = Flags::REPLY;
    for _ in 0..1_000 {
        session.post(reply.clone()).unwrap();
    }
    // Large answers have become small faults.
    let held = session.counts().bytes_under_way;
    assert!(held < 3 * ROOM as u64, "{held} bytes");
    let mut system = Frame::of_body(Vec::new());
    system.header.command = SYSTEM_COMMANDS;
    session.post(system).unwrap();
}

#[test]
fn a_frame_larger_than_the_room_passes_when_nothing_else_is_under_way() {
    let clock = Clock::virtual_clock();
    let (session, _) = session(&clock);
    session.attach(frozen(), 0).unwrap();
    session.post(Frame::of_body(vec![0; 2 * ROOM])).unwrap();
    let held = session.counts().bytes_under_way;
    session.post(Frame::of_body(vec![0; 10])).unwrap();
    assert_eq!(session.counts().bytes_under_way, held);
}

#[test]
fn a_request_that_waits_for_room_leaves_when_there_is_some_unless_its_sender_gave_up() {
    let clock = Clock::virtual_clock();
    let (session, _) = session(&clock);
    let stream = session.attach(frozen(), 0).unwrap();
    session.post(Frame::of_body(vec![0; ROOM])).unwrap();
    for call in [7, 8] {
        let mut waits = Frame::of_body(vec![0; 100]);
        waits.call = call;
        session.post(waits).unwrap();
    }
    let mut gives_up = Frame::of_body(Vec::new());
    gives_up.call = 7;
    gives_up.header.flags = Flags::ABANDONED;
    session.post(gives_up).unwrap();
    let mut acknowledges = packet(Kind::Pulse, 0, Content::Nothing);
    acknowledges.received = 1;
    assert!(session.receive(stream, acknowledges, session.now()));
    let one = (PACKET_HEAD + FRAME_FIXED + 100) as u64;
    assert_eq!(session.counts().bytes_under_way, one);
}

#[test]
fn what_an_earlier_stream_still_brings_is_not_listened_to() {
    let clock = Clock::virtual_clock();
    let (session, told) = session(&clock);
    let first = session.attach(frozen(), 0).unwrap();
    assert!(session.receive(first, frame(1), session.now()));
    let second = session.attach(frozen(), 0).unwrap();
    assert!(!session.receive(first, frame(2), session.now()));
    session.lost(first);
    assert_eq!(session.state(), State::Up);
    // Sent again, as the other end did not know how far this one had heard.
    assert!(session.receive(second, frame(1), session.now()));
    assert!(session.receive(second, frame(2), session.now()));
    let told = lock(&told);
    assert_eq!((told.ups, &told.frames[..]), (1, &[1, 2][..]));
}

#[test]
fn a_peer_whose_process_has_ended_is_read_to_its_end_and_then_down_at_once() {
    let clock = Clock::virtual_clock();
    let (session, told) = session(&clock);
    let stream = session.attach(frozen(), 0).unwrap();
    session.event(Event::PeerEnded, DownReason::Ended);
    assert!(session.receive(stream, frame(1), session.now()));
    assert!(lock(&told).downs.is_empty());
    session.lost(stream);
    let told = lock(&told);
    assert_eq!(
        (&told.frames[..], &told.downs[..]),
        (&[1][..], &[DownReason::Ended][..])
    );
}

#[test]
fn a_peer_that_is_gone_before_it_has_the_last_words_was_let_go() {
    let clock = Clock::virtual_clock();
    let ends: [fn(&Session, u64); 2] = [
        |session, _| session.event(Event::PeerEnded, DownReason::Ended),
        |session, stream| session.lost(stream),
    ];
    for end in ends {
        let (session, told) = session(&clock);
        let stream = session.attach(frozen(), 0).unwrap();
        session.close();
        assert_eq!(session.state(), State::Closing);
        end(&session, stream);
        assert_eq!(lock(&told).downs, [DownReason::Closed]);
    }
}

#[test]
fn rubbish_ends_the_session_and_says_what_it_was() {
    let clock = Clock::virtual_clock();
    let (session, told) = session(&clock);
    let stream = session.attach(frozen(), 0).unwrap();
    let mut claims = frame(1);
    claims.received = 5;
    assert!(!session.receive(stream, claims, session.now()));
    let downs = lock(&told).downs.clone();
    assert!(
        matches!(&downs[..], [DownReason::Rubbish(what)] if what.contains('5')),
        "{downs:?}"
    );
    assert!(lock(&told).frames.is_empty());
}

#[test]
fn one_that_was_given_up_learns_so_and_one_that_says_goodbye_is_not_missed() {
    let clock = Clock::virtual_clock();
    for (kind, number, reason) in [
        (Kind::GivenUp, 0, DownReason::GivenUp),
        (Kind::Bye, 1, DownReason::Bye),
    ] {
        let (session, told) = session(&clock);
        let stream = session.attach(frozen(), 0).unwrap();
        assert!(!session.receive(
            stream,
            packet(kind, number, Content::Nothing),
            session.now()
        ));
        assert_eq!(lock(&told).downs, [reason]);
    }
}

/// Two sessions over the two ends of a Unix socket.
fn joined(test: impl AsyncFnOnce([(Arc<Session>, Arc<Mutex<Told>>); 2])) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    runtime.unwrap().block_on(async {
        let clock = Clock::real();
        let pair = [session(&clock), session(&clock)];
        let (one, other) = tokio::net::UnixStream::pair().unwrap();
        let lookout = Lookout::new("test", clock.clone(), Duration::ZERO).unwrap();
        for ((session, _), stream) in pair.clone().into_iter().zip([one, other]) {
            let lookout = lookout.clone();
            tokio::spawn(async move {
                let stream = crate::link::transport::Stream::Unix(stream);
                let driven = drive::drive(&session, stream, 0, &lookout);
                driven.await.unwrap();
            });
        }
        tokio::time::timeout(Duration::from_secs(60), test(pair))
            .await
            .unwrap();
        lookout.close();
    });
}

async fn reaches(session: &Session, state: State) {
    session.watch().wait_for(|now| *now == state).await.unwrap();
}

#[test]
fn frames_of_any_size_go_there_and_the_last_ones_before_goodbye() {
    joined(async |[(one, one_told), (other, other_told)]| {
        reaches(&one, State::Up).await;
        reaches(&other, State::Up).await;
        let sizes = [0, 1, 100, 70_000, 900_000, 3, 200_000];
        for (index, size) in sizes.into_iter().enumerate() {
            let mut frame = Frame::of_body(vec![1; size]);
            frame.call = index as u64;
            // In the lane of answers, so that the small room of these sessions is no matter.
            frame.header.flags = Flags::ABANDONED;
            one.post(frame).unwrap();
        }
        one.close();
        reaches(&other, State::Down).await;
        reaches(&one, State::Down).await;
        assert_eq!(lock(&other_told).frames, [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(lock(&other_told).downs, [DownReason::Bye]);
        assert_eq!(lock(&one_told).downs, [DownReason::Closed]);
        let bytes = sizes.iter().sum::<usize>() as u64;
        assert_eq!(
            (other.counts().bytes_in, one.counts().bytes_out),
            (bytes, bytes)
        );
        assert!(bytes > FRAME_FIXED as u64);
    });
}
