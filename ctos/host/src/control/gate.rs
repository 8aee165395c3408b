//! Where tools come in. Tools of the app's own user come by its socket, those of other hosts over TLS with what
//! the role of their key permits. At the loopback without keys, tools of the same user show the secret of the
//! port.
//!
//! All that a stranger does is bounded, and refusals are logged and counted.

use std::{net::SocketAddr, sync::Arc};

use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, BufReader},
    net::UnixStream,
    sync::Semaphore,
    task::JoinSet,
};

use super::{
    protocol::{ErrorCode, Shown},
    service::{Client, Reader, Service, Writer, busy, error, tell},
};
use crate::{
    doors::{Lobby, PortSecret, STRANGER_TIMEOUT, STRANGERS, Turned},
    remote::is_same_user,
};
use ctos_link::{
    security::{KeyError, Role},
    transport::{Call, Listener, is},
};

/// How many of the places for clients those of other hosts may have, so that there is always one for the app's own user.
pub(super) const PLACES: usize = 32;

/// The longest line with a secret, bytes.
const SECRET_LIMIT: u64 = 512;

/// Why a caller is not served.
#[derive(Debug, thiserror::Error)]
enum GateError {
    #[error(transparent)]
    Key(#[from] KeyError),
    #[error("it does not belong to the user of the app, who gave it no keys ([security])")]
    User,
    #[error("it does not know the secret of this port")]
    Secret,
    #[error(transparent)]
    Turned(#[from] Turned),
}

/// Where tools call, and what those of other hosts say there when there are no keys.
pub(crate) struct Gate {
    pub(crate) listener: Listener,
    pub(crate) secret: Option<PortSecret>,
}

/// Serves tools, `places` at a time, until it is aborted.
pub(super) async fn serve(
    gate: Gate,
    places: usize,
    service: Arc<Service>,
    clients: Arc<Semaphore>,
) {
    let Gate { listener, secret } = gate;
    let secret = Arc::new(secret);
    let lobby = Lobby::new(STRANGERS);
    let places = Arc::new(Semaphore::new(places));
    let mut serving = JoinSet::new();
    loop {
        let refuse = |_: Option<&Call>, why: &str| service.refuse("a caller", why);
        let (call, guest) = lobby.next(|| listener.accept(), refuse).await;
        while serving.try_join_next().is_some() {}
        call.keep_alive();
        let ends = call.ends();
        let from = ends.map_or_else(|| "a caller".to_owned(), |(peer, _)| peer.to_string());
        let (service, clients, places) = (service.clone(), clients.clone(), places.clone());
        let secret = secret.clone();
        serving.spawn(async move {
            let met = meet(call, ends, &from, secret.as_ref().as_ref());
            let (client, reader, mut writer) = match guest.hear(STRANGER_TIMEOUT, met).await {
                Ok(met) => met,
                Err(error) => return service.refuse(&from, &error.to_string()),
            };
            let served = match (places.try_acquire_owned(), clients.try_acquire_owned()) {
                (Ok(_far), Ok(_place)) => service.client(&client, reader, writer).await,
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
    secret: Option<&PortSecret>,
) -> Result<(Client, Reader, Writer), GateError> {
    let (stream, identity) = call.prove().await?;
    let own = is::<UnixStream>(&stream);
    let (reader, mut writer) = tokio::io::split(stream);
    let mut reader = BufReader::new(reader);
    let client = match identity {
        Some(identity) => Client {
            who: format!("the key `{}`", identity.name),
            role: identity.role,
        },
        // The user may do what he likes with what is his.
        None if own => Client {
            who: "its user".to_owned(),
            role: Role::Boot,
        },
        None => {
            if !ends.is_some_and(|(peer, ours)| is_same_user(peer, ours).unwrap_or(false)) {
                return Err(GateError::User);
            }
            let mut line = Vec::new();
            let mut limited = (&mut reader).take(SECRET_LIMIT);
            let read = limited.read_until(b'\n', &mut line).await;
            read.map_err(KeyError::from)?;
            let shown = serde_json::from_slice::<Shown>(&line).ok();
            let shown = shown.map(|shown| shown.token);
            if !secret.is_some_and(|secret| secret.is(shown.as_ref())) {
                let text = GateError::Secret.to_string();
                let told = tell(&mut writer, &error(ErrorCode::NotAllowed, text)).await;
                told.map_err(KeyError::from)?;
                return Err(GateError::Secret);
            }
            Client {
                who: from.to_owned(),
                role: Role::Boot,
            }
        }
    };
    Ok((client, reader, writer))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::{io::AsyncWriteExt, net::TcpStream};

    use super::*;
    use crate::{
        control::{LogStore, Ticker},
        doors::{NO_PAGE, Secret},
    };
    use ctos_bootstrap::bootstrap::Observer;
    use ctos_config::load_texts;
    use ctos_core::{chassis::Chassis, registry::Registry};
    use ctos_link::transport::Address;
    use ctos_time::Clock;

    /// A test that takes longer hangs; none takes a fraction of it.
    const WATCHDOG: Duration = Duration::from_secs(60);
    const APP: &str = "[chassis.a]\n[task.one]\nhandler = \"none\"\non = \"a\"\n";
    /// What is answered at once, whatever state the app is in.
    const ASKS: &str = "{\"version\":1,\"request\":{\"kind\":\"record_stop\",\"key\":9}}\n";

    fn run<T>(test: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let test = async { tokio::time::timeout(WATCHDOG, test).await.unwrap() };
        runtime.unwrap().block_on(test)
    }

    /// A gate without keys, the line that opens it, and the chassis behind it.
    async fn gate() -> (SocketAddr, String, Arc<Chassis>) {
        let app = load_texts(&[("app.toml", APP)], &[], &[]);
        let app = app.map_err(|findings| findings.to_string()).unwrap();
        let registry = Arc::new(Registry::new());
        let chassis = Chassis::new(0, Arc::new(app), registry, Clock::real());
        let nobody: Observer = Arc::new(|_| {});
        let logs = Arc::new(LogStore::new(chassis.clock.clone()));
        let service = Arc::new(Service::new(&chassis, &logs, &Ticker::observe(&nobody).0));
        let listener = Listener::tcp(([127, 0, 0, 1], 0).into(), None).await;
        let listener = listener.unwrap();
        let Address::Tcp(address) = listener.address().unwrap() else {
            panic!("not TCP")
        };
        let secret = PortSecret::new(address).unwrap();
        let token = Secret::of_port(address).unwrap();
        let gate = Gate {
            listener,
            secret: Some(secret),
        };
        let clients = Arc::new(Semaphore::new(64));
        tokio::spawn(serve(gate, PLACES, service, clients));
        let shown = serde_json::to_string(&Shown { token }).unwrap();
        (address, format!("{shown}\n"), chassis)
    }

    /// Waits until so many were refused.
    async fn counted(chassis: &Chassis, refused: u64) {
        while ctos_bootstrap::refusals::Refusals::of(chassis).count() < refused {
            tokio::task::yield_now().await;
        }
    }

    /// All that is answered to `says`, until the connection ends.
    async fn answers(address: SocketAddr, says: &str) -> String {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(says.as_bytes()).await.unwrap();
        stream.shutdown().await.unwrap();
        let mut told = String::new();
        stream.read_to_string(&mut told).await.unwrap();
        told
    }

    #[test]
    fn a_web_page_is_refused_at_the_control_port_and_nothing_that_it_says_is_obeyed() {
        run(async {
            let (address, opens, chassis) = gate().await;
            let head = "POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\nOrigin: http://evil.example\r\n\r\n";
            assert_eq!(answers(address, &format!("{head}{ASKS}")).await, NO_PAGE);
            // Not even one that has somehow learnt the secret.
            let told = answers(address, &format!("{opens}{head}{ASKS}")).await;
            assert_eq!(told, NO_PAGE);
            counted(&chassis, 2).await;
        });
    }

    #[test]
    fn a_control_port_without_keys_opens_to_its_secret_alone() {
        run(async {
            let (address, opens, chassis) = gate().await;
            let told = answers(address, &format!("{opens}{ASKS}{ASKS}")).await;
            assert_eq!(told.matches("there is no record 9").count(), 2, "{told}");
            let guessed = opens.replace("\":\"", "\":\"0");
            for shows in ["", "\n", "{}\n", &guessed, &"x".repeat(1000)] {
                let told = answers(address, &format!("{shows}{ASKS}")).await;
                assert!(told.contains("not_allowed"), "{told}");
                assert!(!told.contains("no record"), "{told}");
            }
            counted(&chassis, 5).await;
        });
    }

    #[test]
    fn the_first_line_that_is_no_request_ends_the_connection_with_one_error() {
        run(async {
            let (address, opens, _) = gate().await;
            let long = "x".repeat(super::super::protocol::REQUEST_LIMIT + 1);
            for rubbish in ["hello", "", "{}", "[1]", "\u{1}", "{\"version\":1}", &long] {
                let told = answers(address, &format!("{opens}{ASKS}{rubbish}\n{ASKS}")).await;
                let lines: Vec<&str> = told.lines().collect();
                assert_eq!(lines.len(), 2, "{told}");
                assert!(lines[1].contains("bad_request"), "{told}");
            }
            // A request of a later version is one.
            let later = "{\"version\":1,\"request\":{\"kind\":\"dance\"}}";
            let told = answers(address, &format!("{opens}{later}\n{ASKS}")).await;
            assert_eq!(told.lines().count(), 2, "{told}");
            // What has no end was cut off, and is not obeyed.
            let told = answers(address, &format!("{opens}{}", ASKS.trim_end())).await;
            assert!(told.contains("bad_request"), "{told}");
        });
    }

    #[test]
    fn idle_strangers_keep_no_tool_out() {
        run(async {
            let (address, opens, chassis) = gate().await;
            let mut idle = Vec::new();
            for _ in 0..STRANGERS + 6 {
                idle.push(TcpStream::connect(address).await.unwrap());
            }
            let told = answers(address, &format!("{opens}{ASKS}")).await;
            assert!(told.contains("no record"), "{told}");
            // The gate waited for nobody.
            assert!(ctos_bootstrap::refusals::Refusals::of(&chassis).count() < STRANGERS as u64);
        });
    }
}
