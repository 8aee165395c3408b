//! The arm of a process without an app: it goes exactly where the planner says, in a time of its own that passes only
//! with its motions. It has kinematics, limits and a planner, but no dynamics, no servo and nothing to bump into.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::Isometry3;
use sorma::Report;

use super::arm::Which;
use super::code;
use crate::client::{PlanReport, Target};
use crate::joints::Joints;
use crate::model::{Model, file::Inertias};
use crate::trajectory::{Blend, CartesianLimits, Goal, PlanError, Planner, Route};

/// Where it begins, rad: the elbow bent, with room on all sides.
const START: [f64; 6] = [
    0.0,
    std::f64::consts::FRAC_PI_4,
    -std::f64::consts::PI,
    0.0,
    std::f64::consts::FRAC_PI_4,
    0.0,
];
/// Lines are checked every so many seconds, as with the usual servo.
const CHECK_PERIOD_S: f64 = 0.018;
/// The control parameters that a servo has unless its configuration says otherwise: Hz, and damping ratio.
const CONTROL: [f64; 2] = [8.0, 1.0];

/// The arm.
#[derive(Debug)]
pub(super) struct LocalArm {
    planner: Planner,
    pub(super) joints: Joints,
    /// How long it has moved so far, s.
    pub(super) time_s: f64,
    /// Bandwidth of the position loop, Hz, and its damping ratio. Nothing follows from them here.
    pub(super) control: [f64; 2],
    pub(super) motions: u64,
}

/// The arm that all objects of a process share.
#[derive(Debug, Clone)]
pub(super) struct SharedArm(Result<Arc<Mutex<LocalArm>>, Report>);

impl SharedArm {
    pub(super) fn new() -> Self {
        Self(LocalArm::new().map(|arm| Arc::new(Mutex::new(arm))))
    }

    /// # Errors
    /// Why there is no arm.
    pub(super) fn lock(&self) -> Result<MutexGuard<'_, LocalArm>, Report> {
        let arm = self.0.as_ref().map_err(Report::clone)?;
        // It is changed in whole steps, so one who panicked has left it whole.
        Ok(arm.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl LocalArm {
    fn new() -> Result<Self, Report> {
        let model = Which::default().load(Inertias::Identified, None)?.model;
        let planner = Planner::new(Arc::new(model), CartesianLimits::default(), CHECK_PERIOD_S);
        let no_arm = |error| Report::error(code::MODEL, format!("{error}"));
        Ok(Self {
            planner: planner.map_err(no_arm)?,
            joints: START.into(),
            time_s: 0.0,
            control: CONTROL,
            motions: 0,
        })
    }

    /// What it is.
    pub(super) fn model(&self) -> &Model {
        self.planner.model()
    }

    /// `base_t_6`.
    pub(super) fn pose(&mut self) -> Isometry3<f64> {
        self.planner.tool_pose(&self.joints)
    }

    /// Where motions, one after the other, would end, and how long they would take with such a blend.
    pub(super) fn plan(&mut self, routes: &[Route], blend: Blend) -> Result<PlanReport, PlanError> {
        let mut report = PlanReport {
            joints: self.joints,
            duration_s: 0.0,
            smallest_singular_value: None,
        };
        let mut before = None;
        for route in routes {
            let (segment, end) = self.planner.segment(&report.joints, route)?;
            report.duration_s += segment.duration();
            if let Some(before) = &before {
                let bridge = self.planner.bridge((before, &segment), route.pace, blend);
                report.duration_s -= bridge.map_or(0.0, |bridge| bridge.gain(before));
            }
            let smallest = segment.singularity().map(|(smallest, _)| smallest);
            let values = [report.smallest_singular_value, smallest];
            report.smallest_singular_value = values.into_iter().flatten().reduce(f64::min);
            report.joints = end;
            before = Some(segment);
        }
        Ok(report)
    }

    /// Is there, and so much later.
    pub(super) fn moved(&mut self, joints: Joints, duration_s: f64) {
        self.joints = joints;
        self.time_s += duration_s;
        self.motions += 1;
    }
}

/// The same for the client interface.
pub(super) fn target(goal: &Goal) -> Target {
    match goal {
        Goal::Joints(joints) => Target::Joints(*joints),
        Goal::Pose(pose) => Target::Pose(rows(pose)),
    }
}

/// A pose as 16 numbers, row by row.
pub(super) fn rows(pose: &Isometry3<f64>) -> [f64; 16] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|index| matrix[(index / 4, index % 4)])
}
