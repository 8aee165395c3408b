//! Rigid-body dynamics of a tree: recursive Newton-Euler, composite rigid bodies, articulated bodies.
//!
//! All vectors have the axes of the base frame, so that nothing has to be turned between bodies: only each body's
//! inertia is, once. Mass matrix and forward dynamics go about one common point, the mean of the joints' origins, so
//! that an arm far from the base frame loses no digits.

use nalgebra::{DMatrix, Matrix3, Vector3, Vector6};

use super::data::{ArticulatedInertia, Data, RigidInertia, Spatial};
use super::features::{FrameId, Joint, JointKind, Model};
use super::kinematics::number;

/// What dynamics count besides the rigid bodies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DynamicsOptions {
    /// Adds the reflected inertia of the rotors. Without it the PUMA's mass matrix is so badly
    /// conditioned that a simulation of it is useless.
    pub rotor_inertia: bool,
    /// Adds viscous and Coulomb friction.
    pub friction: bool,
}

impl DynamicsOptions {
    /// Links only.
    pub const RIGID: Self = Self {
        rotor_inertia: false,
        friction: false,
    };
    /// Links and rotors: what the drives feel on a frictionless arm.
    pub const WITH_ROTORS: Self = Self {
        rotor_inertia: true,
        friction: false,
    };
    /// Links, rotors and friction.
    pub const FULL: Self = Self {
        rotor_inertia: true,
        friction: true,
    };
}

/// A joint carries nothing that resists it, or a number is none: no acceleration follows from a torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the mass matrix is not positive definite: nothing that joint {} carries resists it", joint + 1)]
pub struct NotPositiveDefinite {
    /// The joint, by index from 0.
    pub joint: usize,
}

impl Joint {
    fn rotor(&self, options: DynamicsOptions) -> f64 {
        if options.rotor_inertia {
            self.motor.reflected_inertia()
        } else {
            0.0
        }
    }

    /// Index of what carries the joint, where 0 is the ground.
    fn below(&self) -> usize {
        self.parent.map_or(0, |parent| parent + 1)
    }

    /// The outward pass for the joint at `index`: how its frame turns, and the acceleration of its origin, from what
    /// carries it and from its own speed and acceleration.
    #[inline]
    fn outward(&self, data: &mut Data, index: usize, speed: f64, rate: f64) {
        let (below, here) = (self.below(), index + 1);
        let placement = &data.placements[here];
        let way = placement.origin - data.placements[below].origin;
        let axis = placement.rotation.column(2).into_owned();
        let speed = axis * speed;
        let mut turning = data.velocities[below].turn;
        let Spatial {
            turn: mut turning_rate,
            shift: mut acceleration,
        } = data.accelerations[below];
        acceleration += turning_rate.cross(&way) + turning.cross(&turning.cross(&way));
        match self.kind {
            JointKind::Revolute => {
                turning_rate += axis * rate + turning.cross(&speed);
                turning += speed;
            }
            JointKind::Prismatic => acceleration += axis * rate + turning.cross(&speed) * 2.0,
        }
        data.velocities[here].turn = turning;
        data.accelerations[here] = Spatial {
            turn: turning_rate,
            shift: acceleration,
        };
    }
}

