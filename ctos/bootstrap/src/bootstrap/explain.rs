//! Why a task did not do in time what it was asked, to acknowledge a startup phase or to come to rest: what it
//! waits for, as far as its chassis can tell.

use std::time::Duration;

use ctos_core::{
    context::{Context, TaskRef},
    report::TaskReport,
    system::{self, Survey, TaskName},
};
use ctos_message::fault::{CallError, Fault};
use ctos_time::Instant;

/// How long the agent of a chassis may take to tell.
pub(super) const TIMEOUT: Duration = Duration::from_secs(1);

/// Why `task` did not do what it was `asked`, in words.
pub(super) async fn explained(
    cx: &Context,
    task: &TaskName,
    asked: &str,
    error: CallError,
) -> String {
    let Fault::Deadline { after } = error.fault else {
        return error.reason();
    };
    let late = format!(
        "`{}` did not {asked} within {:.3} s",
        task.name,
        after.as_secs_f64()
    );
    let agent = TaskRef::new("agent", system::agent_tid(task.tid.chassis()));
    let Ok(report) = cx.call(&agent, Survey {}).deadline(TIMEOUT).await else {
        let chassis = cx.chassis().name_of(task.tid.chassis());
        return format!("{late}; its chassis `{chassis}` does not answer either");
    };
    let found = report.tasks.iter().find(|one| one.tid == task.tid);
    match found {
        Some(found) => format!("{late}: {}", doing(found, report.now)),
        None => format!("{late}: it has ended"),
    }
}

/// What a task does at `now`, in words.
pub(crate) fn doing(task: &TaskReport, now: Instant) -> String {
    let seconds = |since: Instant| now.since(since).as_secs_f64();
    if let Some(wait) = task.waits.first() {
        return format!(
            "it waits for the reply of `{}` to `{}` for {:.1} s",
            wait.to,
            wait.command,
            seconds(wait.since)
        );
    }
    let command = task.command.as_deref().unwrap_or("a message");
    match task.counters.began {
        Some(began) => format!(
            "it has been at `{command}` for {:.1} s and waits for no task: it sleeps, waits for hardware, or does not come to an end",
            seconds(began)
        ),
        None => {
            "it has not begun: its processor is busy with another task that does not come to an end"
                .to_owned()
        }
    }
}
