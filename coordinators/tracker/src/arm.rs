//! Which joint positions put the hand at a place, period by period, and which places it reaches. Knows no tasks: a call is a period.
//!
//! The hand keeps how it is turned. Where the wrist is nearly straight, joints 4 and 6 could keep that only by turning against each other
//! at any speed. There it gives way: the place is kept, and the turn follows as far as it costs little, by damped least squares
//! (S. Chiaverini, B. Siciliano and O. Egeland, IEEE Trans. Control Systems Technology 2(2), 1994). So the hand passes a
//! singularity of its wrist. It stays before those of shoulder and elbow: behind them the arm has no posture, or one without a way back.

use mcs::{
    Joints,
    model::{
        Data, Limits,
        inverse::{Branch, Wrist},
    },
    trajectory::Solver,
};
use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};

use crate::joint_limits::JointLimits;

/// Nearer to a singular pose than this joints turn too fast: smallest singular value, m per rad.
const SINGULAR: f64 = 0.04;

/// The wrist's turning is damped where its smallest singular value is below the first; by the second where that is 0.
const DAMPED: [f64; 2] = [0.2, 0.1];

/// How fast a turn is made up for that was given way, parts per s.
const BACK: f64 = 6.0;

/// The part of speeds and accelerations of the wrist's joints that is used; the servo has the rest for what lies between two periods.
const USED: f64 = 0.8;

/// A joint of the wrist stays so far before its limit, rad.
const SHORT: f64 = 0.002;

/// Joints that carry the wrist, and all joints of an arm whose wrist gives way.
const WRIST: usize = 3;
const ALL: usize = 6;

/// The other posture of the wrist is one that it passes into when joint 4 turns no more than this, rad.
const PASSES: f64 = 1.0;

/// A wrist whose joint 5 has a smaller sine than this is nearly straight: there the turn is damped.
const STRAIGHT: f64 = 0.28;

/// Steps by which three joints find a place, and how far from it they may end, m.
const STEPS: usize = 8;
const EXACT: f64 = 1e-6;

/// An arm whose setpoint is led.
#[derive(Debug, Clone)]
pub struct Arm {
    solver: Solver,
    data: Data,
    joints: Joints,
    speeds: Joints,
    /// How the hand is to be turned.
    turn: UnitQuaternion<f64>,
    /// What the joints allowed where that was known last.
    limits: JointLimits,
}

impl Arm {
    /// With joints at rest, rad. The hand stays turned as it is.
    #[must_use]
    pub fn at_rest(solver: Solver, joints: Joints) -> Self {
        let mut arm = Self {
            data: solver.model().data(),
            speeds: Joints::zeros(joints.len()),
            joints,
            turn: UnitQuaternion::identity(),
            limits: JointLimits::NONE,
            solver,
        };
        arm.turn = arm.pose(&joints).rotation;
        arm
    }

    /// The arm rests elsewhere now: it was stopped.
    pub fn rest_at(&mut self, joints: Joints) {
        self.turn = self.pose(&joints).rotation;
        self.speeds = Joints::zeros(joints.len());
        self.joints = joints;
    }

    /// `base_T_tool` at joint positions, rad.
    pub fn pose(&mut self, joints: &[f64]) -> Isometry3<f64> {
        self.solver.pose(joints)
    }

    /// How the hand is to be turned.
    #[must_use]
    pub fn turn(&self) -> UnitQuaternion<f64> {
        self.turn
    }

    /// Where the joints are sent, rad.
    #[must_use]
    pub fn joints(&self) -> &Joints {
        &self.joints
    }

    /// Whether the hand may give way in how it is turned: three joints place a wrist of three more.
    fn gives_way(&self) -> bool {
        self.joints.len() == ALL && self.solver.branch_of(&self.joints).is_some()
    }

