//! Two sessions joined over a real socket: what their receivers are told, and by whom it is written.

pub(super) mod sample;

use super::*;
use crate::{frame::FRAME_FIXED, message::Flags, reactor::Reactor};

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
const MOST: usize = 1 << 20;

fn session(clock: &Clock) -> (Arc<Session>, Arc<Mutex<Told>>) {
    let told: Arc<Mutex<Told>> = Arc::default();
    let limits = Limits {
        timeout: TIMEOUT,
        unacknowledged: MOST,
    };
    let session = Session::new(clock.clone(), limits, None, Box::new(Keeps(told.clone())));
    (session, told)
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
        let reactor = Reactor::new("test", clock.clone(), Duration::ZERO).unwrap();
        for ((session, _), stream) in pair.clone().into_iter().zip([one, other]) {
            let reactor = reactor.clone();
            tokio::spawn(async move {
                let stream = Box::new(stream);
                let driven = drive::drive(&session, stream, 0, &reactor);
                driven.await.unwrap();
            });
        }
        tokio::time::timeout(Duration::from_secs(60), test(pair))
            .await
            .unwrap();
        reactor.close();
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
            let mut frame = sample::request(vec![1; size]);
            frame.call = index as u64;
            // In the lane of answers, so that the few credits of these sessions do not matter.
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
