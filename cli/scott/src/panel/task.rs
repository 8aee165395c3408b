//! The task of a panel: carries the lines of its pages to the app's daemons, and keeps the server.

use std::{sync::Arc, time::Duration};

use ctos::{
    diagnostic::Findings,
    message::Message,
    task::{Context, EventHandler, Handled, HandlerError, Phase, StopReason},
    text::Say,
};
use futures_util::{FutureExt as _, future::BoxFuture};
use tokio::sync::{Semaphore, mpsc, oneshot};

use super::{
    args::PanelArgs,
    script::Panel,
    server,
    service::{Objects, Service},
};
use cli_common::page::{self, Front, Kind, Served, Setting};

use crate::attach::refusal;

/// Lines that may wait for this task.
const LINES: usize = 64;
/// Lines that may be under way at a time. One more is refused at once: it never waits for them, because it may be
/// the one that stops them.
const UNDER_WAY: usize = 256;
/// A motion is answered at its end.
const LONGEST: Duration = Duration::from_secs(3600);

/// A line and where its reply goes.
type Asking = (String, oneshot::Sender<String>);

/// The event handler.
pub(super) struct ObjectPanel {
    args: PanelArgs,
    panels: Vec<Panel>,
    daemon: String,
    served: Option<Served>,
    asked: Option<mpsc::Receiver<Asking>>,
}

/// Hands lines to the task.
struct Carried(mpsc::Sender<Asking>);

impl Objects for Carried {
    fn ask(&self, line: String) -> BoxFuture<'static, String> {
        let lines = self.0.clone();
        async move {
            let (sender, reply) = oneshot::channel();
            let asked = line.clone();
            if lines.send((line, sender)).await.is_err() {
                return refusal(&asked, "the app has ended");
            }
            let reply = reply.await;
            reply.unwrap_or_else(|_| refusal(&asked, "the app is ending"))
        }
        .boxed()
    }
}

impl ObjectPanel {
    pub(super) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: PanelArgs = cx.args()?;
        let daemon = args.daemon(cx.app());
        Ok(Self {
            // The check of the app has reported what is wrong in the files.
            panels: args.read(cx.app(), &mut Findings::new()),
            daemon: daemon.ok_or_else(|| HandlerError::new("the app has no daemon to ask"))?,
            args,
            served: None,
            asked: None,
        })
    }

    /// Binds the address and serves it on a thread of its own.
    fn open(&mut self, cx: &Context) -> Result<(), HandlerError> {
        let args = &self.args;
        let setting = Setting {
            listen: args.listen,
            names: &args.names,
            allow_control: args.allow_control,
            token: args.token.as_deref(),
            kind: Kind::Page("#"),
        };
        let (lines, asked) = mpsc::channel(LINES);
        let (name, panels) = (cx.app().name.clone(), std::mem::take(&mut self.panels));
        let serve = move |pages, door, stopped| {
            let service = Service::new(&name, panels, door, Carried(lines));
            server::serve(pages, service, stopped)
        };
        let front = Front::bind(cx.app(), &setting)?;
        let served = front.serve_task(cx, "panel", serve)?;
        let open = served.opener.as_ref().map(tracing::field::display);
        tracing::info!(
            target: page::LOG_TARGET,
            task = cx.name(),
            page = served.url,
            open,
            "a panel is served"
        );
        self.served = Some(served);
        self.asked = Some(asked);
        Ok(())
    }
}

impl EventHandler for ObjectPanel {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if page::is_needless(cx, phase) {
            return Ok(());
        }
        match phase {
            Phase::Create => self.open(cx),
            Phase::Connect => Ok(()),
            // Every object is there, and may ask others.
            Phase::Run => {
                if let Some(asked) = self.asked.take() {
                    let (child, daemon) = (cx.clone(), self.daemon.clone());
                    cx.spawn(async move { carry(&child, &daemon, asked).await });
                }
                Ok(())
            }
        }
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        self.served = None;
        Ok(())
    }
}

/// Has every line met, all at the same time.
async fn carry(cx: &Context, daemon: &str, mut asked: mpsc::Receiver<Asking>) {
    let permits = Arc::new(Semaphore::new(UNDER_WAY));
    while let Some((line, reply)) = asked.recv().await {
        let Ok(permit) = Arc::clone(&permits).try_acquire_owned() else {
            // The caller may be gone.
            let _ = reply.send(refusal(&line, "too many requests are under way"));
            continue;
        };
        let (child, daemon) = (cx.clone(), daemon.to_owned());
        cx.spawn(async move {
            let _ = reply.send(met(&child, &daemon, line).await);
            drop(permit);
        });
    }
}

/// The reply to a line, or why there is none.
async fn met(cx: &Context, daemon: &str, line: String) -> String {
    let say = Say {
        line: line.clone(),
        from: format!("{}@{}", cx.name(), cx.chassis().name()),
        trace: 0,
    };
    let told = async {
        let to = cx.task(daemon).await.map_err(|error| error.to_string())?;
        let call = cx.call(&to, say).deadline(LONGEST);
        call.await.map_err(|error| error.to_string())
    };
    told.await.unwrap_or_else(|why| refusal(&line, &why))
}
