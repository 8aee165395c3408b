//! Where one joint is over time: phases of constant jerk, as plain numbers.
//!
//! Also the progress along a path of the tool, from 0 to 1. Without a limit of jerk the acceleration jumps between phases,
//! and the course from rest to rest is a trapezoid of speed.

use crate::timing::{JointBounds, JointState};

/// Phases of a course: three to gain speed, one to keep it, three to lose it.
const PHASES: usize = 7;

/// One phase, as it begins.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Phase {
    /// When it begins, s from the start of the course.
    begin: f64,
    state: JointState,
    jerk: f64,
}

impl Phase {
    fn at(&self, t: f64) -> JointState {
        let (t, jerk) = (t - self.begin, self.jerk);
        let JointState {
            position,
            velocity,
            acceleration,
        } = self.state;
        JointState {
            position: position + t * (velocity + t * (0.5 * acceleration + t * jerk / 6.0)),
            velocity: velocity + t * (acceleration + 0.5 * t * jerk),
            acceleration: acceleration + t * jerk,
        }
    }
}

/// The least and the largest of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Range {
    pub(crate) least: f64,
    pub(crate) most: f64,
}

impl Range {
    pub(crate) const NONE: Self = Self {
        least: f64::INFINITY,
        most: f64::NEG_INFINITY,
    };

    pub(crate) fn with(self, number: f64) -> Self {
        Self {
            least: self.least.min(number),
            most: self.most.max(number),
        }
    }
}

/// What a joint's speed and acceleration are within some time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ranges {
    pub(crate) velocity: Range,
    pub(crate) acceleration: Range,
}

impl Ranges {
    pub(crate) const NONE: Self = Self {
        velocity: Range::NONE,
        acceleration: Range::NONE,
    };

    pub(crate) fn with(self, state: &JointState) -> Self {
        Self {
            velocity: self.velocity.with(state.velocity),
            acceleration: self.acceleration.with(state.acceleration),
        }
    }
}

/// The course of one joint, in at most so many phases. The default stands at 0 for no time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Course<const N: usize = PHASES> {
    phases: [Phase; N],
    duration: f64,
    end: JointState,
}

impl<const N: usize> Default for Course<N> {
    fn default() -> Self {
        Self {
            phases: [Phase::default(); N],
            duration: 0.0,
            end: JointState::default(),
        }
    }
}

impl Course {
    /// Standing at `position` (rad or m) for no time.
    #[must_use]
    pub fn still(position: f64) -> Self {
        let end = JointState {
            position,
            ..JointState::default()
        };
        let phase = Phase {
            state: end,
            ..Phase::default()
        };
        Self {
            phases: [phase; PHASES],
            duration: 0.0,
            end,
        }
    }

    /// From rest to rest in the least time under limits, all above zero, but for a jerk of 0, which is no limit. The
    /// closed forms of the trapezoid and of its counterpart with a limit of jerk.
    #[must_use]
    pub fn rest_to_rest(from: f64, to: f64, bounds: &JointBounds) -> Self {
        let way = (to - from).abs();
        if way == 0.0 {
            return Self::still(to);
        }
        let JointBounds {
            velocity: fastest,
            acceleration: hardest,
            jerk,
        } = *bounds;
        // How long the acceleration takes to be there, and the speed that this alone gives.
        let lag = if jerk > 0.0 { hardest / jerk } else { 0.0 };
        let least = hardest * lag;
        // The speed that is reached when there is no time to keep it.
        let peak = 2.0 * way / (lag + (lag * lag + 4.0 * way / hardest).sqrt());
        let peak = if peak >= least {
            peak
        } else {
            (0.25 * jerk).cbrt() * way.cbrt().powi(2)
        };
        let peak = peak.min(fastest);
        let (rise, keep) = if peak >= least {
            (lag, peak / hardest - lag)
        } else {
            ((peak / jerk).sqrt(), 0.0)
        };
        let reached = if peak >= least { hardest } else { jerk * rise };
        let cruise = (way / peak - 2.0 * rise - keep).max(0.0);
        let sign = (to - from).signum();
        let (reached, jerk) = (sign * reached, sign * jerk);
        // How long, from which acceleration, and under which jerk.
        let phases = [
            (rise, 0.0, jerk),
            (keep, reached, 0.0),
            (rise, reached, -jerk),
            (cruise, 0.0, 0.0),
            (rise, 0.0, -jerk),
            (keep, -reached, 0.0),
            (rise, -reached, jerk),
        ];
        let mut course = Self::still(from);
        let mut state = course.end;
        for (phase, (lasts, acceleration, jerk)) in course.phases.iter_mut().zip(phases) {
            state.acceleration = acceleration;
            *phase = Phase {
                begin: course.duration,
                state,
                jerk,
            };
            course.duration += lasts;
            state = phase.at(course.duration);
        }
        course.end = JointState {
            position: to,
            ..JointState::default()
        };
        course
    }

