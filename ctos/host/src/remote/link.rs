//! The boot's links to the agents of its hosts. It calls them and sends them the app. It passes on
//! orders to processes there, and news of them.
//!
//! A connection that breaks is opened again. An agent that is silent for longer than a peer may be is
//! lost, and with it, for the boot, every process of its host. Supervision decides what follows; when
//! it wants a process there again, the agent is called again.

#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use rustix::process::Signal;
use tokio::sync::{mpsc, oneshot};

use super::{
    call::{Compared, files},
    wire::{
        AppFiles, Asked, Connection, HELLO_TIMEOUT, Hello, Outbox, PROTOCOL, Pulse, ToAgent,
        ToBoot, ticks,
    },
};
use crate::boot::{
    launcher::{Briefing, ProcessId},
    processes::Witness,
    spawn::Ending,
};
use ctos_bootstrap::bootstrap::HostError;
use ctos_config::HostConfig;
use ctos_core::chassis::Chassis;
use ctos_link::{handshake::Token, security::Keys, transport::Address};
use ctos_message::ChassisNumber;
use ctos_time::{Clock, Instant};

/// The pause before an attempt to have a broken connection anew.
const PAUSE: Duration = Duration::from_millis(50);

/// What the links to all hosts need.
pub(crate) struct HostsSetup<'a> {
    pub(crate) chassis: &'a Arc<Chassis>,
    pub(crate) keys: Option<Arc<Keys>>,
    /// What to tell chassis besides the app.
    pub(crate) options: &'a [String],
    /// Where chassis of other hosts reach the boot.
    pub(crate) boot: Address,
    pub(crate) token: Token,
}

/// The links to the hosts of an app, by name.
#[derive(Clone, Default)]
pub(crate) struct Hosts(Arc<BTreeMap<String, HostLink>>);

/// Takes orders for processes of one host.
#[derive(Clone)]
pub(crate) struct HostLink(mpsc::UnboundedSender<Order>);

enum Order {
    Start(Arc<Witness>),
    Signal(ProcessId, Asked),
    Close(oneshot::Sender<()>),
}

impl Hosts {
    /// Calls the agents of all hosts that have chassis, and sends them the app.
    ///
    /// # Errors
    /// Every host on which nothing can be started.
    pub(crate) async fn connect(setup: &HostsSetup<'_>) -> Result<Self, Vec<HostError>> {
        let app = &setup.chassis.app;
        let used = app.hosts.iter().filter(|host| app.is_used(host));
        let used: Vec<&HostConfig> = used.collect();
        let Some(first) = used.first() else {
            return Ok(Self::default());
        };
        let files = files(app, &setup.chassis.registry(), setup.options);
        let files = files.map_err(|reason| {
            vec![HostError {
                host: first.name.clone(),
                agent: first.agent,
                reason,
            }]
        })?;
        let files = Arc::new(files);
        let calls = used.into_iter().map(|host| {
            let mut link = Link::new(setup, host, files.clone());
            async move {
                let connection = link.open().await;
                connection.map(|connection| (link, connection))
            }
        });
        let mut links = BTreeMap::new();
        let mut errors = Vec::new();
        for called in futures_util::future::join_all(calls).await {
            match called {
                Ok((link, connection)) => {
                    let (sender, orders) = mpsc::unbounded_channel();
                    links.insert(link.host.name.clone(), HostLink(sender));
                    tokio::spawn(link.run(connection, orders));
                }
                Err(error) => errors.push(error),
            }
        }
        let hosts = Self(Arc::new(links));
        if errors.is_empty() {
            return Ok(hosts);
        }
        hosts.close().await;
        Err(errors)
    }

    pub(crate) fn link(&self, name: &str) -> Option<HostLink> {
        self.0.get(name).cloned()
    }

    /// Tells all agents that the run is over, and waits until nothing of it is left there.
    pub(crate) async fn close(&self) {
        let closed = self.0.values().map(|link| {
            let (done, over) = oneshot::channel();
            // A link that has ended is closed.
            let _ = link.0.send(Order::Close(done));
            async {
                let _ = over.await;
            }
        });
        futures_util::future::join_all(closed).await;
    }
}

impl HostLink {
    /// Starts the process that `witness` waits to hear of.
    pub(crate) fn start(&self, witness: Arc<Witness>) {
        if let Err(unsent) = self.0.send(Order::Start(witness))
            && let Order::Start(witness) = unsent.0
        {
            witness.ended(Ending::unseen("could not be started: the app is ending"));
        }
    }

    /// Sends a process a signal: SIGTERM, or for all others SIGKILL.
    pub(crate) fn signal(&self, id: ProcessId, signal: Signal) {
        let asked = if signal == Signal::TERM {
            Asked::Term
        } else {
            Asked::Kill
        };
        // A link that has ended has no processes.
        let _ = self.0.send(Order::Signal(id, asked));
    }
}

