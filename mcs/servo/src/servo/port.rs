//! How everything else reaches the servo: orders in, snapshots out.

use std::sync::{Arc, Mutex, PoisonError};

use crossbeam_queue::ArrayQueue;
use serde::{Deserialize, Serialize};

use super::stream::{Stream, StreamStatus};
use crate::control::ControlLaw;
use crate::driver::{DriverError, Power};
use crate::guard::rack::RackPort;
use crate::guard::{GuardReport, GuardSet, Mounted, Reaction, Words};
use crate::joints::{Distances, Joints};
use crate::model::JointKind;
use crate::trajectory::{Bridge, Segment};

/// So many segments are under way or wait at most.
pub const QUEUE: usize = 8;

/// An order to the servo. Orders that the present state does not allow change nothing; the status
/// shows what holds.
#[derive(Debug, Clone)]
#[allow(
    clippy::large_enum_variant,
    reason = "a segment behind a pointer would be freed, and so call the allocator, in the tick"
)]
pub enum ServoCommand {
    /// Power on, brakes stay on.
    PowerOn,
    /// Open the brakes and hold the arm where it is measured to be.
    ReleaseBrakes,
    /// Protective stop if moving, then brakes on, power stays on.
    EngageBrakes,
    /// Protective stop if moving, then brakes on and power off.
    PowerOff,
    /// Follow a segment, from rest: from the setpoint that is held, or after those that are under way and wait, from where
    /// the last of them ends.
    Move {
        /// Number by which the status reports it.
        id: u64,
        /// The planned segment.
        segment: Segment,
    },
    /// Sets a number of an output. All are 0 again when power goes off.
    SetOutput {
        /// Which, among the numbers of all slots that are no joints, from 0.
        number: usize,
        /// To what.
        value: f64,
    },
    /// Motions ordered after this are watched by these guards, besides those that always watch.
    Name {
        /// By slot: see [`ServoPort::mount`].
        guards: GuardSet,
    },
    /// The same without the rest before it.
    MoveOver {
        /// Number by which the status reports it.
        id: u64,
        /// The planned segment.
        segment: Segment,
        /// The way into it. Where it comes too late for that, the arm rests between both.
        bridge: Bridge,
    },
    /// Protective stop: brake along the path within limits to rest, then hold (category 2). No
    /// segment is taken until [`Self::Resume`].
    Stop,
    /// Brake as a protective stop does, after which the next segment is taken at once.
    Cancel,
    /// Ends a protective stop.
    Resume,
    /// Brake along the path within limits to rest, then drive power off (category 1), latched until [`Self::Reset`]. An
    /// arm with its brakes on has its power off in the next tick.
    ControlledStop,
    /// Drive power off in the next tick (category 0), latched until [`Self::Reset`].
    EmergencyStop,
    /// Other parameters for the control law: the position loop's natural frequency, Hz, and damping ratio.
    Tune {
        /// Hz.
        bandwidth: f64,
        /// Of critical damping.
        damping: f64,
    },
    /// Clears a fault and ends a protective stop. Power stays off.
    Reset,
}

/// Why drive power was taken away.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum Fault {
    /// Somebody asked for it.
    #[error("emergency stop was asked for")]
    EmergencyStop,
    /// Somebody asked for a controlled stop, and the arm was at rest before its power went off.
    #[error("a controlled stop was asked for")]
    ControlledStop,
    /// The channel driver reported an error; [`ServoPort::driver_error`] has its words.
    #[error("the channel driver failed")]
    Driver,
    /// A joint read as a NaN or an infinity.
    #[error("joint {joint} reads as no finite number")]
    Reading {
        /// Joint number, from 1.
        joint: usize,
    },
    /// A sensor read a NaN or an infinity.
    #[error("number {number} of slot `{slot}` is no finite number")]
    Sensor {
        /// The sensor's name.
        slot: Words,
        /// Which of its numbers, from 1.
        number: usize,
    },
    /// A joint was too far from its setpoint.
    #[error(
        "joint {joint} was {error:.4} {unit} from its setpoint, the limit is {limit:.4} {unit}",
        unit = .kind.unit()
    )]
    FollowingError {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Distance, rad or m.
        error: f64,
        /// Limit, rad or m.
        limit: f64,
    },
    /// A joint was away from its setpoint for too long: the arm does not follow.
    #[error(
        "joint {joint} has been more than {window:.4} {unit} from its setpoint for {after:.3} s; is something in the way of the arm?",
        unit = .kind.unit()
    )]
    NotFollowing {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// The distance that is allowed for any length of time, rad or m.
        window: f64,
        /// How long it was exceeded, s.
        after: f64,
    },
    /// The setpoint rests at the end of a motion and the arm does not.
    #[error(
        "the arm did not settle within {after:.3} s: a joint is {error:.5} {unit} from its target, the limit is {limit:.5} {unit}",
        unit = .kind.unit()
    )]
    NotSettled {
        /// Whether that joint turns or slides.
        kind: JointKind,
        /// Largest distance of a joint from its target, rad or m.
        error: f64,
        /// Limit, rad or m.
        limit: f64,
        /// How long it was waited for, s.
        after: f64,
    },
    /// The control law gave a torque that is no finite number.
    #[error("the control law gave a torque that is no finite number")]
    ControlLaw,
    /// The control law said that it cannot go on, and why.
    #[error("the control law gave up: {0}")]
    LawGaveUp(Words),
    /// A segment had no setpoint although it was checked.
    #[error("the segment has no setpoint here although it was checked")]
    Segment,
}

