//! Makes a model joint by joint, and refuses by name what no arm can be.

use std::collections::HashMap;

use ctos_config::diagnostic::Finding;
use nalgebra::{Matrix3, Vector3};

use super::features::{Body, Frame, FrameId, Joint, JointKind, Limits, MAX_JOINTS, Model, Motor};
use super::placement::Placement;
use super::shapes::{Shape, Solid, SolidFault};

/// Acceleration of free fall, m/s^2, unless something else is said.
const GRAVITY: f64 = 9.81;
/// A principal inertia this much below zero, as part of the largest, is rounding.
const ROUNDING: f64 = 1e-9;

/// Why something cannot be part of a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// More than [`MAX_JOINTS`] joints move.
    #[error("too many joints: joint `{joint}` would be moving joint {} and a model has at most {MAX_JOINTS}", MAX_JOINTS + 1)]
    TooManyJoints {
        /// The first joint too many.
        joint: String,
    },
    /// A name is given twice.
    #[error("duplicate name: there is a {what} `{name}` already")]
    SameName {
        /// `joint` or `frame`.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A number is infinite or none.
    #[error("not a finite number: {what} of `{name}`")]
    NotFinite {
        /// Which number.
        what: &'static str,
        /// Whose.
        name: String,
    },
    /// A mass below zero.
    #[error("negative mass: `{name}` has {mass} kg")]
    NegativeMass {
        /// Whose.
        name: String,
        /// The mass, kg.
        mass: f64,
    },
    /// An inertia tensor that no rigid body has.
    #[error(
        "inertia not positive definite: the principal inertias of `{name}` about its centre of mass are {:.4e}, {:.4e} and {:.4e} kg m^2",
        principal[0], principal[1], principal[2]
    )]
    Inertia {
        /// Whose.
        name: String,
        /// Its eigenvalues, kg m^2.
        principal: [f64; 3],
    },
    /// A solid of no size.
    #[error("no solid: the {what} of a solid of `{name}` is {size} m; it must be above 0")]
    Solid {
        /// Whose.
        name: String,
        /// Which size.
        what: &'static str,
        /// The size, m.
        size: f64,
    },
    /// An axis of no length.
    #[error("no axis: the axis of joint `{joint}` has no direction")]
    NoAxis {
        /// The joint.
        joint: String,
    },
    /// Limits of position in the wrong order.
    #[error("limits: the lower limit {lower} of joint `{joint}` is above the upper limit {upper}")]
    LimitOrder {
        /// The joint.
        joint: String,
        /// Lower limit, rad or m.
        lower: f64,
        /// Upper limit, rad or m.
        upper: f64,
    },
    /// A largest speed, acceleration, jerk or torque below zero, or a limit that is no number.
    #[error("limits: the largest {what} of joint `{joint}` is {value}; it must be 0 or more")]
    Limit {
        /// The joint.
        joint: String,
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
    },
}

impl ModelError {
    /// What to do about it, where its text does not say that.
    fn advice(&self) -> Option<&'static str> {
        Some(match self {
            Self::SameName { .. } => "give one of them another name",
            Self::NegativeMass { .. } => "give its mass in kg, 0 or more",
            Self::Inertia { .. } => "give its inertia about its centre of mass, in kg m^2",
            Self::NoAxis { .. } => "give a direction, as `0 0 1`",
            Self::LimitOrder { .. } => "give the lower limit first",
            _ => return None,
        })
    }
}

impl From<&ModelError> for Finding {
    /// Still without its place.
    fn from(error: &ModelError) -> Self {
        let finding = Self::error("mcs::model::impossible", error.to_string());
        match error.advice() {
            Some(advice) => finding.help(advice),
            None => finding,
        }
    }
}

/// A joint to be added. Its link's frame stands in the parent's at `before`, moved along or about `axis`, then `after`.
#[derive(Debug, Clone, PartialEq)]
pub struct JointSpec {
    /// Its name.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// The frame that it stands on.
    pub parent: FrameId,
    /// Its own frame at position 0, in the parent's.
    pub before: Placement,
    /// Its axis in its own frame; of any length but 0.
    pub axis: Vector3<f64>,
    /// The frame of its link, in its own frame after the motion.
    pub after: Placement,
    /// Limits.
    pub limits: Limits,
    /// Motor and gear.
    pub motor: Motor,
}

impl JointSpec {
    /// A joint about or along the z axis of the parent's frame, without limits and motor.
    #[must_use]
    pub fn new(name: impl Into<String>, kind: JointKind, parent: FrameId) -> Self {
        Self {
            name: name.into(),
            kind,
            parent,
            before: Placement::identity(),
            axis: Vector3::z(),
            after: Placement::identity(),
            limits: Limits::NONE,
            motor: Motor::default(),
        }
    }
}

