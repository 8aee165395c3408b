//! Paths of the tool: followed in thought before they are driven, and slowed down where a joint could not follow.

use std::f64::consts::FRAC_1_SQRT_2;

use mcs_model::Joints;
use nalgebra::{Isometry3, Vector3};

use super::error::MOST_SLOWING;
use super::{PlanError, Planner};
use crate::along::{Along, SECTIONS, Sections, section_of};
use crate::curve::Curve;
use crate::interpolate::{Interpolator, Knot};
use crate::segment::{SegmentError, ToolPath};
use crate::timing::{JointBounds, JointState};
use crate::{Pace, Path, Segment};

/// A path shorter than this (m, and rad of turn) is no motion.
const NO_WAY: f64 = 1e-9;
/// Most checks along one path.
const MOST_CHECKS: f64 = 20_000.0;
/// How often a path is slowed down, and followed again in thought, before it is given up.
const ROUNDS: u32 = 30;
/// How much of their limits joints use on a path that is slowed down for them: what is between two checks stays unseen.
const USED: f64 = 0.98;
/// At so many moments between two solved poses jerk is seen, which is as often as the servo sees it.
const MOMENTS: u32 = 4;
/// How much more than needed a path with limits of jerk is stretched: what is between two moments stays unseen.
const CAUTION: f64 = 1.02;
/// So little progress before the end shows no accelerations, only rounding.
const LAST: f64 = 1e-5;

/// What a section of a path asks of the joints per progress, as the hardest of them has it.
#[derive(Debug, Clone, Copy, Default)]
struct Need {
    /// Slope of the positions, in speed limits: s.
    speed: f64,
    /// The same, in acceleration limits: s^2.
    pull: f64,
    /// Slope of the slope, in acceleration limits: s^2.
    bend: f64,
}

impl Need {
    /// Speed (1/s) and acceleration (1/s^2) of the progress that joints can follow, within those of the tool. The
    /// acceleration of a joint comes half from its speed along a path that bends and half from the tool's acceleration.
    fn within(&self, (speed, acceleration): (f64, f64)) -> (f64, f64) {
        let half = 0.5 * USED;
        let speed = speed.min(USED / self.speed).min((half / self.bend).sqrt());
        (speed, acceleration.min(half / self.pull))
    }
}

/// What following a path in thought found.
struct Walk {
    /// The joint positions at its end, rad or m.
    end: Joints,
    /// The smallest singular value of the tool's Jacobian, and where it is, percent of the length.
    smallest: (f64, f64),
    /// What first was beyond a limit.
    beyond: Option<PlanError>,
    /// How many times as long all of it must take for every limit to be kept.
    excess: f64,
    /// The mean accelerations of the joints in the last period that was looked at,
    accelerations: Joints,
    /// and how the slopes of their positions changed with the progress at its begin.
    bends: Joints,
}

impl Planner {
    /// The tool along a curve, turning about one axis: first as fast as the tool's limits have it, then more slowly in the
    /// sections where a joint cannot follow, until all can.
    pub(super) fn along(
        &mut self,
        start: &Joints,
        (curve, base_t_tool): (Curve, &Isometry3<f64>),
        pace: Pace,
    ) -> Result<Segment, PlanError> {
        let pace = pace.check()?;
        let start_pose = self.tool_pose(start);
        let turn = base_t_tool.rotation * start_pose.rotation.inverse();
        let (axis, angle) = turn.axis_angle().unwrap_or((Vector3::z_axis(), 0.0));
        let branch = self.solver.branch_of(start);
        // The end first: a target out of reach is a clearer refusal than a path that leaves the reach.
        let end_joints = match branch {
            Some(_) => self.solver.follow(base_t_tool, branch, start),
            None => self.solver.nearest(base_t_tool, start, None),
        }
        .map_err(PlanError::Target)?;
        if curve.length() < NO_WAY && angle < NO_WAY {
            return Ok(Segment::hold(*start));
        }
        let width = 1.0 / SECTIONS as f64;
        let own: Sections = std::array::from_fn(|index| {
            let (from, to) = (index as f64 * width, (index + 1) as f64 * width);
            self.tool_limits(curve.length(), angle, curve.curvature(from, to), pace)
        });
        let least = |(speed, acceleration): (f64, f64), own: &(f64, f64)| {
            (speed.min(own.0), acceleration.min(own.1))
        };
        let (velocity, acceleration) = own.iter().fold((f64::INFINITY, f64::INFINITY), least);
        let limits = &self.cartesian;
        let jerk = (limits.linear_jerk / curve.length()).min(limits.angular_jerk / angle);
        let even = Along::even(&JointBounds {
            velocity,
            acceleration,
            jerk: match self.limits_jerk {
                true => jerk * pace.acceleration,
                false => 0.0,
            },
        });
        let along = match self.limits_jerk || curve.is_even() {
            true => even,
            false => Along::within(&own),
        };
        let wanted = along.duration();
        let mut path = ToolPath {
            curve,
            orientation: start_pose.rotation,
            axis,
            angle,
            branch,
            start_joints: *start,
            end_joints,
            along,
            smallest_singular_value: f64::INFINITY,
            slowed: 1.0,
        };
        let mut needs = [Need::default(); SECTIONS];
        for _ in 0..ROUNDS {
            let walk = self.walk(&path, start, &mut needs)?;
            path.end_joints = walk.end;
            let (smallest, percent) = walk.smallest;
            path.smallest_singular_value = smallest;
            if walk.beyond.is_none() {
                return Ok(Segment::new(Path::Tool(path)));
            }
            path.along = match self.limits_jerk {
                // Sections would begin and end with a jump of the acceleration.
                true => path.along.stretched(walk.excess.max(CAUTION)),
                false => Along::within(&std::array::from_fn(|index| {
                    needs[index].within(own[index])
                })),
            };
            path.slowed = path.along.duration() / wanted;
            if path.slowed.is_nan() || path.slowed > MOST_SLOWING {
                return Err(PlanError::Singular { smallest, percent });
            }
        }
        let walk = self.walk(&path, start, &mut needs)?;
        let segment = Segment::new(Path::Tool(path));
        walk.beyond.map_or(Ok(segment), Err)
    }

