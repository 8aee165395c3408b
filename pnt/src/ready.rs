//! A set of small numbers whose least member is found in a few steps however large it is.

/// Bits of one word.
const BITS: usize = 64;

/// Level 0 has one bit per number; a bit of level n + 1 says whether a word of level n has any.
#[derive(Debug, Clone)]
pub(crate) struct ReadySet {
    levels: Vec<Vec<u64>>,
}

impl ReadySet {
    /// An empty set for the numbers below `size`.
    pub(crate) fn new(size: usize) -> Self {
        let mut levels = Vec::new();
        let mut words = size.div_ceil(BITS).max(1);
        loop {
            levels.push(vec![0; words]);
            if words == 1 {
                return Self { levels };
            }
            words = words.div_ceil(BITS);
        }
    }

    /// Adds a number.
    pub(crate) fn insert(&mut self, number: usize) {
        let mut bit = number;
        for level in &mut self.levels {
            if let Some(word) = level.get_mut(bit / BITS) {
                *word |= 1 << (bit % BITS);
            }
            bit /= BITS;
        }
    }

    /// Removes a number.
    pub(crate) fn remove(&mut self, number: usize) {
        let mut bit = number;
        for level in &mut self.levels {
            let Some(word) = level.get_mut(bit / BITS) else {
                return;
            };
            *word &= !(1 << (bit % BITS));
            if *word != 0 {
                return;
            }
            bit /= BITS;
        }
    }

    /// The least member that is not below `from`.
    pub(crate) fn next(&self, from: usize) -> Option<usize> {
        let mut bit = from;
        // Up, until a word has a member at or after the bit; then down along least members.
        for (height, level) in self.levels.iter().enumerate() {
            let word = level.get(bit / BITS)? & (u64::MAX << (bit % BITS));
            if word != 0 {
                let mut found = bit / BITS * BITS + word.trailing_zeros() as usize;
                for lower in self.levels.iter().take(height).rev() {
                    found = found * BITS + lower.get(found)?.trailing_zeros() as usize;
                }
                return Some(found);
            }
            bit = bit / BITS + 1;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_agrees_with_an_ordered_set(
            size in 1_usize..9000,
            steps in prop::collection::vec((any::<bool>(), any::<prop::sample::Index>()), 0..200),
        ) {
            let mut ours = ReadySet::new(size);
            let mut theirs = BTreeSet::new();
            for (add, index) in steps {
                let number = index.index(size);
                if add {
                    ours.insert(number);
                    theirs.insert(number);
                } else {
                    ours.remove(number);
                    theirs.remove(&number);
                }
                prop_assert_eq!(ours.next(0), theirs.first().copied());
                prop_assert_eq!(ours.next(number), theirs.range(number..).next().copied());
            }
        }
    }
}
