//! The timers of one processor: a heap in which every timer knows its place, so that one that is no
//! longer wanted is taken out at once. It knows neither clock nor wakers.

use crate::time::Instant;

/// Timers that each carry a `T`. First the earliest; of one moment, the one that was set first.
pub(crate) struct Timers<T> {
    heap: Vec<Node<T>>,
    /// Where in the heap the timer of a key stands, or the next free entry.
    places: Vec<u32>,
    /// The first free entry of `places`; [`NONE`] when there is none.
    free: u32,
    next: u64,
}

const NONE: u32 = u32::MAX;

struct Node<T> {
    at: Instant,
    number: u64,
    place: u32,
    value: T,
}

impl<T> Node<T> {
    fn order(&self) -> (Instant, u64) {
        (self.at, self.number)
    }
}

/// Takes a timer out again. Worth nothing once the timer is out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct TimerKey {
    place: u32,
    number: u64,
}

impl<T> Default for Timers<T> {
    fn default() -> Self {
        Self {
            heap: Vec::new(),
            places: Vec::new(),
            free: NONE,
            next: 0,
        }
    }
}

impl<T> Timers<T> {
    /// The moment of the first timer.
    #[inline]
    pub(crate) fn first(&self) -> Option<Instant> {
        self.heap.first().map(|node| node.at)
    }

    /// Sets a timer.
    pub(crate) fn insert(&mut self, at: Instant, value: T) -> TimerKey {
        let number = self.next;
        self.next += 1;
        let position = self.heap.len();
        let place = self.take_place(position);
        self.heap.push(Node {
            at,
            number,
            place,
            value,
        });
        self.rise(position);
        TimerKey { place, number }
    }

    /// Takes a timer out before its time; `None` when it is out already.
    pub(crate) fn remove(&mut self, key: TimerKey) -> Option<T> {
        let position = *self.places.get(key.place as usize)? as usize;
        let node = self.heap.get(position)?;
        // A free entry holds no position, and another timer may have the place by now.
        if node.place != key.place || node.number != key.number {
            return None;
        }
        self.take_out(position)
    }

    /// Takes out the first timer if it is due.
    pub(crate) fn pop_due(&mut self, now: Instant) -> Option<T> {
        if self.first()? > now {
            return None;
        }
        self.take_out(0)
    }

    /// Takes out all timers.
    pub(crate) fn clear(&mut self) -> Vec<T> {
        self.places.clear();
        self.free = NONE;
        let heap = std::mem::take(&mut self.heap);
        heap.into_iter().map(|node| node.value).collect()
    }

    fn take_place(&mut self, position: usize) -> u32 {
        // Below 2^32 timers at once, by far: each has a future that waits.
        let position = position as u32;
        match self.places.get_mut(self.free as usize) {
            Some(entry) => {
                let place = self.free;
                self.free = *entry;
                *entry = position;
                place
            }
            None => {
                self.places.push(position);
                (self.places.len() - 1) as u32
            }
        }
    }

    fn take_out(&mut self, position: usize) -> Option<T> {
        if position >= self.heap.len() {
            return None;
        }
        let node = self.heap.swap_remove(position);
        if let Some(entry) = self.places.get_mut(node.place as usize) {
            *entry = self.free;
            self.free = node.place;
        }
        if position < self.heap.len() {
            self.note(position);
            let position = self.rise(position);
            self.sink(position);
        }
        Some(node.value)
    }

    /// Writes down where the timer at `position` stands.
    fn note(&mut self, position: usize) {
        if let Some(node) = self.heap.get(position)
            && let Some(entry) = self.places.get_mut(node.place as usize)
        {
            *entry = position as u32;
        }
    }

    fn is_before(&self, one: usize, other: usize) -> bool {
        match (self.heap.get(one), self.heap.get(other)) {
            (Some(one), Some(other)) => one.order() < other.order(),
            _ => false,
        }
    }

    fn rise(&mut self, mut position: usize) -> usize {
        while position > 0 {
            let parent = (position - 1) / 2;
            if !self.is_before(position, parent) {
                break;
            }
            self.heap.swap(position, parent);
            self.note(position);
            self.note(parent);
            position = parent;
        }
        position
    }

    fn sink(&mut self, mut position: usize) {
        loop {
            let (left, right) = (2 * position + 1, 2 * position + 2);
            let child = if self.is_before(right, left) {
                right
            } else {
                left
            };
            if !self.is_before(child, position) {
                break;
            }
            self.heap.swap(position, child);
            self.note(position);
            self.note(child);
            position = child;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[derive(Debug, Clone)]
    enum Step {
        Insert(u64),
        Remove(usize),
        Pop(u64),
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            3 => (0_u64..50).prop_map(Step::Insert),
            2 => any::<usize>().prop_map(Step::Remove),
            2 => (0_u64..60).prop_map(Step::Pop),
        ]
    }

    proptest! {
        #[test]
        fn it_does_what_an_ordered_map_does(steps in proptest::collection::vec(step(), 0..300)) {
            let mut timers = Timers::default();
            let mut model = BTreeMap::new();
            let mut keys = Vec::new();
            for (count, step) in steps.into_iter().enumerate() {
                match step {
                    Step::Insert(at) => {
                        let at = Instant::from_nanos(at);
                        keys.push((timers.insert(at, count), (at, count)));
                        model.insert((at, count), count);
                    }
                    Step::Remove(index) if !keys.is_empty() => {
                        // Also keys whose timer is out already.
                        let (key, in_model) = keys[index % keys.len()];
                        prop_assert_eq!(timers.remove(key), model.remove(&in_model));
                    }
                    Step::Remove(_) => {}
                    Step::Pop(now) => {
                        let now = Instant::from_nanos(now);
                        let first = model.first_entry().filter(|entry| entry.key().0 <= now);
                        prop_assert_eq!(timers.pop_due(now), first.map(|entry| entry.remove()));
                    }
                }
                prop_assert_eq!(timers.first(), model.keys().next().map(|key| key.0));
            }
        }
    }
}