    /// Speed (1/s) and acceleration (1/s^2) of the progress that the tool's limits allow on a path of some length (m), turn
    /// (rad) and curvature (1/m). On an arc the acceleration along it and the one towards its centre get the same share.
    fn tool_limits(&self, length: f64, angle: f64, curvature: f64, pace: Pace) -> (f64, f64) {
        let limits = &self.cartesian;
        let scale = |linear: f64, angular: f64| (linear / length).min(angular / angle);
        let speed = scale(limits.linear_speed, limits.angular_speed) * pace.speed;
        let acceleration = scale(limits.linear_acceleration, limits.angular_acceleration);
        let acceleration = acceleration * pace.acceleration;
        if curvature <= 0.0 {
            return (speed, acceleration);
        }
        let share = FRAC_1_SQRT_2 * limits.linear_acceleration * pace.acceleration / length;
        let inward = (share / (curvature * length)).sqrt();
        (speed.min(inward), acceleration.min(share))
    }

    /// Follows a path in thought, as planned and as braked from every point of it, to the joint positions at its end.
    /// Poses are solved and joined by cubics as the servo does it, whose accelerations are those that count: without a
    /// closed form they are not the least ones of each pose.
    fn walk(
        &mut self,
        path: &ToolPath,
        start: &Joints,
        needs: &mut [Need; SECTIONS],
    ) -> Result<Walk, PlanError> {
        let duration = path.along.duration();
        let step = self.check_period.max(duration / MOST_CHECKS);
        let mut last = self.knot(path, 0.0, start)?;
        let mut walk = Walk {
            end: last.position,
            smallest: (self.solver.smallest_singular_value(&last.position), 0.0),
            beyond: None,
            excess: 1.0,
            accelerations: Joints::zeros(start.len()),
            bends: Joints::zeros(start.len()),
        };
        let mut time = 0.0;
        while time < duration {
            let progress = path.along.at(time + step).position;
            let next = self.knot(path, progress, &last.position)?;
            let smallest = self.solver.smallest_singular_value(&next.position);
            if smallest < walk.smallest.0 {
                walk.smallest = (smallest, 100.0 * progress);
            }
            if time + step < duration || progress - last.progress > LAST {
                let between = Interpolator::new(last, next);
                self.need_of(&between, needs);
                let beyond = self.check_between(path, &between, (time, step));
                walk.beyond = walk.beyond.or(beyond.err());
                if self.limits_jerk {
                    self.check_jerk(path, &between, (time, step), &mut walk);
                }
            }
            last = next;
            time += step;
        }
        walk.end = last.position;
        Ok(walk)
    }

    /// Sees how much longer a path would have to take, so that the joints keep their limits, that of jerk among them. It
    /// looks at a few moments between two solved poses.
    fn check_jerk(
        &self,
        path: &ToolPath,
        between: &Interpolator,
        (time, step): (f64, f64),
        walk: &mut Walk,
    ) {
        let apart = step / f64::from(MOMENTS);
        for moment in 0..MOMENTS {
            let now = time + f64::from(moment) * apart;
            let [along, then] = [now, now + apart].map(|time| path.along.at(time));
            let (braking, jerk) = (path.along.braking(now, now), path.along.jerk());
            for (index, joint) in self.model().joints().iter().enumerate() {
                let limits = &joint.limits;
                let state = between.state(index, along);
                // Means of the periods, as the servo announces them.
                let mean = (between.state(index, then).velocity - state.velocity) / apart;
                let value = (mean - walk.accelerations[index]).abs() / apart;
                walk.accelerations[index] = mean;
                // What a stop from here, or on the way to rest, asks for at most.
                let [_, slope, bend] = between.at(index, along.position);
                let braked = bend.abs() * along.velocity.powi(2) + slope.abs() * braking;
                let hardest = state.acceleration.abs().max(braked);
                let before = std::mem::replace(&mut walk.bends[index], bend);
                let stop = (bend - before).abs() * along.velocity.powi(2) / apart
                    + 3.0 * bend.abs() * along.velocity * braking
                    + slope.abs() * jerk;
                let value = value.max(stop);
                let jerk = match limits.jerk > 0.0 {
                    true => value / limits.jerk,
                    false => 0.0,
                };
                let times = (state.velocity.abs() / limits.velocity)
                    .max((hardest / limits.acceleration).sqrt())
                    .max(jerk.cbrt());
                if times * CAUTION > 1.0 {
                    // A little more, so that it is not looked for in ever smaller steps.
                    walk.excess = walk.excess.max(times * CAUTION * CAUTION);
                    let limit = limits.jerk;
                    walk.beyond = walk.beyond.or(Some(PlanError::JointJerk {
                        joint: index + 1,
                        kind: joint.kind,
                        value,
                        limit,
                        percent: 100.0 * along.position,
                    }));
                }
            }
        }
    }

