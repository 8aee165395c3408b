//! What each request is answered with.

use std::{io, time::Duration};

use base64::{Engine, engine::general_purpose::STANDARD};
use tokio::sync::broadcast;

use super::{Service, Speaker, Writer, ended, error, failed, tell};
use crate::{
    control::{
        logs::LogLine,
        protocol::{
            Answer, ErrorCode, ErrorView, LogRequest, ProcessLog, RecordRequest, SayRequest,
            StatusView,
        },
        recording::Recording,
        server::News,
        view,
    },
    text::Say,
};
use ctos_bootstrap::bootstrap::{BootEvent, StopStep};
use ctos_core::system::{self, Interrupt, RestartChassis, RestartTask};
use ctos_message::fault::Fault;

/// The longest that a client may wait for a task.
const CALL_TIMEOUT: Duration = Duration::from_secs(3600);
/// How long the answer to a line of text is waited for, unless the request says otherwise.
const SAY_TIMEOUT: Duration = Duration::from_secs(600);
/// The longest that a request may have its answer waited for, s.
const LONGEST_SAY_S: f64 = 86_400.0;
/// How many of its last lines the status of a chassis shows of each process.
const STATUS_LINES: usize = 10;

impl Service {
    /// Sends a task one of its commands.
    pub(super) async fn call(
        &self,
        task: &str,
        command: &str,
        data: &str,
        within_s: f64,
    ) -> Answer {
        let chassis = &self.chassis;
        if chassis.app.task(task).is_none() {
            return self.no_such_name(task);
        }
        let found = chassis.registry().command_of(&chassis.app, task, command);
        let info = match found {
            Ok(info) => info,
            Err(finding) => return error(ErrorCode::NoSuchName, finding.to_string()),
        };
        let Ok(data) = STANDARD.decode(data) else {
            return error(ErrorCode::BadRequest, "the data is not base64");
        };
        // Whoever asks has a timeout of its own; what is absurd is bounded here.
        let timeout = Duration::try_from_secs_f64(within_s).unwrap_or(CALL_TIMEOUT);
        let timeout = timeout.min(CALL_TIMEOUT);
        let query = system::QueryTid {
            name: task.to_owned(),
        };
        let answered = match view::ask(chassis, system::TID_SERVER, query, timeout).await {
            Ok(Ok(tid)) => view::ask_raw(chassis, tid, (info.code, data), timeout).await,
            Ok(Err(_)) => return error(ErrorCode::Failed, format!("task `{task}` is not there")),
            Err(fault) => Err(fault),
        };
        match answered {
            Ok(data) => Answer::Reply {
                data: STANDARD.encode(data),
            },
            Err(fault) => failed(&fault),
        }
    }

    fn no_such_name(&self, name: &str) -> Answer {
        let app = &self.chassis.app;
        let tasks = app.tasks.iter().map(|task| task.name.clone());
        let chassis = app.chassis.iter().map(|chassis| chassis.name.clone());
        Answer::Error(ErrorView {
            code: ErrorCode::NoSuchName,
            message: format!("no task or chassis of `{}` is called `{name}`", app.name),
            known: tasks.chain(chassis).collect(),
        })
    }

    pub(super) async fn status(&self, name: &str) -> Answer {
        let app = match view::app(&self.chassis, &self.logs).await {
            Ok(app) => app,
            Err(fault) => return failed(&fault),
        };
        let task = app.tasks.iter().find(|task| task.name == name).cloned();
        let home = task.as_ref().map_or(name, |task| task.chassis.as_str());
        let Some(chassis) = app.chassis.iter().find(|one| one.name == home).cloned() else {
            return self.no_such_name(name);
        };
        let is_task = task.is_some();
        let tasks = match task {
            Some(task) => vec![task],
            None => app
                .tasks
                .into_iter()
                .filter(|task| task.chassis == chassis.name)
                .collect(),
        };
        Answer::Status(Box::new(StatusView {
            app: app.app,
            up_s: app.up_s,
            logs: self.process_logs(&chassis.name, is_task.then_some(name)),
            chassis,
            tasks,
            is_task,
        }))
    }

