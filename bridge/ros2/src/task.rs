//! The task: follows what all tasks of the app show and publishes it, takes what comes and asks the tasks that it is for.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    rc::Rc,
    time::Duration,
};

use ctos::{
    message::Message,
    survey::AtReport,
    task::{Context, EventHandler, Handled, HandlerError, Phase, StopReason},
};
use scene::follow::{Follower, RETRY, sources};
use tokio::sync::mpsc;

use crate::{
    args::{Args, plain},
    control::{self, Arm},
    endpoint::Node,
    messages::{JointTrajectory, TRIGGER, Topic, TriggerRequest, TriggerResponse, decode, encode},
    network::{Call, EVENTS, Event, Network, Order, Plan},
    status::Status,
    translate::{Told, Translator},
};

/// How often everything is told again, for those who came later.
const AGAIN: Duration = Duration::from_secs(1);
/// Calls that may be under way at a time.
const MOST_CALLS: usize = 16;

/// The log target of addresses that are served: it is shown where nothing else of its level is.
const LOG_TARGET: &str = "ctos::page";

/// The date of the host when the clock of the app stood at zero, ns since 1970: ROS stamps messages with dates.
fn started_ns(cx: &Context) -> u64 {
    cx.outside("date of the host", || {
        cx.chassis().clock().started_date_ns().unwrap_or_default()
    })
}

/// What all parts of the task share.
struct Shared {
    args: Args,
    /// The node's name, and that of the app.
    node: String,
    app: String,
    started_ns: u64,
    translator: RefCell<Translator>,
    status: RefCell<Status>,
    network: RefCell<Option<Network>>,
    /// Services that are being asked now.
    calls: Cell<usize>,
    /// By their topic.
    arms: BTreeMap<String, Arm>,
}

impl Shared {
    fn publish(&self, cx: &Context, all: Vec<Told>) {
        let at_ns = self.unix_ns(cx);
        let mut lost = 0;
        if let Some(network) = &*self.network.borrow() {
            for Told { name, of, bytes } in all {
                let order = Order::Publish {
                    name,
                    of,
                    at_ns,
                    bytes,
                };
                lost += u64::from(!network.order(order));
            }
        }
        if lost > 0 {
            self.lose(cx, lost);
        }
    }

    fn lose(&self, cx: &Context, count: u64) {
        let mut status = self.status.borrow_mut();
        if status.lost == 0 {
            tracing::warn!(
                task = cx.name(),
                "messages for ROS are lost: the network does not keep up"
            );
        }
        status.lost += count;
    }

    /// ns since 1970.
    fn unix_ns(&self, cx: &Context) -> u64 {
        self.started_ns.saturating_add(cx.now().as_nanos())
    }

    fn is_there(&self) -> bool {
        self.status.borrow().there.0
    }

    fn wrong(&self, cx: &Context, name: &str, text: String) {
        let told = text.clone();
        if self
            .status
            .borrow_mut()
            .wrong(name, text, cx.now().as_nanos())
        {
            tracing::warn!(task = cx.name(), name, "{told}");
        }
        self.show(cx);
    }

    /// Says how it is.
    fn show(&self, cx: &Context) {
        let text = self.status.borrow().words();
        cx.is_at(Some(AtReport { text, until: None }));
    }

    /// The name in the configuration whose full name this is.
    fn configured<'a, T>(&self, table: &'a BTreeMap<String, T>, name: &str) -> Option<&'a T> {
        let mut all = table.iter();
        all.find(|(key, _)| self.args.name(key) == name)
            .map(|(_, value)| value)
    }
}

/// The event handler.
pub(crate) struct Bridge {
    shared: Rc<Shared>,
}