impl Model {
    /// Inverse dynamics: the joint torques (N m, or N) that give accelerations `qdd` at positions `q` and speeds `qd`,
    /// gravity included. A number that is missing counts as NaN.
    pub fn inverse_dynamics<'d>(
        &self,
        data: &'d mut Data,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        options: DynamicsOptions,
    ) -> &'d [f64] {
        self.forward(data, q);
        data.velocities[0] = Spatial::zero();
        data.accelerations[0] = Spatial {
            turn: Vector3::zeros(),
            shift: -self.gravity,
        };
        for (index, joint) in self.joints.iter().enumerate() {
            let here = index + 1;
            joint.outward(data, index, number(qd, index), number(qdd, index));
            let turning = data.velocities[here].turn;
            let Spatial {
                turn: turning_rate,
                shift: acceleration,
            } = data.accelerations[here];
            let body = &joint.body;
            let turn = &data.placements[here].rotation;
            let centre = turn * body.centre;
            let force = (acceleration
                + turning_rate.cross(&centre)
                + turning.cross(&turning.cross(&centre)))
                * body.mass;
            let (own, own_rate) = (turn.tr_mul(&turning), turn.tr_mul(&turning_rate));
            let moment = turn * (body.inertia * own_rate + own.cross(&(body.inertia * own)));
            data.forces[here] = Spatial {
                turn: moment + centre.cross(&force),
                shift: force,
            };
        }
        self.inward(data, |joint, index| {
            let mut torque = joint.rotor(options) * number(qdd, index);
            if options.friction {
                torque += joint.motor.friction_torque(number(qd, index));
            }
            torque
        })
    }

    /// Velocity-product acceleration of a frame's origin, the term `dJ/dt qd`: its linear (m/s^2) and angular (rad/s^2)
    /// acceleration in the base frame with all joint accelerations zero, at positions `q` and speeds `qd`. Leaves the
    /// last Jacobian as it is.
    pub fn bias_acceleration(
        &self,
        data: &mut Data,
        q: &[f64],
        qd: &[f64],
        frame: FrameId,
    ) -> Vector6<f64> {
        self.forward(data, q);
        data.velocities[0] = Spatial::zero();
        data.accelerations[0] = Spatial::zero();
        for (index, joint) in self.joints.iter().enumerate() {
            joint.outward(data, index, number(qd, index), 0.0);
        }
        let carrier = self.at(frame).carrier.map_or(0, |joint| joint + 1);
        let way = data.placement(self, frame).origin - data.placements[carrier].origin;
        let turning = data.velocities[carrier].turn;
        let Spatial { turn, shift } = data.accelerations[carrier];
        let shift = shift + turn.cross(&way) + turning.cross(&turning.cross(&way));
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    /// Torques (N m, or N) that hold the arm at rest at `q` against gravity.
    pub fn gravity_torques<'d>(&self, data: &'d mut Data, q: &[f64]) -> &'d [f64] {
        self.forward(data, q);
        for (index, joint) in self.joints.iter().enumerate() {
            // Holding against gravity is the same as accelerating upwards.
            let force = self.gravity * -joint.body.mass;
            let centre = data.placements[index + 1].rotation * joint.body.centre;
            data.forces[index + 1] = Spatial {
                turn: centre.cross(&force),
                shift: force,
            };
        }
        self.inward(data, |_, _| 0.0)
    }

    /// The inward pass: joint torques from the moment about each joint's origin and the force that its body needs.
    fn inward<'d>(&self, data: &'d mut Data, besides: impl Fn(&Joint, usize) -> f64) -> &'d [f64] {
        for (index, joint) in self.joints.iter().enumerate().rev() {
            let (below, here) = (joint.below(), index + 1);
            let Spatial {
                turn: moment,
                shift: force,
            } = data.forces[here];
            let placement = &data.placements[here];
            let axis = placement.rotation.column(2);
            let along = match joint.kind {
                JointKind::Revolute => axis.dot(&moment),
                JointKind::Prismatic => axis.dot(&force),
            };
            data.torques[index] = along + besides(joint, index);
            if below > 0 {
                let way = placement.origin - data.placements[below].origin;
                let to = &mut data.forces[below];
                to.turn += moment + way.cross(&force);
                to.shift += force;
            }
        }
        &data.torques
    }

    /// Joint-space mass matrix M(q): kg m^2 between joints that turn, kg between joints that slide, kg m across.
    pub fn mass_matrix<'d>(
        &self,
        data: &'d mut Data,
        q: &[f64],
        options: DynamicsOptions,
    ) -> &'d DMatrix<f64> {
        self.forward(data, q);
        self.about_one_point(data);
        let n = self.joints.len();
        let mass = data.mass.as_mut_slice();
        for (index, joint) in self.joints.iter().enumerate().rev() {
            let (carried, own) = data.inertias.split_at_mut(index + 1);
            let (whole, axis) = (&own[0], &data.axes[index]);
            let force = whole.force(axis);
            mass[n * index + index] = axis.dot(&force) + joint.rotor(options);
            for carrier in self.carriers(joint.parent) {
                let common = data.axes[carrier].dot(&force);
                mass[n * index + carrier] = common;
                mass[n * carrier + index] = common;
            }
            if joint.parent.is_some() {
                carried[joint.below()].add(whole);
            }
        }
        &data.mass
    }

    /// Forward dynamics: joint accelerations (rad/s^2, or m/s^2) under `torques` (N m, or N), by articulated bodies.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] names the first joint, from the tips, for which no acceleration follows: only bodies
    /// without inertia, or numbers that are not finite, give that.
    pub fn forward_dynamics<'d>(
        &self,
        data: &'d mut Data,
        q: &[f64],
        qd: &[f64],
        torques: &[f64],
        options: DynamicsOptions,
    ) -> Result<&'d [f64], NotPositiveDefinite> {
        self.forward(data, q);
        self.about_one_point(data);
        self.bias_forces(data, qd);
        for (index, joint) in self.joints.iter().enumerate().rev() {
            let (below, here) = (joint.below(), index + 1);
            let (axis, inertia) = (data.axes[index], data.articulated[here]);
            let force = inertia.force(&axis);
            let resistance = axis.dot(&force) + joint.rotor(options);
            // What is left of the largest term by rounding counts as nothing.
            let largest = axis.turn.component_mul(&force.turn).amax()
                + axis.shift.component_mul(&force.shift).amax();
            if resistance.is_nan() || resistance <= largest * 1e-13 {
                return Err(NotPositiveDefinite { joint: index });
            }
            let mut drive = number(torques, index) - axis.dot(&data.forces[here]);
            if options.friction {
                drive -= joint.motor.friction_torque(number(qd, index));
            }
            data.drives[index] = (force, 1.0 / resistance, drive);
            if below > 0 {
                let left = inertia.giving_way(&force, 1.0 / resistance);
                let (bias, share) = (left.force(&data.biases[here]), drive / resistance);
                let own = data.forces[here];
                let to = &mut data.forces[below];
                to.turn += own.turn + bias.turn + force.turn * share;
                to.shift += own.shift + bias.shift + force.shift * share;
                data.articulated[below].add(&left);
            }
        }
        data.accelerations[0] = Spatial {
            turn: Vector3::zeros(),
            shift: -self.gravity,
        };
        for (index, joint) in self.joints.iter().enumerate() {
            let (from, bias, axis) = (
                data.accelerations[joint.below()],
                data.biases[index + 1],
                data.axes[index],
            );
            let mut acceleration = Spatial {
                turn: from.turn + bias.turn,
                shift: from.shift + bias.shift,
            };
            let (force, inverse, drive) = &data.drives[index];
            let rate = (drive - force.dot(&acceleration)) * inverse;
            acceleration.turn += axis.turn * rate;
            acceleration.shift += axis.shift * rate;
            data.accelerations[index + 1] = acceleration;
            data.accelerated[index] = rate;
        }
        Ok(&data.accelerated)
    }

    /// Axes and inertias of all joints about the mean of their origins.
    fn about_one_point(&self, data: &mut Data) {
        let origins = data
            .placements
            .iter()
            .skip(1)
            .map(|placement| placement.origin);
        let middle = origins.sum::<Vector3<f64>>() / self.joints.len().max(1) as f64;
        let placed = self.joints.iter().zip(data.placements.iter().skip(1));
        let written = data.axes.iter_mut().zip(data.inertias.iter_mut().skip(1));
        for ((joint, placement), (own_axis, inertia)) in placed.zip(written) {
            let axis = placement.rotation.column(2).into_owned();
            let origin = placement.origin - middle;
            *own_axis = match joint.kind {
                JointKind::Revolute => Spatial {
                    turn: axis,
                    shift: origin.cross(&axis),
                },
                JointKind::Prismatic => Spatial {
                    turn: Vector3::zeros(),
                    shift: axis,
                },
            };
            let (turn, body) = (&placement.rotation, &joint.body);
            let centre = turn * body.centre + origin;
            let moment = centre * body.mass;
            let half = turn * body.inertia;
            let turned = |row: usize, column: usize| half.row(row).dot(&turn.row(column));
            // What the mass adds away from the point.
            let square = moment.component_mul(&centre);
            let added = Vector3::new(
                square.y + square.z,
                square.x + square.z,
                square.x + square.y,
            );
            let products = Vector3::new(
                moment.y * centre.z,
                moment.x * centre.z,
                moment.x * centre.y,
            );
            *inertia = RigidInertia {
                mass: body.mass,
                moment,
                diagonal: Vector3::new(turned(0, 0), turned(1, 1), turned(2, 2)) + added,
                across: Vector3::new(turned(1, 2), turned(0, 2), turned(0, 1)) - products,
            };
        }
    }

    /// Speeds of all joints' frames, the accelerations that they bring and the forces that these need; and every
    /// articulated inertia as that of the body alone.
    fn bias_forces(&self, data: &mut Data, qd: &[f64]) {
        data.velocities[0] = Spatial::zero();
        for (index, joint) in self.joints.iter().enumerate() {
            let here = index + 1;
            let (axis, speed) = (&data.axes[index], number(qd, index));
            let own = Spatial {
                turn: axis.turn * speed,
                shift: axis.shift * speed,
            };
            let from = &data.velocities[joint.below()];
            let velocity = Spatial {
                turn: from.turn + own.turn,
                shift: from.shift + own.shift,
            };
            data.biases[here] = Spatial {
                turn: velocity.turn.cross(&own.turn),
                shift: velocity.turn.cross(&own.shift) + velocity.shift.cross(&own.turn),
            };
            let inertia = &data.inertias[here];
            let momentum = inertia.force(&velocity);
            data.forces[here] = Spatial {
                turn: velocity.turn.cross(&momentum.turn) + velocity.shift.cross(&momentum.shift),
                shift: velocity.turn.cross(&momentum.shift),
            };
            data.velocities[here] = velocity;
            data.articulated[here] = ArticulatedInertia {
                turn: inertia.tensor(),
                across: inertia.moment.cross_matrix(),
                shift: Matrix3::from_diagonal_element(inertia.mass),
            };
        }
    }
}

