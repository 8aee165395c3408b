//! The synchronous function of the two lowest layers: read slots, advance the setpoint, apply the
//! control law, limit, write; once per servo period.
//!
//! [`Servo::tick`] allocates nothing, takes no lock and never waits. Orders come in through a bounded
//! lock-free queue and what happened goes out as a snapshot, both through [`ServoPort`]. Nothing
//! here knows tasks or messages; all time is counted in ticks.

mod blend;
mod motion;
pub mod port;
mod queue;
mod sensing;
mod slots;
pub mod stream;
mod streaming;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use crossbeam_queue::ArrayQueue;

use crate::control::ControlLaw;
use crate::driver::{ChannelDriver, DriverError, Mode, Power, SlotReading};
use crate::guard::rack::{Now, Rack};
use crate::guard::{GuardSet, Neighbour, Reaction, Stopping, Words};
use crate::joints::{Distances, Joints, MAX_SLOTS, TooManyJoints};
use crate::model::{Model, Placement};
use crate::trajectory::{Follower, Setpoint, Solver};
use crate::words;
use blend::Blend;
use motion::Motion;
pub use port::{
    Ended, Fault, MotionPhase, MotionStatus, QUEUE, Rejection, ServoCommand, ServoPort, ServoStatus,
};
use port::{Laws, Streams};
use slots::Slots;
pub use stream::{Following, Newest, Source, Stream, StreamKind, StreamStatus};

/// Orders that may wait in the queue at once.
const COMMANDS: usize = 32;
/// Laws that may.
const LAWS: usize = 4;
/// Streams that may.
const STREAMS: usize = 4;
/// How fast a slot that is commanded by speed goes back to its setpoint: so much per s of what it is off, and slower than any
/// drive's own loop.
const RETURNING: f64 = 10.0;
/// How far (rad or m) a segment may start from the setpoint that is held, or from the end of the one before.
const START_TOLERANCE: f64 = 1e-6;

/// When a motion counts as settled.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settling {
    /// Every joint's error is at most this, rad of one that turns and m of one that slides,
    pub error: f64,
    /// and its speed at most this, rad/s or m/s,
    pub speed: f64,
    /// for this many ticks on end.
    pub ticks: u32,
    /// Ticks after which a motion that has not settled is given up as unsettled.
    pub patience: u32,
}

impl Default for Settling {
    fn default() -> Self {
        Self {
            error: 2e-4,
            speed: 5e-3,
            ticks: 20,
            patience: 667,
        }
    }
}

/// Rates and watchdog limits of one servo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServoConfig {
    /// Servo period; 4.5 ms on the CIRSSE testbed.
    pub period: Duration,
    /// A pose on a line is solved every so many periods (at least 1), and interpolated between.
    pub setpoint_every: u32,
    /// A joint this far from its setpoint is an emergency.
    pub following_error: Distances,
    /// A joint further from its setpoint than this
    pub following_window: Distances,
    /// for this long does not follow: something is in its way, or it is not driven. As the following
    /// error window and time-out of CiA 402 (objects 6065h and 6066h).
    pub following_timeout: Duration,
    /// When a motion counts as settled.
    pub settling: Settling,
    /// What a slot that is no joint has read, and that is older than this, is stale.
    pub stale_after: Duration,
    /// Whether stops and streams keep the limits of jerk that the model's joints have. Planned motions bring their own.
    pub limit_jerk: bool,
}

impl Default for ServoConfig {
    fn default() -> Self {
        Self {
            period: Duration::from_micros(4500),
            setpoint_every: 4,
            following_error: Distances {
                turning: 0.1,
                sliding: 0.05,
            },
            following_window: Distances {
                turning: 0.03,
                sliding: 0.015,
            },
            following_timeout: Duration::from_millis(100),
            settling: Settling::default(),
            stale_after: Duration::from_millis(100),
            limit_jerk: false,
        }
    }
}

