//! A session: what makes a link out of streams that may break. Frames posted to it arrive once, in
//! order, or the peer is down.
//!
//! One session joins this chassis to one incarnation of one peer, over any number of streams, one at a
//! time. Packets are numbered and kept until the other end has acknowledged them; a new stream goes on
//! where the old one broke. Signs of life tell a peer that is frozen or cut off from one that is idle.
//!
//! Knows streams as something that takes bytes ([`Writer`]) and drives them ([`drive`], [`direct`]); who
//! connects to whom is decided elsewhere.

mod arrive;
mod direct;
pub(crate) mod drive;
mod line;
pub(crate) mod packet;
mod post;
pub(crate) mod state;
mod window;
mod writer;

use std::{
    fmt, io,
    sync::{Arc, Mutex},
    task::{Context as PollContext, Poll, Waker},
    time::Duration,
};

use tokio::sync::watch;

#[cfg(feature = "zenoh")]
pub(crate) use self::writer::DirectWrite;
pub(crate) use self::writer::Writer;
use self::{
    line::Line,
    packet::{Kind, PacketError},
    state::{Event, State},
    window::{Incoming, Outgoing, Pumped},
    writer::Socket,
};
use crate::{
    link::{Counts, Frame, injure::Injury},
    lock::lock,
    time::{Clock, Instant},
};

/// How often a session says that it lives, as a part of the time after which silence counts.
const PULSES: u32 = 4;

/// How often an injured session looks after what was lost.
const INJURED_PULSE: Duration = Duration::from_millis(20);

/// Why a session is down.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum DownReason {
    /// Nothing was heard for so long.
    Silence(Duration),
    /// The peer's process has ended.
    Ended,
    /// Nobody listens where the peer did; what the system says.
    Deserted(String),
    /// Another chassis, or another life of this one, answers where the peer did.
    Replaced,
    /// The peer said that it ends.
    Bye,
    /// The peer has given this chassis up.
    GivenUp,
    /// What the peer sent cannot be read.
    Rubbish(String),
    /// This end wanted it.
    Closed,
}

impl fmt::Display for DownReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silence(limit) => {
                write!(
                    f,
                    "nothing was heard of it for {:.3} s",
                    limit.as_secs_f64()
                )
            }
            Self::Ended => f.write_str("its process has ended"),
            Self::Deserted(why) => write!(f, "nobody listens there any more: {why}"),
            Self::Replaced => f.write_str("another chassis answers there"),
            Self::Bye => f.write_str("it said goodbye"),
            Self::GivenUp => f.write_str("it has given this chassis up"),
            Self::Rubbish(what) => write!(f, "it sent what no peer may send: {what}"),
            Self::Closed => f.write_str("this end closed the link"),
        }
    }
}

/// Who takes what a session brings. Called in order, never twice at a time.
pub(crate) trait Receiver: Send + Sync {
    /// The first stream is there; frames may be posted, and come from now on.
    fn up(&self, session: Arc<Session>);
    /// A frame of a task, which came at `now`.
    fn frame(&self, frame: Frame, now: Instant);
    /// A message of the peer's mesh.
    fn notice(&self, bytes: Vec<u8>);
    /// Nothing more will come. Called once, also if it was never up.
    fn down(&self, reason: &DownReason);
}

/// What a session holds to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// A peer that is silent for so long is down.
    pub(crate) timeout: Duration,
    /// How many bytes of requests, and of answers, may be under way.
    pub(crate) room: usize,
}

struct Core {
    state: State,
    outgoing: Outgoing,
    /// Requests that wait for room.
    line: Line,
    incoming: Incoming,
    writer: Option<Writer>,
    /// Which stream: what is left of an earlier one is not listened to.
    stream: u64,
    driver: Option<Waker>,
    /// When anything was heard last.
    heard: Instant,
    /// When the keeper was to look next: a process that was frozen must not blame its peers.
    due: Instant,
    reason: Option<DownReason>,
    greeted: bool,
    counts: Counts,
}

/// One end of a session.
pub(crate) struct Session {
    clock: Clock,
    limits: Limits,
    injured: bool,
    core: Mutex<Core>,
    /// Held while something is handed to the receiver, so that one stream's last packet comes before
    /// the next one's first.
    handing: Mutex<()>,
    receiver: Box<dyn Receiver>,
    state: watch::Sender<State>,
}

/// The stream is of no use to the session.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AttachError {
    #[error("the session is {0:?}")]
    State(State),
    #[error(transparent)]
    Packet(#[from] PacketError),
    #[error("the link is cut on purpose")]
    Cut,
}

impl Session {
    /// A session without a stream.
    pub(crate) fn new(
        clock: Clock,
        limits: Limits,
        injury: Option<Injury>,
        receiver: Box<dyn Receiver>,
    ) -> Arc<Self> {
        let now = clock.now();
        let injured = injury.is_some();
        let core = Core {
            state: State::Waiting,
            outgoing: Outgoing::new(limits.room, injury),
            line: Line::new(limits.room),
            incoming: Incoming::default(),
            writer: None,
            stream: 0,
            driver: None,
            heard: now,
            due: now,
            reason: None,
            greeted: false,
            counts: Counts::default(),
        };
        Arc::new(Self {
            clock,
            limits,
            injured,
            core: Mutex::new(core),
            handing: Mutex::new(()),
            receiver,
            state: watch::Sender::new(State::Waiting),
        })
    }

