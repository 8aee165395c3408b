//! The physics: one PUMA 560 as a Rapier multibody on a fixed root, driven by joint torques.
//!
//! Base frame = world frame, z up, m, rad, s, N m. This module knows neither slots nor cameras.
//!
//! What the engine does not do by itself, and is done here: every joint gets its rotor inertia
//! (without it the mass matrix is too badly conditioned to integrate) and loses Rapier's default
//! damping; joint torques are applied as a pair of body torques, +tau on the child and -tau on the
//! parent; the inertia tensors go in as full matrices; bodies never sleep.

use std::time::Duration;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::{
    dynamics::{
        GenericJointBuilder, JointAxesMask, JointAxis, MassProperties, Multibody,
        MultibodyJointHandle, RigidBodyBuilder, RigidBodyHandle,
    },
    geometry::{ColliderBuilder, Group, InteractionGroups, InteractionTestMode},
    math::{Matrix, Pose, Rotation, Vector},
    pipeline::PhysicsWorld,
};

use crate::{
    puma560::{self, JOINTS, Link},
    shapes::{ArmShape, Shape, Solid},
};

/// Free fall, m/s^2.
pub const GRAVITY: f64 = 9.81;

/// The longest time step given to the engine, s; a servo period is divided into equal steps.
const MAX_STEP: f64 = 1.5e-3;

/// Substeps of the engine per step; each rebuilds the mass matrix, and the error is first order in
/// their length. Largest joint error against an exact integration, 2 s of driven swing in 1.5 ms
/// steps: 10.7, 2.7, 1.35, 0.68 mrad with 1, 4, 8, 16.
const SUBSTEPS: usize = 8;

/// Braking torque as a multiple of the largest drive torque of the joint.
const BRAKE_FACTOR: f64 = 1.5;

/// Below this joint speed, rad/s, the brakes grip for good.
const GRIP_SPEED: f64 = 1e-2;

/// Why the world cannot be built or cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// A joint angle at the start is not a number within the joint's limits.
    #[error("joint {joint} cannot start at {angle} rad: its limits are {low:.4} to {high:.4} rad")]
    Start {
        /// Joint number from 1.
        joint: usize,
        /// The angle asked for, rad.
        angle: f64,
        /// Lowest angle, rad.
        low: f64,
        /// Highest angle, rad.
        high: f64,
    },
    /// A torque is not a finite number.
    #[error("the torque of joint {joint} is {torque}, not a finite number")]
    Torque {
        /// Joint number from 1.
        joint: usize,
        /// The torque, N m.
        torque: f64,
    },
    /// The engine refused or lost a part of the arm, or its state is no longer finite.
    #[error("the physics engine {0}")]
    Engine(&'static str),
}

/// What the arm's world is built from.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldSetup {
    /// Joint angles at the start, rad.
    pub start: [f64; JOINTS],
    /// Whether the joints have the Coulomb and viscous friction of the real arm.
    pub friction: bool,
    /// The arm's outer form.
    pub arm: Vec<ArmShape>,
    /// What stands in the room, in the world frame.
    pub room: Vec<Shape>,
}

/// One PUMA 560 in its room.
pub struct World {
    physics: PhysicsWorld,
    bodies: [RigidBodyHandle; JOINTS + 1],
    arm: MultibodyJointHandle,
    links: [Link; JOINTS],
    friction: bool,
    /// The brakes are on, whether or not the arm stands.
    braking: bool,
    /// The brakes have brought the arm to rest and hold it.
    braked: bool,
    elapsed: Duration,
    positions: [f64; JOINTS],
    velocities: [f64; JOINTS],
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("elapsed", &self.elapsed)
            .field("positions", &self.positions)
            .field("velocities", &self.velocities)
            .field("braked", &self.braked)
            .finish_non_exhaustive()
    }
}

