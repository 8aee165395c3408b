//! How segments that are followed would come to rest if that began now.

use mcs_model::Joints;
use nalgebra::Isometry3;

use super::halt::{Braking, GOING_BACK};
use super::{Clock, Follower};
use crate::Solver;
use crate::segment::Path;

/// How many steps a look at a stop takes, about; how long each is at most, s; and how many they are at most.
const REST_STEPS: f64 = 16.0;
const LONGEST_REST_STEP: f64 = 0.04;
const MOST_REST_STEPS: usize = 64;
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
}