    /// From a state to rest under limits of acceleration and jerk, a jerk of 0 being none: in `within` (s), braking no harder
    /// than that needs, or in the least time where that is longer. The limit of speed does not matter. Without a limit of
    /// jerk the acceleration of the state does not either.
    #[must_use]
    pub fn to_rest(from: &JointState, bounds: &JointBounds, within: f64) -> Self {
        let (hardest, jerk) = (bounds.acceleration, bounds.jerk);
        let (speed, pull) = (from.velocity, from.acceleration);
        // How long, from which acceleration, and under which jerk; all along the way on which the joint brakes.
        let (sign, phases) = if jerk > 0.0 {
            // The speed that is left when the acceleration is gone says which way the joint must brake.
            let sign = (speed + 0.5 * pull * pull.abs() / jerk).signum();
            (
                sign,
                braking(sign * speed, sign * pull, (hardest, jerk), within),
            )
        } else {
            let lasts = (speed.abs() / hardest).max(within);
            let even = match lasts > 0.0 {
                true => (lasts, -speed.abs() / lasts, 0.0),
                false => (0.0, 0.0, 0.0),
            };
            (speed.signum(), [even, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
        };
        let mut course = Self::still(from.position);
        let mut state = *from;
        for (index, phase) in course.phases.iter_mut().enumerate() {
            let (lasts, acceleration, jerk) = phases.get(index).copied().unwrap_or_default();
            state.acceleration = sign * acceleration;
            *phase = Phase {
                begin: course.duration,
                state,
                jerk: sign * jerk,
            };
            course.duration += lasts;
            state = phase.at(course.duration);
        }
        course.end = JointState {
            position: state.position,
            ..JointState::default()
        };
        course
    }
}

/// The phases in which a joint with a speed and an acceleration, which is above zero where the acceleration is gone, comes to
/// rest: how long each lasts, the acceleration with which it begins, and its jerk.
fn braking(
    speed: f64,
    pull: f64,
    (hardest, jerk): (f64, f64),
    within: f64,
) -> [(f64, f64, f64); 3] {
    // With the hardest braking p it takes (pull + p + square / p) / jerk, where p is at most the root of the square.
    let square = jerk * speed + 0.5 * pull * pull;
    let wanted = within * jerk - pull;
    let spread = (wanted * wanted - 4.0 * square).max(0.0).sqrt();
    let most = square.max(0.0).sqrt().min(hardest).max(-pull);
    let gentle = 2.0 * square / (wanted + spread);
    let takes = most > 0.0 && within * jerk > pull + most + square / most;
    let peak = if takes { gentle } else { most };
    if peak >= -pull {
        let keep = match peak > 0.0 {
            true => ((square / peak - peak) / jerk).max(0.0),
            false => 0.0,
        };
        return [
            ((pull + peak) / jerk, pull, -jerk),
            (keep, -peak, 0.0),
            (peak / jerk, -peak, jerk),
        ];
    }
    // It brakes harder already than it needs to.
    let left = speed - 0.5 * pull * pull / jerk;
    let peak = (left / (within + pull / jerk)).max(0.0);
    let keep = if peak > 0.0 { left / peak } else { 0.0 };
    [
        ((-pull - peak) / jerk, pull, jerk),
        (keep, -peak, 0.0),
        (peak / jerk, -peak, jerk),
    ]
}

impl<const N: usize> Course<N> {
    /// A course of given phases, each with its begin (s), its state there and its jerk, to a state at `duration` (s).
    pub(crate) fn of_phases(
        duration: f64,
        end: JointState,
        phase: impl Fn(usize) -> (f64, JointState, f64),
    ) -> Self {
        let phases = std::array::from_fn(|index| {
            let (begin, state, jerk) = phase(index);
            Phase { begin, state, jerk }
        });
        Self {
            phases,
            duration,
            end,
        }
    }

    /// The same course with room for more phases.
    pub(crate) fn widened<const M: usize>(&self) -> Course<M> {
        let spare = Phase {
            begin: self.duration,
            state: self.end,
            jerk: 0.0,
        };
        Course {
            phases: std::array::from_fn(|index| self.phases.get(index).copied().unwrap_or(spare)),
            duration: self.duration,
            end: self.end,
        }
    }

    /// The same course in `factor` times the time, with speeds, accelerations and jerks so much smaller; at least 1.
    #[must_use]
    pub fn stretched(mut self, factor: f64) -> Self {
        let slower = |state: &mut JointState| {
            state.velocity /= factor;
            state.acceleration /= factor * factor;
        };
        for phase in &mut self.phases {
            phase.begin *= factor;
            slower(&mut phase.state);
            phase.jerk /= factor * factor * factor;
        }
        self.duration *= factor;
        slower(&mut self.end);
        self
    }

    /// The course of a joint that goes from `from` to `to` (rad or m) in proportion to this one, which goes from 0 to 1.
    #[must_use]
    pub fn scaled(mut self, from: f64, to: f64) -> Self {
        let way = to - from;
        let scale = |state: &mut JointState| {
            state.position = from + way * state.position;
            state.velocity *= way;
            state.acceleration *= way;
        };
        for phase in &mut self.phases {
            scale(&mut phase.state);
            phase.jerk *= way;
        }
        scale(&mut self.end);
        self.end.position = to;
        self
    }

    /// How long it takes, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Where the joint is at time `t`, s; before the start as at the start, after the end exactly at the end.
    #[must_use]
    pub fn at(&self, t: f64) -> JointState {
        if t >= self.duration {
            return self.end;
        }
        let t = t.max(0.0);
        let begun = self.phases.get(self.phase_at(t));
        begun.map_or(self.end, |phase| phase.at(t))
    }

    /// The number of the phase under way at time `t`, s. The first one begins at 0.
    fn phase_at(&self, t: f64) -> usize {
        let begun = self.phases.partition_point(|phase| phase.begin <= t);
        begun.saturating_sub(1)
    }

    /// The phases and when they end.
    fn lasting(&self) -> impl Iterator<Item = (&Phase, f64)> {
        let ends = self.phases.iter().skip(1).map(|phase| phase.begin);
        self.phases.iter().zip(ends.chain([self.duration]))
    }

    /// The least and the largest position on it.
    pub(crate) fn positions(&self) -> Range {
        let mut reached = Range::NONE.with(self.end.position);
        for (phase, end) in self.lasting() {
            reached = reached.with(phase.state.position);
            // Where the speed is zero: v + a t + j t^2 / 2 = 0.
            let (v, a, j) = (phase.state.velocity, phase.state.acceleration, phase.jerk);
            let root = (a * a - 2.0 * j * v).sqrt();
            let turns = [-2.0 * v / (a + root), -2.0 * v / (a - root)];
            for turn in turns.map(|t| phase.begin + t) {
                if phase.begin < turn && turn < end {
                    reached = reached.with(phase.at(turn).position);
                }
            }
        }
        reached
    }

    /// What speed and acceleration are between two times, s.
    pub(crate) fn ranges(&self, from: f64, to: f64) -> Ranges {
        let mut ranges = Ranges::NONE;
        // One that has just ended is at its end, too.
        let before = self.phases.partition_point(|phase| phase.begin < from);
        for (phase, end) in self.lasting().skip(before.saturating_sub(1)) {
            if phase.begin > to {
                break;
            }
            let (first, last) = (from.max(phase.begin), to.min(end));
            if first > last {
                continue;
            }
            ranges = ranges.with(&phase.at(first)).with(&phase.at(last));
            // Where the acceleration passes zero the speed is largest or least.
            let turn = phase.begin - phase.state.acceleration / phase.jerk;
            if first < turn && turn < last {
                ranges = ranges.with(&phase.at(turn));
            }
        }
        if to >= self.duration {
            ranges = ranges.with(&self.end);
        }
        ranges
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::timing;
    use proptest::prelude::*;

    fn bounds() -> impl Strategy<Value = JointBounds> {
        let jerk = prop_oneof![Just(0.0), 5.0..300.0_f64];
        (0.01..5.0_f64, 0.1..20.0_f64, jerk).prop_map(|(velocity, acceleration, jerk)| {
            JointBounds {
                velocity,
                acceleration,
                jerk,
            }
        })
    }

    fn at_rest(position: f64) -> JointState {
        JointState {
            position,
            ..JointState::default()
        }
    }

    proptest! {
        #[test]
        fn from_rest_to_rest_takes_the_least_time(from in -3.0..3.0_f64, to in -3.0..3.0_f64, bounds in bounds()) {
            let course = Course::rest_to_rest(from, to, &bounds);
            let times = timing::between(&[(at_rest(from), at_rest(to), bounds)]).unwrap();
            let within = 1e-9 * (1.0 + times.together);
            prop_assert!((course.duration() - times.together).abs() < within, "{} {}", course.duration(), times.together);
            if bounds.jerk == 0.0 {
                let (way, v, a) = ((to - from).abs(), bounds.velocity, bounds.acceleration);
                let closed = if way >= v * v / a { way / v + v / a } else { 2.0 * (way / a).sqrt() };
                prop_assert!((course.duration() - closed).abs() < 1e-9);
            }
        }

        #[test]
        fn a_course_keeps_its_limits_has_no_steps_and_exact_ends_and_stretched_is_the_same_but_slower(
            from in -3.0..3.0_f64, to in -3.0..3.0_f64, bounds in bounds(), factor in 1.0..4.0_f64,
        ) {
            prop_assume!(from != to);
            let course = Course::rest_to_rest(from, to, &bounds);
            let slow = course.stretched(factor);
            prop_assert!((slow.duration() - factor * course.duration()).abs() < 1e-9);
            prop_assert_eq!(course.at(0.0).position, from);
            prop_assert_eq!(course.at(-1.0), course.at(0.0));
            prop_assert_eq!(course.at(course.duration()), at_rest(to));
            prop_assert_eq!(slow.at(slow.duration()), at_rest(to));
            let dt = course.duration() / 500.0;
            let mut before = course.at(0.0);
            for step in 1..=500_u32 {
                let t = dt * f64::from(step);
                let now = course.at(t);
                prop_assert!(now.velocity.abs() <= bounds.velocity * (1.0 + 1e-12) + 1e-12);
                prop_assert!(now.acceleration.abs() <= bounds.acceleration * (1.0 + 1e-9) + 1e-12);
                prop_assert!((now.velocity - before.velocity).abs() <= bounds.acceleration * dt * (1.0 + 1e-9) + 1e-12);
                let mean = (now.position - before.position) / dt;
                prop_assert!(mean.abs() <= bounds.velocity * (1.0 + 1e-9) + 1e-9);
                prop_assert!((mean - 0.5 * (now.velocity + before.velocity)).abs() <= bounds.acceleration * dt);
                if bounds.jerk > 0.0 {
                    let harder = (now.acceleration - before.acceleration).abs();
                    prop_assert!(harder <= bounds.jerk * dt * (1.0 + 1e-9) + 1e-9, "{harder}");
                }
                let later = slow.at(factor * t);
                prop_assert!((later.position - now.position).abs() < 1e-9);
                prop_assert!((later.velocity * factor - now.velocity).abs() < 1e-6);
                before = now;
            }
        }

        #[test]
        fn the_ranges_of_some_time_hold_every_speed_and_acceleration_in_it(
            to in -3.0..3.0_f64, bounds in bounds(), first in 0.0..1.0_f64, lasts in 0.0..0.3_f64, within in 0.0..1.0_f64,
        ) {
            let course = Course::rest_to_rest(0.0, to, &bounds);
            let (from, until) = (first * course.duration(), (first + lasts) * course.duration());
            let ranges = course.ranges(from, until);
            let now = course.at(from + within * (until - from));
            let holds = |range: Range, number: f64| range.least - 1e-9 <= number && number <= range.most + 1e-9;
            prop_assert!(holds(ranges.velocity, now.velocity), "{ranges:?} {now:?}");
            prop_assert!(holds(ranges.acceleration, now.acceleration), "{ranges:?} {now:?}");
            prop_assert!(holds(course.positions(), now.position), "{:?} {now:?}", course.positions());
        }
    }

    proptest! {
        #[test]
        fn to_rest_takes_the_time_and_the_way_that_ruckig_finds_and_keeps_its_limits(
            speed in -5.0..5.0_f64, pull in -1.0..1.0_f64, bounds in bounds(), stretch in 0.0..3.0_f64,
        ) {
            let from = JointState { position: 0.7, velocity: speed, acceleration: pull * bounds.acceleration };
            let (least, way) = timing::stops(&[(from, bounds)]).unwrap()[0];
            let course = Course::to_rest(&from, &bounds, 0.0);
            prop_assert!((course.duration() - least).abs() < 1e-9 * (1.0 + least), "{} {least}", course.duration());
            prop_assert!((course.at(least + 1.0).position - 0.7 - way).abs() < 1e-7 * (1.0 + way.abs()));
            // As long as is asked for, where that is longer and the joint is not at rest anyway before its acceleration is gone.
            let longer = least * stretch;
            let slow = Course::to_rest(&from, &bounds, longer);
            let moves = bounds.jerk == 0.0 || (speed + 0.5 * from.acceleration * from.acceleration.abs() / bounds.jerk).abs() > 1e-6;
            if moves {
                let expected = least.max(longer);
                prop_assert!((slow.duration() - expected).abs() < 1e-6 * (1.0 + expected), "{} {expected}", slow.duration());
            }
            for course in [course, slow] {
                let dt = course.duration() / 500.0;
                let begin = course.at(0.0);
                prop_assert!((begin.velocity - speed).abs() < 1e-12 && begin.position == 0.7);
                prop_assert!(bounds.jerk == 0.0 || (begin.acceleration - from.acceleration).abs() < 1e-9);
                let mut before = begin;
                for step in 1..=500_u32 {
                    let now = course.at(dt * f64::from(step));
                    prop_assert!(now.acceleration.abs() <= bounds.acceleration * (1.0 + 1e-9) + 1e-12);
                    let mean = (now.position - before.position) / dt;
                    prop_assert!((mean - 0.5 * (now.velocity + before.velocity)).abs() <= bounds.acceleration * dt + 1e-9);
                    prop_assert!((now.velocity - before.velocity).abs() <= bounds.acceleration * dt * (1.0 + 1e-9) + 1e-9);
                    if bounds.jerk > 0.0 {
                        let harder = (now.acceleration - before.acceleration).abs();
                        prop_assert!(harder <= bounds.jerk * dt * (1.0 + 1e-9) + 1e-8, "{harder}");
                    }
                    before = now;
                }
                let end = course.at(course.duration());
                prop_assert_eq!(end, at_rest(end.position));
                prop_assert!((end.position - before.position).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn what_rests_already_comes_to_rest_in_no_time() {
        for jerk in [0.0, 100.0] {
            let bounds = JointBounds {
                velocity: 1.0,
                acceleration: 10.0,
                jerk,
            };
            for within in [0.0, 1.0] {
                let course = Course::to_rest(&at_rest(2.0), &bounds, within);
                assert_eq!(course.at(0.0), at_rest(2.0));
                assert_eq!(course.at(course.duration()), at_rest(2.0));
            }
        }
    }

    #[test]
    fn a_course_of_no_length_takes_no_time() {
        let bounds = JointBounds {
            velocity: 1.0,
            acceleration: 1.0,
            jerk: 1.0,
        };
        let course = Course::rest_to_rest(2.0, 2.0, &bounds);
        assert_eq!(course.duration(), 0.0);
        assert_eq!(course.at(0.0), at_rest(2.0));
        // So short that its square is no number any more.
        let course = Course::rest_to_rest(0.0, 1e-200, &bounds);
        assert!(course.duration().is_finite() && course.at(0.0).velocity.is_finite());
    }
}
