//! A session without its streams: what one end knows of what it sent and what it heard, as a state machine.
//!
//! Bytes, events and the present moment go in; what came, a new state and bytes to write come out. It knows
//! no stream, no thread and no clock. Its driver says what has come and when, hands on what it gets back,
//! and lets it write ([`Core::pump`]).

use std::{io, io::IoSlice, time::Duration};

use super::{
    line::{Line, gives_up, is_fence, lane_of_request},
    packet::{Content, Decoder, Kind, Packet, PacketError},
    state::{DownReason, Event, State},
    window::{Arrival, Incoming, Lane, Outgoing},
};
use crate::{
    frame::{Counts, Frame, Full},
    injure::Injury,
    message::{Flags, SYSTEM_COMMANDS, fault::Fault},
    time::Instant,
};

/// How often a session says that it lives, as a part of the time after which silence counts.
const PULSES: u32 = 4;

/// How often an injured session looks after what was lost.
const INJURED_PULSE: Duration = Duration::from_millis(20);

/// Faults are let through when there are no credits for answers; they are small.
const SMALL: usize = 4 * 1024;

/// What a session holds to.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// A peer that is silent for so long is down.
    pub timeout: Duration,
    /// How many bytes of requests, and of answers, may be unacknowledged.
    pub unacknowledged: usize,
}

/// The stream is of no use to the session.
#[derive(Debug, thiserror::Error)]
pub enum AttachError {
    #[error("the session is {0:?}")]
    State(State),
    #[error(transparent)]
    Packet(#[from] PacketError),
    #[error("the link is cut on purpose")]
    Cut,
}

/// What came of some bytes.
#[derive(Debug, Default)]
pub struct Heard {
    /// For the receiver.
    pub content: Content,
    /// There may be something to write.
    pub writes: bool,
    /// The state is another one.
    pub changed: bool,
    /// More may come over the stream.
    pub goes_on: bool,
}

/// One end of a session.
pub struct Core {
    limits: Limits,
    injured: bool,
    state: State,
    outgoing: Outgoing,
    /// Requests that wait for credits.
    line: Line,
    incoming: Incoming,
    decoder: Decoder,
    /// Which stream: what is left of an earlier one is not listened to.
    stream: u64,
    /// When anything was heard last.
    heard: Instant,
    /// When the driver was to look next: a process that was frozen must not blame its peers.
    due: Instant,
    /// Why it is down, or will be, until that was reported.
    reason: Option<DownReason>,
    counts: Counts,
}

impl Core {
    /// A session without a stream.
    pub fn new(limits: Limits, injury: Option<Injury>, now: Instant) -> Self {
        Self {
            limits,
            injured: injury.is_some(),
            state: State::Waiting,
            outgoing: Outgoing::new(limits.unacknowledged, injury),
            line: Line::new(limits.unacknowledged),
            incoming: Incoming::default(),
            decoder: Decoder::default(),
            stream: 0,
            heard: now,
            due: now,
            reason: None,
            counts: Counts::default(),
        }
    }

    pub fn state(&self) -> State {
        self.state
    }

    /// The present stream, or the last one; 0 before the first.
    pub fn stream(&self) -> u64 {
        self.stream
    }

    /// Whether it has had no stream at all.
    pub fn was_never_up(&self) -> bool {
        self.stream == 0
    }

    /// Whether it is injured on purpose.
    pub fn is_injured(&self) -> bool {
        self.injured
    }

    /// Whether its streams are cut on purpose at the moment.
    pub fn is_cut(&self, now: Instant) -> bool {
        self.outgoing.is_cut(now)
    }

    /// The number up to which everything of the peer has come; said when a stream begins.
    pub fn received(&self) -> u64 {
        self.incoming.received()
    }

    /// What went over it.
    pub fn counts(&self) -> Counts {
        Counts {
            bytes_under_way: self.outgoing.bytes() as u64,
            ..self.counts
        }
    }

