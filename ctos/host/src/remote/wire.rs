//! What a boot and the agent of another host say to each other, and the connection that carries it.
//!
//! A caller first says who it is ([`Hello`], at most as much as any stranger may). Then follow frames:
//! a length of four bytes and postcard. Both ends may open the connection anew while their run lives.
//! So everything may be said twice, and lines of a log are numbered.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tokio::{
    io::{ReadHalf, WriteHalf},
    sync::{Mutex, mpsc},
};
use tokio_util::{
    codec::{FramedRead, FramedWrite, LengthDelimitedCodec},
    task::AbortOnDropHandle,
};

use crate::{
    boot::{
        launcher::{Briefing, ProcessId},
        spawn::{Ending, LINE_LIMIT},
    },
    doors::Secret,
};
use ctos_config::Bundle;
use ctos_link::{
    handshake::{Process, Token},
    transport::{Stream, hang_up},
};
use ctos_message::ChassisNumber;
use ctos_time::{Clock, Instant};

/// The first bytes of a boot that calls an agent: the protocol.
pub(crate) const GREETING: [u8; 8] = *b"ctosagt\0";

/// The version of what follows; both ends must have the same.
pub(crate) const PROTOCOL: u32 = 5;

/// How much the files of an app may come to, bytes.
pub(crate) const BUNDLE_LIMIT: usize = 64 << 20;

/// The longest frame but the one with the app's files, bytes: a line of a log and what is around it.
pub(crate) const FRAME_LIMIT: usize = 4 * LINE_LIMIT;

/// How long a caller may take to say who it is, and an agent to answer.
pub(crate) const HELLO_TIMEOUT: Duration = Duration::from_secs(5);

/// How many lines of logs may wait for a slow connection; further ones are lost, and counted.
pub(crate) const LINES_WAITING: usize = 2048;

/// A boot says who it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Hello {
    pub(crate) protocol: u32,
    /// The version of the program.
    pub(crate) version: String,
    /// Its run: the same when it calls again.
    pub(crate) run: Token,
    /// The run before it, which this boot has lost: nothing of it may be left when this one begins.
    pub(crate) replaces: Option<Token>,
    pub(crate) app: String,
    /// A run that is silent for so long is gone, ms.
    pub(crate) silence_ms: u64,
    /// How long each rung of stopping may take, ms.
    pub(crate) stop_ms: u64,
    /// That of the agent's port, where there are no keys.
    pub(crate) secret: Option<Secret>,
}

/// What the agent answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum HelloAnswer {
    /// Frames from here on. Whether the agent has the run already, with its processes; and which
    /// process it is itself.
    Welcome { known: bool, process: Process },
    /// No.
    Refused { reason: String },
}

/// A handler as a program has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct HandlerView {
    pub(crate) name: String,
    /// Code and name of each command that it takes.
    pub(crate) commands: Vec<(u16, String)>,
}

/// What an agent needs to start chassis of an app.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct AppFiles {
    pub(crate) bundle: Bundle,
    /// What to tell chassis besides the app: how much to log.
    pub(crate) options: Vec<String>,
    /// The handlers that the app names, as the boot has them.
    pub(crate) handlers: Vec<HandlerView>,
    /// Whether the app is recorded.
    pub(crate) recorded: bool,
}

/// What a boot says to an agent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum ToAgent {
    /// First, in a new run.
    App(Box<AppFiles>),
    /// Start the process of a chassis; nothing happens if it was started.
    Start(ChassisNumber, Briefing),
    /// Send a process a signal.
    Signal(ProcessId, Asked),
    /// Say that you live.
    Ping { number: u64 },
    /// The run is over: nothing of it may be left.
    Bye,
}

/// The signals that a boot may send.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Asked {
    Term,
    Kill,
}

/// What an agent says to a boot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum ToBoot {
    /// The app's files are there.
    Unpacked,
    /// The app cannot run here.
    Refused { reason: String },
    /// A process runs, with this number in its system.
    Started(ProcessId, Option<u32>),
    /// A line of its log; they are numbered from 1.
    Line(ProcessId, u64, String),
    /// A process has ended, or could not be started, after so many lines.
    Ended(ProcessId, Ending, u64),
    /// It lives. What its monotonic clock shows, ns.
    Pong { number: u64, monotonic_ns: u64 },
    /// Nothing of the run is left.
    Over,
}

impl ToBoot {
    /// Whether it may be dropped when too much waits.
    pub(crate) fn may_be_dropped(&self) -> bool {
        matches!(self, Self::Line(..))
    }
}

/// What waits to be said, in order. It outlives the connection.
pub(crate) struct Outbox<T> {
    sender: mpsc::UnboundedSender<T>,
    waiting: Mutex<mpsc::UnboundedReceiver<T>>,
    /// Whether one may be dropped when there are too many.
    may_be_dropped: fn(&T) -> bool,
    /// How many of them may be dropped.
    droppable: AtomicUsize,
}

impl<T> Outbox<T> {
    /// When too much waits, what `may_be_dropped` tells is dropped.
    pub(crate) fn new(may_be_dropped: fn(&T) -> bool) -> Arc<Self> {
        let (sender, waiting) = mpsc::unbounded_channel();
        Arc::new(Self {
            sender,
            waiting: Mutex::new(waiting),
            may_be_dropped,
            droppable: AtomicUsize::new(0),
        })
    }

    /// Adds `item`; one that may be dropped only while there is space for it.
    pub(crate) fn say(&self, item: T) {
        if (self.may_be_dropped)(&item) {
            if self.droppable.load(Ordering::Relaxed) >= LINES_WAITING {
                return;
            }
            self.droppable.fetch_add(1, Ordering::Relaxed);
        }
        // The other end is in here, too.
        let _ = self.sender.send(item);
    }

