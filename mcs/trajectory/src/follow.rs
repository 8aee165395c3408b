//! Following segments, one servo period at a time, and stopping on them. Allocates nothing.
//!
//! A segment has a time of its own. It runs as the clock does until a stop is asked for; then it runs ever more slowly,
//! until it stands still. So the joints stay on the path that was planned and checked. Per period it is slowed down as
//! much as the accelerations of all joints allow: with q(s) the path over its own time s, a joint's acceleration is
//! q'' s'^2 + q' s''. A joint that brakes already at its limit cannot brake harder; a joint that gains speed begins to lose
//! it at once.
//!
//! Segments wait in a queue. Over a [`Bridge`] the arm gets into the next one without a stop; without one it rests at the end
//! of each until it is told to go on.

use std::collections::VecDeque;

use mcs_model::{Joint, Joints};
use nalgebra::Isometry3;

use super::course::Ranges;
use super::interpolate::Interpolator;
use super::segment::{Courses, Path, SegmentError};
use super::timing::JointState;
use super::{Bridge, Segment, Setpoint, Solver};

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
const LONGEST_REST_STEP: f64 = 0.25;
const MOST_REST_STEPS: u32 = 64;
/// How much farther than it seems a path of the tool is taken to go until rest.
const PATH_CAUTION: f64 = 1.05;

/// How segments would come to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// The time from when it brakes until then at most, s.
    pub time: f64,
    /// Where all joints rest, rad or m; `None` on a path of the tool.
    pub joints: Option<Joints>,
    /// `base_t_tool` at rest, on a path of the tool.
    pub tool: Option<Isometry3<f64>>,
    /// The travel from now until rest on a path of the tool: so many seconds at the present pace.
    pub lead: f64,
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
        }
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

    /// Stops on the path, as hard as the accelerations of all joints allow; what has not moved yet does not begin to.
    pub fn stop(&mut self) {
        self.clock.stopping = true;
        if self.clock.time == 0.0 && !self.clock.part.is_bridge {
            self.clock.rate = 0.0;
        }
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
        self.begun && (at_end || self.clock.rate <= 0.0)
    }

    /// The setpoint of the next period, `near` the joint positions (rad or m) of the one before. Its acceleration is the
    /// mean until the one after it, for which torques are held.
    ///
    /// # Errors
    /// [`SegmentError`] for a path through a pose that cannot be followed.
    pub fn next(&mut self, solver: &mut Solver, near: &[f64]) -> Result<Setpoint, SegmentError> {
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
        let mut clock = self.after(&self.clock, self.period, solver);
        clock.stopping = true;
        let step = clock.rate / self.braking(&clock, self.period, solver) / REST_STEPS;
        let step = step.min(LONGEST_REST_STEP).max(self.period);
        let (mut time, mut steps) = (0.0, 0);
        while clock.rate > 0.0 && !self.is_at_end(&clock) && steps < MOST_REST_STEPS {
            clock = self.after(&clock, step, solver);
            time += step;
            steps += 1;
        }
        if clock.rate > 0.0 {
            // As far as the part goes: it may not come to rest before.
            clock.time = self.end_of(clock.part).0;
        }
        self.rest_at(&clock, time)
    }

    /// What is known of rest at a place of the way, after so much time (s).
    fn rest_at(&self, clock: &Clock, time: f64) -> Rest {
        let Clock { part, time: at, .. } = *clock;
        let mut rest = Rest {
            time,
            joints: None,
            tool: None,
            lead: time,
        };
        let Some(entry) = self.queue.get(part.entry) else {
            return rest;
        };
        let courses = match (part.is_bridge, &entry.bridge, entry.segment.path()) {
            (true, Some(bridge), _) => &bridge.courses,
            (_, _, Path::Joint(courses)) => courses,
            (_, _, Path::Tool(path)) => {
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
                return rest;
            }
        };
        let mut joints = Joints::zeros(courses.each().len());
        for (joint, course) in joints.iter_mut().zip(courses.each()) {
            *joint = course.at(at).position;
        }
        rest.joints = Some(joints);
        rest
    }

    /// Whether nothing comes after this.
    fn is_at_end(&self, clock: &Clock) -> bool {
        let (end, following) = self.end_of(clock.part);
        following.is_none() && clock.time >= end
    }

    /// The clock one `period` (s) later.
    fn after(&self, clock: &Clock, period: f64, solver: &Solver) -> Clock {
        let mut clock = *clock;
        if clock.stopping {
            let braking = self.braking(&clock, period, solver);
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
        } else {
            clock.periods += 1;
            // A motion of 2^53 periods would take longer than the arm will last.
            clock.time = clock.periods as f64 * period - clock.before;
        }
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
            (_, _, Path::Tool(path)) => {
                let along = path.along.at(time);
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
        }
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
        let mut last = match &self.between {
            Some([_, between]) => *between.end(),
            None => {
                // As if it had been followed from its start, so that it is what was planned.
                let apart = self.period * f64::from(self.every);
                self.solved = (time / apart).floor() * apart;
                let near = coming.map_or(near, |bridge| &bridge.near);
                path.knot(solver, path.along.at(self.solved).position, near)?
            }
        };
        // One period ahead, because the speed there is announced.
        while self.between.is_none() || self.solved < time + self.period {
            self.solved += self.period * f64::from(self.every);
            let progress = path.along.at(self.solved).position;
            let next = path.knot(solver, progress, &last.position)?;
            let newer = Interpolator::new(last, next);
            let older = self.between.map_or(newer, |[_, between]| between);
            self.between = Some([older, newer]);
            last = next;
        }
        Ok(())
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
