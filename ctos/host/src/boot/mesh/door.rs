//! The door of a mesh: takes calls for the whole run and lets in who belongs to it.
//!
//! Everything a stranger does is bounded: how many of them are heard at a time, for how long, and how
//! much they may say. Refusals are logged and counted.

use std::sync::Arc;

use super::{Inner, MeshEvent};
use crate::doors::{Lobby, STRANGER_TIMEOUT, STRANGERS, Turned};
use ctos_bootstrap::refusals::Refusals;
use ctos_link::{
    handshake::{Answer, GREETING, Greeting, HandshakeError, Hello, Member, hear_greeting, say},
    security::{Identity, KeyError, Role},
    session::{AttachError, drive},
    shm,
    transport::{Call, Listener, Stream},
};
use ctos_message::ChassisNumber;

/// Why a caller was not let in.
#[derive(Debug, thiserror::Error)]
enum RefusedError {
    #[error(transparent)]
    Key(#[from] KeyError),
    #[error(transparent)]
    Handshake(#[from] HandshakeError),
    #[error(transparent)]
    Attach(#[from] AttachError),
    #[error(transparent)]
    Turned(#[from] Turned),
    #[error("chassis {chassis} of incarnation {incarnation} was given up")]
    GivenUp {
        chassis: ChassisNumber,
        incarnation: u32,
    },
}

impl RefusedError {
    /// Whether the caller went before it had said who it is.
    fn hung_up(&self) -> bool {
        matches!(self, Self::Handshake(HandshakeError::Io(error))
            if error.kind() == std::io::ErrorKind::UnexpectedEof)
    }
}

/// Takes calls until it is aborted.
pub(super) async fn keep(mesh: Arc<Inner>, listener: Listener) {
    let lobby = Lobby::new(STRANGERS);
    loop {
        let accept = || listener.accept();
        let (call, guest) = lobby.next(accept, |_, why| mesh.refuse(why)).await;
        let mesh = mesh.clone();
        tokio::spawn(async move {
            let heard = guest.hear(STRANGER_TIMEOUT, hear(&mesh, call)).await;
            let served = match heard {
                Ok(Some((stream, hello))) => serve(&mesh, stream, hello).await,
                Ok(None) => Ok(()),
                Err(error) => Err(error),
            };
            match served {
                Ok(()) | Err(RefusedError::Attach(AttachError::Cut)) => {}
                // As one does that looks whether anybody listens here at all.
                Err(error) if error.hung_up() => tracing::debug!("a caller hung up"),
                Err(error) => mesh.refuse(&error.to_string()),
            }
        });
    }
}

/// Hears who calls; `None` when that is all it wanted to say.
async fn hear(mesh: &Arc<Inner>, call: Call) -> Result<Option<(Stream, Hello)>, RefusedError> {
    let (mut stream, identity) = call.prove().await?;
    may_be_chassis(identity.as_ref())?;
    let greeting: Greeting = hear_greeting(&mut stream, GREETING).await?;
    if *greeting.token() != mesh.who.token {
        return Err(HandshakeError::Stranger.into());
    }
    let known = |chassis: ChassisNumber| {
        let mut others = mesh.chassis.others();
        others.any(|other| other == chassis && chassis != 0)
    };
    match greeting {
        Greeting::Hello { hello, .. } if known(hello.member.chassis) => Ok(Some((stream, hello))),
        Greeting::Unable {
            chassis, reason, ..
        } if known(chassis) => {
            mesh.send(MeshEvent::Unable { chassis, reason });
            Ok(None)
        }
        Greeting::Hello { hello, .. } => Err(HandshakeError::Nobody(hello.member.chassis).into()),
        Greeting::Unable { chassis, .. } => Err(HandshakeError::Nobody(chassis).into()),
    }
}

/// A chassis runs what it is told, and tells others; that takes the highest role.
pub(super) fn may_be_chassis(identity: Option<&Identity>) -> Result<(), HandshakeError> {
    match identity {
        Some(identity) if !identity.may(Role::Boot) => Err(HandshakeError::Role {
            role: identity.role,
        }),
        _ => Ok(()),
    }
}

/// Answers a chassis of this run and carries its session over the stream.
async fn serve(mesh: &Arc<Inner>, mut stream: Stream, hello: Hello) -> Result<(), RefusedError> {
    let Hello {
        member,
        received,
        shared,
    } = hello;
    let (chassis, incarnation) = (member.chassis, member.incarnation);
    let session = mesh.session_with(chassis, incarnation, &member.process);
    let Some(session) = session.filter(|session| session.is_open()) else {
        say(&mut stream, &Answer::GivenUp).await?;
        return Err(RefusedError::GivenUp {
            chassis,
            incarnation,
        });
    };
    mesh.introduce(member);
    let hello = mesh.hello(&session, &stream, shared);
    let (shared, welcome) = (hello.shared, Answer::Welcome(hello));
    tokio::time::timeout(STRANGER_TIMEOUT, say(&mut stream, &welcome))
        .await
        .map_err(|_| HandshakeError::Late)??;
    if !shared {
        return Ok(drive::drive(&session, stream, received, &mesh.reactor).await?);
    }
    let taken = tokio::time::timeout(STRANGER_TIMEOUT, shm::pass::receive(stream)).await;
    let (socket, shared) = taken
        .map_err(|_| HandshakeError::Late)?
        .map_err(HandshakeError::from)?;
    Ok(drive::drive_shared(&session, socket, shared, received, &mesh.reactor).await?)
}

impl Inner {
    fn refuse(&self, reason: &str) {
        let chassis = &self.chassis;
        Refusals::of(chassis).note(&chassis.clock, "a caller", reason);
    }

    /// What a chassis says of itself, for the others.
    pub(super) fn introduce(&self, member: Member) {
        let mut state = ctos_time::lock::lock(&self.state);
        if let Some(peer) = state.peers.get_mut(&member.chassis) {
            peer.member = Some(member);
        }
    }
}