    fn knot(&mut self, path: &ToolPath, progress: f64, near: &[f64]) -> Result<Knot, PlanError> {
        let (knot, percent) = (
            path.knot(&mut self.solver, progress, near),
            100.0 * progress,
        );
        knot.map_err(|reason| match reason {
            // No time is long enough. The value is that of the last pose before it.
            SegmentError::Singular => PlanError::Singular {
                smallest: self.solver.smallest_singular_value(near),
                percent,
            },
            reason => PlanError::Path { percent, reason },
        })
    }

    /// Adds what the joints do between two solved poses to what the sections there need.
    fn need_of(&self, between: &Interpolator, needs: &mut [Need; SECTIONS]) {
        let (from, to) = (between.start(), between.end());
        let way = to.progress - from.progress;
        let mut need = Need::default();
        for (index, joint) in self.model().joints().iter().enumerate() {
            let limits = &joint.limits;
            let mean = (to.position[index] - from.position[index]) / way;
            need.speed = need.speed.max(mean.abs() / limits.velocity);
            for share in [0.0, 0.5, 1.0] {
                let [_, slope, bend] = between.at(index, from.progress + share * way);
                need.speed = need.speed.max(slope.abs() / limits.velocity);
                need.pull = need.pull.max(slope.abs() / limits.acceleration);
                need.bend = need.bend.max(bend.abs() / limits.acceleration);
            }
        }
        let touched = section_of(from.progress)..=section_of(to.progress);
        for section in needs.get_mut(touched).unwrap_or_default() {
            section.speed = section.speed.max(need.speed);
            section.pull = section.pull.max(need.pull);
            section.bend = section.bend.max(need.bend);
        }
    }

    /// Checks what the joints do from one solved pose to the next, at some time (s) of a path and for so long (s).
    fn check_between(
        &self,
        path: &ToolPath,
        between: &Interpolator,
        (time, step): (f64, f64),
    ) -> Result<(), PlanError> {
        let moving = path.along.ranges(time, time + step);
        let hardest = [
            moving.acceleration.least,
            moving.acceleration.most,
            -path.along.braking(time, time + step),
        ];
        for share in [0.0, 0.5, 1.0] {
            let along = path.along.at(time + share * step);
            self.check_joints_on(between, along, hardest)?;
        }
        let (from, to) = (between.start(), between.end());
        self.check_step(&from.position, &to.position, step, 100.0 * from.progress)
    }

    /// Checks what the joints do between two solved poses while the tool is `along` the path, under some accelerations of
    /// the progress, 1/s^2.
    fn check_joints_on(
        &self,
        between: &Interpolator,
        along: JointState,
        accelerations: [f64; 3],
    ) -> Result<(), PlanError> {
        let percent = 100.0 * along.position;
        for (index, joint) in self.model().joints().iter().enumerate() {
            let (kind, limit) = (joint.kind, &joint.limits);
            let [_, slope, bend] = between.at(index, along.position);
            let value = (slope * along.velocity).abs();
            if value > limit.velocity {
                return Err(PlanError::JointSpeed {
                    joint: index + 1,
                    kind,
                    value,
                    limit: limit.velocity,
                    percent,
                });
            }
            for acceleration in accelerations {
                let value = bend * along.velocity * along.velocity + slope * acceleration;
                if value.abs() > limit.acceleration {
                    return Err(PlanError::JointAcceleration {
                        joint: index + 1,
                        kind,
                        value: value.abs(),
                        limit: limit.acceleration,
                        percent,
                    });
                }
            }
        }
        Ok(())
    }

    /// A joint must get from check to check at its speed limit: a whole turn or another posture in
    /// between shows here and not in the speeds at the checks.
    fn check_step(
        &self,
        from: &[f64],
        to: &[f64],
        step: f64,
        percent: f64,
    ) -> Result<(), PlanError> {
        for (index, joint) in self.model().joints().iter().enumerate() {
            let limit = joint.limits.velocity;
            let way = (to[index] - from[index]).abs();
            if way > limit * step + 1e-6 {
                return Err(PlanError::JointSpeed {
                    joint: index + 1,
                    kind: joint.kind,
                    value: way / step,
                    limit,
                    percent,
                });
            }
        }
        Ok(())
    }
}
