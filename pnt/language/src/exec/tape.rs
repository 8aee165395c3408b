//! The input tape: commands in the order they were put. One command is in progress at a time; the
//! next becomes readable when its answer is on the output tape, as the analysis assumes.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::net::CommandId;

/// A command on the tape.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OnTape {
    /// Its number, counted from the start of the execution.
    pub number: u64,
    /// Which command.
    pub command: CommandId,
    /// What came with it.
    pub arguments: Vec<String>,
}

/// The input tape of one net.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tape {
    waiting: VecDeque<OnTape>,
    current: Option<OnTape>,
    put: u64,
}

impl Tape {
    /// The command that has been read and not answered.
    #[must_use]
    pub fn current(&self) -> Option<&OnTape> {
        self.current.as_ref()
    }

    /// Commands that have not been read, next one first.
    pub fn waiting(&self) -> impl Iterator<Item = &OnTape> {
        self.waiting.iter()
    }

    /// How many commands have not been read.
    #[must_use]
    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Whether all commands have been read.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// The symbol that can be read now.
    #[must_use]
    pub fn head(&self) -> Option<CommandId> {
        match self.current {
            Some(_) => None,
            None => self.waiting.front().map(|on_tape| on_tape.command),
        }
    }

    /// Whether the tape is one that puts and reads could have made, of commands below `commands`.
    pub(super) fn is_sound(&self, commands: usize, most: u64) -> bool {
        let numbers = self.current.iter().chain(&self.waiting);
        let known = |on_tape: &OnTape| on_tape.command.index() < commands;
        self.put <= most
            && numbers
                .clone()
                .all(|on_tape| known(on_tape) && on_tape.number < self.put)
            && numbers.is_sorted_by(|a, b| a.number < b.number)
    }

    /// Gives every command on it the number that `renumbered` says.
    ///
    /// # Errors
    /// That of `renumbered`.
    pub fn renumber<E>(
        &mut self,
        mut renumbered: impl FnMut(CommandId) -> Result<CommandId, E>,
    ) -> Result<(), E> {
        for on_tape in self.waiting.iter_mut().chain(&mut self.current) {
            on_tape.command = renumbered(on_tape.command)?;
        }
        Ok(())
    }

    pub(super) fn put(&mut self, command: CommandId, arguments: Vec<String>) -> u64 {
        let number = self.put;
        self.put += 1;
        self.waiting.push_back(OnTape {
            number,
            command,
            arguments,
        });
        number
    }

    /// Removes commands that have not been read, but for those that `keeps` says.
    pub(super) fn retain_waiting(&mut self, mut keeps: impl FnMut(u64) -> bool) {
        self.waiting.retain(|on_tape| keeps(on_tape.number));
    }

    pub(super) fn read(&mut self) -> Option<u64> {
        self.current = self.waiting.pop_front();
        self.current.as_ref().map(|on_tape| on_tape.number)
    }

    /// Puts a command that was read back to the front, unless it has been answered.
    /// Says whether it did.
    pub(super) fn unread(&mut self, number: u64) -> bool {
        let current = self.current.take_if(|on_tape| on_tape.number == number);
        let is_back = current.is_some();
        if let Some(on_tape) = current {
            self.waiting.push_front(on_tape);
        }
        is_back
    }

    /// Ends the command in progress if `answers` says that the symbol answers it.
    pub(super) fn answer(&mut self, answers: impl Fn(CommandId) -> bool) -> Option<u64> {
        self.current
            .take_if(|on_tape| answers(on_tape.command))
            .map(|on_tape| on_tape.number)
    }
}
