//! The way from one segment into the next past the point where both meet: a blend.
//!
//! The arm leaves the first segment before its end and joins the second one after its start. Between both every joint goes
//! from state to state under its own limits, in the least time that is common to all. No speed has a step. With a limit of
//! jerk no acceleration has one.

use mcs_model::Joints;
use rsruckig::prelude::ControlInterface;

use super::course::{Course, Range};
use super::segment::Courses;
use super::timing::{self, Engine, JointBounds, JointState, Motion};
use super::{Pace, Planner, Segment, Setpoint};

/// How often the blend is halved before the arm stops at the point after all.
const HALVES: u32 = 4;
/// How far beyond the box of the two ways that it replaces a bridge may lead, as a share of a joint's way in them.
const BEYOND: f64 = 1e-6;

/// The courses between two segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bridge {
    /// Where each joint is on the bridge.
    pub(super) courses: Courses,
    /// The time of the first segment at which it is left, s.
    pub(super) leave: f64,
    /// The time of the second segment at which it is joined, s.
    pub(super) join: f64,
}

impl Bridge {
    /// How long it takes, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.courses.duration()
    }

    /// Where the joints are at its end, rad or m.
    pub(super) fn end(&self) -> Joints {
        self.courses.setpoint(self.duration()).position
    }

    /// How much sooner the second segment ends than after a stop at the point, s.
    #[must_use]
    pub fn gain(&self, first: &Segment) -> f64 {
        first.duration() - self.leave + self.join - self.duration()
    }
}

impl Planner {
    /// The bridge between two segments, the second of which begins where the first ends. Of each the share `blend` (0 to 1)
    ///     /// of that half is given up that lies at the point. The share is halved while the bridge is no quicker than a stop,
    /// leads out of the box of what it replaces, or takes hardly any time. `None` when no share will do: then the arm stops
    /// at the point.
    pub fn bridge(
        &mut self,
        (first, second): (&Segment, &Segment),
        pace: Pace,
        blend: f64,
    ) -> Option<Bridge> {
        let mut share = blend.clamp(0.0, 1.0);
        for _ in 0..=HALVES {
            let bridge = self.bridge_of((first, second), pace, share);
            if bridge.is_some() || share <= 0.0 {
                return bridge;
            }
            share *= 0.5;
        }
        None
    }

    fn bridge_of(
        &mut self,
        (first, second): (&Segment, &Segment),
        pace: Pace,
        share: f64,
    ) -> Option<Bridge> {
        let given_up = |segment: &Segment| 0.5 * share * segment.duration();
        let (leave, join) = (first.duration() - given_up(first), given_up(second));
        let corner = first.end(&mut self.solver).ok()?;
        let from = first.at(&mut self.solver, leave, &corner).ok()?;
        let to = second.at(&mut self.solver, join, &corner).ok()?;
        let state = |setpoint: &Setpoint, joint: usize| JointState {
            position: setpoint.position[joint],
            velocity: setpoint.velocity[joint],
            acceleration: setpoint.acceleration[joint],
        };
        let model = self.solver.model();
        let mut motions: Vec<Motion> = Vec::with_capacity(model.dof());
        for (index, joint) in model.joints().iter().enumerate() {
            let (from, to) = (state(&from, index), state(&to, index));
            // A joint that stands on both sides may have no limits. On a line a joint may be faster than its pace.
            let limit = |limit: f64, [a, b]: [f64; 2]| {
                let limit = if limit.is_finite() { limit } else { 1.0 };
                limit.max(a.abs()).max(b.abs()) * (1.0 + 1e-9)
            };
            let limits = &joint.limits;
            let jerk = self.limits_jerk && limits.jerk.is_finite() && limits.jerk > 0.0;
            let accelerations = match jerk {
                true => [from.acceleration, to.acceleration],
                false => [0.0; 2],
            };
            let bounds = JointBounds {
                velocity: limit(limits.velocity * pace.speed, [from.velocity, to.velocity]),
                acceleration: limit(limits.acceleration * pace.acceleration, accelerations),
                jerk: if jerk {
                    limits.jerk * pace.acceleration
                } else {
                    0.0
                },
            };
            let motion = (from, to, bounds);
            timing::check(index + 1, (&from, &to), &bounds, ControlInterface::Position).ok()?;
            motions.push(motion);
        }
        let mut engine = Engine::new(motions.len(), ControlInterface::Position);
        let courses = courses_of(&mut engine, &motions)?;
        let bridge = Bridge {
            courses,
            leave,
            join,
        };
        let sooner = bridge.gain(first) > 0.0 && bridge.duration() >= 2.0 * self.check_period;
        (sooner && bridge.stays_between(&corner)).then_some(bridge)
    }
}

/// The courses that the engine finds, as plain numbers.
fn courses_of(engine: &mut Engine, motions: &[Motion]) -> Option<Courses> {
    let trajectory = engine.compute(motions).ok()?;
    let profiles = trajectory.profiles.first()?;
    // What begins beyond a limit is brought back first, which takes more phases than a course has.
    if profiles.iter().any(|profile| profile.brake.duration > 0.0) {
        return None;
    }
    let duration = trajectory.duration;
    Some(Courses::new(motions.len(), |index| {
        let profile = &profiles[index];
        let state = |phase: usize| JointState {
            position: profile.p[phase],
            velocity: profile.v[phase],
            acceleration: profile.a[phase],
        };
        let begin = |phase: usize| {
            if phase == 0 {
                0.0
            } else {
                profile.t_sum[phase - 1]
            }
        };
        Course::of_phases(duration, motions[index].1, |phase| {
            (begin(phase), state(phase), profile.j[phase])
        })
    }))
}

impl Bridge {
    /// Whether every joint stays in what lies between the bridge's ends and the point that it passes.
    fn stays_between(&self, corner: &[f64]) -> bool {
        let duration = self.duration();
        self.courses
            .each()
            .iter()
            .zip(corner)
            .all(|(course, corner)| {
                let ends = [
                    course.at(0.0).position,
                    course.at(duration).position,
                    *corner,
                ];
                let Range { least, most } = ends.into_iter().fold(Range::NONE, Range::with);
                let beyond = BEYOND * (most - least) + 1e-9;
                let reached = course.positions();
                reached.least >= least - beyond && reached.most <= most + beyond
            })
    }
}
