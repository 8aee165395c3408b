//! Calls: has a stream to a peer, and has it anew when it breaks.

use std::{sync::Arc, time::Duration};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::net::UnixStream;

use super::{Inner, calls, door::may_be_chassis};
use ctos_core::chassis::Chassis;
use ctos_link::{
    handshake::{Answer, GREETING, Greeting, HandshakeError, Hello, Member, Token, greet, hear},
    security::Keys,
    session::{
        Core, DownReason, Session, drive,
        state::{Event, State},
    },
    shm,
    transport::{Address, ConnectError, Stream, connect, hang_up, is},
};
use ctos_time::{lock::lock, seed::mix};

/// How long the other end may take to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// The pause before the first new attempt; each further one is twice as long, up to the longest. The
/// seed draws between half and all of it, so that those who lost the same peer do not call at once.
const PAUSE: Duration = Duration::from_millis(4);
const LONGEST_PAUSE: Duration = Duration::from_millis(500);

/// A call that came to nothing.
#[derive(Debug, thiserror::Error)]
enum CallError {
    #[error(transparent)]
    Connect(#[from] ConnectError),
    #[error(transparent)]
    Handshake(#[from] HandshakeError),
    #[error("it does not answer")]
    Late,
    #[error("another chassis answers there")]
    Other,
    #[error("it has given this chassis up")]
    GivenUp,
}

impl Inner {
    /// Calls `member` until it is connected, and again whenever the stream breaks, or has it call. The session with it,
    /// unless that is over.
    pub(super) fn call(self: &Arc<Self>, member: Member) -> Option<Arc<Session>> {
        let theirs = (member.chassis, member.incarnation);
        let session = self.session_with(theirs.0, theirs.1, &member.process)?;
        if !session.is_open() {
            return None;
        }
        let was_called = {
            let mut state = lock(&self.state);
            let peer = state.peers.get_mut(&member.chassis)?;
            std::mem::replace(&mut peer.called, true)
        };
        if was_called {
            return Some(session);
        }
        if calls((self.chassis.index(), self.who.incarnation), theirs) {
            let (mesh, called) = (self.clone(), session.clone());
            self.runtime
                .spawn(async move { mesh.keep_calling(&called, &member).await });
        } else {
            self.ask_to_be_called(&member);
        }
        Some(session)
    }

    async fn keep_calling(self: Arc<Self>, session: &Arc<Session>, member: &Member) {
        let app = &self.chassis.app;
        let names = [self.chassis.name(), self.chassis.name_of(member.chassis)];
        let mut rng = ChaCha8Rng::seed_from_u64(mix(app.seed, &["reconnect", names[0], names[1]]));
        let mut pause = PAUSE;
        while session.is_open() {
            if !session.is_cut() {
                match self.call_once(session, member).await {
                    Ok(()) => pause = PAUSE,
                    Err(error) => {
                        self.failed(session, member, &error);
                        pause = (pause * 2).min(LONGEST_PAUSE);
                    }
                }
            }
            let drawn = rng.random_range(0.5..1.0);
            let mut state = session.watch();
            tokio::select! {
                () = tokio::time::sleep(pause.mul_f64(drawn)) => {}
                _ = state.wait_for(|state| *state == State::Down) => {}
            }
        }
    }

    fn failed(&self, session: &Session, member: &Member, error: &CallError) {
        let peer = self.chassis.name_of(member.chassis);
        tracing::debug!(peer, error = %error, "a call came to nothing");
        let near = self.process.sees(&member.process);
        match error {
            CallError::GivenUp => session.event(Event::GivenUp, DownReason::GivenUp),
            CallError::Connect(error) if near && error.is_refused() => {
                session.event(Event::PeerEnded, DownReason::Deserted(error.to_string()));
            }
            CallError::Other => session.event(Event::PeerEnded, DownReason::Replaced),
            _ => {}
        }
        if session.state() == State::Down && session.look(Core::was_never_up) {
            tracing::warn!(peer, error = %error, "cannot be reached");
        }
    }

    /// One stream, from the call to its end.
    async fn call_once(
        self: &Arc<Self>,
        session: &Arc<Session>,
        member: &Member,
    ) -> Result<(), CallError> {
        let address = self.nearest(member);
        let called = tokio::time::timeout(ANSWER_TIMEOUT, self.shake_hands(session, address)).await;
        let (stream, welcome) = called.map_err(|_| CallError::Late)??;
        let Answer::Welcome(hello) = welcome else {
            return Err(CallError::GivenUp);
        };
        let (process, received) = (hello.member.process, hello.received);
        if (hello.member.chassis, hello.member.incarnation) != (member.chassis, member.incarnation)
        {
            return Err(CallError::Other);
        }
        if member.chassis == 0 && session.look(Core::was_never_up) && self.process.sees(&process) {
            // Of the boot only its address was known.
            self.runtime
                .spawn(super::peer::watch(session.clone(), process.pid));
        }
        let carried = if hello.shared {
            let made = shm::pass::send(stream).await;
            let (socket, shared) = made.map_err(HandshakeError::from)?;
            drive::drive_shared(session, socket, shared, received, &self.reactor).await
        } else {
            drive::drive(session, stream, received, &self.reactor).await
        };
        if let Err(error) = carried {
            tracing::debug!(error = %error, "a stream was not wanted");
        }
        Ok(())
    }

    async fn shake_hands(
        &self,
        session: &Session,
        address: &Address,
    ) -> Result<(Stream, Answer), CallError> {
        let (keys, fabric) = (self.keys.as_ref(), self.fabric.as_ref());
        let (mut stream, identity) = connect(address, keys, fabric).await?;
        may_be_chassis(identity.as_ref())?;
        let greeting = Greeting::Hello {
            token: self.who.token.clone(),
            hello: self.hello(session, &stream, true),
        };
        greet(&mut stream, GREETING, &greeting).await?;
        let answer = hear(&mut stream).await?;
        Ok((stream, answer))
    }

    /// What this end says of itself. It uses shared memory where both ends can, and the other one `asks` for it.
    pub(super) fn hello(&self, session: &Session, stream: &Stream, asks: bool) -> Hello {
        let can = self.shares_memory && is::<UnixStream>(stream);
        Hello {
            member: Member {
                chassis: self.chassis.index(),
                incarnation: self.who.incarnation,
                process: self.process.clone(),
                listen: self.listen.clone(),
            },
            received: session.look(Core::received),
            shared: asks && can && !session.look(Core::is_injured),
        }
    }

    /// Where to call a member: through the file system only if it is on this host.
    fn nearest<'m>(&self, member: &'m Member) -> &'m Address {
        const NOWHERE: &Address = &Address::Tcp(std::net::SocketAddr::new(
            std::net::IpAddr::V4(std::net::Ipv4Addr::UNSPECIFIED),
            0,
        ));
        let near = self.process.sees(&member.process);
        let usable = |address: &&Address| match address {
            Address::Unix(_) => near,
            Address::Tcp(_) => true,
            Address::Zenoh(_) => self.fabric.is_some(),
        };
        member.listen.iter().find(usable).unwrap_or(NOWHERE)
    }
}

/// Tells the boot at `boot` why `chassis` cannot start. If that does not succeed, the boot sees the process end.
pub(crate) async fn unable(
    boot: &Address,
    chassis: &Chassis,
    keys: Option<&Arc<Keys>>,
    token: &Token,
    reason: &str,
) {
    let tell = async {
        let (mut stream, _) = connect(boot, keys, None).await.ok()?;
        let greeting = Greeting::Unable {
            token: token.clone(),
            chassis: chassis.index(),
            reason: reason.to_owned(),
        };
        greet(&mut stream, GREETING, &greeting).await.ok()?;
        hang_up(stream).await.ok()
    };
    let _ = tokio::time::timeout(ANSWER_TIMEOUT, tell).await;
}