impl RigidInertia {
    /// The momentum of a velocity, or the moment and force of an acceleration.
    fn force(&self, velocity: &Spatial) -> Spatial {
        let (t, v) = (&self.across, &velocity.turn);
        let turned = self.diagonal.component_mul(v)
            + Vector3::new(
                t.z * v.y + t.y * v.z,
                t.z * v.x + t.x * v.z,
                t.y * v.x + t.x * v.y,
            );
        Spatial {
            turn: turned + self.moment.cross(&velocity.shift),
            shift: velocity.shift * self.mass - self.moment.cross(&velocity.turn),
        }
    }

    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.moment += other.moment;
        self.diagonal += other.diagonal;
        self.across += other.across;
    }

    /// The whole tensor.
    fn tensor(&self) -> Matrix3<f64> {
        let (d, a) = (&self.diagonal, &self.across);
        Matrix3::new(d.x, a.z, a.y, a.z, d.y, a.x, a.y, a.x, d.z)
    }
}

impl ArticulatedInertia {
    fn force(&self, acceleration: &Spatial) -> Spatial {
        Spatial {
            turn: self.turn * acceleration.turn + self.across * acceleration.shift,
            shift: self.across.tr_mul(&acceleration.turn) + self.shift * acceleration.shift,
        }
    }

    /// What is left when a joint gives way to `force`, with `inverse` one over the inertia along its axis.
    fn giving_way(&self, force: &Spatial, inverse: f64) -> Self {
        let (turn, shift) = (force.turn * inverse, force.shift * inverse);
        Self {
            turn: self.turn - turn * force.turn.transpose(),
            across: self.across - turn * force.shift.transpose(),
            shift: self.shift - shift * force.shift.transpose(),
        }
    }

    fn add(&mut self, other: &Self) {
        self.turn += other.turn;
        self.across += other.across;
        self.shift += other.shift;
    }
}
