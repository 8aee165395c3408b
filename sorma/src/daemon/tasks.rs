//! The way to daemons: an object that asks another one, in another process, does so in the name of a task.

use super::address;
use super::arguments::HANDLER;
use super::protocol::{Ask, Tell, VERSION};
use super::streams::{self, Leave, Subscribe, Take};
use crate::comm::{Answer, Comm, Job, NoAnswer, Taken};
use crate::name::{Location, ObjectName};
use crate::raise;
use crate::report::{Report, code};
use crate::request::Request;
use crate::results::Keep;
use crate::transport::Transport;
use crate::workers::Workers;
use ctos::call::{CallError, Fault};
use ctos::message::CommandInfo;
use ctos::task::{Context, NameError, TaskRef};
use futures_util::FutureExt as _;
use futures_util::future::LocalBoxFuture;
use std::rc::Rc;
use std::time::Duration;

/// How long a caller waits for a daemon that is being started again, before it asks once more.
const BACK_WITHIN: Duration = Duration::from_secs(30);

/// Reaches daemons as tasks, in the name of one task.
#[derive(Clone)]
pub struct Tasks {
    cx: Context,
    deadline: Option<Duration>,
    retries: u32,
    workers: Option<&'static Workers>,
}

impl Tasks {
    /// In the name of that task; its calls do not try again.
    #[must_use]
    pub fn of(cx: &Context) -> Self {
        Self {
            cx: cx.clone(),
            deadline: None,
            retries: 0,
            workers: None,
        }
    }

    /// In the name of a daemon, whose objects keep it from nobody. In virtual time there is one thread for everything.
    pub(super) fn serving(cx: &Context) -> Self {
        let is_real = cx.chassis().clock().origin_ns().is_some();
        Self {
            workers: is_real.then(Workers::of_process).flatten(),
            ..Self::of(cx)
        }
    }

    /// With another deadline than that of every call.
    #[must_use]
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = Some(deadline);
        self
    }

    /// Asks up to `retries` times more when a daemon dies before it answers. Only for requests that may
    /// be executed twice.
    #[must_use]
    pub fn idempotent(mut self, retries: u32) -> Self {
        self.retries = retries;
        self
    }

    /// The daemon's task. One of this app that is not there is being started again. The caller waits for
    /// that: nothing was asked of it yet.
    async fn found(&self, daemon: &str) -> Result<TaskRef, NameError> {
        match self.cx.task(daemon).await {
            Err(NameError::Unknown { .. }) if self.cx.app().task(daemon).is_some() => {
                self.cx.wait_for_task(daemon, BACK_WITHIN).await
            }
            found => found,
        }
    }

    /// Who asks.
    fn from(&self) -> String {
        format!("{}@{}", self.cx.name(), self.cx.chassis().name())
    }

    fn request(&self, request: Request) -> Ask {
        let mut ask = Ask {
            version: VERSION,
            object: request.name.to_string(),
            method: request.method,
            body: request.body,
        };
        ask.body.opaque.share();
        if ask.body.from.is_empty() {
            ask.body.from = self.from();
        }
        ask
    }

    /// Has something asked of the daemon at a place, of which `object` is the one concerned.
    async fn asked<T>(
        &self,
        at: &Location,
        object: &ObjectName,
        ask: impl AsyncFnOnce(&str) -> Result<T, Lost>,
    ) -> Result<T, Report> {
        let daemon = address::task_at(self.cx.app(), at, object)?;
        let answer = ask(&daemon).await;
        answer.map_err(|lost| lost.report(object, &daemon))
    }

    async fn once(&self, daemon: &str, ask: Ask) -> Result<Transport, Lost> {
        let task = self.found(daemon).await?;
        self.at(&task, ask).await
    }

    async fn at(&self, task: &TaskRef, ask: Ask) -> Result<Transport, Lost> {
        let call = self.cx.call(task, ask);
        let answer = match self.deadline {
            Some(deadline) => call.deadline(deadline).await,
            None => call.await,
        };
        Ok(answer?)
    }
}