    async fn next(&self) -> Option<T> {
        let item = self.waiting.lock().await.recv().await?;
        let dropped = usize::from((self.may_be_dropped)(&item));
        self.droppable.fetch_sub(dropped, Ordering::Relaxed);
        Some(item)
    }

    /// How much waits.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.waiting.try_lock().unwrap().len()
    }
}

/// Why a connection is of no use any more.
#[derive(Debug, thiserror::Error)]
pub(crate) enum WireError {
    #[error("the connection broke: {0}")]
    Io(#[from] io::Error),
    #[error("the other end hung up")]
    HungUp,
    /// Also a frame that is too long, or what is no TLS.
    #[error("what it says cannot be read: {0}")]
    Garbled(String),
    #[error("nothing was heard of it for {:.3} s", .0.as_secs_f64())]
    Silence(Duration),
}

/// A connection after the hello.
pub(crate) struct Connection {
    frames: FramedRead<ReadHalf<Stream>, LengthDelimitedCodec>,
    writer: AbortOnDropHandle<WireError>,
}

impl Connection {
    /// Reads frames of at most `limit` bytes from `stream`, and writes what is in `outbox`; a frame
    /// that cannot be written within `silence` ends it.
    pub(crate) fn new<T: Serialize + Send + 'static>(
        stream: Stream,
        outbox: Arc<Outbox<T>>,
        limit: usize,
        silence: Duration,
    ) -> Self {
        let (reader, writer) = tokio::io::split(stream);
        Self {
            frames: FramedRead::new(reader, codec(limit)),
            writer: AbortOnDropHandle::new(tokio::spawn(write(writer, outbox, silence))),
        }
    }

    /// From now on frames may have at most `limit` bytes.
    pub(crate) fn limit(&mut self, limit: usize) {
        self.frames.decoder_mut().set_max_frame_length(limit);
    }

    /// What the other end says next. Nothing is lost when this is dropped before it ends.
    ///
    /// # Errors
    /// [`WireError`]: the connection is of no use any more.
    pub(crate) async fn hear<T: DeserializeOwned>(&mut self) -> Result<T, WireError> {
        tokio::select! {
            frame = self.frames.next() => {
                let frame = frame.ok_or(WireError::HungUp)?.map_err(|error| match error.kind() {
                    io::ErrorKind::InvalidData => WireError::Garbled(error.to_string()),
                    _ => error.into(),
                })?;
                postcard::from_bytes(&frame).map_err(|error| WireError::Garbled(error.to_string()))
            }
            error = &mut self.writer => Err(error.unwrap_or(WireError::HungUp)),
        }
    }
}

async fn write<T: Serialize>(
    stream: WriteHalf<Stream>,
    outbox: Arc<Outbox<T>>,
    silence: Duration,
) -> WireError {
    // The other end knows how much it takes.
    let mut frames = FramedWrite::new(stream, codec(usize::MAX));
    while let Some(item) = outbox.next().await {
        let frame = match postcard::to_stdvec(&item) {
            Ok(body) => Bytes::from(body),
            Err(error) => return WireError::Garbled(error.to_string()),
        };
        // The files of an app may take longer than one sign of life on a slow line; they are watched by
        // who sends them.
        let timeout = silence + Duration::from_secs(frame.len() as u64 >> 20);
        match tokio::time::timeout(timeout, frames.send(frame)).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return error.into(),
            Err(_) => return WireError::Silence(timeout),
        }
    }
    WireError::HungUp
}

fn codec(limit: usize) -> LengthDelimitedCodec {
    LengthDelimitedCodec::builder()
        .max_frame_length(limit)
        .little_endian()
        .new_codec()
}

/// Says one thing on a stream that ends then, so that the other end hears it whatever it has said
/// itself in the meantime.
pub(crate) async fn say_last(mut stream: Stream, answer: &HelloAnswer) {
    let told = async {
        ctos_link::handshake::say(&mut stream, answer).await.ok()?;
        hang_up(stream).await.ok()
    };
    let _ = tokio::time::timeout(HELLO_TIMEOUT, told).await;
}

/// Tells a peer that is silent from one that was not listened to: a process that was frozen must not
/// blame others.
pub(crate) struct Pulse {
    clock: Clock,
    timeout: Duration,
    heard: Instant,
    due: Instant,
}

/// How many signs of life fit into the time after which silence counts.
const PULSES: u32 = 4;

impl Pulse {
    pub(crate) fn new(timeout: Duration) -> Self {
        let clock = Clock::real();
        let now = clock.now();
        Self {
            due: now + timeout / PULSES,
            heard: now,
            clock,
            timeout,
        }
    }

    /// How often to look.
    pub(crate) fn every(&self) -> Duration {
        (self.timeout / PULSES).max(Duration::from_millis(1))
    }

    /// Something was heard.
    pub(crate) fn heard(&mut self) {
        self.heard = self.clock.now();
    }

    /// Looks: whether nothing was heard for too long.
    ///
    /// # Errors
    /// That it was.
    pub(crate) fn look(&mut self) -> Result<(), WireError> {
        let now = self.clock.now();
        let late = now.since(self.due);
        self.due = now + self.every();
        if late > self.timeout / 2 {
            // This process itself did not run.
            self.heard = now;
        }
        if now.since(self.heard) > self.timeout {
            return Err(WireError::Silence(self.timeout));
        }
        Ok(())
    }
}

/// Ticks for a [`Pulse`].
pub(crate) fn ticks(pulse: &Pulse) -> tokio::time::Interval {
    let mut ticks = tokio::time::interval(pulse.every());
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    ticks
}
