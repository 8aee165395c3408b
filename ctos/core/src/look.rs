//! Looking at a task without disturbing it.

use std::time::Duration;

use crate::{
    context::{Context, TaskRef},
    handled::HandlerError,
    last_messages::{LastMessage, TaskLook},
    system::{self, LookAt, NamesOf},
};
/// How long an asked task may take.
const DEADLINE: Duration = Duration::from_secs(2);

impl Context {
    /// Looks at a task without disturbing it: one that is busy, or stuck, is seen as well as one that is idle.
    /// Its last messages are kept from the first look on, but for those of the commands `without`. What comes
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
        let looked = self.call(&agent, ask).deadline(DEADLINE).await?;
        let Some(mut look) = looked else {
            return Err(HandlerError::new(format!("`{}` has ended", task.name())));
        };
        self.name_senders(&mut look.last).await?;
        Ok(look)
    }

    async fn name_senders(&self, messages: &mut [LastMessage]) -> Result<(), HandlerError> {
        let tids = messages.iter().map(|message| message.sender).collect();
        let ask = NamesOf { tids };
        let names = self.call(&Self::server(), ask).deadline(DEADLINE).await?;
        for (message, name) in messages.iter_mut().zip(names) {
            let sender = message.sender;
            message.from = match name {
                Some(name) => name,
                None if sender.processor() == 0 => {
                    format!("runtime of {}", self.chassis().name_of(sender.chassis()))
                }
                None => sender.to_string(),
            };
        }
        Ok(())
    }
}