    /// The last lines of a chassis's processes; of the present one those about `task`, if one is named.
    fn process_logs(&self, chassis: &str, task: Option<&str>) -> Vec<ProcessLog> {
        let mut logs: Vec<ProcessLog> = self
            .logs
            .processes(chassis)
            .into_iter()
            .map(|(incarnation, pid)| ProcessLog {
                incarnation,
                pid,
                lines: Vec::new(),
            })
            .collect();
        let present = logs.last().map_or(0, |log| log.incarnation);
        for line in self.logs.lines() {
            let wanted = line.chassis == chassis
                && (line.incarnation != present || task.is_none_or(|task| line.is_about(task)));
            let log = logs
                .iter_mut()
                .find(|log| log.incarnation == line.incarnation);
            if let Some(log) = log.filter(|_| wanted) {
                if log.lines.len() == STATUS_LINES {
                    log.lines.remove(0);
                }
                log.lines.push(line);
            }
        }
        logs
    }

    pub(super) async fn logs(&self, request: &LogRequest, writer: &mut Writer) -> io::Result<()> {
        let app = &self.chassis.app;
        if let Some(name) = &request.name {
            let chassis = app.chassis.iter().any(|chassis| chassis.name == *name);
            if !chassis && app.task(name).is_none() {
                return tell(writer, &self.no_such_name(name)).await;
            }
        }
        let mut news = self.ticker.subscribe();
        let (lines, mut following) = self.logs.follow();
        let last_at = lines.last().map_or(f64::NEG_INFINITY, |line| line.at_s);
        let chosen: Vec<LogLine> = lines
            .into_iter()
            .filter(|line| self.is_wanted(line, request))
            .collect();
        let skipped = request
            .last
            .map_or(0, |last| chosen.len().saturating_sub(last));
        for line in chosen.into_iter().skip(skipped) {
            tell(writer, &Answer::Log(line)).await?;
        }
        let mut is_over = false;
        while request.follow && !is_over {
            tokio::select! {
                biased;
                line = following.recv() => match line {
                    Ok(line) if line.at_s > last_at && self.is_wanted(&line, request) => {
                        tell(writer, &Answer::Log(line)).await?;
                    }
                    Ok(_) => {}
                    Err(broadcast::error::RecvError::Lagged(lines)) => {
                        tell(writer, &Answer::Lost { lines }).await?;
                    }
                    Err(broadcast::error::RecvError::Closed) => is_over = true,
                },
                () = ended(&mut news) => is_over = true,
            }
        }
        tell(writer, &Answer::Done {}).await
    }

    fn is_wanted(&self, line: &LogLine, request: &LogRequest) -> bool {
        let level = request.level.is_none_or(|level| line.level >= level);
        let since = request.since_s.is_none_or(|since| line.at_s >= since);
        let name = request.name.as_ref().is_none_or(|name| {
            let declared = self.chassis.app.task(name);
            let here = declared.is_some_and(|task| task.chassis == line.chassis);
            // A task that has moved is known by its field alone elsewhere.
            line.chassis == *name
                || declared.is_some() && line.is_of(name)
                || here && line.is_about(name)
        });
        level && since && name
    }

    /// Says a line to a task, in the name of a client.
    pub(super) async fn say(&self, request: SayRequest, speaker: &mut Speaker) -> Answer {
        let timeout = match request.limit_s {
            None => SAY_TIMEOUT,
            Some(timeout) if (0.0..=LONGEST_SAY_S).contains(&timeout) => {
                Duration::from_secs_f64(timeout)
            }
            Some(timeout) => {
                let text = format!("`limit_s` is 0 to {LONGEST_SAY_S} s, not {timeout}");
                return error(ErrorCode::BadRequest, text);
            }
        };
        let query = system::QueryTid {
            name: request.task.clone(),
        };
        let found = view::ask(&self.chassis, system::TID_SERVER, query, SAY_TIMEOUT).await;
        let task = match found {
            Ok(Ok(task)) => task,
            Ok(Err(_)) if self.chassis.app.task(&request.task).is_some() => {
                let text = format!(
                    "task `{}` is not there just now: its chassis is being started again, or it has ended",
                    request.task
                );
                return error(ErrorCode::Failed, text);
            }
            Ok(Err(_)) => return self.no_such_name(&request.task),
            Err(fault) => return failed(&fault),
        };
        speaker.heard.insert(task);
        let say = Say {
            line: request.line,
            from: speaker.name.clone(),
            trace: request.trace,
        };
        match view::ask(&self.chassis, task, say, timeout).await {
            Ok(line) => Answer::Said { line },
            Err(Fault::UnknownCommand { takes }) => {
                let text = format!(
                    "task `{}` takes no lines of text; it takes {}",
                    request.task,
                    takes.join(", ")
                );
                error(ErrorCode::Failed, text)
            }
            Err(fault) => failed(&fault),
        }
    }

