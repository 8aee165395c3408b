//! The planner: turns a target into a checked segment, or into a refusal that names what is wrong.
//!
//! Everything that could stop a motion half way (a limit, a pose out of reach, a singularity) is found here, before
//! anything moves. A path of the tool goes more slowly where a joint could not follow it otherwise.

use std::f64::consts::FRAC_1_SQRT_2;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::along::{Along, SECTIONS, Sections, section_of};
use super::course::Course;
use super::curve::{Curve, CurveError};
use super::interpolate::{Interpolator, Knot};
use super::segment::{Courses, SegmentError, ToolPath};
use super::timing::{JointBounds, JointState};
use super::{Name, Pace, Path, PlanningRegistry, Segment, Solver};
use mcs_model::inverse::{Elbow, IkError};
use mcs_model::{JointKind, Model};
use mcs_model::{Joints, MAX_SLOTS, TooManyJoints};

#[cfg(test)]
mod tests;

/// The least speed fraction accepted; slower motions would take hours.
pub const SLOWEST: f64 = 1e-3;
/// A path shorter than this (m, and rad of turn) is no motion.
const NO_WAY: f64 = 1e-9;
/// Most checks along one path.
const MOST_CHECKS: f64 = 20_000.0;
/// How often a path is slowed down, and followed again in thought, before it is given up.
const ROUNDS: u32 = 30;
/// A path that would take so many times as long as the tool's limits want it is refused.
const MOST_SLOWING: f64 = 20.0;
/// How much of their limits joints use on a path that is slowed down for them: what is between two checks stays unseen.
const USED: f64 = 0.98;
/// At so many moments between two solved poses jerk is seen, which is as often as the servo sees it.
const MOMENTS: u32 = 4;
/// How much more than needed a path with limits of jerk is stretched: what is between two moments stays unseen.
const CAUTION: f64 = 1.02;
/// So little progress before the end shows no accelerations, only rounding.
const LAST: f64 = 1e-5;

/// Limits of the tool's motion along a line, an arc or an arch.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CartesianLimits {
    /// Speed, m/s.
    pub linear_speed: f64,
    /// Acceleration, m/s^2.
    pub linear_acceleration: f64,
    /// Turning speed, rad/s.
    pub angular_speed: f64,
    /// Turning acceleration, rad/s^2.
    pub angular_acceleration: f64,
    /// Jerk along the path, m/s^3, where jerk is limited.
    pub linear_jerk: f64,
    /// Turning jerk, rad/s^3, where jerk is limited.
    pub angular_jerk: f64,
}

impl Default for CartesianLimits {
    /// Speeds that a PUMA's joints can follow over most of its work volume.
    fn default() -> Self {
        Self {
            linear_speed: 0.5,
            linear_acceleration: 1.5,
            angular_speed: 1.0,
            angular_acceleration: 3.0,
            linear_jerk: 15.0,
            angular_jerk: 30.0,
        }
    }
}

