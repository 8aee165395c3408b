//! A byte stream over two keys of the zenoh network, one for each direction, made of numbered chunks. A
//! missing number shows a gap, credits stop a sender that is not read, and the end is sent.
//!
//! A zenoh network handles congestion in its own manner. What does not fit is dropped, or the whole connection
//! stands still, and with it the streams of all others. So no end ever sends more than the other one has
//! credits for. The user's end never waits for zenoh, which hands over what arrives on threads of its own. One
//! thread for each stream publishes what leaves, because publishing may have to wait for the network.

use std::{
    io,
    sync::{Arc, Mutex},
};

use ::zenoh::{
    Session, Wait,
    liveliness::LivelinessToken,
    pubsub::{Publisher, Subscriber},
    qos::CongestionControl,
    sample::{Sample, SampleKind},
};
use bytes::Bytes;
use futures_util::{SinkExt, stream};
use serde::{Deserialize, Serialize};
use tokio::{
    runtime::Handle,
    sync::{Semaphore, mpsc, watch},
};
use tokio_util::{
    io::{CopyToBytes, SinkWriter, StreamReader},
    sync::PollSender,
};

use crate::{lock::lock, transport::Stream};

/// How much may be on its way and not read, bytes. Small enough that the queues along the way hold what a
/// few streams send to a process that stands still.
const WINDOW: usize = 512 * 1024;

/// The most data of a chunk, bytes: with its head it fits into one batch of zenoh's.
const CHUNK: usize = 60 * 1024;

/// This end says what it has read whenever it is this much, bytes.
const TELL: usize = WINDOW / 4;

/// How many writes of the user may wait to be sent.
const WRITES: usize = 4;

/// Why a stream is of no use any more.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
enum Broken {
    #[error("a chunk of {0} bytes cannot be read")]
    Garbled(usize),
    #[error("chunk {expected} should have come, and {found} did: the network lost something")]
    Gap { expected: u64, found: u64 },
    #[error("the other end sends more than it may")]
    Credit,
    #[error("the other end has read what was never sent")]
    Acknowledged,
    #[error("the other end is gone")]
    Gone,
    #[error("the network does not take it: {0}")]
    Network(String),
}

/// What goes over a stream, each behind its number.
#[derive(Debug, Serialize, Deserialize)]
enum Chunk {
    /// What the user has written, which stands behind.
    Data(#[serde(skip)] Bytes),
    /// So many bytes were read since the last report of that.
    Read(usize),
    /// No more data follows.
    Last,
}

/// Whether anything may be sent.
#[derive(Debug, PartialEq, Eq)]
enum State {
    /// The other end does not listen yet: it would be lost.
    Unheard,
    Heard,
    Broken(Broken),
}

/// What has arrived.
#[derive(Default)]
struct Arrivals {
    /// How many chunks.
    chunks: u64,
    /// Bytes that were not read.
    unread: usize,
    /// Bytes that were read without the other end knowing.
    untold: usize,
    /// The user; `None` when no more comes.
    to: Option<mpsc::UnboundedSender<Bytes>>,
}

/// What the user's end, zenoh's threads and the publishing thread share.
struct Shared {
    state: watch::Sender<State>,
    arrivals: Mutex<Arrivals>,
    /// A permit for each byte that may be sent.
    credit: Semaphore,
}

impl Shared {
    /// A stream, and what arrives for its user.
    fn new() -> (Arc<Self>, mpsc::UnboundedReceiver<Bytes>) {
        let (to, arrived) = mpsc::unbounded_channel();
        let shared = Arc::new(Self {
            state: watch::Sender::new(State::Unheard),
            arrivals: Mutex::new(Arrivals {
                to: Some(to),
                ..Arrivals::default()
            }),
            credit: Semaphore::new(WINDOW),
        });
        (shared, arrived)
    }

    fn arrive(&self, chunk: &[u8]) {
        if let Err(broken) = self.take(chunk) {
            self.fail(broken);
        }
    }

