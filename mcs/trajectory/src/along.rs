//! How far the tool is along its path over time, from 0 to 1: the timing of a path.
//!
//! Either one course for all of the path, or a path cut into sections of the same progress, each with a largest speed and
//! acceleration of its own. In these the square of the speed grows and falls in proportion to the progress, as far as the
//! sections before and after allow: forward from the start, then backward from the end (K. Shin and N. McKay, IEEE Trans.
//! Automatic Control 30(6), 1985, on a grid). So the tool slows down before a place where the joints need it, and only there.

use super::course::{Course, Ranges};
use super::timing::{JointBounds, JointState};

/// Sections of a path.
pub const SECTIONS: usize = 128;

/// The timing of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Along {
    course: Course<SECTIONS>,
    /// The hardest braking that each section allows, 1/s^2.
    braking: [f64; SECTIONS],
    /// The limit of jerk, 1/s^3; 0 for none.
    jerk: f64,
}

/// The largest speed, 1/s, and acceleration, 1/s^2, of each section, all above 0.
pub(super) type Sections = [(f64, f64); SECTIONS];

/// The section in which a place of the progress lies.
pub(super) fn section_of(progress: f64) -> usize {
    // A place before the start counts as the start.
    ((progress * SECTIONS as f64) as usize).min(SECTIONS - 1)
}

impl Along {
    /// From rest to rest in the least time under the same limits all along.
    #[must_use]
    pub fn even(bounds: &JointBounds) -> Self {
        Self {
            course: Course::rest_to_rest(0.0, 1.0, bounds).widened(),
            braking: [bounds.acceleration; SECTIONS],
            jerk: bounds.jerk,
        }
    }

    /// From rest to rest under limits of each section.
    pub(super) fn within(sections: &Sections) -> Self {
        let width = 1.0 / SECTIONS as f64;
        // Squares of the speeds where sections meet.
        let mut squares = [0.0; SECTIONS + 1];
        for index in 1..SECTIONS {
            let [(before, hardest), (after, _)] = [sections[index - 1], sections[index]];
            let gained = squares[index - 1] + 2.0 * width * hardest;
            squares[index] = before.min(after).powi(2).min(gained);
        }
        for index in (1..SECTIONS).rev() {
            let lost = squares[index + 1] + 2.0 * width * sections[index].1;
            squares[index] = squares[index].min(lost);
        }
        let speed = |index: usize| squares[index].sqrt();
        let mut begins = [0.0; SECTIONS + 1];
        for index in 0..SECTIONS {
            begins[index + 1] = begins[index] + 2.0 * width / (speed(index) + speed(index + 1));
        }
        let phase = |index: usize| {
            let state = JointState {
                position: index as f64 * width,
                velocity: speed(index),
                acceleration: (squares[index + 1] - squares[index]) / (2.0 * width),
            };
            (begins[index], state, 0.0)
        };
        let end = JointState {
            position: 1.0,
            ..JointState::default()
        };
        Self {
            course: Course::of_phases(begins[SECTIONS], end, phase),
            braking: sections.map(|(_, hardest)| hardest),
            jerk: 0.0,
        }
    }

    /// The same in `factor` times the time, at least 1.
    pub(super) fn stretched(&self, factor: f64) -> Self {
        Self {
            course: self.course.stretched(factor),
            braking: self.braking.map(|hardest| hardest / (factor * factor)),
            jerk: self.jerk / (factor * factor * factor),
        }
    }

    /// How long it takes, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.course.duration()
    }

    /// The progress, its speed and its acceleration at time `t`, s.
    #[must_use]
    pub fn at(&self, t: f64) -> JointState {
        self.course.at(t)
    }

    /// What speed and acceleration are between two times, s.
    pub(super) fn ranges(&self, from: f64, to: f64) -> Ranges {
        self.course.ranges(from, to)
    }

    /// The limit of jerk, 1/s^3; 0 for none.
    #[must_use]
    pub fn jerk(&self) -> f64 {
        self.jerk
    }

    /// The hardest braking that is allowed all the way between two times (s), 1/s^2.
    pub(super) fn braking(&self, from: f64, to: f64) -> f64 {
        let [from, to] = [from, to].map(|time| section_of(self.at(time).position));
        let all = self.braking.get(from..=to).unwrap_or_default();
        all.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Limits that differ from stretch to stretch.
    fn sections() -> impl Strategy<Value = Sections> {
        let limits = (0.001..3.0_f64, 0.05..10.0_f64);
        prop::collection::vec(limits, 1..9).prop_map(|stretches| {
            std::array::from_fn(|index| stretches[index * stretches.len() / SECTIONS])
        })
    }

    proptest! {
        #[test]
        fn every_section_keeps_its_limits_and_no_speed_has_a_step(sections in sections()) {
            let along = Along::within(&sections);
            let steps = 3_000_u32;
            let step = along.duration() / f64::from(steps);
            prop_assert_eq!(along.at(0.0).velocity, 0.0);
            prop_assert_eq!(along.at(along.duration()), JointState { position: 1.0, ..JointState::default() });
            let mut before = along.at(0.0);
            for count in 1..=steps {
                let now = along.at(f64::from(count) * step);
                let touched = section_of(before.position)..=section_of(now.position);
                let all = || touched.clone().map(|index| sections[index]);
                let fastest = all().fold(0.0, |most: f64, (speed, _)| most.max(speed));
                let hardest = all().fold(0.0, |most: f64, (_, acceleration)| most.max(acceleration));
                prop_assert!(now.velocity <= fastest * (1.0 + 1e-9));
                prop_assert!((now.velocity - before.velocity).abs() <= hardest * step * (1.0 + 1e-9) + 1e-9);
                let mean = 0.5 * (now.velocity + before.velocity) * step;
                prop_assert!(now.position >= before.position);
                prop_assert!((now.position - before.position - mean).abs() <= hardest * step * step + 1e-9);
                before = now;
            }
        }

        #[test]
        fn the_same_limits_all_along_take_hardly_longer_than_the_least_time(speed in 0.05..3.0_f64, hardest in 0.05..10.0_f64) {
            let bounds = JointBounds { velocity: speed, acceleration: hardest, jerk: 0.0 };
            let least = Along::even(&bounds).duration();
            let found = Along::within(&[(speed, hardest); SECTIONS]).duration();
            // A ramp takes whole sections: at most one at either end is gone through at half the speed.
            let most = least + 2.0 / (SECTIONS as f64 * speed);
            prop_assert!(found >= least * (1.0 - 1e-9) && found <= most * (1.0 + 1e-9), "{found} {least}");
        }
    }
}
