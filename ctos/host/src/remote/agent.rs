//! The agent of a host: waits for boots, lets in who may boot, and has a [`Run`] for each.
//!
//! Everything a stranger does is bounded, as at the door of a mesh; refusals are logged and
//! counted.

use std::{
    collections::BTreeMap,
    io,
    net::SocketAddr,
    path::PathBuf,
    sync::{Arc, Mutex},
    time::Duration,
};

use serde::Serialize;
use tokio::{
    signal::unix::{SignalKind, signal},
    sync::{mpsc, watch},
    task::JoinSet,
};

use super::{
    is_same_user,
    run::{About, Common, Return, Run},
    unpack::set_path,
    wire::{
        BUNDLE_LIMIT, Connection, FRAME_LIMIT, GREETING, HELLO_TIMEOUT, Hello, HelloAnswer, Outbox,
        PROTOCOL, ToBoot, say_last,
    },
};
use crate::doors::{Lobby, PortSecret, STRANGERS, Turned};
use ctos_bootstrap::refusals::Refusals;
use ctos_core::registry::Registry;
use ctos_link::{
    handshake::{self, HandshakeError, Process},
    security::{Identity, KeyError, Keys, Role},
    transport::{Address, Call, Listener, Stream},
};
use ctos_time::{Clock, lock::lock};

/// How many runs there may be at a time.
const RUNS: usize = 32;

/// The longest times that a boot may ask for.
const LONGEST: Duration = Duration::from_secs(3600);

/// How an agent is to be.
#[derive(Debug, Clone)]
pub struct AgentSetup {
    /// Where it listens; port 0 is a free one.
    pub listen: SocketAddr,
    /// Its key without ending, and the certificate of the authority. Without one it listens at the
    /// loopback only, for callers of its own user.
    pub key: Option<(PathBuf, PathBuf)>,
    /// Where the folders of runs are made.
    pub folder: PathBuf,
    /// The program that is a chassis when it is called with `chassis`, usually this one.
    pub program: PathBuf,
}

/// What an agent sees and does, for the code that shows it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
#[non_exhaustive]
pub enum AgentEvent {
    /// It listens.
    Listening {
        /// Where.
        address: SocketAddr,
    },
    /// A boot was let in.
    Boot {
        /// The app's name.
        app: String,
        /// Who boots: where from, and whose key.
        from: String,
    },
    /// A process runs.
    Started {
        /// Its app.
        app: String,
        /// The chassis.
        chassis: String,
        /// Its process id.
        pid: Option<u32>,
    },
    /// A process has ended.
    Ended {
        /// Its app.
        app: String,
        /// The chassis.
        chassis: String,
        /// Completes "the chassis ...".
        how: String,
    },
    /// Nothing of a run is left.
    Over {
        /// Its app.
        app: String,
        /// Why it is over.
        why: String,
    },
    /// A caller, or its app, was refused.
    Refused {
        /// Who.
        who: String,
        /// Why.
        reason: String,
    },
}

/// Sees [`AgentEvent`]s as they happen.
pub type AgentObserver = Arc<dyn Fn(&AgentEvent) + Send + Sync>;

/// An agent that cannot wait for boots.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// Others could let it start processes.
    #[error(
        "an agent at {0}, where others can reach it, needs a key: make one with `ctos keys new keys/NAME --role boot` and add `--key keys/NAME`; or listen at 127.0.0.1"
    )]
    NoKey(SocketAddr),
    /// Its key cannot be used.
    #[error("the agent's key cannot be used: {0}")]
    Key(#[from] KeyError),
    /// Its chassis could not take part with this key.
    #[error(
        "the key `{name}` has the role `{role}`, and an agent, whose chassis use it, needs `boot`"
    )]
    Role {
        /// Whose key it is.
        name: String,
        /// What it may do.
        role: Role,
    },
    /// The address cannot be listened at.
    #[error(
        "cannot listen at {address}: {error}; another program uses the port, or it is not one of this host"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        error: io::Error,
    },
    /// The folder for runs cannot be used.
    #[error("{}: {error}", .folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// The system refused something else.
    #[error("cannot start: {0}")]
    System(#[from] io::Error),
}

