//! Where tools of other hosts come in: over TLS, each with what the role of its key permits; at the
//! loopback without keys those of the same user.
//!
//! Everything a stranger does is bounded, and who is refused is logged and counted.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use tokio::{sync::Semaphore, task::JoinSet};

use super::desk::{Client, Desk, Writer, busy, tell};
use crate::{
    link::transport::{Call, Listener, Stream},
    remote::is_same_user,
    security::{KeyError, Role},
};

/// How many callers who have not shown who they are are heard at a time.
const STRANGERS: usize = 64;

/// How many of the places for clients they may have, so that there is always one for the app's own user.
const PLACES: usize = 32;

/// How long a caller may take to show who it is.
const LIMIT: Duration = Duration::from_secs(5);

/// How long to wait after an `accept` that failed: no file descriptors for the moment, perhaps.
const ACCEPT_PAUSE: Duration = Duration::from_millis(20);

/// Why a caller is not served.
#[derive(Debug, thiserror::Error)]
enum GateError {
    #[error(transparent)]
    Key(#[from] KeyError),
    #[error("it does not belong to the user of the app, who gave it no keys ([security])")]
    User,
    #[error("it did not show who it is in time")]
    Late,
}

/// Serves tools until it is aborted.
pub(super) async fn serve(listener: Listener, desk: Arc<Desk>, clients: Arc<Semaphore>) {
    let strangers = Arc::new(Semaphore::new(STRANGERS));
    let places = Arc::new(Semaphore::new(PLACES));
    let mut serving = JoinSet::new();
    loop {
        let call = tokio::select! {
            call = listener.accept() => call,
            Some(_) = serving.join_next() => continue,
        };
        let call = match call {
            Ok(call) => call,
            Err(error) => {
                tracing::warn!(error = %error, "a client was lost");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        call.keep_alive();
        let ends = call.ends();
        let from = ends.map_or_else(|| "a caller".to_owned(), |(peer, _)| peer.to_string());
        let Ok(stranger) = strangers.clone().try_acquire_owned() else {
            desk.refuse(&from, "too many callers at once");
            continue;
        };
        let (desk, clients, places) = (desk.clone(), clients.clone(), places.clone());
        serving.spawn(async move {
            let met = tokio::time::timeout(LIMIT, meet(call, ends, &from)).await;
            drop(stranger);
            let (client, stream) = match met.unwrap_or(Err(GateError::Late)) {
                Ok(met) => met,
                Err(error) => return desk.refuse(&from, &error.to_string()),
            };
            let (reader, writer) = tokio::io::split(stream);
            let mut writer: Writer = Box::new(writer);
            let served = match (places.try_acquire_owned(), clients.try_acquire_owned()) {
                (Ok(_far), Ok(_place)) => desk.client(&client, Box::new(reader), writer).await,
                _ => tell(&mut writer, &busy()).await,
            };
            if let Err(error) = served {
                tracing::debug!(who = client.who, error = %error, "a client went away");
            }
        });
    }
}

/// Lets the caller show who it is.
async fn meet(
    call: Call,
    ends: Option<(SocketAddr, SocketAddr)>,
    from: &str,
) -> Result<(Client, Stream), GateError> {
    let (stream, identity) = call.prove().await?;
    let client = match identity {
        Some(identity) => Client {
            who: format!("the key `{}`", identity.name),
            role: identity.role,
        },
        None if ends.is_some_and(|(peer, ours)| is_same_user(peer, ours).unwrap_or(false)) => {
            Client {
                who: from.to_owned(),
                role: Role::Boot,
            }
        }
        None => return Err(GateError::User),
    };
    Ok((client, stream))
}
