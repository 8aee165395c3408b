//! How fast the time of segments that are followed may slow down.

use mcs_model::Joint;

use super::{Clock, Follower, Part};
use crate::Solver;
use crate::course::Ranges;
use crate::segment::Path;

impl Follower {
    /// The clock one `period` (s) later.
    pub(super) fn after(&self, clock: &Clock, period: f64, solver: &Solver) -> Clock {
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
    pub(super) fn braked(&self, clock: &Clock, period: f64, braking: f64) -> Clock {
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
    pub(super) fn braking(&self, clock: &Clock, period: f64, solver: &Solver) -> f64 {
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
}
