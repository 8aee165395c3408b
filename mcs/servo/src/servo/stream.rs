//! Setpoints and torques that somebody streams: the newest value is followed in every tick, until it is too old or cannot
//! be followed, and then the arm comes to rest.
//!
//! Between two values a joint goes along a line, or with speeds along a cubic, in the time that lay between them in whole
//! servo periods. A joint goes after that point within its limits (`trajectory::chase`, or `trajectory::pursuit` where jerk is
//! limited), so that a jump of the stream is none of the arm. Allocates nothing in a tick.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use crate::guard::{GuardSet, Words};
use crate::joints::Joints;
use crate::model::inverse::Branch;
use crate::model::{Data, Joint, Limits, Model};
use crate::trajectory::chase::{brake, chase};
use crate::trajectory::timing::{JointBounds, JointState};
use crate::trajectory::{
    Course, Pursuit, REST_PARTS, Rest, Setpoint, Solver, WayToRest, way_to_rest,
};
use crate::words;

/// How far the rotation of a pose may be from a rotation, per entry.
const ROTATION_ROUNDING: f64 = 1e-6;
/// How much longer than it seems the way until rest is taken to be under direct torques, and by how many periods of travel:
/// the law that takes over lags behind its setpoint.
const CAUTION: f64 = 1.25;
const LATE: f64 = 2.0;
/// The way to a value takes no longer than this, however seldom values come, s.
const LONGEST_WAY: f64 = 0.25;
/// A joint that is nearer than this (rad or m) to where it goes back to, and no faster (per s), is there; and how long that takes
/// at most, about, s.
const REACHED: f64 = 1e-7;
const GOING_BACK: f64 = 0.1;

/// What is streamed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum StreamKind {
    /// Of n joints, n positions (rad or m), or as many and then n speeds (per s).
    Joints,
    /// `base_T_tool`, 16 numbers row by row, m; or 6 numbers by which the tool is away from where it was when the stream
    /// began: along the base's axes, m, and roll, pitch and yaw about them, rad.
    Tool,
    /// Of n joints, n torques, N m or N.
    Torques {
        /// Whether those that carry the arm's weight are added.
        gravity: bool,
    },
}

/// The newest value of a stream.
#[derive(Debug, Clone, Copy)]
pub struct Newest<'a> {
    /// Which one it is; another one has another number.
    pub count: u64,
    /// When it was written, s since some moment.
    pub stamp: f64,
    /// How long ago that was, s.
    pub age: f64,
    /// The value.
    pub numbers: &'a [f64],
}

/// Where values come from. Asked once per tick; must neither allocate, lock nor wait.
pub trait Source: Send {
    /// The newest value; `None` before the first.
    fn newest(&mut self) -> Option<Newest<'_>>;
}

/// How a stream is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Following {
    /// The number by which the status tells of it.
    pub serial: u64,
    /// What is streamed.
    pub kind: StreamKind,
    /// A value older than this ends it, s.
    pub max_age: f64,
    /// Fractions of the largest speeds and accelerations.
    pub pace: (f64, f64),
    /// Guards that watch it, besides those that always do.
    pub guards: GuardSet,
}

/// How the latest stream is, or how it ended.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct StreamStatus {
    /// Its number; 0 before the first.
    pub serial: u64,
    /// How many values were taken.
    pub values: u64,
    /// Age of the newest value at the last tick, s.
    pub age: f64,
    /// Why it is followed no more.
    pub end: Option<Words>,
}

/// The way of one joint to the value that came last.
#[derive(Debug, Clone, Copy, Default)]
struct Way {
    from: f64,
    leaving: f64,
    to: f64,
    /// The speed there, where the stream tells it.
    arriving: Option<f64>,
}

impl Way {
    fn standing(at: f64) -> Self {
        Self {
            from: at,
            to: at,
            ..Self::default()
        }
    }