/// Why a caller was not let in.
#[derive(Debug, thiserror::Error)]
enum RefusedError {
    #[error(transparent)]
    Key(#[from] KeyError),
    #[error(transparent)]
    Handshake(#[from] HandshakeError),
    #[error("it may not boot: the key `{}` has the role `{}`, and that takes `boot`", .0.name, .0.role)]
    Role(Identity),
    #[error("it may not boot: it does not belong to the user of the agent; give both keys")]
    User,
    #[error("the boot is version {boot} (protocol {protocol}) of the program and the agent version {} (protocol {PROTOCOL}); install the same on both", env!("CARGO_PKG_VERSION"))]
    Version { boot: String, protocol: u32 },
    #[error(
        "it may not boot: it does not know the secret of the agent's port; is it of the same user and host?"
    )]
    Secret,
    #[error("the agent has {RUNS} apps already")]
    Full,
    #[error(transparent)]
    Turned(#[from] Turned),
}

/// The agent of a host.
#[derive(derive_more::Debug)]
#[debug("HostAgent({})", self.address)]
pub struct HostAgent {
    listener: Listener,
    address: SocketAddr,
    common: Arc<Common>,
    stop: watch::Sender<bool>,
    runs: Runs,
    /// What callers must say where there are no keys.
    secret: Option<PortSecret>,
    clock: Clock,
    refused: Refusals,
}

/// The runs by their secret: where their boots come back to, and what waits for them there.
type Runs = Mutex<BTreeMap<String, (mpsc::UnboundedSender<Return>, Arc<Outbox<ToBoot>>)>>;

impl HostAgent {
    /// Listens, so that boots may call from now on, and serves them until SIGINT or SIGTERM; then
    /// everything that was started is ended.
    ///
    /// # Errors
    /// [`AgentError`].
    pub fn run(
        setup: AgentSetup,
        registry: Registry,
        observer: &AgentObserver,
    ) -> Result<(), AgentError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        runtime.block_on(async {
            let mut interrupt = signal(SignalKind::interrupt())?;
            let mut terminate = signal(SignalKind::terminate())?;
            let agent = Self::bind(setup, registry, observer.clone()).await?;
            observer(&AgentEvent::Listening {
                address: agent.address,
            });
            let stop = async {
                tokio::select! {
                    _ = interrupt.recv() => {}
                    _ = terminate.recv() => {}
                }
            };
            agent.serve(stop).await;
            Ok(())
        })
    }

    /// Listens.
    ///
    /// # Errors
    /// [`AgentError`].
    pub(super) async fn bind(
        setup: AgentSetup,
        registry: Registry,
        observer: AgentObserver,
    ) -> Result<Self, AgentError> {
        let mut key_arguments = Vec::new();
        let keys = match &setup.key {
            Some((key, authority)) => {
                let key = std::path::absolute(key)?;
                let authority = std::path::absolute(authority)?;
                let keys = Keys::load(&key, &authority)?;
                if !keys.identity().may(Role::Boot) {
                    let Identity { name, role } = keys.identity().clone();
                    return Err(AgentError::Role { name, role });
                }
                key_arguments.push(set_path("security.key", &key));
                key_arguments.push(set_path("security.authority", &authority));
                Some(Arc::new(keys))
            }
            None if !setup.listen.ip().to_canonical().is_loopback() => {
                return Err(AgentError::NoKey(setup.listen));
            }
            None => None,
        };
        std::fs::read_dir(&setup.folder).map_err(|error| AgentError::Folder {
            folder: setup.folder.clone(),
            error,
        })?;
        let failed = |error| AgentError::Listen {
            address: setup.listen,
            error,
        };
        let listener = Listener::tcp(setup.listen, keys).await.map_err(failed)?;
        let address = match listener.address()? {
            Address::Tcp(address) => address,
            _ => setup.listen,
        };
        let secret = match setup.key {
            Some(_) => None,
            None => Some(PortSecret::new(address)?),
        };
        let (stop, stopping) = watch::channel(false);
        Ok(Self {
            listener,
            address,
            common: Arc::new(Common {
                program: setup.program,
                folder: std::path::absolute(&setup.folder)?,
                key_arguments,
                registry,
                observer,
                stopping,
            }),
            stop,
            runs: Runs::default(),
            secret,
            clock: Clock::real(),
            refused: Refusals::default(),
        })
    }

    /// Where it listens.
    #[cfg(test)]
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Serves boots until `stop` ends, and then until nothing is left that was started for them.
    pub(super) async fn serve(self, stop: impl Future<Output = ()>) {
        let agent = Arc::new(self);
        let mut stop = std::pin::pin!(stop);
        let lobby = Lobby::new(STRANGERS);
        let mut serving = JoinSet::new();
        loop {
            let refuse = |_: Option<&Call>, why: &str| agent.refuse(None, why);
            let (call, guest) = tokio::select! {
                next = lobby.next(|| agent.listener.accept(), refuse) => next,
                () = &mut stop => break,
            };
            while serving.try_join_next().is_some() {}
            let from = call.ends().map(|(peer, _)| peer);
            let agent = agent.clone();
            serving.spawn(async move {
                match guest.hear(HELLO_TIMEOUT, agent.hear(call)).await {
                    Ok(heard) => agent.admit(heard, from).await,
                    Err(error) => agent.refuse(from, &error.to_string()),
                }
            });
        }
        agent.stop.send_replace(true);
        while serving.join_next().await.is_some() {}
    }