impl Bridge {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: Args = cx.args()?;
        let (app, started_ns) = (cx.app().name.to_string(), started_ns(cx));
        let arms = args
            .take
            .keys()
            .map(|name| (args.name(name), Arm::default()));
        let shared = Shared {
            node: args.node.clone().unwrap_or_else(|| plain(&app)),
            app,
            started_ns,
            translator: RefCell::new(Translator::new(args.clone(), started_ns)),
            status: RefCell::default(),
            network: RefCell::default(),
            calls: Cell::default(),
            arms: arms.collect(),
            args,
        };
        Ok(Self {
            shared: Rc::new(shared),
        })
    }

    fn plan(&self, cx: &Context) -> Plan {
        let args = &self.shared.args;
        let app = cx.app();
        let space = args.namespace.trim_matches('/');
        let keys = app.security.as_ref().map(|security| {
            let key = app
                .folder
                .join(&security.key)
                .to_string_lossy()
                .into_owned();
            let authority = app.folder.join(&security.authority);
            [
                format!("{key}.pem"),
                format!("{key}.key"),
                authority.to_string_lossy().into_owned(),
            ]
        });
        let take = args
            .take
            .keys()
            .map(|name| (args.name(name), JointTrajectory::TYPE));
        let serve = args.serve.keys().map(|name| (args.name(name), TRIGGER));
        Plan {
            node: Node {
                domain: args.domain,
                name: self.shared.node.clone(),
                namespace: match space.is_empty() {
                    true => String::new(),
                    false => format!("/{space}"),
                },
            },
            endpoints: args.endpoints(),
            is_router: !args.listen.is_empty(),
            keys,
            take: take.collect(),
            serve: serve.collect(),
            clock: cx.chassis().clock().clone(),
        }
    }

    /// Joins the network, and hears what comes from there.
    fn join(&self, cx: &Context) -> Handled {
        let (events, come) = mpsc::channel(EVENTS);
        let network = Network::join(self.plan(cx), events);
        let network = network.map_err(|error| HandlerError::new(format!("no thread: {error}")))?;
        self.shared.network.replace(Some(network));
        self.shared.show(cx);
        let (child, shared) = (cx.clone(), Rc::clone(&self.shared));
        cx.spawn(async move { hear(&child, &shared, come).await });
        let (child, shared) = (cx.clone(), Rc::clone(&self.shared));
        cx.spawn(async move { repeat(&child, &shared).await });
        Ok(())
    }
}

impl EventHandler for Bridge {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        // In virtual time, and in a replay, nobody takes part.
        let real = cx.chassis().clock().origin_ns().is_some() && !cx.is_replay();
        match phase {
            Phase::Create if real => {
                cx.reads_unrecorded("a network of ROS 2");
                self.join(cx)?;
            }
            Phase::Connect if real => {
                for source in sources(cx.app(), &cx.registry()) {
                    let (child, shared) = (cx.clone(), Rc::clone(&self.shared));
                    cx.spawn(async move { follow(&child, &shared, &source).await });
                }
                let names: Vec<String> = self.shared.arms.keys().cloned().collect();
                for name in names {
                    let (child, shared) = (cx.clone(), Rc::clone(&self.shared));
                    cx.spawn(async move { drive(&child, &shared, &name).await });
                }
            }
            _ => {}
        }
        Ok(())
    }

    async fn stop(&mut self, _cx: &Context, _reason: &StopReason) -> Handled {
        self.shared.network.take();
        Ok(())
    }
}

/// Follows one task for good, through the end and the return of its chassis.
async fn follow(cx: &Context, shared: &Shared, source: &str) {
    let mut follower = Follower::new(cx, source);
    loop {
        match follower.next().await {
            Ok(batch) => {
                let all = shared.translator.borrow_mut().take(source, batch);
                if shared.is_there() {
                    shared.publish(cx, all);
                }
            }
            Err(error) => {
                tracing::debug!(source, %error, "nothing is shown");
                cx.sleep(RETRY).await;
            }
        }
    }
}

/// Tells everything again and again.
async fn repeat(cx: &Context, shared: &Shared) {
    loop {
        cx.sleep(AGAIN).await;
        if shared.is_there() {
            let name = format!("{}: bridge to ROS 2", shared.node);
            let bridge = shared.status.borrow().diagnostic(&name, &shared.app);
            let at_ns = cx.now().as_nanos();
            let all = shared.translator.borrow().whole(at_ns, bridge);
            shared.publish(cx, all);
        }
    }
}

/// Carries out the trajectories of one topic, one after the other.
async fn drive(cx: &Context, shared: &Shared, name: &str) {
    let (Some(arm), Some(taken)) = (
        shared.arms.get(name),
        shared.configured(&shared.args.take, name),
    ) else {
        return;
    };
    loop {
        match arm.next(cx, taken).await {
            Ok(text) => {
                tracing::info!(task = cx.name(), name, "{text}");
                shared.status.borrow_mut().done(name, text);
                shared.show(cx);
            }
            Err(text) => shared.wrong(cx, name, text),
        }
    }
}