    fn take(&self, chunk: &[u8]) -> Result<(), Broken> {
        let garbled = |_| Broken::Garbled(chunk.len());
        let read = postcard::take_from_bytes::<(u64, Chunk)>(chunk);
        let ((found, chunk), data) = read.map_err(garbled)?;
        let mut arrivals = lock(&self.arrivals);
        let expected = arrivals.chunks;
        if found != expected {
            return Err(Broken::Gap { expected, found });
        }
        arrivals.chunks += 1;
        match chunk {
            Chunk::Read(count) if count > WINDOW - self.credit.available_permits() => {
                return Err(Broken::Acknowledged);
            }
            Chunk::Read(count) => self.credit.add_permits(count),
            Chunk::Data(_) if arrivals.unread + data.len() > WINDOW => return Err(Broken::Credit),
            Chunk::Data(_) => {
                arrivals.unread += data.len();
                let data = Bytes::copy_from_slice(data);
                // What comes behind the last, and what nobody carries any more, is of no use.
                let _ = arrivals.to.as_ref().map(|to| to.send(data));
            }
            Chunk::Last => arrivals.to = None,
        }
        Ok(())
    }

    /// So much was read, or nobody is there to read it: what the other end is told now.
    fn read(&self, count: usize) -> Option<Chunk> {
        let mut arrivals = lock(&self.arrivals);
        arrivals.unread -= count;
        arrivals.untold += count;
        let tells = arrivals.untold >= TELL || arrivals.to.is_none();
        tells.then(|| Chunk::Read(std::mem::take(&mut arrivals.untold)))
    }

    /// The other end listens, or does not any more.
    fn listened_to(&self, listens: bool) {
        if listens {
            self.state.send_if_modified(|state| {
                let first = *state == State::Unheard;
                if first {
                    *state = State::Heard;
                }
                first
            });
        } else if *self.state.borrow() == State::Heard {
            self.fail(Broken::Gone);
        }
    }

    /// Nothing more can come, or be sent. What has come is read.
    fn fail(&self, broken: Broken) {
        lock(&self.arrivals).to = None;
        self.state.send_if_modified(|state| {
            let first = !matches!(state, State::Broken(_));
            if first {
                tracing::debug!(reason = %broken, "a stream over zenoh ended");
                *state = State::Broken(broken);
            }
            first
        });
    }

    /// Carries what arrives to the user, and what the user writes to `chunks` as credits allow it. Ends when the user is
    /// gone and the other end has read all of it, or never will.
    async fn carry(&self, user: Other, chunks: mpsc::UnboundedSender<Chunk>) {
        let Other {
            mut arrived,
            reads,
            mut writes,
        } = user;
        let publish = |chunk| {
            // Who publishes ends with this.
            let _ = chunks.send(chunk);
        };
        let receive = async {
            while let Some(data) = arrived.recv().await {
                let count = data.len();
                // Without a user it counts as read.
                let _ = reads.send(Some(data)).await;
                self.read(count).into_iter().for_each(publish);
            }
            self.read(0).into_iter().for_each(publish);
            let _ = reads.send(None).await;
            std::future::pending().await
        };
        let mut state = self.state.subscribe();
        let send = async move {
            while let Some(mut bytes) = writes.recv().await {
                while !bytes.is_empty() {
                    let data = bytes.split_to(bytes.len().min(CHUNK));
                    self.use_credit(data.len()).await;
                    publish(Chunk::Data(data));
                }
            }
            publish(Chunk::Last);
            self.use_credit(WINDOW).await;
        };
        let over = async {
            // The sender is in here, as below.
            let _ = state.wait_for(|state| *state != State::Unheard).await;
            tokio::select! {
                () = send => {}
                _ = state.wait_for(|state| matches!(state, State::Broken(_))) => {}
            }
            reads.closed().await;
        };
        tokio::select! {
            () = over => {}
            () = receive => {}
        }
    }