/// A model in the making. It is complete at any time.
#[derive(Debug, Clone)]
pub struct ModelBuilder {
    model: Model,
    joints: HashMap<String, usize>,
    frames: HashMap<String, usize>,
}

impl ModelBuilder {
    /// A model of nothing but its base frame, which has the name `base`.
    #[must_use]
    pub fn new(name: impl Into<String>, base: impl Into<String>) -> Self {
        let base = base.into();
        let frame = Frame {
            name: base.clone(),
            parent: None,
            carrier: None,
            placement: Placement::identity(),
            body: Body::default(),
        };
        Self {
            model: Model {
                name: name.into(),
                joints: Vec::new(),
                frames: vec![frame],
                shapes: Vec::new(),
                tip: 0,
                gravity: Vector3::new(0.0, 0.0, -GRAVITY),
            },
            joints: HashMap::new(),
            frames: HashMap::from([(base, 0)]),
        }
    }

    /// The base frame.
    #[must_use]
    pub fn base(&self) -> FrameId {
        FrameId(0)
    }

    /// The frame of that name.
    #[must_use]
    pub fn frame_named(&self, name: &str) -> Option<FrameId> {
        self.frames.get(name).copied().map(FrameId)
    }

    /// The names of the frames there are.
    pub fn frame_names(&self) -> impl Iterator<Item = &str> {
        self.model.frames.iter().map(|frame| frame.name.as_str())
    }

    /// Adds a frame that is fixed to another: a joint that does not move. It becomes the tip.
    ///
    /// # Errors
    /// [`ModelError::SameName`], [`ModelError::NotFinite`].
    pub fn frame(
        &mut self,
        name: impl Into<String>,
        parent: FrameId,
        placement: &Placement,
    ) -> Result<FrameId, ModelError> {
        let name = name.into();
        finite(placement, "the place", &name)?;
        let on = self.model.at(parent);
        let frame = Frame {
            name,
            parent: Some(parent),
            carrier: on.carrier,
            placement: on.placement.then(placement),
            body: Body::default(),
        };
        self.put(frame)
    }

    /// Adds a joint that moves, and the frame of its link under the name `link`, which becomes the tip.
    ///
    /// # Errors
    /// What [`ModelError`] names, except of bodies.
    pub fn joint(
        &mut self,
        spec: JointSpec,
        link: impl Into<String>,
    ) -> Result<FrameId, ModelError> {
        let JointSpec {
            name,
            kind,
            parent,
            before,
            axis,
            after,
            limits,
            motor,
        } = spec;
        let index = self.model.joints.len();
        if index == MAX_JOINTS {
            return Err(ModelError::TooManyJoints { joint: name });
        }
        finite(&before, "the place", &name)?;
        finite(&after, "the place", &name)?;
        if !axis.iter().all(|number| number.is_finite()) {
            return Err(ModelError::NotFinite {
                what: "the axis",
                name,
            });
        }
        let Some(axis) = axis.try_normalize(0.0) else {
            return Err(ModelError::NoAxis { joint: name });
        };
        check_limits(&limits, &name)?;
        if self.joints.contains_key(&name) {
            return Err(ModelError::SameName {
                what: "joint",
                name,
            });
        }
        let along = if axis == Vector3::z() {
            Placement::identity()
        } else {
            Placement::along(&axis)
        };
        let on = self.model.at(parent);
        let placement = on.placement.then(&before).then(&along);
        let carrier = on.carrier;
        let frame = self.put(Frame {
            name: link.into(),
            parent: Some(parent),
            carrier: Some(index),
            placement: along.inverse().then(&after),
            body: Body::default(),
        })?;
        self.joints.insert(name.clone(), index);
        self.model.joints.push(Joint {
            name,
            kind,
            parent: carrier,
            placement,
            body: Body::default(),
            limits,
            motor,
        });
        Ok(frame)
    }

    /// Fixes a body to a frame. What is fixed to the ground does not matter to anything.
    ///
    /// # Errors
    /// [`ModelError::NegativeMass`], [`ModelError::Inertia`], [`ModelError::NotFinite`].
    pub fn body(&mut self, frame: FrameId, body: &Body) -> Result<(), ModelError> {
        check_body(body, &self.model.at(frame).name)?;
        self.model.fix(frame, body);
        Ok(())
    }