/// Takes what comes from the network.
async fn hear(cx: &Context, shared: &Rc<Shared>, mut events: mpsc::Receiver<Event>) {
    while let Some(event) = events.recv().await {
        match event {
            Event::There(true, _) => {
                let node = &shared.node;
                tracing::info!(target: LOG_TARGET, task = cx.name(), node, "the network of ROS is there");
                shared.status.borrow_mut().there = (true, String::new());
                shared.show(cx);
            }
            Event::There(false, why) => {
                tracing::warn!(
                    task = cx.name(),
                    why,
                    "the network of ROS is not there; it is looked for each second"
                );
                shared.status.borrow_mut().there = (false, why);
                shared.show(cx);
            }
            Event::Nodes(nodes, peers) => {
                let mut status = shared.status.borrow_mut();
                (status.nodes, status.peers) = (nodes, peers);
                drop(status);
                shared.show(cx);
            }
            Event::Wrong { name, text } => shared.wrong(cx, &name, text),
            Event::Came { name, bytes } => came(cx, shared, &name, &bytes),
            Event::Called { name, bytes, call } => {
                let (child, shared) = (cx.clone(), Rc::clone(shared));
                cx.spawn(async move { called(&child, &shared, &name, &bytes, call).await });
            }
        }
    }
}

/// Why nothing is ordered.
fn may_not(name: &str) -> String {
    format!("`{name}` may only be looked at: [bridge.ros2] says no `allow_control = true`")
}

fn came(cx: &Context, shared: &Rc<Shared>, name: &str, bytes: &[u8]) {
    if !shared.args.allow_control {
        return shared.wrong(cx, name, may_not(name));
    }
    let trajectory: JointTrajectory = match decode(bytes) {
        Ok(trajectory) => trajectory,
        Err(error) => {
            let text = format!("a message of {} bytes cannot be read: {error}", bytes.len());
            return shared.wrong(cx, name, text);
        }
    };
    let (child, shared, name) = (cx.clone(), Rc::clone(shared), name.to_owned());
    cx.spawn(async move {
        let taken = shared.configured(&shared.args.take, &name);
        if let (Some(arm), Some(taken)) = (shared.arms.get(&name), taken) {
            arm.follow(&child, taken, trajectory).await;
        }
    });
}

async fn called(cx: &Context, shared: &Shared, name: &str, bytes: &[u8], call: Call) {
    let refuse = |message: String| {
        shared.wrong(cx, name, message.clone());
        TriggerResponse {
            success: false,
            message,
        }
    };
    let served = shared.configured(&shared.args.serve, name);
    let response = match (decode::<TriggerRequest>(bytes), served) {
        (Err(error), _) => refuse(format!(
            "a call of {} bytes cannot be read: {error}",
            bytes.len()
        )),
        (Ok(_), Some(_)) if shared.args.allow_control && shared.calls.get() >= MOST_CALLS => {
            refuse(format!("{MOST_CALLS} calls are under way already"))
        }
        (Ok(_), Some(served)) if shared.args.allow_control => {
            shared.calls.update(|calls| calls + 1);
            let response = control::serve(cx, served).await;
            shared.calls.update(|calls| calls - 1);
            let TriggerResponse { success, message } = &response;
            match success {
                true => {
                    tracing::info!(
                        task = cx.name(),
                        name,
                        asked = served.task,
                        command = served.command,
                        "asked from ROS"
                    );
                    shared.status.borrow_mut().done(name, message.clone());
                }
                false => shared.wrong(cx, name, message.clone()),
            }
            response
        }
        (Ok(_), _) => refuse(may_not(name)),
    };
    let Ok(bytes) = encode(&response) else { return };
    let at_ns = shared.unix_ns(cx);
    let reply = Order::Reply { call, at_ns, bytes };
    let sent = shared
        .network
        .borrow()
        .as_ref()
        .is_some_and(|network| network.order(reply));
    if !sent {
        shared.lose(cx, 1);
    }
}
