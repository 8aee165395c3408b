//! Tasks that wait for names: one line for each name. What is asked about one name takes no time for the others.

use std::collections::BTreeMap;

/// So many may wait before it is looked for the first time who has given up.
const FEW: usize = 32;

/// Those who wait, by the name that they wait for, and in the order in which they came.
pub(super) struct Lines<T> {
    waiting: BTreeMap<(String, u64), T>,
    came: u64,
    /// When so many wait, those who have given up are forgotten.
    crowded: usize,
}

impl<T> Default for Lines<T> {
    fn default() -> Self {
        Self {
            waiting: BTreeMap::new(),
            came: 0,
            crowded: FEW,
        }
    }
}

impl<T> Lines<T> {
    /// One more waits for `name`. Now and then those who have given up are forgotten.
    pub(super) fn push(&mut self, name: String, one: T, has_given_up: impl Fn(&T) -> bool) {
        if self.waiting.len() >= self.crowded {
            self.forget(has_given_up);
            // So each is looked at twice on the average, however many there are.
            self.crowded = (self.waiting.len() * 2).max(FEW);
        }
        self.waiting.insert((name, self.came), one);
        self.came += 1;
    }

    /// Forgets those who have given up.
    pub(super) fn forget(&mut self, has_given_up: impl Fn(&T) -> bool) {
        self.waiting.retain(|_, one| !has_given_up(one));
    }

    /// Takes out those who wait for `name`, in their order.
    pub(super) fn take(&mut self, name: &str) -> Vec<T> {
        let line = (name.to_owned(), 0)..=(name.to_owned(), u64::MAX);
        let taken = self.waiting.extract_if(line, |_, _| true);
        taken.map(|(_, one)| one).collect()
    }

    /// Takes out all, in the order in which they came.
    pub(super) fn take_all(&mut self) -> Vec<T> {
        let all = std::mem::take(&mut self.waiting).into_iter();
        let mut all: Vec<_> = all.map(|((_, came), one)| (came, one)).collect();
        all.sort_unstable_by_key(|(came, _)| *came);
        all.into_iter().map(|(_, one)| one).collect()
    }

    /// All, with the names that they wait for.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &T)> {
        let all = self.waiting.iter();
        all.map(|((name, _), one)| (name.as_str(), one))
    }

    /// Those who wait for `name`.
    pub(super) fn of<'l>(&'l self, name: &str) -> impl Iterator<Item = &'l T> + use<'l, T> {
        let line = (name.to_owned(), 0)..=(name.to_owned(), u64::MAX);
        self.waiting.range(line).map(|(_, one)| one)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn each_name_has_its_line_in_the_order_in_which_they_came() {
        let mut lines = Lines::default();
        for (number, name) in ["b", "a", "b", "ab", "a"].into_iter().enumerate() {
            lines.push(name.to_owned(), number, |_| false);
        }
        assert_eq!(lines.of("b").collect::<Vec<_>>(), [&0, &2]);
        assert_eq!(lines.take("a"), [1, 4]);
        assert_eq!(lines.take("a"), [0; 0]);
        assert_eq!(lines.take_all(), [0, 2, 3]);
        assert_eq!(lines.iter().count(), 0);
    }

    #[test]
    fn who_has_given_up_is_forgotten_and_each_is_looked_at_a_few_times_however_many_wait() {
        const COUNT: usize = 10_000;
        let looks = Cell::new(0);
        let mut lines = Lines::default();
        for number in 0..COUNT {
            lines.push("a".to_owned(), number, |one| {
                looks.set(looks.get() + 1);
                // All but every hundredth give up.
                one % 100 != 0
            });
        }
        assert!(lines.of("a").count() < COUNT / 20);
        assert!(looks.get() < 3 * COUNT, "{}", looks.get());
        lines.forget(|one| one % 100 != 0);
        assert_eq!(lines.of("a").count(), COUNT / 100);
        for number in 0..COUNT {
            lines.push("b".to_owned(), number, |_| {
                looks.set(looks.get() + 1);
                false
            });
        }
        assert!(looks.get() < 6 * COUNT, "{}", looks.get());
    }
}
