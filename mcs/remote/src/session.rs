//! The driver's side of an exchange: which command goes out next, and whether what comes back may be believed.
//!
//! Knows no socket and looks at no clock: its caller says what came and when a period is over. Nothing allocates but the
//! making of a session. A peer is believed once it has answered well [`GOOD`] times on end; the first frame that cannot be
//! right ends that, and with it the order to move.

use std::{io, time::Duration};

use mcs::driver::{Power, SlotReading};

use crate::frame::{Frame, FrameError, Kind, Mode, Trouble};

/// So many good answers on end make a peer one that is believed.
pub const GOOD: u32 = 3;

/// A joint may be so many times as fast as it can be by its model: brakes that open let it fall, and speeds have noise.
const FACTOR: f64 = 2.0;

/// Positions may be read so much apart at rest, rad or m: the counts of encoders.
const COUNTS: f64 = 1e-3;

/// Why a peer is not believed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Doubt {
    /// It has not answered yet.
    #[error("has not answered yet; is it running?")]
    NoAnswer,
    /// It has stopped answering.
    #[error("is silent: it has answered nothing for {for_ms:.1} ms; is it running?")]
    Silent {
        /// For how long, ms.
        for_ms: f64,
    },
    /// Bytes from it are no frame.
    #[error("sent what is no frame: {0}")]
    Frame(#[from] FrameError),
    /// It sent a command.
    #[error("sends commands and no states: is another driver there?")]
    Kind,
    /// It has other slots.
    #[error(
        "has {found} slots, and the arm has {needed} joints; choose another `model`, or another address"
    )]
    Slots {
        /// How many it has.
        found: usize,
        /// How many the arm has.
        needed: usize,
    },
    /// It answered somebody else.
    #[error("answered another driver; let one driver use it")]
    Receiver,
    /// It is another one than before, or the same started again.
    #[error("began again: it has forgotten what it was told")]
    BeganAgain,
    /// A sequence number came again, or an older one.
    #[error("sent frame {found} after frame {newest}: an old or repeated sequence number")]
    Old {
        /// The sequence number.
        found: u64,
        /// The newest before it.
        newest: u64,
    },
    /// It answered what it was not asked.
    #[error("answered command {found}, which is not one of {first} to {last}")]
    Answer {
        /// The command.
        found: u64,
        /// The oldest without an answer.
        first: u64,
        /// The newest.
        last: u64,
    },
    /// Its answer is about a command of long ago.
    #[error("is late: its newest answer is {by_ms:.1} ms old")]
    Stale {
        /// How old, ms.
        by_ms: f64,
    },
    /// A number of a slot is none.
    #[error("sent a position or a speed of slot {slot} that is no finite number")]
    NotFinite {
        /// Slot, from 1.
        slot: usize,
    },
    /// A slot moved farther than its joint can.
    #[error(
        "let slot {slot} jump by {by:.4} in {within_ms:.1} ms, and its joint moves {most:.4} at most"
    )]
    Jump {
        /// Slot, from 1.
        slot: usize,
        /// How far, rad or m.
        by: f64,
        /// In what time, ms.
        within_ms: f64,
        /// How far at most, rad or m.
        most: f64,
    },
    /// A slot is faster than its joint can be.
    #[error("has slot {slot} move at {speed:.3}, and its joint is not faster than {most:.3}")]
    Speed {
        /// Slot, from 1.
        slot: usize,
        /// How fast, rad/s or m/s.
        speed: f64,
        /// How fast at most.
        most: f64,
    },
    /// It braked by itself.
    #[error("lost power, or engaged its brakes by itself")]
    Power,
    /// It goes on although it was told to brake.
    #[error("does not brake although it was told to {for_ms:.1} ms ago")]
    Disobeys {
        /// Since when, ms.
        for_ms: f64,
    },
    /// It says why it does nothing.
    #[error("{}", match .0 {
        Trouble::Late => "has braked: commands reached it too late",
        Trouble::Refused => "has braked: it cannot do what a command said",
        Trouble::Fault | Trouble::None => "has braked: it reports a fault of its own",
    })]
    Own(Trouble),
    /// The operating system refuses.
    #[error("cannot be reached: {0}")]
    Socket(io::ErrorKind),
}

