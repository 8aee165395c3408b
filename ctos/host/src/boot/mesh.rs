//! The mesh: who connects to whom, for as long as the app runs.
//!
//! Every chassis has a mesh. All others call the boot's, which tells them of each other. Any two others are linked when one
//! first needs the other. Of the two, one calls ([`calls`]), if need be asked to by way of the boot. Calls are taken for
//! the whole run, so a chassis that was started again (with a higher incarnation number) can join. The link of its
//! predecessor goes down first, then its own comes up. Streams that break are opened again until the peer counts as silent.
//!
//! Knows sessions and streams, but nothing of what supervision does about a chassis that is gone.

mod call;
mod door;
mod members;
mod peer;

pub(crate) use call::unable;
pub(crate) use peer::EXIT_GIVEN_UP;

use std::{
    collections::BTreeMap,
    io,
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use tokio::{runtime::Handle, sync::mpsc, task::JoinSet};

use ctos_bootstrap::refusals::Refusals;
use ctos_config::{App, InjuryConfig, SameHost};
use ctos_core::chassis::Chassis;
use ctos_link::{
    handshake::{Member, Process, Token},
    injure::Injury,
    reactor::{self, LinkParker, Reactor},
    security::{KeyError, Keys},
    session::{
        DownReason, Limits, Session,
        state::{Event, State},
    },
    shm::Shared,
    transport::{Address, Listener},
    zenoh::Fabric,
};
use ctos_message::ChassisNumber;
use ctos_time::lock::lock;

/// How long the last frames may take when a process ends.
pub(crate) const FLUSH_TIMEOUT: Duration = Duration::from_secs(1);

/// What the mesh of one chassis tells that of another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
enum Notice {
    /// From the boot: who belongs to the app now.
    Members(Vec<Member>),
    /// To the boot: let this incarnation of a chassis call the sender. From the boot: call it.
    Call(ChassisNumber, u32),
    /// From the boot: this incarnation is not there to call anybody.
    Gone(ChassisNumber, u32),
}

/// What happens to the links of a chassis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum MeshEvent {
    /// A chassis is connected to this one.
    Up {
        chassis: ChassisNumber,
        incarnation: u32,
    },
    /// At the boot: all know of a chassis. Elsewhere: this one (`chassis` is its number) has heard who belongs to the app.
    Joined {
        chassis: ChassisNumber,
        incarnation: u32,
    },
    /// A chassis is gone.
    Down {
        chassis: ChassisNumber,
        incarnation: u32,
        reason: DownReason,
    },
    /// A chassis that was started cannot take part.
    Unable {
        chassis: ChassisNumber,
        reason: String,
    },
}

/// Why a mesh could not be made.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MeshError {
    /// The address of the configuration cannot be listened at.
    #[error(
        "cannot listen on {address}: {error}; another program uses the port, or it is not one of this host: choose another `listen` for it (the boot's stands in [app]), or leave it out for a free one"
    )]
    Listen { address: String, error: io::Error },
    /// The system does not let it wait for its links.
    #[error("cannot wait for links: {0}")]
    Wait(io::Error),
    /// The keys cannot be used.
    #[error("the keys of [security] cannot be used: {0}")]
    Keys(#[from] KeyError),
    /// The network of `[zenoh]` cannot be joined.
    #[error("cannot join the network of [zenoh]: {0}")]
    Zenoh(io::Error),
}

/// Who this chassis is to the others.
pub(crate) struct Identification {
    pub(crate) token: Token,
    /// How often it was started; the first time is 1.
    pub(crate) incarnation: u32,
}

/// A peer as this mesh knows it.
#[derive(Default)]
struct Peer {
    incarnation: u32,
    session: Option<Arc<Session>>,
    /// What the boot, or the peer itself, said of it.
    member: Option<Member>,
    /// Somebody is calling it, or has asked it to call.
    called: bool,
}

