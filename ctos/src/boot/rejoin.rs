//! How the process of a chassis that was started anew joins a running app: it is told where the others
//! listen, calls all of them, and is linked once it reached them.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    ops::ControlFlow,
    sync::{Arc, Mutex},
};

use tokio::{net::TcpListener, task::JoinHandle};

use crate::{
    call::lock,
    chassis::Chassis,
    link::tcp::{Caller, Connection, Handshake, HandshakeError, Token, callers},
    system,
};

/// The writers of all links of a chassis, which end when everything posted has been written.
pub(super) type Writers = Arc<Mutex<Vec<JoinHandle<()>>>>;

/// Where the chassis listen.
pub(super) type Addresses = Arc<Mutex<BTreeMap<u8, SocketAddr>>>;

/// Takes newcomers at a chassis that is not the boot, for ever.
pub(super) async fn take_newcomers(
    chassis: Arc<Chassis>,
    listener: TcpListener,
    token: Token,
    writers: Writers,
) {
    let taken = callers(&listener, &token, |caller| {
        // The link of the process before it is down before that of the newcomer is up.
        chassis.link_down(caller.chassis);
        let writer = caller.connection.into_link(&chassis, caller.chassis);
        lock(&writers).push(writer);
        ControlFlow::Continue(())
    });
    if let Err(error) = taken.await {
        tracing::error!(error = %error, "takes no newcomers any more");
    }
}

/// The boot's end of the same.
pub(super) struct Doorman {
    pub(super) chassis: Arc<Chassis>,
    pub(super) token: Token,
    pub(super) addresses: Addresses,
    pub(super) incarnations: Arc<Mutex<BTreeMap<u8, u32>>>,
    pub(super) writers: Writers,
}

impl Doorman {
    /// Takes newcomers for ever.
    pub(super) async fn serve(self: Arc<Self>, listener: TcpListener) {
        loop {
            let taken = callers(&listener, &self.token, |caller| {
                tokio::spawn(self.clone().introduce(caller));
                ControlFlow::Continue(())
            });
            if let Err(error) = taken.await {
                // A newcomer that cannot start says why; its end is seen by whoever started it.
                tracing::error!(error = %error, "a newcomer cannot start");
            }
        }
    }

    async fn introduce(self: Arc<Self>, caller: Caller) {
        let Caller {
            chassis: index,
            listen: Some(listen),
            mut connection,
        } = caller
        else {
            return;
        };
        let incarnation = lock(&self.incarnations).get(&index).copied();
        let Some(incarnation) = incarnation.filter(|_| !self.chassis.is_linked(index)) else {
            tracing::warn!(
                chassis = self.chassis.name_of(index),
                "a newcomer that nobody expects"
            );
            return;
        };
        let peers: Vec<(u8, SocketAddr)> = lock(&self.addresses)
            .iter()
            .filter(|(peer, _)| **peer != index && self.chassis.is_linked(**peer))
            .map(|(peer, address)| (*peer, *address))
            .collect();
        if let Err(error) = introduced(&mut connection, peers).await {
            tracing::error!(chassis = self.chassis.name_of(index), error = %error, "cannot join");
            return;
        }
        lock(&self.addresses).insert(index, listen);
        lock(&self.writers).push(connection.into_link(&self.chassis, index));
        let linked = system::ChassisLinked {
            chassis: index,
            incarnation,
        };
        self.chassis.post_system(system::BOOTSTRAP, linked);
    }
}

async fn introduced(
    connection: &mut Connection,
    peers: Vec<(u8, SocketAddr)>,
) -> Result<(), HandshakeError> {
    connection.tell(&Handshake::Peers(peers)).await?;
    match connection.hear().await? {
        Handshake::Ready => connection.tell(&Handshake::Go).await,
        other => Err(HandshakeError::Unexpected(Box::new(other))),
    }
}
