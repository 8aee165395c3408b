//! A set of small numbers whose least member is found in a few steps however large it is.

/// Bits of one word.
const BITS: usize = 64;

/// Levels that any set needs: 64 to this power is more than can be numbered.
const MOST_LEVELS: usize = 6;

/// Level 0 has one bit per number; a bit of level n + 1 says whether a word of level n has any. The
/// levels stand one after the other.
#[derive(Debug, Clone)]
pub(crate) struct ReadySet {
    words: Vec<u64>,
    /// Where each level begins.
    begins: [usize; MOST_LEVELS],
    levels: usize,
}

impl ReadySet {
    /// An empty set for the numbers below `size`.
    pub(crate) fn new(size: usize) -> Self {
        let mut begins = [0; MOST_LEVELS];
        let mut total = 0;
        let mut levels = 0;
        let mut words = size.div_ceil(BITS).max(1);
        for begin in &mut begins {
            *begin = total;
            total += words;
            levels += 1;
            if words == 1 {
                break;
            }
            words = words.div_ceil(BITS);
        }
        Self {
            words: vec![0; total],
            begins,
            levels,
        }
    }

    /// Where the levels begin, from the lowest up.
    fn begins(&self) -> &[usize] {
        self.begins.get(..self.levels).unwrap_or(&[])
    }

    /// Adds a number.
    pub(crate) fn insert(&mut self, number: usize) {
        let mut bit = number;
        for level in 0..self.levels {
            let at = self.begins[level] + bit / BITS;
            let Some(word) = self.words.get_mut(at) else {
                return;
            };
            let before = *word;
            *word |= 1 << (bit % BITS);
            // A word that had any is already known above.
            if before != 0 {
                return;
            }
            bit /= BITS;
        }
    }

    pub(crate) fn remove(&mut self, number: usize) {
        let mut bit = number;
        for level in 0..self.levels {
            let at = self.begins[level] + bit / BITS;
            let Some(word) = self.words.get_mut(at) else {
                return;
            };
            *word &= !(1 << (bit % BITS));
            if *word != 0 {
                return;
            }
            bit /= BITS;
        }
    }

    /// The least member.
    pub(crate) fn first(&self) -> Option<usize> {
        let mut found = 0;
        for begin in self.begins().iter().rev() {
            let word = *self.words.get(begin + found)?;
            if word == 0 {
                return None;
            }
            found = found * BITS + word.trailing_zeros() as usize;
        }
        Some(found)
    }

    /// The least member that is not below `from`.
    pub(crate) fn next(&self, from: usize) -> Option<usize> {
        let begins = self.begins();
        let mut bit = from;
        // Up, until a word has a member at or after the bit; then down along least members.
        for (height, begin) in begins.iter().enumerate() {
            let end = begins.get(height + 1).copied().unwrap_or(self.words.len());
            let level = self.words.get(*begin..end)?;
            let word = level.get(bit / BITS)? & (u64::MAX << (bit % BITS));
            if word != 0 {
                let mut found = bit / BITS * BITS + word.trailing_zeros() as usize;
                for lower in begins.iter().take(height).rev() {
                    let below = self.words.get(lower + found)?;
                    found = found * BITS + below.trailing_zeros() as usize;
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
                prop_assert_eq!(ours.first(), theirs.first().copied());
                prop_assert_eq!(ours.next(number), theirs.range(number..).next().copied());
            }
        }
    }
}