#[derive(Default)]
struct Roll {
    peers: BTreeMap<ChassisNumber, Peer>,
    /// At the boot: who of the last announcement is still there, with the incarnation.
    announced: BTreeMap<ChassisNumber, u32>,
}

/// What the tasks of a mesh share.
struct Inner {
    chassis: Arc<Chassis>,
    who: Identification,
    process: Process,
    keys: Option<Arc<Keys>>,
    fabric: Option<Arc<Fabric>>,
    runtime: Handle,
    /// Who reads what comes over plain sockets and shared memory.
    reactor: Arc<Reactor>,
    /// Whether chassis of this host are joined through shared memory.
    shares_memory: bool,
    listen: Vec<Address>,
    state: Mutex<Roll>,
    /// Whose link the chassis has: number and incarnation. Held while that changes.
    live: Mutex<BTreeMap<ChassisNumber, u32>>,
    events: mpsc::UnboundedSender<MeshEvent>,
}

/// The links of one chassis.
pub(crate) struct Mesh {
    inner: Arc<Inner>,
    events: mpsc::UnboundedReceiver<MeshEvent>,
    doors: JoinSet<()>,
}

/// Whether chassis `ours` calls chassis `theirs` (number and incarnation). The one that came later does;
/// of two that came together, the one with the higher number.
fn calls(ours: (ChassisNumber, u32), theirs: (ChassisNumber, u32)) -> bool {
    (ours.1, ours.0) > (theirs.1, theirs.0)
}

impl Mesh {
    /// Listens where the configuration says, from now on.
    ///
    /// # Errors
    /// [`MeshError`].
    pub(crate) async fn start(
        chassis: &Arc<Chassis>,
        who: Identification,
    ) -> Result<Self, MeshError> {
        Self::start_as(chassis, who, Process::this()).await
    }

    async fn start_as(
        chassis: &Arc<Chassis>,
        who: Identification,
        process: Process,
    ) -> Result<Self, MeshError> {
        let app = &chassis.app;
        let keys = keys_of(app)?;
        let fabric = Fabric::join(app, chassis.index() == 0)
            .await
            .map_err(MeshError::Zenoh)?;
        let listeners = listeners(chassis, keys.as_ref(), fabric.as_ref()).await?;
        let addresses: io::Result<Vec<Address>> = listeners.iter().map(Listener::address).collect();
        let addresses = addresses.map_err(not_at(chassis.name()))?;
        let spin = app.links.spin_here();
        let reactor = Reactor::new(chassis.name(), chassis.clock.clone(), spin);
        let reactor = reactor.map_err(MeshError::Wait)?;
        let links = reactor.clone();
        chassis.share(reactor::SHARED, reactor.clone());
        chassis.set_parks(Box::new(move || Arc::new(LinkParker::new(links.clone()))));
        let (sender, events) = mpsc::unbounded_channel();
        let inner = Arc::new(Inner {
            chassis: chassis.clone(),
            who,
            process,
            keys,
            fabric,
            runtime: Handle::current(),
            reactor,
            shares_memory: shares_memory(app.links.same_host),
            listen: addresses,
            state: Mutex::default(),
            live: Mutex::default(),
            events: sender,
        });
        if chassis.index() != 0 {
            let mesh = Arc::downgrade(&inner);
            chassis.connect_by(move |peer| {
                if let Some(mesh) = mesh.upgrade() {
                    mesh.connect(peer);
                }
            });
        }
        let doors = listeners
            .into_iter()
            .map(|listener| door::keep(inner.clone(), listener))
            .collect();
        Ok(Self {
            inner,
            events,
            doors,
        })
    }

    /// The keys of the app, if it has any.
    pub(crate) fn keys(&self) -> Option<Arc<Keys>> {
        self.inner.keys.clone()
    }

    /// Where this chassis can be called, the nearest first.
    pub(crate) fn addresses(&self) -> &[Address] {
        &self.inner.listen
    }

