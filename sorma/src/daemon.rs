//! Service objects carried by the tasks of CTOS: the daemon that serves them, and the way to it.
//!
//! A daemon is a task; its symbolic name is what stands after `@` in the name of an object, unless the
//! dictionary says otherwise. The runtime finds it, wherever it is, and finds it again when its chassis
//! was started anew.

mod address;
mod arguments;
mod protocol;
mod streams;
mod tasks;

use crate::asynchronous;
use crate::comm::Comm;
use crate::dictionary::Dictionary;
use crate::request::{Method, Request};
use crate::sorm::{Kept, Sorm};
use crate::transport::Transport;
use crate::watching::Trace;
use arguments::Arguments;
use ctos::diagnostic::Findings;
use ctos::message::Replier;
use ctos::registry::Registry;
use ctos::task::{Context, Durable, Handled, HandlerError, Handover};
use ctos::text::Gone;
/// Asks by one line of text: a request `name EXEC|CTRL|DBX ...`, and the reply has the same form.
pub use ctos::text::Say;
use std::rc::Rc;
use std::time::Duration;
use streams::{Leave, Subscribe, Subscribers, Take};
use tasks::begin;

pub use arguments::HANDLER;
pub use protocol::{Ask, Tell, VERSION};
pub use tasks::Tasks;

/// How often, and for how long, objects in calls are asked to give back what they keep for those who are gone.
const RELEASE_EVERY: Duration = Duration::from_secs(1);
const RELEASES: u32 = 120;

/// A task that serves the objects of its process.
pub struct Daemon {
    sorm: Sorm,
    subscribers: Rc<Subscribers>,
}

/// Registers the handler. `shipped` is the dictionary that comes with the program; those that a task's arguments
/// name override it. `classes` registers the classes that a daemon serves, besides those that every daemon has.
/// These are `dict`, `sorm`, `watch`, and for requests without waiting `fork`, `later`, `stream` and `event`.
pub fn register(
    registry: &mut Registry,
    shipped: Dictionary,
    classes: impl Fn(&Context, &Sorm) + Send + Sync + 'static,
) {
    let handler = registry.durable(HANDLER, &Daemon::COMMANDS, move |cx| {
        let sorm = manager(cx, shipped.clone())?;
        asynchronous::register(&sorm);
        classes(cx, &sorm);
        if cx.config().is_some_and(|config| config.durable) {
            sorm.keep(Kept::new());
        }
        Ok(Daemon {
            sorm,
            subscribers: Rc::default(),
        })
    });
    handler.checked_args(arguments::check);
}

/// The manager of a task's chassis, with the dictionary that its arguments name, over a shipped one.
///
/// # Errors
/// Wrong arguments, or a dictionary that cannot be read, with its places.
pub fn manager(cx: &Context, shipped: Dictionary) -> Result<Sorm, HandlerError> {
    let arguments: Arguments = cx.args()?;
    let mut dictionary = shipped;
    for file in &arguments.dictionary {
        let loaded = dictionary.load_file(&cx.app().file_at(file));
        loaded.map_err(|findings| wrong(&findings))?;
    }
    dictionary
        .load_environment(environment())
        .map_err(|findings| wrong(&findings))?;
    let chassis = cx.chassis();
    // Objects are used by reference too, where no context tells what they read.
    if cx.started_ns() != 0 {
        cx.reads_unrecorded("the real clock of its service objects");
    }
    let sorm = Sorm::of(chassis.name(), chassis.clock().clone(), dictionary);
    if let Some(number) = arguments.number {
        tracing::info!(task = cx.name(), number, "found by its number too");
    }
    for (class, attributes) in arguments.offers.read() {
        sorm.offer(&class, attributes);
    }
    Ok(sorm)
}

/// The process's environment, as far as it is text.
fn environment() -> impl Iterator<Item = (String, String)> {
    std::env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)))
}

