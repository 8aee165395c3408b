//! What a model is made of: joints, bodies, frames, motors and limits. Pure data; nothing here computes motion.

use nalgebra::{Matrix3, Vector3};

use super::placement::Placement;
use super::shapes::Shape;

/// No model has more moving joints than this.
pub const MAX_JOINTS: usize = 64;

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum JointKind {
    /// Turns about the z axis of its frame, rad.
    Revolute,
    /// Slides along the z axis of its frame, m.
    Prismatic,
}

impl JointKind {
    /// The unit of its position.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Revolute => "rad",
            Self::Prismatic => "m",
        }
    }

    /// The unit of what drives it, a torque or a force.
    #[must_use]
    pub fn effort_unit(self) -> &'static str {
        match self {
            Self::Revolute => "N m",
            Self::Prismatic => "N",
        }
    }
}

/// Viscous and Coulomb friction of one joint, at the motor shaft as it was measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Friction {
    /// Viscous coefficient B, N m s/rad at the motor.
    pub viscous: f64,
    /// Coulomb torque while the motor turns forward, N m at the motor, positive.
    pub coulomb_forward: f64,
    /// Coulomb torque while the motor turns backward, N m at the motor, negative.
    pub coulomb_backward: f64,
}

/// Motor and gear train of one joint. The default is none: no inertia, no friction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motor {
    /// Rotor inertia Jm, kg m^2 at the motor.
    pub rotor_inertia: f64,
    /// Gear ratio G, motor turns (rad) per rad or m of the joint. Its sign is direction only.
    pub gear_ratio: f64,
    /// Friction, measured at the motor.
    pub friction: Friction,
}

impl Motor {
    /// Rotor inertia seen at the joint, `Jm G^2`: kg m^2, or kg at a joint that slides.
    #[must_use]
    pub fn reflected_inertia(&self) -> f64 {
        self.rotor_inertia * self.gear_ratio * self.gear_ratio
    }

    /// Friction torque seen at the joint that moves with `velocity` (rad/s or m/s), N m or N:
    /// `|G| (B |G| qd + Tc)`. At rest the Coulomb part is undetermined and taken as zero.
    #[must_use]
    pub fn friction_torque(&self, velocity: f64) -> f64 {
        let gear = self.gear_ratio.abs();
        let coulomb = if velocity > 0.0 {
            self.friction.coulomb_forward
        } else if velocity < 0.0 {
            self.friction.coulomb_backward
        } else {
            0.0
        };
        gear * (self.friction.viscous * gear * velocity + coulomb)
    }
}

/// What one joint may do. What is not limited is infinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Smallest position, rad or m.
    pub lower: f64,
    /// Largest position, rad or m.
    pub upper: f64,
    /// Largest speed, rad/s or m/s.
    pub velocity: f64,
    /// Largest acceleration, rad/s^2 or m/s^2.
    pub acceleration: f64,
    /// Largest rate of the acceleration, rad/s^3 or m/s^3.
    pub jerk: f64,
    /// Largest torque of the drive at the joint, N m, or force, N.
    pub torque: f64,
}

impl Limits {
    /// No limits.
    pub const NONE: Self = Self {
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        velocity: f64::INFINITY,
        acceleration: f64::INFINITY,
        jerk: f64::INFINITY,
        torque: f64::INFINITY,
    };
}

/// A rigid body in some frame. The default has no mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass, m.
    pub centre: Vector3<f64>,
    /// Inertia tensor about the centre of mass, axes of the frame, kg m^2.
    pub inertia: Matrix3<f64>,
}

impl Default for Body {
    fn default() -> Self {
        Self {
            mass: 0.0,
            centre: Vector3::zeros(),
            inertia: Matrix3::zeros(),
        }
    }
}

impl Body {
    /// A body with `mass` in kg, its centre of mass in m, and the principal inertias about it along the frame's
    /// axes, kg m^2.
    #[must_use]
    pub fn diagonal(mass: f64, centre: [f64; 3], inertia: [f64; 3]) -> Self {
        Self {
            mass,
            centre: centre.into(),
            inertia: Matrix3::from_diagonal(&inertia.into()),
        }
    }

