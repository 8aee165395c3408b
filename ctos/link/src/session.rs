//! A session: what makes a link out of streams that may break. Frames posted to it arrive once, in
//! order, or the peer is down.
//!
//! One session joins this chassis to one incarnation of one peer, over any number of streams, one at a
//! time. Packets are numbered and kept until the other end has acknowledged them; a new stream goes on
//! where the old one broke. Signs of life tell a peer that is frozen or cut off from one that is idle.
//! All that is in `core.rs`; here it is shared by threads, joined to a stream that takes bytes
//! and to a [`Receiver`]. Who connects to whom is decided elsewhere.

mod core;
mod direct;
pub mod drive;
mod line;
pub mod packet;
pub mod state;
mod window;

use std::{
    fmt, io,
    pin::Pin,
    sync::{Arc, Mutex},
    task::{Context as PollContext, Poll, Waker},
    time::Duration,
};

use tokio::{io::AsyncWrite, sync::watch};

pub use self::core::{AttachError, Core, Limits};
pub use self::state::DownReason;
use self::{
    direct::Carrier,
    packet::Content,
    state::{Event, State},
    window::{PIECE, PIECE_NEARBY},
};
use crate::{
    frame::{Counts, Frame, Full, Link},
    injure::Injury,
    lock::lock,
    time::{Clock, Instant},
};

/// Who takes what a session brings. Called in order, never twice at a time.
pub trait Receiver: Send + Sync {
    /// The first stream is there; frames may be posted, and come from now on.
    fn up(&self, session: Arc<Session>);
    /// A frame of a task, which came at `now`.
    fn frame(&self, frame: Frame, now: Instant);
    /// A message of the peer's mesh.
    fn notice(&self, bytes: Vec<u8>);
    /// Nothing more will come. Called once, also if it was never up.
    fn down(&self, reason: &DownReason);
}

/// One end of a session, shared by the threads that post to it and read its streams.
#[derive(derive_more::Debug)]
#[debug("Session({:?})", self.state())]
pub struct Session {
    clock: Clock,
    joined: Mutex<Joined>,
    /// Held while something is handed to the receiver, so that one stream's last packet comes before
    /// the next one's first.
    handing: Mutex<()>,
    receiver: Box<dyn Receiver>,
    state: watch::Sender<State>,
}

/// Where a session writes.
enum Writer {
    /// From any thread.
    Direct(Arc<Carrier>),
    /// From its driver only.
    Driven(Box<dyn AsyncWrite + Send + Unpin>),
}

/// The core of a session, joined to its stream.
struct Joined {
    core: Core,
    writer: Option<Writer>,
    driver: Option<Waker>,
}

/// What came of bytes that were read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Read {
    /// There were frames among them.
    pub(super) frames: bool,
    /// More may come over the stream.
    pub(super) goes_on: bool,
}

impl Joined {
    /// Writes what can be written at once, from whatever thread. The driver finds a stream that fails, and writes
    /// where only it may.
    fn pump(&mut self, now: Instant) {
        let needs_driver = match &self.writer {
            Some(Writer::Direct(carrier)) => {
                let pumped = self.core.pump(now, |slices| carrier.try_write(slices));
                pumped.is_err()
            }
            Some(Writer::Driven(_)) => true,
            None => false,
        };
        if needs_driver && let Some(driver) = &self.driver {
            driver.wake_by_ref();
        }
    }

    /// The state is another one: a stream that is of no more use is let go.
    fn settle(&mut self, now: Instant) {
        match self.core.state() {
            State::Broken => self.writer = None,
            State::Down => {
                // A last attempt; nobody waits for it.
                self.pump(now);
                self.writer = None;
            }
            State::Waiting | State::Up | State::Draining | State::Closing => {}
        }
    }
}

