//! A line of those who wait: each has a number and a deadline, and is served in order when it asks.

use ctos::time::Instant;
use std::collections::VecDeque;

/// The most that may wait for one thing at once.
const MOST: usize = 10_000;

/// Those who wait, the first first.
#[derive(Debug, Clone)]
pub(super) struct Tickets<T> {
    last: u64,
    waiting: VecDeque<Ticket<T>>,
}

#[derive(Debug, Clone)]
struct Ticket<T> {
    number: u64,
    until: Instant,
    who: T,
}

/// What becomes of somebody who asks with a ticket.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Turn<T> {
    /// The asker is served, and the ticket is used up.
    Now(T),
    /// Others come first, or there is nothing to have.
    NotYet,
    /// There is no such ticket: used, given up, or too late.
    None,
}

impl<T> Default for Tickets<T> {
    fn default() -> Self {
        Self {
            last: 0,
            waiting: VecDeque::new(),
        }
    }
}

impl<T> Tickets<T> {
    /// A number for somebody who wants to wait until `until`; `None` when the line is too long.
    pub(super) fn draw(&mut self, who: T, until: Instant) -> Option<u64> {
        if self.waiting.len() >= MOST {
            return None;
        }
        self.last += 1;
        let number = self.last;
        self.waiting.push_back(Ticket { number, until, who });
        Some(number)
    }

    /// Somebody asks with his ticket, when so many may be served.
    pub(super) fn ask(&mut self, number: u64, available: usize) -> Turn<T> {
        let place = self.waiting.iter().position(|one| one.number == number);
        match place {
            None => Turn::None,
            Some(place) if place < available => match self.waiting.remove(place) {
                Some(ticket) => Turn::Now(ticket.who),
                None => Turn::None,
            },
            Some(_) => Turn::NotYet,
        }
    }

    /// Strikes out those who are too late, and those that `is_gone`.
    pub(super) fn lapse(&mut self, now: Instant, is_gone: impl Fn(&T) -> bool) {
        self.waiting
            .retain(|ticket| now < ticket.until && !is_gone(&ticket.who));
    }

    /// How many wait.
    pub(super) fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Those who wait, in their order.
    pub(super) fn iter(&self) -> impl Iterator<Item = (u64, &T)> {
        self.waiting
            .iter()
            .map(|ticket| (ticket.number, &ticket.who))
    }
}
