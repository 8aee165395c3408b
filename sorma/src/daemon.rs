//! Service objects carried by the tasks of CTOS: the daemon that serves them, and the way to it.
//!
//! A daemon is a task; its symbolic name is what stands after `@` in the name of an object, unless the
//! dictionary says otherwise. The runtime finds it, wherever it is, and finds it again when its chassis
//! was started anew.

use crate::comm::Comm;
use crate::dictionary::Dictionary;
use crate::name::Location;
use crate::raise;
use crate::report::{Report, code};
use crate::request::{Method, Request};
use crate::sorm::Sorm;
use crate::transport::Transport;
use crate::watching::Trace;
use ctos::call::{CallError, Fault};
use ctos::message::{Command, CommandInfo, Replier};
use ctos::registry::Registry;
use ctos::task::{Context, Handled, HandlerError, NameError};
use ctos::text::Gone;
/// Asks by one line of text: a request `name EXEC|CTRL|DBX ...`, and the reply has the same form.
pub use ctos::text::Say;
use futures_util::future::LocalBoxFuture;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Duration;

/// The handler's name, as configurations write it.
pub const HANDLER: &str = "sorma.daemon";

/// What a daemon and its callers must agree in.
const VERSION: u32 = 2;

/// How long a caller waits for a daemon that is being started again, before it asks once more.
const BACK_WITHIN: Duration = Duration::from_secs(30);

/// How often, and for how long, objects in calls are asked to give back what they keep for those who are gone.
const RELEASE_EVERY: Duration = Duration::from_secs(1);
const RELEASES: u32 = 120;

/// Asks an object of this daemon.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "ask", reply = Transport, code = 0x0001)]
pub struct Ask {
    /// The caller's version of this command.
    version: u32,
    /// The object, by its local name.
    object: String,
    method: Method,
    body: Transport,
}

/// Arguments of the handler.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Arguments {
    /// Files of the dictionary, the later ones over the earlier.
    #[serde(default)]
    dictionary: Vec<String>,
}

/// A task that serves the objects of its process.
pub struct Daemon {
    sorm: Sorm,
}

/// Registers the handler. `shipped` is the dictionary that comes with the program, under those that a
/// task's arguments name; `classes` registers the classes that a daemon serves.
pub fn register(
    registry: &mut Registry,
    shipped: Dictionary,
    classes: impl Fn(&Context, &Sorm) + Send + Sync + 'static,
) {
    registry.handler(HANDLER, &Daemon::COMMANDS, move |cx| {
        let sorm = manager(cx, shipped.clone())?;
        classes(cx, &sorm);
        Ok(Daemon { sorm })
    });
}

/// The manager of a task's chassis, with the dictionary that its arguments name, over a shipped one.
///
/// # Errors
/// Wrong arguments, or a dictionary that cannot be read, with its places.
pub fn manager(cx: &Context, shipped: Dictionary) -> Result<Sorm, HandlerError> {
    let arguments: Arguments = cx.args()?;
    let mut dictionary = shipped;
    for file in &arguments.dictionary {
        let path = cx.path(file);
        load(&mut dictionary, &path)?;
    }
    let chassis = cx.chassis();
    Ok(Sorm::of(
        chassis.name(),
        chassis.clock().clone(),
        dictionary,
    ))
}

fn load(dictionary: &mut Dictionary, path: &Path) -> Result<(), HandlerError> {
    dictionary.load_file(path).map_err(|findings| {
        let lines: Vec<String> = findings.iter().map(ToString::to_string).collect();
        HandlerError::new(lines.join("\n"))
    })
}

#[ctos::handler]
impl Daemon {
    #[command]
    fn ask(&mut self, cx: &Context, request: Ask, reply: Replier<Ask>) -> Handled {
        if request.version != VERSION {
            return reply.fail(format!(
                "the caller speaks version {} of service objects, this daemon {VERSION}: \
                 run the same program on both sides",
                request.version
            ));
        }
        let name = request.object.parse()?;
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        // An object that waits must not keep the others waiting.
        cx.spawn(async move {
            let request = Request {
                name,
                method: request.method,
                body: request.body,
            };
            let answer = sorm.ask(&Tasks::of(&here), request).await;
            // Whoever asked may be gone.
            let _ = reply.ok(answer.body);
        });
        Ok(())
    }

    #[command]
    fn say(&mut self, cx: &Context, request: Say, reply: Replier<Say>) -> Handled {
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        cx.spawn(async move {
            let comm = Tasks::of(&here);
            let trace = Trace {
                id: request.trace,
                depth: 0,
            };
            let answer = sorm.tell_traced(&comm, &request.line, &request.from, trace);
            let answer = answer.await;
            // Whoever asked may be gone.
            let _ = reply.ok(answer);
        });
        Ok(())
    }

    #[command]
    fn gone(&mut self, cx: &Context, gone: Gone) {
        self.forget(cx, move |from| from == gone.who);
    }

    #[chassis_down]
    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        let suffix = format!("@{chassis}");
        self.forget(cx, move |from| from.ends_with(&suffix));
        Ok(())
    }

    #[chassis_up]
    async fn chassis_up(&mut self, cx: &Context, chassis: &str) -> Handled {
        rebuild(&self.sorm, cx, chassis).await;
        Ok(())
    }
}

