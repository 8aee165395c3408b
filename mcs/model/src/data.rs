//! What the computations on a model write: allocated once, so that no evaluation allocates.

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::features::{FrameId, Model};
use super::placement::Placement;

/// A quantity with a part for turning and a part for shifting: a velocity, an acceleration, or a moment and a force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spatial {
    pub turn: Vector3<f64>,
    pub shift: Vector3<f64>,
}

impl Spatial {
    pub const fn zero() -> Self {
        const NONE: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);
        Self {
            turn: NONE,
            shift: NONE,
        }
    }

    pub fn dot(&self, other: &Self) -> f64 {
        self.turn.dot(&other.turn) + self.shift.dot(&other.shift)
    }
}

/// Inertia of a rigid body about a point, in some axes: mass (kg), mass times its centre (kg m), and the tensor about the
/// point (kg m^2), which is symmetric: its diagonal, and the elements yz, xz and xy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RigidInertia {
    pub mass: f64,
    pub moment: Vector3<f64>,
    pub diagonal: Vector3<f64>,
    pub across: Vector3<f64>,
}

/// Inertia that a body seems to have while what it carries gives way: a symmetric matrix of six rows, by blocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ArticulatedInertia {
    /// Rows and columns of turning.
    pub turn: Matrix3<f64>,
    /// Rows of turning, columns of shifting.
    pub across: Matrix3<f64>,
    /// Rows and columns of shifting.
    pub shift: Matrix3<f64>,
}

/// Scratch and results for one model. Made by [`Model::data`]; of no use to a model with another number of joints.
#[derive(Debug, Clone)]
pub struct Data {
    /// The base frame, then every joint's frame in the base frame, moved.
    pub(super) placements: Vec<Placement>,
    pub(super) axes: Vec<Spatial>,
    pub(super) velocities: Vec<Spatial>,
    pub(super) accelerations: Vec<Spatial>,
    pub(super) forces: Vec<Spatial>,
    pub(super) biases: Vec<Spatial>,
    pub(super) inertias: Vec<RigidInertia>,
    pub(super) articulated: Vec<ArticulatedInertia>,
    /// Per joint: the force of its articulated inertia along its axis, one over the inertia there, and the drive left.
    pub(super) drives: Vec<(Spatial, f64, f64)>,
    pub(super) torques: Vec<f64>,
    pub(super) accelerated: Vec<f64>,
    pub(super) mass: DMatrix<f64>,
    pub(super) jacobian: DMatrix<f64>,
}

impl Data {
    /// Where a frame stands in the base frame, after a computation that took joint positions.
    #[must_use]
    pub fn placement(&self, model: &Model, frame: FrameId) -> Placement {
        let frame = model.at(frame);
        self.carrier(frame.carrier).then(&frame.placement)
    }

    /// Where the frame of a joint stands in the base frame, after a computation that took joint positions; the base
    /// frame itself for `None`.
    #[must_use]
    pub fn carrier(&self, joint: Option<usize>) -> Placement {
        let place = joint.map_or(0, |joint| joint + 1);
        // Of another, smaller model it has no joint of that number.
        let found = self.placements.get(place);
        found.copied().unwrap_or_else(Placement::identity)
    }
}

impl Model {
    /// Scratch and results for this model.
    #[must_use]
    pub fn data(&self) -> Data {
        let n = self.dof();
        let nothing = Spatial::zero();
        let no_inertia = RigidInertia {
            mass: 0.0,
            moment: Vector3::zeros(),
            diagonal: Vector3::zeros(),
            across: Vector3::zeros(),
        };
        let no_articulated = ArticulatedInertia {
            turn: Matrix3::zeros(),
            across: Matrix3::zeros(),
            shift: Matrix3::zeros(),
        };
        Data {
            placements: vec![Placement::identity(); n + 1],
            axes: vec![nothing; n],
            velocities: vec![nothing; n + 1],
            accelerations: vec![nothing; n + 1],
            forces: vec![nothing; n + 1],
            biases: vec![nothing; n + 1],
            inertias: vec![no_inertia; n + 1],
            articulated: vec![no_articulated; n + 1],
            drives: vec![(nothing, 0.0, 0.0); n],
            torques: vec![0.0; n],
            accelerated: vec![0.0; n],
            mass: DMatrix::zeros(n, n),
            jacobian: DMatrix::zeros(6, n),
        }
    }
}