    /// Its state, and every change of it.
    pub(crate) fn watch(&self) -> watch::Receiver<State> {
        self.state.subscribe()
    }

    pub(crate) fn state(&self) -> State {
        *self.state.borrow()
    }

    /// Whether a stream may still be had for it.
    pub(crate) fn is_open(&self) -> bool {
        matches!(self.state(), State::Waiting | State::Up | State::Broken)
    }

    /// Whether it has had no stream at all.
    pub(crate) fn was_never_up(&self) -> bool {
        !lock(&self.core).greeted
    }

    /// Whether it is injured on purpose.
    pub(crate) fn is_injured(&self) -> bool {
        self.injured
    }

    /// Whether its streams are cut on purpose at the moment.
    pub(crate) fn is_cut(&self) -> bool {
        lock(&self.core).outgoing.is_cut(self.clock.now())
    }

    /// The number up to which everything of the peer has come; said when a stream begins.
    pub(crate) fn received(&self) -> u64 {
        lock(&self.core).incoming.received()
    }

    /// Goes on over a new stream, whose other end has received everything up to `received`. The number
    /// is the stream's; what comes from it must be handed in under that number.
    ///
    /// # Errors
    /// When the session is over, or the other end claims to have what was never sent.
    pub(crate) fn attach(
        self: &Arc<Self>,
        writer: Writer,
        received: u64,
    ) -> Result<u64, AttachError> {
        let _handing = lock(&self.handing);
        let now = self.clock.now();
        let (stream, first) = {
            let mut core = lock(&self.core);
            if core.outgoing.is_cut(now) {
                return Err(AttachError::Cut);
            }
            // A newer stream takes the place of one that has not been seen to break.
            if core.state != State::Up {
                let next = core.state.after(Event::Attached);
                core.state = next.ok_or(AttachError::State(core.state))?;
            }
            core.outgoing.restart(received)?;
            core.outgoing.cut_into(writer.piece());
            let core = &mut *core;
            core.line.advance(&mut core.outgoing, now);
            core.writer = Some(writer);
            core.stream += 1;
            core.counts.streams += 1;
            core.heard = now;
            let first = !std::mem::replace(&mut core.greeted, true);
            (core.stream, first)
        };
        self.state.send_replace(State::Up);
        if first {
            self.receiver.up(self.clone());
        }
        self.wake_driver();
        Ok(stream)
    }

    /// Something happened. Down is told to the receiver, once.
    pub(crate) fn event(&self, event: Event, reason: DownReason) {
        let changed = {
            let mut core = lock(&self.core);
            self.change(&mut core, event, reason)
        };
        if changed {
            self.announce();
        }
    }

    /// The session of `stream` lost it.
    pub(crate) fn lost(&self, stream: u64) {
        let changed = {
            let mut core = lock(&self.core);
            core.stream == stream && self.change(&mut core, Event::StreamLost, DownReason::Ended)
        };
        if changed {
            self.announce();
        }
    }

    /// Makes the transition; whether there was one. The caller announces it without the lock.
    fn change(&self, core: &mut Core, event: Event, reason: DownReason) -> bool {
        let Some(next) = core.state.after(event) else {
            return false;
        };
        core.state = next;
        match next {
            State::Broken => core.writer = None,
            State::Down => {
                core.reason.get_or_insert(reason);
                if event == Event::Silence {
                    // If it can hear again, it shall know.
                    core.outgoing.pulse(Kind::GivenUp);
                }
                // A last attempt; nobody waits for it.
                let _ = Self::pump_now(core, self.clock.now());
                core.writer = None;
            }
            // However it ends from here on, this end wanted it.
            State::Closing => _ = core.reason.get_or_insert(reason),
            State::Waiting | State::Up | State::Draining => {}
        }
        true
    }

    /// Tells the present state to those who watch it, and to the receiver when it is the last.
    fn announce(&self) {
        let (state, reason) = {
            let mut core = lock(&self.core);
            let down = core.state == State::Down;
            (core.state, if down { core.reason.take() } else { None })
        };
        if let Some(reason) = reason {
            self.receiver.down(&reason);
        }
        self.state.send_replace(state);
        self.wake_driver();
    }

    fn wake_driver(&self) {
        let driver = lock(&self.core).driver.take();
        if let Some(driver) = driver {
            driver.wake();
        }
    }

    /// Writes what can be written at once, from whatever thread.
    fn pump_now(core: &mut Core, now: Instant) -> io::Result<Pumped> {
        let Core {
            outgoing,
            incoming,
            writer: Some(writer),
            ..
        } = core
        else {
            return Ok(Pumped::Idle);
        };
        outgoing.pump(incoming.received(), now, |slices| writer.try_write(slices))
    }

