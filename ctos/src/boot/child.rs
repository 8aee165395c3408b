//! The process of one chassis: connects to the others, runs its processors until it is told to end.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::SocketAddr,
    ops::ControlFlow,
    sync::{Arc, Mutex},
};

use tokio::{
    net::{TcpListener, TcpStream},
    sync::oneshot,
    task::JoinHandle,
};

use crate::{
    boot::{
        self,
        rejoin::{Writers, take_newcomers},
    },
    call::lock,
    chassis::Chassis,
    config::App,
    link::tcp::{Connection, FLUSH_LIMIT, Handshake, HandshakeError, Token, VERSION, callers},
    registry::Registry,
    time::Clock,
};

/// Why a chassis could not start.
#[derive(Debug, thiserror::Error)]
pub enum ChildError {
    /// The configuration has no such chassis.
    #[error("the configuration has no chassis `{0}`")]
    Unknown(String),
    /// It could not be connected.
    #[error("cannot connect to {what}: {reason}")]
    Connect {
        /// To whom.
        what: String,
        /// Why not.
        reason: String,
    },
    /// Its address is taken.
    #[error(
        "cannot listen on {address}: {reason}; another program uses the port: choose another `listen`, or leave it out for a free one"
    )]
    Listen {
        /// The address of the configuration.
        address: SocketAddr,
        /// What the system said.
        reason: String,
    },
    /// The system refused a thread or a timer.
    #[error("cannot start: {0}")]
    System(#[from] std::io::Error),
}

/// Runs chassis `name` of `app` until the boot at `boot` tells it to end, or is gone.
/// Returns the process's exit code.
///
/// # Errors
/// [`ChildError`] when it cannot be connected; the boot is told, if it can be reached.
pub fn run_chassis(
    app: App,
    registry: Registry,
    name: &str,
    boot: SocketAddr,
    origin_ns: u64,
) -> Result<i32, ChildError> {
    let app = Arc::new(app);
    let index = app
        .chassis
        .iter()
        .position(|chassis| chassis.name == name)
        .and_then(|position| u8::try_from(position + 1).ok())
        .ok_or_else(|| ChildError::Unknown(name.to_owned()))?;
    let token = Token(std::env::var(super::TOKEN_VARIABLE).unwrap_or_default());
    let chassis = Chassis::new(index, app, Arc::new(registry), Clock::real_from(origin_ns));
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let code = runtime.block_on(serve(&chassis, boot, &token))?;
    runtime.shutdown_background();
    Ok(code)
}

async fn serve(chassis: &Arc<Chassis>, boot: SocketAddr, token: &Token) -> Result<i32, ChildError> {
    let (sender, exited) = oneshot::channel();
    chassis.set_on_exit(move |code| {
        // The receiver lives as long as this function.
        let _ = sender.send(code);
    });
    boot::start_system_tasks(chassis, None);
    let limit = chassis.app.phase_timeout;
    let connected = tokio::time::timeout(limit, connect(chassis, boot, token)).await;
    let (writers, listener) = connected.map_err(|_| ChildError::Connect {
        what: "the other chassis".to_owned(),
        reason: format!("not done within {:.3} s", limit.as_secs_f64()),
    })??;
    let writers: Writers = Arc::new(Mutex::new(writers));
    let newcomers = take_newcomers(chassis.clone(), listener, token.clone(), writers.clone());
    let newcomers = tokio::spawn(newcomers);
    let threads = boot::start_processors(chassis)?;
    // Without a sender left, every chassis thread is gone: an error exit.
    let code = exited.await.unwrap_or(1);
    newcomers.abort();
    let writers = std::mem::take(&mut *lock(&writers));
    finish(chassis, writers).await;
    chassis.stop_processors();
    // A processor that is stuck in a handler must not keep the process; it ends with it.
    let ended = futures_util::future::join_all(threads.into_iter().map(|thread| thread.ended));
    let _ = tokio::time::timeout(FLUSH_LIMIT, ended).await;
    Ok(code)
}

/// Lets the last frames out.
async fn finish(chassis: &Arc<Chassis>, writers: Vec<JoinHandle<()>>) {
    chassis.drop_links();
    let flushed = futures_util::future::join_all(writers);
    // What cannot be written within the limit belongs to a peer that no longer reads.
    let _ = tokio::time::timeout(FLUSH_LIMIT, flushed).await;
}

