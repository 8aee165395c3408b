//! The latest of a row of values, from one thread to any others, without a lock.
//!
//! The writer goes round four slots and never waits. A reader copies the newest one, and copies again only if the writer
//! came round to it meanwhile: no reader ever gets a mixture (a sequence lock per slot, after H.-J. Boehm, MSPC 2012).

use std::sync::atomic::{AtomicU64, Ordering, fence};

/// With so many slots a writer that was interrupted leaves its readers the values before.
const SLOTS: u64 = 4;

/// The count of a slot that is being written: no write has it.
const BUSY: u64 = u64::MAX;

/// The latest values, each time as many.
#[derive(Debug)]
pub struct Latest {
    /// Counts the writes.
    newest: AtomicU64,
    slots: [Slot; SLOTS as usize],
}

#[derive(Debug)]
struct Slot {
    /// Which write it holds, or [`BUSY`].
    count: AtomicU64,
    values: Box<[AtomicU64]>,
}

impl Latest {
    /// A row of `first`, which counts as no write.
    pub fn new(first: &[f64]) -> Self {
        Self {
            newest: AtomicU64::new(0),
            slots: std::array::from_fn(|_| Slot {
                count: AtomicU64::new(0),
                values: first
                    .iter()
                    .map(|value| AtomicU64::new(value.to_bits()))
                    .collect(),
            }),
        }
    }

    /// Writes all values; those that are missing stay as they were three writes before. One thread may write.
    pub fn write(&self, values: impl IntoIterator<Item = f64>) {
        let count = self.newest.load(Ordering::Relaxed) + 1;
        let slot = self.slot(count);
        slot.count.store(BUSY, Ordering::Relaxed);
        // Whoever sees a value of this write sees that the slot is being written.
        fence(Ordering::Release);
        for (place, value) in slot.values.iter().zip(values) {
            place.store(value.to_bits(), Ordering::Relaxed);
        }
        slot.count.store(count, Ordering::Release);
        self.newest.store(count, Ordering::Release);
    }

    /// Copies the newest values and tells how many writes there were up to them.
    pub fn read(&self, values: &mut [f64]) -> u64 {
        loop {
            let count = self.newest.load(Ordering::Acquire);
            let slot = self.slot(count);
            let before = slot.count.load(Ordering::Acquire);
            for (value, place) in values.iter_mut().zip(&slot.values) {
                *value = f64::from_bits(place.load(Ordering::Relaxed));
            }
            fence(Ordering::Acquire);
            if before == count && slot.count.load(Ordering::Relaxed) == count {
                return count;
            }
        }
    }

    fn slot(&self, count: u64) -> &Slot {
        // A remainder is less than the number of slots.
        &self.slots[(count % SLOTS) as usize]
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    #[test]
    fn a_reader_sees_the_last_write_and_how_many_there_were() {
        let latest = Latest::new(&[1.0, 2.0]);
        let mut values = [0.0; 2];
        assert_eq!((latest.read(&mut values), values), (0, [1.0, 2.0]));
        for count in 1..10 {
            let value = count as f64;
            latest.write([value, -value]);
            assert_eq!((latest.read(&mut values), values), (count, [value, -value]));
        }
    }

    #[test]
    fn readers_on_other_threads_never_see_a_mixture_nor_go_back() {
        const WRITES: u64 = 100_000;
        let latest = Latest::new(&[0.0; 24]);
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    let (mut values, mut last) = ([0.0; 24], 0);
                    while !over.load(Ordering::Relaxed) {
                        let count = latest.read(&mut values);
                        assert!(
                            values.iter().all(|value| *value == count as f64),
                            "{values:?}"
                        );
                        assert!(count >= last);
                        last = count;
                    }
                    assert_eq!(latest.read(&mut values), WRITES);
                });
            }
            for count in 1..=WRITES {
                latest.write([count as f64; 24]);
            }
            over.store(true, Ordering::Relaxed);
        });
    }
}
