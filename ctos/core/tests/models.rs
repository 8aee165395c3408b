//! Models of the structures that threads share: loom tries every interleaving of a few steps.
//!
//! The files are those of the crate, compiled here over loom's atomics instead of the standard library's.

#![allow(
    clippy::unwrap_used,
    reason = "a test may end where it finds something wrong"
)]
#![allow(dead_code, reason = "a model uses a part of what it models")]

mod concurrent {
    pub(crate) use loom::sync::atomic::{AtomicBool, AtomicU32, Ordering, fence};
}

#[path = "../src/asleep.rs"]
mod asleep;
#[path = "../src/credits.rs"]
mod credits;

use loom::{
    sync::{Arc, Mutex, Notify},
    thread,
};

use asleep::Asleep;
use credits::Credits;

/// A processor's inbox, with its announcement and its bed, which keeps a call that comes too early. (Loom's
/// `unpark` is lost to a thread that waits for a lock.)
struct Inbox {
    items: Mutex<Vec<u32>>,
    asleep: Asleep,
    bed: Notify,
}

impl Inbox {
    /// The loop of a processor: takes what is there, or sleeps until somebody wakes it.
    fn take(&self, wanted: usize) -> Vec<u32> {
        let mut taken = Vec::new();
        while taken.len() < wanted {
            taken.append(&mut self.items.lock().unwrap());
            if taken.len() < wanted {
                let has_work = || !self.items.lock().unwrap().is_empty();
                if self.asleep.fall(has_work) {
                    self.bed.wait();
                    self.asleep.up();
                }
            }
        }
        taken
    }
}

#[test]
fn a_processor_that_goes_to_sleep_is_woken_for_whatever_comes() {
    // All interleavings take minutes.
    let mut model = loom::model::Builder::new();
    model.preemption_bound = Some(2);
    model.check(|| {
        let inbox = Arc::new(Inbox {
            items: Mutex::default(),
            asleep: Asleep::default(),
            bed: Notify::new(),
        });
        let bring = |number: u32| {
            let inbox = inbox.clone();
            thread::spawn(move || {
                inbox.items.lock().unwrap().push(number);
                if inbox.asleep.must_be_woken() {
                    inbox.bed.notify();
                }
            })
        };
        let senders = [bring(1), bring(2)];
        // Should a wake-up be lost, nobody could go on, which loom reports.
        let mut taken = inbox.take(2);
        taken.sort_unstable();
        assert_eq!(taken, [1, 2]);
        for sender in senders {
            sender.join().unwrap();
        }
    });
}

#[test]
fn no_more_credits_are_taken_than_there_are() {
    const CAPACITY: usize = 1;
    loom::model(|| {
        let credits = Arc::new(Credits::default());
        let send = || {
            let credits = credits.clone();
            thread::spawn(move || credits.take(CAPACITY))
        };
        let senders = [send(), send()];
        let took = senders.map(|sender| sender.join().unwrap());
        assert_eq!(took.into_iter().filter(|took| *took).count(), CAPACITY);
        assert_eq!(credits.taken(), CAPACITY);
        credits.give(CAPACITY);
        assert!(credits.take(CAPACITY));
    });
}

#[test]
fn nobody_takes_a_credit_while_its_own_message_waits() {
    loom::model(|| {
        let credits = Arc::new(Credits::default());
        assert!(credits.take(1));
        assert!(credits.line_up(1));
        let owner = credits.clone();
        // The owner takes a message and lets the one that waits into its place.
        let owner = thread::spawn(move || {
            owner.give(1);
            assert!(owner.take_past_others(1));
            owner.leave_line();
        });
        assert!(!credits.take(1));
        owner.join().unwrap();
        assert!(!credits.take(1));
        credits.give(1);
        assert!(credits.take(1));
    });
}
