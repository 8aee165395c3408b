//! Following segments, one servo period at a time, and stopping on them. Allocates nothing.
//!
//! A segment has a time of its own. It runs as the clock does until a stop is asked for; then it runs ever more slowly,
//! until it stands still. So the joints stay on the path that was planned and checked. Per period it is slowed down as
//! much as the accelerations of all joints allow: with q(s) the path over its own time s, a joint's acceleration is
//! q'' s'^2 + q' s''. A joint that brakes already at its limit cannot brake harder; a joint that gains speed begins to lose
//! it at once. With limits of jerk the progress along a path of the tool comes to rest under its own limits, with which the
//! planner has checked the joints. Elsewhere the joints leave the path for a stop: each comes to rest under its own limits
//! from where it is and how it moves, all in the time of the slowest, which keeps them near it.
//!
//! Segments wait in a queue. Over a [`Bridge`] the arm gets into the next one without a stop; without one it rests at the end
//! of each until it is told to go on.

use std::collections::VecDeque;

use mcs_model::{Joint, Joints};
use nalgebra::Isometry3;

use super::chase::chase;
use super::course::{Course, Ranges};
use super::interpolate::{Interpolator, Knot};
use super::segment::{Courses, Path, SegmentError, ToolPath};
use super::timing::{JointBounds, JointState};
use super::{Bridge, Pursuit, Segment, Setpoint, Solver};

#[cfg(test)]
mod tests;

/// The segments that are followed.
#[derive(Debug)]
pub struct Follower {
    /// The first one is under way.
    queue: VecDeque<Entry>,
    /// How many the queue holds.
    most: usize,
    /// Servo period, s.
    period: f64,
    /// Servo periods between two solved poses of a path of the tool.
    every: u32,
    clock: Clock,
    /// Whether the first setpoint has been given.
    begun: bool,
    /// How many segments were left over a bridge.
    passed: u64,
    /// What lies between the last three solved poses of the path under way, and the path's time at the last of them.
    between: Option<[Interpolator; 2]>,
    solved: f64,
    /// Whether stops keep the limits of jerk.
    limits_jerk: bool,
    /// A stop with limits of jerk, or back to a position, that is under way.
    halt: Option<Halt>,
    pursuit: Pursuit,
    /// The speeds of the last setpoint, and the mean accelerations by which they came to be.
    told: [Joints; 2],
}

/// A stop that does not go on along the path, or that keeps the limits of jerk.
#[derive(Debug, Clone, Copy)]
struct Halt {
    way: Braking,
    /// Periods since it began.
    periods: u32,
}

#[derive(Debug, Clone, Copy)]
#[allow(
    clippy::large_enum_variant,
    reason = "courses behind a pointer would be freed, and so call the allocator, in the tick"
)]
enum Braking {
    /// Every joint for itself, beside the path.
    Joints(Courses),
    /// The progress along the path of the tool under way.
    Path(Course),
    /// Every joint for itself back to a position, rad or m; the state in the next period, and whether that is all.
    Back {
        to: Joints,
        next: Setpoint,
        rests: bool,
    },
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    segment: Segment,
    /// The way into it from the one before.
    bridge: Option<Bridge>,
}

/// A part of the way: the segment of an entry of the queue, or the bridge into it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Part {
    entry: usize,
    is_bridge: bool,
}

/// Where the arm is on its way, and how the time of that runs.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Clock {
    part: Part,
    /// The part's own time, s.
    time: f64,
    /// How fast it runs, 1 to 0.
    rate: f64,
    /// Periods since the start, from which the time is counted until a stop, so that it never drifts, and the time of them
    /// that other parts took.
    periods: u64,
    before: f64,
    stopping: bool,
}

/// How many steps a look at a stop takes, about; how long each is at most, s; and how many they are at most.
const REST_STEPS: f64 = 16.0;
const LONGEST_REST_STEP: f64 = 0.04;
const MOST_REST_STEPS: usize = 64;
/// A joint that is nearer than this (rad or m) to where it goes back to, and no faster (per s), is there.
const REACHED: f64 = 1e-7;
/// How long going back takes at most, about, s.
const GOING_BACK: f64 = 0.1;
/// How much farther than it seems a path of the tool is taken to go until rest.
const PATH_CAUTION: f64 = 1.05;

