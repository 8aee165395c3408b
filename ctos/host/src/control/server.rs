//! The boot's end of the control socket: who is let in, and that all hear how the app ended.

use std::{io, path::PathBuf, sync::Arc, time::Duration};

use tokio::{
    net::UnixListener,
    sync::Semaphore,
    task::{JoinHandle, JoinSet},
};

use crate::{
    control::{
        LogStore,
        gate::{self, Gate},
        news::{News, Ticker},
        place,
        protocol::EndView,
        service::{Client, Service, Writer, busy, tell},
    },
    doors::ACCEPT_PAUSE,
};
use ctos_bootstrap::bootstrap::{End, Outcome};
use ctos_core::chassis::Chassis;
use ctos_link::{security::Role, transport::listen_at};

/// How many clients are served at a time.
const CLIENTS: usize = 64;
/// How long clients may take to hear how the app ended.
const FAREWELL: Duration = Duration::from_secs(1);
/// Serves clients until it is told how the app ended. Dropped without that, it takes its socket away.
pub(crate) struct Server {
    path: Option<PathBuf>,
    ticker: Ticker,
    serving: Vec<JoinHandle<()>>,
    clients: Arc<Semaphore>,
}

impl Server {
    /// Serves in the user's folder of sockets, and tools of other hosts at `gate`. An app that can
    /// have no socket there runs without.
    pub(crate) fn start(
        chassis: &Arc<Chassis>,
        logs: &Arc<LogStore>,
        ticker: Ticker,
        gate: Option<Gate>,
    ) -> Self {
        let clients = Arc::new(Semaphore::new(CLIENTS));
        let service = Arc::new(Service::new(chassis, logs, &ticker));
        let mut serving = Vec::new();
        if let Some(gate) = gate {
            let served = gate::serve(gate, service.clone(), clients.clone());
            serving.push(tokio::spawn(served));
        }
        let path = match Self::socket(chassis) {
            Ok((listener, path)) => {
                serving.push(tokio::spawn(serve(listener, service, clients.clone())));
                Some(path)
            }
            Err(error) => {
                tracing::warn!(error = %error, "no control socket: `ctos ps` and the like do not see this app");
                None
            }
        };
        Self {
            path,
            ticker,
            serving,
            clients,
        }
    }

    /// A socket in the user's folder.
    fn socket(chassis: &Arc<Chassis>) -> io::Result<(UnixListener, PathBuf)> {
        let folder = place::folder();
        place::prepare(&folder)?;
        // Removes those of apps that were killed.
        place::sockets(&folder);
        let socket = place::socket(&folder, &chassis.app.name, std::process::id());
        // In the place of one of a process of the same number, before the last start of the machine.
        let listener = listen_at(&socket.path)?;
        Ok((listener, socket.path))
    }

    /// Tells the clients how the app ended, and goes.
    pub(crate) async fn finish(self, outcome: &Outcome) {
        let ended = EndView {
            ok: matches!(&outcome.end, End::Finished(result) if result.ok),
            reason: match &outcome.end {
                End::Finished(result) if !result.ok => result.text.clone(),
                end => end.reason().to_string(),
            },
            casualties: outcome.casualties.clone(),
        };
        // Nobody may be listening.
        let _ = self.ticker.0.send(News::Ended(ended));
        let count = u32::try_from(CLIENTS).unwrap_or(u32::MAX);
        let all_gone = self.clients.acquire_many(count);
        // One that does not read is not waited for.
        let _ = tokio::time::timeout(FAREWELL, all_gone).await;
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        for serving in &self.serving {
            serving.abort();
        }
        if let Some(path) = &self.path {
            // Nobody else removes it but for good reasons.
            let _ = std::fs::remove_file(path);
        }
    }
}

async fn serve(listener: UnixListener, service: Arc<Service>, clients: Arc<Semaphore>) {
    let mut serving = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => {
                    let own = stream.peer_cred().is_ok_and(|peer| {
                        peer.uid() == place::uid() || peer.uid() == 0
                    });
                    if !own {
                        service.refuse("a client of another user", "the socket is its user's own");
                        continue;
                    }
                    let place = clients.clone().try_acquire_owned();
                    let service = service.clone();
                    serving.spawn(async move {
                        let (reader, writer) = stream.into_split();
                        let mut writer: Writer = Box::new(writer);
                        match place {
                            Ok(_place) => {
                                // The user may do what he likes with what is his.
                                let client = Client { who: "its user".to_owned(), role: Role::Boot };
                                service.client(&client, Box::new(reader), writer).await
                            }
                            Err(_) => tell(&mut writer, &busy()).await,
                        }
                    });
                }
                Err(error) => {
                    service.refuse("a client", &format!("it was lost: {error}"));
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            },
            Some(_) = serving.join_next() => {}
        }
    }
}
