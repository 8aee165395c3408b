//! The data objects that the nets of `push` exchange through the DOM, by name and type.

use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::{dispatching::Told, outcome::Failure};

/// What is to be pushed from where to where: written by the Dispatcher.
pub const JOB: &str = "push_job";
/// How it went: written by the Coordinator.
pub const ACCOUNT: &str = "push_account";

/// [`JOB`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Number of the command since the Dispatcher started, from 1.
    pub command: u32,
    /// Where the way of the tool begins, in the base frame of the arm, m: before the thing.
    pub from: Point2<f64>,
    /// Where it ends, behind which the thing shall stand.
    pub to: Point2<f64>,
}

impl Job {
    /// The direction of the push.
    #[must_use]
    pub fn direction(&self) -> Vector2<f64> {
        let way = self.to - self.from;
        way.try_normalize(1e-9).unwrap_or_else(Vector2::x)
    }

    /// How far along the push a point is, m, from its beginning.
    #[must_use]
    pub fn along(&self, point: &Point2<f64>) -> f64 {
        (point - self.from).dot(&self.direction())
    }

    /// `base_t_tool` so far (m) along the way and at a height (m): straight down, its x axis in the direction of the push, or
    /// turned about the vertical by so much from there (rad).
    #[must_use]
    pub fn pose(&self, along: f64, height: f64, turn: f64) -> Isometry3<f64> {
        let direction = self.direction();
        let at = self.from + direction * along;
        let heading = direction.y.atan2(direction.x) + turn;
        let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
        Isometry3::from_parts(Translation3::new(at.x, at.y, height), turned * down)
    }

    /// The length of the way, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        (self.to - self.from).norm()
    }
}

/// [`ACCOUNT`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Account {
    /// The job's command.
    pub command: u32,
    /// How the gripper is turned about the vertical, rad.
    pub turn: Option<f64>,
    /// Where on the way the tool was when it first felt the thing, m.
    pub touched_m: Option<f64>,
    /// Where on the way it was when the push ended, m.
    pub ended_m: Option<f64>,
    /// How often the contact was lost and felt for again.
    pub again: u32,
    /// What was not done, in the order of time: the request, and why.
    pub problems: Vec<(String, Failure)>,
}

impl Told for Account {
    fn command(&self) -> u32 {
        self.command
    }

    fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if let (Some(touched), Some(ended)) = (self.touched_m, self.ended_m) {
            let again = match self.again {
                0 => String::new(),
                count => format!(", felt for again {count} times"),
            };
            lines.push(format!(
                "felt at {:.0} mm of the way, pushed {:.0} mm from there{again}",
                touched * 1e3,
                (ended - touched) * 1e3
            ));
        }
        let problems = self.problems.iter();
        lines.extend(problems.map(|(request, failure)| format!("{request}: {}", failure.reason)));
        lines
    }

    fn failures(&self) -> Vec<Failure> {
        let problems = self.problems.iter();
        problems.map(|(_, failure)| failure.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tool_points_down_and_goes_along_the_line_with_its_x_axis_ahead() {
        let job = Job {
            command: 1,
            from: Point2::new(0.5, -0.2),
            to: Point2::new(0.5, 0.1),
        };
        let pose = job.pose(0.1, 0.43, 0.0);
        assert!((pose.translation.vector - Vector3::new(0.5, -0.1, 0.43)).norm() < 1e-12);
        assert!((pose * Vector3::z() + Vector3::z()).norm() < 1e-12);
        assert!((pose * Vector3::x() - Vector3::y()).norm() < 1e-12);
        assert!((job.along(&Point2::new(0.7, 0.0)) - 0.2).abs() < 1e-12);
    }
}
