//! One run of an app on the agent's host: its files, its processes, and the connection to its boot.
//!
//! It outlives the connection for as long as a peer may be silent; then everything of it is ended and
//! removed.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    process::Stdio,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use rustix::process::Signal;
use tokio::sync::{mpsc, watch};

use super::{
    agent::{AgentEvent, AgentObserver},
    unpack::Unpacked,
    wire::{
        AppFiles, Asked, Connection, FRAME_LIMIT, Outbox, Pulse, ToAgent, ToBoot, WireError, ticks,
    },
};
use crate::boot::{
    launcher::{Briefing, ProcessId, TETHER_VARIABLE},
    spawn::{self, Ending, LAST_WORDS, Spawned},
};
use ctos_core::registry::Registry;
use ctos_message::ChassisNumber;
use ctos_time::Clock;

/// What all runs of an agent have in common.
pub(super) struct Common {
    pub(super) program: PathBuf,
    /// Where runs have their folders.
    pub(super) folder: PathBuf,
    /// What to tell chassis of the agent's own keys.
    pub(super) key_arguments: Vec<String>,
    pub(super) registry: Registry,
    pub(super) observer: AgentObserver,
    pub(super) stopping: watch::Receiver<bool>,
}

/// A boot is back with a new connection, or else with a new run in the place of this one.
pub(super) type Return = Option<Connection>;

/// What a boot said of its run.
pub(super) struct About {
    pub(super) app: String,
    pub(super) silence: Duration,
    pub(super) stop: Duration,
}

/// A process of the run.
struct Child {
    name: String,
    id: ProcessId,
    /// How many lines its log has so far.
    lines: Arc<AtomicU64>,
    /// It runs, or how it has ended.
    state: Result<Spawned, Ending>,
}

/// A process has ended.
type Gone = (ProcessId, Ending);

/// Why a run is over: the error when its boot is not there to hear of it.
type Over = Result<String, String>;

pub(super) struct Run {
    common: Arc<Common>,
    about: About,
    outbox: Arc<Outbox<ToBoot>>,
    unpacked: Option<Unpacked>,
    children: BTreeMap<ChassisNumber, Child>,
    gone: (mpsc::UnboundedSender<Gone>, mpsc::UnboundedReceiver<Gone>),
}

impl Run {
    pub(super) fn new(common: Arc<Common>, about: About, outbox: Arc<Outbox<ToBoot>>) -> Self {
        Self {
            common,
            about,
            outbox,
            unpacked: None,
            children: BTreeMap::new(),
            gone: mpsc::unbounded_channel(),
        }
    }

    /// Serves the boot over `first`, and over each connection that it makes anew, until the run is over
    /// and nothing of it is left.
    pub(super) async fn serve(
        mut self,
        first: Connection,
        mut anew: mpsc::UnboundedReceiver<Return>,
    ) {
        let mut connection = Some(first);
        let why = self.live(&mut connection, &mut anew).await;
        let why = why.unwrap_or_else(|why| {
            tracing::warn!(app = self.about.app, reason = why, "a run is ended");
            connection = None;
            why
        });
        self.end().await;
        if let Some(unpacked) = self.unpacked.take() {
            unpacked.remove();
        }
        self.tell(&AgentEvent::Over {
            app: self.about.app.clone(),
            why,
        });
        self.outbox.say(ToBoot::Over);
        if let Some(connection) = connection {
            self.farewell(connection).await;
        }
    }

    fn tell(&self, event: &AgentEvent) {
        (self.common.observer)(event);
    }