    fn refuse(&self, from: Option<SocketAddr>, reason: &str) {
        let who = from.map_or_else(|| "a caller".to_owned(), |from| from.to_string());
        if self.refused.note(&self.clock, &who, reason) {
            (self.common.observer)(&AgentEvent::Refused {
                who,
                reason: reason.to_owned(),
            });
        }
    }

    /// Hears who calls.
    async fn hear(&self, call: Call) -> Result<Heard, RefusedError> {
        let ends = call.ends();
        let (mut stream, identity) = call.prove().await?;
        let hello = handshake::hear_greeting(&mut stream, GREETING).await?;
        Ok(Heard {
            stream,
            identity,
            hello,
            ends,
        })
    }

    /// Why a caller gets no run, if that is so.
    fn objection(&self, heard: &Heard, is_known: bool) -> Option<RefusedError> {
        let Heard { hello, ends, .. } = heard;
        match &heard.identity {
            Some(identity) if !identity.may(Role::Boot) => {
                return Some(RefusedError::Role(identity.clone()));
            }
            Some(_) => {}
            None => {
                let same = |(peer, ours)| is_same_user(peer, ours).unwrap_or(false);
                if !ends.is_some_and(same) {
                    return Some(RefusedError::User);
                }
            }
        }
        let versions = (hello.protocol, hello.version.as_str());
        if versions != (PROTOCOL, env!("CARGO_PKG_VERSION")) {
            return Some(RefusedError::Version {
                boot: hello.version.clone(),
                protocol: hello.protocol,
            });
        }
        let secret = self.secret.as_ref();
        if !secret.is_none_or(|secret| secret.is(hello.secret.as_ref())) {
            return Some(RefusedError::Secret);
        }
        let is_full = !is_known && lock(&self.runs).len() >= RUNS;
        is_full.then_some(RefusedError::Full)
    }

    /// Gives the caller a run, or says why not.
    async fn admit(self: &Arc<Self>, heard: Heard, from: Option<SocketAddr>) {
        let known = lock(&self.runs).get(&heard.hello.run.0).cloned();
        let objection = self.objection(&heard, known.is_some());
        let Heard {
            mut stream,
            identity,
            hello,
            ..
        } = heard;
        if let Some(refused) = objection {
            let reason = refused.to_string();
            self.refuse(from, &reason);
            return say_last(stream, &HelloAnswer::Refused { reason }).await;
        }
        let silence =
            Duration::from_millis(hello.silence_ms).clamp(Duration::from_millis(20), LONGEST);
        let answer = HelloAnswer::Welcome {
            known: known.is_some(),
            process: Process::this(),
        };
        let told = tokio::time::timeout(HELLO_TIMEOUT, handshake::say(&mut stream, &answer)).await;
        if !matches!(told, Ok(Ok(()))) {
            return self.refuse(from, "it did not hear the answer");
        }
        if let Some((connections, outbox)) = known {
            let connection = Connection::new(stream, outbox, FRAME_LIMIT, silence);
            // A run that has just ended has nobody to come back to; the boot sees it hang up.
            let _ = connections.send(Some(connection));
            return;
        }
        let from = from.map_or_else(String::new, |from| from.to_string());
        (self.common.observer)(&AgentEvent::Boot {
            app: hello.app.clone(),
            from: match identity {
                Some(identity) => format!("{from} with the key `{}`", identity.name),
                None => from,
            },
        });
        let replaced = hello.replaces.as_ref();
        let replaced = replaced.and_then(|run| lock(&self.runs).get(&run.0).cloned());
        if let Some((replaced, _)) = replaced {
            // It may just have ended.
            let _ = replaced.send(None);
            replaced.closed().await;
        }
        let (sender, anew) = mpsc::unbounded_channel();
        let outbox = Outbox::new(ToBoot::may_be_dropped);
        lock(&self.runs).insert(hello.run.0.clone(), (sender, outbox.clone()));
        let connection = Connection::new(stream, outbox.clone(), BUNDLE_LIMIT, silence);
        let about = About {
            app: hello.app,
            silence,
            stop: Duration::from_millis(hello.stop_ms).min(LONGEST),
        };
        let run = Run::new(self.common.clone(), about, outbox);
        run.serve(connection, anew).await;
        lock(&self.runs).remove(&hello.run.0);
    }
}

/// A caller that has said who it is.
struct Heard {
    stream: Stream,
    identity: Option<Identity>,
    hello: Hello,
    /// Where it comes from, and where it arrived.
    ends: Option<(SocketAddr, SocketAddr)>,
}