    /// Takes packets and writes as far as the stream allows; what is left the driver writes.
    fn put(&self, put: impl FnOnce(&mut Core, Instant)) {
        let now = self.clock.now();
        let driver = {
            let mut core = lock(&self.core);
            if core.state == State::Down {
                return;
            }
            put(&mut core, now);
            let pumped = Self::pump_now(&mut core, now);
            if self.needs_driver(&core, &pumped) {
                core.driver.take()
            } else {
                None
            }
        };
        if let Some(driver) = driver {
            driver.wake();
        }
    }

    /// Whether the driver must go on: a stream that fails is found by it, and of room that comes only it
    /// may be told.
    fn needs_driver(&self, core: &Core, pumped: &io::Result<Pumped>) -> bool {
        match pumped {
            Ok(Pumped::Idle) => self.injured,
            Ok(Pumped::Blocked) => !core.writer.as_ref().is_some_and(Writer::is_watched),
            Err(_) => true,
        }
    }

    /// Goes on writing to `stream`, which may have room again.
    pub(crate) fn pump(&self, stream: u64) {
        self.pump_on(&mut lock(&self.core), stream);
    }

    /// [`Self::pump`] for a stream over `socket`, which is asked about room as long as there is too little.
    pub(super) fn pump_socket(&self, stream: u64, socket: &Socket) {
        let mut core = lock(&self.core);
        if !self.pump_on(&mut core, stream) {
            // Whoever finds too little later asks behind this: under the lock, too.
            socket.set_wants_room(false);
        }
    }

    /// Whether there was too little room.
    fn pump_on(&self, core: &mut Core, stream: u64) -> bool {
        core.stream == stream && self.pump_or_wake(core, self.clock.now())
    }

    /// The present moment.
    pub(crate) fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Something came over `stream` that is no whole packet yet.
    pub(crate) fn heard_of(&self, stream: u64, now: Instant) {
        let mut core = lock(&self.core);
        if core.stream == stream {
            core.heard = now;
        }
    }

    /// Writes from the driver of `stream`; ends only with an error, or when another stream has taken
    /// its place.
    pub(crate) fn poll_pump(&self, cx: &mut PollContext<'_>, stream: u64) -> Poll<io::Error> {
        let now = self.clock.now();
        let mut core = lock(&self.core);
        let core = &mut *core;
        if core.stream != stream || core.outgoing.is_cut(now) {
            return Poll::Ready(io::ErrorKind::ConnectionAborted.into());
        }
        let Some(writer) = &mut core.writer else {
            return Poll::Ready(io::ErrorKind::ConnectionAborted.into());
        };
        core.driver = Some(cx.waker().clone());
        let received = core.incoming.received();
        let pumped = core.outgoing.pump(received, now, |slices| {
            match writer.poll_write(cx, slices) {
                Poll::Ready(written) => written,
                Poll::Pending => Err(io::ErrorKind::WouldBlock.into()),
            }
        });
        match pumped {
            Err(error) => Poll::Ready(error),
            Ok(_) => match writer.poll_flush(cx) {
                Poll::Ready(Err(error)) => Poll::Ready(error),
                Poll::Ready(Ok(())) | Poll::Pending => Poll::Pending,
            },
        }
    }

    /// A message to the peer's mesh.
    pub(crate) fn notify(&self, bytes: Vec<u8>) {
        self.put(|core, now| core.outgoing.put_control(Kind::Notice, bytes, now));
    }

    /// How often [`Self::keep`] is to be called.
    pub(crate) fn pulse_every(&self) -> Duration {
        let pulse = self.limits.timeout / PULSES;
        if self.injured {
            pulse.min(INJURED_PULSE)
        } else {
            pulse
        }
    }

    /// Says that this end lives, and sees whether the other one does.
    pub(crate) fn keep(&self) {
        let now = self.clock.now();
        let silent = {
            let mut core = lock(&self.core);
            let late = now.since(core.due);
            core.due = now + self.pulse_every();
            if late > self.pulse_every() {
                // This process itself stood still: what the peer said meanwhile has not been read yet.
                core.heard = core.heard + late;
            }
            now.since(core.heard) >= self.limits.timeout
        };
        if silent {
            let limit = self.limits.timeout;
            return self.event(Event::Silence, DownReason::Silence(limit));
        }
        self.put(|core, _| core.outgoing.pulse(Kind::Pulse));
    }

    /// Ends in order: what was posted goes out first.
    pub(crate) fn close(&self) {
        self.put(|core, now| {
            if core.state == State::Up {
                core.outgoing.put_control(Kind::Bye, Vec::new(), now);
            }
        });
        self.event(Event::Close, DownReason::Closed);
    }

    /// What went over it.
    pub(crate) fn counts(&self) -> Counts {
        let core = lock(&self.core);
        Counts {
            bytes_under_way: core.outgoing.bytes() as u64,
            ..core.counts
        }
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Session({:?})", self.state())
    }
}

#[cfg(test)]
mod tests;