/// The driver's side of an exchange.
#[derive(Debug)]
pub struct Session {
    own: u32,
    watchdog: Duration,
    /// Speed of each joint at most, rad/s or m/s.
    speeds: Vec<f64>,
    /// What each slot is commanded by.
    modes: Vec<Mode>,
    period: Duration,
    /// The peer's session, or 0.
    peer: u32,
    /// The newest command, and the newest state.
    sent: u64,
    heard: u64,
    /// The newest command that was answered.
    answered: u64,
    readings: Vec<SlotReading>,
    /// Whether the readings are of the peer that is being listened to.
    placed: bool,
    /// Good answers on end.
    good: u32,
    fresh: bool,
    silent: Duration,
    doubt: Doubt,
    ordered: Power,
    /// The first command of the power state that is ordered.
    since: u64,
    /// Whether the peer has shown released brakes since.
    released: bool,
}

impl Session {
    /// A session with the number `own` (not 0) for joints of those `speeds` at most (rad/s or m/s). The peer brakes `watchdog`
    /// after the last command. It is given up as long after its last state.
    #[must_use]
    pub fn new(own: u32, speeds: Vec<f64>, watchdog: Duration) -> Self {
        Self {
            own: own.max(1),
            watchdog,
            period: Duration::ZERO,
            peer: 0,
            sent: 0,
            heard: 0,
            answered: 0,
            readings: vec![SlotReading::default(); speeds.len()],
            modes: vec![Mode::Torque; speeds.len()],
            speeds,
            placed: false,
            good: 0,
            fresh: false,
            silent: Duration::ZERO,
            doubt: Doubt::NoAnswer,
            ordered: Power::Off,
            since: 1,
            released: false,
        }
    }

    /// The same with slots that are commanded by these modes, one for each; those that are missing by torque.
    #[must_use]
    pub fn commanding(mut self, modes: &[Mode]) -> Self {
        for (own, mode) in self.modes.iter_mut().zip(modes) {
            *own = *mode;
        }
        self
    }

    /// What each slot is commanded by.
    #[must_use]
    pub fn modes(&self) -> &[Mode] {
        &self.modes
    }

    /// How many slots there are.
    #[must_use]
    pub fn slots(&self) -> usize {
        self.speeds.len()
    }