    /// Adds a solid to the outer form of a link, given in the link's frame.
    ///
    /// # Errors
    /// [`ModelError::Solid`], [`ModelError::NotFinite`].
    pub fn shape(&mut self, frame: FrameId, solid: &Solid) -> Result<(), ModelError> {
        let on = self.model.at(frame);
        let name = || on.name.clone();
        match solid.fault() {
            None => {}
            Some(SolidFault::NotFinite) => {
                return Err(ModelError::NotFinite {
                    what: "a solid",
                    name: name(),
                });
            }
            Some(SolidFault::Size(what, size)) => {
                return Err(ModelError::Solid {
                    name: name(),
                    what,
                    size,
                });
            }
        }
        let shape = Shape {
            frame,
            carrier: on.carrier,
            solid: solid.seen_from(&on.placement),
        };
        self.model.shapes.push(shape);
        Ok(())
    }

    /// Sets another model on a frame, its base frame at `placement`; its names get `prefix` and a dot before them.
    ///
    /// # Errors
    /// [`ModelError::SameName`], [`ModelError::TooManyJoints`], [`ModelError::NotFinite`].
    pub fn attach(
        &mut self,
        parent: FrameId,
        placement: &Placement,
        prefix: &str,
        part: &Model,
    ) -> Result<(), ModelError> {
        let prefixed = |name: &str| format!("{prefix}.{name}");
        finite(placement, "the place", prefix)?;
        let on = self.model.at(parent);
        let (carrier, base) = (on.carrier, on.placement.then(placement));
        let (first, first_frame) = (self.model.joints.len(), self.model.frames.len());
        for joint in &part.joints {
            let name = prefixed(&joint.name);
            if self.model.joints.len() == MAX_JOINTS {
                return Err(ModelError::TooManyJoints { joint: name });
            }
            if self.joints.contains_key(&name) {
                return Err(ModelError::SameName {
                    what: "joint",
                    name,
                });
            }
            self.joints.insert(name.clone(), self.model.joints.len());
            let mut joint = Joint {
                name,
                ..joint.clone()
            };
            match &mut joint.parent {
                Some(parent) => *parent += first,
                None => {
                    joint.parent = carrier;
                    joint.placement = base.then(&joint.placement);
                }
            }
            self.model.joints.push(joint);
        }
        for (index, frame) in part.frames.iter().enumerate() {
            let on = frame.parent.map(|on| FrameId(on.0 + first_frame));
            let mut frame = Frame {
                name: prefixed(&frame.name),
                parent: on.or(Some(parent)),
                ..frame.clone()
            };
            match &mut frame.carrier {
                Some(on) => *on += first,
                None => {
                    frame.carrier = carrier;
                    frame.placement = base.then(&frame.placement);
                }
            }
            // What the part has fixed to its own ground, the joint carries that the part stands on.
            let on_ground = part.at(FrameId(index)).carrier.is_none();
            let body = std::mem::take(&mut frame.body);
            let own = self.put(frame)?;
            match on_ground {
                true => self.model.fix(own, &body),
                false => self.model.frames[own.0].body = body,
            }
        }
        for shape in &part.shapes {
            let own = shape.carrier.map(|on| on + first);
            let solid = match own {
                Some(_) => shape.solid.clone(),
                None => shape.solid.seen_from(&base),
            };
            self.model.shapes.push(Shape {
                frame: FrameId(shape.frame.0 + first_frame),
                carrier: own.or(carrier),
                solid,
            });
        }
        Ok(())
    }

    /// Says which frame is the tip; without it, the frame that was added last is.
    pub fn tip(&mut self, frame: FrameId) {
        self.model.tip = frame.0;
    }

    /// The model.
    #[must_use]
    pub fn build(self) -> Model {
        self.model
    }

    fn put(&mut self, frame: Frame) -> Result<FrameId, ModelError> {
        if self.frames.contains_key(&frame.name) {
            let name = frame.name;
            return Err(ModelError::SameName {
                what: "frame",
                name,
            });
        }
        let index = self.model.frames.len();
        self.frames.insert(frame.name.clone(), index);
        self.model.frames.push(frame);
        self.model.tip = index;
        Ok(FrameId(index))
    }
}

fn finite(placement: &Placement, what: &'static str, name: &str) -> Result<(), ModelError> {
    if placement.is_finite() {
        return Ok(());
    }
    let name = name.to_owned();
    Err(ModelError::NotFinite { what, name })
}

pub(super) fn check_limits(limits: &Limits, joint: &str) -> Result<(), ModelError> {
    let joint = || joint.to_owned();
    let Limits { lower, upper, .. } = *limits;
    if lower.is_nan() || upper.is_nan() {
        return Err(ModelError::NotFinite {
            what: "a limit",
            name: joint(),
        });
    }
    if lower > upper {
        return Err(ModelError::LimitOrder {
            joint: joint(),
            lower,
            upper,
        });
    }
    let largest = [
        ("velocity", limits.velocity),
        ("acceleration", limits.acceleration),
        ("jerk", limits.jerk),
        ("torque", limits.torque),
    ];
    match largest
        .into_iter()
        .find(|(_, value)| value.is_nan() || *value < 0.0)
    {
        Some((what, value)) => Err(ModelError::Limit {
            joint: joint(),
            what,
            value,
        }),
        None => Ok(()),
    }
}

