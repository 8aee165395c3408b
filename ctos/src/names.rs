//! The task identification service: which task has which symbolic name.
//!
//! One task for the whole app, on the chassis that boots it (the report's figure 4). Chassis remember
//! what they were told until the chassis of the task is gone.

use std::collections::BTreeMap;

use crate::{
    bootstrap::UsedSlots,
    context::Context,
    message::{Command, CommandInfo, Message, Tid},
    system::{QueryTid, RegisterTid},
    task::{EventHandler, Handled},
};

/// What the service takes.
pub(crate) const COMMANDS: [CommandInfo; 2] = [RegisterTid::INFO, QueryTid::INFO];

/// The service's state.
#[derive(Default)]
pub(crate) struct TidServer {
    names: BTreeMap<String, Tid>,
}

impl EventHandler for TidServer {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            RegisterTid::CODE => {
                let (RegisterTid { task }, reply) = message.open::<RegisterTid>()?;
                match self.names.get(&task.name) {
                    Some(tid) if *tid != task.tid => reply.fail(format!(
                        "the name `{}` belongs to task {tid} already",
                        task.name
                    )),
                    _ => {
                        if let Some(used) = cx.shared::<UsedSlots>(UsedSlots::KEY) {
                            used.note(task.tid);
                        }
                        self.names.insert(task.name, task.tid);
                        reply.ok(())
                    }
                }
            }
            QueryTid::CODE => {
                let (QueryTid { name }, reply) = message.open::<QueryTid>()?;
                let found = self.names.get(&name).copied();
                reply.ok(found.ok_or_else(|| self.names.keys().cloned().collect()))
            }
            _ => cx.default_processing(message),
        }
    }

    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let gone = cx.chassis();
        self.names
            .retain(|_, tid| gone.name_of(tid.chassis()) != chassis);
        Ok(())
    }
}