    pub(super) async fn stop(&self, now: bool, writer: &mut Writer) -> io::Result<()> {
        let mut news = self.ticker.subscribe();
        self.chassis.post_system(system::BOOTSTRAP, Interrupt {});
        loop {
            match news.recv().await {
                Ok(News::Event(what)) => {
                    let begins = matches!(
                        what,
                        BootEvent::StopStep {
                            step: StopStep::Quiesce | StopStep::Tasks
                        } | BootEvent::Stopped { .. }
                    );
                    if now && begins {
                        self.chassis.post_system(system::BOOTSTRAP, Interrupt {});
                    }
                    tell(writer, &Answer::Event { what }).await?;
                }
                Ok(News::Ended(ended)) => return tell(writer, &Answer::Ended(ended)).await,
                Err(broadcast::error::RecvError::Lagged(_)) => {}
                Err(broadcast::error::RecvError::Closed) => return Ok(()),
            }
        }
    }

    pub(super) async fn record(
        &self,
        request: RecordRequest,
        writer: &mut Writer,
    ) -> io::Result<()> {
        let mut news = self.ticker.subscribe();
        let begun = Recording::begin(&self.chassis, &self.recordings, request).await;
        let mut recording = match begun {
            Ok(recording) => recording,
            Err(wrong) => return tell(writer, &Answer::Error(wrong)).await,
        };
        tell(writer, &Answer::Recording(recording.view())).await?;
        while let Some(answer) = recording.next(restarted(&mut news)).await {
            tell(writer, &answer).await?;
        }
        Ok(())
    }

    pub(super) async fn restart(&self, name: &str) -> Answer {
        let app = &self.chassis.app;
        // Every phase and every rung of the ladder may take its time.
        let timeout = app.phase_timeout.saturating_mul(4) + app.stop_timeout.saturating_mul(4);
        let chassis = (1..).zip(&app.chassis).find(|(_, one)| one.name == name);
        let restarted = if let Some((chassis, _)) = chassis {
            view::ask(
                &self.chassis,
                system::BOOTSTRAP,
                RestartChassis { chassis },
                timeout,
            )
            .await
        } else {
            let overview = view::app(&self.chassis, &self.logs).await;
            if let Err(fault) = overview {
                return failed(&fault);
            }
            let query = system::QueryTid {
                name: name.to_owned(),
            };
            match view::ask(&self.chassis, system::TID_SERVER, query, timeout).await {
                Ok(Ok(tid)) => view::ask(&self.chassis, tid, RestartTask {}, timeout).await,
                Ok(Err(_)) => return self.no_such_name(name),
                Err(fault) => Err(fault),
            }
        };
        match restarted {
            Ok(()) => Answer::Done {},
            Err(Fault::NoReply) => error(
                ErrorCode::Failed,
                format!("the app ended while `{name}` was being restarted"),
            ),
            Err(fault) => failed(&fault),
        }
    }
}

/// The next chassis that is started again; `None` when the app has ended.
async fn restarted(news: &mut broadcast::Receiver<News>) -> Option<String> {
    loop {
        match news.recv().await {
            Ok(News::Event(BootEvent::Restarted { chassis, .. })) => return Some(chassis),
            Ok(News::Ended(_)) | Err(broadcast::error::RecvError::Closed) => return None,
            Ok(News::Event(_)) | Err(broadcast::error::RecvError::Lagged(_)) => {}
        }
    }
}
