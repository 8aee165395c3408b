//! The futures of a processor that are ready to be polled, in the order in which they became so. Any of them can be
//! taken out: a simulation draws which one comes next.

use std::collections::VecDeque;

/// So many stand in one piece. Taking one out moves the rest of its piece, and no others.
const PIECE: usize = 256;

/// A queue that can be left in the middle.
pub(super) struct Ready<T> {
    /// None is empty but the last, into which new ones come.
    pieces: VecDeque<VecDeque<T>>,
    len: usize,
}

impl<T> Default for Ready<T> {
    fn default() -> Self {
        Self {
            pieces: VecDeque::new(),
            len: 0,
        }
    }
}

impl<T> Ready<T> {
    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn push(&mut self, one: T) {
        self.len += 1;
        match self.pieces.back_mut() {
            Some(last) if last.len() < PIECE => last.push_back(one),
            _ => self.pieces.push_back(VecDeque::from([one])),
        }
    }

    /// Takes out the one at `index`, counted from the first; the others keep their order.
    pub(super) fn take(&mut self, index: usize) -> Option<T> {
        let mut left = index;
        let mut pieces = self.pieces.iter_mut().enumerate();
        let (number, piece) = pieces.find(|(_, piece)| {
            let here = left < piece.len();
            if !here {
                left -= piece.len();
            }
            here
        })?;
        let taken = piece.remove(left);
        if piece.is_empty() && self.pieces.len() > 1 {
            self.pieces.remove(number);
        }
        self.len -= 1;
        taken
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    impl<T> Ready<T> {
        /// How many places taking out the one at `index` looks at or moves.
        fn cost_of(&self, index: usize) -> usize {
            let mut before = 0;
            let piece = self.pieces.iter().position(|piece| {
                before += piece.len();
                index < before
            });
            piece.unwrap_or(0) + PIECE
        }
    }

    proptest! {
        #[test]
        fn it_does_what_a_plain_queue_does(
            steps in proptest::collection::vec((any::<bool>(), 1..600_usize, any::<prop::sample::Index>()), 0..20)
        ) {
            let (mut ready, mut model) = (Ready::default(), VecDeque::new());
            let mut next = 0;
            for (grows, count, index) in steps {
                for _ in 0..count {
                    if grows {
                        ready.push(next);
                        model.push_back(next);
                        next += 1;
                    } else {
                        let index = index.index(model.len() + 1);
                        prop_assert_eq!(ready.take(index), model.remove(index));
                    }
                    prop_assert_eq!(ready.len(), model.len());
                }
            }
            let rest = std::iter::from_fn(|| ready.take(0));
            prop_assert_eq!(rest.collect::<Vec<_>>(), Vec::from(model));
        }
    }

    #[test]
    fn taking_out_one_of_many_touches_few_of_them() {
        let mut ready = Ready::default();
        (0..100_000).for_each(|one| ready.push(one));
        let most = (0..100_000).map(|index| ready.cost_of(index)).max();
        assert!(most < Some(1000), "{most:?}");
        // Also when most of them have gone, from the front or from anywhere.
        for round in 0..99_000_usize {
            let index = round * 7919 % ready.len();
            assert!(ready.cost_of(index) < 1000);
            ready.take(index).unwrap();
        }
        assert!(ready.pieces.len() <= 1000);
    }
}
