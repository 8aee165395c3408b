//! Models of the structures that threads share: loom tries every interleaving of a few steps.
//!
//! The files are those of the crate, compiled here over loom's locks and atomics instead of the
//! standard library's.

#![allow(
    clippy::unwrap_used,
    reason = "a test may end where it finds something wrong"
)]
#![allow(dead_code, reason = "a model uses a part of what it models")]

mod concurrent {
    pub(crate) use std::sync::PoisonError;

    pub(crate) use loom::sync::{
        Mutex, MutexGuard,
        atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering},
    };
}

#[path = "../src/inbox.rs"]
mod inbox;
#[path = "../src/room.rs"]
mod room;
#[path = "../src/message/store.rs"]
mod store;

use loom::{
    sync::{Arc, Mutex},
    thread,
};

use inbox::Inbox;
use room::Room;
use store::Store;

/// The loop of a processor: takes what is there, or sleeps until somebody wakes it.
fn take(inbox: &Inbox<u32>, wanted: usize) -> Vec<u32> {
    let (mut taken, mut batch) = (Vec::new(), Vec::new());
    while taken.len() < wanted {
        if inbox.is_filled() {
            inbox.swap(&mut batch);
            taken.append(&mut batch);
        } else if inbox.sleep() {
            thread::park();
        }
    }
    taken
}

#[test]
fn a_processor_that_goes_to_sleep_is_woken_for_whatever_comes() {
    loom::model(|| {
        let inbox = Arc::new(Inbox::default());
        let reader = thread::current();
        let bring = |number: u32| {
            let (inbox, reader) = (inbox.clone(), reader.clone());
            thread::spawn(move || {
                if inbox.push(number).unwrap() {
                    reader.unpark();
                }
            })
        };
        let senders = [bring(1), bring(2)];
        // Should a wake-up be lost, nobody could go on, which loom reports.
        let mut taken = take(&inbox, 2);
        taken.sort_unstable();
        assert_eq!(taken, [1, 2]);
        for sender in senders {
            sender.join().unwrap();
        }
    });
}

#[test]
fn what_may_be_brought_is_counted_without_atomic_additions() {
    loom::model(|| {
        const MOST: u32 = 1;
        let inbox = Arc::new(Inbox::default());
        let count = Arc::new(concurrent::AtomicU32::new(0));
        let bring = |number: u32| {
            let (inbox, count) = (inbox.clone(), count.clone());
            thread::spawn(move || {
                let may = || {
                    let before = count.load(concurrent::Ordering::Relaxed);
                    count.store(before + 1, concurrent::Ordering::Relaxed);
                    before < MOST
                };
                inbox.push_if(number, may).is_ok()
            })
        };
        let senders = [bring(1), bring(2)];
        let brought = senders.map(|sender| sender.join().unwrap());
        assert_eq!(count.load(concurrent::Ordering::Relaxed), 2);
        assert_eq!(brought.into_iter().filter(|brought| *brought).count(), 1);
        assert_eq!(take(&inbox, 1).len(), 1);
    });
}

#[test]
fn what_one_thread_brings_is_taken_in_its_order_and_nothing_after_the_end() {
    loom::model(|| {
        let inbox = Arc::new(Inbox::default());
        let (other, reader) = (inbox.clone(), thread::current());
        let sender = thread::spawn(move || {
            let mut refused = 0;
            for number in 1..=3 {
                match other.push(number) {
                    Ok(true) => reader.unpark(),
                    Ok(false) => {}
                    Err(_) => refused += 1,
                }
            }
            refused
        });
        let mut taken = take(&inbox, 1);
        taken.extend(inbox.close());
        let refused = sender.join().unwrap();
        assert_eq!(taken.len() + refused, 3);
        assert_eq!(taken, Vec::from_iter(1..=taken.len() as u32));
    });
}

/// The places of a queue to which a message was brought before: what is made for the first one is made once by
/// something of the standard library, which loom cannot see into.
fn used_room() -> Room {
    let room = Room::default();
    assert!(room.claim(1));
    room.arrived(1, 0);
    assert_eq!(room.len(), 0);
    room
}

#[test]
fn no_more_places_are_claimed_than_there_are() {
    const CAPACITY: usize = 1;
    loom::model(|| {
        let room = Arc::new(used_room());
        // What was brought and not taken in, and how much of it there may be.
        let brought = Arc::new(Mutex::new(0_usize));
        let send = || {
            let (room, brought) = (room.clone(), brought.clone());
            thread::spawn(move || {
                // As with the inbox: claimed and brought in one step.
                let mut brought = brought.lock().unwrap();
                if room.claim(CAPACITY) {
                    *brought += 1;
                }
            })
        };
        let senders = [send(), send()];
        // The owner takes in what has come, and takes one message.
        let mut held = 0;
        let arrived = std::mem::take(&mut *brought.lock().unwrap());
        assert!(arrived <= CAPACITY);
        for _ in 0..arrived {
            held += 1;
            room.arrived(1, held);
        }
        let handled = usize::from(held > 0);
        held -= handled;
        room.set_held(held);
        for sender in senders {
            sender.join().unwrap();
        }
        let late = *brought.lock().unwrap();
        assert!(held + late <= CAPACITY);
        for _ in 0..late {
            held += 1;
            room.arrived(1, held);
        }
        assert_eq!(room.len(), held);
        assert!(
            handled + held >= 1,
            "two senders at an empty queue both failed for good"
        );
    });
}

#[test]
fn nobody_claims_a_place_while_its_own_message_waits() {
    loom::model(|| {
        let room = Arc::new(used_room());
        room.set_held(1);
        assert!(room.line_up(1));
        let owner = room.clone();
        // The owner takes a message and lets the one that waits into its place.
        let owner = thread::spawn(move || {
            owner.leave_line();
            owner.set_held(1);
        });
        assert!(!room.looks_free(1) && !room.claim(1));
        owner.join().unwrap();
        assert!(!room.looks_free(1) && !room.claim(1));
        room.set_held(0);
        assert!(room.looks_free(1) && room.claim(1));
    });
}

#[test]
fn what_threads_give_and_take_is_always_in_one_place_and_never_in_two() {
    loom::model(|| {
        // So small that batches are dropped, too.
        let store = Arc::new(Store::new(1));
        let run = |first: u32| {
            let store = store.clone();
            thread::spawn(move || {
                let mut own = vec![Box::new(first), Box::new(first + 1)];
                store.give(&mut own, 1);
                assert_eq!(own.len(), 1, "what is beyond those to be kept goes");
                own.clear();
                store.take(&mut own);
                own
            })
        };
        let others = [run(0), run(10)];
        let mut all: Vec<u32> = Vec::new();
        for other in others {
            all.extend(other.join().unwrap().into_iter().map(|one| *one));
        }
        let mut rest = Vec::new();
        store.take(&mut rest);
        all.extend(rest.into_iter().map(|one| *one));
        // Of each thread the second one was given; of both at least one was kept.
        all.sort_unstable();
        assert!(matches!(all[..], [1] | [11] | [1, 11]), "{all:?}");
        let mut more = Vec::new();
        store.take(&mut more);
        assert!(more.is_empty(), "something is there twice");
    });
}
