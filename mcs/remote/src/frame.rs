//! The one frame of the protocol, and its bytes. Knows no socket and no session.
//!
//! Every frame has [`SIZE`] bytes, whatever the number of slots; numbers are little-endian. `docs/remote.md` has the table
//! of all fields. What is accepted is written again to the same bytes.

pub use mcs::driver::Mode;
use mcs::{MAX_SLOTS, driver::Power};

/// Bytes of a frame.
pub const SIZE: usize = 604;

/// The version of the protocol that this crate speaks.
pub const VERSION: u8 = 1;

/// The first bytes of each frame.
pub const MAGIC: [u8; 4] = *b"mcsr";

/// Where the modes, the rows and the checksum begin.
const MODES: usize = 56;
const ROWS: usize = MODES + MAX_SLOTS;
const CHECKSUM: usize = ROWS + 16 * MAX_SLOTS;
const _: () = assert!(CHECKSUM + 4 == SIZE);

/// Who sends a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The driver: what the slots shall do.
    Command = 1,
    /// The peer: how the slots are.
    State = 2,
}

/// What keeps a peer from doing what it is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// Nothing does.
    None = 0,
    /// Commands had stopped coming; brakes are on until a command does not release them.
    Late = 1,
    /// A command could not be obeyed: its mode, or a number in it. Brakes are on likewise.
    Refused = 2,
    /// A fault of its own.
    Fault = 3,
}

/// Two numbers of a slot. Of a command: the target by its mode, and 0. Of a state: position (rad or m) and velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// The mode that is ordered, or that holds.
    pub mode: Mode,
    /// The numbers.
    pub values: [f64; 2],
}

/// A frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Who sends it.
    pub kind: Kind,
    /// The power state that is ordered, or that holds.
    pub power: Power,
    /// A number that the sender has chosen at its start; never 0.
    pub session: u32,
    /// The session of the receiver as far as the sender knows it; else 0.
    pub receiver: u32,
    /// Counts the frames of the session, from 1.
    pub sequence: u64,
    /// The sequence of the newest frame that the sender has taken in.
    pub answers: u64,
    /// The sender's clock, ns since some moment of its own.
    pub stamp_ns: u64,
    /// When the next command is due, ns. Of a state, that of the command.
    pub period_ns: u32,
    /// After this long without a command the peer brakes, ns; after as long without a state the driver gives up.
    pub watchdog_ns: u32,
    /// What keeps the peer from obeying.
    pub trouble: Trouble,
    /// How many rows count.
    slots: u8,
    rows: [Row; MAX_SLOTS],
}

/// Why bytes are no frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Not as long as a frame.
    #[error("it has {found} bytes and not {SIZE}")]
    Length {
        /// Its length.
        found: usize,
    },
    /// It does not begin as a frame does.
    #[error("it does not begin with `mcsr`: it is of another protocol")]
    Magic,
    /// Another version.
    #[error("it is of version {found} of the protocol and not {VERSION}")]
    Version {
        /// Its version.
        found: u8,
    },
    /// Bytes were changed on the way, or the sender computes otherwise.
    #[error("its checksum is wrong")]
    Checksum,
    /// A field says what it cannot.
    #[error("its field `{field}` has no such value as {found}")]
    Field {
        /// Which.
        field: &'static str,
        /// Its value.
        found: u32,
    },
    /// Something stands where nothing may.
    #[error("something stands behind its last slot")]
    Unused,
}

impl Frame {
    /// A frame of `slots` slots (1 to [`MAX_SLOTS`]) with nothing in it.
    #[must_use]
    pub fn new(kind: Kind, slots: usize) -> Self {
        let row = Row {
            mode: Mode::Torque,
            values: [0.0; 2],
        };
        Self {
            kind,
            power: Power::Off,
            session: 0,
            receiver: 0,
            sequence: 0,
            answers: 0,
            stamp_ns: 0,
            period_ns: 0,
            watchdog_ns: 0,
            trouble: Trouble::None,
            slots: slots.clamp(1, MAX_SLOTS) as u8,
            rows: [row; MAX_SLOTS],
        }
    }

