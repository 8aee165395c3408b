//! Why a task has not acknowledged a startup phase, or not come to rest, in time. It says what the task
//! waits for, as far as the task's chassis can tell.

use std::time::Duration;

use ctos_core::{
    context::{Context, TaskRef},
    report::TaskReport,
    system::{self, Survey},
};
use ctos_message::fault::{CallError, Fault};

/// How long the agent of a chassis may take to tell.
pub(super) const TIMEOUT: Duration = Duration::from_secs(1);

/// Why `task` did not do what it was `asked`, in words.
pub(super) async fn explained(
    cx: &Context,
    task: &TaskRef,
    asked: &str,
    error: CallError,
) -> String {
    let Fault::Deadline { after } = error.fault else {
        return error.reason();
    };
    let late = format!(
        "`{}` did not {asked} within {:.3} s",
        task.name(),
        after.as_secs_f64()
    );
    let agent = TaskRef::new("agent", system::agent_tid(task.tid().chassis()));
    let Ok(report) = cx.call(&agent, Survey {}).deadline(TIMEOUT).await else {
        let chassis = cx.chassis().name_of(task.tid().chassis());
        return format!("{late}; its chassis `{chassis}` does not answer either");
    };
    let mut tasks = report.tasks.iter();
    match tasks.find(|(tid, _)| *tid == task.tid()) {
        Some((_, found)) => format!("{late}: {}", doing(found)),
        None => format!("{late}: it has ended"),
    }
}

/// What a task does, in words.
pub(crate) fn doing(task: &TaskReport) -> String {
    if let Some(wait) = task.waits.first() {
        return format!(
            "it waits for the reply of `{}` to `{}` for {:.1} s",
            wait.to, wait.command, wait.for_s
        );
    }
    let command = task.command.as_deref().unwrap_or("a message");
    match task.in_handler_s {
        Some(time_s) => format!(
            "it has been at `{command}` for {time_s:.1} s and waits for no task: it sleeps, waits for hardware, or does not come to an end"
        ),
        None => {
            "it has not begun: its processor is busy with another task that does not come to an end"
                .to_owned()
        }
    }
}
