//! Models from TOML files: `configs/models/puma560.toml` explains the keys.
//!
//! Every mistake is a finding with its place. A file may be made of parts, which are other files of its folder or
//! models that are built in.

use std::path::{Path, PathBuf};

use ctos_config::{
    Node,
    diagnostic::{Finding, Findings, Source},
};
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;

use super::builder::{JointSpec, ModelBuilder, ModelError};
use super::built_in;
use super::features::{Body, FrameId, Friction, JointKind, Limits, Model, Motor};
use super::placement::Placement;
use super::shapes::Solid;

/// Parts of parts of parts ... of no more layers than this.
const DEEPEST: usize = 8;

/// Which of the bodies of a file make the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Inertias {
    /// As they were identified, or assumed.
    #[default]
    Identified,
    /// As a physics engine accepts them: each one a possible rigid body.
    Engine,
}

/// Reads a model from a file.
///
/// # Errors
/// Everything that is wrong in it, each with its place.
pub fn read(path: &Path, inertias: Inertias) -> Result<Model, Findings> {
    let source = Source::read(path)?;
    let folder = path.parent().map(Path::to_path_buf);
    Reading {
        folder,
        inertias,
        depth: 0,
    }
    .model(&source)
}

/// Reads a model from the text of a file; its parts are built in.
///
/// # Errors
/// Everything that is wrong in it, each with its place.
pub fn parse(source: &Source, inertias: Inertias) -> Result<Model, Findings> {
    Reading {
        folder: None,
        inertias,
        depth: 0,
    }
    .model(source)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileText {
    name: String,
    #[serde(default = "base")]
    base: String,
    tip: Option<String>,
    #[serde(default)]
    at: AtText,
    #[serde(default)]
    shapes: Vec<ShapeText>,
    #[serde(default)]
    part: Vec<PartText>,
    #[serde(default)]
    joint: Vec<JointText>,
    #[serde(default)]
    frame: Vec<FrameText>,
}

fn base() -> String {
    "base".to_owned()
}

/// A place: `xyz` in m, `rpy` about the fixed x, y and z in degrees.
#[derive(Debug, Clone, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub struct AtText {
    xyz: [f64; 3],
    rpy: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PartText {
    name: String,
    model: String,
    parent: Option<String>,
    #[serde(default)]
    at: AtText,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameText {
    name: String,
    parent: Option<String>,
    #[serde(default)]
    at: AtText,
    body: Option<BodyText>,
    engine_body: Option<BodyText>,
    #[serde(default)]
    shapes: Vec<ShapeText>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointText {
    name: String,
    link: Option<String>,
    r#type: KindText,
    parent: Option<String>,
    dh: Option<DhText>,
    at: Option<AtText>,
    axis: Option<[f64; 3]>,
    limits: Option<LimitsText>,
    motor: Option<MotorText>,
    body: Option<BodyText>,
    engine_body: Option<BodyText>,
    #[serde(default)]
    shapes: Vec<ShapeText>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
enum KindText {
    Revolute,
    Prismatic,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct DhText {
    theta: f64,
    d: f64,
    a: f64,
    alpha: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitsText {
    range: Option<[f64; 2]>,
    velocity: Option<f64>,
    acceleration: Option<f64>,
    jerk: Option<f64>,
    torque: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MotorText {
    inertia: f64,
    gear: f64,
    #[serde(default)]
    viscous: f64,
    #[serde(default)]
    coulomb: [f64; 2],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BodyText {
    mass: f64,
    #[serde(default)]
    centre: [f64; 3],
    /// Ixx, Iyy, Izz, and then perhaps Ixy, Ixz, Iyz.
    inertia: Vec<f64>,
}

/// A solid: the ends of a capsule's axis, a sphere's centre, or the edges of a box; which it is says the key.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShapeText {
    capsule: Option<[[f64; 3]; 2]>,
    sphere: Option<[f64; 3]>,
    r#box: Option<[f64; 3]>,
    radius: Option<f64>,
    #[serde(default)]
    at: AtText,
}

impl ShapeText {
    /// The solid in its frame, m.
    ///
    /// # Errors
    /// What does not make one.
    pub fn solid(&self) -> Result<Solid, &'static str> {
        let solid = self.form()?;
        match solid.fault() {
            None => Ok(solid),
            Some(_) => Err("the sizes of a solid are finite and above 0 m"),
        }
    }

    /// What it says; sizes are not checked.
    fn form(&self) -> Result<Solid, &'static str> {
        let at = self.at.placement();
        let round = "a capsule and a sphere have a `radius`";
        match (self.capsule, self.sphere, self.r#box, self.radius) {
            (Some([a, b]), None, None, Some(radius)) => Ok(Solid::Capsule {
                a: at.point(&a.into()),
                b: at.point(&b.into()),
                radius,
            }),
            (None, Some(centre), None, Some(radius)) => {
                Ok(Solid::sphere(at.point(&centre.into()), radius))
            }
            (None, None, Some(edges), None) => Ok(Solid::Block {
                at,
                half: Vector3::from(edges) * 0.5,
            }),
            (Some(_), None, None, None) | (None, Some(_), None, None) => Err(round),
            (None, None, Some(_), Some(_)) => Err("a box has no `radius`"),
            _ => Err("a solid is either a `capsule`, a `sphere` or a `box`"),
        }
    }
}

impl AtText {
    /// The place.
    #[must_use]
    pub fn placement(&self) -> Placement {
        Placement::from_degrees(self.xyz, self.rpy)
    }
}

impl LimitsText {
    fn limits(&self, kind: JointKind) -> Limits {
        let unit = |value: f64| match kind {
            JointKind::Revolute => value.to_radians(),
            JointKind::Prismatic => value,
        };
        let [lower, upper] = self
            .range
            .map_or([f64::NEG_INFINITY, f64::INFINITY], |range| range.map(unit));
        let most = |value: Option<f64>| value.unwrap_or(f64::INFINITY);
        Limits {
            lower,
            upper,
            velocity: most(self.velocity),
            acceleration: most(self.acceleration),
            jerk: most(self.jerk),
            torque: most(self.torque),
        }
    }
}

impl MotorText {
    fn motor(&self) -> Motor {
        let [coulomb_forward, coulomb_backward] = self.coulomb;
        Motor {
            rotor_inertia: self.inertia,
            gear_ratio: self.gear,
            friction: Friction {
                viscous: self.viscous,
                coulomb_forward,
                coulomb_backward,
            },
        }
    }
}

/// How a file is read.
struct Reading {
    /// Where its parts are looked for first.
    folder: Option<PathBuf>,
    inertias: Inertias,
    depth: usize,
}

/// An entry of a file, in the order in which they stand there.
enum Entry<'t> {
    Part(&'t PartText),
    Joint(&'t JointText),
    Frame(&'t FrameText),
}

impl Reading {
    fn model(&self, source: &Source) -> Result<Model, Findings> {
        let mut findings = Findings::new();
        let node = Node::from_toml(source, &mut findings);
        if findings.has_errors() {
            return Err(findings);
        }
        let text: FileText = node.parse()?;
        let mut builder = ModelBuilder::new(&text.name, &text.base);
        let mut last = builder.base();
        solids(&mut builder, last, &text.shapes, &node)?;
        let entries = in_order(&text, &node);
        for (at, entry) in entries {
            last = match entry {
                Entry::Part(part) => self.part(&mut builder, last, part, at)?,
                Entry::Joint(joint) => self.joint(&mut builder, last, joint, at)?,
                Entry::Frame(frame) => {
                    let parent = parent(&builder, last, frame.parent.as_deref(), at)?;
                    let made = builder.frame(&frame.name, parent, &frame.at.placement());
                    let id = made.map_err(|error| refused(&error, at))?;
                    self.body(
                        &mut builder,
                        id,
                        frame.body.as_ref(),
                        frame.engine_body.as_ref(),
                        at,
                    )?;
                    solids(&mut builder, id, &frame.shapes, at)?;
                    id
                }
            };
        }
        builder.tip(match &text.tip {
            Some(tip) => named(&builder, tip, node.get("tip").unwrap_or(&node))?,
            None => last,
        });
        Ok(builder.build().moved(&text.at.placement()))
    }

    fn part(
        &self,
        builder: &mut ModelBuilder,
        last: FrameId,
        part: &PartText,
        at: &Node,
    ) -> Result<FrameId, Findings> {
        let parent = parent(builder, last, part.parent.as_deref(), at)?;
        if self.depth == DEEPEST {
            let text = format!("loop: parts within parts, {DEEPEST} deep");
            return Err(tree(text, at)
                .help("a model cannot be a part of itself")
                .into());
        }
        let inner = Reading {
            folder: self.folder.clone(),
            inertias: self.inertias,
            depth: self.depth + 1,
        };
        let beside = self
            .folder
            .as_ref()
            .map(|folder| folder.join(format!("{}.toml", part.model)));
        let model = match (
            beside.filter(|path| path.is_file()),
            built_in::source(&part.model),
        ) {
            (Some(path), _) => inner.model(&Source::read(&path)?)?,
            (None, Some(source)) => inner.model(&source)?,
            (None, None) => {
                let text = format!("there is no model `{}`", part.model);
                let node = at.get("model").unwrap_or(at);
                return Err(tree(text, node)
                    .suggest(&part.model, built_in::NAMES)
                    .into());
            }
        };
        let attached = builder.attach(parent, &part.at.placement(), &part.name, &model);
        attached.map_err(|error| refused(&error, at))?;
        let tip = format!("{}.{}", part.name, model.at(model.tip()).name);
        // It was attached just now.
        Ok(builder.frame_named(&tip).unwrap_or(parent))
    }

    fn joint(
        &self,
        builder: &mut ModelBuilder,
        last: FrameId,
        text: &JointText,
        at: &Node,
    ) -> Result<FrameId, Findings> {
        let kind = match text.r#type {
            KindText::Revolute => JointKind::Revolute,
            KindText::Prismatic => JointKind::Prismatic,
        };
        let parent = parent(builder, last, text.parent.as_deref(), at)?;
        let mut spec = JointSpec::new(&text.name, kind, parent);
        match (&text.dh, &text.at, text.axis) {
            (Some(dh), None, None) => {
                spec.before = Placement::from_degrees([0.0; 3], [0.0, 0.0, dh.theta]);
                spec.after = Placement::from_degrees([dh.a, 0.0, dh.d], [dh.alpha, 0.0, 0.0]);
            }
            (None, place, axis) => {
                spec.before = place
                    .as_ref()
                    .map_or_else(Placement::identity, AtText::placement);
                spec.axis = axis.map_or_else(Vector3::z, Vector3::from);
            }
            (Some(_), _, _) => {
                let text = format!("joint `{}` has `dh` and `at` or `axis`", text.name);
                return Err(tree(text, at).help("write one or the other").into());
            }
        }
        if let Some(limits) = &text.limits {
            spec.limits = limits.limits(kind);
        }
        if let Some(motor) = &text.motor {
            spec.motor = motor.motor();
        }
        let made = builder.joint(spec, text.link.as_ref().unwrap_or(&text.name));
        let id = made.map_err(|error| refused(&error, at))?;
        self.body(
            builder,
            id,
            text.body.as_ref(),
            text.engine_body.as_ref(),
            at,
        )?;
        solids(builder, id, &text.shapes, at)?;
        Ok(id)
    }

    fn body(
        &self,
        builder: &mut ModelBuilder,
        frame: FrameId,
        identified: Option<&BodyText>,
        engine: Option<&BodyText>,
        at: &Node,
    ) -> Result<(), Finding> {
        let (key, text) = match (self.inertias, engine) {
            (Inertias::Engine, Some(engine)) => ("engine_body", Some(engine)),
            _ => ("body", identified),
        };
        let Some(text) = text else { return Ok(()) };
        let at = at.get(key).unwrap_or(at);
        let inertia = match *text.inertia.as_slice() {
            [xx, yy, zz] => Matrix3::from_diagonal(&Vector3::new(xx, yy, zz)),
            [xx, yy, zz, xy, xz, yz] => Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            _ => {
                let count = text.inertia.len();
                let text = format!(
                    "an inertia has 3 numbers, xx yy zz, or 6, with xy xz yz after them, not {count}"
                );
                return Err(tree(text, at.get("inertia").unwrap_or(at)));
            }
        };
        let body = Body {
            mass: text.mass,
            centre: text.centre.into(),
            inertia,
        };
        builder
            .body(frame, &body)
            .map_err(|error| refused(&error, at))
    }
}

/// Adds the solids of a link, each refused at its own place.
fn solids(
    builder: &mut ModelBuilder,
    frame: FrameId,
    texts: &[ShapeText],
    at: &Node,
) -> Result<(), Finding> {
    let nodes = at
        .entry("shapes")
        .map_or(&[][..], |entry| entry.value.elements());
    for (index, text) in texts.iter().enumerate() {
        let at = nodes.get(index).unwrap_or(at);
        let solid = text.form().map_err(|what| tree(what.to_owned(), at))?;
        let made = builder.shape(frame, &solid);
        made.map_err(|error| refused(&error, at))?;
    }
    Ok(())
}

/// The entries of all kinds, in the order of the file, each with its node.
fn in_order<'t>(text: &'t FileText, node: &'t Node) -> Vec<(&'t Node, Entry<'t>)> {
    let nodes = |key: &str| {
        node.entry(key)
            .map_or(&[][..], |entry| entry.value.elements())
    };
    let parts = nodes("part").iter().zip(text.part.iter().map(Entry::Part));
    let joints = nodes("joint")
        .iter()
        .zip(text.joint.iter().map(Entry::Joint));
    let frames = nodes("frame")
        .iter()
        .zip(text.frame.iter().map(Entry::Frame));
    let mut entries: Vec<_> = parts.chain(joints).chain(frames).collect();
    entries.sort_by_key(|(node, _)| node.place().map(|place| place.range.start));
    entries
}

fn parent(
    builder: &ModelBuilder,
    last: FrameId,
    name: Option<&str>,
    at: &Node,
) -> Result<FrameId, Finding> {
    match name {
        None => Ok(last),
        Some(name) => named(builder, name, at.get("parent").unwrap_or(at)),
    }
}

fn named(builder: &ModelBuilder, name: &str, at: &Node) -> Result<FrameId, Finding> {
    builder.frame_named(name).ok_or_else(|| {
        let text = format!("there is no frame `{name}` before this");
        tree(text, at).suggest(name, builder.frame_names())
    })
}

fn tree(text: String, at: &Node) -> Finding {
    Finding::error("mcs::model::file", text).at(at.place().cloned())
}

fn refused(error: &ModelError, at: &Node) -> Finding {
    Finding::from(error).at(at.place().cloned())
}

#[cfg(test)]
mod tests;
