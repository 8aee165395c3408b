//! A joint that goes after what moves, under limits of speed, acceleration and jerk: where it is one period later.
//!
//! In each period the quickest way to what it goes after is found anew, as if that moved on evenly, and one period of it is
//! gone (L. Berscheid and T. Kroeger, Robotics: Science and Systems 2021, by rsruckig). Knows no arm and no stream.

use mcs_model::Limits;
use rsruckig::prelude::{
    DataArrayOrVec, InputParameter, Ruckig, RuckigResult, ThrowErrorHandler, Trajectory,
};

use super::course::Course;
use super::timing::{JointBounds, JointState};

/// What is gone after counts as no faster than this share of the joint's largest speed: else it would never be caught.
const CAUGHT: f64 = 0.99;
/// How far beyond a limit of the position rounding may be, rad or m.
const ROUNDING: f64 = 1e-9;

/// The scratch of one joint's pursuit after another. Allocates only when it is made.
pub struct Pursuit {
    input: InputParameter<1>,
    ruckig: Ruckig<1, ThrowErrorHandler>,
    trajectory: Trajectory<1>,
}

impl std::fmt::Debug for Pursuit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Pursuit")
    }
}

impl Default for Pursuit {
    fn default() -> Self {
        Self {
            input: InputParameter::new(None),
            ruckig: Ruckig::new(None, 1.0),
            trajectory: Trajectory::new(None),
        }
    }
}

impl Pursuit {
    /// The state after the next `period` (s) of a joint that goes after `aim`, a position and a speed, under fractions (`pace`) of its
    /// limits: of the speed, and of acceleration and jerk. From there it can still come to rest before a limit of its position.
    pub fn next(
        &mut self,
        now: &JointState,
        aim: (f64, f64),
        limits: &Limits,
        pace: (f64, f64),
        period: f64,
    ) -> JointState {
        let bounds = JointBounds::of(limits, pace, true);
        let (low, high) = (limits.lower - ROUNDING, limits.upper + ROUNDING);
        let found = self.towards(now, aim, &bounds, period);
        let stays = found.filter(|then| {
            let rest = Course::to_rest(then, &bounds, 0.0);
            let end = rest.at(rest.duration()).position;
            (low..=high).contains(&end)
        });
        stays.unwrap_or_else(|| Course::to_rest(now, &bounds, 0.0).at(period))
    }

    /// The same, whatever the limits of the position are.
    fn towards(
        &mut self,
        now: &JointState,
        (there, speed): (f64, f64),
        bounds: &JointBounds,
        period: f64,
    ) -> Option<JointState> {
        let fastest = bounds.velocity;
        let speed = speed.clamp(-CAUGHT * fastest, CAUGHT * fastest);
        let input = &mut self.input;
        // Seen from what it goes after.
        input.current_position[0] = now.position - there;
        input.current_velocity[0] = now.velocity - speed;
        input.current_acceleration[0] = now.acceleration;
        input.max_velocity[0] = fastest - speed;
        input.max_acceleration[0] = bounds.acceleration;
        input.max_jerk[0] = bounds.jerk;
        input.min_velocity = Some(DataArrayOrVec::Stack([-fastest - speed]));
        let result = self.ruckig.calculate(input, &mut self.trajectory);
        if !matches!(result, Ok(RuckigResult::Working | RuckigResult::Finished)) {
            return None;
        }
        let mut then = None;
        let mut section = 0;
        let found = &self.trajectory;
        found.state_to_integrate_from(period, &mut section, |_, t, p, v, a, j| {
            then = Some(JointState {
                position: p + t * (v + t * (0.5 * a + t * j / 6.0)) + there + speed * period,
                velocity: v + t * (a + 0.5 * t * j) + speed,
                acceleration: a + t * j,
            });
        });
        then
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD: f64 = 0.0045;

    fn limits() -> Limits {
        Limits {
            lower: -1.0,
            upper: 1.5,
            velocity: 2.0,
            acceleration: 8.0,
            jerk: 100.0,
            ..Limits::NONE
        }
    }

    fn at(position: f64) -> JointState {
        JointState {
            position,
            ..JointState::default()
        }
    }

    /// So many periods towards what stands there: each state.
    fn run(from: f64, aims: &[f64], pace: (f64, f64)) -> Vec<JointState> {
        let (mut pursuit, mut now) = (Pursuit::default(), at(from));
        let each = aims.iter().map(|aim| {
            now = pursuit.next(&now, (*aim, 0.0), &limits(), pace, PERIOD);
            now
        });
        each.collect()
    }

    #[test]
    fn a_jump_is_made_in_the_least_time_and_without_overshoot() {
        let passed = run(0.0, &[1.0; 400], (1.0, 1.0));
        let bounds = JointBounds::of(&limits(), (1.0, 1.0), true);
        let least = Course::rest_to_rest(0.0, 1.0, &bounds).duration();
        let there = passed
            .iter()
            .position(|now| (now.position - 1.0).abs() < 1e-9);
        let periods = there.unwrap() as f64 + 1.0;
        assert!(
            (periods * PERIOD - least).abs() < 2.0 * PERIOD,
            "{periods} {least}"
        );
        assert!(passed.iter().all(|now| now.position < 1.0 + 1e-9));
        assert!(passed[399].velocity.abs() < 1e-9);
    }

    #[test]
    fn what_moves_evenly_is_caught_and_kept() {
        let (mut pursuit, mut now) = (Pursuit::default(), at(0.3));
        for tick in 0..400 {
            let aim = -0.8 + 0.9 * f64::from(tick) * PERIOD;
            now = pursuit.next(&now, (aim, 0.9), &limits(), (1.0, 1.0), PERIOD);
            if tick > 350 {
                let off = now.position - aim - 0.9 * PERIOD;
                assert!(off.abs() < 1e-8, "tick {tick}: {off}");
            }
        }
    }

    proptest! {
        #[test]
        fn whatever_it_goes_after_no_limit_is_passed_that_of_jerk_among_them(
            from in -1.0..1.5_f64,
            aims in prop::collection::vec((-3.0..3.0_f64, -4.0..4.0_f64), 1..200),
            hold in 1..30_usize,
            pace in (0.05..1.0_f64, 0.05..1.0_f64),
        ) {
            let aims = aims.into_iter().flat_map(|aim| std::iter::repeat_n(aim, hold));
            let (limits, mut pursuit) = (limits(), Pursuit::default());
            let mut before = at(from);
            for aim in aims {
                let now = pursuit.next(&before, aim, &limits, pace, PERIOD);
                prop_assert!(now.velocity.abs() <= limits.velocity * pace.0 + 1e-9);
                prop_assert!(now.acceleration.abs() <= limits.acceleration * pace.1 + 1e-9);
                let harder = (now.acceleration - before.acceleration).abs();
                prop_assert!(harder <= limits.jerk * pace.1 * PERIOD * (1.0 + 1e-9) + 1e-9, "{harder}");
                prop_assert!(now.position <= limits.upper + 1e-8 && now.position >= limits.lower - 1e-8);
                let mean = 0.5 * (now.velocity + before.velocity);
                prop_assert!(((now.position - before.position) / PERIOD - mean).abs() < 1e-3);
                before = now;
            }
        }
    }
}
