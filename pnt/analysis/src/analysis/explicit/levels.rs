//! Which markings, by number, are how far from the initial one. Threads give numbers of their own, so
//! those of one level are several ranges, and some numbers are nobody's.

use std::ops::Range;

/// Numbers of one level.
#[derive(Debug, Clone)]
struct Span {
    numbers: Range<u32>,
    level: u32,
}

/// All levels.
#[derive(Debug, Clone, Default)]
pub(in crate::analysis) struct Levels {
    /// By number.
    spans: Vec<Span>,
    markings: usize,
}

impl Levels {
    /// These numbers are of this level; they are of no other.
    pub(super) fn add(&mut self, level: usize, numbers: Range<u32>) {
        self.markings += numbers.len();
        // There are fewer levels than markings.
        let level = level as u32;
        // Nearly always the last: numbers are given upwards, but for what a thread had left.
        let at = self
            .spans
            .partition_point(|span| span.numbers.start < numbers.start);
        let before = at.checked_sub(1).and_then(|at| self.spans.get_mut(at));
        match before {
            Some(span) if span.level == level && span.numbers.end == numbers.start => {
                span.numbers.end = numbers.end;
            }
            _ => self.spans.insert(at, Span { numbers, level }),
        }
    }

    /// Markings of all levels.
    pub(super) fn markings(&self) -> usize {
        self.markings
    }

    /// The level of a number; `None` when it is of none.
    pub(in crate::analysis) fn of(&self, number: u32) -> Option<usize> {
        let at = self
            .spans
            .partition_point(|span| span.numbers.start <= number);
        let span = self.spans.get(at.checked_sub(1)?)?;
        (number < span.numbers.end).then_some(span.level as usize)
    }

    /// The numbers of a level.
    pub(super) fn level(&self, level: usize) -> impl Iterator<Item = u32> {
        let spans = self.spans.iter();
        spans
            .filter(move |span| span.level as usize == level)
            .flat_map(|span| span.numbers.clone())
    }

    /// All numbers, upwards.
    pub(in crate::analysis) fn numbers(&self) -> impl Iterator<Item = u32> {
        self.spans.iter().flat_map(|span| span.numbers.clone())
    }

    /// All numbers with their levels, the nearest first.
    pub(in crate::analysis) fn nearest_first(&self) -> impl Iterator<Item = (usize, u32)> {
        let mut spans = self.spans.clone();
        spans.sort_by_key(|span| span.level);
        let each = |span: Span| {
            let level = span.level as usize;
            span.numbers.map(move |number| (level, number))
        };
        spans.into_iter().flat_map(each)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_nobody_gave_are_of_no_level() {
        let mut levels = Levels::default();
        levels.add(0, 0..1);
        levels.add(1, 4..6);
        levels.add(1, 1..3);
        levels.add(2, 6..7);
        levels.add(2, 7..9);
        let of: Vec<_> = (0..10).map(|number| levels.of(number)).collect();
        let (one, two) = (Some(1), Some(2));
        assert_eq!(of, [Some(0), one, one, None, one, one, two, two, two, None]);
        assert_eq!(levels.markings(), 8);
        assert_eq!(levels.level(1).collect::<Vec<_>>(), [1, 2, 4, 5]);
        let mut spans = Levels::default();
        spans.add(1, 0..2);
        spans.add(0, 2..3);
        let nearest: Vec<_> = spans.nearest_first().collect();
        assert_eq!(nearest, [(0, 2), (1, 0), (1, 1)]);
    }
}