impl World {
    /// Builds the world with the arm at rest, brakes on.
    ///
    /// # Errors
    /// A start angle outside its joint's limits, or an engine that refuses the arm.
    pub fn new(setup: &WorldSetup) -> Result<Self, WorldError> {
        let links = puma560::links();
        check_start(&links, &setup.start)?;
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::new(0.0, 0.0, -GRAVITY);
        physics.integration_parameters.num_solver_iterations = SUBSTEPS;
        add_room(&mut physics, &setup.room);
        let (bodies, arm) = add_arm(&mut physics, &links, &setup.arm)?;
        let mut world = Self {
            physics,
            bodies,
            arm,
            links,
            friction: setup.friction,
            braking: true,
            braked: false,
            elapsed: Duration::ZERO,
            positions: setup.start,
            velocities: [0.0; JOINTS],
        };
        world.settle(&setup.start)?;
        world.grip()?;
        Ok(world)
    }

    /// Joint angles, rad.
    #[must_use]
    pub fn positions(&self) -> &[f64; JOINTS] {
        &self.positions
    }

    /// Joint speeds, rad/s.
    #[must_use]
    pub fn velocities(&self) -> &[f64; JOINTS] {
        &self.velocities
    }

    /// Simulated time since the beginning.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.elapsed
    }

    /// Poses of the base and the six link frames as the engine has them, `world_T_link`.
    #[must_use]
    pub fn link_poses(&self) -> [Isometry3<f64>; JOINTS + 1] {
        self.bodies.map(|handle| {
            self.physics
                .bodies
                .get(handle)
                .map_or_else(Isometry3::identity, |body| isometry(body.position()))
        })
    }

    /// Advances by `period` with the brakes off and constant joint torques, N m. The drives
    /// saturate at their largest torques.
    ///
    /// # Errors
    /// A torque that is not finite (nothing moves then), or an engine state that is not.
    pub fn drive(&mut self, torques: &[f64; JOINTS], period: Duration) -> Result<(), WorldError> {
        for (index, torque) in torques.iter().enumerate() {
            if !torque.is_finite() {
                return Err(WorldError::Torque {
                    joint: index + 1,
                    torque: *torque,
                });
            }
        }
        if self.braking {
            self.set_friction(self.friction)?;
            self.braking = false;
            self.braked = false;
        }
        self.advance(torques, period)
    }

    /// Advances by `period` with the brakes on and the drives off: a turning joint is slowed down
    /// by its brake; once all are slow they are held where they are, without creep.
    ///
    /// # Errors
    /// As for [`drive`](Self::drive).
    pub fn brake(&mut self, period: Duration) -> Result<(), WorldError> {
        if !self.braking {
            self.set_brakes()?;
            self.braking = true;
        }
        if !self.braked && self.velocities.iter().all(|v| v.abs() < GRIP_SPEED) {
            self.grip()?;
        }
        self.advance(&[0.0; JOINTS], period)
    }

    fn advance(&mut self, torques: &[f64; JOINTS], period: Duration) -> Result<(), WorldError> {
        let seconds = period.as_secs_f64();
        self.elapsed += period;
        // Nothing but the arm moves in this world, so a gripped arm is a world that stands still.
        if self.braked || seconds <= 0.0 {
            return Ok(());
        }
        // The small allowance keeps 4.5 ms at three steps of 1.5 ms whatever the rounding.
        let steps = (seconds / MAX_STEP - 1e-6).ceil().max(1.0);
        self.physics.integration_parameters.dt = seconds / steps;
        for _ in 0..steps as u64 {
            self.apply(torques)?;
            self.physics.step();
        }
        self.read_back()
    }

    /// Sets the torques on the bodies: they persist in the engine, so they are set anew each step,
    /// about the axes as they stand now.
    fn apply(&mut self, torques: &[f64; JOINTS]) -> Result<(), WorldError> {
        let mut total = [Vector::ZERO; JOINTS + 1];
        for (index, (torque, link)) in torques.iter().zip(&self.links).enumerate() {
            let bias = if self.friction {
                (link.coulomb[1] - link.coulomb[0]) / 2.0
            } else {
                0.0
            };
            let torque = torque.clamp(-link.max_torque, link.max_torque) + bias;
            let parent = self
                .physics
                .bodies
                .get(self.bodies[index])
                .ok_or(WorldError::Engine("lost a link"))?;
            let axis = parent.position().rotation * Vector::Z;
            total[index] -= axis * torque;
            total[index + 1] += axis * torque;
        }
        for (handle, torque) in self.bodies.iter().zip(total) {
            if let Some(body) = self.physics.bodies.get_mut(*handle) {
                body.reset_torques(false);
                body.add_torque(torque, true);
            }
        }
        Ok(())
    }

    fn read_back(&mut self) -> Result<(), WorldError> {
        let multibody = arm(&self.physics, self.arm)?;
        let mut positions = [0.0; JOINTS];
        let mut velocities = [0.0; JOINTS];
        let joints = multibody.links().skip(1);
        for ((link, q), qd) in joints.zip(&mut positions).zip(&mut velocities) {
            *q = link.joint().coords()[HINGE];
            *qd = multibody.joint_velocity(link)[0];
        }
        if !positions
            .iter()
            .chain(&velocities)
            .all(|x: &f64| x.is_finite())
        {
            return Err(WorldError::Engine("lost the arm: its state is not finite"));
        }
        self.positions = positions;
        self.velocities = velocities;
        Ok(())
    }

    /// Puts the arm at `joints` and writes what the engine would otherwise choose per joint. The
    /// root must have lost its free joint before (first forward kinematics), else the vectors are
    /// indexed six places off.
    fn settle(&mut self, joints: &[f64; JOINTS]) -> Result<(), WorldError> {
        let PhysicsWorld {
            multibody_joints,
            bodies,
            ..
        } = &mut self.physics;
        let (multibody, _) = multibody_joints
            .get_mut(self.arm)
            .ok_or(WorldError::Engine("lost the arm"))?;
        multibody.forward_kinematics(bodies, true);
        if multibody.ndofs() != JOINTS {
            return Err(WorldError::Engine("gave the arm a wrong number of joints"));
        }
        for (index, link) in self.links.iter().enumerate() {
            multibody.armature_mut()[index] = link.rotor_inertia;
        }
        multibody.apply_displacements(joints);
        multibody.forward_kinematics(bodies, true);
        multibody.update_rigid_bodies(bodies, true);
        self.set_brakes()?;
        self.read_back()
    }

    fn set_friction(&mut self, on: bool) -> Result<(), WorldError> {
        self.set_losses(|link| {
            if on {
                // The engine's dry friction is symmetric; the difference is a torque (`apply`).
                (
                    f64::midpoint(link.coulomb[0], link.coulomb[1]),
                    link.viscous,
                )
            } else {
                (0.0, 0.0)
            }
        })
    }

    fn set_brakes(&mut self) -> Result<(), WorldError> {
        self.set_losses(|link| (BRAKE_FACTOR * link.max_torque, 0.0))
    }

    fn set_losses(&mut self, losses: impl Fn(&Link) -> (f64, f64)) -> Result<(), WorldError> {
        let multibody = arm_mut(&mut self.physics, self.arm)?;
        for (index, link) in self.links.iter().enumerate() {
            let (dry, viscous) = losses(link);
            multibody.frictions_mut()[index] = dry;
            multibody.damping_mut()[index] = viscous;
        }
        Ok(())
    }

    /// The brakes grip: every joint stops where it is.
    fn grip(&mut self) -> Result<(), WorldError> {
        let multibody = arm_mut(&mut self.physics, self.arm)?;
        multibody.generalized_velocity_mut().fill(0.0);
        self.velocities = [0.0; JOINTS];
        self.braked = true;
        Ok(())
    }
}