    /// The same body seen from the frame in which its own frame stands at `placement`.
    #[must_use]
    pub fn seen_from(&self, placement: &Placement) -> Self {
        let turn = &placement.rotation;
        Self {
            mass: self.mass,
            centre: placement.point(&self.centre),
            inertia: turn * self.inertia * turn.transpose(),
        }
    }

    /// Both bodies as one, given in the same frame.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        if mass <= 0.0 {
            return Self {
                inertia: self.inertia + other.inertia,
                ..*self
            };
        }
        let centre = (self.centre * self.mass + other.centre * other.mass) / mass;
        let about = |body: &Self| {
            let way = body.centre - centre;
            let square = Matrix3::from_diagonal_element(way.norm_squared());
            body.inertia + (square - way * way.transpose()) * body.mass
        };
        Self {
            mass,
            centre,
            inertia: about(self) + about(other),
        }
    }

    /// Whether there is nothing of it.
    #[must_use]
    pub fn is_nothing(&self) -> bool {
        self.mass == 0.0 && self.inertia == Matrix3::zeros()
    }
}

/// A moving joint and the bodies that move with its frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// The joint that carries it, by index; `None` when it stands on the ground.
    pub parent: Option<usize>,
    /// Its frame at position 0, in the frame of the joint that carries it or in the base frame.
    pub placement: Placement,
    /// All that is fixed to its frame, as one body.
    pub body: Body,
    /// Limits.
    pub limits: Limits,
    /// Motor and gear.
    pub motor: Motor,
}

/// Names a frame of one model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameId(pub(super) usize);

/// A frame that somebody may ask for: a link, a tool, a mounting surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Its name.
    pub name: String,
    /// The frame that it was set on, of a link the frame under its joint; `None` of the base frame.
    pub parent: Option<FrameId>,
    /// The joint that carries it, by index; `None` when it stands on the ground.
    pub carrier: Option<usize>,
    /// Where it stands in the frame of that joint, or in the base frame.
    pub placement: Placement,
    /// What is fixed to it, in its own axes: a part of its joint's body.
    pub body: Body,
}

/// A tree of joints and bodies, which never changes. Made by a [`ModelBuilder`](super::ModelBuilder).
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    pub(super) name: String,
    pub(super) joints: Vec<Joint>,
    pub(super) frames: Vec<Frame>,
    pub(super) shapes: Vec<Shape>,
    pub(super) tip: usize,
    pub(super) gravity: Vector3<f64>,
}

impl Model {
    /// Its name, for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How many joints move: the length of every joint vector.
    #[must_use]
    pub fn dof(&self) -> usize {
        self.joints.len()
    }

    /// The moving joints, parents before children.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// The frames, the base frame first.
    #[must_use]
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// Its outer form: solids on its links, in no order that matters. None where nothing is said of it.
    #[must_use]
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// The frame of that name.
    #[must_use]
    pub fn frame(&self, name: &str) -> Option<FrameId> {
        let found = self.frames.iter().position(|frame| frame.name == name);
        found.map(FrameId)
    }

    /// What a frame is.
    #[must_use]
    pub fn at(&self, frame: FrameId) -> &Frame {
        // An id of another, larger model: its own base frame stands in, which every model has.
        self.frames.get(frame.0).unwrap_or(&self.frames[0])
    }

    /// The frame that is meant when nobody says which.
    #[must_use]
    pub fn tip(&self) -> FrameId {
        FrameId(self.tip)
    }

    /// Acceleration of free fall in the base frame, m/s^2.
    #[must_use]
    pub fn gravity(&self) -> &Vector3<f64> {
        &self.gravity
    }

    /// The same model where things fall with `gravity` (m/s^2, base frame).
    #[must_use]
    pub fn with_gravity(mut self, gravity: Vector3<f64>) -> Self {
        self.gravity = gravity;
        self
    }

