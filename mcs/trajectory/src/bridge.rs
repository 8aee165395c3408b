//! The way from one segment into the next past the point where both meet: a blend.
//!
//! The arm leaves the first segment before its end and joins the second one after its start. Between both every joint goes
//! from state to state under its own limits, in the least time that is common to all. No speed has a step. With a limit of
//! jerk no acceleration has one.

use mcs_model::Joints;
use nalgebra::Vector3;
use rsruckig::prelude::ControlInterface;
use serde::{Deserialize, Serialize};

use super::course::{Course, Range};
use super::interpolate::Interpolator;
use super::segment::{Courses, ToolPath};
use super::timing::{self, Engine, JointBounds, JointState, Motion};
use super::{Pace, Path, PlanError, Planner, Segment, Setpoint};

/// How often the blend is halved before the arm stops at the point after all.
const HALVES: u32 = 4;
/// How far beyond the box of the two ways that it replaces a bridge may lead, as a share of a joint's way in them.
const BEYOND: f64 = 1e-6;

/// At so many places of a segment's half it is seen how far they are from its end, and of a bridge.
const PLACES: u32 = 32;
/// So often the place of a distance is looked for between two of them.
const BISECTIONS: u32 = 30;

/// How much of two segments may give way to a bridge past the point where they meet; never more than the half of each that
/// lies at the point. Zero is a stop at the point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Blend {
    /// This share of the time of both halves, 0 to 1.
    Share(f64),
    /// What is nearer to the tool's place at the point, m. The bridge stays within it, too.
    Radius(f64),
    /// Where no joint is farther from its position at the point, rad or m. So it is on the bridge, too.
    Joints(f64),
}

impl Default for Blend {
    fn default() -> Self {
        Self::Share(0.0)
    }
}

impl From<f64> for Blend {
    fn from(share: f64) -> Self {
        Self::Share(share)
    }
}

impl Blend {
    /// # Errors
    /// [`PlanError::Share`] or [`PlanError::Distance`].
    pub fn check(self) -> Result<(), PlanError> {
        match self {
            Self::Share(given) if !(0.0..=1.0).contains(&given) => Err(PlanError::Share { given }),
            Self::Radius(given) | Self::Joints(given) if !(0.0..f64::INFINITY).contains(&given) => {
                Err(PlanError::Distance { given })
            }
            _ => Ok(()),
        }
    }
}

/// The courses between two segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bridge {
    /// Where each joint is on the bridge.
    pub(super) courses: Courses,
    /// The time of the first segment at which it is left, s.
    pub(super) leave: f64,
    /// The time of the second segment at which it is joined, s.
    pub(super) join: f64,
    /// Joint positions (rad or m) at the last pose of the second segment that is solved before, by which the next ones are
    /// found.
    pub(super) near: Joints,
}

impl Bridge {
    /// How long it takes, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.courses.duration()
    }

    /// How much sooner the second segment ends than after a stop at the point, s.
    #[must_use]
    pub fn gain(&self, first: &Segment) -> f64 {
        first.duration() - self.leave + self.join - self.duration()
    }
}

impl Planner {
    /// The bridge between two segments, the second of which begins where the first ends. What is given up of both is
    /// halved while the bridge is no quicker than a stop, leads out of what it replaces, or takes hardly any time. `None`
    /// when nothing will do: then the arm stops at the point.
    pub fn bridge(
        &mut self,
        (first, second): (&Segment, &Segment),
        pace: Pace,
        blend: impl Into<Blend>,
    ) -> Option<Bridge> {
        let blend = blend.into();
        let corner = first.end(&mut self.solver).ok()?;
        let place = self.tool_pose(&corner).translation.vector;
        let before = self.given_up(blend, (first, true), (&corner, &place))?;
        let after = self.given_up(blend, (second, false), (&corner, &place))?;
        if before <= 0.0 && after <= 0.0 {
            return None;
        }
        let mut share = 1.0;
        for _ in 0..=HALVES {
            let times = (first.duration() - share * before, share * after);
            let bridge = self.bridge_of((first, second), pace, times, &corner);
            if let Some(bridge) = bridge
                && self.stays_near(&bridge, blend, &place)
            {
                return Some(bridge);
            }
            share *= 0.5;
        }
        None
    }