/// The free coordinate of a hinge in the engine's layout: three linear ones, then about x.
const HINGE: usize = 3;

fn arm(physics: &PhysicsWorld, handle: MultibodyJointHandle) -> Result<&Multibody, WorldError> {
    let (multibody, _) = physics
        .multibody_joints
        .get(handle)
        .ok_or(WorldError::Engine("lost the arm"))?;
    Ok(multibody)
}

fn arm_mut(
    physics: &mut PhysicsWorld,
    handle: MultibodyJointHandle,
) -> Result<&mut Multibody, WorldError> {
    let (multibody, _) = physics
        .multibody_joints
        .get_mut(handle)
        .ok_or(WorldError::Engine("lost the arm"))?;
    Ok(multibody)
}

fn check_start(links: &[Link; JOINTS], start: &[f64; JOINTS]) -> Result<(), WorldError> {
    for (index, (angle, link)) in start.iter().zip(links).enumerate() {
        let [low, high] = link.limits;
        if !(low..=high).contains(angle) {
            return Err(WorldError::Start {
                joint: index + 1,
                angle: *angle,
                low,
                high,
            });
        }
    }
    Ok(())
}

/// The arm touches the room, never itself.
fn groups(of: Group, touches: Group) -> InteractionGroups {
    InteractionGroups::new(of, touches, InteractionTestMode::And)
}