/// Why a daemon gave no answer.
#[derive(Debug, thiserror::Error)]
enum Lost {
    #[error(transparent)]
    Name(#[from] NameError),
    #[error("{error}{}", of_another_version(.error))]
    Call {
        #[from]
        error: CallError,
    },
}

/// What most often is behind data that one of the two cannot read.
fn of_another_version(error: &CallError) -> &'static str {
    match error.fault {
        Fault::BadPayload { .. } | Fault::UnknownCommand { .. } => {
            "; one of the two may be of another version: run the same program on both sides"
        }
        _ => "",
    }
}

impl Lost {
    /// Whether the daemon, or the way to it, went while it was asked.
    fn is_loss(&self) -> bool {
        match self {
            Self::Name(_) => false,
            Self::Call { error } => {
                matches!(error.fault, Fault::PeerDown { .. } | Fault::UnknownTask)
            }
        }
    }

    /// Whether the request may have been executed all the same.
    fn perhaps_executed(&self) -> bool {
        match self {
            Self::Name(_) => false,
            Self::Call { error } => !matches!(
                error.fault,
                Fault::Full { .. } | Fault::LinkFull { .. } | Fault::UnknownCommand { .. }
            ),
        }
    }

    fn report(&self, object: &impl std::fmt::Display, daemon: &str) -> Report {
        raise!(code::DAEMON, "`{object}@{daemon}`: {self}")
    }
}

impl Comm for Tasks {
    fn ask<'a>(&'a self, at: &'a Location, request: Request) -> Answer<'a, Transport> {
        Box::pin(async move {
            let daemon = address::task_at(self.cx.app(), at, &request.name)?;
            let mut ask = self.request(request);
            let object = ask.object.clone();
            let mut left = self.retries;
            loop {
                // Who does not ask again keeps nothing: what it sends may be long.
                let kept = (left > 0).then(|| ask.clone());
                let lost = match self.once(&daemon, ask).await {
                    Ok(answer) => return Ok(answer),
                    Err(lost) => lost,
                };
                ask = match kept {
                    Some(kept) if lost.is_loss() => kept,
                    _ => return Err(lost.report(&object, &daemon)),
                };
                tracing::warn!(daemon, object, error = %lost, "asks again");
                left -= 1;
                let back = self.cx.wait_for_task(&daemon, BACK_WITHIN).await;
                back.map_err(|error| raise!(code::DAEMON, "`{object}@{daemon}`: {lost}; {error}"))?;
            }
        })
    }

