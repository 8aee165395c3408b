//! A byte stream over two keys of the zenoh network, one for each direction.
//!
//! What the user's end does is a matter of a [`Pipe`] behind a lock and never waits. zenoh hands what arrives
//! to the pipe on threads of its own; what leaves is published by one thread for each stream, because
//! publishing may have to wait for the network, and then nothing else shall.

use std::{
    io,
    pin::Pin,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll, Waker},
    time::Duration,
};

use ::zenoh::{
    Session, Wait,
    liveliness::LivelinessToken,
    pubsub::{Publisher, Subscriber},
    qos::CongestionControl,
    sample::{Sample, SampleKind},
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    sync::mpsc,
};

use super::pipe::{Broken, Pipe, Read};
use crate::lock::lock;

/// How long a stream whose user has gone waits for the other end to take the rest.
const LINGER: Duration = Duration::from_secs(1);

/// The longest wait at a time.
const LONGEST: Duration = Duration::from_secs(3600);

#[derive(Default)]
struct State {
    pipe: Pipe,
    reader: Option<Waker>,
    writer: Option<Waker>,
}

/// What the user's end, zenoh's threads and the publishing thread share.
#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    /// The publishing thread may have something to do.
    changed: Condvar,
}

impl Shared {
    /// Changes the pipe from the network's side, and wakes all that may go on now.
    fn change(&self, change: impl FnOnce(&mut Pipe)) {
        let wakers = {
            let mut state = lock(&self.state);
            change(&mut state.pipe);
            [state.reader.take(), state.writer.take()]
        };
        self.changed.notify_all();
        for waker in wakers.into_iter().flatten() {
            waker.wake();
        }
    }

    /// Waits for a change, until a deadline if there is one; whether that has passed.
    fn wait<'s>(
        &self,
        state: MutexGuard<'s, State>,
        deadline: Option<Duration>,
    ) -> (MutexGuard<'s, State>, bool) {
        let woken = self
            .changed
            .wait_timeout(state, deadline.unwrap_or(LONGEST));
        let (state, result) = woken.unwrap_or_else(PoisonError::into_inner);
        (state, deadline.is_some() && result.timed_out())
    }
}

/// One end of a stream on the network. What it has declared there goes with it.
pub(super) struct End {
    shared: Arc<Shared>,
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
        let shared = Arc::new(Shared::default());
        let to = shared.clone();
        let arrivals = session
            .declare_subscriber(incoming.clone())
            .callback(move |sample: Sample| {
                let chunk = sample.payload().to_bytes();
                to.change(|pipe| pipe.arrive(&chunk));
            })
            .wait()?;
        let to = shared.clone();
        let watch = session
            .liveliness()
            .declare_subscriber(format!("{incoming}/alive"))
            .history(true)
            .callback(move |change: Sample| {
                if change.kind() == SampleKind::Delete {
                    to.change(|pipe| pipe.fail(Broken::Gone));
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
            .callback(move |status| to.change(|pipe| pipe.listened_to(status.matching())))
            .background()
            .wait()?;
        if publisher.matching_status().wait()?.matching() {
            shared.change(|pipe| pipe.listened_to(true));
        }
        Ok(Self {
            shared,
            publisher,
            _arrivals: arrivals,
            _watch: watch,
            _token: token,
        })
    }

    /// The user's end. `alive` is dropped when nothing is left to send.
    pub(super) fn stream(&self) -> ZenohStream {
        ZenohStream(self.shared.clone())
    }

    /// Publishes what the user writes, until that has all arrived or cannot. Waits for the network.
    pub(super) fn publish(self, alive: mpsc::Sender<()>) {
        while let Some(chunk) = self.next() {
            if let Err(error) = self.publisher.put(chunk).wait() {
                let broken = Broken::Network(error.to_string());
                self.shared.change(|pipe| pipe.fail(broken));
            }
        }
        self.shared.change(|pipe| {
            if let Some(broken) = pipe.broken() {
                let key = self.publisher.key_expr().as_str();
                tracing::debug!(key, reason = %broken, "a stream over zenoh ended");
            }
            pipe.fail(Broken::Gone);
        });
        drop(self);
        drop(alive);
    }

    /// Waits for the next chunk; `None` when there will be none.
    fn next(&self) -> Option<Vec<u8>> {
        let mut state = lock(&self.shared.state);
        loop {
            if state.pipe.is_over() {
                return None;
            }
            if let Some(chunk) = state.pipe.next() {
                let writer = state.writer.take();
                drop(state);
                if let Some(writer) = writer {
                    writer.wake();
                }
                return Some(chunk);
            }
            let deadline = state.pipe.is_closed().then_some(LINGER);
            let late;
            (state, late) = self.shared.wait(state, deadline);
            if late {
                return None;
            }
        }
    }
}

/// The user's end of a stream. Without it, what arrives counts as read, and the other end is told that no more comes.
pub struct ZenohStream(Arc<Shared>);

impl ZenohStream {
    /// Takes what there is space for; `waker` is woken when there is some again.
    fn put(&self, slices: &[io::IoSlice<'_>], waker: &Waker) -> Poll<io::Result<usize>> {
        let mut state = lock(&self.0.state);
        let mut written = 0;
        for slice in slices {
            let Some(count) = state.pipe.write(slice) else {
                return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
            };
            written += count;
            if count < slice.len() {
                break;
            }
        }
        if written == 0 && slices.iter().any(|slice| !slice.is_empty()) {
            state.writer = Some(waker.clone());
            return Poll::Pending;
        }
        drop(state);
        self.0.changed.notify_all();
        Poll::Ready(Ok(written))
    }
}

impl AsyncRead for ZenohStream {
    fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut state = lock(&self.0.state);
        match state.pipe.read(into.initialize_unfilled()) {
            Read::Bytes(count) => {
                into.advance(count);
                let idle = state.pipe.is_idle();
                drop(state);
                if !idle {
                    self.0.changed.notify_all();
                }
                Poll::Ready(Ok(()))
            }
            Read::End => Poll::Ready(Ok(())),
            Read::Nothing => {
                state.reader = Some(cx.waker().clone());
                Poll::Pending
            }
        }
    }
}

impl AsyncWrite for ZenohStream {
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.poll_write_vectored(cx, &[io::IoSlice::new(bytes)])
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.put(slices, cx.waker())
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    /// What was written is on its way.
    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.0.change(Pipe::close);
        Poll::Ready(Ok(()))
    }
}

impl Drop for ZenohStream {
    fn drop(&mut self) {
        self.0.change(|pipe| {
            pipe.close();
            pipe.forget();
        });
    }
}
