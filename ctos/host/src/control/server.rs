//! The boot's end of the control socket: who is let in, and that all hear how the app ended.

use std::{io, sync::Arc, time::Duration};

use tokio::{sync::Semaphore, task::JoinSet};

use crate::control::{
    LogStore,
    gate::{self, Gate, PLACES},
    news::{News, Ticker},
    place,
    protocol::EndView,
    service::Service,
};
use ctos_bootstrap::bootstrap::{End, Outcome};
use ctos_core::chassis::Chassis;
use ctos_link::transport::Listener;

/// How many clients are served at a time.
const CLIENTS: usize = 64;
/// How long clients may take to hear how the app ended.
const FAREWELL: Duration = Duration::from_secs(1);

/// Serves clients until it is told how the app ended.
pub(crate) struct Server {
    ticker: Ticker,
    _serving: JoinSet<()>,
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
        let mut serving = JoinSet::new();
        let mut serve = |gate, places| {
            serving.spawn(gate::serve(gate, places, service.clone(), clients.clone()));
        };
        if let Some(gate) = gate {
            serve(gate, PLACES);
        }
        match Self::socket(chassis) {
            Ok(listener) => {
                let secret = None;
                serve(Gate { listener, secret }, CLIENTS);
            }
            Err(error) => {
                tracing::warn!(error = %error, "no control socket: `ctos ps` and the like do not see this app");
            }
        }
        Self {
            ticker,
            _serving: serving,
            clients,
        }
    }

    /// A socket in the user's folder.
    fn socket(chassis: &Arc<Chassis>) -> io::Result<Listener> {
        let folder = place::prepared_folder()?;
        // Removes those of apps that were killed.
        place::sockets(&folder);
        let socket = place::socket(&folder, &chassis.app.name, std::process::id());
        // In the place of one of a process of the same number, before the last start of the machine.
        Listener::unix_at(socket.path)
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
        // The server does not wait for one that does not read.
        let _ = tokio::time::timeout(FAREWELL, all_gone).await;
    }
}
