//! The manipulator: its parameters, kinematics and dynamics. Knows no servo, no task and no hardware.
//!
//! Joint vectors are `[f64; 6]` in rad, poses are [`nalgebra::Isometry3`] named `a_t_b` for the pose
//! of frame b in frame a. Frame 0 is the base, frame 6 the wrist centre of the last link.

pub mod dynamics;
pub mod inverse;
pub mod kinematics;
pub mod model;

pub use dynamics::DynamicsOptions;
pub use inverse::{Branch, Elbow, IkError, IkSolution, IkSolutions, Shoulder, Wrist};
pub use model::{ArmModel, DOF, DhRow, Friction, JointLimits, Joints, Link, Motor};
