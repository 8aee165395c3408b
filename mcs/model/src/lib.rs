//! The manipulator as data: a tree of joints and bodies of any shape, and what can be computed from it.
//!
//! A [`Model`] is made once, in code ([`ModelBuilder`]), from a TOML file ([`mod@file`]), from URDF ([`urdf`]) or by the
//! name of one that is [`built_in`], and never changes. Whatever a computation writes stands in [`Data`], which is
//! allocated once for a model: no evaluation allocates. The split is that of Pinocchio (Carpentier and others, SII 2019);
//! the algorithms are those of R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008.
//!
//! Units are m, rad, kg, s, N and N m. A value of a joint that turns is in rad, of one that slides in m, and the force
//! at it in N m or N. Vectors ([`Joints`]) have one number for each moving joint, in the model's order, parents before
//! children. A joint turns about, or slides along, the z axis of its own frame. Knows no servo, no task and no hardware.

mod builder;
pub mod built_in;
mod data;
mod dynamics;
mod features;
pub mod file;
pub mod hull;
pub mod inverse;
pub mod joints;
mod kinematics;
pub mod origin;
mod placement;
mod shapes;
pub mod urdf;

pub use builder::{JointSpec, ModelBuilder, ModelError};
pub use data::Data;
pub use dynamics::{DynamicsOptions, NotPositiveDefinite};
pub use features::{
    Body, Frame, FrameId, Friction, Joint, JointKind, Limits, MAX_JOINTS, Model, Motor,
};
pub use joints::{Joints, MAX_SLOTS, TooManyJoints};
pub use placement::Placement;
pub use shapes::{Shape, Solid};

#[cfg(test)]
mod tests;
