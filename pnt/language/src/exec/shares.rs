//! The weights of the enabled transitions of each priority, so that chance chooses among any number
//! of them in a few steps. It keeps sums of pairs, of pairs of pairs and so on. A sum depends only
//! on what is enabled now, so a restored net chooses as the first one did.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::wiring::Wiring;

/// The transitions of one priority.
#[derive(Debug, Clone, Copy)]
struct Class {
    first_rank: usize,
    /// Where its sums begin.
    base: usize,
    /// A power of two, not less than the number of transitions; also the place of the first leaf.
    leaves: usize,
}

#[derive(Debug, Clone)]
pub(super) struct Shares {
    classes: Vec<Class>,
    /// Per rank.
    class_of: Vec<u32>,
    sums: Vec<f64>,
    /// Ranks whose enabling function has said no in this choice, with their weights.
    aside: Vec<(usize, f64)>,
}

impl Shares {
    /// Nothing is enabled yet.
    pub(super) fn new(wiring: &Wiring) -> Self {
        let mut shares = Self {
            classes: Vec::new(),
            class_of: Vec::new(),
            sums: Vec::new(),
            aside: Vec::new(),
        };
        let mut rank = 0;
        while rank < wiring.first_timed {
            let size = wiring.class_from(rank).len().max(1);
            let leaves = size.next_power_of_two();
            let number = u32::try_from(shares.classes.len()).unwrap_or(u32::MAX);
            shares.classes.push(Class {
                first_rank: rank,
                base: shares.sums.len(),
                leaves,
            });
            shares.class_of.extend(std::iter::repeat_n(number, size));
            shares.sums.extend(std::iter::repeat_n(0.0, 2 * leaves));
            rank += size;
        }
        shares
    }

    fn class(&self, rank: usize) -> Option<Class> {
        let number = *self.class_of.get(rank)?;
        self.classes.get(number as usize).copied()
    }

    fn sum(&self, class: Class, node: usize) -> f64 {
        self.sums.get(class.base + node).copied().unwrap_or(0.0)
    }

    pub(super) fn set(&mut self, rank: usize, weight: f64) {
        let Some(class) = self.class(rank) else {
            return;
        };
        let mut node = class.leaves + rank - class.first_rank;
        if let Some(leaf) = self.sums.get_mut(class.base + node) {
            *leaf = weight;
        }
        while node > 1 {
            node /= 2;
            let sum = self.sum(class, 2 * node) + self.sum(class, 2 * node + 1);
            if let Some(inner) = self.sums.get_mut(class.base + node) {
                *inner = sum;
            }
        }
    }

    /// One of the same priority as `rank`, each as probable as its weight says.
    pub(super) fn draw(&self, rank: usize, rng: &mut ChaCha8Rng) -> Option<usize> {
        let class = self.class(rank)?;
        let total = self.sum(class, 1);
        if total <= 0.0 {
            return None;
        }
        let mut left_over = rng.random::<f64>() * total;
        let mut node = 1;
        while node < class.leaves {
            let (left, right) = (self.sum(class, 2 * node), self.sum(class, 2 * node + 1));
            // Rounding must not lead to where nothing is.
            if (left_over < left || right <= 0.0) && left > 0.0 {
                node *= 2;
            } else {
                left_over -= left;
                node = 2 * node + 1;
            }
        }
        Some(class.first_rank + node - class.leaves)
    }

    /// Leaves a transition out of this choice.
    pub(super) fn set_aside(&mut self, rank: usize) {
        if let Some(class) = self.class(rank) {
            let weight = self.sum(class, class.leaves + rank - class.first_rank);
            self.aside.push((rank, weight));
            self.set(rank, 0.0);
        }
    }

    /// The choice is made: whatever was left out counts again.
    pub(super) fn put_back(&mut self) {
        while let Some((rank, weight)) = self.aside.pop() {
            self.set(rank, weight);
        }
    }
}