    fn sleep(&self, time: Duration) -> LocalBoxFuture<'_, ()> {
        Box::pin(self.cx.sleep(time))
    }

    fn ask_once<'a>(
        &'a self,
        at: &'a Location,
        request: Request,
    ) -> LocalBoxFuture<'a, Result<Transport, NoAnswer>> {
        Box::pin(async move {
            let not_asked = |report| NoAnswer {
                report,
                perhaps_executed: false,
            };
            let daemon = address::task_at(self.cx.app(), at, &request.name).map_err(not_asked)?;
            let ask = self.request(request);
            let object = ask.object.clone();
            // It does not wait for one that is being restarted: the caller may ask another one.
            let asked = async {
                let task = self.cx.task(&daemon).deadline(Duration::ZERO).await?;
                self.at(&task, ask).await
            };
            asked.await.map_err(|lost: Lost| NoAnswer {
                report: lost.report(&object, &daemon),
                perhaps_executed: lost.perhaps_executed(),
            })
        })
    }

    fn retries(&self) -> u32 {
        self.retries
    }

    fn tell<'a>(&'a self, at: &'a Location, request: Request) -> Answer<'a, ()> {
        Box::pin(async move {
            let object = request.name.clone();
            self.asked(at, &object, async |daemon: &str| {
                let task = self.found(daemon).await?;
                let ask = self.request(request);
                Ok(self.cx.send(&task, Tell { ask }).await?)
            })
            .await
        })
    }

    fn spawn(&self, job: Job) -> Result<(), Report> {
        begin(&self.cx, job(Rc::new(self.clone())));
        Ok(())
    }

    fn daemons(&self) -> Vec<String> {
        let tasks = self.cx.app().tasks.iter();
        let daemons = tasks.filter(|task| task.handler == HANDLER);
        daemons.map(|task| task.name.clone()).collect()
    }

    fn subscribe<'a>(
        &'a self,
        at: &'a Location,
        name: &'a ObjectName,
        keep: Keep,
    ) -> Answer<'a, (u64, u64)> {
        Box::pin(self.asked(at, name, async move |daemon: &str| {
            let task = self.found(daemon).await?;
            let request = Subscribe::new(name, keep, self.from());
            Ok(self.cx.call(&task, request).await?)
        }))
    }

    fn take<'a>(
        &'a self,
        at: &'a Location,
        name: &'a ObjectName,
        subscriber: u64,
        after: u64,
    ) -> Answer<'a, Taken> {
        Box::pin(self.asked(at, name, async move |daemon: &str| {
            let task = self.cx.task(daemon).await?;
            let call = self.cx.call(&task, Take { subscriber, after });
            let taken = call.deadline(streams::PATIENCE).await?;
            Ok(taken.map_or(Taken::Unknown, Taken::Samples))
        }))
    }

    fn leave<'a>(&'a self, at: &'a Location, subscriber: u64) -> LocalBoxFuture<'a, ()> {
        Box::pin(async move {
            let Ok(daemon) = address::task_at(self.cx.app(), at, &"it") else {
                return;
            };
            // A daemon that is gone knows of nobody any more.
            if let Ok(task) = self.cx.task(&daemon).deadline(Duration::ZERO).await {
                let _ = self.cx.send(&task, Leave { subscriber }).await;
            }
        })
    }

    fn back<'a>(&'a self, at: &'a Location) -> Answer<'a, ()> {
        Box::pin(async move {
            let daemon = address::task_at(self.cx.app(), at, &"it")?;
            let back = self.cx.wait_for_task(&daemon, BACK_WITHIN).await;
            back.map(|_| ())
                .map_err(|error| raise!(code::DAEMON, "`@{daemon}`: {error}"))
        })
    }

    fn workers(&self) -> Option<&'static Workers> {
        self.workers
    }

    fn is_in_app(&self) -> bool {
        true
    }

    fn tasks_of<'a>(&'a self, handler: &'a str) -> Answer<'a, Vec<String>> {
        let tasks = self.cx.app().tasks.iter();
        let named = tasks.filter(|task| task.handler == handler);
        let mut names: Vec<String> = named.map(|task| task.name.clone()).collect();
        names.sort();
        Box::pin(std::future::ready(Ok(names)))
    }

    fn call_task<'a>(
        &'a self,
        task: &'a str,
        command: CommandInfo,
        data: Vec<u8>,
        deadline: Duration,
    ) -> Answer<'a, Vec<u8>> {
        Box::pin(async move {
            let found = self.cx.task(task).await;
            let found = found.map_err(|error| {
                raise!(
                    code::DAEMON,
                    "{error}; the options of an object name its task: CTRL -help tells which"
                )
            })?;
            let answer = self.cx.call_raw(&found, command, data, deadline).await;
            answer.map_err(|error| match &error.fault {
                Fault::Refused { text } => {
                    raise!(
                        code::REFUSED,
                        "task `{task}` refused `{}`: {text}",
                        command.name
                    )
                }
                _ => raise!(code::DAEMON, "{error}"),
            })
        })
    }
}

/// Begins some work now, which keeps requests in their order. The work goes on concurrently with the task: an object that
/// waits keeps no other waiting.
pub(super) fn begin(cx: &Context, work: impl Future<Output = ()> + 'static) {
    let mut work = Box::pin(work);
    if work.as_mut().now_or_never().is_none() {
        cx.spawn(work);
    }
}
