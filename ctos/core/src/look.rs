//! Looking at a task without disturbing it.

use std::time::Duration;

use crate::{
    context::{Context, TaskRef},
    handled::HandlerError,
    last_messages::Note,
    report::TaskReport,
    system::{self, LookAt, NamesOf, Seen},
};
use ctos_time::Instant;

pub use crate::report::Ending;

/// How long whoever is asked may take.
const DEADLINE: Duration = Duration::from_secs(2);

/// A task that somebody looks at.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskLook {
    /// How it is.
    pub task: TaskReport,
    /// When what it says that it is at will be over, if it is known.
    pub until: Option<Instant>,
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
        let seen = self.call(&agent, ask).deadline(DEADLINE).await?;
        let Some(Seen { task, until, last }) = seen else {
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
            until,
            last: last.into_iter().zip(senders).map(told).collect(),
        })
    }

    /// The names of the senders of `notes`, one for each.
    async fn names_of(&self, notes: &[Note]) -> Result<Vec<String>, HandlerError> {
        let tids = notes.iter().map(|note| note.from).collect();
        let ask = NamesOf { tids };
        let names = self.call(&Self::server(), ask).deadline(DEADLINE).await?;
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
