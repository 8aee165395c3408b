//! The task of a display: follows the nets, carries orders to them, and keeps the server.

use std::{collections::BTreeSet, sync::Arc, time::Duration};

use ctos::{
    diagnostic::Findings,
    message::Message,
    task::{Context, EventHandler, Handled, HandlerError, Phase, StopReason},
};
use pnt::stream::{Describe, Event, EventPhase, Follow, NetView};
use tokio::sync::mpsc;

use super::{
    args::DisplayArgs,
    arrange,
    hub::Hub,
    looking, orders,
    overview::Overviews,
    server::{self, Asking, Service},
    standing,
    summing::{self, Opened},
};
use cli_common::page::{self, Front, Kind, Served, Setting};

/// How long a net waits for something to happen before it answers.
const PATIENCE_MS: u32 = 2_000;
/// A net that does not answer for so long is gone.
const SILENCE: Duration = Duration::from_secs(4);
/// How long after a net was lost it is looked for again.
const RETRY: Duration = Duration::from_millis(250);
/// How long browsers have to hear that the app has ended.
const FAREWELL: Duration = Duration::from_millis(100);
/// Orders that may wait.
const ORDERS: usize = 64;

/// The event handler.
pub(super) struct NetDisplay {
    args: DisplayArgs,
    hub: Arc<Hub>,
    served: Option<Served>,
    orders: Option<mpsc::Receiver<Asking>>,
    opened: Opened,
}

impl NetDisplay {
    pub(super) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: DisplayArgs = cx.args()?;
        let overviews = match args.read_displays(cx.app()) {
            // What is wrong in it was said when the app was checked.
            Some(source) => {
                let path = cx.app().file_at(args.displays(cx.app()));
                let mut nothing = Findings::new();
                let mut overviews = Overviews::read(&source?, &mut nothing);
                overviews.arrange_from(&path, &mut nothing);
                overviews
            }
            None => Overviews::default(),
        };
        let clock = cx.chassis().clock().clone();
        let hub = Hub::live(&cx.app().name, overviews, clock);
        let tasks = cx.app().tasks.iter().map(|task| task.name.clone());
        Ok(Self {
            hub: Arc::new(hub.with_tasks(tasks.collect())),
            args,
            served: None,
            orders: None,
            opened: Opened::default(),
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
            kind: Kind::Page("?token="),
        };
        let (orders, received) = mpsc::channel(ORDERS);
        let (hub, viewers) = (self.hub.clone(), args.viewers);
        let serve = move |pages, door, stopped| {
            let permits = server::permits(viewers);
            let service = Service {
                hub,
                door,
                viewers,
                permits,
                orders,
            };
            server::serve(pages, service, stopped)
        };
        let front = Front::bind(cx.app(), &setting)?;
        let served = front.serve_task(cx, "display", serve)?;
        let open = served.opener.as_ref().map(tracing::field::display);
        tracing::info!(
            target: page::LOG_TARGET,
            task = cx.name(),
            page = served.url,
            open,
            "nets are shown"
        );
        self.served = Some(served);
        self.orders = Some(received);
        Ok(())
    }

    /// Looks for what the analysis says of the nets, on a thread of its own: it may take a while.
    fn analyse(&self, cx: &Context) {
        let (app, registry) = (cx.app().clone(), cx.registry());
        let hub = self.hub.clone();
        // Without it the nets are shown without notes.
        let _ = std::thread::Builder::new()
            .name("display-notes".to_owned())
            .spawn(move || hub.notes(&registry.check(&app)));
    }

    /// The nets that are shown.
    fn nets(&self, cx: &Context) -> Vec<String> {
        let all = pnt::task::net_tasks(cx.app(), &cx.registry());
        match &self.args.nets {
            Some(wanted) => {
                // What stands for a net at another site runs none itself.
                let abroad = wanted.iter().filter(|net| net.contains('@'));
                let here = all.into_iter().filter(|net| wanted.contains(net));
                here.chain(abroad.cloned()).collect()
            }
            None => all,
        }
    }
}