/// A process on the host, to this end.
struct Live {
    witness: Arc<Witness>,
    started: bool,
    /// How many lines of its log have come, or are known to be lost.
    lines: u64,
    asked: Option<Asked>,
}

/// Why a connection is served no more.
enum Left {
    Closed(oneshot::Sender<()>),
    /// It broke; it may be had anew.
    Broke(String),
    /// The agent has been silent for too long already.
    Silent(String),
}

pub(super) struct Link {
    pub(super) host: HostConfig,
    pub(super) clock: Clock,
    pub(super) keys: Option<Arc<Keys>>,
    pub(super) boot: Address,
    pub(super) token: Token,
    /// The last run that the agent has begun.
    pub(super) last_run: Option<Token>,
    pub(super) hello: Hello,
    pub(super) phase: Duration,
    pub(super) silence: Duration,
    pub(super) files: Arc<AppFiles>,
    pub(super) outbox: Arc<Outbox<ToAgent>>,
    live: BTreeMap<ChassisNumber, Live>,
    pub(super) compared: Option<Compared>,
    pub(super) pings: u64,
    pub(super) pinged: Option<(u64, Instant)>,
}

impl Link {
    fn new(setup: &HostsSetup<'_>, host: &HostConfig, files: Arc<AppFiles>) -> Self {
        let app = &setup.chassis.app;
        let millis = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        Self {
            host: host.clone(),
            clock: setup.chassis.clock.clone(),
            keys: setup.keys.clone(),
            boot: setup.boot.clone(),
            token: setup.token.clone(),
            hello: Hello {
                protocol: PROTOCOL,
                version: env!("CARGO_PKG_VERSION").to_owned(),
                run: Token(String::new()),
                replaces: None,
                app: app.name.clone(),
                silence_ms: millis(app.links.peer_timeout),
                stop_ms: millis(app.stop_timeout),
                secret: None,
            },
            last_run: None,
            phase: app.phase_timeout,
            silence: app.links.peer_timeout,
            files,
            outbox: Outbox::new(|_| false),
            live: BTreeMap::new(),
            compared: None,
            pings: 0,
            pinged: None,
        }
    }

    pub(super) fn error(&self, reason: String) -> HostError {
        HostError {
            host: self.host.name.clone(),
            agent: self.host.agent,
            reason,
        }
    }

    /// Serves the boot until it closes the link.
    async fn run(mut self, mut connection: Connection, mut orders: mpsc::UnboundedReceiver<Order>) {
        loop {
            let left = self.serve(&mut connection, &mut orders).await;
            let had = match left {
                Left::Closed(done) => return self.say_bye(connection, done).await,
                Left::Silent(reason) => Err(reason),
                Left::Broke(reason) => {
                    let host = &self.host.name;
                    tracing::warn!(host, reason, "the connection to an agent broke");
                    drop(connection);
                    self.again(&reason).await
                }
            };
            match had {
                Ok(had) => {
                    connection = had;
                    continue;
                }
                Err(reason) => self.lost(&reason).await,
            }
            // Nothing runs there; the next process that is wanted brings it back.
            connection = loop {
                match orders.recv().await {
                    Some(Order::Start(witness)) => match self.open().await {
                        Ok(connection) => {
                            self.start(witness);
                            break connection;
                        }
                        Err(error) => {
                            witness.ended(Ending::unseen(format!("could not be started: {error}")));
                        }
                    },
                    Some(Order::Signal(..)) => {}
                    // The sender is dropped, and that says it.
                    Some(Order::Close(_)) | None => return,
                }
            };
        }
    }

    /// Serves one connection until it breaks or is closed.
    async fn serve(
        &mut self,
        connection: &mut Connection,
        orders: &mut mpsc::UnboundedReceiver<Order>,
    ) -> Left {
        let mut pulse = Pulse::new(self.silence);
        let mut ticks = ticks(&pulse);
        loop {
            tokio::select! {
                heard = connection.hear::<ToBoot>() => match heard {
                    Ok(said) => {
                        pulse.heard();
                        if let Err(reason) = self.heard(said) {
                            return Left::Broke(reason);
                        }
                    }
                    Err(error) => return Left::Broke(error.to_string()),
                },
                order = orders.recv() => match order {
                    Some(Order::Start(witness)) => self.start(witness),
                    Some(Order::Signal(id, asked)) => self.signal(id, asked),
                    Some(Order::Close(done)) => return Left::Closed(done),
                    None => std::future::pending().await,
                },
                _ = ticks.tick() => {
                    if let Err(error) = pulse.look() {
                        return Left::Silent(error.to_string());
                    }
                    self.ping();
                }
            }
        }
    }