/// Why the servo did not take a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Rejection {
    /// Power is off, the brakes are on or about to be.
    #[error("the brakes are not released")]
    NotReleased,
    /// A protective stop holds.
    #[error("a protective stop holds")]
    Stopped,
    /// Setpoints or torques are streamed to the arm.
    #[error("the arm follows a stream; end that first")]
    Streaming,
    /// A motion is under way.
    #[error("a motion is under way; a stream can begin when the arm has come to rest")]
    Moving,
    /// A slot that is no joint has read nothing new for too long.
    #[error("a slot of the arm is stale; `pino EXEC sensors` names it")]
    StaleSlot,
    /// Torques for a slot that takes none.
    #[error("a slot of the arm is commanded by position or speed, and takes no torque")]
    NoTorque,
    /// A motion is being stopped.
    #[error("the arm follows a stream or is still coming to rest; try again when it rests")]
    Busy,
    /// So many segments wait that there is no room for another one.
    #[error("{QUEUE} motions are under way or wait already; wait for one of them to end")]
    Full,
    /// The segment does not begin where the arm is held, or where the last one before it ends.
    #[error("the segment does not begin where the arm is held, or where the one before it ends")]
    StartsElsewhere,
    /// The segment has no setpoint at its start.
    #[error("the segment has no setpoint at its start")]
    Unfit,
}

/// How far a motion is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum MotionPhase {
    /// No motion since start.
    #[default]
    None,
    /// Following the segment.
    Moving,
    /// Braking along the path.
    Stopping,
    /// The setpoint rests; waiting for the arm to.
    Settling,
    /// Arrived and settled.
    Done,
    /// Stopped before the end, and settled.
    Stopped,
    /// Ended by a fault.
    Failed,
    /// Never begun, and why.
    Rejected(Rejection),
}

impl MotionPhase {
    /// Whether nothing more happens to this motion.
    #[must_use]
    pub fn is_over(self) -> bool {
        !matches!(self, Self::Moving | Self::Stopping | Self::Settling)
    }
}

/// The latest motion.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MotionStatus {
    /// The number it was ordered under; 0 before the first.
    pub id: u64,
    /// How far it is.
    pub phase: MotionPhase,
    /// Ticks since it began.
    pub elapsed_ticks: u64,
    /// Largest distances of joints from their setpoints since it began.
    pub max_tracking_error: Distances,
    /// Largest distances of joints from their setpoints now; once over, the final errors.
    pub error: Distances,
}

/// The motions that ended lately, so that whoever looks now and then misses none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Ended {
    motions: [MotionStatus; 2 * QUEUE],
    next: usize,
}

impl Ended {
    pub(super) fn push(&mut self, motion: MotionStatus) {
        if let Some(oldest) = self.motions.get_mut(self.next) {
            *oldest = motion;
        }
        self.next = (self.next + 1) % self.motions.len();
    }

    /// The largest number of a motion that ended.
    #[must_use]
    pub fn newest(&self) -> u64 {
        let ids = self.motions.iter().map(|motion| motion.id);
        ids.max().unwrap_or_default()
    }

    /// How the motion with this number ended, if it has.
    #[must_use]
    pub fn of(&self, id: u64) -> Option<&MotionStatus> {
        let mut ended = self.motions.iter();
        ended.find(|motion| motion.id == id && motion.phase != MotionPhase::None)
    }
}

/// What the servo shows after each tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ServoStatus {
    /// Ticks since start.
    pub ticks: u64,
    /// Periods skipped since start.
    pub missed: u64,
    /// Physical state.
    pub power: Power,
    /// Latched fault.
    pub fault: Option<Fault>,
    /// A protective stop holds: no segment is taken.
    pub stopped: bool,
    /// Joint positions as read back, rad or m.
    pub position: Joints,
    /// Joint velocities as read back, rad/s or m/s.
    pub velocity: Joints,
    /// Joint setpoints, rad or m.
    pub setpoint: Joints,
    /// Torques written, N m, or forces, N.
    pub torque: Joints,
    /// What the driver's sensors read, one after the other, in the units of their kinds.
    pub sensors: Joints,
    /// Which sensors are stale, the first by the lowest bit.
    pub stale: u32,
    /// Nothing moves and nothing is going to.
    pub at_rest: bool,
    /// The latest motion.
    pub motion: MotionStatus,
    /// What a guard found last.
    pub guard: Option<GuardReport>,
    /// The motions that ended lately.
    pub ended: Ended,
    /// Number of the latest segment that was not taken, and why.
    pub rejected: Option<(u64, Rejection)>,
    /// The latest stream.
    pub stream: StreamStatus,
    /// Number of the latest stream that was not taken, and why.
    pub stream_rejected: Option<(u64, Rejection)>,
}