fn wrong(findings: &Findings) -> HandlerError {
    let lines: Vec<String> = findings.iter().map(ToString::to_string).collect();
    HandlerError::new(lines.join("\n"))
}

#[ctos::handler]
impl Daemon {
    #[command]
    fn ask(&mut self, cx: &Context, request: Ask, reply: Replier<Ask>) -> Handled {
        let request = request.read()?;
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        begin(cx, async move {
            let mut answer = sorm.ask(&Tasks::serving(&here), request).await;
            answer.body.opaque.share();
            // The caller may be gone.
            let _ = match here.keep(&sorm.kept()).await {
                Ok(()) => reply.ok(answer.body),
                Err(error) => reply.fail(not_kept(&error)),
            };
        });
        Ok(())
    }

    #[command]
    fn tell(&mut self, cx: &Context, request: Tell) -> Result<(), HandlerError> {
        let request = request.ask.read()?;
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        begin(cx, async move {
            let answer = sorm.ask(&Tasks::serving(&here), request).await;
            sorm.unheard(&answer.name, &answer.body);
            if let Err(error) = here.keep(&sorm.kept()).await {
                tracing::error!("{}", not_kept(&error));
            }
        });
        Ok(())
    }

    #[command]
    fn subscribe(&mut self, cx: &Context, request: Subscribe) -> Result<(u64, u64), HandlerError> {
        self.subscribers.add(&self.sorm, cx, &request)
    }

    #[command]
    fn take(&mut self, cx: &Context, request: Take, reply: Replier<Take>) -> Handled {
        let (subscribers, here) = (Rc::clone(&self.subscribers), cx.clone());
        cx.spawn(async move {
            let taken = subscribers.take(&here, &request).await;
            // The caller may be gone.
            let _ = reply.ok(taken);
        });
        Ok(())
    }

    #[command]
    fn leave(&mut self, request: Leave) -> Result<(), HandlerError> {
        self.subscribers.leave(request.subscriber);
        Ok(())
    }

    #[command]
    fn say(&mut self, cx: &Context, request: Say, reply: Replier<Say>) -> Handled {
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        begin(cx, async move {
            let comm = Tasks::serving(&here);
            let trace = Trace {
                id: request.trace,
                depth: 0,
            };
            let answer = sorm.tell_traced(&comm, &request.line, &request.from, trace);
            let answer = answer.await;
            // The caller may be gone.
            let _ = match here.keep(&sorm.kept()).await {
                Ok(()) => reply.ok(answer),
                Err(error) => reply.fail(not_kept(&error)),
            };
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
        self.subscribers.gone(&suffix);
        self.forget(cx, move |from| from.ends_with(&suffix));
        Ok(())
    }

    #[chassis_up]
    async fn chassis_up(&mut self, cx: &Context, chassis: &str) -> Handled {
        rebuild(&self.sorm, cx, chassis).await;
        Ok(())
    }
}

/// It is done all the same, for as long as the process lives.
fn not_kept(error: &HandlerError) -> String {
    format!("it is done, but would not survive the process: {error}")
}

/// Its objects are called by reference within its process, and stay there.
impl Handover for Daemon {
    type State = Kept;

    fn hand_over(&mut self) -> Result<Kept, HandlerError> {
        Err("a daemon stays where its objects are".into())
    }

    fn take_over(&mut self, _: &Context, kept: Kept) -> Handled {
        self.sorm.keep(kept);
        Ok(())
    }
}

impl Durable for Daemon {
    fn state(&self) -> Kept {
        self.sorm.kept()
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
        let Ok(daemon) = address::task_at(cx.app(), &at, &"it") else {
            continue;
        };
        let task = cx.app().task(&daemon);
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
                let error = answer.said();
                tracing::warn!(daemon, error, "objects cannot be built again");
            }
            Err(report) => {
                tracing::warn!(daemon, error = %report, "objects cannot be built again");
            }
        }
    }
}