    /// Position and speed at a `share` of the whole time, s; it stays at the end.
    fn at(&self, share: f64, whole: f64) -> (f64, f64) {
        let over = self.to - self.from;
        let Some(arriving) = self.arriving else {
            return match share < 1.0 {
                true => (self.from + over * share, over / whole),
                false => (self.to, 0.0),
            };
        };
        if share >= 1.0 {
            return (self.to, 0.0);
        }
        // The cubic of Hermite.
        let (leaving, arriving) = (self.leaving * whole, arriving * whole);
        let square = 3.0 * over - 2.0 * leaving - arriving;
        let cube = leaving + arriving - 2.0 * over;
        let position = self.from + share * (leaving + share * (square + share * cube));
        let slope = leaving + share * (2.0 * square + share * 3.0 * cube);
        (position, slope / whole)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Following,
    Braking,
    /// Every joint goes back to the end of its way.
    Yielding,
    /// The setpoint rests.
    Resting,
}

/// A stream that is followed.
pub struct Stream {
    how: Following,
    source: Box<dyn Source>,
    data: Data,
    phase: Phase,
    status: StreamStatus,
    /// Which value was taken last, and its stamp, s.
    last: Option<(u64, f64)>,
    waited: f64,
    ways: Vec<Way>,
    /// Periods since the last value was taken, and how many its way takes.
    passed: u32,
    periods: u32,
    /// Where the joints are to be in the next tick, how fast, and with which accelerations.
    next: Setpoint,
    /// Whether the limits of jerk count, and what finds ways under them.
    limits_jerk: bool,
    pursuit: Pursuit,
    /// Where the tool was when it began, and in which posture.
    origin: Isometry3<f64>,
    posture: Option<Branch>,
    /// Torques that came last.
    torques: Option<Joints>,
}

impl Stream {
    /// A stream for an arm, which begins when the servo takes it.
    #[must_use]
    pub fn new(how: Following, source: Box<dyn Source>, model: &Model) -> Self {
        Self {
            how,
            source,
            data: model.data(),
            phase: Phase::Following,
            status: StreamStatus {
                serial: how.serial,
                ..StreamStatus::default()
            },
            last: None,
            waited: 0.0,
            ways: vec![Way::default(); model.dof()],
            passed: 0,
            periods: 1,
            next: Setpoint::default(),
            limits_jerk: false,
            pursuit: Pursuit::default(),
            origin: Isometry3::identity(),
            posture: None,
            torques: None,
        }
    }

    /// How it is to be followed.
    pub(super) fn how(&self) -> &Following {
        &self.how
    }

    /// How it is.
    pub(super) fn status(&self) -> StreamStatus {
        self.status
    }

    /// Begins where the arm is held; whether the limits of jerk count.
    pub(super) fn begin(&mut self, held: &Joints, solver: &mut Solver, limits_jerk: bool) {
        self.next = Setpoint::at_rest(*held);
        self.limits_jerk = limits_jerk;
        for (way, held) in self.ways.iter_mut().zip(held) {
            *way = Way::standing(*held);
        }
        self.origin = solver.pose(held);
        self.posture = solver.branch_of(held);
    }

    /// Follows it no more: every joint brakes as hard as it may. The first reason counts.
    pub(super) fn end(&mut self, why: Words) {
        if self.phase == Phase::Following {
            self.phase = Phase::Braking;
            self.status.end = Some(why);
        }
    }

    /// Follows it no more: takes over the arm from where it was measured and how fast, and brings it back to that position (rad
    /// or m) as quickly as their limits of speed and acceleration allow. The setpoint of this tick, unless it ends already.
    pub(super) fn yield_to(
        &mut self,
        arm: &Setpoint,
        why: Words,
        model: &Model,
        period: f64,
    ) -> Option<Setpoint> {
        if self.phase != Phase::Following {
            return None;
        }
        self.end(why);
        self.phase = Phase::Yielding;
        let each = self.ways.iter_mut().zip(&arm.position).zip(model.joints());
        for ((way, to), joint) in each {
            *way = Way::standing(to.clamp(joint.limits.lower, joint.limits.upper));
        }
        self.next = *arm;
        Some(self.one_tick(model, period))
    }

    /// Whether it is followed no more.
    pub(super) fn is_ending(&self) -> bool {
        self.phase != Phase::Following
    }

    /// Whether the setpoint rests.
    pub(super) fn rests(&self) -> bool {
        self.phase == Phase::Resting
    }

    /// Whether the torques are the stream's and not those of a law: the arm is where it happens to be.
    fn is_direct(&self) -> bool {
        self.phase == Phase::Following && self.torques.is_some()
    }