    /// At the boot: from now on only this incarnation of `chassis`, or a later one, may call; the link
    /// of an earlier one goes down.
    pub(crate) fn expect(&self, chassis: ChassisNumber, incarnation: u32) {
        self.inner.supersede(chassis, incarnation);
    }

    /// At the boot: nobody need wait for `chassis`, which ended before it called.
    pub(crate) fn miss(&self, chassis: ChassisNumber) {
        lock(&self.inner.state).peers.remove(&chassis);
        self.inner.changed();
    }

    /// What happens next.
    pub(crate) async fn next(&mut self) -> MeshEvent {
        match self.events.recv().await {
            Some(event) => event,
            // The mesh itself holds the other end.
            None => std::future::pending().await,
        }
    }

    /// How many callers were refused so far.
    pub(crate) fn refused(&self) -> u64 {
        Refusals::of(&self.inner.chassis).count()
    }

    /// Joins the app whose boot listens at `boot`; what comes of it are events.
    pub(crate) fn join(&self, boot: &Address) {
        let near = match boot {
            Address::Unix(_) | Address::Zenoh(_) => true,
            Address::Tcp(at) => at.ip().to_canonical().is_loopback(),
        };
        let member = Member {
            chassis: 0,
            incarnation: 1,
            // One of another host is seen by nobody here.
            process: if near {
                self.inner.process.clone()
            } else {
                Process::default()
            },
            listen: vec![boot.clone()],
        };
        self.inner.call(member);
    }

    /// Says goodbye on all links that have a stream, once everything posted has gone out; nobody is let in any more.
    pub(crate) async fn close(&mut self) {
        tracing::debug!(refused = self.refused(), "the mesh closes");
        self.doors.abort_all();
        let sessions: Vec<Arc<Session>> = {
            let mut state = lock(&self.inner.state);
            let peers = state.peers.values_mut();
            peers.filter_map(|peer| peer.session.take()).collect()
        };
        for session in &sessions {
            session.close();
        }
        let down = sessions.iter().map(|session| {
            let mut state = session.watch();
            async move {
                // An error says that the session is gone.
                let _ = state.wait_for(|state| *state == State::Down).await;
            }
        });
        let down = futures_util::future::join_all(down);
        // What cannot be written within the limit belongs to a peer that no longer reads.
        let _ = tokio::time::timeout(FLUSH_TIMEOUT, down).await;
        if let Some(fabric) = &self.inner.fabric {
            fabric.close().await;
        }
        self.inner.reactor.close();
    }
}

impl Drop for Mesh {
    fn drop(&mut self) {
        self.inner.reactor.close();
    }
}

/// The keys that an app names.
///
/// # Errors
/// When they cannot be used.
pub(crate) fn keys_of(app: &App) -> Result<Option<Arc<Keys>>, KeyError> {
    let Some(security) = &app.security else {
        return Ok(None);
    };
    let place = |path: &Path| app.folder.join(path);
    let keys = Keys::load(&place(&security.key), &place(&security.authority))?;
    Ok(Some(Arc::new(keys)))
}

/// It cannot be listened there.
fn not_at(address: impl ToString) -> impl FnOnce(io::Error) -> MeshError {
    let address = address.to_string();
    move |error| MeshError::Listen { address, error }
}