    /// How much of a segment's half at its end, or at its start, is given up, s.
    fn given_up(
        &mut self,
        blend: Blend,
        (segment, at_end): (&Segment, bool),
        (corner, place): (&Joints, &Vector3<f64>),
    ) -> Option<f64> {
        let half = 0.5 * segment.duration();
        let most = match blend {
            Blend::Share(share) => return Some(half * share.clamp(0.0, 1.0)),
            Blend::Radius(most) | Blend::Joints(most) => most,
        };
        let is_far = |planner: &mut Self, from_corner: f64| {
            let time = match at_end {
                true => segment.duration() - from_corner,
                false => from_corner,
            };
            let distance = match (blend, segment.path()) {
                (Blend::Radius(_), Path::Tool(path)) => {
                    let [there, ..] = path.curve.at(path.along.at(time).position);
                    (there - place).norm()
                }
                (Blend::Radius(_), Path::Joint(courses)) => {
                    let there = planner.tool_pose(&courses.setpoint(time).position);
                    (there.translation.vector - place).norm()
                }
                _ => {
                    let joints = planner.planned(segment, time)?.0.position;
                    let pairs = joints.iter().zip(corner);
                    pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
                }
            };
            Some(distance > most)
        };
        // The first place on the way from the corner that is too far: what comes back later counts no more.
        let step = half / f64::from(PLACES);
        let mut near = 0.0;
        for count in 1..=PLACES {
            let mut far = f64::from(count) * step;
            if !is_far(self, far)? {
                near = far;
                continue;
            }
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (near + far);
                match is_far(self, middle)? {
                    true => far = middle,
                    false => near = middle,
                }
            }
            return Some(near);
        }
        Some(half)
    }

    /// Whether the tool stays as near to the point as a blend wants it.
    fn stays_near(&mut self, bridge: &Bridge, blend: Blend, place: &Vector3<f64>) -> bool {
        let Blend::Radius(most) = blend else {
            return true;
        };
        let step = bridge.duration() / f64::from(PLACES);
        (0..=PLACES).all(|count| {
            let joints = bridge.courses.setpoint(f64::from(count) * step).position;
            let off = self.tool_pose(&joints).translation.vector - place;
            off.norm() <= most * (1.0 + BEYOND) + 1e-9
        })
    }

    /// Where a segment has the joints at some time, s: of a path of the tool on the cubics between the poses that the servo
    /// solves. And the joint positions at the solved pose before.
    fn planned(&mut self, segment: &Segment, time: f64) -> Option<(Setpoint, Joints)> {
        match segment.path() {
            Path::Joint(courses) => {
                let setpoint = courses.setpoint(time);
                Some((setpoint, setpoint.position))
            }
            Path::Tool(path) => self.planned_on(path, time),
        }
    }

    fn planned_on(&mut self, path: &ToolPath, time: f64) -> Option<(Setpoint, Joints)> {
        let period = self.check_period;
        let count = (time / period).floor();
        let late = time > 0.5 * path.along.duration();
        let mut near = if late {
            path.end_joints
        } else {
            path.start_joints
        };
        // Without a closed form, and after a near pass of a singularity, the joints are where the way led them.
        if path.branch.is_none() || path.slowed > 1.0 {
            near = path.start_joints;
            for step in 0..count as u64 {
                let progress = path.along.at(step as f64 * period).position;
                near = self
                    .solver
                    .follow(&path.pose(progress), path.branch, &near)
                    .ok()?;
            }
        }
        let from = path.along.at(count * period).position;
        let from = path.knot(&mut self.solver, from, &near).ok()?;
        let to = path.along.at((count + 1.0) * period).position;
        let to = path.knot(&mut self.solver, to, &from.position).ok()?;
        let between = Interpolator::new(from, to);
        let along = path.along.at(time);
        let mut setpoint = Setpoint::at_rest(from.position);
        for index in 0..from.position.len() {
            let state = between.state(index, along);
            setpoint.position[index] = state.position;
            setpoint.velocity[index] = state.velocity;
            setpoint.acceleration[index] = state.acceleration;
        }
        Some((setpoint, from.position))
    }

    fn bridge_of(
        &mut self,
        (first, second): (&Segment, &Segment),
        pace: Pace,
        (leave, join): (f64, f64),
        corner: &Joints,
    ) -> Option<Bridge> {
        let (from, _) = self.planned(first, leave)?;
        let (to, near) = self.planned(second, join)?;
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
            near,
        };
        let sooner = bridge.gain(first) > 0.0 && bridge.duration() >= 2.0 * self.check_period;
        (sooner && bridge.stays_between(corner)).then_some(bridge)
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
