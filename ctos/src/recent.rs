//! The last messages of a task: who sent them, when they were begun, what became of them.
//!
//! Nothing is kept of a task before somebody has looked at it: until then a message costs one load.

use std::{
    collections::VecDeque,
    sync::{Mutex, OnceLock},
    time::Duration,
};

use serde::{Deserialize, Serialize};

use crate::{
    call::lock,
    chassis::Chassis,
    command,
    context::{Context, TaskRef},
    message::Tid,
    survey::{self, TaskReport},
    system::{self, NamesOf},
    task::HandlerError,
    time::Instant,
};

pub use crate::record::Ending;

/// So many messages of a task are kept.
const KEPT: usize = 16;

/// How long whoever is asked may take.
const LIMIT: Duration = Duration::from_secs(2);

command! {
    /// Asks an agent how a task is and what it handled last; from then on that is kept, without messages of
    /// the commands `without`.
    pub(crate) struct LookAt { pub(crate) task: Tid, pub(crate) without: Vec<u16> } => Option<Seen>, 0xff58, "look_at"
}

/// What an agent tells of a task of its chassis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Seen {
    task: TaskReport,
    last: Vec<Note>,
}

/// A task that somebody looks at.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskLook {
    /// How it is.
    pub task: TaskReport,
    /// The moment at which it was so.
    pub now: Instant,
    /// The messages that it handled last, oldest first; the one at hand too. Those of before anybody looked at
    /// it are not known.
    pub last: Vec<LastMessage>,
}

/// A message that a task handled, or handles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LastMessage {
    /// Who sent it.
    pub from: String,
    /// The command's name; its code, where the task's handler does not declare it.
    pub command: String,
    /// When the handler was called.
    pub began: Instant,
    /// How long the handler took and how it ended; `None` while it has not.
    pub ended: Option<(Duration, Ending)>,
}

/// The short form of a message.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Note {
    from: Tid,
    command: u16,
    named: String,
    began: Instant,
    ended: Option<(Duration, Ending)>,
}

/// The last messages of one task, once somebody has looked at it.
#[derive(Debug, Default)]
pub(crate) struct Recent(OnceLock<Box<Mutex<Kept>>>);

#[derive(Debug, Default)]
struct Kept {
    without: Vec<u16>,
    notes: VecDeque<Note>,
}

impl Kept {
    fn push(&mut self, note: Note) {
        if self.notes.len() == KEPT {
            self.notes.pop_front();
        }
        self.notes.push_back(note);
    }
}

impl Recent {
    /// What is kept, which begins with the first call.
    fn look(&self, without: &[u16]) -> Vec<Note> {
        let mut kept = lock(self.0.get_or_init(Box::default));
        for command in without {
            if !kept.without.contains(command) {
                kept.without.push(*command);
            }
        }
        kept.notes.iter().cloned().collect()
    }

    /// The handler is called with a message of `from`.
    #[inline]
    pub(crate) fn began(&self, from: Tid, command: u16, began: Instant) {
        if let Some(kept) = self.0.get() {
            let mut kept = lock(kept);
            if !kept.without.contains(&command) {
                kept.push(Note {
                    from,
                    command,
                    named: String::new(),
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
            let open = kept.notes.back_mut().filter(|note| note.ended.is_none());
            if let Some(note) = open.filter(|note| note.command == command) {
                note.ended = Some((now.since(note.began), ending()));
            }
        }
    }
}

/// How the task `tid` of `chassis` is.
pub(crate) fn seen(chassis: &Chassis, tid: Tid, without: &[u16]) -> Option<Seen> {
    let record = chassis.task(tid)?;
    let mut last = record.statistics.activity().recent.look(without);
    let task = survey::of_task(chassis, &record);
    for note in &mut last {
        note.named = survey::command_name(chassis, &task.handler, note.command);
    }
    Some(Seen { task, last })
}

impl Context {
    /// Looks at a task without disturbing it: one that is busy, or stuck, is seen as well as one that is idle.
    /// Its last messages are kept from the first look on, but for those of the commands `without`: what comes
    /// often because somebody looks on would hide everything else.
    ///
    /// # Errors
    /// The task has ended, or its chassis does not answer.
    pub async fn look_at(&self, task: &TaskRef, without: &[u16]) -> Result<TaskLook, HandlerError> {
        let tid = self.chassis().directory.current(task.tid());
        let agent = TaskRef::new("agent", system::agent_tid(tid.chassis()));
        let ask = LookAt {
            task: tid,
            without: without.to_vec(),
        };
        let seen = self.call(&agent, ask).deadline(LIMIT).await?;
        let Some(Seen { task, last }) = seen else {
            return Err(HandlerError::new(format!("`{}` has ended", task.name())));
        };
        let senders = self.names_of(&last).await?;
        let told = |(note, from): (Note, String)| LastMessage {
            from,
            command: note.named,
            began: note.began,
            ended: note.ended,
        };
        Ok(TaskLook {
            task,
            now: self.now(),
            last: last.into_iter().zip(senders).map(told).collect(),
        })
    }

    /// The names of the senders of `notes`, one for each.
    async fn names_of(&self, notes: &[Note]) -> Result<Vec<String>, HandlerError> {
        let tids = notes.iter().map(|note| note.from).collect();
        let ask = NamesOf { tids };
        let names = self.call(&Self::server(), ask).deadline(LIMIT).await?;
        let name = |(name, note): (Option<String>, &Note)| match name {
            Some(name) => name,
            None if note.from.processor() == 0 => {
                format!("runtime of {}", self.chassis().name_of(note.from.chassis()))
            }
            None => note.from.to_string(),
        };
        Ok(names.into_iter().zip(notes).map(name).collect())
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
        // The end of a message that was begun before is no message.
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
        assert!(
            kept.iter()
                .all(|note| note.command == 1 && note.ended == end)
        );
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