/// Where this chassis listens: for its own host, and where the configuration says. The first is where
/// others of this host call.
async fn listeners(
    chassis: &Arc<Chassis>,
    keys: Option<&Arc<Keys>>,
    fabric: Option<&Arc<Fabric>>,
) -> Result<Vec<Listener>, MeshError> {
    let app = &chassis.app;
    let listen = app.listens_at(chassis.name());
    let mut listeners = Vec::new();
    if let Some(fabric) = fabric {
        let listener = fabric.listen(chassis.name()).await;
        let listener = listener.map_err(MeshError::Zenoh)?;
        listeners.push(Listener::Zenoh(listener, keys.cloned()));
    }
    if matches!(app.links.same_host, SameHost::Shared | SameHost::Unix) {
        let listener = Listener::unix(chassis.name());
        listeners.push(listener.map_err(not_at("a socket of this user's own"))?);
    }
    if listen.is_some() || app.links.same_host == SameHost::Tcp || listeners.is_empty() {
        let address = listen.unwrap_or_else(|| ([127, 0, 0, 1], 0).into());
        let listener = Listener::tcp(address, keys.cloned()).await;
        listeners.push(listener.map_err(not_at(address))?);
    }
    if app.links.same_host != SameHost::Zenoh {
        // For those on other hosts that cannot be called more directly.
        listeners.sort_by_key(|listener| matches!(listener, Listener::Zenoh(..)));
    }
    Ok(listeners)
}

impl Inner {
    #[cfg(test)]
    fn session(&self, chassis: ChassisNumber) -> Option<Arc<Session>> {
        lock(&self.state).peers.get(&chassis)?.session.clone()
    }

    fn send(&self, event: MeshEvent) {
        // Nobody may listen any more.
        let _ = self.events.send(event);
    }

    /// Ends the session of an earlier incarnation than `incarnation`. False when there is a later one.
    fn supersede(&self, chassis: ChassisNumber, incarnation: u32) -> bool {
        let old = {
            let mut state = lock(&self.state);
            let peer = state.peers.entry(chassis).or_default();
            if peer.incarnation >= incarnation {
                return peer.incarnation == incarnation;
            }
            peer.incarnation = incarnation;
            peer.called = false;
            peer.member = None;
            peer.session.take()
        };
        if let Some(old) = old {
            // Its successor is there, so nothing more can come of it.
            old.event(Event::PeerEnded, DownReason::Ended);
            old.event(Event::Silence, DownReason::Ended);
        }
        true
    }

    /// The session with an incarnation of `chassis`, made when there is none. `None` when a later
    /// incarnation is known.
    fn session_with(
        self: &Arc<Self>,
        chassis: ChassisNumber,
        incarnation: u32,
        process: &Process,
    ) -> Option<Arc<Session>> {
        if !self.supersede(chassis, incarnation) {
            return None;
        }
        let mut state = lock(&self.state);
        let peer = state.peers.entry(chassis).or_default();
        if let Some(session) = &peer.session {
            return Some(session.clone());
        }
        let app = &self.chassis.app;
        let limits = Limits {
            timeout: app.links.peer_timeout,
            unacknowledged: app.links.unacknowledged,
        };
        let injury = self.injury(&app.links.injury, chassis);
        let receiver = peer::PeerReceiver {
            mesh: Arc::downgrade(self),
            chassis,
            incarnation,
        };
        let clock = self.chassis.clock.clone();
        let session = Session::new(clock, limits, injury, Box::new(receiver));
        peer.session = Some(session.clone());
        let leased = (chassis == 0).then(|| self.chassis.clock.clone());
        self.runtime.spawn(peer::keep(session.clone(), leased));
        if self.process.sees(process) {
            self.runtime
                .spawn(peer::watch(session.clone(), process.pid));
        }
        Some(session)
    }

    fn injury(&self, config: &InjuryConfig, peer: ChassisNumber) -> Option<Injury> {
        let (from, to) = (self.chassis.name(), self.chassis.name_of(peer));
        Injury::of(config, self.chassis.app.seed, from, to)
    }
}

/// Whether the configuration wants memory to be shared and the system has some.
fn shares_memory(same_host: SameHost) -> bool {
    if same_host != SameHost::Shared {
        return false;
    }
    let made = Shared::make();
    if let Err(error) = &made {
        tracing::warn!(error = %error, "no memory can be shared: the chassis of this host are joined by sockets");
    }
    made.is_ok()
}

#[cfg(test)]
mod tests;