/// Connects to the boot and to every other chassis.
async fn connect(
    chassis: &Arc<Chassis>,
    boot: SocketAddr,
    token: &Token,
) -> Result<(Vec<JoinHandle<()>>, TcpListener), ChildError> {
    let failed = |what: &str, error: HandshakeError| ChildError::Connect {
        what: what.to_owned(),
        reason: error.to_string(),
    };
    let stream = TcpStream::connect(boot).await;
    let mut parent = stream
        .and_then(Connection::new)
        .map_err(|error| failed("the boot", error.into()))?;
    let listener = match listen(chassis).await {
        Ok(listener) => listener,
        Err(error) => {
            // The boot shows the reason; if it cannot be told, it sees the process end.
            let refused = Handshake::Refused {
                token: token.clone(),
                reason: error.to_string(),
            };
            let _ = parent.tell(&refused).await;
            return Err(error);
        }
    };
    let hello = |listen| Handshake::Hello {
        version: VERSION,
        token: token.clone(),
        chassis: chassis.index(),
        listen,
    };
    let address = listener.local_addr()?;
    let told = parent.tell(&hello(Some(address))).await;
    told.map_err(|error| failed("the boot", error))?;
    let peers = match parent.hear().await {
        Ok(Handshake::Peers(peers)) => peers,
        Ok(other) => {
            return Err(failed(
                "the boot",
                HandshakeError::Unexpected(Box::new(other)),
            ));
        }
        Err(error) => return Err(failed("the boot", error)),
    };
    let mut connections = BTreeMap::new();
    // Lower numbers are called, higher ones call; a newcomer to a running app calls all.
    let calls = |peer: u8| peer < chassis.index() || incarnation() > 1;
    for (peer, address) in &peers {
        if calls(*peer) {
            let name = chassis.name_of(*peer);
            let stream = TcpStream::connect(address).await;
            let mut connection = stream
                .and_then(Connection::new)
                .map_err(|error| failed(name, error.into()))?;
            let told = connection.tell(&hello(None)).await;
            told.map_err(|error| failed(name, error))?;
            connections.insert(*peer, connection);
        }
    }
    let mut missing: BTreeSet<u8> = peers
        .iter()
        .map(|(peer, _)| *peer)
        .filter(|peer| *peer != chassis.index() && !calls(*peer))
        .collect();
    if !missing.is_empty() {
        let called = callers(&listener, token, |caller| {
            if missing.remove(&caller.chassis) {
                connections.insert(caller.chassis, caller.connection);
            }
            if missing.is_empty() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        // The boot says nothing until all are connected; if it does, or is gone, there is no app.
        tokio::select! {
            called = called => called.map_err(|error| failed("the other chassis", error))?,
            heard = parent.hear() => {
                let error = heard.map_or_else(
                    |error| error,
                    |other| HandshakeError::Unexpected(Box::new(other)),
                );
                return Err(failed("the boot", error));
            }
        }
    }
    let told = parent.tell(&Handshake::Ready).await;
    told.map_err(|error| failed("the boot", error))?;
    match parent.hear().await {
        Ok(Handshake::Go) => {}
        Ok(other) => {
            return Err(failed(
                "the boot",
                HandshakeError::Unexpected(Box::new(other)),
            ));
        }
        Err(error) => return Err(failed("the boot", error)),
    }
    connections.insert(0, parent);
    let links = connections.into_iter();
    let writers = links.map(|(peer, connection)| connection.into_link(chassis, peer));
    Ok((writers.collect(), listener))
}

/// Which process of its chassis this one is, from 1.
fn incarnation() -> u32 {
    let number = std::env::var(super::INCARNATION_VARIABLE);
    number.ok().and_then(|text| text.parse().ok()).unwrap_or(1)
}

async fn listen(chassis: &Arc<Chassis>) -> Result<TcpListener, ChildError> {
    let configured = chassis
        .app
        .chassis
        .iter()
        .find(|config| config.name == chassis.name())
        .and_then(|config| config.listen);
    let address = configured.unwrap_or_else(|| SocketAddr::from(([127, 0, 0, 1], 0)));
    TcpListener::bind(address)
        .await
        .map_err(|error| ChildError::Listen {
            address,
            reason: error.to_string(),
        })
}

#[cfg(test)]
mod tests;