/// The time in which an arm comes to rest is cut into so many equal parts.
pub const REST_PARTS: usize = 8;

/// Where all joints are on the way to rest, rad or m: when the braking begins, and at the end of each part of its time.
pub type WayToRest = [Joints; REST_PARTS + 1];

/// How segments would come to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// The time from when it brakes until then at most, s.
    pub time: f64,
    /// Where the joints are meanwhile; `None` on a path of the tool.
    pub way: Option<WayToRest>,
    /// `base_t_tool` at rest, on a path of the tool.
    pub tool: Option<Isometry3<f64>>,
    /// The travel from now until rest on a path of the tool: so many seconds at the present pace.
    pub lead: f64,
}

/// The places on a way to rest that takes so long (s), where the joints are at `state` after some time of it.
pub fn way_to_rest(time: f64, state: impl Fn(f64) -> Joints) -> WayToRest {
    std::array::from_fn(|part| state(time * part as f64 / REST_PARTS as f64))
}

impl Follower {
    /// One that follows nothing, with room for so many segments, for setpoints every `period` (s). Poses on a path of the tool are
    /// solved every so many periods (at least 1) and interpolated between.
    #[must_use]
    pub fn new(most: usize, period: f64, every: u32) -> Self {
        Self {
            queue: VecDeque::with_capacity(most),
            most,
            period,
            every: every.max(1),
            clock: Clock::START,
            begun: false,
            passed: 0,
            between: None,
            solved: 0.0,
            limits_jerk: false,
            halt: None,
            pursuit: Pursuit::default(),
            told: [Joints::default(); 2],
        }
    }

    /// Whether stops keep the limits of jerk that the model's joints have. Then they leave the path, a little.
    #[must_use]
    pub fn limiting_jerk(mut self, limits: bool) -> Self {
        self.limits_jerk = limits;
        self
    }

    /// Puts a segment behind the others, which begins where the last of them ends; whether there was room for it. The
    /// bridge into it is taken when the one before has not come too far, or else the arm stops between both.
    pub fn push(&mut self, segment: Segment, bridge: Option<Bridge>) -> bool {
        if self.queue.len() >= self.most {
            return false;
        }
        let next = self.next_on_last();
        self.queue.push_back(Entry {
            segment,
            bridge: bridge.filter(|bridge| next.is_some_and(|next| next < bridge.leave)),
        });
        true
    }

    /// The last segment's time in the next period, s, which is announced already; before its start where the arm has not
    /// come to it. `None` when there is no segment.
    fn next_on_last(&self) -> Option<f64> {
        let last = self.queue.len().checked_sub(1)?;
        let Clock { part, time, .. } = self.clock;
        let next = time + self.period;
        if part.entry != last {
            return Some(f64::NEG_INFINITY);
        }
        match self.queue.get(last)?.bridge.as_ref() {
            Some(bridge) if part.is_bridge => Some(bridge.join + next - bridge.duration()),
            _ => Some(next),
        }
    }

    /// Leaves the segment at whose end the arm rests for the next one in the queue; whether there is one.
    pub fn go_on(&mut self) -> bool {
        self.queue.pop_front();
        self.restart();
        !self.queue.is_empty()
    }

    /// Follows nothing any more.
    pub fn clear(&mut self) {
        self.queue.clear();
        self.restart();
    }

    fn restart(&mut self) {
        self.clock = Clock::START;
        self.begun = false;
        self.between = None;
        self.halt = None;
    }

    /// How many segments are under way or wait.
    #[must_use]
    pub fn len(&self) -> usize {
        self.queue.len()
    }

    /// Whether no segment is under way.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// Where the last segment ends, rad or m.
    ///
    /// # Errors
    /// [`SegmentError`] as [`Segment::end`].
    pub fn end(&self, solver: &mut Solver) -> Result<Option<Joints>, SegmentError> {
        let last = self.queue.back();
        last.map(|last| last.segment.end(solver)).transpose()
    }

