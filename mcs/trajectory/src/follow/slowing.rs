//! How fast the time of segments that are followed may slow down.

use mcs_model::{Joint, MAX_SLOTS};
use tinyvec::ArrayVec;

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
        let bearable = self.bearable(clock, period, solver);
        // First as if what gains speed went on to do so, which gives the lowest rate at the end of the period.
        let bold = bearable.at(clock.rate);
        bearable.at((clock.rate - bold * period).max(0.0))
    }

    /// What all parts that the coming `period` (s) may lead through bear.
    fn bearable(&self, clock: &Clock, period: f64, solver: &Solver) -> Bearable {
        let mut bearable = Bearable {
            rate: clock.rate,
            others: f64::INFINITY,
            gaining: ArrayVec::new(),
        };
        let (mut part, mut from) = (clock.part, clock.time);
        let mut left = clock.rate * period;
        loop {
            let (end, following) = self.end_of(part);
            let until = from + left;
            match following {
                Some((next, start)) if until > end => {
                    self.bear(part, (from, end), solver, &mut bearable);
                    left = until - end;
                    (part, from) = (next, start);
                }
                _ => {
                    self.bear(part, (from, until), solver, &mut bearable);
                    return bearable;
                }
            }
        }
    }

    /// Adds what some time of one part bears.
    fn bear(
        &self,
        part: Part,
        (from, until): (f64, f64),
        solver: &Solver,
        bearable: &mut Bearable,
    ) {
        let limit = |joint: &Joint| joint.limits.acceleration;
        let joints = solver.model().joints().iter().enumerate();
        let Some(entry) = self.queue.get(part.entry) else {
            return;
        };
        let courses = match (part.is_bridge, &entry.bridge, entry.segment.path()) {
            (true, Some(bridge), _) => &bridge.courses,
            (_, _, Path::Joint(courses)) => courses,
            (_, _, Path::Tool(path)) => {
                let along = &path.along;
                bearable.with(&along.ranges(from, until), along.braking(from, until));
                if part.entry > 0 {
                    // A look far ahead: no pose of it is solved yet.
                    return;
                }
                let middle = 0.5 * (from + until);
                for (index, joint) in joints {
                    // Within a period the cubics hardly bend.
                    let states = [from, middle, until].map(|time| self.state(part, index, time));
                    let ranges = states.iter().fold(Ranges::NONE, Ranges::with);
                    bearable.with(&ranges, limit(joint));
                }
                return;
            }
        };
        for ((_, joint), course) in joints.zip(courses.each()) {
            bearable.with(&course.ranges(from, until), limit(joint));
        }
    }
}

/// How fast the rate may fall, by how far it does.
struct Bearable {
    /// Where it falls from.
    rate: f64,
    /// What those bear that gain no speed, 1/s.
    others: f64,
    /// Those that gain speed: their limits, by how much they do, and how fast they are.
    gaining: ArrayVec<[(f64, f64, f64); MAX_SLOTS]>,
}

impl Bearable {
    /// Adds what has these speeds and accelerations and this limit of acceleration.
    fn with(&mut self, ranges: &Ranges, limit: f64) {
        let (speed, acceleration) = (&ranges.velocity, &ranges.acceleration);
        let most = speed.most.max(-speed.least);
        if most <= 0.0 {
            return;
        }
        // The least acceleration along the way of the joint, or against it where that turns within the period.
        let along = if speed.least >= 0.0 {
            acceleration.least
        } else if speed.most <= 0.0 {
            -acceleration.most
        } else {
            -acceleration.most.max(-acceleration.least)
        };
        let gains = along > 0.0;
        if gains && self.gaining.try_push((limit, along, most)).is_none() {
            return;
        }
        // Of one that gains speed and finds no room, what it gains does not count.
        let along = along.min(0.0);
        let room = (limit + along * self.rate * self.rate).max(0.0) / most;
        self.others = self.others.min(room);
    }

    /// How fast the rate may fall when it falls no lower than `slowest`, 1/s.
    fn at(&self, slowest: f64) -> f64 {
        let gaining = self.gaining.iter();
        gaining.fold(self.others, |least, (limit, along, most)| {
            least.min((limit + along * slowest * slowest) / most)
        })
    }
}
