//! The way of the setpoint to a goal that moves: within limits of speed and acceleration, and to rest at the goal in about the least
//! time (SORMA technical report, section 2.2.8). Knows no tasks: a call is a period.
//!
//! Far from the goal the profile is a trapezoid: the setpoint comes as fast as it can still brake. The last bit is exponential, which
//! takes up the small corrections of an estimate without a jerk.

use nalgebra::{Point3, Vector3};
use serde::Deserialize;

use crate::{joint_limits::JointLimits, walls::Walls};

/// Part of the acceleration that is planned with; the rest is for goals that change their speed.
const PLANNED: f64 = 0.7;

/// Limits of a course.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CourseArgs {
    /// Highest speed, m/s.
    pub speed: f64,
    /// Highest acceleration, m/s^2.
    pub acceleration: f64,
    /// Time constant of the last bit of the way, s.
    pub settle_s: f64,
    /// A goal that is predicted to move faster than this is met no more than by so much faster, m/s: a hand that comes up faster
    /// cannot brake when the goal turns. One that rests is reached in the least time.
    pub closing: f64,
}

impl Default for CourseArgs {
    fn default() -> Self {
        Self {
            speed: 1.0,
            acceleration: 6.0,
            settle_s: 0.05,
            closing: 0.3,
        }
    }
}

impl CourseArgs {
    /// The first number that cannot be, by its key.
    #[must_use]
    pub fn wrong(&self) -> Option<(&'static str, f64)> {
        let all = [
            ("speed", self.speed),
            ("acceleration", self.acceleration),
            ("settle_s", self.settle_s),
            ("closing", self.closing),
        ];
        let wrong = |(_, value): &(_, f64)| !(*value > 0.0 && *value <= 100.0);
        all.into_iter().find(wrong)
    }
}

/// A setpoint under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Course {
    args: CourseArgs,
    /// Where it is, m.
    pub place: Point3<f64>,
    /// How fast it goes, m/s.
    pub velocity: Vector3<f64>,
    /// How fast the joints go for that, rad/s.
    joints: Vector3<f64>,
}

impl Course {
    /// At rest.
    #[must_use]
    pub fn at_rest(args: CourseArgs, place: Point3<f64>) -> Self {
        Self {
            args,
            place,
            velocity: Vector3::zeros(),
            joints: Vector3::zeros(),
        }
    }

    /// How fast it would go towards a goal that moves with a velocity and is there at the end of a period of so many s, m/s. The goal's
    /// motion is `predicted`, or it is only where it was. The joints allow the hand to brake with `brakes`, m/s^2.
    #[must_use]
    pub fn wanted(
        &self,
        goal: &Point3<f64>,
        moving: &Vector3<f64>,
        predicted: bool,
        brakes: f64,
        period: f64,
    ) -> Vector3<f64> {
        let CourseArgs {
            speed,
            acceleration,
            settle_s,
            closing,
        } = self.args;
        let acceleration = acceleration.min(brakes);
        let way = goal - moving * period - self.place;
        let left = way.norm();
        // v(d) = d/T near the goal, and further off as fast as it can brake: the two meet with one slope at d = a T^2.
        let braking = PLANNED * acceleration;
        let near = braking * settle_s * settle_s;
        let towards = if left <= near {
            left / settle_s
        } else {
            (braking * (2.0 * left - near)).sqrt()
        };
        let turns = match predicted {
            true => (moving.norm() / closing).min(1.0),
            false => 0.0,
        };
        let towards = towards - turns * (towards - closing).max(0.0);
        let direction = way.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        clipped(moving + direction * towards, speed)
    }

    /// Goes on by a period, s, as fast as is `wanted`, and as walls and joints allow. It goes no faster than `safe` now: what it touches
    /// or a wall asks for comes first, whatever the joints are rated for. The change of the velocity is never more than the
    /// acceleration allows.
    pub fn follow_within(
        &mut self,
        walls: &Walls,
        joints: &JointLimits,
        [safe, wanted]: [Vector3<f64>; 2],
        period: f64,
    ) {
        let most = self.args.acceleration * period;
        let brakes = walls.allow(&self.place, safe, period) - self.velocity;
        let brakes = clipped(brakes, most);
        // Both velocities are allowed, and so is all that is between them.
        let wanted = joints.slowed(wanted);
        let braked = self.velocity + brakes;
        let more = walls.allow(&self.place, wanted, period) - braked;
        let more = more * part_within(&brakes, &more, most);
        let change = brakes + joints.limited(&self.joints, &braked, &more, period);
        let before = self.velocity;
        self.velocity += change;
        self.joints = joints.speeds(&self.velocity);
        self.place += 0.5 * (before + self.velocity) * period;
    }

