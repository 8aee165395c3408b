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

use mcs_model::Joints;

use super::interpolate::{Interpolator, Knot};
use super::segment::{Courses, Path, SegmentError, ToolPath};
use super::timing::JointState;
use super::{Bridge, Segment, Setpoint, Solver};
use halt::Halt;
pub use rest::{REST_PARTS, Rest, WayToRest, way_to_rest};

mod halt;
mod rest;
mod slowing;

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
    /// The speeds of the last setpoint, and the mean accelerations by which they came to be.
    told: [Joints; 2],
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

    /// Whether a stop was asked for.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.clock.stopping
    }

    /// Whether the setpoint rests, at the end of a segment or where a stop has ended.
    #[must_use]
    pub fn rests(&self) -> bool {
        if let Some(halt) = &self.halt {
            return halt.rests(self.period);
        }
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