    /// The setpoint of this tick, the arm being measured at these positions and speeds.
    pub(super) fn setpoint(
        &mut self,
        solver: &mut Solver,
        (position, velocity): (&Joints, &Joints),
        period: f64,
    ) -> Setpoint {
        if self.is_direct() {
            self.next = Setpoint {
                velocity: *velocity,
                ..Setpoint::at_rest(*position)
            };
        }
        if self.phase == Phase::Following
            && let Err(why) = self.take(solver, period)
        {
            self.end(why);
        }
        if self.is_direct() {
            match strayed(&self.next, solver.model(), self.limits_jerk, period) {
                Some(why) => self.end(why),
                None => return self.next,
            }
        }
        self.one_tick(solver.model(), period)
    }

    /// The setpoint of this tick; the next one is found.
    fn one_tick(&mut self, model: &Model, period: f64) -> Setpoint {
        let mut now = self.next;
        let whole = f64::from(self.periods) * period;
        let share = f64::from(self.passed) / f64::from(self.periods);
        self.passed = self.passed.saturating_add(1);
        for (index, joint) in model.joints().iter().enumerate() {
            let aim = match (self.phase, self.ways.get(index)) {
                (Phase::Following, Some(way)) => Some(way.at(share, whole)),
                (Phase::Yielding, Some(way)) => Some((way.to, 0.0)),
                _ => None,
            };
            let at = state(&now, index);
            let then = self.one_period(&at, aim, &joint.limits, period);
            now.acceleration[index] = (then.velocity - at.velocity) / period;
            self.next.position[index] = then.position;
            self.next.velocity[index] = then.velocity;
            self.next.acceleration[index] = then.acceleration;
        }
        let stands = |number: &f64| *number == 0.0;
        let still = now.velocity.iter().chain(&now.acceleration).all(stands);
        if self.phase == Phase::Braking && still {
            self.phase = Phase::Resting;
        }
        if self.phase == Phase::Yielding && self.is_back(&now) {
            self.phase = Phase::Resting;
            now = Setpoint::at_rest(now.position);
            self.next = now;
        }
        now
    }

    /// Whether every joint is where it was to go back to.
    fn is_back(&self, now: &Setpoint) -> bool {
        let mut ways = self.ways.iter().enumerate();
        ways.all(|(joint, way)| {
            (now.position[joint] - way.to).abs() < REACHED && now.velocity[joint].abs() < REACHED
        })
    }

    /// Where a joint is a period later: on its way after an aim, a position and a speed, or braking.
    fn one_period(
        &mut self,
        now: &JointState,
        aim: Option<(f64, f64)>,
        limits: &Limits,
        period: f64,
    ) -> JointState {
        let pace = match self.phase {
            Phase::Yielding => (1.0, 1.0),
            _ => self.how.pace,
        };
        let aim = aim.map(|(position, speed)| {
            let held = position.clamp(limits.lower, limits.upper);
            (held, speed)
        });
        // What keeps a limit of jerk presses on meanwhile.
        let limits_jerk = self.limits_jerk && self.phase != Phase::Yielding;
        let bounds = JointBounds::of(limits, (1.0, 1.0), limits_jerk);
        if bounds.jerk > 0.0 {
            return match aim {
                Some(aim) => self.pursuit.next(now, aim, limits, pace, period),
                None => Course::to_rest(now, &bounds, 0.0).at(period),
            };
        }
        let (position, speed) = (now.position, now.velocity);
        let then = match aim {
            Some(aim) => chase((position, speed), aim, limits, pace, period),
            None => brake(speed, limits, period),
        };
        JointState {
            position: position + 0.5 * (speed + then) * period,
            velocity: then,
            acceleration: 0.0,
        }
    }