    /// How many segments were left over a bridge so far.
    #[must_use]
    pub fn passed(&self) -> u64 {
        self.passed
    }

    /// Stops as hard as the limits of all joints allow: on the path, or with limits of jerk beside it. What has not moved yet
    /// does not begin to.
    pub fn stop(&mut self) {
        self.clock.stopping = true;
        if self.clock.time == 0.0 && !self.clock.part.is_bridge {
            self.clock.rate = 0.0;
        }
    }

    /// Stops, and goes back to a position (rad or m) as quickly as the limits of all joints allow. `now` is the last setpoint;
    /// its acceleration becomes the one with which that begins. What stops or rests already does no more than that.
    pub fn yield_to(&mut self, to: &Joints, now: &mut Setpoint, solver: &Solver) {
        if self.clock.stopping {
            return;
        }
        self.stop();
        if self.rests() {
            return;
        }
        let joints = solver.model().joints();
        let to = Joints::from_fn(to.len().min(joints.len()), |index| {
            let limits = &joints[index].limits;
            to[index].clamp(limits.lower, limits.upper)
        });
        let mut from = *now;
        for (index, acceleration) in from.acceleration.iter_mut().enumerate() {
            *acceleration = self.told_state(index, solver).acceleration;
        }
        let next = self.back(&from, &to, solver);
        for (index, acceleration) in now.acceleration.iter_mut().enumerate() {
            *acceleration = (next.velocity[index] - now.velocity[index]) / self.period;
        }
        let rests = false;
        let way = Braking::Back { to, next, rests };
        self.halt = Some(Halt { way, periods: 0 });
    }

    /// The states of all joints a period later on their way back to a position.
    fn back(&mut self, from: &Setpoint, to: &Joints, solver: &Solver) -> Setpoint {
        let (period, mut then) = (self.period, *from);
        for (index, joint) in solver.model().joints().iter().enumerate() {
            let (limits, aim) = (&joint.limits, (to[index], 0.0));
            let (position, speed) = (from.position[index], from.velocity[index]);
            let all = (1.0, 1.0);
            let bounds = JointBounds::of(limits, all, self.limits_jerk);
            let state = if bounds.jerk > 0.0 {
                let now = JointState {
                    position,
                    velocity: speed,
                    acceleration: from.acceleration[index],
                };
                self.pursuit.next(&now, aim, limits, all, period)
            } else {
                let velocity = chase((position, speed), aim, limits, all, period);
                JointState {
                    position: position + 0.5 * (speed + velocity) * period,
                    velocity,
                    acceleration: 0.0,
                }
            };
            then.position[index] = state.position;
            then.velocity[index] = state.velocity;
            then.acceleration[index] = state.acceleration;
        }
        then
    }