    /// Goes on over a new stream, whose other end has received everything up to `received`. Frames with more data
    /// than `piece` bytes are cut on it. The number is the stream's, the first is 1; what comes from it must be
    /// handed in under that number.
    ///
    /// # Errors
    /// When the session is over, or the other end claims to have what was never sent.
    pub fn attach(
        &mut self,
        received: u64,
        piece: usize,
        now: Instant,
    ) -> Result<u64, AttachError> {
        if self.is_cut(now) {
            return Err(AttachError::Cut);
        }
        let next = match self.state {
            // A newer stream takes the place of one that has not been seen to break.
            State::Up => State::Up,
            state => state
                .after(Event::Attached)
                .ok_or(AttachError::State(state))?,
        };
        self.outgoing.restart(received)?;
        self.state = next;
        self.outgoing.cut_into(piece);
        self.line.advance(&mut self.outgoing, now);
        self.decoder = Decoder::default();
        self.heard = now;
        self.stream += 1;
        self.counts.streams += 1;
        Ok(self.stream)
    }

    /// Something happened, and why; whether the state is another one now.
    pub fn event(&mut self, event: Event, reason: DownReason) -> bool {
        let Some(next) = self.state.after(event) else {
            return false;
        };
        self.state = next;
        // However it ends from `Closing` on, this end wanted it.
        if matches!(next, State::Down | State::Closing) {
            self.reason.get_or_insert(reason);
        }
        if event == Event::Silence {
            // If it can hear again, it shall know.
            self.outgoing.pulse(Kind::GivenUp);
        }
        true
    }

    /// The stream ended or failed; whether the state is another one now.
    pub fn lost(&mut self, stream: u64) -> bool {
        self.stream == stream && self.event(Event::StreamLost, DownReason::Ended)
    }

    /// Why it is down; said once.
    pub fn take_reason(&mut self) -> Option<DownReason> {
        if self.state == State::Down {
            self.reason.take()
        } else {
            None
        }
    }

    // -- what is sent -----------------------------------------------------------------------

    /// Takes a frame. One that is posted to a session that is down is lost.
    ///
    /// # Errors
    /// [`Full`] when too much is under way already.
    pub fn post(&mut self, frame: Frame, now: Instant) -> Result<(), Full> {
        if self.state == State::Down {
            return Ok(());
        }
        let lane = lane_of(&frame);
        let size = frame.body.len();
        match lane {
            Lane::Data | Lane::Urgent => {
                let sent = self.line.send(frame, &mut self.outgoing, now);
                self.counts.refused += u64::from(sent.is_err());
                sent?;
            }
            // One that still waits for credits is not sent at all.
            Lane::Control if gives_up(&frame) && self.line.withdraw(frame.call) => {}
            Lane::Control => {
                let frame = match self.outgoing.admits(lane, size) {
                    Ok(()) => frame,
                    Err(Full { bytes }) => {
                        self.counts.refused += 1;
                        Self::without_body(frame, bytes)
                    }
                };
                self.outgoing.put_frame(frame, lane, now);
            }
        }
        self.counts.frames_out += 1;
        self.counts.bytes_out += size as u64;
        Ok(())
    }

    /// A control frame for which there are no credits: what is small goes anyway, a large answer becomes the
    /// fault that says so.
    fn without_body(mut frame: Frame, under_way: usize) -> Frame {
        if frame.body.len() <= SMALL || !frame.header.flags.contains(Flags::REPLY) {
            return frame;
        }
        let fault = Fault::LinkFull { bytes: under_way };
        // A fault is plain data; should it fail to encode, the empty body is read as one.
        frame.body = postcard::to_stdvec(&fault).unwrap_or_default().into();
        frame.header.flags |= Flags::FAULT;
        frame.header.size = u32::try_from(frame.body.len()).unwrap_or(u32::MAX);
        frame
    }

    /// Takes a message to the peer's mesh.
    pub fn notify(&mut self, bytes: Vec<u8>, now: Instant) {
        if self.state != State::Down {
            self.outgoing.put_control(Kind::Notice, bytes, now);
        }
    }

    /// Ends in order: what was posted goes out first. Whether the state is another one now.
    pub fn close(&mut self, now: Instant) -> bool {
        if self.state == State::Up {
            self.outgoing.put_control(Kind::Bye, Vec::new(), now);
        }
        self.event(Event::Close, DownReason::Closed)
    }

    /// Writes until everything is written or `write` takes no more.
    ///
    /// # Errors
    /// What `write` says, other than that it would block.
    pub fn pump(
        &mut self,
        now: Instant,
        write: impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>,
    ) -> io::Result<()> {
        self.outgoing.pump(self.incoming.received(), now, write)
    }