/// Why a motion is refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The speed is not a usable fraction.
    #[error("speed {given} is not a fraction of full speed; give a value from {SLOWEST} to 1")]
    Speed {
        /// What was given.
        given: f64,
    },
    /// The acceleration is not a usable fraction.
    #[error(
        "acceleration {given} is not a fraction of full acceleration; give a value from {SLOWEST} to 1"
    )]
    Acceleration {
        /// What was given.
        given: f64,
    },
    /// No path planner has this name.
    #[error(
        "there is no path planner `{name}`; register it, or ask for joint, direct, line, arc, about or arch"
    )]
    UnknownPath {
        /// The name.
        name: Name,
    },
    /// A path planner takes another count of numbers.
    #[error("the path takes {needed} numbers, not {given}")]
    Numbers {
        /// How many it takes.
        needed: usize,
        /// How many were given.
        given: usize,
    },
    /// A blend that is no share.
    #[error("a blend is 0 to 1, not {given}")]
    Share {
        /// What was given.
        given: f64,
    },
    /// A blend that is no distance.
    #[error("the radius of a blend is 0 or more, not {given}")]
    Distance {
        /// What was given, rad or m.
        given: f64,
    },
    /// A joint target holds a NaN or an infinity.
    #[error("the target of joint {joint} is not a finite number")]
    NotFinite {
        /// Joint number, from 1.
        joint: usize,
    },
    /// So many joint positions are not those of the arm.
    #[error("the arm has {needed} joints, and the target has {given} positions")]
    Count {
        /// Joints of the arm.
        needed: usize,
        /// Positions given.
        given: usize,
    },
    /// Without limits of speed and acceleration there is no fraction of them.
    #[error(
        "joint {joint} has no largest speed or acceleration above zero in its model; give the servo `velocity` and `acceleration`"
    )]
    NoLimit {
        /// Joint number, from 1.
        joint: usize,
    },
    /// The target itself is out of reach or beyond a joint's limits.
    #[error("{0}; choose another target")]
    Target(IkError),
    /// There is no such path.
    #[error(transparent)]
    Curve(#[from] CurveError),
    /// The path leaves what the arm can reach.
    #[error(
        "the path cannot be followed at {percent:.0} % of its length: {reason}; move joint-interpolated or through another pose"
    )]
    Path {
        /// Where on the path, percent of its length.
        percent: f64,
        /// What is wrong there.
        reason: SegmentError,
    },
    /// The path leads through a singularity, or so near one that joints could follow it only at a crawl.
    #[error(
        "the path leads through a singularity of the arm, or too near it: joints could follow it only in more than {MOST_SLOWING} times its time; the smallest singular value along it is {smallest:.2e}, at {percent:.0} % of its length; move joint-interpolated or through another pose"
    )]
    Singular {
        /// The smallest singular value of the tool's Jacobian.
        smallest: f64,
        /// Where on the path that is, percent of its length.
        percent: f64,
    },
    /// A joint would have to move too fast to follow the path.
    #[error(
        "joint {joint} would have to move at {value:.3} {unit}/s at {percent:.0} % of the path, its limit is {limit:.3} {unit}/s; slow down or move joint-interpolated",
        unit = .kind.unit()
    )]
    JointSpeed {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Speed needed, rad/s or m/s.
        value: f64,
        /// Limit, rad/s or m/s.
        limit: f64,
        /// Where on the path, percent of its length.
        percent: f64,
    },
    /// A joint's acceleration would have to change too fast.
    #[error(
        "the acceleration of joint {joint} would have to change at {value:.3} {unit}/s^3 at {percent:.0} % of the path, its limit is {limit:.3} {unit}/s^3; slow down or move joint-interpolated",
        unit = .kind.unit()
    )]
    JointJerk {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Jerk needed, rad/s^3 or m/s^3.
        value: f64,
        /// Limit, rad/s^3 or m/s^3.
        limit: f64,
        /// Where on the path, percent of its length.
        percent: f64,
    },
    /// A joint would have to accelerate (or brake in a protective stop) too hard to stay on the path.
    #[error(
        "joint {joint} would have to accelerate at {value:.3} {unit}/s^2 at {percent:.0} % of the path, its limit is {limit:.3} {unit}/s^2; slow down or move joint-interpolated",
        unit = .kind.unit()
    )]
    JointAcceleration {
        /// Joint number, from 1.
        joint: usize,
        /// Whether it turns or slides.
        kind: JointKind,
        /// Acceleration needed, rad/s^2 or m/s^2.
        value: f64,
        /// Limit, rad/s^2 or m/s^2.
        limit: f64,
        /// Where on the path, percent of its length.
        percent: f64,
    },
}

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
    /// The mean accelerations of the joints in the last period that was looked at.
    accelerations: Joints,
}

/// Plans segments for one manipulator, whose tool is the tip of its model.
#[derive(Debug, Clone)]
pub struct Planner {
    pub(super) solver: Solver,
    cartesian: CartesianLimits,
    pub(super) check_period: f64,
    pub(super) limits_jerk: bool,
    pub(super) planning: Arc<PlanningRegistry>,
}

impl Planner {
    /// A planner for `model`; paths of its tip are checked every `check_period` seconds of their motion (the time in
    /// which the servo solves one pose is the right one).
    ///
    /// # Errors
    /// [`TooManyJoints`].
    pub fn new(
        model: Arc<Model>,
        cartesian: CartesianLimits,
        check_period: f64,
    ) -> Result<Self, TooManyJoints> {
        Ok(Self {
            solver: Solver::new(model)?,
            cartesian,
            check_period,
            limits_jerk: false,
            planning: Arc::default(),
        })
    }

    /// With the path planners of a program.
    #[must_use]
    pub fn offering(mut self, planning: Arc<PlanningRegistry>) -> Self {
        self.planning = planning;
        self
    }

    /// With a way to find joint positions, for the same arm.
    #[must_use]
    pub fn solving_by(mut self, solver: Solver) -> Self {
        self.solver = solver;
        self
    }

    /// How joint positions are found.
    #[must_use]
    pub fn solver(&self) -> &Solver {
        &self.solver
    }