    /// Goes on by a period, s, at whose end the hand is to be at `place`, m.
    ///
    /// # Errors
    /// A text: the arm does not reach that. Its joints stay.
    pub fn go(&mut self, place: &Point3<f64>, period: f64) -> Result<(), String> {
        let before = self.joints;
        let next = match self.gives_way() {
            true => self.given_way(place, period)?,
            false => {
                let pose = Isometry3::from_parts(place.coords.into(), self.turn);
                let branch = self.solver.branch_of(&before);
                let found = self.solver.follow(&pose, branch, &before);
                found.map_err(|error| error.to_string())?
            }
        };
        let speed = |index: usize| (next[index] - before[index]) / period;
        self.speeds = Joints::from_fn(next.len(), speed);
        self.joints = next;
        Ok(())
    }

    fn given_way(&mut self, place: &Point3<f64>, period: f64) -> Result<Joints, String> {
        let mut next = self.joints;
        let now = self.pose(&next).rotation;
        self.put(place, &mut next)?;
        // What the first three joints turned the hand by is made up for at once, what was given way before slowly.
        let carried = self.pose(&next).rotation;
        let off = (self.turn * now.inverse()).scaled_axis() * (BACK * period).min(1.0);
        let wanted = (now * carried.inverse()).scaled_axis() + off;
        let [_, wrist] = self.jacobians(&next);
        let least = wrist.singular_values().min();
        let [far, most] = DAMPED;
        let damping = most * most * (1.0 - (least / far).powi(2)).max(0.0);
        let square = wrist * wrist.transpose() + Matrix3::identity() * damping;
        let inverse = square.try_inverse().unwrap_or_else(Matrix3::zeros);
        let steps = wrist.transpose() * inverse * wanted;
        for (index, step) in (WRIST..ALL).zip(steps.iter()) {
            let limits = &self.solver.model().joints()[index].limits;
            let (at, speed) = (self.joints[index], self.speeds[index]);
            let braking = USED * limits.acceleration;
            // As fast as it can still brake before its limit, with half of that.
            let room = |left: f64| (braking * (left - SHORT).max(0.0)).sqrt();
            let most = USED * limits.velocity;
            let fast = (step / period).clamp(-most, most);
            let fast = fast.clamp(-room(at - limits.lower), room(limits.upper - at));
            let change = braking * period;
            next[index] = at + (fast.clamp(speed - change, speed + change)) * period;
        }
        self.put(place, &mut next)?;
        Ok(next)
    }

    /// Has the first three joints put the hand at a place, m, by Newton's steps.
    fn put(&mut self, place: &Point3<f64>, joints: &mut Joints) -> Result<(), String> {
        let mut left = f64::INFINITY;
        for _ in 0..STEPS {
            let there = Point3::from(self.pose(joints).translation.vector);
            let way = place - there;
            left = way.norm();
            if left < 1e-9 {
                break;
            }
            let [arm, _] = self.jacobians(joints);
            let step = arm.try_inverse().map(|inverse| inverse * way);
            let step = step.filter(|step| step.norm() < 1.0);
            let step = step.ok_or("the arm is singular there")?;
            for (joint, step) in joints.iter_mut().zip(step.iter()) {
                *joint += step;
            }
        }
        match left < EXACT {
            true => Ok(()),
            false => Err(format!("the arm ends {left:.4} m before the place")),
        }
    }

    /// How the first three joints move the tool, m per rad, and how the others turn it, in the base frame.
    fn jacobians(&mut self, joints: &[f64]) -> [Matrix3<f64>; 2] {
        let model = self.solver.model();
        let all = model.jacobian(&mut self.data, joints, model.tip());
        [
            all.fixed_view::<3, 3>(0, 0).into_owned(),
            all.fixed_view::<3, 3>(3, WRIST).into_owned(),
        ]
    }

    /// Its smallest singular value, m per rad; without the wrist, where that gives way.
    fn least(&mut self, joints: &[f64]) -> f64 {
        match self.gives_way() {
            true => self.jacobians(joints)[0].singular_values().min(),
            false => self.solver.smallest_singular_value(joints),
        }
    }

