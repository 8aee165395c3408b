//! Service objects carried by the tasks of CTOS: the daemon that serves them, and the way to it.
//!
//! A daemon is a task; its symbolic name is what stands after `@` in the name of an object, unless the
//! dictionary says otherwise. The runtime finds it, wherever it is, and finds it again when its chassis
//! was started anew.

mod address;
mod offers;
mod streams;
mod tasks;

use crate::comm::Comm;
use crate::dictionary::Dictionary;
use crate::request::{Method, Request};
use crate::sorm::Sorm;
use crate::transport::Transport;
use crate::watching::Trace;
use ctos::diagnostic::Findings;
use ctos::message::{Command, Replier};
use ctos::registry::Registry;
use ctos::task::{Context, Handled, HandlerError};
use ctos::text::Gone;
/// Asks by one line of text: a request `name EXEC|CTRL|DBX ...`, and the reply has the same form.
pub use ctos::text::Say;
use futures_util::FutureExt as _;
use offers::Offers;
use serde::{Deserialize, Serialize};
use std::rc::Rc;
use std::time::Duration;
use streams::{Leave, Subscribe, Subscribers, Take};
pub use tasks::Tasks;

/// The handler's name, as configurations write it.
pub const HANDLER: &str = "sorma.daemon";

/// What a daemon and its callers must agree in.
pub const VERSION: u32 = 2;

/// How long a caller waits for a daemon that is being started again, before it asks once more.
const BACK_WITHIN: Duration = Duration::from_secs(30);

/// How often, and for how long, objects in calls are asked to give back what they keep for those who are gone.
const RELEASE_EVERY: Duration = Duration::from_secs(1);
const RELEASES: u32 = 120;

/// Asks an object of this daemon.
#[derive(Debug, Clone, Serialize, Deserialize, Command)]
#[command(name = "ask", reply = Transport, code = 0x0001)]
pub struct Ask {
    /// The caller's version of this command.
    version: u32,
    /// The object, by its local name.
    object: String,
    method: Method,
    body: Transport,
}

impl Ask {
    /// What is asked, of a caller of this version.
    fn read(self) -> Result<Request, HandlerError> {
        same_version(self.version)?;
        Ok(Request {
            name: self.object.parse()?,
            method: self.method,
            body: self.body,
        })
    }
}

/// Arguments of the handler.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Arguments {
    /// Files of the dictionary, the later ones over the earlier.
    #[serde(default)]
    dictionary: Vec<String>,
    /// By which number, besides its name, it is found on its host: `foo.a@host:11`.
    #[serde(default)]
    number: Option<u32>,
    /// What it offers to whoever trades, by class.
    #[serde(default)]
    offers: Offers,
}

/// Does what [`Ask`] does, and answers nothing.
#[derive(Debug, Serialize, Deserialize, Command)]
#[command(name = "tell", code = 0x0013)]
pub struct Tell {
    ask: Ask,
}

/// A task that serves the objects of its process.
pub struct Daemon {
    sorm: Sorm,
    subscribers: Rc<Subscribers>,
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
        Ok(Daemon {
            sorm,
            subscribers: Rc::default(),
        })
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
        let loaded = dictionary.load_file(&cx.path(file));
        loaded.map_err(|findings| wrong(&findings))?;
    }
    dictionary
        .load_environment(environment())
        .map_err(|findings| wrong(&findings))?;
    let chassis = cx.chassis();
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

/// Refuses a caller of another version.
fn same_version(version: u32) -> Result<(), HandlerError> {
    if version == VERSION {
        return Ok(());
    }
    Err(HandlerError::new(format!(
        "the caller speaks version {version} of service objects, this daemon {VERSION}: \
         run the same program on both sides"
    )))
}

/// Begins some work now, so that requests are begun in the order in which they come, and goes on with it
/// beside the task, so that an object that waits keeps no other waiting.
fn begin(cx: &Context, work: impl Future<Output = ()> + 'static) {
    let mut work = Box::pin(work);
    if work.as_mut().now_or_never().is_none() {
        cx.spawn(work);
    }
}

#[ctos::handler]
impl Daemon {
    #[command]
    fn ask(&mut self, cx: &Context, request: Ask, reply: Replier<Ask>) -> Handled {
        let request = request.read()?;
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        begin(cx, async move {
            let mut answer = sorm.ask(&Tasks::of(&here), request).await;
            answer.body.opaque.share();
            // Whoever asked may be gone.
            let _ = reply.ok(answer.body);
        });
        Ok(())
    }

    #[command]
    fn tell(&mut self, cx: &Context, request: Tell) -> Result<(), HandlerError> {
        let request = request.ask.read()?;
        let (sorm, here) = (self.sorm.clone(), cx.clone());
        begin(cx, async move {
            let answer = sorm.ask(&Tasks::of(&here), request).await;
            sorm.unheard(&answer.name, &answer.body);
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
            // Whoever asked may be gone.
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
