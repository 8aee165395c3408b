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

    /// The symbol that can be read now.
    #[must_use]
    pub fn head(&self) -> Option<CommandId> {
        match self.current {
            Some(_) => None,
            None => self.waiting.front().map(|on_tape| on_tape.command),
        }
    }

    /// Gives every command on it the number that `renumbered` says.
    pub(super) fn renumber<E>(
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

    pub(super) fn read(&mut self) -> Option<u64> {
        self.current = self.waiting.pop_front();
        self.current.as_ref().map(|on_tape| on_tape.number)
    }

    /// Puts a command that was read back to the front, unless it has been answered.
    pub(super) fn unread(&mut self, number: u64) {
        if let Some(on_tape) = self.current.take_if(|on_tape| on_tape.number == number) {
            self.waiting.push_front(on_tape);
        }
    }

    /// Ends the command in progress if `answers` says that the symbol answers it.
    pub(super) fn answer(&mut self, answers: impl Fn(CommandId) -> bool) -> Option<u64> {
        self.current
            .take_if(|on_tape| answers(on_tape.command))
            .map(|on_tape| on_tape.number)
    }
}