    /// Where joints put a hand that is turned as it shall be, next to where they are, or why they do not.
    fn found(&mut self, place: &Point3<f64>) -> Result<Joints, String> {
        let pose = Isometry3::from_parts(place.coords.into(), self.turn);
        let near = self.joints;
        let branch = self.solver.branch_of(&near);
        let found = self.solver.follow(&pose, branch, &near);
        let why = match (found, branch) {
            (Ok(found), _) => return Ok(found),
            (Err(why), None) => return Err(why.to_string()),
            (Err(why), Some(_)) if !self.gives_way() => return Err(why.to_string()),
            (Err(why), Some(_)) => why,
        };
        // A straight wrist is passed into its other posture.
        let other = branch.map(|branch| Branch {
            wrist: match branch.wrist {
                Wrist::Flip => Wrist::NoFlip,
                Wrist::NoFlip => Wrist::Flip,
            },
            ..branch
        });
        let passed = self.solver.follow(&pose, other, &near).ok();
        let passed = passed.filter(|passed| (passed[WRIST] - near[WRIST]).abs() < PASSES);
        let passed = passed.or_else(|| self.straight(place));
        passed.ok_or_else(|| why.to_string())
    }

    /// Where joints put a hand whose wrist is nearly straight there, however it is turned then.
    fn straight(&mut self, place: &Point3<f64>) -> Option<Joints> {
        let mut found = self.joints;
        self.put(place, &mut found).ok()?;
        let [_, wrist] = self.jacobians(&found);
        let turned = self.turn * self.pose(&found).rotation.inverse();
        let bend = wrist.column(0).cross(&(turned * wrist.column(2)));
        let outside = self.solver.model().joint_outside(&found);
        (bend.norm() < STRAIGHT && outside.is_none_or(|joint| joint >= WRIST)).then_some(found)
    }

    /// What its joints allow of the hand at a place, m. An arm that is nearly singular already may become less so.
    ///
    /// # Errors
    /// A text: why it does not reach that place.
    pub fn limits_at(&mut self, place: &Point3<f64>) -> Result<JointLimits, String> {
        let found = self.found(place)?;
        let joints = self.joints;
        let (now, then) = (self.least(&joints), self.least(&found));
        if then < SINGULAR.min(now) {
            return Err(format!(
                "the arm would be singular: its smallest singular value would be {then:.3}, and {SINGULAR} is needed"
            ));
        }
        self.allowed(&found)
            .ok_or_else(|| "the arm is singular there".to_owned())
    }

    /// What its joints allow of the hand where it is; where they are singular, what they allowed last.
    pub fn limits(&mut self) -> JointLimits {
        let joints = self.joints;
        self.limits = self.allowed(&joints).unwrap_or(self.limits);
        self.limits
    }

    /// What joints allow of a hand that stays turned as it is: the first three carry the middle of the wrist as fast as the hand goes.
    fn allowed(&mut self, joints: &Joints) -> Option<JointLimits> {
        if !self.gives_way() {
            return Some(JointLimits::NONE);
        }
        let model = self.solver.model();
        model.forward(&mut self.data, joints);
        let wrist = self.data.carrier(Some(WRIST + 1)).origin;
        let all = model.jacobian_there(&mut self.data, model.tip(), &wrist);
        let jacobian = all.fixed_view::<3, 3>(0, 0).into_owned();
        let joints = model.joints();
        let most = |pick: fn(&Limits) -> f64| Vector3::from_fn(|row, _| pick(&joints[row].limits));
        let both = [
            most(|limits| limits.velocity),
            most(|limits| limits.acceleration),
        ];
        JointLimits::new(jacobian, both)
    }
}

#[cfg(test)]
mod tests {
    use std::{path::Path, sync::Arc};

    use mcs::model::{
        Model, built_in,
        file::{self, Inertias},
    };
    use proptest::prelude::*;

    use super::*;
    use crate::control::{Control, ControlArgs};

    const PERIOD: f64 = 0.0045;

    fn arm(degrees: [f64; 6]) -> Arm {
        let model = built_in::model("puma560", Inertias::Identified).unwrap();
        of_model(model.unwrap(), degrees)
    }