    // -- what is heard ----------------------------------------------------------------------

    /// Takes what it needs of `bytes`, which came over `stream`: at most one packet.
    pub fn read(&mut self, stream: u64, bytes: &mut &[u8], now: Instant) -> Heard {
        let mut heard = Heard::default();
        if self.stream != stream || self.state == State::Down {
            return heard;
        }
        // A large frame takes long: what has come of it is a sign of life, too.
        self.heard = now;
        let accepted = match self.decoder.feed(bytes) {
            Ok(Some(packet)) => self.accept(packet, now, &mut heard),
            Ok(None) => Ok(()),
            Err(error) => Err(error),
        };
        if let Err(error) = accepted {
            heard.changed = self.event(Event::Rubbish, DownReason::Rubbish(error.to_string()));
        } else if self.state == State::Closing && self.outgoing.is_empty() {
            heard.changed = self.event(Event::Flushed, DownReason::Closed);
        }
        heard.goes_on = self.state != State::Down;
        heard
    }

    /// What a packet means.
    fn accept(
        &mut self,
        packet: Packet,
        now: Instant,
        heard: &mut Heard,
    ) -> Result<(), PacketError> {
        self.outgoing.acknowledge(packet.received)?;
        heard.writes = self.line.advance(&mut self.outgoing, now);
        match packet.kind {
            Kind::GivenUp => {
                heard.changed = self.event(Event::GivenUp, DownReason::GivenUp);
                return Ok(());
            }
            Kind::Again => self.outgoing.again(),
            _ => {}
        }
        if !packet.kind.is_numbered() {
            if packet.number > self.incoming.received() {
                self.outgoing.pulse(Kind::Again);
            }
            heard.writes = true;
            return Ok(());
        }
        match self.incoming.take(packet.number, packet.content.size()) {
            Arrival::Old => {}
            Arrival::Early => {
                if self.incoming.must_ask() {
                    self.outgoing.pulse(Kind::Again);
                    heard.writes = true;
                }
            }
            Arrival::Next => {
                let is_bye = packet.kind == Kind::Bye;
                if self
                    .incoming
                    .must_acknowledge(self.limits.unacknowledged / 4)
                    || is_bye
                {
                    self.outgoing.pulse(Kind::Pulse);
                    heard.writes = true;
                }
                if is_bye {
                    heard.changed = self.event(Event::Bye, DownReason::Bye);
                    return Ok(());
                }
                if let Content::Frame(frame) = &packet.content {
                    self.counts.frames_in += 1;
                    self.counts.bytes_in += frame.body.len() as u64;
                }
                heard.content = packet.content;
            }
        }
        Ok(())
    }

    // -- time -------------------------------------------------------------------------------

    /// How often [`Self::keep`] is to be called.
    pub fn pulse_every(&self) -> Duration {
        let pulse = self.limits.timeout / PULSES;
        if self.injured {
            pulse.min(INJURED_PULSE)
        } else {
            pulse
        }
    }

    /// Says that this end lives, and sees whether the other one does; whether the state is another one now.
    pub fn keep(&mut self, now: Instant) -> bool {
        let late = now.since(self.due);
        self.due = now + self.pulse_every();
        if late > self.pulse_every() {
            // This process itself stood still: what the peer said meanwhile has not been read yet.
            self.heard = self.heard + late;
        }
        let timeout = self.limits.timeout;
        if now.since(self.heard) >= timeout {
            return self.event(Event::Silence, DownReason::Silence(timeout));
        }
        if self.state != State::Down {
            self.outgoing.pulse(Kind::Pulse);
        }
        false
    }
}

/// Answers and the runtime's own messages are never kept out by requests, but for a fence, which follows them.
fn lane_of(frame: &Frame) -> Lane {
    let flags = frame.header.flags;
    let answers = flags.contains(Flags::REPLY) || flags.contains(Flags::ABANDONED);
    let of_runtime = frame.header.command >= SYSTEM_COMMANDS && !is_fence(frame);
    if answers || of_runtime {
        Lane::Control
    } else {
        lane_of_request(frame)
    }
}

#[cfg(test)]
mod tests;
