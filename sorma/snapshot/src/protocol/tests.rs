//! The protocol in a model checker. It tries every order of loads and stores that the memory model of
//! Rust allows between one writer and one reader. A test bounds the preemptions. It also checks a writer
//! that dies between any two stores while another takes over.

use super::*;
use loom::sync::Arc;
use loom::sync::atomic::{AtomicU64, Ordering, fence};
use loom::thread;

/// How often a thread may be interrupted where it need not.
const PREEMPTIONS: usize = 3;

/// Words of the model, with the fences that the protocol asks for, or without.
struct Words {
    words: Vec<AtomicU64>,
    fenced: bool,
}

impl Words {
    fn new(ring: &Ring, fenced: bool) -> Self {
        let slots = usize::try_from(ring.slots).unwrap();
        let words = ring.first + slots * ring.stride;
        Self {
            words: (0..words).map(|_| AtomicU64::new(0)).collect(),
            fenced,
        }
    }
}

impl Load for Words {
    fn load(&self, at: usize) -> u64 {
        self.words[at].load(Ordering::Relaxed)
    }
    fn fence_acquire(&self) {
        if self.fenced {
            fence(Ordering::Acquire);
        }
    }
}

impl Store for Words {
    fn store(&self, at: usize, word: u64) {
        self.words[at].store(word, Ordering::Relaxed);
    }
    fn fence_release(&self) {
        if self.fenced {
            fence(Ordering::Release);
        }
    }
}

/// A writer that dies after so many stores: the later ones are never made.
struct Mortal<'a> {
    words: &'a Words,
    left: std::cell::Cell<usize>,
}

impl Load for Mortal<'_> {
    fn load(&self, at: usize) -> u64 {
        self.words.load(at)
    }
    fn fence_acquire(&self) {
        self.words.fence_acquire();
    }
}

impl Store for Mortal<'_> {
    fn store(&self, at: usize, word: u64) {
        if let Some(left) = self.left.get().checked_sub(1) {
            self.left.set(left);
            self.words.store(at, word);
        }
    }
    fn fence_release(&self) {
        self.words.fence_release();
    }
}

fn ring(slots: u64) -> Ring {
    Ring {
        head: 0,
        first: 1,
        stride: SLOT_HEAD + 2,
        slots,
        floats: 2,
        bytes: 0,
    }
}

/// Stores that one record takes: twice the sequence, stamp, generation, length, two floats, head.
const STORES: usize = 8;

fn put(ring: &Ring, memory: &impl Store, count: u64, generation: u64) {
    let mark = Mark {
        count,
        stamp_ns: count + 100,
        generation,
    };
    let value = (10 * count + generation) as f64;
    ring.write(memory, mark, &[value, -value], &[]);
}

/// Reads a record and holds that it is whole.
fn take(ring: &Ring, memory: &impl Load, count: u64) -> Option<u64> {
    let (mut floats, mut bytes) = (Vec::new(), Vec::new());
    match ring.read(memory, count, &mut floats, &mut bytes) {
        Taken::Whole(mark) => {
            let value = (10 * count + mark.generation) as f64;
            assert_eq!(floats, [value, -value], "torn");
            assert_eq!((mark.count, mark.stamp_ns), (count, count + 100), "torn");
            Some(count)
        }
        Taken::Overwritten => None,
        Taken::NotYet => panic!("announced, but not there"),
    }
}

fn check(model: impl Fn() + Sync + Send + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(PREEMPTIONS);
    builder.check(model);
}

fn one_writer_one_reader(slots: u64, records: u64, fenced: bool) {
    check(move || {
        let ring = ring(slots);
        let words = Arc::new(Words::new(&ring, fenced));
        let shared = Arc::clone(&words);
        let writer = thread::spawn(move || {
            for count in 1..=records {
                put(&ring, &*shared, count, 1);
            }
        });
        let head = ring.head(&*words);
        if head > 0 {
            take(&ring, &*words, head);
        }
        writer.join().unwrap();
        // When all is still, all that fits is there.
        assert_eq!(ring.head(&*words), records);
        for count in ring.oldest(records)..=records {
            assert_eq!(take(&ring, &*words, count), Some(count));
        }
    });
}

#[test]
fn no_order_of_loads_and_stores_tears_a_record() {
    one_writer_one_reader(2, 3, true);
}

#[test]
fn a_single_slot_is_read_whole_or_not_at_all() {
    one_writer_one_reader(1, 2, true);
}

#[test]
fn the_model_would_notice_fences_that_are_missing() {
    let tearing = std::panic::catch_unwind(|| one_writer_one_reader(1, 2, false));
    assert!(tearing.is_err());
}

#[test]
fn a_writer_that_dies_between_any_two_stores_is_succeeded_and_nothing_is_torn() {
    for death in 0..=STORES {
        check(move || {
            let ring = ring(2);
            let words = Arc::new(Words::new(&ring, true));
            let shared = Arc::clone(&words);
            let writers = thread::spawn(move || {
                put(&ring, &*shared, 1, 1);
                let mortal = Mortal {
                    words: &shared,
                    left: std::cell::Cell::new(death),
                };
                put(&ring, &mortal, 2, 1);
                let head = ring.recover(&*shared).unwrap();
                // Whole without being announced counts as written.
                assert_eq!(head, if death + 1 >= STORES { 2 } else { 1 });
                put(&ring, &*shared, head + 1, 2);
                head + 1
            });
            let head = ring.head(&*words);
            for count in ring.oldest(head)..=head {
                take(&ring, &*words, count);
            }
            let head = writers.join().unwrap();
            assert_eq!(ring.head(&*words), head);
            for count in ring.oldest(head)..=head {
                assert_eq!(take(&ring, &*words, count), Some(count));
            }
        });
    }
}
