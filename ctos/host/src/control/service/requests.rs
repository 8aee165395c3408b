//! What each request is answered with.

use std::time::Duration;

use base64::{Engine, engine::general_purpose::STANDARD};
use tokio::sync::broadcast;

use super::{Answered, Service, Speaker, Writer, tell};
use crate::{
    control::{
        logs::LogLine,
        news::{News, ended},
        protocol::{Answer, AppView, ErrorCode, ErrorView, LogRequest, SayRequest, StatusView},
        view,
    },
    text::Say,
};
use ctos_bootstrap::bootstrap::{BootEvent, StopStep};
use ctos_core::system::{self, FindTid, Interrupt};
use ctos_message::{Tid, fault::Fault};

/// The longest that a client may wait for a task.
const CALL_TIMEOUT: Duration = Duration::from_secs(3600);
/// How long the boot waits for the answer to a line of text, unless the request says otherwise.
const SAY_TIMEOUT: Duration = Duration::from_secs(600);
/// The longest time that a request may have the boot wait for its answer, s.
const LONGEST_SAY_S: f64 = 86_400.0;

impl Service {
    /// The app as it is now.
    pub(in crate::control) async fn app(&self) -> Result<AppView, ErrorView> {
        Ok(view::app(&self.chassis, &self.logs).await?)
    }

    /// Where a task is.
    pub(in crate::control) async fn find(
        &self,
        name: &str,
        timeout: Duration,
    ) -> Result<Tid, ErrorView> {
        let app = &self.chassis.app;
        let home = app.task(name).map(|task| task.chassis.as_str());
        let query = FindTid {
            name: name.to_owned(),
            gone: None,
            // To look for it starts its process.
            waits: self.chassis.others().any(|index| {
                self.chassis.starts_on_demand(index) && home == Some(self.chassis.name_of(index))
            }),
        };
        let found = view::ask(&self.chassis, system::TID_SERVER, query, timeout).await?;
        found.map_err(|_| match app.task(name) {
            Some(_) => ErrorView::new(
                ErrorCode::Failed,
                format!(
                    "task `{name}` does not run at the moment: its chassis is being started again, or it has ended"
                ),
            ),
            None => self.no_such_name(name),
        })
    }

    /// Sends a task one of its commands.
    pub(super) async fn call(
        &self,
        task: &str,
        command: &str,
        data: &str,
        within_s: f64,
    ) -> Answered {
        let chassis = &self.chassis;
        if chassis.app.task(task).is_none() {
            return Err(self.no_such_name(task).into());
        }
        let info = chassis.registry().command_of(&chassis.app, task, command);
        let info =
            info.map_err(|finding| ErrorView::new(ErrorCode::NoSuchName, finding.to_string()))?;
        let data = STANDARD
            .decode(data)
            .map_err(|_| ErrorView::new(ErrorCode::BadRequest, "the data is not base64"))?;
        // The tool has a time-out of its own; an absurd one is bounded here.
        let timeout = Duration::try_from_secs_f64(within_s).unwrap_or(CALL_TIMEOUT);
        let timeout = timeout.min(CALL_TIMEOUT);
        let tid = self.find(task, timeout).await?;
        let data = view::ask_raw(chassis, tid, (info.code, data), timeout).await;
        let data = data.map_err(ErrorView::from)?;
        Ok(Answer::Reply {
            data: STANDARD.encode(data),
        })
    }

    fn no_such_name(&self, name: &str) -> ErrorView {
        let app = &self.chassis.app;
        let tasks = app.tasks.iter().map(|task| task.name.clone());
        let chassis = app.chassis.iter().map(|chassis| chassis.name.clone());
        ErrorView {
            code: ErrorCode::NoSuchName,
            message: format!("no task or chassis of `{}` is called `{name}`", app.name),
            known: tasks.chain(chassis).collect(),
        }
    }

