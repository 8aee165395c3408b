//! The other side of an exchange: which commands a simulator or a controller obeys, and what it answers.
//!
//! Knows no socket, no arm and no clock: its caller says what came, and when nothing did for too long. A peer in another
//! language does the same in a few lines; `sim/examples/mujoco` is one. Its tests are with those of the session.

use std::time::Duration;

use mcs::driver::Power;

use crate::frame::{Frame, FrameError, Kind, Mode, Trouble};

/// What the slots shall do until the next order.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// Brakes are released only by [`Power::Released`].
    pub power: Power,
    /// What each slot shall do, by its mode: be at a position (rad or m), have a speed (per s) or hold a torque (N m or N);
    /// zeros unless brakes are released.
    pub commands: Vec<f64>,
    /// When the next order is due. A simulator advances by so much.
    pub period: Duration,
}

/// Why a command is not taken in. It is not answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It is no frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// It is a state.
    #[error("it is no command")]
    Kind,
    /// It has other slots.
    #[error("it has {found} slots and not {needed}")]
    Slots {
        /// How many it has.
        found: usize,
        /// How many there are.
        needed: usize,
    },
    /// Its sequence number is not larger than the one before.
    #[error("it is old, or came twice")]
    Old,
}

/// The other side of an exchange.
#[derive(Debug)]
pub struct Peer {
    own: u32,
    slots: usize,
    /// What each slot takes.
    modes: Vec<Mode>,
    driver: u32,
    heard: u64,
    sent: u64,
    period_ns: u32,
    watchdog_ns: u32,
    trouble: Trouble,
}

impl Peer {
    /// A peer of `slots` slots, with a number `own` that another start of it would not have.
    #[must_use]
    pub fn new(own: u32, slots: usize) -> Self {
        Self {
            own: own.max(1),
            slots,
            modes: vec![Mode::Torque; slots],
            driver: 0,
            heard: 0,
            sent: 0,
            period_ns: 0,
            watchdog_ns: 0,
            trouble: Trouble::None,
        }
    }

    /// The same with slots that take these modes, one for each; those that are missing take torques.
    #[must_use]
    pub fn taking(mut self, modes: &[Mode]) -> Self {
        for (own, mode) in self.modes.iter_mut().zip(modes) {
            *own = *mode;
        }
        self
    }

    /// Takes in a command.
    ///
    /// A driver that is new is listened to at once. Brakes are released only by a command that knows this very peer, in
    /// the modes that its slots take, with numbers that are finite; after any trouble only once one came that did not release them.
    ///
    /// # Errors
    /// [`Refusal`] of what is not to be answered.
    pub fn take(&mut self, bytes: &[u8]) -> Result<Order, Refusal> {
        let frame = Frame::decode(bytes)?;
        if frame.kind != Kind::Command {
            return Err(Refusal::Kind);
        }
        let (found, needed) = (frame.rows().len(), self.slots);
        if found != needed {
            return Err(Refusal::Slots { found, needed });
        }
        if frame.session != self.driver {
            (self.driver, self.heard) = (frame.session, 0);
        }
        if frame.sequence <= self.heard {
            return Err(Refusal::Old);
        }
        self.heard = frame.sequence;
        (self.period_ns, self.watchdog_ns) = (frame.period_ns, frame.watchdog_ns);
        let released = frame.power == Power::Released;
        let rows = frame.rows().iter();
        let sound = rows
            .zip(&self.modes)
            .all(|(row, mode)| row.mode == *mode && row.values[0].is_finite());
        if released && !(frame.receiver == self.own && sound) {
            self.trouble = Trouble::Refused;
        } else if !released && self.trouble != Trouble::Fault {
            self.trouble = Trouble::None;
        }
        let obeyed = released && self.trouble == Trouble::None;
        let command = |row: &crate::frame::Row| if obeyed { row.values[0] } else { 0.0 };
        Ok(Order {
            power: match frame.power {
                Power::Released if !obeyed => Power::Braked,
                power => power,
            },
            commands: frame.rows().iter().map(command).collect(),
            period: Duration::from_nanos(self.period_ns.into()),
        })
    }

    /// How long no command may come before the brakes engage; nothing before the first one.
    #[must_use]
    pub fn watchdog(&self) -> Option<Duration> {
        (self.heard > 0).then(|| Duration::from_nanos(self.watchdog_ns.into()))
    }

    /// No command came for as long as [`Self::watchdog`] says: whoever calls this engages the brakes.
    pub fn silent(&mut self) {
        if self.trouble == Trouble::None {
            self.trouble = Trouble::Late;
        }
    }

    /// Something is wrong with the arm itself, for good.
    pub fn fault(&mut self) {
        self.trouble = Trouble::Fault;
    }

    /// The answer to the command that was taken in last: the power state that holds, then position (rad or m) and velocity
    /// of each slot.
    pub fn answer(
        &mut self,
        power: Power,
        slots: impl IntoIterator<Item = [f64; 2]>,
        stamp_ns: u64,
    ) -> Frame {
        self.sent += 1;
        let mut frame = Frame::new(Kind::State, self.slots);
        frame.power = power;
        (frame.session, frame.receiver) = (self.own, self.driver);
        (frame.sequence, frame.answers) = (self.sent, self.heard);
        (frame.period_ns, frame.watchdog_ns) = (self.period_ns, self.watchdog_ns);
        (frame.stamp_ns, frame.trouble) = (stamp_ns, self.trouble);
        let each = slots.into_iter().zip(&self.modes);
        for (row, (values, mode)) in frame.rows_mut().iter_mut().zip(each) {
            (row.mode, row.values) = (*mode, values);
        }
        frame
    }
}