    /// Takes the newest value in, if it is another one.
    fn take(&mut self, solver: &mut Solver, period: f64) -> Result<(), Words> {
        let Some(newest) = self.source.newest() else {
            self.waited += period;
            let limit = self.how.max_age;
            return match self.waited > limit {
                true => Err(words!("no value has come within {limit:.3} s")),
                false => Ok(()),
            };
        };
        let (age, limit) = (newest.age, self.how.max_age);
        self.status.age = age;
        if age.is_nan() || age > limit {
            return Err(words!(
                "the newest value is {age:.3} s old, and the limit is {limit:.3} s"
            ));
        }
        if self.last.is_some_and(|(count, _)| count == newest.count) {
            return Ok(());
        }
        let numbers = newest.numbers;
        if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
            let (number, value) = (index + 1, numbers[index]);
            return Err(words!("number {number} of a value is {value}"));
        }
        let model = solver.model();
        let (n, given) = (model.dof(), numbers.len());
        let (mut positions, mut speeds) = (Joints::zeros(n), None);
        match self.how.kind {
            StreamKind::Joints if given == n || given == 2 * n => {
                positions.copy_from_slice(&numbers[..n]);
                if given > n {
                    let mut those = Joints::zeros(n);
                    those.copy_from_slice(&numbers[n..]);
                    speeds = Some(those);
                }
            }
            StreamKind::Torques { .. } if given == n => {
                let mut torques = Joints::zeros(n);
                torques.copy_from_slice(numbers);
                within(&torques, model, "torque", |joint| joint.limits.torque)?;
                self.torques = Some(torques);
            }
            StreamKind::Tool if given == 6 || given == 16 => {
                let pose = pose(numbers, &self.origin)?;
                let near = Joints::from_fn(n, |index| self.ways[index].to);
                let found = solver.follow(&pose, self.posture, &near);
                positions = found.map_err(|error| words!("{error}"))?;
            }
            kind => {
                let wanted = match kind {
                    StreamKind::Joints => words!("{n} or {}", 2 * n),
                    StreamKind::Torques { .. } => words!("{n}"),
                    StreamKind::Tool => words!("6 or 16"),
                };
                return Err(words!("a value has {given} numbers and not {wanted}"));
            }
        }
        let before = self.last.replace((newest.count, newest.stamp));
        self.status.values += 1;
        if self.torques.is_some() {
            return Ok(());
        }
        let model = solver.model();
        if let Some(index) = model.joint_outside(&positions) {
            let (joint, at) = (&model.joints()[index], positions[index]);
            let (unit, limits) = (joint.kind.unit(), &joint.limits);
            let (low, high, joint) = (limits.lower, limits.upper, index + 1);
            return Err(words!(
                "joint {joint} would have to be at {at:.4} {unit}, its limits are {low:.4} and {high:.4}"
            ));
        }
        if let Some(speeds) = &speeds {
            within(speeds, model, "speed", |joint| joint.limits.velocity)?;
        }
        let apart = before.map_or(0.0, |(_, stamp)| newest.stamp - stamp);
        self.go(&positions, speeds.as_ref(), apart, period);
        Ok(())
    }

    /// Sets out for a value that was written so many seconds after the one before.
    fn go(&mut self, to: &Joints, speeds: Option<&Joints>, apart: f64, period: f64) {
        let whole = f64::from(self.periods) * period;
        let share = f64::from(self.passed) / f64::from(self.periods);
        for (index, way) in self.ways.iter_mut().enumerate() {
            let (from, leaving) = way.at(share, whole);
            *way = Way {
                from,
                leaving,
                to: to[index],
                arriving: speeds.map(|speeds| speeds[index]),
            };
        }
        // A hair less, lest rounding make one period more of a whole number of them.
        let periods = apart.clamp(period, LONGEST_WAY.max(period)) / period - 1e-6;
        self.periods = periods.ceil() as u32;
        self.passed = 0;
    }

    /// The torques of this tick, where they are the stream's.
    pub(super) fn torques(&mut self, model: &Model, position: &Joints) -> Option<Joints> {
        if !self.is_direct() {
            return None;
        }
        let mut torques = self.torques?;
        if self.how.kind == (StreamKind::Torques { gravity: true }) {
            let weight = model.gravity_torques(&mut self.data, position);
            for (torque, weight) in torques.iter_mut().zip(weight) {
                *torque += weight;
            }
        }
        Some(torques)
    }