    async fn use_credit(&self, bytes: usize) {
        let permits = u32::try_from(bytes).unwrap_or(u32::MAX);
        // It is never closed.
        if let Ok(permits) = self.credit.acquire_many(permits).await {
            permits.forget();
        }
    }
}

/// A chunk as it is published.
fn encoded(number: u64, chunk: &Chunk) -> Result<Vec<u8>, Broken> {
    let head = postcard::to_stdvec(&(number, chunk));
    let head = head.map_err(|error| Broken::Network(error.to_string()))?;
    let data = match chunk {
        Chunk::Data(data) => data,
        _ => &Bytes::new(),
    };
    Ok([&head, &data[..]].concat())
}

/// The other side of what a user reads and writes.
struct Other {
    arrived: mpsc::UnboundedReceiver<Bytes>,
    /// None at the end.
    reads: mpsc::Sender<Option<Bytes>>,
    writes: mpsc::Receiver<Bytes>,
}

/// What a user reads from and writes to.
fn user_end(arrived: mpsc::UnboundedReceiver<Bytes>) -> (Stream, Other) {
    let (reads, read) = mpsc::channel(1);
    let (write, writes) = mpsc::channel(WRITES);
    let read = stream::unfold(read, async |mut read: mpsc::Receiver<Option<Bytes>>| {
        let data = read.recv().await.flatten()?;
        Some((Ok::<_, io::Error>(data), read))
    });
    let gone = |_| io::Error::from(io::ErrorKind::BrokenPipe);
    let write = PollSender::new(write).sink_map_err(gone);
    let user = tokio::io::join(
        StreamReader::new(Box::pin(read)),
        SinkWriter::new(CopyToBytes::new(write)),
    );
    let other = Other {
        arrived,
        reads,
        writes,
    };
    (Box::new(user), other)
}

/// One end of a stream on the network. What it has declared there goes with it.
pub(super) struct End {
    shared: Arc<Shared>,
    arrived: mpsc::UnboundedReceiver<Bytes>,
    publisher: Publisher<'static>,
    _arrivals: Subscriber<()>,
    _watch: Subscriber<()>,
    /// The last to go: the other end takes it for the end of this one.
    _token: LivelinessToken,
}

impl End {
    /// Declares the end of stream `key` that sends and hears under two parts of it. Waits for the network; not for
    /// threads of a tokio runtime.
    ///
    /// # Errors
    /// When the session is over.
    pub(super) fn open(
        session: &Session,
        key: &str,
        [sends, hears]: [&str; 2],
    ) -> Result<Self, ::zenoh::Error> {
        let (outgoing, incoming) = (format!("{key}/{sends}"), format!("{key}/{hears}"));
        let (shared, arrived) = Shared::new();
        let to = shared.clone();
        let arrivals = session
            .declare_subscriber(incoming.clone())
            .callback(move |sample: Sample| to.arrive(&sample.payload().to_bytes()))
            .wait()?;
        let to = shared.clone();
        let watch = session
            .liveliness()
            .declare_subscriber(format!("{incoming}/alive"))
            .history(true)
            .callback(move |change: Sample| {
                if change.kind() == SampleKind::Delete {
                    to.fail(Broken::Gone);
                }
            })
            .wait()?;
        let token = session
            .liveliness()
            .declare_token(format!("{outgoing}/alive"))
            .wait()?;
        let publisher = session
            .declare_publisher(outgoing)
            .congestion_control(CongestionControl::Block)
            // Chunks are as full as they can be; waiting for more would only delay them.
            .express(true)
            .wait()?;
        let to = shared.clone();
        publisher
            .matching_listener()
            .callback(move |status| to.listened_to(status.matching()))
            .background()
            .wait()?;
        if publisher.matching_status().wait()?.matching() {
            shared.listened_to(true);
        }
        Ok(Self {
            shared,
            arrived,
            publisher,
            _arrivals: arrivals,
            _watch: watch,
            _token: token,
        })
    }

    /// Hands the user's end to `give` and publishes what is written there, until that has all arrived or cannot. Waits
    /// for the network.
    pub(super) fn publish(self, runtime: &Handle, give: impl FnOnce(Stream)) {
        let (user, other) = user_end(self.arrived);
        let (published, mut chunks) = mpsc::unbounded_channel();
        let shared = self.shared.clone();
        runtime.spawn(async move { shared.carry(other, published).await });
        give(user);
        let mut number = 0;
        while let Some(chunk) = chunks.blocking_recv() {
            let failed = |error: ::zenoh::Error| Broken::Network(error.to_string());
            let put = |chunk| self.publisher.put(chunk).wait().map_err(failed);
            if let Err(broken) = encoded(number, &chunk).and_then(put) {
                self.shared.fail(broken);
            }
            number += 1;
        }
    }
}

#[cfg(test)]
mod tests;
