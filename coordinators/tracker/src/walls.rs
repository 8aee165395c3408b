//! Walls that the configuration states: the hand comes towards one no faster than it can brake before it. Knows no tasks.
//!
//! At a distance `d` beyond the stand-off the speed towards a wall is at most `sqrt(v^2 + 2 a d)`, with the speed `v` of a contact. Along
//! a wall and away from it the hand goes as it likes. A wall that is not stated is met as fast as the hand comes.

use nalgebra::{Point3, Vector3};
use serde::Deserialize;

/// Part of the hand's acceleration that walls are braked for with: three that are square to each other can be at once.
const BRAKES: f64 = 0.5;

/// Where walls meet at a sharp angle, what one of them asks for is taken up again so often.
const ROUNDS: usize = 4;

/// A wall, in the base frame of the arm.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// What it is called in findings.
    pub name: String,
    /// A box,
    #[serde(rename = "box")]
    pub solid: Option<Solid>,
    /// or all that is behind a plane.
    pub half_space: Option<HalfSpace>,
    /// So far from its surface, m, the tool is when the hand touches it: the size of the hand, and what is not known of the wall.
    pub stand_off_m: f64,
    /// The hand may touch it so fast, m/s.
    #[serde(default = "contact_m_s")]
    pub contact_m_s: f64,
}

/// A box along the axes, m.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Solid {
    /// Its lowest corner.
    pub low: [f64; 3],
    /// Its highest corner.
    pub high: [f64; 3],
}

/// All that is behind a plane.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HalfSpace {
    /// A place of the plane, m.
    pub at: [f64; 3],
    /// The direction away from it, of any length.
    pub away: [f64; 3],
}

fn contact_m_s() -> f64 {
    0.1
}

impl Wall {
    /// What is wrong with it, if something is.
    #[must_use]
    pub fn wrong(&self) -> Option<String> {
        let Self { name, .. } = self;
        let finite = |numbers: &[f64]| numbers.iter().all(|number| number.abs() < 1e3);
        match (&self.solid, &self.half_space) {
            (Some(Solid { low, high }), None) => {
                let sorted = low.iter().zip(high).all(|(low, high)| low < high);
                if !(sorted && finite(low) && finite(high)) {
                    return Some(format!(
                        "the box of wall `{name}` goes from {low:?} to {high:?}"
                    ));
                }
            }
            (None, Some(HalfSpace { at, away })) => {
                let long = Vector3::from(*away).norm() > 1e-6;
                if !(long && finite(at) && finite(away)) {
                    return Some(format!(
                        "the plane of wall `{name}` is at {at:?} and faces {away:?}"
                    ));
                }
            }
            _ => {
                return Some(format!(
                    "wall `{name}` is no `box`, or no `half_space`, alone"
                ));
            }
        }
        if !(0.0..=1.0).contains(&self.stand_off_m) {
            let value = self.stand_off_m;
            return Some(format!("`stand_off_m` of wall `{name}` is {value}"));
        }
        (!(0.001..=2.0).contains(&self.contact_m_s))
            .then(|| format!("`contact_m_s` of wall `{name}` is {}", self.contact_m_s))
    }

    /// How far a place is from its surface, m, below 0 inside, and the direction away from it.
    fn seen_from(&self, place: &Point3<f64>) -> (f64, Vector3<f64>) {
        if let Some(HalfSpace { at, away }) = &self.half_space {
            let away = Vector3::from(*away).normalize();
            return ((place - Point3::from(*at)).dot(&away), away);
        }
        let Some(Solid { low, high }) = &self.solid else {
            return (f64::INFINITY, Vector3::zeros());
        };
        let nearest =
            Point3::from_slice(&[0, 1, 2].map(|axis| place[axis].clamp(low[axis], high[axis])));
        let way = place - nearest;
        let far = way.norm();
        if far > 0.0 {
            return (far, way / far);
        }
        // Inside, the face that is the nearest counts.
        let faces = [0, 1, 2].into_iter().flat_map(|axis| {
            let away = Vector3::ith(axis, 1.0);
            [
                (place[axis] - high[axis], away),
                (low[axis] - place[axis], -away),
            ]
        });
        faces.fold((f64::NEG_INFINITY, Vector3::zeros()), |best, face| {
            if face.0 > best.0 { face } else { best }
        })
    }
}

/// All walls of a hand.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Walls {
    walls: Vec<Wall>,
    /// What it brakes with, m/s^2.
    braking: f64,
}

impl Walls {
    /// Of a hand that can accelerate so, m/s^2.
    #[must_use]
    pub fn new(walls: Vec<Wall>, acceleration: f64) -> Self {
        Self {
            walls,
            braking: BRAKES * acceleration,
        }
    }