    fn of_model(model: Model, degrees: [f64; 6]) -> Arm {
        let solver = Solver::new(Arc::new(model)).unwrap();
        Arm::at_rest(solver, Joints::from(degrees.map(f64::to_radians)))
    }

    /// What a way of the hand costs: largest speed and acceleration of a joint of the wrist, as parts of their limits; how far the
    /// hand was turned at most and at the end, rad; and where it is from its place at most, m.
    #[derive(Debug, Default)]
    struct Cost {
        speed: f64,
        acceleration: f64,
        turned: f64,
        last: f64,
        off: f64,
        /// It was held before the end, for a joint would have been beyond its limit.
        held: bool,
    }

    /// Leads a hand from a straight wrist's one side to the other, inwards, and it rests there.
    fn passed(aside: f64, fast: f64) -> Cost {
        let mut arm = arm([0.0, 39.0, -159.0, 0.0, -20.0, 0.0]);
        let turn = arm.turn();
        let from = Point3::from(arm.pose(&arm.joints().clone()).translation.vector);
        let mut cost = Cost::default();
        let way = Vector3::new(-0.3, aside, 0.0);
        let seconds = way.norm() / fast + 4.0;
        let mut before = *arm.joints();
        let mut speeds = Joints::zeros(ALL);
        for tick in 1..(seconds / PERIOD) as u32 {
            let time = f64::from(tick) * PERIOD;
            // Even but for its ends.
            let share = (time * fast / way.norm()).min(1.0);
            let share = share * share * (3.0 - 2.0 * share);
            let place = from + way * share;
            if share < 1.0 && arm.limits_at(&(place + way.normalize() * 0.02)).is_err() {
                cost.held = true;
                return cost;
            }
            arm.go(&place, PERIOD).unwrap();
            let joints = *arm.joints();
            let pose = arm.pose(&joints);
            cost.off = cost
                .off
                .max((pose.translation.vector - place.coords).norm());
            cost.last = pose.rotation.angle_to(&turn);
            cost.turned = cost.turned.max(cost.last);
            for index in WRIST..ALL {
                let limits = &arm.solver.model().joints()[index].limits;
                let speed = (joints[index] - before[index]) / PERIOD;
                let change = (speed - speeds[index]) / PERIOD;
                cost.speed = cost.speed.max(speed.abs() / limits.velocity);
                cost.acceleration = cost.acceleration.max(change.abs() / limits.acceleration);
                speeds[index] = speed;
                assert!(
                    (limits.lower..=limits.upper).contains(&joints[index]),
                    "{joints:?} {time} s"
                );
            }
            before = joints;
        }
        cost
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_hand_passes_a_straight_wrist_within_all_limits_and_is_turned_back_behind_it(
            aside in -0.1..0.1_f64,
            fast in 0.05..0.4_f64,
        ) {
            let cost = passed(aside, fast);
            prop_assert!(cost.off < 1e-5, "{cost:?}");
            prop_assert!(cost.speed <= 1.0 && cost.acceleration <= 1.0, "{cost:?}");
            // Further aside joint 4 comes to its limit, and the hand stays turned a little or is held.
            let near = aside.abs() < 0.06;
            prop_assert!(cost.turned < if near { 0.12 } else { 0.3 }, "{cost:?}");
            prop_assert!(!near || (cost.last < 0.02 && !cost.held), "{cost:?}");
        }
    }

