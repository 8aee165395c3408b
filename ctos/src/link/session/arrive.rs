//! What a session makes of the packets that come over its streams.

use super::{
    Core, DownReason, Session,
    packet::{Content, Kind, Packet, PacketError},
    state::{Event, State},
    window::{Arrival, Pumped},
};
use crate::{lock::lock, time::Instant};

impl Session {
    /// Something came over `stream`, lately: at `now`. False when nothing more may come over it.
    pub(crate) fn receive(&self, stream: u64, packet: Packet, now: Instant) -> bool {
        let _handing = lock(&self.handing);
        let mut core = lock(&self.core);
        if core.stream != stream || core.state == State::Down {
            return false;
        }
        core.heard = now;
        let (take, event) = match self.accept(&mut core, &packet, now) {
            Ok(accepted) => accepted,
            Err(error) => (
                false,
                Some((Event::Rubbish, DownReason::Rubbish(error.to_string()))),
            ),
        };
        let state = core.state;
        drop(core);
        if take {
            self.hand_over(packet.content, now);
        }
        if let Some((event, reason)) = event {
            self.event(event, reason);
        } else if state != State::Closing {
            // Should it have come to an end meanwhile, the next packet is told.
            return true;
        } else if lock(&self.core).outgoing.is_empty() {
            self.event(Event::Flushed, DownReason::Closed);
        }
        self.state() != State::Down
    }

    /// What a packet means: whether its content is to be handed over, and what has happened.
    fn accept(
        &self,
        core: &mut Core,
        packet: &Packet,
        now: Instant,
    ) -> Result<(bool, Option<(Event, DownReason)>), PacketError> {
        core.outgoing.acknowledge(packet.received)?;
        if core.line.advance(&mut core.outgoing, now) {
            self.pump_or_wake(core, now);
        }
        if packet.kind == Kind::GivenUp {
            return Ok((false, Some((Event::GivenUp, DownReason::GivenUp))));
        }
        if packet.kind == Kind::Again {
            core.outgoing.again();
        }
        if !packet.kind.is_numbered() {
            if packet.number > core.incoming.received() {
                core.outgoing.pulse(Kind::Again);
            }
            self.pump_or_wake(core, now);
            return Ok((false, None));
        }
        match core.incoming.take(packet.number, packet.content.size()) {
            Arrival::Old => Ok((false, None)),
            Arrival::Early => {
                if core.incoming.must_ask() {
                    core.outgoing.pulse(Kind::Again);
                    self.pump_or_wake(core, now);
                }
                Ok((false, None))
            }
            Arrival::Next => {
                if let Content::Frame(frame) = &packet.content {
                    core.counts.frames_in += 1;
                    core.counts.bytes_in += frame.body.len() as u64;
                }
                let bye = packet.kind == Kind::Bye;
                if core.incoming.must_acknowledge(self.limits.room / 4) || bye {
                    core.outgoing.pulse(Kind::Pulse);
                    self.pump_or_wake(core, now);
                }
                Ok((!bye, bye.then_some((Event::Bye, DownReason::Bye))))
            }
        }
    }

    /// As [`Self::put`], for one that holds the lock and is the driver. Whether there was too little room.
    pub(super) fn pump_or_wake(&self, core: &mut Core, now: Instant) -> bool {
        let pumped = Self::pump_now(core, now);
        if self.needs_driver(core, &pumped)
            && let Some(driver) = &core.driver
        {
            driver.wake_by_ref();
        }
        matches!(pumped, Ok(Pumped::Blocked))
    }

    fn hand_over(&self, content: Content, now: Instant) {
        match content {
            Content::Frame(frame) => {
                tracing::trace!(
                    target: "ctos::link",
                    from = %frame.header.from,
                    to = %frame.header.to,
                    command = frame.header.command,
                    bytes = frame.body.len(),
                    "in"
                );
                self.receiver.frame(frame, now);
            }
            Content::Notice(bytes) => self.receiver.notice(bytes),
            Content::Nothing => {}
        }
    }
}

impl Content {
    pub(super) fn size(&self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Frame(frame) => frame.body.len(),
            Self::Notice(bytes) => bytes.len(),
        }
    }
}
