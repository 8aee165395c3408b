//! Path planners and solvers of inverse kinematics by the names that requests and configurations use for them.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use tinyvec::ArrayVec;

use super::solver::{ByClosedForm, BySearch, Inverse};
use super::{Goal, Pace, PlanError, Planner, Segment};
use mcs_model::inverse::Elbow;
use mcs_model::{Joints, Model};

/// The longest name of a path planner, bytes.
const LONGEST: usize = 24;

/// The name of a path planner, short enough to be copied with a request.
#[derive(Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Name(ArrayVec<[u8; LONGEST]>);

/// A name that is too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the name of a path planner has at most {LONGEST} bytes")]
pub struct NameTooLong;

impl FromStr for Name {
    type Err = NameTooLong;

    fn from_str(text: &str) -> Result<Self, NameTooLong> {
        let bytes = ArrayVec::try_from(text.as_bytes());
        bytes.map(Self).map_err(|_| NameTooLong)
    }
}

impl Name {
    /// The name; empty when somebody sent bytes that are no text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        std::str::from_utf8(&self.0).unwrap_or_default()
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

/// What a path planner is asked for.
#[derive(Debug, Clone, Copy)]
pub struct PathRequest<'a> {
    /// Joint positions from which it begins, rad or m.
    pub start: &'a Joints,
    /// Where to.
    pub goal: &'a Goal,
    /// How fast.
    pub pace: Pace,
    /// Elbow posture at a pose that is reached in joints, of an arm with a closed form.
    pub elbow: Option<Elbow>,
    /// Numbers of the request, as the path planner has them.
    pub numbers: &'a [f64],
}

impl PathRequest<'_> {
    /// As many numbers as there must be.
    ///
    /// # Errors
    /// [`PlanError::Numbers`].
    pub fn exactly<const N: usize>(&self) -> Result<[f64; N], PlanError> {
        let given = self.numbers.len();
        let found = self.numbers.try_into();
        found.map_err(|_| PlanError::Numbers { needed: N, given })
    }

    /// Where the tool is to be at the end.
    ///
    /// # Errors
    /// As [`Planner::check_joints`].
    pub fn pose(&self, planner: &mut Planner) -> Result<Isometry3<f64>, PlanError> {
        match self.goal {
            Goal::Pose(pose) => Ok(*pose),
            Goal::Joints(joints) => {
                planner.check_joints(joints)?;
                Ok(planner.tool_pose(joints))
            }
        }
    }
}

type PlanPath =
    Arc<dyn Fn(&mut Planner, &PathRequest<'_>) -> Result<Segment, PlanError> + Send + Sync>;
type BuildInverse = Arc<dyn Fn(&Arc<Model>) -> Option<Box<dyn Inverse>> + Send + Sync>;

/// The path planners and solvers of inverse kinematics that a program offers.
#[derive(Clone)]
pub struct PlanningRegistry {
    paths: BTreeMap<String, PlanPath>,
    inverses: BTreeMap<String, BuildInverse>,
}

impl Default for PlanningRegistry {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Debug for PlanningRegistry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (paths, inverses) = (self.paths.keys(), self.inverses.keys());
        f.debug_list().entries(paths).entries(inverses).finish()
    }
}

impl PlanningRegistry {
    /// The path planners that come with this crate (`joint`, `direct`, `line`, `arc`, `about` and `arch`), and the solvers
    /// (`closed_form` and `search`).
    #[must_use]
    pub fn new() -> Self {
        let mut registry = Self {
            paths: BTreeMap::new(),
            inverses: BTreeMap::new(),
        };
        registry.path("joint", |planner, request| {
            let [] = request.exactly()?;
            let joints = match request.goal {
                Goal::Joints(joints) => *joints,
                Goal::Pose(pose) => planner.joints_for(pose, request.start, request.elbow)?,
            };
            planner.joint(request.start, &joints, request.pace)
        });
        registry.path("direct", |planner, request| {
            let [] = request.exactly()?;
            let joints = match request.goal {
                Goal::Joints(joints) => *joints,
                Goal::Pose(pose) => planner.joints_for(pose, request.start, request.elbow)?,
            };
            planner.direct(request.start, &joints, request.pace)
        });
        registry.path("line", |planner, request| {
            let [] = request.exactly()?;
            let goal = request.pose(planner)?;
            planner.line(request.start, &goal, request.pace)
        });
        registry.path("arc", |planner, request| {
            let through: [f64; 3] = request.exactly()?;
            let goal = request.pose(planner)?;
            planner.arc_through(request.start, (through.into(), &goal), request.pace)
        });
        registry.path("about", |planner, request| {
            let [x, y, z, longer] = request.exactly()?;
            let goal = request.pose(planner)?;
            let about = ([x, y, z].into(), longer != 0.0, &goal);
            planner.arc_about(request.start, about, request.pace)
        });
        registry.path("arch", |planner, request| {
            let (height, corner) = match *request.numbers {
                [height, corner] => (height, Some(corner)),
                _ => (request.exactly::<1>()?[0], None),
            };
            let goal = request.pose(planner)?;
            planner.arch(request.start, (height, corner, &goal), request.pace)
        });
        registry.inverse("closed_form", |model| {
            let closed = ByClosedForm::of(model)?;
            Some(Box::new(closed))
        });
        registry.inverse("search", |model| Some(Box::new(BySearch::of(model))));
        registry
    }

    /// Registers a path planner under `name`, in place of one that has it already.
    pub fn path(
        &mut self,
        name: &str,
        plan: impl Fn(&mut Planner, &PathRequest<'_>) -> Result<Segment, PlanError>
        + Send
        + Sync
        + 'static,
    ) {
        self.paths.insert(name.to_owned(), Arc::new(plan));
    }

    /// Registers a solver under `name`, in place of one that has it already; one that is not for an arm is `None`.
    pub fn inverse(
        &mut self,
        name: &str,
        build: impl Fn(&Arc<Model>) -> Option<Box<dyn Inverse>> + Send + Sync + 'static,
    ) {
        self.inverses.insert(name.to_owned(), Arc::new(build));
    }

    /// The path planner called `name`.
    pub(super) fn planner(&self, name: &str) -> Option<PlanPath> {
        self.paths.get(name).map(Arc::clone)
    }

    /// Makes the solver called `name` for an arm; `None` when none is, and `Some(None)` when it is not for that arm.
    #[must_use]
    pub fn solver(&self, name: &str, model: &Arc<Model>) -> Option<Option<Box<dyn Inverse>>> {
        self.inverses.get(name).map(|build| build(model))
    }

    /// The names of all solvers, in order.
    pub fn solvers(&self) -> impl Iterator<Item = &str> {
        self.inverses.keys().map(String::as_str)
    }
}

#[cfg(test)]
mod tests;