impl Session {
    /// A session without a stream.
    pub fn new(
        clock: Clock,
        limits: Limits,
        injury: Option<Injury>,
        receiver: Box<dyn Receiver>,
    ) -> Arc<Self> {
        let core = Core::new(limits, injury, clock.now());
        Arc::new(Self {
            clock,
            joined: Mutex::new(Joined {
                core,
                writer: None,
                driver: None,
            }),
            handing: Mutex::new(()),
            receiver,
            state: watch::Sender::new(State::Waiting),
        })
    }

    /// Its state, and every change of it.
    pub fn watch(&self) -> watch::Receiver<State> {
        self.state.subscribe()
    }

    pub fn state(&self) -> State {
        *self.state.borrow()
    }

    /// Whether a stream may still be had for it.
    pub fn is_open(&self) -> bool {
        matches!(self.state(), State::Waiting | State::Up | State::Broken)
    }

    /// Looks at its core.
    pub fn look<T>(&self, look: impl FnOnce(&Core) -> T) -> T {
        look(&lock(&self.joined).core)
    }

    /// Whether its streams are cut on purpose at the moment.
    pub fn is_cut(&self) -> bool {
        self.look(|core| core.is_cut(self.clock.now()))
    }

    // -- its streams ------------------------------------------------------------------------

    /// Goes on over a new stream, whose other end has received everything up to `received`. The number
    /// is the stream's; what comes from it must be handed in under that number.
    ///
    /// # Errors
    /// When the session is over, or the other end claims to have what was never sent.
    fn attach(self: &Arc<Self>, writer: Writer, received: u64) -> Result<u64, AttachError> {
        let _handing = lock(&self.handing);
        let stream = {
            let mut joined = lock(&self.joined);
            let now = self.clock.now();
            let piece = match &writer {
                Writer::Direct(carrier) if carrier.is_nearby() => PIECE_NEARBY,
                _ => PIECE,
            };
            let stream = joined.core.attach(received, piece, now)?;
            joined.writer = Some(writer);
            stream
        };
        self.state.send_replace(State::Up);
        if stream == 1 {
            self.receiver.up(self.clone());
        }
        self.wake_driver();
        Ok(stream)
    }

    /// The session of `stream` lost it.
    pub fn lost(&self, stream: u64) {
        self.change(|core, _| core.lost(stream));
    }

    /// Bytes came over `stream`.
    pub(super) fn read(&self, stream: u64, mut bytes: &[u8]) -> Read {
        let now = self.clock.now();
        let mut frames = false;
        let _handing = lock(&self.handing);
        loop {
            let heard = {
                let mut joined = lock(&self.joined);
                let heard = joined.core.read(stream, &mut bytes, now);
                if heard.writes {
                    joined.pump(now);
                }
                if heard.changed {
                    joined.settle(now);
                }
                heard
            };
            frames |= matches!(heard.content, Content::Frame(_));
            self.hand_over(heard.content, now);
            if heard.changed {
                self.announce();
            }
            if bytes.is_empty() || !heard.goes_on {
                let goes_on = heard.goes_on;
                return Read { frames, goes_on };
            }
        }
    }

    fn hand_over(&self, content: Content, now: Instant) {
        match content {
            Content::Frame(frame) => {
                trace(&frame, "in");
                self.receiver.frame(frame, now);
            }
            Content::Notice(bytes) => self.receiver.notice(bytes),
            Content::Nothing => {}
        }
    }

    /// Goes on writing to `stream`, which may be writable again.
    pub(super) fn pump(&self, stream: u64) {
        let mut joined = lock(&self.joined);
        if joined.core.stream() == stream {
            joined.pump(self.clock.now());
        }
    }