impl Daemon {
    /// Gives back what is kept for callers that are gone. An object that is in a call at that moment, perhaps
    /// their last one, is asked again when it may be over.
    fn forget(&self, cx: &Context, gone: impl Fn(&str) -> bool + 'static) {
        if self.sorm.release(&gone) {
            return;
        }
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        cx.spawn(async move {
            for _ in 0..RELEASES {
                here.sleep(RELEASE_EVERY).await;
                if sorm.release(&gone) {
                    return;
                }
            }
        });
    }
}

/// Has the daemons of a chassis that is back build the objects that are in use here, so that the next
/// calls find them ready.
pub async fn rebuild(sorm: &Sorm, cx: &Context, chassis: &str) {
    let comm = Tasks::of(cx);
    for (at, names) in sorm.proxies() {
        let Location::Alias(daemon) = &at else {
            continue;
        };
        let task = cx.app().task(daemon);
        if task.is_none_or(|task| task.chassis != chassis) {
            continue;
        }
        let orders: Vec<String> = names.iter().map(|name| format!("-create {name}")).collect();
        let Ok(name) = "sorm".parse() else { return };
        let request = Request {
            name,
            method: Method::Ctrl,
            body: Transport::text(orders.join(" ")),
        };
        match comm.ask(&at, request).await {
            Ok(answer) if answer.is_ok() => {
                tracing::info!(
                    daemon,
                    objects = names.len(),
                    "objects in use are built again"
                );
            }
            Ok(answer) => {
                let why = answer
                    .reports
                    .iter()
                    .map(ToString::to_string)
                    .collect::<Vec<_>>();
                tracing::warn!(
                    daemon,
                    error = why.join("; "),
                    "objects cannot be built again"
                );
            }
            Err(report) => {
                tracing::warn!(daemon, error = %report, "objects cannot be built again");
            }
        }
    }
}

/// Reaches daemons as tasks, in the name of one task.
#[derive(Clone)]
pub struct Tasks {
    cx: Context,
    deadline: Option<Duration>,
    retries: u32,
}

impl Tasks {
    /// In the name of that task; its calls do not try again.
    #[must_use]
    pub fn of(cx: &Context) -> Self {
        Self {
            cx: cx.clone(),
            deadline: None,
            retries: 0,
        }
    }

    /// With another time limit than that of every call.
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

    async fn once(&self, daemon: &str, request: &Ask) -> Result<Transport, NoAnswer> {
        let task = match self.cx.task(daemon).await {
            // It is of this app, so its chassis is being started again. Nothing was asked yet.
            Err(NameError::Unknown { .. }) if self.cx.app().task(daemon).is_some() => {
                self.cx.wait_for_task(daemon, BACK_WITHIN).await?
            }
            found => found?,
        };
        let ask = Ask {
            version: request.version,
            object: request.object.clone(),
            method: request.method,
            body: request.body.clone(),
        };
        let call = self.cx.call(&task, ask);
        let answer = match self.deadline {
            Some(deadline) => call.deadline(deadline).await,
            None => call.await,
        };
        Ok(answer?)
    }
}

/// Why a daemon gave no answer.
#[derive(Debug, thiserror::Error)]
enum NoAnswer {
    #[error(transparent)]
    Name(#[from] NameError),
    #[error(transparent)]
    Call(#[from] CallError),
}

impl NoAnswer {
    /// Whether the daemon, or the way to it, went while it was asked.
    fn is_loss(&self) -> bool {
        match self {
            Self::Name(_) => false,
            Self::Call(error) => matches!(error.fault, Fault::PeerDown { .. } | Fault::UnknownTask),
        }
    }
}

impl Comm for Tasks {
    fn ask<'a>(
        &'a self,
        at: &'a Location,
        request: Request,
    ) -> LocalBoxFuture<'a, Result<Transport, Report>> {
        Box::pin(async move {
            let object = request.name.to_string();
            let Location::Alias(daemon) = at else {
                return Err(raise!(
                    code::DAEMON,
                    "`{object}`: daemons of an app are found by the names of their tasks, not by an address; \
                     write `{object}@TASK`"
                ));
            };
            let mut ask = Ask {
                version: VERSION,
                object,
                method: request.method,
                body: request.body,
            };
            if ask.body.from.is_empty() {
                ask.body.from = format!("{}@{}", self.cx.name(), self.cx.chassis().name());
            }
            let mut left = self.retries;
            loop {
                match self.once(daemon, &ask).await {
                    Ok(answer) => return Ok(answer),
                    Err(lost) if left > 0 && lost.is_loss() => {
                        tracing::warn!(daemon, object = ask.object, error = %lost, "asks again");
                        left -= 1;
                        let back = self.cx.wait_for_task(daemon, BACK_WITHIN).await;
                        back.map_err(|error| {
                            raise!(code::DAEMON, "`{}@{daemon}`: {lost}; {error}", ask.object)
                        })?;
                    }
                    Err(error) => {
                        return Err(raise!(code::DAEMON, "`{}@{daemon}`: {error}", ask.object));
                    }
                }
            }
        })
    }

    fn sleep(&self, time: Duration) -> LocalBoxFuture<'_, ()> {
        Box::pin(self.cx.sleep(time))
    }

    fn is_in_app(&self) -> bool {
        true
    }

    fn call_task<'a>(
        &'a self,
        task: &'a str,
        command: CommandInfo,
        data: Vec<u8>,
        deadline: Duration,
    ) -> LocalBoxFuture<'a, Result<Vec<u8>, Report>> {
        Box::pin(async move {
            let found = self.cx.task(task).await;
            let found = found.map_err(|error| raise!(code::DAEMON, "{error}"))?;
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
