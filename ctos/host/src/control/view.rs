//! Puts together what a client sees of an app: the bootstrap service's view of the chassis, and each
//! agent's view of its tasks. A chassis that does not answer delays nobody for long.

use std::{sync::Arc, time::Duration};

use futures_util::future::join_all;

use crate::control::{
    LogStore,
    protocol::{AppView, ChassisView, TaskView},
};
use ctos_bootstrap::bootstrap::{AppReport, Overview};
use ctos_bootstrap::refusals::Refusals;
use ctos_core::{
    chassis::Chassis,
    envelope::Message,
    report::ChassisReport,
    system::{self, Survey},
    tap::WaitFor,
};
use ctos_message::{Command, Data, Flags, Tid, fault::Fault};

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
    Ok(sent(chassis, message, timeout).await?.into_bytes()?)
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
    Ok(sent(chassis, message, timeout).await?.take::<C::Reply>()?)
}

async fn sent(chassis: &Arc<Chassis>, message: Message, timeout: Duration) -> Result<Data, Fault> {
    let message = message
        .flagged(Flags::HIGH_PRIORITY)
        .until(Some(chassis.clock.now() + timeout));
    let answer = tokio::time::timeout(timeout, chassis.dispatch(message, WaitFor::Reply)).await;
    answer.map_err(|_| Fault::Deadline { after: timeout })?
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
        file: app.selection.file.display().to_string(),
        pid: std::process::id(),
        state,
        up_s: now.since_start().as_secs_f64(),
        chassis: Vec::new(),
        tasks: Vec::new(),
        refused: Refusals::of(chassis).count(),
    };
    for (member, survey) in members.into_iter().zip(surveys(chassis).await) {
        let answers = survey.is_some();
        let survey = survey.unwrap_or_else(|| silent(chassis, &member.name, logs));
        view.refused += survey.refused;
        view.tasks
            .extend(survey.tasks.into_iter().map(|(_, task)| task));
        view.chassis.push(ChassisView {
            host: app.host_of(&member.name).map(|host| host.name.clone()),
            name: member.name,
            pid: survey.pid,
            state: member.state,
            since_s: now.since(member.since).as_secs_f64(),
            restarts: member.incarnation.saturating_sub(1),
            last_end: member.last_end,
            answers,
            processors: survey.processors,
            tasks: member.tasks.len(),
            records: survey.records,
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

/// A chassis that does not answer, as it was declared.
fn silent(chassis: &Chassis, name: &str, logs: &LogStore) -> ChassisReport {
    let pid = logs.pid(name);
    let declared = chassis.app.tasks.iter();
    let tasks = declared
        .filter(|task| task.chassis == name)
        .map(|task| TaskView {
            name: task.name.clone(),
            chassis: name.to_owned(),
            processor: task.processor.clone(),
            handler: task.handler.clone(),
            pid,
            capacity: task.queue as u64,
            ..TaskView::default()
        });
    ChassisReport {
        pid,
        tasks: tasks.map(|task| (Tid::default(), task)).collect(),
        ..ChassisReport::default()
    }
}
