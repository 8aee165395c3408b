//! The last messages of a task: who sent them, when they were begun, what became of them.
//!
//! Nothing is kept of a task before somebody has looked at it: until then a message costs one load.

use std::{
    collections::VecDeque,
    sync::{Mutex, OnceLock},
    time::Duration,
};

use serde::{Deserialize, Serialize};

use crate::report::{Ending, TaskReport};
use ctos_message::Tid;
use ctos_time::{Instant, lock::lock};

/// So many messages of a task are kept.
const KEPT: usize = 16;

/// A message that a task handled, or handles.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LastMessage {
    /// Who sent it.
    pub from: String,
    /// Its id.
    pub(crate) sender: Tid,
    /// The command's name; its code, where the task's handler does not declare it.
    pub command: String,
    /// The command's code.
    pub code: u16,
    /// When the handler was called.
    pub began: Instant,
    /// How long the handler took and how it ended; `None` while it has not.
    pub ended: Option<(Duration, Ending)>,
}

/// A task that somebody looks at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskLook {
    /// How it is.
    pub task: TaskReport,
    /// When what it says that it is at will be over, if it is known.
    pub until: Option<Instant>,
    /// The messages that it handled last, oldest first; the one at hand too. Those of before anybody looked at
    /// it are not known.
    pub last: Vec<LastMessage>,
}

/// The last messages of one task, once somebody has looked at it.
#[derive(Debug, Default)]
pub struct Recent(OnceLock<Box<Mutex<Kept>>>);

#[derive(Debug, Default)]
struct Kept {
    without: Vec<u16>,
    messages: VecDeque<LastMessage>,
}

impl Kept {
    fn push(&mut self, message: LastMessage) {
        if self.messages.len() == KEPT {
            self.messages.pop_front();
        }
        self.messages.push_back(message);
    }
}

impl Recent {
    /// What is kept, which begins with the first call. Names are not known here.
    pub fn look(&self, without: &[u16]) -> Vec<LastMessage> {
        let mut kept = lock(self.0.get_or_init(Box::default));
        for command in without {
            if !kept.without.contains(command) {
                kept.without.push(*command);
            }
        }
        kept.messages.iter().cloned().collect()
    }

    /// The handler is called with a message of `from`.
    #[inline]
    pub(crate) fn began(&self, from: Tid, command: u16, began: Instant) {
        if let Some(kept) = self.0.get() {
            let mut kept = lock(kept);
            if !kept.without.contains(&command) {
                kept.push(LastMessage {
                    from: String::new(),
                    sender: from,
                    command: String::new(),
                    code: command,
                    began,
                    ended: None,
                });
            }
        }
    }

    /// The handler has returned from the message that was begun last.
    #[inline]
    pub(crate) fn ended(&self, command: u16, now: Instant, ending: impl FnOnce() -> Ending) {
        if let Some(kept) = self.0.get() {
            let mut kept = lock(kept);
            // One that was begun before anybody looked is not there.
            let open = kept
                .messages
                .back_mut()
                .filter(|message| message.ended.is_none());
            if let Some(message) = open.filter(|message| message.code == command) {
                message.ended = Some((now.since(message.began), ending()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FROM: Tid = Tid::new(1, 1, 7);

    fn at(nanos: u64) -> Instant {
        Instant::from_nanos(nanos)
    }

    #[test]
    fn nothing_is_kept_before_somebody_looks_and_no_more_than_the_last_ones_after() {
        let recent = Recent::default();
        recent.began(FROM, 1, at(1));
        assert!(recent.look(&[9]).is_empty());
        // The end of a message that was begun before is not a message.
        recent.ended(1, at(2), || Ending::Done);
        assert!(recent.look(&[]).is_empty());
        for count in 0..100 {
            recent.began(FROM, 1, at(10 * count));
            recent.ended(1, at(10 * count + 3), || Ending::Done);
            recent.began(FROM, 9, at(10 * count + 4));
            recent.ended(9, at(10 * count + 5), || Ending::Stopped);
        }
        let kept = recent.look(&[]);
        assert_eq!(kept.len(), KEPT);
        let end = Some((Duration::from_nanos(3), Ending::Done));
        assert!(kept.iter().all(|note| note.code == 1 && note.ended == end));
        assert_eq!(kept.last().map(|note| note.began), Some(at(990)));
    }

    #[test]
    fn the_message_at_hand_is_open_until_its_handler_returns() {
        let recent = Recent::default();
        recent.look(&[]);
        recent.began(FROM, 4, at(5));
        assert_eq!(recent.look(&[])[0].ended, None);
        recent.ended(4, at(25), || Ending::Refused("no".to_owned()));
        let end = Some((Duration::from_nanos(20), Ending::Refused("no".to_owned())));
        assert_eq!(recent.look(&[])[0].ended, end);
    }
}
