//! Where something was: poses with their stamps, and the pose at a moment between two (SORMA technical report, section 2.2.6).

use std::collections::VecDeque;

use nalgebra::Isometry3;

/// A pose is carried on beyond the newest one for so long, s: a picture may be younger than the last reading.
const BEYOND: f64 = 0.02;

/// Poses by stamp, the newest last.
#[derive(Debug, Clone)]
pub struct History {
    /// What is older than the newest by more than this is forgotten, s.
    span: f64,
    poses: VecDeque<(f64, Isometry3<f64>)>,
}

impl History {
    /// That remembers a span, s.
    #[must_use]
    pub fn new(span: f64) -> Self {
        Self {
            span,
            poses: VecDeque::new(),
        }
    }

    /// Notes a pose, s. One that is not later than the newest is left out.
    pub fn note(&mut self, at: f64, pose: Isometry3<f64>) {
        if self.poses.back().is_some_and(|(newest, _)| *newest >= at) {
            return;
        }
        self.poses.push_back((at, pose));
        while self
            .poses
            .front()
            .is_some_and(|(old, _)| at - old > self.span)
        {
            self.poses.pop_front();
        }
    }

    /// The newest.
    #[must_use]
    pub fn newest(&self) -> Option<&(f64, Isometry3<f64>)> {
        self.poses.back()
    }

    /// The pose at a moment, s; `None` before the oldest that is remembered, and long after the newest.
    #[must_use]
    pub fn at(&self, moment: f64) -> Option<Isometry3<f64>> {
        let after = self.poses.partition_point(|(at, _)| *at < moment);
        let after = after.clamp(1, self.poses.len().saturating_sub(1).max(1));
        let ((from, first), (to, last)) = (self.poses.get(after - 1)?, self.poses.get(after)?);
        if !(moment >= *from && moment <= to + BEYOND) {
            return None;
        }
        let share = (moment - from) / (to - from);
        let place = first
            .translation
            .vector
            .lerp(&last.translation.vector, share);
        let turn = first
            .rotation
            .try_slerp(&last.rotation, share.min(1.0), 1e-12);
        Some(Isometry3::from_parts(
            place.into(),
            turn.unwrap_or(last.rotation),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    fn pose(time: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * (0.5 * time));
        Isometry3::from_parts(Translation3::new(2.0 * time, -time, 1.0), turn)
    }

    fn history() -> History {
        let mut history = History::new(1.0);
        for step in 0..400 {
            let time = f64::from(step) * 0.0045;
            history.note(time, pose(time));
        }
        history
    }

    #[test]
    fn a_pose_between_two_is_interpolated() {
        let history = history();
        for moment in [0.9, 1.234_5, 1.5, 1.7951, 1.8] {
            let found = history.at(moment).unwrap();
            let expected = pose(moment);
            let off = (found.translation.vector - expected.translation.vector).norm();
            assert!(off < 1e-12, "{moment}: {off}");
            assert!(found.rotation.angle_to(&expected.rotation) < 0.01);
        }
    }

    #[test]
    fn what_is_forgotten_or_to_come_has_no_pose() {
        let history = history();
        assert_eq!(history.at(0.7), None);
        assert_eq!(history.at(1.9), None);
        assert_eq!(history.at(f64::NAN), None);
        assert_eq!(History::new(1.0).at(0.0), None);
    }

    #[test]
    fn a_stamp_that_goes_back_is_left_out() {
        let mut history = history();
        history.note(0.1, pose(50.0));
        assert!((history.newest().unwrap().0 - 1.7955).abs() < 1e-9);
    }
}