    async fn live(
        &mut self,
        connection: &mut Option<Connection>,
        anew: &mut mpsc::UnboundedReceiver<Return>,
    ) -> Over {
        let mut pulse = Pulse::new(self.about.silence);
        let mut ticks = ticks(&pulse);
        let mut stopping = self.common.stopping.clone();
        let mut broke = String::new();
        loop {
            let heard = async {
                match connection.as_mut() {
                    Some(connection) => connection.hear().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                heard = heard => match heard {
                    Ok(ToAgent::Bye) => return Ok("the boot has ended it".to_owned()),
                    Ok(said) => {
                        pulse.heard();
                        if let (ToAgent::App(_), Some(connection)) = (&said, connection.as_mut()) {
                            connection.limit(FRAME_LIMIT);
                        }
                        if let Err(over) = self.heard(said) {
                            return Ok(over);
                        }
                    }
                    Err(WireError::Garbled(error)) => {
                        return Err(format!("the boot says what cannot be read: {error}"));
                    }
                    Err(error) => {
                        tracing::debug!(app = self.about.app, error = %error, "a boot is away");
                        broke = error.to_string();
                        *connection = None;
                    }
                },
                Some(back) = anew.recv() => match back {
                    Some(new) => {
                        pulse.heard();
                        *connection = Some(new);
                        self.say_all();
                    }
                    None => return Err("its boot has begun anew".to_owned()),
                },
                Some(gone) = self.gone.1.recv() => self.ended(gone),
                _ = ticks.tick() => if let Err(error) = pulse.look() {
                    let reason = if connection.is_some() { error.to_string() } else { broke };
                    return Err(format!("its boot is gone: {reason}"));
                },
                _ = stopping.wait_for(|stopping| *stopping) => return Ok("the agent is being stopped".to_owned()),
            }
        }
    }

    /// Does what the boot says.
    ///
    /// # Errors
    /// Why the run is over.
    fn heard(&mut self, said: ToAgent) -> Result<(), String> {
        match said {
            ToAgent::App(files) => match self.unpack(*files) {
                Ok(()) => self.outbox.say(ToBoot::Unpacked),
                Err(reason) => {
                    self.tell(&AgentEvent::Refused {
                        who: format!("app `{}`", self.about.app),
                        reason: reason.clone(),
                    });
                    self.outbox.say(ToBoot::Refused { reason });
                    return Err("it cannot run here".to_owned());
                }
            },
            ToAgent::Start(chassis, briefing) => self.start(chassis, &briefing),
            ToAgent::Signal(id, signal) => {
                let child = self.children.get(&id.chassis);
                let child = child.filter(|child| child.id == id);
                if let Some(Ok(spawned)) = child.map(|child| &child.state) {
                    spawned.signal(match signal {
                        Asked::Term => Signal::TERM,
                        Asked::Kill => Signal::KILL,
                    });
                }
            }
            ToAgent::Ping { number } => self.outbox.say(ToBoot::Pong {
                number,
                monotonic_ns: Clock::real().origin_ns().unwrap_or(0),
            }),
            ToAgent::Bye => {}
        }
        Ok(())
    }

    /// Lays the app's files down, in a folder that only this user may enter.
    fn unpack(&mut self, files: AppFiles) -> Result<(), String> {
        if self.unpacked.is_some() {
            return Err("the app's files were sent twice".to_owned());
        }
        self.unpacked = Some(Unpacked::new(&self.common, files)?);
        Ok(())
    }

    /// Starts a process, unless that was done.
    fn start(&mut self, chassis: ChassisNumber, briefing: &Briefing) {
        let incarnation = briefing.incarnation;
        if let Some(child) = self.children.get(&chassis)
            && child.id.incarnation >= incarnation
        {
            return self.say_of(child);
        }
        let id = ProcessId {
            chassis,
            incarnation,
        };
        let lines = Arc::default();
        let spawned = self.spawn(id, briefing, &lines);
        if let Ok(spawned) = &spawned {
            self.tell(&AgentEvent::Started {
                app: self.about.app.clone(),
                chassis: briefing.name.clone(),
                pid: spawned.pid,
            });
        }
        let failed = |reason| Ending::unseen(format!("could not be started: {reason}"));
        let child = Child {
            name: briefing.name.clone(),
            id,
            lines,
            state: spawned.map_err(failed),
        };
        self.say_of(&child);
        self.children.insert(chassis, child);
    }

    fn spawn(
        &self,
        id: ProcessId,
        briefing: &Briefing,
        lines: &Arc<AtomicU64>,
    ) -> Result<Spawned, String> {
        let unpacked = self.unpacked.as_ref();
        let unpacked = unpacked.ok_or("the app's files were not sent")?;
        let mut command = unpacked.command(&self.common);
        briefing.put_into(&mut command);
        command.env(TETHER_VARIABLE, "1");
        let (outbox, counted) = (self.outbox.clone(), lines.clone());
        let line = move |text: String| {
            let number = counted.fetch_add(1, Ordering::Relaxed) + 1;
            outbox.say(ToBoot::Line(id, number, text));
        };
        let gone = self.gone.0.clone();
        let ended = move |ending| {
            // The run waits for all its processes.
            let _ = gone.send((id, ending));
        };
        let spawned = spawn::spawn(command, Stdio::piped(), line, ended);
        spawned.map_err(|error| format!("{}: {error}", self.common.program.display()))
    }

    fn ended(&mut self, (id, ending): Gone) {
        let child = self.children.get_mut(&id.chassis);
        let Some(child) = child.filter(|child| child.id == id) else {
            return;
        };
        let event = AgentEvent::Ended {
            app: self.about.app.clone(),
            chassis: child.name.clone(),
            how: ending.how.clone(),
        };
        child.state = Err(ending);
        self.tell(&event);
        if let Some(child) = self.children.get(&id.chassis) {
            self.say_of(child);
        }
    }

    /// Says how a process is.
    fn say_of(&self, child: &Child) {
        self.outbox.say(match &child.state {
            Ok(spawned) => ToBoot::Started(child.id, spawned.pid),
            Err(ending) => {
                let lines = child.lines.load(Ordering::Relaxed);
                ToBoot::Ended(child.id, ending.clone(), lines)
            }
        });
    }

    /// To a boot that is back: what it may have missed.
    fn say_all(&self) {
        if self.unpacked.is_some() {
            self.outbox.say(ToBoot::Unpacked);
        }
        for child in self.children.values() {
            self.say_of(child);
        }
    }

    /// Ends what is left of the run. First it lets the run go, which the run takes as the loss of
    /// its boot and stops in order. Then SIGTERM, then SIGKILL.
    async fn end(&mut self) {
        let rung = self.about.stop;
        // The end of the last one is seen when its log is read, for which it has some time.
        let last = rung.max(2 * LAST_WORDS);
        let rungs = [
            (None, rung),
            (Some(Signal::TERM), rung),
            (Some(Signal::KILL), last),
        ];
        for (signal, timeout) in rungs {
            for child in self.children.values_mut() {
                let Ok(spawned) = &mut child.state else {
                    continue;
                };
                spawned.tether = None;
                if let Some(signal) = signal {
                    tracing::warn!(chassis = child.name, signal = ?signal, "does not end by itself");
                    spawned.signal(signal);
                }
            }
            let all = async {
                while self.children.values().any(|child| child.state.is_ok()) {
                    match self.gone.1.recv().await {
                        Some(gone) => self.ended(gone),
                        None => return,
                    }
                }
            };
            if tokio::time::timeout(timeout, all).await.is_ok() {
                return;
            }
        }
        tracing::error!(app = self.about.app, "processes of a run cannot be ended");
    }

    /// Lets the boot hear the last of it, and hang up.
    async fn farewell(&self, mut connection: Connection) {
        let hung_up = async { while connection.hear::<ToAgent>().await.is_ok() {} };
        let _ = tokio::time::timeout(self.about.silence, hung_up).await;
    }
}