    /// The same model with other joints: `change` is given each one in turn, with its index. What carries it stays. Whoever
    /// changes a limit, a body or a motor answers for the numbers.
    #[must_use]
    pub fn with_joints(mut self, mut change: impl FnMut(usize, &mut Joint)) -> Self {
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let parent = joint.parent;
            change(index, joint);
            joint.parent = parent;
        }
        self
    }

    /// The same model with another of its frames as the tip.
    #[must_use]
    pub fn with_tip(mut self, tip: FrameId) -> Self {
        self.tip = tip.0.min(self.frames.len() - 1);
        self
    }

    /// The same model with a tool on its tip, at `tip_t_tool`: its frame, called `tool`, becomes the tip.
    #[must_use]
    pub fn with_tool(mut self, tip_t_tool: &Placement) -> Self {
        let on = self.at(self.tip());
        let tool = Frame {
            name: "tool".to_owned(),
            parent: Some(self.tip()),
            carrier: on.carrier,
            placement: on.placement.then(tip_t_tool),
            body: Body::default(),
        };
        self.tip = self.frames.len();
        self.frames.push(tool);
        self
    }

    /// The same model with all of it moved: its base frame stays, and what stands on the ground stands at `placement`
    /// from where it stood.
    #[must_use]
    pub fn moved(mut self, placement: &Placement) -> Self {
        let on_ground = self
            .joints
            .iter_mut()
            .filter(|joint| joint.parent.is_none());
        for joint in on_ground {
            joint.placement = placement.then(&joint.placement);
        }
        // The base frame is the first, and stays.
        let fixed = self
            .frames
            .iter_mut()
            .skip(1)
            .filter(|frame| frame.carrier.is_none());
        for frame in fixed {
            frame.placement = placement.then(&frame.placement);
        }
        let on_ground = self.shapes.iter_mut();
        for shape in on_ground.filter(|shape| shape.carrier.is_none()) {
            shape.solid = shape.solid.seen_from(placement);
        }
        self
    }

    /// The same model with the bodies and motors that `change` makes of them: what an arm is in truth. What is fixed to a
    /// frame is changed as the joint's whole body is, so `change` may scale, and not add.
    #[must_use]
    pub fn falsified(mut self, mut change: impl FnMut(&mut Body, &mut Motor)) -> Self {
        for joint in &mut self.joints {
            change(&mut joint.body, &mut joint.motor);
        }
        for frame in &mut self.frames {
            change(&mut frame.body, &mut Motor::default());
        }
        self
    }

    /// The same model with one more body fixed to a frame, given in that frame's axes.
    #[must_use]
    pub fn with_body(mut self, frame: FrameId, body: &Body) -> Self {
        self.fix(frame, body);
        self
    }

    /// Fixes a body to a frame, and so to the joint that carries it.
    pub(super) fn fix(&mut self, frame: FrameId, body: &Body) {
        let Some(on) = self.frames.get_mut(frame.0) else {
            return;
        };
        on.body = on.body.joined(body);
        let seen = body.seen_from(&on.placement);
        let carrier = on.carrier;
        if let Some(joint) = carrier.and_then(|carrier| self.joints.get_mut(carrier)) {
            joint.body = joint.body.joined(&seen);
        }
    }

    /// Whether a frame hangs on another one: was set on it, or on what hangs on it.
    #[must_use]
    pub fn hangs_on(&self, frame: FrameId, other: FrameId) -> bool {
        let mut on = std::iter::successors(self.at(frame).parent, |on| self.at(*on).parent);
        on.any(|on| on == other)
    }

    /// The frames that hang on a frame, and what is fixed to each, in its axes; not what is fixed to the frame itself.
    pub fn hanging(&self, frame: FrameId) -> impl Iterator<Item = (FrameId, &Body)> {
        let all = self.frames.iter().enumerate();
        all.map(|(index, own)| (FrameId(index), &own.body))
            .filter(move |(own, _)| self.hangs_on(*own, frame))
    }

    /// The joints between the base and a frame, nearest to the base first.
    #[must_use]
    pub fn chain(&self, frame: FrameId) -> Vec<usize> {
        let mut chain: Vec<usize> = self.carriers(self.at(frame).carrier).collect();
        chain.reverse();
        chain
    }

    /// A joint and those that carry it, down to the ground.
    pub(super) fn carriers(&self, joint: Option<usize>) -> impl Iterator<Item = usize> {
        std::iter::successors(joint, |joint| self.joints[*joint].parent)
    }

    /// The first joint whose position in `q` is outside its limits (or not a number, or missing), by index.
    #[must_use]
    pub fn joint_outside(&self, q: &[f64]) -> Option<usize> {
        self.joints.iter().enumerate().position(|(index, joint)| {
            let limits = &joint.limits;
            let inside = |position: &f64| (limits.lower..=limits.upper).contains(position);
            !q.get(index).is_some_and(inside)
        })
    }
}