/// A body may have no mass (a motor's rotor alone, say) but no less, and no negative principal inertia. The triangle
/// inequality is not asked for: the identified PUMA 560 breaks it.
pub(super) fn check_body(body: &Body, name: &str) -> Result<(), ModelError> {
    let name = || name.to_owned();
    if body.mass < 0.0 {
        return Err(ModelError::NegativeMass {
            name: name(),
            mass: body.mass,
        });
    }
    let mut numbers = body
        .centre
        .iter()
        .chain(body.inertia.iter())
        .chain([&body.mass]);
    if !numbers.all(|number| number.is_finite()) {
        return Err(ModelError::NotFinite {
            what: "a number of the body",
            name: name(),
        });
    }
    let symmetric: Matrix3<f64> = (body.inertia + body.inertia.transpose()) * 0.5;
    let mut principal: [f64; 3] = symmetric.symmetric_eigenvalues().into();
    principal.sort_by(f64::total_cmp);
    let [smallest, _, largest] = principal;
    if smallest < -ROUNDING * largest.abs() || smallest.is_nan() {
        return Err(ModelError::Inertia {
            name: name(),
            principal,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_arm_can_be_is_refused_by_name() {
        let mut builder = ModelBuilder::new("test", "base");
        let base = builder.base();
        let spec = |name: &str| JointSpec::new(name, JointKind::Revolute, base);
        let link = builder.joint(spec("a"), "link").unwrap();
        assert!(matches!(
            builder.joint(spec("a"), "other"),
            Err(ModelError::SameName { what: "joint", .. })
        ));
        assert!(matches!(
            builder.joint(spec("b"), "link"),
            Err(ModelError::SameName { what: "frame", .. })
        ));
        let mut still = spec("c");
        still.axis = Vector3::zeros();
        assert!(matches!(
            builder.joint(still, "c"),
            Err(ModelError::NoAxis { .. })
        ));
        let mut crossed = spec("d");
        (crossed.limits.lower, crossed.limits.upper) = (1.0, -1.0);
        assert!(matches!(
            builder.joint(crossed, "d"),
            Err(ModelError::LimitOrder { .. })
        ));
        let mut slow = spec("e");
        slow.limits.velocity = -1.0;
        assert!(matches!(
            builder.joint(slow, "e"),
            Err(ModelError::Limit {
                what: "velocity",
                ..
            })
        ));
        let mut nowhere = spec("f");
        nowhere.before.origin.x = f64::NAN;
        assert!(matches!(
            builder.joint(nowhere, "f"),
            Err(ModelError::NotFinite { .. })
        ));
        let negative = Body::diagonal(-1.0, [0.0; 3], [1.0; 3]);
        assert!(matches!(
            builder.body(link, &negative),
            Err(ModelError::NegativeMass { .. })
        ));
        let mut impossible = Body::diagonal(1.0, [0.0; 3], [1.0; 3]);
        (impossible.inertia[(0, 1)], impossible.inertia[(1, 0)]) = (2.0, 2.0);
        assert!(matches!(
            builder.body(link, &impossible),
            Err(ModelError::Inertia { .. })
        ));
        assert_eq!(
            builder.build().dof(),
            1,
            "what was refused left nothing behind"
        );
    }

    #[test]
    fn no_more_joints_than_the_stated_maximum_are_taken() {
        let mut builder = ModelBuilder::new("long", "base");
        let mut parent = builder.base();
        for index in 0..MAX_JOINTS {
            let spec = JointSpec::new(format!("j{index}"), JointKind::Prismatic, parent);
            parent = builder.joint(spec, format!("l{index}")).unwrap();
        }
        let spec = JointSpec::new("more", JointKind::Revolute, parent);
        assert!(matches!(
            builder.joint(spec, "more"),
            Err(ModelError::TooManyJoints { .. })
        ));
    }

    #[test]
    fn two_bodies_fixed_to_each_other_are_one_with_their_inertia_about_the_common_centre() {
        // Two points of 1 kg, 2 m apart: 2 kg, and 2 kg m^2 about each axis across.
        let point = |x: f64| Body::diagonal(1.0, [x, 0.0, 0.0], [0.0; 3]);
        let both = point(1.0).joined(&point(3.0));
        assert_eq!(both, Body::diagonal(2.0, [2.0, 0.0, 0.0], [0.0, 2.0, 2.0]));
    }
}