    /// The largest accelerations of the first three joints, rad/s^2, of a hand that follows jumps of a ball, which is seen every 40 ms,
    /// 110 ms late: `to` where each of them goes, m from where the hand begins.
    fn jumped(mut arm: Arm, to: &[[f64; 3]]) -> [f64; WRIST] {
        let from = Point3::from(arm.pose(&arm.joints().clone()).translation.vector);
        let mut control = Control::new(ControlArgs::default(), from);
        let (mut before, mut speeds, mut most) = (*arm.joints(), [0.0; WRIST], [0.0_f64; WRIST]);
        let (still, mut since_held) = (Vector3::zeros(), 0);
        for tick in 0..to.len() as u32 * 200 {
            let now = f64::from(tick) * PERIOD;
            if tick % 9 == 0 {
                let at = now - 0.11;
                let jump = (at / 0.9).max(0.0) as usize;
                let place = |jump: usize| from + Vector3::from(to[jump.min(to.len() - 1)]);
                // A jump of 0.5 s, of constant acceleration and as much deceleration, and a rest.
                let share = ((at - jump as f64 * 0.9) / 0.5).clamp(0.0, 1.0);
                let done = match share < 0.5 {
                    true => 2.0 * share * share,
                    false => 1.0 - 2.0 * (1.0 - share).powi(2),
                };
                let last = jump.checked_sub(1).map_or(from, place);
                control.measure(now, at, &(last + (place(jump) - last) * done));
            }
            let joints = arm.limits();
            let limits_at = |place: &Point3<f64>| arm.limits_at(place).ok();
            control.go_within(now, [&still, &still], PERIOD, &joints, limits_at);
            arm.go(&control.course().place, PERIOD).unwrap();
            // Before the end of what it reaches the hand brakes as it can.
            let held = control.beyond().is_some();
            since_held = if held { 0 } else { since_held + 1 };
            for joint in 0..WRIST {
                let speed = (arm.joints()[joint] - before[joint]) / PERIOD;
                if since_held > 3 {
                    most[joint] = most[joint].max((speed - speeds[joint]).abs() / PERIOD);
                }
                speeds[joint] = speed;
            }
            before = *arm.joints();
        }
        most
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn however_the_ball_jumps_the_joints_that_place_the_hand_keep_their_limits(
            to in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 4..8)
        ) {
            // Further outwards the elbow is nearly stretched, and the hand is held.
            let to: Vec<_> =
                to.iter().map(|(x, y, z)| [0.075 * x - 0.025, 0.15 * y, 0.05 * z]).collect();
            // Also with a tool on its wrist, which is 0.2 m long.
            for model in ["puma560", "puma560_carrying_hand"] {
                let file = format!("{}/../../configs/models/{model}.toml", env!("CARGO_MANIFEST_DIR"));
                let model = file::read(Path::new(&file), Inertias::Identified).unwrap();
                let arm = of_model(model, [0.0, 39.0, -159.0, 0.0, -60.0, 0.0]);
                let joints = arm.solver.model().joints().to_vec();
                for (joint, most) in joints.iter().zip(jumped(arm, &to)) {
                    prop_assert!(most <= joint.limits.acceleration, "{most} rad/s^2 in {}", joint.name);
                }
            }
        }
    }

    #[test]
    fn away_from_singular_poses_the_hand_stays_turned_as_it_was() {
        let mut arm = arm([0.0, 39.0, -159.0, 0.0, -60.0, 0.0]);
        let turn = arm.turn();
        let from = Point3::from(arm.pose(&arm.joints().clone()).translation.vector);
        for tick in 1..2000 {
            let time = f64::from(tick) * PERIOD;
            let off = Vector3::new(0.1 * (2.0 * time).sin(), 0.12 * (2.5 * time).sin(), 0.0);
            arm.go(&(from + off), PERIOD).unwrap();
            let pose = arm.pose(&arm.joints().clone());
            assert!(
                pose.rotation.angle_to(&turn) < 0.01,
                "{}",
                pose.rotation.angle_to(&turn)
            );
        }
    }

    #[test]
    fn a_place_that_the_arm_does_not_reach_is_told_with_its_reason_and_moves_nothing() {
        let mut arm = arm([0.0, 39.0, -159.0, 0.0, -60.0, 0.0]);
        let before = *arm.joints();
        let far = Point3::new(3.0, 0.0, 0.5);
        assert!(arm.limits_at(&far).is_err() && arm.go(&far, PERIOD).is_err());
        assert_eq!(*arm.joints(), before);
        let there = Point3::from(arm.pose(&before).translation.vector);
        assert!(arm.limits_at(&there).is_ok());
    }
}
