//! Byte streams over a zenoh network, for chassis that discovery and routers bring together.
//!
//! A chassis that can be called has a key, `ctos/APP/NAME-NOISE`, and answers queries there. A caller draws
//! the id of a stream, and both declare its two keys ([`stream`]). From then on the stream is a connection
//! like any other. It carries bytes in order until either end goes or the network loses something; then the
//! session above opens a new one. Nothing else of zenoh's is used: what it promises of single messages
//! depends on queues, routes and routers that are not ours.
//!
//! zenoh waits on whatever thread calls it, and refuses those of a single-threaded runtime. So threads
//! that belong to nobody else call it.

mod settings;
mod stream;

use std::{
    io,
    path::Path,
    sync::{Arc, mpsc::RecvTimeoutError},
    time::Duration,
};

use ::zenoh::{
    Session, Wait,
    bytes::ZBytes,
    query::{ConsolidationMode, Query},
};
use tokio::{
    runtime::Handle,
    sync::{Mutex as AsyncMutex, mpsc, oneshot},
};
use tokio_util::task::TaskTracker;

use self::{settings::settings, stream::End};
use crate::{address::is_plain_key, config::App, noise, security, transport::Stream};

/// Every key begins so.
const ROOT: &str = "ctos";

/// How many callers may wait to be heard.
const CALLERS: usize = 64;

/// A call is tried again after this, should the network not have told that somebody listens.
const CALL_AGAIN: Duration = Duration::from_millis(100);

/// How long who is called may take to answer before the call is tried again.
const ANSWER_DEADLINE: Duration = Duration::from_secs(1);

/// How long the goodbye to the network may take.
const CLOSE_DEADLINE: Duration = Duration::from_secs(1);

/// Runs what waits for zenoh on a thread of its own.
async fn on_thread<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> io::Result<T> {
    let (sender, done) = oneshot::channel();
    std::thread::Builder::new()
        .name("zenoh-call".to_owned())
        .spawn(move || {
            // The caller may have given up.
            let _ = sender.send(work());
        })?;
    done.await
        .map_err(|_| io::Error::other("zenoh ended unexpectedly"))
}

fn refused(what: &str) -> impl FnOnce(::zenoh::Error) -> io::Error {
    let what = what.to_owned();
    move |error| io::Error::other(format!("{what}: {error}"))
}

/// The session with the network. The last to let go of it does not wait for its end.
struct Membership(Option<Session>);

impl Membership {
    fn session(&self) -> io::Result<&Session> {
        let gone = || io::Error::other("this process has left the zenoh network");
        self.0.as_ref().ok_or_else(gone)
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        if let Some(session) = self.0.take() {
            // Without a thread for it the session ends with the process.
            let _ = std::thread::Builder::new().spawn(move || drop(session));
        }
    }
}

/// This process's place on a zenoh network.
pub struct Fabric {
    membership: Arc<Membership>,
    /// All keys of the app begin so.
    prefix: String,
    /// Those that have something to send.
    streams: TaskTracker,
}

impl Fabric {
    /// Joins the network that the configuration describes, as the boot or as a chassis; `None` when it
    /// describes none.
    ///
    /// # Errors
    /// When no address can be listened at, or no router is found within `app.phase_timeout_s`.
    pub async fn join(app: &App, is_boot: bool) -> io::Result<Option<Arc<Self>>> {
        let Some(config) = &app.links.zenoh else {
            return Ok(None);
        };
        let keys = app.security.as_ref().map(|security| {
            let place = |path: &Path| app.folder.join(path);
            security::KeyFiles::of(&place(&security.key), &place(&security.authority))
        });
        let settings = settings(
            config,
            is_boot,
            &app.links,
            app.phase_timeout,
            keys.as_ref(),
        );
        let session = on_thread(move || {
            let mut config = ::zenoh::Config::default();
            for (key, value) in settings {
                config
                    .insert_json5(key, &value.to_string())
                    .map_err(refused(&format!("the setting {key} = {value}")))?;
            }
            ::zenoh::open(config)
                .wait()
                .map_err(|error| io::Error::other(error.to_string()))
        })
        .await??;
        Ok(Some(Arc::new(Self {
            membership: Arc::new(Membership(Some(session))),
            prefix: format!("{ROOT}/{}", key_part(&app.name)),
            streams: TaskTracker::new(),
        })))
    }

    /// Opens a stream on a thread of its own, which then publishes what is written to it. `open` is told whether nobody
    /// waits for it any more.
    async fn stream<F>(&self, open: F) -> io::Result<Stream>
    where
        F: FnOnce(&Session, &dyn Fn() -> bool) -> io::Result<End> + Send + 'static,
    {
        let (alive, membership) = (self.streams.token(), self.membership.clone());
        if self.streams.is_closed() {
            return Err(io::Error::other("this process leaves the zenoh network"));
        }
        let (sender, opened) = oneshot::channel();
        let runtime = Handle::current();
        std::thread::Builder::new()
            .name("zenoh-stream".to_owned())
            .spawn(move || {
                let ended = || sender.is_closed();
                let session = membership.session();
                // Nobody takes it when who waited gave up just now: then it is dropped and ends.
                match session.and_then(|session| open(session, &ended)) {
                    Ok(end) => end.publish(&runtime, |user| drop(sender.send(Ok(user)))),
                    Err(error) => drop(sender.send(Err(error))),
                }
                drop(alive);
            })?;
        opened
            .await
            .map_err(|_| io::Error::other("zenoh ended unexpectedly"))?
    }