    /// Whether motions keep the limits of jerk that the model's joints have, and those of the tool along its path. They do
    /// not unless this is set: their accelerations jump. Stops know no limit of jerk.
    #[must_use]
    pub fn limiting_jerk(mut self, limits: bool) -> Self {
        self.limits_jerk = limits;
        self
    }

    /// The arm planned for.
    #[must_use]
    pub fn model(&self) -> &Arc<Model> {
        self.solver.model()
    }

    /// `base_t_tool` at joint positions `q` (rad or m).
    pub fn tool_pose(&mut self, q: &[f64]) -> Isometry3<f64> {
        self.solver.pose(q)
    }

    /// Joint positions (rad or m) that put the tool at `base_t_tool`, near `near`: see [`Solver::nearest`].
    ///
    /// # Errors
    /// [`PlanError::Target`] with the reason.
    pub fn joints_for(
        &mut self,
        base_t_tool: &Isometry3<f64>,
        near: &Joints,
        elbow: Option<Elbow>,
    ) -> Result<Joints, PlanError> {
        let found = self.solver.nearest(base_t_tool, near, elbow);
        found.map_err(PlanError::Target)
    }

    /// A joint target itself, checked against the limits.
    ///
    /// # Errors
    /// [`PlanError::Count`], [`PlanError::NotFinite`] or [`PlanError::Target`].
    pub fn check_joints(&self, q: &[f64]) -> Result<(), PlanError> {
        let model = self.model();
        let (needed, given) = (model.dof(), q.len());
        if needed != given {
            return Err(PlanError::Count { needed, given });
        }
        if let Some(index) = q.iter().position(|value| !value.is_finite()) {
            return Err(PlanError::NotFinite { joint: index + 1 });
        }
        let Some(index) = model.joint_outside(q) else {
            return Ok(());
        };
        let joint = &model.joints()[index];
        Err(PlanError::Target(IkError::JointLimit {
            joint: index + 1,
            kind: joint.kind,
            value: q[index],
            lower: joint.limits.lower,
            upper: joint.limits.upper,
        }))
    }

    /// A joint-interpolated motion: all joints start and stop together. Each is on the quickest course that `pace`
    /// (fractions of full speed and acceleration; one number is both) leaves it, stretched to the time of the slowest.
    ///
    /// # Errors
    /// A pace that is no fraction, a target that is no number or beyond a limit.
    pub fn joint(
        &self,
        start: &Joints,
        end: &Joints,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let pace = pace.into().check()?;
        self.check_joints(end)?;
        let mut courses = [Course::default(); MAX_SLOTS];
        let mut together = 0.0_f64;
        let joints = self.model().joints().iter().zip(&mut courses);
        let ends = start.iter().zip(end);
        for (index, ((joint, course), (from, to))) in joints.zip(ends).enumerate() {
            let limits = &joint.limits;
            let usable = |limit: f64| limit > 0.0 && limit.is_finite();
            if from == to {
                *course = Course::still(*to);
                continue;
            }
            if !usable(limits.velocity) || !usable(limits.acceleration) {
                return Err(PlanError::NoLimit { joint: index + 1 });
            }
            let limits_jerk = self.limits_jerk && usable(limits.jerk);
            let bounds = JointBounds {
                velocity: limits.velocity * pace.speed,
                acceleration: limits.acceleration * pace.acceleration,
                jerk: match limits_jerk {
                    true => limits.jerk * pace.acceleration,
                    false => 0.0,
                },
            };
            *course = Course::rest_to_rest(*from, *to, &bounds);
            together = together.max(course.duration());
        }
        let stretched = |index: usize| {
            let course = &courses[index];
            match course.duration() {
                0.0 => *course,
                least => course.stretched(together / least),
            }
        };
        let courses = Courses::new(end.len(), stretched);
        Ok(Segment::new(Path::Joint(courses)))
    }