    /// Whether a stop was asked for.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.clock.stopping
    }

    /// Whether the setpoint rests, at the end of a segment or where a stop has ended.
    #[must_use]
    pub fn rests(&self) -> bool {
        let (end, following) = self.end_of(self.clock.part);
        let at_end = following.is_none() && self.clock.time >= end;
        let halted = self.halt.as_ref();
        let halted = halted.is_some_and(|halt| halt.rests(self.period));
        self.begun && (at_end || halted || self.clock.rate <= 0.0)
    }

    /// The setpoint of the next period, `near` the joint positions (rad or m) of the one before. Its acceleration is the
    /// mean until the one after it, for which torques are held.
    ///
    /// # Errors
    /// [`SegmentError`] for a path through a pose that cannot be followed.
    pub fn next(&mut self, solver: &mut Solver, near: &[f64]) -> Result<Setpoint, SegmentError> {
        let jerk = self.limits_jerk && self.clock.stopping && self.begun;
        if self.halt.is_some() || (jerk && !self.rests()) {
            return self.brake(solver);
        }
        let setpoint = self.along(solver, near)?;
        let [speeds, accelerations] = &mut self.told;
        *accelerations = Joints::from_fn(setpoint.velocity.len(), |index| {
            let before = speeds.get(index).copied().unwrap_or_default();
            (setpoint.velocity[index] - before) / self.period
        });
        *speeds = setpoint.velocity;
        Ok(setpoint)
    }

    /// The next setpoint of a stop with limits of jerk.
    fn brake(&mut self, solver: &mut Solver) -> Result<Setpoint, SegmentError> {
        let begun = |follower: &Self| {
            let Clock { part, time, .. } = follower.clock;
            let state = |joint| follower.told_state(joint, solver);
            follower.halt_from(part, time, solver.model().joints(), state)
        };
        let mut halt = self.halt.take().unwrap_or_else(|| begun(self));
        halt.periods = halt.periods.saturating_add(1);
        self.halt = Some(halt);
        let time = f64::from(halt.periods) * self.period;
        let mut setpoint;
        match &halt.way {
            Braking::Joints(courses) => {
                setpoint = courses.setpoint(time);
                let then = courses.setpoint(time + self.period);
                for (index, acceleration) in setpoint.acceleration.iter_mut().enumerate() {
                    *acceleration = (then.velocity[index] - setpoint.velocity[index]) / self.period;
                }
            }
            Braking::Back { to, next, .. } => {
                let then = self.back(next, to, solver);
                setpoint = *next;
                for (index, acceleration) in setpoint.acceleration.iter_mut().enumerate() {
                    *acceleration = (then.velocity[index] - next.velocity[index]) / self.period;
                }
                let near = |one: &Joints, other: &Joints| {
                    let mut pairs = one.iter().zip(other);
                    pairs.all(|(one, other)| (one - other).abs() < REACHED)
                };
                let still = Joints::zeros(to.len());
                let rests = near(&next.position, to) && near(&next.velocity, &still);
                if rests {
                    setpoint = Setpoint::at_rest(next.position);
                }
                let way = Braking::Back {
                    to: *to,
                    next: then,
                    rests,
                };
                self.halt = Some(Halt { way, ..halt });
            }
            Braking::Path(course) => {
                let [now, then] = [time, time + self.period].map(|time| course.at(time));
                self.solve_as_far(solver, then.position)?;
                setpoint = Setpoint::at_rest(Joints::zeros(solver.model().dof()));
                for index in 0..setpoint.position.len() {
                    let [now, then] = [now, then].map(|along| self.on_path(index, along));
                    setpoint.position[index] = now.position;
                    setpoint.velocity[index] = now.velocity;
                    setpoint.acceleration[index] = (then.velocity - now.velocity) / self.period;
                }
            }
        }
        Ok(setpoint)
    }

    /// A stop with limits of jerk from some time of a part, where the joints are in these states.
    fn halt_from(
        &self,
        part: Part,
        time: f64,
        joints: &[Joint],
        state: impl Fn(usize) -> JointState,
    ) -> Halt {
        let entry = self.queue.get(part.entry);
        let way = match entry.map(|entry| entry.segment.path()) {
            Some(Path::Tool(path)) if !part.is_bridge => {
                let bounds = JointBounds {
                    velocity: f64::INFINITY,
                    acceleration: path.along.braking(time, time),
                    jerk: path.along.jerk(),
                };
                Braking::Path(Course::to_rest(&path.along.at(time), &bounds, 0.0))
            }
            _ => Braking::Joints(Courses::to_rest(joints, state)),
        };
        Halt { way, periods: 0 }
    }

    /// The state of a joint at the last setpoint. Its acceleration is no other than the limit of jerk lets it be after the mean
    /// one of the period before: between two solved poses of a path the cubics have others.
    fn told_state(&self, joint: usize, solver: &Solver) -> JointState {
        let Clock { part, time, .. } = self.clock;
        let mut state = self.state(part, joint, time);
        let limits = solver
            .model()
            .joints()
            .get(joint)
            .map(|joint| &joint.limits);
        let jerk = limits.map_or(0.0, |limits| limits.jerk);
        let mean = self.told[1].get(joint).copied().unwrap_or_default();
        if jerk > 0.0 {
            let more = 0.5 * jerk * self.period;
            state.acceleration = state.acceleration.clamp(mean - more, mean + more);
        }
        state
    }

    /// The setpoint of the next period on the way of the segments.
    fn along(&mut self, solver: &mut Solver, near: &[f64]) -> Result<Setpoint, SegmentError> {
        if self.begun {
            self.clock = self.after(&self.clock, self.period, solver);
        }
        self.begun = true;
        while self.clock.part.entry > 0 {
            self.clock.part.entry -= 1;
            self.queue.pop_front();
            self.passed += 1;
            self.between = None;
        }
        self.solve(solver, near)?;
        let now = self.clock;
        let mut setpoint = Setpoint::at_rest(Joints::zeros(solver.model().dof()));
        if self.rests() {
            for index in 0..setpoint.position.len() {
                setpoint.position[index] = self.state(now.part, index, now.time).position;
            }
            if let (Some([_, between]), true) = (&self.between, now.rate > 0.0) {
                setpoint.position = between.end().position;
            }
            return Ok(setpoint);
        }
        let ahead = self.after(&self.clock, self.period, solver);
        for index in 0..setpoint.position.len() {
            let state = self.state(now.part, index, now.time);
            let then = self.state(ahead.part, index, ahead.time);
            setpoint.position[index] = state.position;
            setpoint.velocity[index] = state.velocity * now.rate;
            setpoint.acceleration[index] =
                (then.velocity * ahead.rate - setpoint.velocity[index]) / self.period;
        }
        Ok(setpoint)
    }

    /// When a part ends, and what follows it from which time of its own, if anything does.
    fn end_of(&self, part: Part) -> (f64, Option<(Part, f64)>) {
        let Some(entry) = self.queue.get(part.entry) else {
            return (0.0, None);
        };
        if let (true, Some(bridge)) = (part.is_bridge, &entry.bridge) {
            let own = Part::segment(part.entry);
            return (bridge.duration(), Some((own, bridge.join)));
        }
        let next = Part {
            entry: part.entry + 1,
            is_bridge: true,
        };
        let bridge = self
            .queue
            .get(next.entry)
            .and_then(|entry| entry.bridge.as_ref());
        match bridge {
            Some(bridge) => (bridge.leave, Some((next, 0.0))),
            None => (entry.segment.duration(), None),
        }
    }

    /// How it would come to rest if it braked from the next period on, in steps longer than a period: a step brakes as hard as
    /// all of it bears, and so no harder than its periods would.
    #[must_use]
    pub fn rest(&self, solver: &Solver) -> Rest {
        if self.limits_jerk || self.halt.is_some() {
            return self.rest_of_halt(solver);
        }
        let mut clock = self.after(&self.clock, self.period, solver);
        clock.stopping = true;
        // A step is so long that braking as hard as in the one before takes about as many.
        let long =
            |braking: f64| (1.0 / braking / REST_STEPS).clamp(self.period, LONGEST_REST_STEP);
        let mut step = long(self.braking(&clock, self.period, solver));
        // When each step begins, from where, and how hard it brakes.
        let mut steps = [(0.0, clock, 0.0); MOST_REST_STEPS];
        let (mut time, mut count) = (0.0, 0);
        for place in &mut steps {
            if clock.rate <= 0.0 || self.is_at_end(&clock) {
                break;
            }
            let braking = self.braking(&clock, step, solver);
            *place = (time, clock, braking);
            count += 1;
            time += step.min(clock.rate / braking);
            clock = self.braked(&clock, step, braking);
            step = long(braking);
        }
        if clock.rate > 0.0 {
            // As far as the part goes: it may not come to rest before.
            clock.time = self.end_of(clock.part).0;
        }
        let mut rest = self.rest_at(&clock, time);
        if rest.tool.is_none() {
            let steps = steps.get(..count).unwrap_or_default();
            rest.way = Some(way_to_rest(time, |after| {
                let begun = steps.partition_point(|(begin, ..)| *begin <= after);
                let Some((begin, from, braking)) = steps.get(begun.saturating_sub(1)) else {
                    return self.joints_at(&clock);
                };
                match after < time {
                    true => self.joints_at(&self.braked(from, after - begin, *braking)),
                    false => self.joints_at(&clock),
                }
            }));
        }
        rest
    }

    /// Where the joints are at a place of the way that is none of a path of the tool, rad or m.
    fn joints_at(&self, clock: &Clock) -> Joints {
        let joints = self.queue.front().map_or(0, |entry| entry.segment.joints());
        Joints::from_fn(joints, |joint| {
            self.state(clock.part, joint, clock.time).position
        })
    }

    /// How a stop with limits of jerk, or back to a position, comes to rest that is under way or would begin in the next period.
    fn rest_of_halt(&self, solver: &Solver) -> Rest {
        let Clock { part, time, .. } = self.after(&self.clock, self.period, solver);
        let joints = solver.model().joints();
        let halt = self.halt.unwrap_or_else(|| {
            self.halt_from(part, time, joints, |joint| self.state(part, joint, time))
        });
        let left = (halt.duration() - f64::from(halt.periods) * self.period).max(0.0);
        let mut rest = Rest {
            time: left,
            way: None,
            tool: None,
            lead: left,
        };
        let gone = halt.duration() - left;
        match (&halt.way, self.queue.get(part.entry)) {
            (Braking::Joints(courses), _) => {
                rest.way = Some(way_to_rest(left, |after| {
                    courses.setpoint(gone + after).position
                }));
            }
            (Braking::Path(course), Some(entry)) => {
                if let Path::Tool(path) = entry.segment.path() {
                    let end = course.at(course.duration()).position;
                    rest.tool = Some(path.pose(end));
                    let now = path.along.at(self.clock.time);
                    let pace = now.velocity + now.acceleration.max(0.0) * self.period;
                    if part == self.clock.part && pace > 0.0 {
                        rest.lead = (end - now.position) / pace;
                    }
                }
            }
            (Braking::Path(_), None) => {}
            (Braking::Back { to, next, .. }, _) => {
                rest.time = GOING_BACK;
                rest.way = Some(way_to_rest(1.0, |share| {
                    let from = &next.position;
                    Joints::from_fn(to.len(), |index| {
                        from[index] + share * (to[index] - from[index])
                    })
                }));
            }
        }
        rest
    }

    /// What is known of rest at a place of the way, after so much time (s).
    fn rest_at(&self, clock: &Clock, time: f64) -> Rest {
        let Clock { part, time: at, .. } = *clock;
        let mut rest = Rest {
            time,
            way: None,
            tool: None,
            lead: time,
        };
        let entry = self.queue.get(part.entry).filter(|_| !part.is_bridge);
        if let Some(Path::Tool(path)) = entry.map(|entry| entry.segment.path()) {
            let then = path.along.at(at).position;
            let now = path.along.at(self.clock.time);
            rest.tool = Some(path.pose(then));
            if part == self.clock.part {
                // The joints may bear less braking farther on than where the poses are solved.
                let then = now.position + (then - now.position) * PATH_CAUTION;
                rest.tool = Some(path.pose(then.min(1.0)));
                let pace = now.velocity + now.acceleration.max(0.0) * self.period;
                if pace > 0.0 {
                    rest.lead = (then - now.position) / pace;
                }
            }
        }
        rest
    }

    /// Whether nothing comes after this.
    fn is_at_end(&self, clock: &Clock) -> bool {
        let (end, following) = self.end_of(clock.part);
        following.is_none() && clock.time >= end
    }

    /// The clock one `period` (s) later.
    fn after(&self, clock: &Clock, period: f64, solver: &Solver) -> Clock {
        if clock.stopping {
            return self.braked(clock, period, self.braking(clock, period, solver));
        }
        let mut clock = *clock;
        clock.periods += 1;
        // A motion of 2^53 periods would take longer than the arm will last.
        clock.time = clock.periods as f64 * period - clock.before;
        self.in_its_part(clock)
    }

    /// The clock one `period` (s) later, in which its rate falls so fast, 1/s.
    fn braked(&self, clock: &Clock, period: f64, braking: f64) -> Clock {
        let mut clock = *clock;
        if clock.rate <= braking * period {
            // It stands before the period is over.
            if braking > 0.0 {
                clock.time += 0.5 * clock.rate * clock.rate / braking;
            }
            clock.rate = 0.0;
        } else {
            clock.time += period * (clock.rate - 0.5 * braking * period);
            clock.rate -= braking * period;
        }
        self.in_its_part(clock)
    }

    /// The same clock, in the part that its time has come to.
    fn in_its_part(&self, mut clock: Clock) -> Clock {
        while let (end, Some((part, start))) = self.end_of(clock.part)
            && clock.time >= end
        {
            clock.part = part;
            clock.time -= end - start;
            clock.before += end - start;
        }
        clock
    }

    /// How fast the rate may fall within the coming `period` (s), 1/s.
    fn braking(&self, clock: &Clock, period: f64, solver: &Solver) -> f64 {
        // First as if what gains speed went on to do so, which gives the lowest rate at the end of the period.
        let bold = self.bearable(clock, period, clock.rate, solver);
        let slowest = (clock.rate - bold * period).max(0.0);
        self.bearable(clock, period, slowest, solver)
    }

    /// How fast the rate may fall within the coming `period` (s) when it falls no lower than `slowest`.
    fn bearable(&self, clock: &Clock, period: f64, slowest: f64, solver: &Solver) -> f64 {
        let rates = (slowest, clock.rate);
        let (mut part, mut from) = (clock.part, clock.time);
        let mut left = clock.rate * period;
        let mut least = f64::INFINITY;
        loop {
            let (end, following) = self.end_of(part);
            let until = from + left;
            match following {
                Some((next, start)) if until > end => {
                    least = least.min(self.bearable_in(part, (from, end), rates, solver));
                    left = until - end;
                    (part, from) = (next, start);
                }
                _ => return least.min(self.bearable_in(part, (from, until), rates, solver)),
            }
        }
    }

    /// The same within some time of one part.
    fn bearable_in(
        &self,
        part: Part,
        (from, until): (f64, f64),
        (slowest, fastest): (f64, f64),
        solver: &Solver,
    ) -> f64 {
        let room = |ranges: &Ranges, limit: f64| {
            let (speed, acceleration) = (&ranges.velocity, &ranges.acceleration);
            let most = speed.most.max(-speed.least);
            if most <= 0.0 {
                return f64::INFINITY;
            }
            // The least acceleration along the way of the joint, or against it where that turns within the period.
            let along = if speed.least >= 0.0 {
                acceleration.least
            } else if speed.most <= 0.0 {
                -acceleration.most
            } else {
                -acceleration.most.max(-acceleration.least)
            };
            let rate = if along > 0.0 { slowest } else { fastest };
            (limit + along * rate * rate).max(0.0) / most
        };
        let limit = |joint: &Joint| joint.limits.acceleration;
        let joints = solver.model().joints().iter().enumerate();
        let Some(entry) = self.queue.get(part.entry) else {
            return f64::INFINITY;
        };
        let courses = match (part.is_bridge, &entry.bridge, entry.segment.path()) {
            (true, Some(bridge), _) => &bridge.courses,
            (_, _, Path::Joint(courses)) => courses,
            (_, _, Path::Tool(path)) => {
                let tool = room(
                    &path.along.ranges(from, until),
                    path.along.braking(from, until),
                );
                if part.entry > 0 {
                    // A look far ahead: no pose of it is solved yet.
                    return tool;
                }
                let middle = 0.5 * (from + until);
                return joints.fold(tool, |least, (index, joint)| {
                    // Within a period the cubics hardly bend.
                    let states = [from, middle, until].map(|time| self.state(part, index, time));
                    let ranges = states.iter().fold(Ranges::NONE, Ranges::with);
                    least.min(room(&ranges, limit(joint)))
                });
            }
        };
        let pairs = joints.zip(courses.each());
        pairs.fold(f64::INFINITY, |least, ((_, joint), course)| {
            least.min(room(&course.ranges(from, until), limit(joint)))
        })
    }

    /// A joint's state at some time of a part.
    fn state(&self, part: Part, joint: usize, time: f64) -> JointState {
        let on = |courses: &Courses| {
            let course = courses.each().get(joint);
            course.map_or_else(JointState::default, |course| course.at(time))
        };
        let Some(entry) = self.queue.get(part.entry) else {
            return JointState::default();
        };
        match (part.is_bridge, &entry.bridge, entry.segment.path()) {
            (true, Some(bridge), _) => on(&bridge.courses),
            (_, _, Path::Joint(courses)) => on(courses),
            (_, _, Path::Tool(path)) => self.on_path(joint, path.along.at(time)),
        }
    }

    /// A joint's state at some progress of the path of the tool whose poses were solved last.
    fn on_path(&self, joint: usize, along: JointState) -> JointState {
        // Its poses are solved before anybody asks: a bridge takes longer than a period.
        let Some([older, newer]) = &self.between else {
            return JointState::default();
        };
        let between = match along.position < newer.start().progress {
            true => older,
            false => newer,
        };
        // Who looks farther ahead sees the arm go on as at the last solved pose.
        let solved = along.position.min(newer.end().progress);
        let place = JointState {
            position: solved,
            ..along
        };
        between.state(joint, place)
    }

    /// Sees that the poses of the path under way, or of that to which the bridge under way leads, are solved as far as the
    /// arm has come.
    fn solve(&mut self, solver: &mut Solver, near: &[f64]) -> Result<(), SegmentError> {
        let Some(Entry { segment, bridge }) = self.queue.front() else {
            return Ok(());
        };
        let Path::Tool(path) = segment.path() else {
            return Ok(());
        };
        let coming = bridge.as_ref().filter(|_| self.clock.part.is_bridge);
        let time = coming.map_or(self.clock.time, |bridge| bridge.join);
        let apart = self.period * f64::from(self.every);
        let mut last = match &self.between {
            Some([_, between]) => *between.end(),
            None => {
                // As if it had been followed from its start, so that it is what was planned.
                self.solved = (time / apart).floor() * apart;
                let near = coming.map_or(near, |bridge| &bridge.near);
                path.knot(solver, path.along.at(self.solved).position, near)?
            }
        };
        // One period ahead, because the speed there is announced.
        let until = time + self.period;
        while self.between.is_none() || self.solved < until {
            let poses = (&mut self.between, &mut self.solved);
            last = solve_next(poses, apart, (solver, path), &last)?;
        }
        Ok(())
    }

    /// Sees that the poses of the path of the tool under way are solved as far as some progress.
    fn solve_as_far(&mut self, solver: &mut Solver, progress: f64) -> Result<(), SegmentError> {
        let Some(Path::Tool(path)) = self.queue.front().map(|entry| entry.segment.path()) else {
            return Ok(());
        };
        let apart = self.period * f64::from(self.every);
        while let Some([_, newer]) = self.between
            && newer.end().progress < progress.min(1.0)
        {
            let poses = (&mut self.between, &mut self.solved);
            solve_next(poses, apart, (solver, path), newer.end())?;
        }
        Ok(())
    }
}