    /// Whether the peer is believed.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.good >= GOOD
    }

    /// Commands that were not answered yet.
    #[must_use]
    pub fn unanswered(&self) -> u64 {
        self.sent.saturating_sub(self.answered)
    }

    /// The next command, one number for each slot by its mode. To a peer that is not believed it says power off, whatever is
    /// asked for.
    pub fn command(
        &mut self,
        commands: &[f64],
        power: Power,
        period: Duration,
        stamp_ns: u64,
    ) -> Frame {
        let power = if self.is_good() { power } else { Power::Off };
        self.sent += 1;
        self.period = period;
        if power != self.ordered {
            (self.ordered, self.since, self.released) = (power, self.sent, false);
        }
        let mut frame = Frame::new(Kind::Command, self.slots());
        frame.power = power;
        (frame.session, frame.receiver) = (self.own, self.peer);
        (frame.sequence, frame.answers) = (self.sent, self.heard);
        frame.stamp_ns = stamp_ns;
        (frame.period_ns, frame.watchdog_ns) = (nanos(period), nanos(self.watchdog));
        let each = commands.iter().zip(&self.modes);
        for (row, (command, mode)) in frame.rows_mut().iter_mut().zip(each) {
            row.mode = *mode;
            row.values[0] = if power == Power::Released {
                *command
            } else {
                0.0
            };
        }
        frame
    }

    /// Takes in what came from the peer.
    pub fn take(&mut self, bytes: &[u8]) {
        let judged = match Frame::decode(bytes) {
            Ok(frame) => self.judge(&frame),
            Err(error) => Err(error.into()),
        };
        match judged {
            Ok(()) => {
                self.fresh = true;
                self.good = self.good.saturating_add(1);
            }
            Err(doubt) => self.fail(doubt),
        }
    }

    /// From now on the peer is not believed, until it has answered well again.
    pub fn fail(&mut self, doubt: Doubt) {
        self.doubt = doubt;
        self.good = 0;
        self.placed = false;
    }

    /// The period is over: the newest readings.
    ///
    /// # Errors
    /// Why the peer is not believed.
    pub fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), Doubt> {
        if std::mem::take(&mut self.fresh) {
            self.silent = Duration::ZERO;
        } else {
            self.silent = self.silent.saturating_add(self.period);
            // Who never said anything, or was in doubt before, is so for the reason that is known.
            if self.silent > self.watchdog && self.heard > 0 {
                let for_ms = millis(self.silent);
                self.fail(Doubt::Silent { for_ms });
            }
        }
        if !self.is_good() {
            return Err(self.doubt);
        }
        readings.copy_from_slice(&self.readings);
        Ok(())
    }

    /// For how long nothing has come; zero where something came in the period that was read last.
    #[must_use]
    pub fn silent(&self) -> Duration {
        self.silent
    }

    /// Why the peer is not believed, if it is not.
    #[must_use]
    pub fn doubt(&self) -> Option<Doubt> {
        (!self.is_good()).then_some(self.doubt)
    }

    fn judge(&mut self, frame: &Frame) -> Result<(), Doubt> {
        if frame.kind != Kind::State {
            return Err(Doubt::Kind);
        }
        let (found, needed) = (frame.rows().len(), self.slots());
        if found != needed {
            return Err(Doubt::Slots { found, needed });
        }
        if frame.receiver != self.own {
            return Err(Doubt::Receiver);
        }
        if frame.session != self.peer {
            let first = self.peer == 0;
            (self.peer, self.heard) = (frame.session, 0);
            if !first {
                return Err(Doubt::BeganAgain);
            }
        }
        if frame.sequence <= self.heard {
            let (found, newest) = (frame.sequence, self.heard);
            return Err(Doubt::Old { found, newest });
        }
        self.heard = frame.sequence;
        let found = frame.answers;
        if !(self.answered + 1..=self.sent).contains(&found) {
            let (first, last) = (self.answered + 1, self.sent);
            return Err(Doubt::Answer { found, first, last });
        }
        let commands = found - self.answered;
        self.answered = found;
        // No count of commands that are under way is large.
        let under_way = self.span(self.sent - found);
        if under_way > self.watchdog {
            let by_ms = millis(under_way);
            return Err(Doubt::Stale { by_ms });
        }
        if frame.trouble != Trouble::None {
            return Err(Doubt::Own(frame.trouble));
        }
        self.judge_motion(frame, self.span(commands))?;
        self.judge_power(frame)
    }

    /// Whether the joints can have moved so in the time of the commands that were answered.
    fn judge_motion(&mut self, frame: &Frame, within: Duration) -> Result<(), Doubt> {
        let slots = frame.rows().iter().zip(&self.speeds);
        for ((index, (row, most)), before) in slots.enumerate().zip(&self.readings) {
            let (slot, [position, speed]) = (index + 1, row.values);
            if !(position.is_finite() && speed.is_finite()) {
                return Err(Doubt::NotFinite { slot });
            }
            let most = FACTOR * most;
            if speed.abs() > most {
                return Err(Doubt::Speed { slot, speed, most });
            }
            let (by, most) = (
                position - before.position,
                most * within.as_secs_f64() + COUNTS,
            );
            if self.placed && by.abs() > most {
                let within_ms = millis(within);
                return Err(Doubt::Jump {
                    slot,
                    by,
                    within_ms,
                    most,
                });
            }
        }
        for (reading, row) in self.readings.iter_mut().zip(frame.rows()) {
            [reading.position, reading.velocity] = row.values;
        }
        self.placed = true;
        Ok(())
    }

    /// Whether the power state is what was ordered, as far as the peer has had time for it.
    fn judge_power(&mut self, frame: &Frame) -> Result<(), Doubt> {
        // An answer to what was ordered before.
        if frame.answers < self.since {
            return Ok(());
        }
        let shown = frame.power == Power::Released;
        if self.ordered == Power::Released {
            if self.released && !shown {
                return Err(Doubt::Power);
            }
            self.released = shown;
            return Ok(());
        }
        let ago = self.span(frame.answers - self.since);
        if shown && ago > self.watchdog {
            let for_ms = millis(ago);
            return Err(Doubt::Disobeys { for_ms });
        }
        Ok(())
    }

    /// The time of so many commands.
    fn span(&self, commands: u64) -> Duration {
        let commands = u32::try_from(commands).unwrap_or(u32::MAX);
        self.period.saturating_mul(commands)
    }
}

/// Whole ns, or as many as there can be.
fn nanos(time: Duration) -> u32 {
    u32::try_from(time.as_nanos()).unwrap_or(u32::MAX)
}

fn millis(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

#[cfg(test)]
mod tests;
