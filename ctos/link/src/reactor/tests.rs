//! Who leads, and that no wake-up is lost.

use std::{
    os::{
        fd::{AsFd, BorrowedFd},
        unix::net::UnixStream,
    },
    sync::mpsc,
    thread::ThreadId,
};

use super::{
    sources::{TIMER, WAKER},
    *,
};

/// Says by which thread it was served, and nudges the thread that shall handle it.
struct Pipe {
    stream: UnixStream,
    served: mpsc::Sender<ThreadId>,
    handles: Option<Arc<LinkParker>>,
}

impl Source for Pipe {
    fn serve(&self, happened: Happened) -> Seen {
        let mut byte = [0];
        if !happened.readable || rustix::io::read(&self.stream, &mut byte).is_err() {
            return Seen::Nothing;
        }
        if let Some(parker) = &self.handles {
            parker.unpark();
        }
        self.served.send(std::thread::current().id()).unwrap();
        Seen::Frames
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }
}

struct Joined {
    reactor: Arc<Reactor>,
    other_end: UnixStream,
    served: mpsc::Receiver<ThreadId>,
    watched: Watched,
}

fn reactor() -> Arc<Reactor> {
    Reactor::new("test", Clock::real(), Duration::ZERO).unwrap()
}

fn parker(reactor: &Arc<Reactor>) -> Arc<LinkParker> {
    Arc::new(LinkParker::new(reactor.clone()))
}

fn joined(reactor: Arc<Reactor>, handles: Option<Arc<LinkParker>>) -> Joined {
    let (stream, other_end) = UnixStream::pair().unwrap();
    stream.set_nonblocking(true).unwrap();
    let (sender, served) = mpsc::channel();
    let pipe = Pipe {
        stream,
        served: sender,
        handles,
    };
    let watched = reactor.add(Arc::new(pipe)).unwrap();
    assert!(watched.id != WAKER.0 && watched.id != TIMER.0);
    Joined {
        reactor,
        other_end,
        served,
        watched,
    }
}

fn write_to(mut stream: &UnixStream) {
    std::io::Write::write_all(&mut stream, &[1]).unwrap();
}

#[test]
fn while_nobody_else_leads_the_standby_does() {
    let joined = joined(reactor(), None);
    for _ in 0..3 {
        write_to(&joined.other_end);
        let by = joined.served.recv().unwrap();
        assert_ne!(by, std::thread::current().id());
    }
    drop(joined.watched);
    joined.reactor.close();
}

#[test]
fn an_idle_processor_takes_the_lead_from_the_standby_and_serves_what_comes_itself() {
    let reactor = reactor();
    let parker = parker(&reactor);
    let joined = joined(reactor, Some(parker.clone()));
    // The standby leads.
    write_to(&joined.other_end);
    joined.served.recv().unwrap();
    parker.nudges.thread.take_nudge();
    let sits = parker.clone();
    let done = Arc::new(AtomicBool::new(false));
    let ends = done.clone();
    let processor = std::thread::spawn(move || {
        sits.sit_down();
        // The standby wakes it once when it has left the lead to it.
        while !ends.load(Ordering::SeqCst) {
            sits.park(Instant::START, None);
        }
    });
    while !joined.reactor.is_led.load(Ordering::SeqCst) {
        std::thread::yield_now();
    }
    write_to(&joined.other_end);
    assert_eq!(joined.served.recv().unwrap(), processor.thread().id());
    done.store(true, Ordering::SeqCst);
    parker.unpark();
    processor.join().unwrap();
    joined.reactor.close();
}

#[test]
fn wake_ups_are_never_lost_wherever_the_thread_sleeps() {
    // Each round puts both to sleep, one of them at the links; a lost wake-up would hang the test.
    const ROUNDS: u64 = 5_000;
    let reactor = reactor();
    let parkers = [parker(&reactor), parker(&reactor)];
    let turn = Arc::new(AtomicU64::new(0));
    let players: Vec<_> = (0..2)
        .map(|mine: usize| {
            let (parkers, turn) = (parkers.clone(), turn.clone());
            std::thread::spawn(move || {
                let [own, other] = [&parkers[mine], &parkers[1 - mine]];
                own.sit_down();
                loop {
                    let now = turn.load(Ordering::SeqCst);
                    if now >= ROUNDS {
                        other.unpark();
                        return;
                    }
                    if now % 2 == mine as u64 {
                        turn.store(now + 1, Ordering::SeqCst);
                        other.unpark();
                    } else {
                        own.park(Instant::START, None);
                    }
                }
            })
        })
        .collect();
    for player in players {
        player.join().unwrap();
    }
    reactor.close();
}

#[test]
fn a_wait_ends_at_its_time() {
    let reactor = reactor();
    let clock = reactor.clock.clone();
    let parker = parker(&reactor);
    parker.sit_down();
    let park_until = |end: Instant| {
        while clock.now() < end {
            parker.park(clock.now(), Some(end));
        }
    };
    for wait in [Duration::from_micros(300), Duration::from_millis(5)] {
        park_until(clock.now() + wait);
    }
    // A timer that is set for later must not keep an earlier end waiting.
    let nudged = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !reactor.is_led.load(Ordering::SeqCst) {
                std::thread::yield_now();
            }
            nudged.store(true, Ordering::SeqCst);
            parker.unpark();
        });
        let later = clock.now() + Duration::from_secs(3_000);
        while !nudged.load(Ordering::SeqCst) {
            parker.park(clock.now(), Some(later));
        }
    });
    park_until(clock.now() + Duration::from_millis(1));
    reactor.close();
}
