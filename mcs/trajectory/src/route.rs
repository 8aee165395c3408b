//! From what somebody asks for (a target, a path, a pace) to the segment that does it: one choice, for the planner's task
//! and for whoever plans without one.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::plan::SLOWEST;
use super::{Name, PathRequest, PlanError, Planner, Segment};
use mcs_model::Joints;
use mcs_model::inverse::Elbow;

/// Which way to take.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[allow(
    clippy::large_enum_variant,
    reason = "a path is copied as it is; one is made for a motion"
)]
pub enum PathKind {
    /// Every joint on a course of its own, all in the time of the slowest: fast, always possible between two positions
    /// within limits.
    #[default]
    Joint,
    /// The tool along a straight line, turning about one axis.
    StraightLine,
    /// The tool along the arc of a circle from where it is, turning about one axis.
    Arc {
        /// A point on the way, m, in the base frame.
        through: [f64; 3],
    },
    /// The same about a centre.
    ArcAbout {
        /// The centre, m, in the base frame. Start and target are equally far from it.
        centre: [f64; 3],
        /// Whether it goes the longer way round.
        longer: bool,
    },
    /// The tool over an obstacle: up along the base's z axis, across and down, turning about one axis.
    Arch {
        /// How far above the higher end it goes across, m.
        height: f64,
        /// The radius of the corners, m; as large as there is room when it is left out.
        corner: Option<f64>,
    },
    /// As a path planner has it that the program registers in a [`PlanningRegistry`](super::PlanningRegistry).
    Named {
        /// Its name.
        name: Name,
        /// What it asks for.
        numbers: Joints,
    },
}

/// How fast: fractions of full speed and of full acceleration. A number alone is both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Fraction of full speed.
    pub speed: f64,
    /// Fraction of full acceleration.
    pub acceleration: f64,
}

impl From<f64> for Pace {
    fn from(speed: f64) -> Self {
        Self {
            speed,
            acceleration: speed,
        }
    }
}

impl Pace {
    /// With an acceleration of its own, where one is given.
    #[must_use]
    pub fn new(speed: f64, acceleration: Option<f64>) -> Self {
        Self {
            speed,
            acceleration: acceleration.unwrap_or(speed),
        }
    }

    /// # Errors
    /// [`PlanError::Speed`] or [`PlanError::Acceleration`]: it is no usable fraction.
    pub(super) fn check(self) -> Result<Self, PlanError> {
        let usable = SLOWEST..=1.0;
        if !usable.contains(&self.speed) {
            return Err(PlanError::Speed { given: self.speed });
        }
        if !usable.contains(&self.acceleration) {
            return Err(PlanError::Acceleration {
                given: self.acceleration,
            });
        }
        Ok(self)
    }
}

/// Where to.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "a goal is copied as it is; one is made for a motion"
)]
pub enum Goal {
    /// Joint positions, rad or m.
    Joints(Joints),
    /// `base_t_tool`.
    Pose(Isometry3<f64>),
}

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Route {
    /// Where to.
    pub goal: Goal,
    /// Which way.
    pub path: PathKind,
    /// How fast.
    pub pace: Pace,
    /// Elbow posture at a pose that is reached in joints, of an arm with a closed form; the one nearest to the start when
    /// it is left out.
    pub elbow: Option<Elbow>,
}

impl Planner {
    /// The checked segment from joint positions `start` (rad or m), and the joint positions at its end.
    ///
    /// # Errors
    /// Everything that would stop it, before anything moves.
    pub fn segment(
        &mut self,
        start: &Joints,
        route: &Route,
    ) -> Result<(Segment, Joints), PlanError> {
        let (name, numbers) = route.path.named();
        let plan = self.planning.planner(name);
        let plan = plan.ok_or_else(|| PlanError::UnknownPath {
            name: name.parse().unwrap_or_default(),
        })?;
        let request = PathRequest {
            start,
            goal: &route.goal,
            pace: route.pace,
            elbow: route.elbow,
            numbers: &numbers,
        };
        let segment = plan(self, &request)?;
        let end = segment.end(&mut self.solver);
        let end = end.map_err(|reason| PlanError::Path {
            percent: 100.0,
            reason,
        })?;
        Ok((segment, end))
    }
}

impl PathKind {
    /// The path planner that is meant, and its numbers.
    fn named(&self) -> (&str, Joints) {
        let none = Joints::default();
        match self {
            Self::Joint => ("joint", none),
            Self::StraightLine => ("line", none),
            Self::Arc { through } => ("arc", (*through).into()),
            Self::ArcAbout {
                centre: [x, y, z],
                longer,
            } => ("about", [*x, *y, *z, f64::from(*longer)].into()),
            Self::Arch {
                height,
                corner: None,
            } => ("arch", [*height].into()),
            Self::Arch {
                height,
                corner: Some(corner),
            } => ("arch", [*height, *corner].into()),
            Self::Named { name, numbers } => (name.as_str(), *numbers),
        }
    }
}