    /// Has a broken connection anew, within the time that a peer may be silent.
    async fn again(&mut self, why: &str) -> Result<Connection, String> {
        let mut pulse = Pulse::new(self.silence);
        let mut why = why.to_owned();
        loop {
            let called = tokio::time::timeout(self.silence, self.call()).await;
            match called {
                Ok(Ok((connection, true))) => {
                    self.say_all();
                    return Ok(connection);
                }
                Ok(Ok((mut connection, false))) => {
                    self.all_ended("is gone: the agent of its host was started anew")
                        .await;
                    let begun = self.begin(&mut connection).await;
                    return begun.map(|()| connection).map_err(|error| error.reason);
                }
                Ok(Err(error)) => why = error.reason,
                Err(_) => {}
            }
            if pulse.look().is_err() {
                return Err(why);
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    async fn lost(&mut self, reason: &str) {
        let HostConfig { name, agent, .. } = &self.host;
        let how = format!("is lost with its host `{name}` ({agent}): {reason}");
        self.all_ended(&how).await;
    }

    /// To this end all processes have ended. Those that are still linked are stopping, or will be, and
    /// are given the time for it: the next ones must not meet them.
    async fn all_ended(&mut self, how: &str) {
        let live = self.live.values();
        let witnesses: Vec<_> = live.map(|live| live.witness.clone()).collect();
        let unlinked = async {
            while witnesses.iter().any(|witness| witness.is_linked()) {
                tokio::time::sleep(PAUSE).await;
            }
        };
        let stop = Duration::from_millis(self.hello.stop_ms);
        // One that has not ended then is cut off when its place is taken.
        let _ = tokio::time::timeout(stop + PAUSE, unlinked).await;
        for live in std::mem::take(&mut self.live).into_values() {
            live.witness.ended(Ending::unseen(how));
        }
    }

    fn start(&mut self, witness: Arc<Witness>) {
        let chassis = witness.id.chassis;
        self.say_start(&witness);
        let live = Live {
            witness,
            started: false,
            lines: 0,
            asked: None,
        };
        self.live.insert(chassis, live);
    }

    fn say_start(&self, witness: &Witness) {
        let briefing = Briefing {
            name: witness.name.clone(),
            incarnation: witness.id.incarnation,
            origin_ns: self.compared.map_or(0, |compared| compared.origin_ns),
            boot: self.boot.clone(),
            token: self.token.clone(),
        };
        self.outbox
            .say(ToAgent::Start(witness.id.chassis, briefing));
    }

    fn signal(&mut self, id: ProcessId, signal: Asked) {
        if let Some(live) = self.live(id) {
            live.asked = Some(signal);
            self.outbox.say(ToAgent::Signal(id, signal));
        }
    }

    /// To an agent that is back: what it may not have heard.
    fn say_all(&self) {
        for live in self.live.values() {
            self.say_start(&live.witness);
            if let Some(signal) = live.asked {
                self.outbox.say(ToAgent::Signal(live.witness.id, signal));
            }
        }
    }

    fn live(&mut self, id: ProcessId) -> Option<&mut Live> {
        let live = self.live.get_mut(&id.chassis)?;
        (live.witness.id == id).then_some(live)
    }

    /// Passes on what the agent says.
    pub(super) fn heard(&mut self, said: ToBoot) -> Result<(), String> {
        let host = self.host.name.clone();
        match said {
            ToBoot::Started(id, pid) => {
                if let Some(live) = self.live(id)
                    && !std::mem::replace(&mut live.started, true)
                {
                    live.witness.started(pid);
                }
            }
            ToBoot::Line(id, number, text) => {
                if let Some(live) = self.live(id)
                    && number > live.lines
                {
                    live.missed(number - 1, &host);
                    live.lines = number;
                    live.witness.line(text);
                }
            }
            ToBoot::Ended(id, ending, lines) => {
                if self.live(id).is_some()
                    && let Some(mut live) = self.live.remove(&id.chassis)
                {
                    live.missed(lines, &host);
                    live.witness.ended(ending);
                }
            }
            ToBoot::Pong {
                number,
                monotonic_ns,
            } => self.pong(number, monotonic_ns),
            ToBoot::Unpacked => {}
            ToBoot::Refused { reason } => return Err(reason),
            ToBoot::Over => return Err("it has ended the run".to_owned()),
        }
        Ok(())
    }

    async fn say_bye(self, mut connection: Connection, done: oneshot::Sender<()>) {
        self.outbox.say(ToAgent::Bye);
        let over = async { while !matches!(connection.hear().await, Ok(ToBoot::Over) | Err(_)) {} };
        if tokio::time::timeout(self.silence.max(HELLO_TIMEOUT), over)
            .await
            .is_err()
        {
            tracing::warn!(
                host = self.host.name,
                "an agent does not say that nothing is left"
            );
        }
        // Nobody may wait any more.
        let _ = done.send(());
    }
}

impl Live {
    /// Tells of lines up to `number` that have not come.
    fn missed(&mut self, number: u64, host: &str) {
        let lost = number.saturating_sub(self.lines);
        if lost > 0 {
            self.lines = number;
            let lines = if lost == 1 { "line" } else { "lines" };
            self.witness.line(format!(
                "WARN {lost} {lines} of this log were lost on the way from host `{host}`"
            ));
        }
    }
}