impl ServoStatus {
    /// What ended motion `id`, if a guard did.
    #[must_use]
    pub fn ended_by_guard(&self, id: u64) -> Option<GuardReport> {
        let ended = |found: &GuardReport| found.motion == id && found.reaction != Reaction::Report;
        self.guard.filter(ended)
    }
}

/// The other side of a [`super::Servo`]: any number of tasks may use it at once. Readers may wait for
/// each other for some nanoseconds; the servo waits for nobody.
pub struct ServoPort {
    commands: Arc<ArrayQueue<ServoCommand>>,
    driver_errors: Arc<ArrayQueue<DriverError>>,
    last_driver_error: Mutex<Option<DriverError>>,
    laws: Arc<Laws>,
    streams: Arc<Streams>,
    status: Mutex<triple_buffer::Output<ServoStatus>>,
    guards: RackPort,
}

/// Things on their way to the servo, and those that it has done with: it frees none.
pub(super) struct Handed<T> {
    next: ArrayQueue<T>,
    done: ArrayQueue<T>,
}

/// Laws.
pub(super) type Laws = Handed<Box<dyn ControlLaw>>;
/// Streams. The servo follows one at most.
pub(super) type Streams = Handed<Box<Stream>>;

impl<T> Handed<T> {
    /// Room for so many each way.
    pub(super) fn new(room: usize) -> Self {
        Self {
            next: ArrayQueue::new(room),
            done: ArrayQueue::new(room),
        }
    }

    /// That which was ordered first, while there is room for it and for the one before it.
    pub(super) fn next(&self) -> Option<T> {
        match self.done.len() + 1 < self.done.capacity() {
            true => self.next.pop(),
            false => None,
        }
    }

    /// Hands one back. There is room: only the servo puts one here, and it looks before.
    pub(super) fn retire(&self, one: T) {
        let _ = self.done.push(one);
    }

    /// Frees what the servo has done with, and orders the next one.
    fn order(&self, one: T) -> Result<(), PortFull> {
        while self.done.pop().is_some() {}
        self.next.push(one).map_err(|_| PortFull)
    }
}

/// The servo's queue of orders is full: it is not running.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the servo does not take orders; is its processor running?")]
pub struct PortFull;

impl ServoPort {
    pub(super) fn new(
        commands: Arc<ArrayQueue<ServoCommand>>,
        driver_errors: Arc<ArrayQueue<DriverError>>,
        (laws, streams): (Arc<Laws>, Arc<Streams>),
        status: triple_buffer::Output<ServoStatus>,
        guards: RackPort,
    ) -> Self {
        Self {
            commands,
            driver_errors,
            last_driver_error: Mutex::new(None),
            laws,
            streams,
            status: Mutex::new(status),
            guards,
        }
    }

    /// Gives an order, obeyed in the next tick.
    ///
    /// # Errors
    /// [`PortFull`] when the servo has taken none for a long time.
    pub fn order(&self, command: ServoCommand) -> Result<(), PortFull> {
        self.commands.push(command).map_err(|_| PortFull)
    }

    /// Puts a guard into a slot from the next tick on, in place of the one that is there, or takes that one out.
    ///
    /// # Errors
    /// [`PortFull`] when the servo has taken none for a long time, or has no such slot.
    pub fn mount(&self, slot: usize, guard: Option<Mounted>) -> Result<(), PortFull> {
        match self.guards.mount(slot, guard) {
            true => Ok(()),
            false => Err(PortFull),
        }
    }

    /// Has the servo go over to another law in the next tick. Its torques begin where those of the law before end.
    ///
    /// # Errors
    /// [`PortFull`] when the servo has taken none for a long time.
    pub fn change_law(&self, law: Box<dyn ControlLaw>) -> Result<(), PortFull> {
        self.laws.order(law)
    }

    /// Has the servo follow a stream from the next tick on. [`ServoStatus::stream`] tells how it fares, or
    /// [`ServoStatus::stream_rejected`] why it was not begun. A stop of any kind ends it.
    ///
    /// # Errors
    /// [`PortFull`] when the servo has taken none for a long time.
    pub fn stream(&self, stream: Box<Stream>) -> Result<(), PortFull> {
        self.streams.order(stream)
    }

    /// Emergency stop, which gets through even when the queue is full of other orders.
    pub fn emergency_stop(&self) {
        self.commands.force_push(ServoCommand::EmergencyStop);
    }

    /// What the latest tick left.
    #[must_use]
    pub fn status(&self) -> ServoStatus {
        // A reader that panicked cannot have left the buffer half-written: only the servo writes.
        let mut reader = self.status.lock().unwrap_or_else(PoisonError::into_inner);
        *reader.read()
    }

    /// What the channel driver said when it last failed.
    #[must_use]
    pub fn driver_error(&self) -> Option<DriverError> {
        let mut last = self
            .last_driver_error
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = self.driver_errors.pop() {
            *last = Some(error);
        }
        last.clone()
    }
}