    /// How it would come to rest if it braked from the next period on.
    pub(super) fn rest(&self, model: &Model, period: f64) -> Rest {
        let joints = model.joints();
        if self.phase == Phase::Yielding {
            let from = &self.next.position;
            let to = |index: usize| self.ways.get(index).map_or(from[index], |way| way.to);
            let way = way_to_rest(1.0, |share| {
                Joints::from_fn(from.len(), |index| {
                    from[index] + share * (to(index) - from[index])
                })
            });
            return Rest {
                time: GOING_BACK,
                way: Some(way),
                tool: None,
                lead: GOING_BACK,
            };
        }
        let braking = |index: usize| {
            let mut next = state(&self.next, index);
            if self.is_direct() {
                // The arm goes on as it was measured.
                next.position += next.velocity * period;
            }
            let bounds = JointBounds::of(&joints[index].limits, (1.0, 1.0), self.limits_jerk);
            Course::to_rest(&next, &bounds, 0.0)
        };
        let durations = (0..joints.len()).map(|index| braking(index).duration());
        let time = durations.fold(0.0, f64::max);
        let mut way = WayToRest::default();
        way.fill(self.next.position);
        for index in 0..joints.len() {
            let braking = braking(index);
            for (part, place) in way.iter_mut().enumerate() {
                let after = time * part as f64 / REST_PARTS as f64;
                place[index] = braking.at(after).position;
            }
        }
        Rest {
            time,
            way: Some(way),
            tool: None,
            lead: time,
        }
    }
}

/// The state of a joint at a setpoint.
fn state(setpoint: &Setpoint, joint: usize) -> JointState {
    JointState {
        position: setpoint.position[joint],
        velocity: setpoint.velocity[joint],
        acceleration: setpoint.acceleration[joint],
    }
}

/// Holds that no number is larger than a limit of its joint.
fn within(
    numbers: &Joints,
    model: &Model,
    what: &str,
    limit: fn(&Joint) -> f64,
) -> Result<(), Words> {
    let mut joints = model.joints().iter().zip(numbers).enumerate();
    let beyond = joints.find(|(_, (joint, number))| number.abs() > limit(joint));
    match beyond {
        Some((index, (joint, number))) => Err(words!(
            "the {what} of joint {} is {number:.4}, its limit is {:.4}",
            index + 1,
            limit(joint)
        )),
        None => Ok(()),
    }
}

/// Why an arm under direct torques must be stopped: a joint is too fast, or would pass a limit before it rests.
fn strayed(now: &Setpoint, model: &Model, limits_jerk: bool, period: f64) -> Option<Words> {
    let mut joints = model.joints().iter().enumerate();
    joints.find_map(|(index, joint)| {
        let (at, speed, limits) = (now.position[index], now.velocity[index], &joint.limits);
        let (unit, number) = (joint.kind.unit(), index + 1);
        if speed.abs() > limits.velocity {
            let limit = limits.velocity;
            return Some(words!(
                "joint {number} went at {speed:.4} {unit}/s, its limit is {limit:.4}"
            ));
        }
        let bounds = JointBounds::of(limits, (1.0, 1.0), limits_jerk);
        let braking = Course::to_rest(&state(now, index), &bounds, 0.0);
        let way = braking.at(braking.duration()).position - at;
        let rest = at + CAUTION * way + LATE * speed * period;
        let (low, high) = (limits.lower, limits.upper);
        let outward = (rest > high && speed >= 0.0) || (rest < low && speed <= 0.0);
        outward.then(|| {
            words!("joint {number} at {at:.4} {unit} would not rest within {low:.4} and {high:.4}")
        })
    })
}

/// The pose that a value asks for: one of its own, or one away from where the tool was when the stream began.
fn pose(numbers: &[f64], origin: &Isometry3<f64>) -> Result<Isometry3<f64>, Words> {
    if let [x, y, z, roll, pitch, yaw] = *numbers {
        if [roll, pitch, yaw]
            .iter()
            .any(|angle| angle.abs() > 2.0 * PI)
        {
            return Err(words!("an angle of a value is more than a whole turn"));
        }
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let place = origin.translation.vector + nalgebra::Vector3::new(x, y, z);
        return Ok(Isometry3::from_parts(place.into(), turn * origin.rotation));
    }
    let [a, b, c, x, d, e, f, y, g, h, i, z, last @ ..] = numbers else {
        return Err(words!("a value has {} numbers", numbers.len()));
    };
    let matrix = Matrix3::new(*a, *b, *c, *d, *e, *f, *g, *h, *i);
    let skew = (matrix * matrix.transpose() - Matrix3::identity()).amax();
    if last != [0.0, 0.0, 0.0, 1.0] || skew > ROTATION_ROUNDING || matrix.determinant() < 0.0 {
        return Err(words!("the 16 numbers of a value are no pose"));
    }
    let rotation = Rotation3::from_matrix_unchecked(matrix);
    Ok(Isometry3::from_parts(
        Translation3::new(*x, *y, *z),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}