/// Why a servo cannot be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ServoError {
    /// The driver's slots do not fit the arm.
    #[error(
        "the channel driver has {found} slots, the arm has {needed} joints; choose another driver or model"
    )]
    Slots {
        /// Slots of the driver.
        found: usize,
        /// Joints of the arm.
        needed: usize,
    },
    /// The arm has more joints than a manipulator may have.
    #[error(transparent)]
    Joints(#[from] TooManyJoints),
    /// The sensors read more numbers than a status has room for.
    #[error(
        "the channel driver's sensors read {found} numbers, and there is room for {MAX_SLOTS}; name fewer of them"
    )]
    Sensors {
        /// How many.
        found: usize,
    },
    /// A number of the configuration that cannot be.
    #[error("servo `{what}` is {value}; it must be above zero")]
    NotPositive {
        /// Name of the number.
        what: &'static str,
        /// What was given.
        value: f64,
    },
}

/// Largest distance of any joint between two positions, rad or m; of different arms infinite.
fn distance(a: &Joints, b: &Joints) -> f64 {
    if a.len() != b.len() {
        return f64::INFINITY;
    }
    let pairs = a.iter().zip(b);
    pairs.fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

/// Whoever drops the servo leaves an arm without a controller: its power goes off first.
impl Drop for Servo {
    fn drop(&mut self) {
        let (still, period) = (self.still(), self.config.period);
        // Nobody is left to be told of a failure.
        let _ = self.driver.write(&still, Power::Off, period);
    }
}

/// What becomes of the power once the arm is at rest.
#[derive(Debug, Clone, Copy)]
enum AfterRest {
    Take(Power),
    /// It goes off and stays off until a reset.
    Latch(Fault),
}

/// The synchronous part of MCS for one manipulator.
pub struct Servo {
    solver: Solver,
    driver: Box<dyn ChannelDriver>,
    law: Box<dyn ControlLaw>,
    laws: Arc<Laws>,
    streams: Arc<Streams>,
    /// That which is followed in place of segments.
    stream: Option<Box<Stream>>,
    /// The torques of the last tick were a stream's.
    direct: bool,
    blend: Blend,
    config: ServoConfig,
    commands: Arc<ArrayQueue<ServoCommand>>,
    driver_errors: Arc<ArrayQueue<DriverError>>,
    output: triple_buffer::Input<ServoStatus>,
    status: ServoStatus,
    readings: Vec<SlotReading>,
    setpoint: Setpoint,
    motion: Option<Motion>,
    guards: Rack,
    /// Where other servos of the chassis see this arm.
    shown: Option<Neighbour>,
    /// How the arm would come to rest.
    stopping: Stopping,
    /// The slots that are no joints.
    slots: Slots,
    /// The segments under way and waiting, and their numbers and guards.
    follower: Follower,
    ids: VecDeque<(u64, GuardSet)>,
    /// What becomes of the power once the arm is at rest.
    after_rest: Option<AfterRest>,
    /// Brakes were ordered open: seed setpoint and law from the next reading.
    releasing: bool,
    /// Ticks for which each joint has been outside its following window.
    astray: Vec<u32>,
    /// Ticks that a joint may be.
    patience: u32,
}

impl Servo {
    /// A servo in power state off, and the port through which others reach it.
    ///
    /// # Errors
    /// [`ServoError`] when the driver does not fit the arm or a number is not positive.
    pub fn new(
        model: Arc<Model>,
        driver: Box<dyn ChannelDriver>,
        law: Box<dyn ControlLaw>,
        config: ServoConfig,
    ) -> Result<(Self, ServoPort), ServoError> {
        let (found, needed) = (driver.slots(), model.dof());
        if found != needed {
            return Err(ServoError::Slots { found, needed });
        }
        let slots = Slots::new(driver.sensors()).map_err(|found| ServoError::Sensors { found })?;
        let solver = Solver::new(Arc::clone(&model))?;
        let guards = Rack::new(model);
        let positive = [
            ("period", config.period.as_secs_f64()),
            ("setpoint_every", f64::from(config.setpoint_every)),
            (
                "following_error of joints that turn",
                config.following_error.turning,
            ),
            (
                "following_error of joints that slide",
                config.following_error.sliding,
            ),
            (
                "following_window of joints that turn",
                config.following_window.turning,
            ),
            (
                "following_window of joints that slide",
                config.following_window.sliding,
            ),
            ("settling.error", config.settling.error),
            ("settling.speed", config.settling.speed),
        ];
        for (what, value) in positive {
            if value.is_nan() || value <= 0.0 {
                return Err(ServoError::NotPositive { what, value });
            }
        }
        let commands = Arc::new(ArrayQueue::new(COMMANDS));
        let driver_errors = Arc::new(ArrayQueue::new(1));
        let still = Joints::zeros(needed);
        let status = ServoStatus {
            position: still,
            velocity: still,
            setpoint: still,
            torque: still,
            sensors: Joints::zeros(slots.width()),
            ..ServoStatus::default()
        };
        let (output, reader) = triple_buffer::triple_buffer(&status);
        let laws = Arc::new(Laws::new(LAWS));
        let streams = Arc::new(Streams::new(STREAMS));
        let port = ServoPort::new(
            Arc::clone(&commands),
            Arc::clone(&driver_errors),
            (Arc::clone(&laws), Arc::clone(&streams)),
            reader,
            guards.port(),
        );
        let servo = Self {
            solver,
            driver,
            law,
            laws,
            streams,
            stream: None,
            direct: false,
            blend: Blend::default(),
            config,
            commands,
            driver_errors,
            output,
            status,
            readings: vec![SlotReading::default(); needed],
            setpoint: Setpoint::at_rest(still),
            motion: None,
            guards,
            shown: None,
            stopping: Stopping::default(),
            slots,
            follower: Follower::new(QUEUE, config.period.as_secs_f64(), config.setpoint_every)
                .limiting_jerk(config.limit_jerk),
            ids: VecDeque::with_capacity(QUEUE),
            after_rest: None,
            releasing: false,
            astray: vec![0; needed],
            // A count of ticks beyond that of 32 bits would be a year.
            patience: (config.following_timeout.as_secs_f64() / config.period.as_secs_f64()) as u32,
        };
        Ok((servo, port))
    }

    /// From now on shows this arm, in every tick, to the guards of others.
    pub fn show_on(&mut self, board: Neighbour) {
        self.shown = Some(board);
    }

    /// From now on finds joint positions in this way, for the same arm.
    pub fn solve_by(&mut self, solver: Solver) {
        self.solver = solver;
    }

    /// What the last tick left.
    #[must_use]
    pub fn status(&self) -> &ServoStatus {
        &self.status
    }

    /// One servo period. `missed` is the number of whole periods that were skipped before this one:
    /// they are counted, and setpoints go on from where they were instead of leaping after the clock.
    pub fn tick(&mut self, missed: u64) {
        self.status.ticks += 1;
        self.status.missed += missed;
        self.guards.take_in();
        // First, so that whatever is ordered after a stream, a stop above all, is about it.
        self.take_streams();
        while let Some(command) = self.commands.pop() {
            self.obey(command);
        }
        self.read();
        self.seed();
        self.advance();
        self.guard();
        self.watch();
        let torques = self.control();
        self.actuate();
        self.write(&torques);
        self.publish(&torques);
    }

    fn obey(&mut self, command: ServoCommand) {
        let power = self.status.power;
        let faulted = self.status.fault.is_some();
        match command {
            ServoCommand::PowerOn if power == Power::Off && !faulted => {
                self.status.power = Power::Braked;
            }
            ServoCommand::ReleaseBrakes if power == Power::Braked && !faulted => {
                self.releasing = true;
            }
            ServoCommand::EngageBrakes if power == Power::Released => {
                self.rest_then(AfterRest::Take(Power::Braked));
            }
            ServoCommand::PowerOff if power == Power::Released => {
                self.rest_then(AfterRest::Take(Power::Off));
            }
            ServoCommand::PowerOff => {
                self.releasing = false;
                self.status.power = Power::Off;
            }
            ServoCommand::Move { id, segment } => self.begin(id, segment, None),
            ServoCommand::MoveOver {
                id,
                segment,
                bridge,
            } => self.begin(id, segment, Some(bridge)),
            ServoCommand::SetOutput { number, value } => self.set_output(number, value),
            ServoCommand::Name { guards } => self.guards.name(guards),
            ServoCommand::Stop => {
                self.status.stopped = true;
                self.brake(words!(
                    "a protective stop, which holds until somebody resumes"
                ));
            }
            ServoCommand::Cancel => self.brake(words!("somebody ended it")),
            ServoCommand::Resume => self.status.stopped = false,
            ServoCommand::ControlledStop if power == Power::Released => {
                self.rest_then(AfterRest::Latch(Fault::ControlledStop));
            }
            ServoCommand::ControlledStop => self.fail(Fault::ControlledStop),
            ServoCommand::EmergencyStop => self.fail(Fault::EmergencyStop),
            // While it follows a segment a leap of the torques would show in the path.
            ServoCommand::Tune { bandwidth, damping } if self.motion.is_none() => {
                self.law.tune(bandwidth, damping);
            }
            ServoCommand::Reset => {
                self.status.fault = None;
                self.status.stopped = false;
            }
            // Power already as ordered, or an order that this state does not allow: the status
            // shows the state that holds, and the state manager is who decides.
            ServoCommand::PowerOn
            | ServoCommand::ReleaseBrakes
            | ServoCommand::EngageBrakes
            | ServoCommand::Tune { .. } => {}
        }
    }

    /// Zeros for all joints.
    fn still(&self) -> Joints {
        Joints::zeros(self.readings.len())
    }

    /// Brakes along the path, or from a stream, and why; standing still already, there is nothing to do.
    fn brake(&mut self, why: Words) {
        match &mut self.stream {
            Some(stream) => stream.end(why),
            None if self.motion.is_some() => self.follower.stop(),
            None => {}
        }
    }

    /// Brakes along the path; what comes after it may not take back that the power will be latched off.
    fn rest_then(&mut self, then: AfterRest) {
        self.brake(words!(
            "the arm was to come to rest and its power to be switched"
        ));
        if !matches!(self.after_rest, Some(AfterRest::Latch(_))) {
            self.after_rest = Some(then);
        }
    }

    fn read(&mut self) {
        if let Err(error) = self.driver.read(&mut self.readings) {
            self.driver_failed(error);
            return;
        }
        for (index, reading) in self.readings.iter().enumerate() {
            if !reading.position.is_finite() || !reading.velocity.is_finite() {
                self.fail(Fault::Reading { joint: index + 1 });
                return;
            }
        }
        for (index, reading) in self.readings.iter().enumerate() {
            self.status.position[index] = reading.position;
            self.status.velocity[index] = reading.velocity;
        }
        self.sense();
    }

    /// Takes over the arm where it is: after any time with the brakes on, setpoint and law start
    /// from what is measured, never from what was once commanded.
    fn seed(&mut self) {
        if self.status.power != Power::Released {
            self.setpoint = Setpoint::at_rest(self.status.position);
        }
        if self.releasing && self.status.fault.is_none() {
            self.law.reset(&self.readings);
            self.status.power = Power::Released;
        }
        self.releasing = false;
    }

    fn advance(&mut self) {
        self.advance_motion();
        if self.motion.is_some() {
            return;
        }
        match self.after_rest.take() {
            Some(AfterRest::Take(power)) => self.status.power = power,
            Some(AfterRest::Latch(fault)) => self.fail(fault),
            None => {}
        }
    }

    fn advance_motion(&mut self) {
        let Some(motion) = self.motion.take() else {
            return;
        };
        match self.stream.take() {
            Some(stream) => self.advance_stream(motion, stream),
            None => self.advance_queue(motion),
        }
    }

    /// An arm whose motion has not settled in time.
    fn not_settled(&self, motion: &Motion) -> Fault {
        let settling = &self.config.settling;
        let (kind, error) = motion.error().largest();
        Fault::NotSettled {
            kind,
            error,
            limit: settling.error,
            after: f64::from(settling.patience) * self.config.period.as_secs_f64(),
        }
    }

    /// Whether the setpoint of the motion under way rests, and whether it is not to go on.
    fn ends(&self) -> (bool, bool) {
        match &self.stream {
            Some(stream) => (stream.rests(), stream.is_ending()),
            None => (self.follower.rests(), self.follower.is_stopping()),
        }
    }

    /// Asks the guards of the motion under way. One that is braking needs none; while one settles, only what presses on the arm
    /// counts.
    fn guard(&mut self) {
        let period = self.config.period.as_secs_f64();
        let mut tool_at_rest = None;
        self.stopping = Stopping::standing(&self.setpoint.position);
        let (rests, stopping) = self.ends();
        if self.status.stale != 0 && self.motion.is_some() && !stopping {
            self.watch_slots();
        }
        if self.motion.is_some() && !rests {
            let rest = match &self.stream {
                Some(stream) => stream.rest(self.solver.model(), period),
                None => self.follower.rest(&self.solver),
            };
            self.stopping = Motion::stopping(&rest, &self.setpoint, period);
            tool_at_rest = rest.tool.map(|tool| Placement::from(&tool));
        }
        let (settles, stopping) = self.ends();
        if self.motion.is_none() || stopping {
            return;
        }
        let now = Now {
            motion: self.status.motion.id,
            setpoint: &self.setpoint,
            readings: &self.readings,
            stopping: &self.stopping,
            tool_at_rest,
            force: self.force(),
            period,
        };
        let found = self.guards.check(&now, settles);
        let Some((found, feels)) = found else { return };
        self.status.guard = Some(found);
        if found.reaction == Reaction::Report {
            return;
        }
        let why = words!("guard `{}`: {}", found.guard, found.measured);
        if !feels {
            return self.brake(why);
        }
        let arm = Setpoint {
            velocity: self.status.velocity,
            ..Setpoint::at_rest(self.status.position)
        };
        let yields = match &mut self.stream {
            Some(stream) => stream.yield_to(&arm, why, self.solver.model(), period),
            None => self.follower.yield_to(&arm, &self.solver),
        };
        self.setpoint = yields.unwrap_or(self.setpoint);
    }

    fn watch(&mut self) {
        if self.status.power != Power::Released {
            self.astray.fill(0);
            return;
        }
        for (index, joint) in self.solver.model().joints().iter().enumerate() {
            let kind = joint.kind;
            let error = (self.setpoint.position[index] - self.status.position[index]).abs();
            let window = self.config.following_window.of(kind);
            let limit = self.config.following_error.of(kind);
            let astray = match error > window {
                true => self.astray[index].saturating_add(1),
                false => 0,
            };
            self.astray[index] = astray;
            let joint = index + 1;
            // Where nothing was read since the joint left its window, that is why it does not follow.
            let since = self.config.period.saturating_mul(astray);
            if (error > limit || astray > self.patience)
                && let Some((silent, error)) = self.driver.silence(index)
                && silent >= since
            {
                return self.driver_failed(error);
            }
            let fault = if error > limit {
                Fault::FollowingError {
                    joint,
                    kind,
                    error,
                    limit,
                }
            } else if astray > self.patience {
                Fault::NotFollowing {
                    joint,
                    kind,
                    window,
                    after: f64::from(astray) * self.config.period.as_secs_f64(),
                }
            } else {
                continue;
            };
            return self.fail(fault);
        }
    }

    fn control(&mut self) -> Joints {
        let mut torques = self.still();
        let next = self.laws.next();
        if self.status.power != Power::Released {
            self.blend = Blend::default();
            self.direct = false;
            if let Some(law) = next {
                self.laws.retire(std::mem::replace(&mut self.law, law));
            }
            return torques;
        }
        let direct = self.direct_torques();
        self.law.sense(&self.status.sensors);
        match direct {
            Some(direct) => torques = direct,
            None => self.law.torques(
                &self.setpoint,
                &self.readings,
                self.config.period,
                &mut torques,
            ),
        }
        if let Some(why) = self.law.gave_up() {
            self.fail(Fault::LawGaveUp(why));
            return self.still();
        }
        match next {
            // It takes over from what is measured when the stream ends.
            Some(law) if direct.is_some() => {
                self.laws.retire(std::mem::replace(&mut self.law, law));
            }
            Some(law) => torques = self.change_law(law, torques),
            None => {}
        }
        self.blend.add_to(&mut torques);
        if torques.iter().any(|torque| !torque.is_finite()) {
            self.fail(Fault::ControlLaw);
            return self.still();
        }
        for (torque, joint) in torques.iter_mut().zip(self.solver.model().joints()) {
            *torque = torque.clamp(-joint.limits.torque, joint.limits.torque);
        }
        for (torque, mode) in torques.iter_mut().zip(self.driver.modes()) {
            // What a drive gives by itself is not known.
            if *mode != Mode::Torque {
                *torque = 0.0;
            }
        }
        torques
    }

    /// Goes over to another law, whose torques begin where those of the law before ended.
    fn change_law(&mut self, mut law: Box<dyn ControlLaw>, mut before: Joints) -> Joints {
        let (readings, period) = (&self.readings, self.config.period);
        law.reset(readings);
        law.sense(&self.status.sensors);
        let mut torques = Joints::zeros(before.len());
        law.torques(&self.setpoint, readings, period, &mut torques);
        self.laws.retire(std::mem::replace(&mut self.law, law));
        // Of a law before that one, too.
        self.blend.add_to(&mut before);
        self.blend = Blend::between(&before, &torques, period);
        torques
    }

    fn write(&mut self, torques: &Joints) {
        let power = self.status.power;
        let commands = self.commands(torques);
        if let Err(error) = self.driver.write(&commands, power, self.config.period) {
            self.driver_failed(error);
        }
    }

    /// What each slot is to do until the next tick, by its mode.
    fn commands(&self, torques: &Joints) -> Joints {
        let (moves, period) = (
            self.status.power == Power::Released,
            self.config.period.as_secs_f64(),
        );
        let modes = self.driver.modes();
        Joints::from_fn(torques.len(), |slot| {
            let (speed, rate) = (
                self.setpoint.velocity[slot],
                self.setpoint.acceleration[slot],
            );
            match modes.get(slot).copied().unwrap_or_default() {
                Mode::Torque => torques[slot],
                Mode::Velocity if moves => {
                    let off = self.setpoint.position[slot] - self.status.position[slot];
                    speed + rate * period + RETURNING * off
                }
                Mode::Velocity => 0.0,
                Mode::Position if moves => {
                    self.setpoint.position[slot] + (speed + 0.5 * rate * period) * period
                }
                Mode::Position => self.status.position[slot],
            }
        })
    }

    fn driver_failed(&mut self, error: DriverError) {
        if self.status.fault.is_none() {
            // It tells why, and no error that a fault before this one has left.
            self.driver_errors.force_push(error);
        } else {
            // Of those that follow, the first since the last look is kept.
            let _ = self.driver_errors.push(error);
        }
        self.fail(Fault::Driver);
    }

    /// Stop of category 0: drive torque is off from this tick on, and stays off until a reset.
    fn fail(&mut self, fault: Fault) {
        if self.status.fault.is_none() {
            self.status.fault = Some(fault);
        }
        self.status.power = Power::Off;
        self.releasing = false;
        self.after_rest = None;
        let moved = self.motion.take().is_some();
        if self.stream.is_some() {
            self.fail_stream(fault);
        } else if moved {
            self.ended(MotionPhase::Failed);
            self.drop_queue(MotionPhase::Failed);
        }
    }

    fn publish(&mut self, torques: &Joints) {
        self.status.setpoint = self.setpoint.position;
        self.status.torque = *torques;
        self.status.at_rest = self.motion.is_none()
            && self.after_rest.is_none()
            && self
                .status
                .velocity
                .iter()
                .all(|speed| speed.abs() <= self.config.settling.speed);
        self.output.write(self.status);
        if let Some(board) = &self.shown {
            board.show(
                &self.setpoint,
                &self.stopping,
                self.config.period.as_secs_f64(),
            );
        }
    }
}