    /// The slots.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows[..usize::from(self.slots)]
    }

    /// The slots, to be filled.
    pub fn rows_mut(&mut self) -> &mut [Row] {
        &mut self.rows[..usize::from(self.slots)]
    }

    /// The bytes of the frame.
    #[must_use]
    pub fn encode(&self) -> [u8; SIZE] {
        let mut bytes = [0; SIZE];
        let mut put = |at: usize, field: &[u8]| bytes[at..at + field.len()].copy_from_slice(field);
        put(0, &MAGIC);
        let power = match self.power {
            Power::Off => 0,
            Power::Braked => 1,
            Power::Released => 2,
        };
        put(4, &[VERSION, self.kind as u8, self.slots, power]);
        put(8, &self.session.to_le_bytes());
        put(12, &self.receiver.to_le_bytes());
        put(16, &self.sequence.to_le_bytes());
        put(24, &self.answers.to_le_bytes());
        put(32, &self.stamp_ns.to_le_bytes());
        put(40, &self.period_ns.to_le_bytes());
        put(44, &self.watchdog_ns.to_le_bytes());
        put(48, &(self.trouble as u32).to_le_bytes());
        for (index, row) in self.rows().iter().enumerate() {
            put(MODES + index, &[row.mode as u8]);
            let [first, second] = row.values;
            put(ROWS + 16 * index, &first.to_le_bytes());
            put(ROWS + 16 * index + 8, &second.to_le_bytes());
        }
        let checksum = crc32fast::hash(&bytes[..CHECKSUM]);
        bytes[CHECKSUM..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// The frame of `bytes`. Numbers of slots may be of any kind, also none.
    ///
    /// # Errors
    /// What is wrong first: length, magic, version, checksum, then the fields in turn.
    pub fn decode(bytes: &[u8]) -> Result<Self, FrameError> {
        let found = bytes.len();
        let bytes: &[u8; SIZE] = bytes.try_into().map_err(|_| FrameError::Length { found })?;
        if bytes[..4] != MAGIC {
            return Err(FrameError::Magic);
        }
        let [version, kind, slots, power] = take(bytes, 4);
        if version != VERSION {
            return Err(FrameError::Version { found: version });
        }
        if u32::from_le_bytes(take(bytes, CHECKSUM)) != crc32fast::hash(&bytes[..CHECKSUM]) {
            return Err(FrameError::Checksum);
        }
        let field = |field: &'static str, found: u32| FrameError::Field { field, found };
        if !(1..=MAX_SLOTS).contains(&usize::from(slots)) {
            return Err(field("slots", slots.into()));
        }
        let kind = match kind {
            1 => Kind::Command,
            2 => Kind::State,
            _ => return Err(field("kind", kind.into())),
        };
        let mut frame = Self::new(kind, usize::from(slots));
        frame.power = match power {
            0 => Power::Off,
            1 => Power::Braked,
            2 => Power::Released,
            _ => return Err(field("power", power.into())),
        };
        let short = |at: usize| u32::from_le_bytes(take(bytes, at));
        let long = |at: usize| u64::from_le_bytes(take(bytes, at));
        (frame.session, frame.receiver) = (short(8), short(12));
        (frame.sequence, frame.answers, frame.stamp_ns) = (long(16), long(24), long(32));
        (frame.period_ns, frame.watchdog_ns) = (short(40), short(44));
        frame.trouble = match short(48) {
            0 => Trouble::None,
            1 => Trouble::Late,
            2 => Trouble::Refused,
            3 => Trouble::Fault,
            found => return Err(field("trouble", found)),
        };
        for (index, row) in frame.rows_mut().iter_mut().enumerate() {
            row.mode = match bytes[MODES + index] {
                8 => Mode::Position,
                9 => Mode::Velocity,
                10 => Mode::Torque,
                found => return Err(field("mode", found.into())),
            };
            let at = ROWS + 16 * index;
            row.values = [at, at + 8].map(|at| f64::from_le_bytes(take(bytes, at)));
        }
        let last = frame.rows().len();
        let behind = [
            &bytes[52..MODES],
            &bytes[MODES + last..ROWS],
            &bytes[ROWS + 16 * last..CHECKSUM],
        ];
        if behind.iter().any(|part| part.iter().any(|byte| *byte != 0)) {
            return Err(FrameError::Unused);
        }
        Ok(frame)
    }
}

/// Some bytes of a frame. Every place that is asked for lies in it.
fn take<const N: usize>(bytes: &[u8; SIZE], at: usize) -> [u8; N] {
    std::array::from_fn(|index| bytes[at + index])
}

#[cfg(test)]
pub(crate) mod tests;