const ARM: Group = Group::GROUP_1;
const ROOM: Group = Group::GROUP_2;

fn add_room(physics: &mut PhysicsWorld, room: &[Shape]) {
    let floor = ColliderBuilder::cuboid(5.0, 5.0, 0.5)
        .translation(Vector::new(0.0, 0.0, -0.5))
        .collision_groups(groups(ROOM, ARM));
    physics.insert_collider(floor, None);
    for shape in room {
        physics.insert_collider(collider(&shape.solid, groups(ROOM, ARM)), None);
    }
}

fn add_arm(
    physics: &mut PhysicsWorld,
    links: &[Link; JOINTS],
    shapes: &[ArmShape],
) -> Result<([RigidBodyHandle; JOINTS + 1], MultibodyJointHandle), WorldError> {
    let root = physics.insert_body(RigidBodyBuilder::fixed());
    let mut bodies = [root; JOINTS + 1];
    let mut last = None;
    let mut parent = root;
    for (index, link) in links.iter().enumerate() {
        let body = physics.insert_body(
            RigidBodyBuilder::dynamic()
                .additional_mass_properties(mass(link))
                .can_sleep(false),
        );
        let joint = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
            .local_frame1(hinge())
            .local_frame2(pose(&link.fixed_part().inverse()) * hinge())
            .contacts_enabled(false)
            .limits(JointAxis::AngX, link.limits)
            .build();
        last = physics.multibody_joints.insert(parent, body, joint, true);
        bodies[index + 1] = body;
        parent = body;
    }
    for part in shapes.iter().filter(|part| part.link > 0) {
        let handle = bodies.get(part.link).ok_or(WorldError::Engine(
            "was given a shape of a link that does not exist",
        ))?;
        let collider = collider(&part.shape.solid, groups(ARM, ROOM)).density(0.0);
        physics.insert_collider(collider, Some(*handle));
    }
    let arm = last.ok_or(WorldError::Engine("refused a joint of the arm"))?;
    Ok((bodies, arm))
}

/// Rapier turns a hinge about its x axis, the convention here is z: this rotation takes x to z.
fn hinge() -> Pose {
    Pose::from_rotation(Rotation::from_axis_angle(
        Vector::Y,
        -std::f64::consts::FRAC_PI_2,
    ))
}

fn mass(link: &Link) -> MassProperties {
    let [x, y, z] = link.inertia.data.0.map(Vector::from);
    MassProperties::with_inertia_matrix(
        vector(&link.centre.coords),
        link.mass,
        Matrix::from_cols(x, y, z),
    )
}

fn collider(solid: &Solid, groups: InteractionGroups) -> ColliderBuilder {
    match solid {
        Solid::Capsule { a, b, radius } => {
            ColliderBuilder::capsule_from_endpoints(vector(&a.coords), vector(&b.coords), *radius)
        }
        Solid::Block { centre, half } => {
            ColliderBuilder::cuboid(half.x, half.y, half.z).translation(vector(&centre.coords))
        }
    }
    .collision_groups(groups)
}

fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

fn pose(isometry: &Isometry3<f64>) -> Pose {
    let q = isometry.rotation.quaternion();
    Pose::from_parts(
        vector(&isometry.translation.vector),
        Rotation::from_xyzw(q.i, q.j, q.k, q.w),
    )
}

fn isometry(pose: &Pose) -> Isometry3<f64> {
    let r = pose.rotation;
    let t = pose.translation;
    Isometry3::from_parts(
        Translation3::from(Point3::new(t.x, t.y, t.z)),
        UnitQuaternion::new_normalize(Quaternion::new(r.w, r.x, r.y, r.z)),
    )
}

#[cfg(test)]
mod tests;