    /// Writes from the driver of `stream`; ends only with an error, or when another stream has taken
    /// its place.
    pub(super) fn poll_pump(&self, cx: &mut PollContext<'_>, stream: u64) -> Poll<io::Error> {
        let now = self.clock.now();
        let mut joined = lock(&self.joined);
        let Joined {
            core,
            writer,
            driver,
        } = &mut *joined;
        let is_it = core.stream() == stream && !core.is_cut(now);
        let Some(writer) = writer.as_mut().filter(|_| is_it) else {
            return Poll::Ready(io::ErrorKind::ConnectionAborted.into());
        };
        *driver = Some(cx.waker().clone());
        let stream = match writer {
            Writer::Direct(carrier) => {
                let pumped = core.pump(now, |slices| carrier.try_write(slices));
                return pumped.err().map_or(Poll::Pending, Poll::Ready);
            }
            Writer::Driven(stream) => stream,
        };
        let pumped = core.pump(now, |slices| {
            match Pin::new(&mut *stream).poll_write_vectored(cx, slices) {
                Poll::Ready(written) => written,
                Poll::Pending => Err(io::ErrorKind::WouldBlock.into()),
            }
        });
        if let Err(error) = pumped {
            return Poll::Ready(error);
        }
        match Pin::new(stream).poll_flush(cx) {
            Poll::Ready(Err(error)) => Poll::Ready(error),
            Poll::Ready(Ok(())) | Poll::Pending => Poll::Pending,
        }
    }

    fn wake_driver(&self) {
        let driver = lock(&self.joined).driver.take();
        if let Some(driver) = driver {
            driver.wake();
        }
    }

    // -- what happens to it -----------------------------------------------------------------

    /// Something happened. The receiver hears of the state down once.
    pub fn event(&self, event: Event, reason: DownReason) {
        self.change(|core, _| core.event(event, reason));
    }

    /// The peer sent what no peer may send.
    pub(super) fn rubbish(&self, what: &impl fmt::Display) {
        self.event(Event::Rubbish, DownReason::Rubbish(what.to_string()));
    }

    /// How often [`Self::keep`] is to be called.
    pub fn pulse_every(&self) -> Duration {
        lock(&self.joined).core.pulse_every()
    }

    /// Says that this end lives, and sees whether the other one does.
    pub fn keep(&self) {
        self.change(Core::keep);
        self.put(|_, _| {});
    }

    /// Ends in order: what was posted goes out first.
    pub fn close(&self) {
        self.change(Core::close);
        self.put(|_, _| {});
    }

    /// Makes a change, and tells others if the state is another one then.
    fn change(&self, change: impl FnOnce(&mut Core, Instant) -> bool) {
        let now = self.clock.now();
        let changed = {
            let mut joined = lock(&self.joined);
            let changed = change(&mut joined.core, now);
            if changed {
                joined.settle(now);
            }
            changed
        };
        if changed {
            self.announce();
        }
    }

    /// Tells the present state to those who watch it, and to the receiver when it is the last.
    fn announce(&self) {
        let (state, reason) = {
            let mut joined = lock(&self.joined);
            (joined.core.state(), joined.core.take_reason())
        };
        if let Some(reason) = reason {
            self.receiver.down(&reason);
        }
        self.state.send_replace(state);
        self.wake_driver();
    }

    // -- what is sent over it ---------------------------------------------------------------

    /// A message to the peer's mesh.
    pub fn notify(&self, bytes: Vec<u8>) {
        self.put(|core, now| core.notify(bytes, now));
    }

    /// Puts something in and writes as far as the stream allows; what is left the driver writes.
    fn put<T>(&self, put: impl FnOnce(&mut Core, Instant) -> T) -> T {
        let now = self.clock.now();
        let mut joined = lock(&self.joined);
        let put = put(&mut joined.core, now);
        joined.pump(now);
        put
    }
}

impl Link for Session {
    fn post(&self, frame: Frame) -> Result<(), Full> {
        trace(&frame, "out");
        self.put(|core, now| core.post(frame, now))
    }

    fn counts(&self) -> Counts {
        self.look(Core::counts)
    }
}

fn trace(frame: &Frame, way: &'static str) {
    tracing::trace!(
        target: "ctos::link",
        from = %frame.header.from,
        to = %frame.header.to,
        command = frame.header.command,
        bytes = frame.body.len(),
        "{way}"
    );
}

#[cfg(test)]
mod tests;
