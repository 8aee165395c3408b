//! Who has the turn, and that no wake-up is lost.

use std::{
    os::{fd::AsFd, unix::net::UnixStream},
    sync::mpsc,
    thread::ThreadId,
};

use super::*;

/// Says by which thread it was served, and nudges whoever shall handle it.
struct Pipe {
    stream: UnixStream,
    served: mpsc::Sender<ThreadId>,
    handles: Option<Arc<Parker>>,
}

impl Source for Pipe {
    fn serve(&self, happened: Happened) -> Seen {
        let mut byte = [0];
        if !happened.came || rustix::io::read(&self.stream, &mut byte).is_err() {
            return Seen::Nothing;
        }
        if let Some(parker) = &self.handles {
            parker.unpark();
        }
        self.served.send(std::thread::current().id()).unwrap();
        Seen::Frames
    }

    fn has_come(&self) -> bool {
        false
    }

    fn is_visible(&self) -> bool {
        false
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }

    fn set_asleep(&self, _: bool) {}
}

struct Joined {
    lookout: Arc<Lookout>,
    other_end: UnixStream,
    served: mpsc::Receiver<ThreadId>,
    watched: Watched,
}

fn joined(handles: Option<Arc<Parker>>) -> Joined {
    let lookout = Lookout::new("test", Clock::real(), Duration::ZERO).unwrap();
    let (stream, other_end) = UnixStream::pair().unwrap();
    stream.set_nonblocking(true).unwrap();
    let (sender, served) = mpsc::channel();
    let watched = lookout.add(|id| {
        assert!(id > NUDGE);
        Arc::new(Pipe {
            stream,
            served: sender,
            handles,
        })
    });
    let watched = watched.unwrap();
    // As a socket's writer does when there is nothing to be written.
    lookout.wants_room(watched.source.fd(), watched.id, false);
    Joined {
        lookout,
        other_end,
        served,
        watched,
    }
}

fn write_to(mut stream: &UnixStream) {
    std::io::Write::write_all(&mut stream, &[1]).unwrap();
}

#[test]
fn while_nobody_else_is_at_the_links_the_relief_serves_them() {
    let joined = joined(None);
    for _ in 0..3 {
        write_to(&joined.other_end);
        let by = joined.served.recv().unwrap();
        assert_ne!(by, std::thread::current().id());
    }
    drop(joined.watched);
    joined.lookout.close();
}

#[test]
fn an_idle_processor_takes_the_turn_from_the_relief_and_serves_what_comes_itself() {
    let parker = Arc::new(Parker::default());
    let joined = joined(Some(parker.clone()));
    // The relief has the turn.
    write_to(&joined.other_end);
    joined.served.recv().unwrap();
    parker.take_nudge();
    let (lookout, sits) = (joined.lookout.clone(), parker.clone());
    let done = Arc::new(AtomicBool::new(false));
    let ends = done.clone();
    let processor = std::thread::spawn(move || {
        sits.sit_down();
        sits.look_out(lookout);
        // The relief wakes it once when it has left the turn to it.
        while !ends.load(Ordering::SeqCst) {
            sits.park(Instant::START, None);
        }
    });
    while !joined.lookout.manned.load(Ordering::SeqCst) {
        std::thread::yield_now();
    }
    write_to(&joined.other_end);
    assert_eq!(joined.served.recv().unwrap(), processor.thread().id());
    done.store(true, Ordering::SeqCst);
    parker.unpark();
    processor.join().unwrap();
    joined.lookout.close();
}

#[test]
fn wake_ups_are_never_lost_wherever_the_thread_sleeps() {
    // Each round puts both to sleep, one of them at the links; a lost wake-up would hang the test.
    const ROUNDS: u64 = 5_000;
    let lookout = Lookout::new("test", Clock::real(), Duration::ZERO).unwrap();
    let parkers: [Arc<Parker>; 2] = Default::default();
    let turn = Arc::new(AtomicU64::new(0));
    let players: Vec<_> = (0..2)
        .map(|mine: usize| {
            let (lookout, parkers, turn) = (lookout.clone(), parkers.clone(), turn.clone());
            std::thread::spawn(move || {
                let [own, other] = [&parkers[mine], &parkers[1 - mine]];
                own.sit_down();
                own.look_out(lookout);
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
    lookout.close();
}

#[test]
fn a_wait_ends_at_its_time() {
    let clock = Clock::real();
    let lookout = Lookout::new("test", clock.clone(), Duration::ZERO).unwrap();
    let parker = Parker::default();
    parker.sit_down();
    parker.look_out(lookout.clone());
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
            while !lookout.manned.load(Ordering::SeqCst) {
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
    lookout.close();
}