impl EventHandler for NetDisplay {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        let pace = virtual_pace(cx, &self.args);
        if pace.is_none() && page::is_needless(cx, phase) {
            return Ok(());
        }
        match phase {
            Phase::Create => {
                // Known before the first page asks.
                let summaries = scene_summary::sources(cx.app(), &cx.registry());
                self.hub.expects_summaries(&summaries);
                self.open(cx)?;
            }
            // Before the first firing, so that nothing is missed.
            Phase::Connect => {
                let nets = self.nets(cx);
                if !summing::are_opened(cx, nets.len()) {
                    for net in nets {
                        let (child, hub) = (cx.clone(), self.hub.clone());
                        cx.spawn(async move { follow(&child, &net, &hub, None).await });
                    }
                }
                // The process that boots tells of an app in real time only.
                if pace.is_none() {
                    let (child, hub) = (cx.clone(), self.hub.clone());
                    cx.spawn(async move { standing::follow(&child, &hub).await });
                }
                for source in scene_summary::sources(cx.app(), &cx.registry()) {
                    let (child, hub) = (cx.clone(), self.hub.clone());
                    cx.spawn(async move { summing::follow(&child, &source, &hub).await });
                }
                let sources = scene::follow::sources(cx.app(), &cx.registry());
                self.hub.expects(&sources);
                for source in sources {
                    let (child, hub) = (cx.clone(), self.hub.clone());
                    cx.spawn(async move { looking::follow(&child, &source, &hub).await });
                }
                if let Some(received) = self.orders.take() {
                    let (child, hub) = (cx.clone(), self.hub.clone());
                    let displays = self.args.displays(cx.app());
                    let (opened, nets) = (self.opened.clone(), self.nets(cx));
                    cx.spawn(async move {
                        orders::carry(&child, &hub, displays, (&opened, nets), received).await;
                    });
                }
            }
            Phase::Run => {
                // What is wrong with many nets was told when the app was checked.
                if !summing::are_opened(cx, self.nets(cx).len()) {
                    self.analyse(cx);
                }
                if let Some(pace) = pace {
                    let child = cx.clone();
                    cx.spawn(async move { summing::keep_pace(&child, pace).await });
                }
            }
        }
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, _reason: &StopReason) -> Handled {
        self.hub.end();
        if let Some(mut served) = self.served.take() {
            served.opener = None;
            match virtual_pace(cx, &self.args) {
                Some(_) => summing::linger(FAREWELL),
                None => cx.sleep(FAREWELL).await,
            }
        }
        Ok(())
    }
}

/// How fast virtual time goes for the page; `None` in real time, and where no page is served.
fn virtual_pace(cx: &Context, args: &DisplayArgs) -> Option<f64> {
    let is_virtual = cx.chassis().clock().origin_ns().is_none();
    args.pace.filter(|_| is_virtual)
}

/// Follows one net through the end and the return of its chassis: for good, or as long as it is among those that were opened.
pub(super) async fn follow(cx: &Context, net: &str, hub: &Hub, opened: Option<&Opened>) {
    while opened.is_none_or(|opened| opened.has(net)) {
        match stream(cx, net, hub, opened).await {
            Ok(()) => break,
            Err(error) => hub.gone(net, &error.to_string()),
        }
        cx.sleep(RETRY).await;
    }
    opened.inspect(|opened| opened.ends(net));
    hub.leave(net);
}

/// Has the last messages kept of a net's task, and of those that it calls: they are there when somebody asks.
fn keep_messages(cx: &Context, view: &NetView) {
    let called = view.transitions.iter().filter_map(|one| one.task.as_ref());
    let names: BTreeSet<String> = called.chain([&view.name]).cloned().collect();
    let child = cx.clone();
    cx.spawn(async move {
        for name in names {
            // A viewer that asks for a missing one is told so.
            let _ = orders::look(&child, &name).await;
        }
    });
}

/// Ends without an error when the net is not to be followed any more.
async fn stream(cx: &Context, net: &str, hub: &Hub, opened: Option<&Opened>) -> Handled {
    let to = cx.task(net).await?;
    let view = cx.call(&to, Describe {}).deadline(SILENCE).await?;
    let mut after = None;
    let mut view = Some(view);
    while opened.is_none_or(|opened| opened.has(net)) {
        let follow = Follow {
            after,
            patience_ms: PATIENCE_MS,
        };
        let mut batch = cx.call(&to, follow).deadline(SILENCE).await?;
        after = Some(batch.mark);
        // A net at another site is called otherwise there.
        if let Some(state) = &mut batch.state {
            net.clone_into(&mut state.net);
        }
        if view.is_some()
            && let (Some(mut view), Some(state)) = (view.take(), batch.state.take())
        {
            if net.contains('@') {
                // The tasks that it asks are there, and not here.
                net.clone_into(&mut view.name);
            } else {
                // Nodes may have been moved since the net read where they are.
                arrange::pin(cx, &mut view);
                keep_messages(cx, &view);
            }
            hub.describe(view, state)?;
            hub.breakpoints(net, orders::breakpoints(cx, &to).await?);
        }
        // A person who set one need not have done so on a page.
        let ordered = |event: &Event| event.phase == EventPhase::Ordered;
        if batch.events.iter().any(ordered) {
            hub.breakpoints(net, orders::breakpoints(cx, &to).await?);
        }
        hub.take(net, batch)?;
    }
    Ok(())
}
