//! Puts together what a client sees of an app: the bootstrap service's view of the chassis, and each
//! agent's view of its tasks. A chassis that does not answer delays nobody for long.

use std::{sync::Arc, time::Duration};

use futures_util::future::join_all;

use crate::control::{
    LogStore,
    protocol::{Activity, AppView, ChassisView, TaskView, WaitView},
};
use ctos_bootstrap::bootstrap::{AppReport, MemberReport, Overview};
use ctos_bootstrap::refusals::Refusals;
use ctos_core::{
    chassis::Chassis,
    envelope::Message,
    report::{ChassisReport, TaskReport},
    system::{self, Survey},
    tap::WaitFor,
};
use ctos_message::{Command, Data, Flags, Tid, fault::Fault};
use ctos_time::Instant;

/// How long a chassis may take to tell about its tasks.
const TIMEOUT: Duration = Duration::from_millis(500);

/// Sends a task bytes from outside of any task; the bytes that it answers.
pub(super) async fn ask_raw(
    chassis: &Arc<Chassis>,
    to: Tid,
    (command, data): (u16, Vec<u8>),
    timeout: Duration,
) -> Result<Vec<u8>, Fault> {
    let from = system::agent_tid(chassis.index());
    let message = Message::with_data(to, from, command, Data::Bytes(data));
    let message = message.in_trace(chassis.fresh_trace());
    let data = sent(chassis, message, timeout).await?;
    data.into_bytes().map_err(unreadable)
}

/// Asks a task from outside of any task.
pub(crate) async fn ask<C: Command>(
    chassis: &Arc<Chassis>,
    to: Tid,
    request: C,
    timeout: Duration,
) -> Result<C::Reply, Fault> {
    let from = system::agent_tid(chassis.index());
    let message = Message::request(to, from, C::CODE, request);
    let data = sent(chassis, message, timeout).await?;
    data.take::<C::Reply>().map_err(unreadable)
}

async fn sent(chassis: &Arc<Chassis>, message: Message, timeout: Duration) -> Result<Data, Fault> {
    let message = message
        .flagged(Flags::HIGH_PRIORITY)
        .until(Some(chassis.clock.now() + timeout));
    let answer = tokio::time::timeout(timeout, chassis.dispatch(message, WaitFor::Reply)).await;
    answer.map_err(|_| Fault::Deadline { after: timeout })?
}

fn unreadable(error: impl ToString) -> Fault {
    Fault::BadPayload {
        text: error.to_string(),
    }
}

/// The app as it is now.
pub(crate) async fn app(chassis: &Arc<Chassis>, logs: &LogStore) -> Result<AppView, Fault> {
    let AppReport {
        state,
        now,
        chassis: members,
    } = ask(chassis, system::BOOTSTRAP, Overview {}, TIMEOUT).await?;
    let app = &chassis.app;
    let mut view = AppView {
        app: app.name.clone(),
        file: app.file.display().to_string(),
        pid: std::process::id(),
        state,
        up_s: now.since_start().as_secs_f64(),
        chassis: Vec::new(),
        tasks: Vec::new(),
        refused: Refusals::of(chassis).count(),
    };
    for (member, survey) in members.into_iter().zip(surveys(chassis).await) {
        view.refused += survey.as_ref().map_or(0, |survey| survey.refused);
        view.tasks
            .extend(task_views(chassis, &member, survey.as_ref(), logs));
        let answers = survey.is_some();
        let (pid, processors, records) = match survey {
            Some(survey) => (Some(survey.pid), survey.processors, survey.records),
            None => (logs.pid(&member.name), Vec::new(), Vec::new()),
        };
        view.chassis.push(ChassisView {
            host: app.host_of(&member.name).map(|host| host.name.clone()),
            name: member.name,
            pid,
            state: member.state,
            since_s: now.since(member.since).as_secs_f64(),
            restarts: member.incarnation.saturating_sub(1),
            last_end: member.last_end,
            answers,
            processors,
            tasks: member.tasks.len(),
            records,
        });
    }
    Ok(view)
}

/// What each chassis tells about itself, in declared order; nothing, where one does not answer.
pub(super) async fn surveys(chassis: &Arc<Chassis>) -> Vec<Option<ChassisReport>> {
    let surveys = (1..)
        .zip(&chassis.app.chassis)
        .map(|(index, _)| async move {
            let agent = system::agent_tid(index);
            ask(chassis, agent, Survey {}, TIMEOUT).await.ok()
        });
    join_all(surveys).await
}

/// The tasks of a chassis: as it tells them, or as they were declared when it does not answer.
fn task_views(
    chassis: &Chassis,
    member: &MemberReport,
    survey: Option<&ChassisReport>,
    logs: &LogStore,
) -> Vec<TaskView> {
    match survey {
        Some(survey) => survey
            .tasks
            .iter()
            // Those of the runtime are nobody's concern here.
            .filter(|task| task.tid.processor() > 0)
            .map(|task| task_view(&member.name, survey, task))
            .collect(),
        None => {
            let declared = chassis.app.tasks.iter();
            declared
                .filter(|task| task.chassis == member.name)
                .map(|task| TaskView {
                    name: task.name.clone(),
                    chassis: member.name.clone(),
                    processor: task.processor.clone(),
                    handler: task.handler.clone(),
                    pid: logs.pid(&member.name),
                    capacity: task.queue as u64,
                    ..TaskView::default()
                })
                .collect()
        }
    }
}

fn task_view(chassis: &str, survey: &ChassisReport, task: &TaskReport) -> TaskView {
    let now = survey.now;
    let seconds = |since: Instant| now.since(since).as_secs_f64();
    let counters = &task.counters;
    let in_handler_s = counters.began.map(seconds);
    TaskView {
        name: task.name.clone(),
        chassis: chassis.to_owned(),
        processor: task.processor.clone(),
        handler: task.handler.clone(),
        pid: Some(survey.pid),
        activity: match (task.waits.is_empty(), in_handler_s) {
            (false, _) => Activity::Waits,
            (true, Some(_)) => Activity::Busy,
            (true, None) => Activity::Idle,
        },
        phase: counters.phase,
        phase_s: task.phase_since.map_or(0.0, seconds),
        handled: counters.handled,
        failed: counters.failed,
        // What the message at hand has taken so far counts too, and what synchronous functions took.
        busy_s: (counters.busy + task.cyclic).as_secs_f64() + in_handler_s.unwrap_or(0.0),
        longest_s: counters.longest.as_secs_f64(),
        in_handler_s,
        command: task.command.clone(),
        urgent: task.queue.urgent,
        queued: task.queue.normal,
        senders_waiting: task.queue.waiting,
        capacity: task.queue.capacity,
        restarts: counters.restarts,
        left_s: task
            .at
            .as_ref()
            .and_then(|at| Some(at.until?.since(now).as_secs_f64())),
        at: task.at.as_ref().map(|at| at.text.clone()),
        waits: task
            .waits
            .iter()
            .map(|wait| WaitView {
                to: wait.to.clone(),
                command: wait.command.clone(),
                for_s: seconds(wait.since),
            })
            .collect(),
    }
}