/// Solves one more pose of a path, so much later (s) on it than the last one.
fn solve_next(
    (between, solved): (&mut Option<[Interpolator; 2]>, &mut f64),
    apart: f64,
    (solver, path): (&mut Solver, &ToolPath),
    last: &Knot,
) -> Result<Knot, SegmentError> {
    *solved += apart;
    let progress = path.along.at(*solved).position;
    let next = path.knot(solver, progress, &last.position)?;
    let newer = Interpolator::new(*last, next);
    let older = between.map_or(newer, |[_, between]| between);
    *between = Some([older, newer]);
    Ok(next)
}

impl Halt {
    /// How long it takes, s.
    fn duration(&self) -> f64 {
        match &self.way {
            Braking::Joints(courses) => courses.duration(),
            Braking::Path(course) => course.duration(),
            Braking::Back { .. } => GOING_BACK,
        }
    }

    fn rests(&self, period: f64) -> bool {
        match &self.way {
            Braking::Back { rests, .. } => *rests,
            _ => f64::from(self.periods) * period >= self.duration(),
        }
    }
}

impl Clock {
    const START: Self = Self {
        part: Part::segment(0),
        time: 0.0,
        rate: 1.0,
        periods: 0,
        before: 0.0,
        stopping: false,
    };
}

impl Part {
    const fn segment(entry: usize) -> Self {
        Self {
            entry,
            is_bridge: false,
        }
    }
}
