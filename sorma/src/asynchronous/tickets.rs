//! Answers that come later, each under the number of its ticket.

use super::answer::{begin, code};
use crate::later::Deferred;
use crate::raise;
use crate::report::Report;
use crate::request::Reply;
use std::collections::BTreeMap;

/// Answers that wait to be collected, and those that are still to come.
#[derive(Default)]
pub(super) struct Tickets {
    last: u64,
    open: BTreeMap<u64, (String, Deferred<Reply>)>,
}

impl Tickets {
    /// Whether one more would be too many.
    ///
    /// # Errors
    /// It would.
    pub(super) fn room(&self, capacity: i64) -> Result<(), Report> {
        if self.open.len() < usize::try_from(capacity).unwrap_or(0) {
            return Ok(());
        }
        let open = self.open.len();
        Err(raise!(
            code::FULL,
            "{open} answers wait to be collected already"
        ))
    }

    /// Takes the oldest answer that is there, to make room.
    pub(super) fn oldest_answer(&mut self) -> Option<Reply> {
        let mut open = self.open.iter_mut();
        let (number, reply) =
            open.find_map(|(number, (_, deferred))| Some((*number, deferred.try_collect()?)))?;
        self.open.remove(&number);
        Some(reply)
    }

    /// The ticket of an answer of that object.
    pub(super) fn add(&mut self, name: String, deferred: Deferred<Reply>) -> u64 {
        self.last += 1;
        self.open.insert(self.last, (name, deferred));
        self.last
    }

    fn find(&mut self, word: &str) -> Result<(u64, &mut Deferred<Reply>), Report> {
        let number: Option<u64> = word.parse().ok();
        let found = number.and_then(|number| {
            let (_, deferred) = self.open.get_mut(&number)?;
            Some((number, deferred))
        });
        found.ok_or_else(|| {
            raise!(
                code::UNKNOWN,
                "there is no ticket `{}`; it was collected or dropped, or never given",
                begin(word)
            )
        })
    }

    /// The answer, if it is there; its ticket is then no more.
    ///
    /// # Errors
    /// There is no such ticket.
    pub(super) fn collect(&mut self, word: &str) -> Result<Option<Reply>, Report> {
        let (number, deferred) = self.find(word)?;
        let reply = deferred.try_collect();
        if reply.is_some() {
            self.open.remove(&number);
        }
        Ok(reply)
    }

    /// Whether the answer is there.
    ///
    /// # Errors
    /// There is no such ticket.
    pub(super) fn is_ready(&mut self, word: &str) -> Result<bool, Report> {
        let (_, deferred) = self.find(word)?;
        Ok(deferred.is_ready())
    }

    /// Nobody wants the answer.
    ///
    /// # Errors
    /// There is no such ticket.
    pub(super) fn drop(&mut self, word: &str) -> Result<(), Report> {
        let (number, _) = self.find(word)?;
        self.open.remove(&number);
        Ok(())
    }

    /// The tickets with their objects, a line each.
    pub(super) fn lines(&self) -> String {
        let lines = self.open.iter();
        let lines = lines.map(|(ticket, (name, _))| format!("{ticket} {name}"));
        lines.collect::<Vec<_>>().join("\n")
    }

    pub(super) fn len(&self) -> usize {
        self.open.len()
    }
}