    /// Can be called from now on, as chassis `name`.
    ///
    /// # Errors
    /// When there is no randomness, or the session is over.
    pub async fn listen(self: &Arc<Self>, name: &str) -> io::Result<Listener> {
        let key = format!(
            "{}/{}-{}",
            self.prefix,
            key_part(name),
            noise::text(noise::bytes::<6>()?)
        );
        let (sender, calls) = mpsc::channel(CALLERS);
        let (membership, at) = (self.membership.clone(), format!("{key}/call"));
        on_thread(move || {
            membership
                .session()?
                .declare_queryable(at)
                .callback(move |query: Query| {
                    // One for whom there is no place is not answered, and calls again.
                    let _ = sender.try_send(query);
                })
                .background()
                .wait()
                .map_err(refused("cannot listen"))
        })
        .await??;
        Ok(Listener {
            fabric: self.clone(),
            key,
            calls: AsyncMutex::new(calls),
        })
    }

    /// Calls who listens at `key`, for as long as the caller waits.
    ///
    /// # Errors
    /// When the key is none of this app's, or the session is over.
    pub async fn connect(&self, key: &str) -> io::Result<Stream> {
        let rest = key.strip_prefix(&self.prefix);
        if !is_plain_key(key) || !rest.is_some_and(|rest| rest.starts_with('/')) {
            let text = format!("`{key}` is not a key of this app");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
        }
        let key = key.to_owned();
        self.stream(move |session, ended| call(session, &key, ended))
            .await
    }

    /// Leaves the network once everything written has arrived, or cannot.
    pub async fn close(&self) {
        self.streams.close();
        // What does not arrive in time belongs to somebody who no longer reads.
        let _ = tokio::time::timeout(CLOSE_DEADLINE, self.streams.wait()).await;
        let membership = self.membership.clone();
        let left = on_thread(move || match membership.session() {
            Ok(session) => session.close().wait().map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        });
        if let Ok(Ok(Err(error))) = tokio::time::timeout(CLOSE_DEADLINE, left).await {
            tracing::debug!(error, "the zenoh network was not left in order");
        }
    }
}

/// Makes a stream to the listener at `key`, until `ended`. Waits for the network.
fn call(session: &Session, key: &str, ended: impl Fn() -> bool) -> io::Result<End> {
    let failed = || refused("cannot call");
    let querier = session
        .declare_querier(format!("{key}/call"))
        .consolidation(ConsolidationMode::None)
        .timeout(ANSWER_DEADLINE)
        .wait()
        .map_err(failed())?;
    let (sender, changes) = std::sync::mpsc::channel();
    querier
        .matching_listener()
        .callback(move |status| {
            // The call may be over.
            let _ = sender.send(status.matching());
        })
        .background()
        .wait()
        .map_err(failed())?;
    while !ended() {
        let matching = querier.matching_status().wait().map_err(failed())?;
        if !matching.matching() {
            match changes.recv_timeout(CALL_AGAIN) {
                Ok(_) | Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(io::ErrorKind::ConnectionAborted.into());
                }
            }
        }
        // A stream of its own for each attempt: an answer that comes too late must not meet the next.
        let id = noise::text(noise::bytes::<12>()?);
        let end = End::open(session, &format!("{key}/{id}"), ["up", "down"]).map_err(failed())?;
        let replies = querier.get().payload(id).wait().map_err(failed())?;
        // Ends with an answer, without one, or with the querier's deadline.
        if replies.recv().is_ok_and(|reply| reply.result().is_ok()) {
            return Ok(end);
        }
        let _ = changes.recv_timeout(CALL_AGAIN);
    }
    Err(io::ErrorKind::TimedOut.into())
}

/// Where calls arrive.
pub struct Listener {
    fabric: Arc<Fabric>,
    key: String,
    calls: AsyncMutex<mpsc::Receiver<Query>>,
}

impl Listener {
    /// The key by which it is called.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// The next caller.
    ///
    /// # Errors
    /// When the session is over.
    pub async fn accept(&self) -> io::Result<Caller> {
        let query = self.calls.lock().await.recv().await;
        let query = query.ok_or(io::ErrorKind::NotConnected)?;
        Ok(Caller {
            fabric: self.fabric.clone(),
            key: self.key.clone(),
            query,
        })
    }
}

/// Somebody who calls and has not been answered.
pub struct Caller {
    fabric: Arc<Fabric>,
    key: String,
    query: Query,
}

impl Caller {
    /// Answers, and begins the stream.
    ///
    /// # Errors
    /// When the call has no stream's id, or the session is over.
    pub async fn answer(self) -> io::Result<Stream> {
        let Self { fabric, key, query } = self;
        let id = query.payload().and_then(stream_id);
        let id = id.ok_or_else(|| io::Error::other("a call over zenoh without a stream's id"))?;
        let open = move |session: &Session, _: &dyn Fn() -> bool| {
            let failed = || refused("cannot answer a call");
            let end =
                End::open(session, &format!("{key}/{id}"), ["down", "up"]).map_err(failed())?;
            let answer = query.reply(query.key_expr().clone(), id);
            // The answer ends with the query, which goes with this.
            answer.wait().map_err(failed())?;
            Ok(end)
        };
        fabric.stream(open).await
    }
}

/// A stream's id, if it is one: it becomes part of a key, so nothing else may stand in it.
fn stream_id(payload: &ZBytes) -> Option<String> {
    let text = payload.try_to_string().ok()?;
    let plain = text.len() == 24 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    plain.then(|| text.into_owned())
}

/// A name as one part of a key: letters, digits, `_`, `-` and `.` as they are, all else by its bytes. So
/// different names stay different.
fn key_part(name: &str) -> String {
    let mut part = String::new();
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"_-.".contains(&byte) {
            part.push(char::from(byte));
        } else {
            part.push_str(&format!("%{byte:02x}"));
        }
    }
    part
}

#[cfg(test)]
mod tests;
