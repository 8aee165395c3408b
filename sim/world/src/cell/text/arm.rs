//! An arm of the cell: `[[arm]]`.

use mcs_model::{FrameId, JointKind, Model, Placement};
use nalgebra::Vector3;
use serde::Deserialize;
use toml::Spanned;

use super::{
    super::{ArmSpec, PadSpec},
    check::{Check, FRICTION, GREY},
};
use crate::shapes::{self, Paint, Shape, Solid};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmText {
    pub(super) name: Spanned<String>,
    model: Spanned<String>,
    #[serde(default)]
    base: BaseText,
    start: Spanned<Vec<f64>>,
    #[serde(default)]
    friction: bool,
    surface: Option<Spanned<f64>>,
    mass_factor: Option<Spanned<f64>>,
    inertia_factor: Option<Spanned<f64>>,
    friction_factor: Option<Spanned<f64>>,
    tip_offset: Option<Spanned<[f64; 3]>>,
    #[serde(default)]
    capsule: Vec<CapsuleText>,
    #[serde(default)]
    pad: Vec<PadText>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct BaseText {
    xyz: Option<Spanned<[f64; 3]>>,
    rpy: Option<Spanned<[f64; 3]>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CapsuleText {
    link: Spanned<String>,
    from: Spanned<[f64; 3]>,
    to: Spanned<[f64; 3]>,
    radius: Spanned<f64>,
    grey: Spanned<f64>,
}

/// A soft form around a link: a capsule.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PadText {
    link: Spanned<String>,
    from: Spanned<[f64; 3]>,
    to: Spanned<[f64; 3]>,
    radius: Spanned<f64>,
    stiffness: Spanned<f64>,
    damping: Spanned<f64>,
}

impl ArmText {
    pub(super) fn check(&self, name: String, check: &mut Check<'_>) -> Option<ArmSpec> {
        let origin = self.base.xyz.as_ref().map_or_else(Vector3::zeros, |xyz| {
            check.point(xyz, "the origin of an arm's base", 100.0)
        });
        let base = Placement::from_degrees(origin.into(), check.turn(self.base.rpy.as_ref()));
        let [mass, inertia, friction] = [
            (&self.mass_factor, "the factor on the masses"),
            (&self.inertia_factor, "the factor on the inertias"),
            (&self.friction_factor, "the factor on the friction"),
        ]
        .map(|(factor, what)| check.factor(factor.as_ref(), what));
        let tip_offset = self
            .tip_offset
            .as_ref()
            .map_or_else(Vector3::zeros, |offset| {
                check.point(offset, "the offset of an arm's tip", 1.0)
            });
        let model = check.model(&self.model)?;
        let start = self.start(&model, check)?;
        let own = self.shapes(&model, check);
        let pads = self.pad.iter();
        let pads = pads.filter_map(|pad| pad.check(&model, check)).collect();
        let shapes = if own.is_empty() {
            shapes::outline(&model)
        } else {
            own
        };
        // What is heavier has more inertia, too.
        let nominal = model.moved(&base);
        let model = nominal.clone().falsified(|body, motor| {
            body.mass *= mass;
            body.inertia *= mass * inertia;
            motor.friction.viscous *= friction;
            motor.friction.coulomb_forward *= friction;
            motor.friction.coulomb_backward *= friction;
        });
        Some(ArmSpec {
            name,
            model,
            nominal,
            base: base.isometry(),
            start,
            friction: self.friction,
            surface: self.surface.as_ref().map_or(FRICTION, |surface| {
                check.number(surface, "the friction of an arm's surface", "", [0.0, 10.0])
            }),
            tip_offset,
            shapes,
            pads,
        })
    }

    /// Joint positions at the start, rad or m.
    fn start(&self, model: &Model, check: &mut Check<'_>) -> Option<Vec<f64>> {
        let given = self.start.get_ref();
        if given.len() != model.dof() {
            check.refuse(
                self.start.span(),
                format!(
                    "{} joints start, and model `{}` has {}",
                    given.len(),
                    model.name(),
                    model.dof()
                ),
                "give one number for each joint, in the model's order: degrees, or m for one that slides",
            );
            return None;
        }
        let mut start = Vec::new();
        for (index, (joint, given)) in model.joints().iter().zip(given).enumerate() {
            let ([lower, upper], value, unit) = match joint.kind {
                JointKind::Revolute => (
                    [joint.limits.lower, joint.limits.upper].map(f64::to_degrees),
                    given.to_radians(),
                    "degrees",
                ),
                JointKind::Prismatic => ([joint.limits.lower, joint.limits.upper], *given, "m"),
            };
            // The limits come from degrees by way of radians: a start at the limit is in.
            if !(lower - 1e-9..=upper + 1e-9).contains(given) {
                let digits = if unit == "m" { 4 } else { 0 };
                check.refuse(
                    self.start.span(),
                    format!("joint {} cannot start at {given} {unit}", index + 1),
                    &format!("its limits are {lower:.digits$} to {upper:.digits$} {unit}"),
                );
            }
            start.push(value.max(joint.limits.lower).min(joint.limits.upper));
        }
        Some(start)
    }

    fn shapes(&self, model: &Model, check: &mut Check<'_>) -> Vec<(FrameId, Shape)> {
        let mut all = Vec::new();
        for capsule in &self.capsule {
            let solid = Solid::Capsule {
                a: check
                    .point(&capsule.from, "an end of a capsule", 10.0)
                    .into(),
                b: check.point(&capsule.to, "an end of a capsule", 10.0).into(),
                radius: check.number(&capsule.radius, "the radius of a capsule", "m", [1e-3, 1.0]),
            };
            let grey = check.number(&capsule.grey, "the grey of a capsule", "grey levels", GREY);
            let paint = Paint::Grey(grey);
            let frame = check.frame(model, &capsule.link);
            all.extend(frame.map(|frame| (frame, Shape { solid, paint })));
        }
        all
    }
}

impl PadText {
    fn check(&self, model: &Model, check: &mut Check<'_>) -> Option<PadSpec> {
        let mut end = |end: &Spanned<[f64; 3]>| check.point(end, "an end of a pad", 10.0).into();
        let solid = Solid::Capsule {
            a: end(&self.from),
            b: end(&self.to),
            radius: check.number(&self.radius, "the radius of a pad", "m", [1e-3, 1.0]),
        };
        let stiffness = &self.stiffness;
        let stiffness = check.number(stiffness, "the stiffness of a pad", "N/m", [1.0, 2e4]);
        let damping = check.number(&self.damping, "the damping of a pad", "N s/m", [0.0, 1e3]);
        Some(PadSpec {
            frame: check.frame(model, &self.link)?,
            solid,
            stiffness,
            damping,
        })
    }
}