    /// A straight line in the space of the joints: all joints in proportion, in the least time that `pace` leaves the one
    /// that needs longest. What is free of obstacles on that line, the arm does not touch.
    ///
    /// # Errors
    /// As [`Self::joint`].
    pub fn direct(
        &self,
        start: &Joints,
        end: &Joints,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let pace = pace.into().check()?;
        self.check_joints(end)?;
        // Of the progress from 0 to 1.
        let mut bounds = JointBounds {
            velocity: f64::INFINITY,
            acceleration: f64::INFINITY,
            jerk: f64::INFINITY,
        };
        let joints = self.model().joints().iter().enumerate();
        for ((index, joint), (from, to)) in joints.zip(start.iter().zip(end)) {
            let (limits, way) = (&joint.limits, (to - from).abs());
            let usable = |limit: f64| limit > 0.0 && limit.is_finite();
            if way == 0.0 {
                continue;
            }
            if !usable(limits.velocity) || !usable(limits.acceleration) {
                return Err(PlanError::NoLimit { joint: index + 1 });
            }
            let speed = limits.velocity * pace.speed / way;
            let acceleration = limits.acceleration * pace.acceleration / way;
            bounds.velocity = bounds.velocity.min(speed);
            bounds.acceleration = bounds.acceleration.min(acceleration);
            if self.limits_jerk && usable(limits.jerk) {
                bounds.jerk = bounds.jerk.min(limits.jerk * pace.acceleration / way);
            }
        }
        if bounds.velocity.is_infinite() {
            return Ok(Segment::new(Path::Joint(Courses::new(
                end.len(),
                |index| Course::still(end[index]),
            ))));
        }
        if bounds.jerk.is_infinite() {
            // None is limited.
            bounds.jerk = 0.0;
        }
        let progress: Course = Course::rest_to_rest(0.0, 1.0, &bounds);
        let courses = Courses::new(end.len(), |index| progress.scaled(start[index], end[index]));
        Ok(Segment::new(Path::Joint(courses)))
    }

    /// A straight line of the tool to `base_t_tool`, turning about one axis. An arm with a closed form keeps its posture;
    /// another moves its joints as little as it can. The path is followed in thought, point by point, before it is
    /// accepted, and is slowed down where a joint could not follow.
    ///
    /// # Errors
    /// The first thing that is wrong on it.
    pub fn line(
        &mut self,
        start: &Joints,
        base_t_tool: &Isometry3<f64>,
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::line(from, base_t_tool.translation.vector);
        self.along(start, (curve, base_t_tool), pace.into())
    }

    /// The arc of a circle through a point (base frame, m) to `base_t_tool`, else as [`Self::line`].
    ///
    /// # Errors
    /// [`PlanError::Curve`], and as [`Self::line`].
    pub fn arc_through(
        &mut self,
        start: &Joints,
        (via, base_t_tool): (Vector3<f64>, &Isometry3<f64>),
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::through(from, via, base_t_tool.translation.vector)?;
        self.along(start, (curve, base_t_tool), pace.into())
    }

    /// The arc of a circle about a centre (base frame, m) to `base_t_tool`, the shorter way round or the longer one, else
    /// as [`Self::line`].
    ///
    /// # Errors
    /// [`PlanError::Curve`], and as [`Self::line`].
    pub fn arc_about(
        &mut self,
        start: &Joints,
        (centre, longer, base_t_tool): (Vector3<f64>, bool, &Isometry3<f64>),
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::about(from, centre, base_t_tool.translation.vector, longer)?;
        self.along(start, (curve, base_t_tool), pace.into())
    }

    /// Up, across and down to `base_t_tool`, over an obstacle that the base's z axis points away from: the tool is `height`
    /// (m) above the higher end while it goes across. Corners are rounded with a radius, m, or as wide as there is room.
    /// Else as [`Self::line`].
    ///
    /// # Errors
    /// [`PlanError::Curve`], and as [`Self::line`].
    pub fn arch(
        &mut self,
        start: &Joints,
        (height, corner, base_t_tool): (f64, Option<f64>, &Isometry3<f64>),
        pace: impl Into<Pace>,
    ) -> Result<Segment, PlanError> {
        let from = self.tool_pose(start).translation.vector;
        let curve = Curve::arch(from, base_t_tool.translation.vector, height, corner)?;
        self.along(start, (curve, base_t_tool), pace.into())
    }

    /// The tool along a curve, turning about one axis: first as fast as the tool's limits have it, then more slowly in the
    /// sections where a joint cannot follow, until all can.
    fn along(
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
            for (index, joint) in self.model().joints().iter().enumerate() {
                let limits = &joint.limits;
                let state = between.state(index, along);
                // Means of the periods, as the servo announces them.
                let mean = (between.state(index, then).velocity - state.velocity) / apart;
                let value = (mean - walk.accelerations[index]).abs() / apart;
                walk.accelerations[index] = mean;
                let braked = JointState {
                    acceleration: -path.along.braking(time, time + step),
                    ..along
                };
                let braked = between.state(index, braked);
                let hardest = state.acceleration.abs().max(braked.acceleration.abs());
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
        let knot = path.knot(&mut self.solver, progress, near);
        knot.map_err(|reason| PlanError::Path {
            percent: 100.0 * progress,
            reason,
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