    pub(super) async fn status(&self, name: &str) -> Answered {
        let app = self.app().await?;
        let task = app.tasks.iter().find(|task| task.name == name).cloned();
        let home = task.as_ref().map_or(name, |task| task.chassis.as_str());
        let mut members = app.chassis.into_iter();
        let chassis = members.find(|one| one.name == home);
        let chassis = chassis.ok_or_else(|| self.no_such_name(name))?;
        let is_task = task.is_some();
        let mut tasks = task.map_or(app.tasks, |task| vec![task]);
        tasks.retain(|task| task.chassis == chassis.name);
        Ok(Answer::Status(Box::new(StatusView {
            app: app.app,
            up_s: app.up_s,
            logs: self.logs.processes(&chassis.name, is_task.then_some(name)),
            chassis,
            tasks,
            is_task,
        })))
    }

    pub(super) async fn logs(&self, request: &LogRequest, writer: &mut Writer) -> Answered {
        let app = &self.chassis.app;
        if let Some(name) = &request.name {
            let chassis = app.chassis.iter().any(|chassis| chassis.name == *name);
            if !chassis && app.task(name).is_none() {
                return Err(self.no_such_name(name).into());
            }
        }
        let mut news = self.ticker.subscribe();
        let (mut lines, mut following) = self.logs.follow();
        let last_at = lines.last().map_or(f64::NEG_INFINITY, |line| line.at_s);
        lines.retain(|line| self.is_wanted(line, request));
        let kept = request.last.unwrap_or(usize::MAX);
        let skipped = lines.len().saturating_sub(kept);
        for line in lines.into_iter().skip(skipped) {
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
        Ok(Answer::Done {})
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
    pub(super) async fn say(&self, request: SayRequest, speaker: &mut Speaker) -> Answered {
        let timeout = match request.limit_s {
            None => SAY_TIMEOUT,
            Some(timeout) if (0.0..=LONGEST_SAY_S).contains(&timeout) => {
                Duration::from_secs_f64(timeout)
            }
            Some(timeout) => {
                let text = format!("`limit_s` is 0 to {LONGEST_SAY_S} s, not {timeout}");
                return Err(ErrorView::new(ErrorCode::BadRequest, text).into());
            }
        };
        let say = Say {
            line: request.line,
            from: speaker.name.clone(),
            trace: request.trace,
        };
        let directory = &self.chassis.directory;
        let mut task = match directory.known(&request.task) {
            Some((_, task)) => task,
            None => directory.learn(&request.task, self.find(&request.task, timeout).await?),
        };
        let mut said = view::ask(&self.chassis, task, say.clone(), timeout).await;
        if said == Err(Fault::UnknownTask) {
            // It is somewhere else now, or nowhere.
            directory.forget(&request.task);
            task = self.find(&request.task, timeout).await?;
            said = view::ask(&self.chassis, task, say, timeout).await;
        }
        speaker.heard.insert(task);
        match said {
            Ok(line) => Ok(Answer::Said { line }),
            Err(Fault::UnknownCommand { takes }) => {
                let text = format!(
                    "task `{}` takes no lines of text; it takes {}",
                    request.task,
                    takes.join(", ")
                );
                Err(ErrorView::new(ErrorCode::Failed, text).into())
            }
            Err(fault) => Err(ErrorView::from(fault).into()),
        }
    }

    pub(super) async fn stop(&self, now: bool, writer: &mut Writer) -> Answered {
        let mut news = self.ticker.subscribe();
        let order = || {
            let order = Interrupt { by_operator: true };
            self.chassis.post_system(system::BOOTSTRAP, order);
        };
        order();
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
                        order();
                    }
                    tell(writer, &Answer::Event { what }).await?;
                }
                Ok(News::Ended(ended)) => return Ok(Answer::Ended(ended)),
                Err(broadcast::error::RecvError::Lagged(_)) => {}
                Err(broadcast::error::RecvError::Closed) => return Ok(Answer::Done {}),
            }
        }
    }
}