    /// How large a change of the velocity within a period is, as a part of what the limit allows.
    #[must_use]
    pub fn ratio(&self, before: &Vector3<f64>, period: f64) -> f64 {
        (self.velocity - before).norm() / (self.args.acceleration * period)
    }
}

/// The largest part of `more`, up to all of it, with which `first` becomes no longer than `most`; `first` is no longer.
fn part_within(first: &Vector3<f64>, more: &Vector3<f64>, most: f64) -> f64 {
    if more.norm_squared() == 0.0 || (first + more).norm() <= most {
        return 1.0;
    }
    let (square, half) = (more.norm_squared(), first.dot(more));
    let room = (most * most - first.norm_squared()).max(0.0);
    ((half * half + square * room).sqrt() - half) / square
}

/// The vector, no longer than `most`.
fn clipped(vector: Vector3<f64>, most: f64) -> Vector3<f64> {
    let length = vector.norm();
    if length > most {
        vector * (most / length)
    } else {
        vector
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD: f64 = 0.0045;

    impl Course {
        /// Goes on by a period towards a goal whose motion is predicted.
        fn go(&mut self, goal: &Point3<f64>, moving: &Vector3<f64>, period: f64) {
            let wanted = self.wanted(goal, moving, true, f64::INFINITY, period);
            let both = [self.velocity, wanted];
            self.follow_within(&Walls::default(), &JointLimits::NONE, both, period);
        }
    }

    fn vector() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0..1.0_f64).prop_map(Vector3::from)
    }

    proptest! {
        #[test]
        fn speed_and_acceleration_keep_their_limits_whatever_the_goal_does(
            goals in prop::collection::vec((vector(), vector()), 1..40)
        ) {
            let args = CourseArgs::default();
            let mut course = Course::at_rest(args, Point3::origin());
            for (goal, moving) in goals {
                for _ in 0..20 {
                    let before = course.velocity;
                    course.go(&Point3::from(goal), &moving, PERIOD);
                    prop_assert!(course.ratio(&before, PERIOD) <= 1.0 + 1e-9);
                    prop_assert!(course.velocity.norm() <= args.speed + 1e-9);
                }
            }
        }

        #[test]
        fn what_is_safe_comes_first_and_takes_all_of_the_acceleration_if_it_has_to(
            safe in vector(), wanted in vector(), before in vector(),
        ) {
            let args = CourseArgs::default();
            let most = args.acceleration * PERIOD;
            let towards = safe - before;
            let braked = before + towards * (most / towards.norm()).min(1.0);
            // What is wanted is as safe, or something else.
            for wanted in [safe, before + towards * 2.0, wanted] {
                let mut course = Course::at_rest(args, Point3::origin());
                course.velocity = before;
                course.follow_within(&Walls::default(), &JointLimits::NONE, [safe, wanted], PERIOD);
                prop_assert!(course.ratio(&before, PERIOD) <= 1.0 + 1e-9);
                if wanted == safe {
                    prop_assert!((course.velocity - braked).norm() < 1e-9);
                }
            }
        }

        #[test]
        fn a_goal_at_rest_is_reached_at_rest_without_passing_it(goal in vector()) {
            let mut course = Course::at_rest(CourseArgs::default(), Point3::origin());
            let direction = goal.normalize();
            for _ in 0..1000 {
                course.go(&Point3::from(goal), &Vector3::zeros(), PERIOD);
                prop_assert!(direction.dot(&(course.place.coords - goal)) < 2e-3);
            }
            prop_assert!((course.place.coords - goal).norm() < 1e-6);
            prop_assert!(course.velocity.norm() < 1e-5);
        }
    }

    #[test]
    fn a_way_takes_little_longer_than_the_least_time() {
        let args = CourseArgs::default();
        let mut course = Course::at_rest(args, Point3::origin());
        let goal = Point3::new(0.5, 0.0, 0.0);
        let mut time = 0.0;
        while (goal - course.place).norm() > 0.005 {
            course.go(&goal, &Vector3::zeros(), PERIOD);
            time += PERIOD;
        }
        // A trapezoid over 0.5 m.
        let least = 0.5 / args.speed + args.speed / args.acceleration;
        assert!(time < 1.25 * least, "{time} s, and {least} s at least");
    }

    #[test]
    fn a_goal_that_moves_evenly_is_followed_without_an_error() {
        let mut course = Course::at_rest(CourseArgs::default(), Point3::origin());
        let moving = Vector3::new(0.3, -0.2, 0.1);
        for step in 1..1000 {
            let goal = Point3::new(0.1, 0.0, 0.2) + moving * (f64::from(step) * PERIOD);
            course.go(&goal, &moving, PERIOD);
            if step > 700 {
                assert!((goal - course.place).norm() < 1e-5);
            }
        }
    }
}