    /// The velocity, m/s, without what would be too fast towards a wall for a hand at `place`, now or a period of so many s later.
    #[must_use]
    pub fn allow(&self, place: &Point3<f64>, velocity: Vector3<f64>, period: f64) -> Vector3<f64> {
        // v^2 = c^2 + 2 a (d - v T)
        let change = self.braking * period;
        let rounds = match self.walls.len() {
            0 | 1 => 1,
            _ => ROUNDS,
        };
        let mut allowed = velocity;
        for wall in std::iter::repeat_n(&self.walls, rounds).flatten() {
            let (far, away) = wall.seen_from(place);
            let left = (far - wall.stand_off_m).max(0.0);
            let square = change.powi(2) + wall.contact_m_s.powi(2) + 2.0 * self.braking * left;
            let most = square.sqrt() - change;
            allowed += away * (-allowed.dot(&away) - most).max(0.0);
        }
        allowed
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{
        course::{Course, CourseArgs},
        joint_limits::JointLimits,
    };

    const PERIOD: f64 = 0.0045;

    fn plane(at: [f64; 3], away: [f64; 3]) -> Wall {
        Wall {
            name: "plane".to_owned(),
            solid: None,
            half_space: Some(HalfSpace { at, away }),
            stand_off_m: 0.1,
            contact_m_s: 0.1,
        }
    }

    fn solid(low: [f64; 3], high: [f64; 3]) -> Wall {
        Wall {
            name: "box".to_owned(),
            solid: Some(Solid { low, high }),
            half_space: None,
            stand_off_m: 0.1,
            contact_m_s: 0.05,
        }
    }

    fn vector() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-1.0..1.0_f64).prop_map(Vector3::from)
    }

    proptest! {
        #[test]
        fn whatever_the_goal_does_a_wall_is_met_no_faster_than_is_said_and_without_a_step(
            goals in prop::collection::vec((vector(), vector()), 1..30)
        ) {
            let args = CourseArgs::default();
            let list = vec![
                plane([0.0, 0.0, -0.4], [0.0, 0.0, 2.0]),
                plane([-0.5, 0.0, 0.0], [1.0, 0.0, 0.0]),
                solid([0.3, -0.2, -0.2], [0.5, 0.2, 0.2]),
            ];
            let walls = Walls::new(list.clone(), args.acceleration);
            let mut course = Course::at_rest(args, Point3::origin());
            let off = |wall: &Wall, place: &Point3<f64>| wall.seen_from(place).0 - wall.stand_off_m;
            for (goal, moving) in goals {
                for _ in 0..20 {
                    let (before, there) = (course.velocity, course.place);
                    let wanted = course.wanted(&Point3::from(goal), &moving, true, f64::INFINITY, PERIOD);
                    course.follow_within(&walls, &JointLimits::NONE, [course.velocity, wanted], PERIOD);
                    prop_assert!(course.ratio(&before, PERIOD) <= 1.0 + 1e-9);
                    for wall in &list {
                        let (from, to) = (off(wall, &there), off(wall, &course.place));
                        let step = BRAKES * args.acceleration * PERIOD;
                        if from > 0.0 && to <= 0.0 {
                            let fast = (from - to) / PERIOD;
                            prop_assert!(fast <= wall.contact_m_s + 0.5 * step, "{fast} m/s");
                        }
                    }
                }
            }
        }

        #[test]
        fn along_a_wall_and_away_from_it_nothing_is_slower(velocity in vector(), far in 0.0..0.3_f64) {
            let walls = Walls::new(vec![plane([0.0; 3], [0.0, 0.0, 1.0])], 4.0);
            let allowed = walls.allow(&Point3::new(0.2, 0.1, far), velocity, PERIOD);
            prop_assert_eq!((allowed.x, allowed.y), (velocity.x, velocity.y));
            if velocity.z >= 0.0 {
                prop_assert_eq!(allowed.z, velocity.z);
            }
        }
    }

    #[test]
    fn a_hand_that_comes_with_its_full_speed_touches_with_the_speed_of_a_contact() {
        let args = CourseArgs::default();
        let walls = Walls::new(
            vec![plane([0.8, 0.0, 0.0], [-1.0, 0.0, 0.0])],
            args.acceleration,
        );
        let mut course = Course::at_rest(args, Point3::origin());
        let (mut fastest, mut touched) = (0.0_f64, f64::NAN);
        for _ in 0..1000 {
            let goal = Point3::new(2.0, 0.0, 0.0);
            let wanted = course.wanted(&goal, &Vector3::zeros(), true, f64::INFINITY, PERIOD);
            course.follow_within(
                &walls,
                &JointLimits::NONE,
                [course.velocity, wanted],
                PERIOD,
            );
            fastest = fastest.max(course.velocity.x);
            if course.place.x < 0.7 {
                touched = course.velocity.x;
            }
        }
        assert!(fastest > 0.9, "{fastest} m/s");
        assert!((0.08..0.102).contains(&touched), "{touched} m/s");
    }

    #[test]
    fn a_wall_that_cannot_be_is_named() {
        let good = plane([0.0; 3], [0.0, 0.0, 1.0]);
        assert_eq!(good.wrong(), None);
        assert_eq!(solid([0.0; 3], [1.0; 3]).wrong(), None);
        let both = Wall {
            solid: Some(Solid {
                low: [0.0; 3],
                high: [1.0; 3],
            }),
            ..good.clone()
        };
        let turned = solid([0.0; 3], [1.0, -1.0, 1.0]);
        let flat = plane([0.0; 3], [0.0; 3]);
        let far = plane([f64::NAN, 0.0, 0.0], [0.0, 0.0, 1.0]);
        let mut thick = good.clone();
        thick.stand_off_m = -0.1;
        let mut fast = good;
        fast.contact_m_s = 0.0;
        for wrong in [both, turned, flat, far, thick, fast] {
            let told = wrong.wrong().unwrap();
            assert!(told.contains(&wrong.name), "{told}");
        }
    }
}
