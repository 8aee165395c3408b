//! Models from URDF, the robot description of ROS (wiki.ros.org/urdf/XML): the joints between two links; and back.
//!
//! Read with `roxmltree`, which keeps the place of every element; `urdf-rs` loses them, and every mistake here is a
//! finding with its place. Of the forms for collisions the boxes, spheres and capsules are read as they are; a cylinder is
//! read as a capsule around it, or as a box where it is wider than high. A mesh in STL or OBJ is read as the convex hull of its
//! points; of one that is of another kind or not there a warning says that nothing watches it. Nothing recurses and nothing
//! takes the square of the file's size.

mod description;
mod mesh;
mod write;
mod xml;

use std::path::Path;

use ctos_config::diagnostic::{Finding, Source};

use super::builder::{JointSpec, ModelBuilder};
use super::features::{FrameId, JointKind, Model};
use super::shapes::Solid;
use description::{Description, Form, JointText, Motion};
use mesh::Fault;
pub use write::write;

/// A limit of speed or effort that is none: URDF asks for a number, and so do its readers.
const UNLIMITED: f64 = 1e30;

/// So many bytes may the meshes of an arm have together.
const MOST_MESH_BYTES: u64 = 16 << 20;

/// A model from URDF, with what is odd about it.
#[derive(Debug, Clone)]
pub struct FromUrdf {
    /// The joints that move between the two links, in that order; its base frame is the one, its tip the other.
    pub model: Model,
    /// What a reader should know: bodies without mass, say.
    pub warnings: Vec<Finding>,
}

/// Reads the joints from link `base` to link `tip`. The base is the root and the tip the only leaf unless they are
/// named. The base may be any link, also one beyond the tip: then the joints are passed from their child to their parent, with
/// positions as they are. Bodies off the way are left out; gravity is along -z of the base link.
///
/// # Errors
/// The first thing that is wrong, with its place.
pub fn read(path: &Path, base: Option<&str>, tip: Option<&str>) -> Result<FromUrdf, Finding> {
    parse(&Source::read(path)?, base, tip)
}

/// As [`read`], from a text. Meshes are looked for from where the file of its name is.
///
/// # Errors
/// The first thing that is wrong, with its place.
pub fn parse(source: &Source, base: Option<&str>, tip: Option<&str>) -> Result<FromUrdf, Finding> {
    let document = xml::parse(source)?;
    let description = Description::read(source, &document)?;
    let base = match base {
        Some(name) => description.link(name, "base")?,
        None => description.root,
    };
    let tip = match tip {
        Some(name) => description.link(name, "tip")?,
        None => description.only_leaf()?,
    };
    let mut making = Making {
        builder: ModelBuilder::new(description.name, description.links[base].name),
        description: &description,
        warnings: Vec::new(),
        beside: Path::new(source.name()),
        left: MOST_MESH_BYTES,
        unread: Vec::new(),
    };
    let mut at = making.builder.base();
    making.shapes(at, base)?;
    for step in way(&description, base, tip) {
        at = making.step(at, step)?;
    }
    making.builder.tip(at);
    making.tell_of_meshes();
    Ok(FromUrdf {
        model: making.builder.build(),
        warnings: making.warnings,
    })
}

/// One joint of the way, and whether it is passed from its child to its parent.
#[derive(Clone, Copy)]
struct Step {
    joint: usize,
    up: bool,
}

/// The joints from one link to another: up to the link that carries both, then down.
fn way(description: &Description<'_>, base: usize, tip: usize) -> Vec<Step> {
    let carriers = |link: usize| -> Vec<usize> {
        let parent = |joint: &usize| description.links[description.joints[*joint].parent].carrier;
        std::iter::successors(description.links[link].carrier, parent).collect()
    };
    let (mut up, mut down) = (carriers(base), carriers(tip));
    // What both are carried by, counted from the root, is not on the way.
    while up.last().is_some() && up.last() == down.last() {
        up.pop();
        down.pop();
    }
    let step = |up: bool| move |joint| Step { joint, up };
    up.into_iter()
        .map(step(true))
        .chain(down.into_iter().rev().map(step(false)))
        .collect()
}

struct Making<'d> {
    builder: ModelBuilder,
    description: &'d Description<'d>,
    warnings: Vec<Finding>,
    /// The file that is read, and how many bytes more of meshes are.
    beside: &'d Path,
    left: u64,
    /// The links whose form has a mesh that is not read, where that stands, and why.
    unread: Vec<(&'d str, &'d std::ops::Range<usize>, String)>,
}

impl Making<'_> {
    /// Adds a joint of the way and the link that it leads to.
    fn step(&mut self, at: FrameId, step: Step) -> Result<FrameId, Finding> {
        let joint = &self.description.joints[step.joint];
        let index = if step.up { joint.parent } else { joint.child };
        let link = &self.description.links[index];
        let made = match joint.motion {
            Motion::Fixed => {
                let placement = if step.up {
                    joint.origin.inverse()
                } else {
                    joint.origin
                };
                self.builder.frame(link.name, at, &placement)
            }
            Motion::Moving(kind) => self
                .builder
                .joint(spec(joint, kind, at, step.up), link.name),
            Motion::Unsupported(kind) => {
                let text = format!(
                    "unsupported joint type: joint `{}` between base and tip is {kind}",
                    joint.name
                );
                return Err(self.description.finding(text, &joint.type_range).help(
                    "joints between base and tip are revolute, continuous, prismatic or fixed",
                ));
            }
        };
        let frame =
            made.map_err(|error| self.description.place(Finding::from(&error), &joint.range))?;
        if let Some(mimicked) = joint.mimics {
            let text = format!(
                "joint `{}` mimics `{mimicked}`; here it moves by itself",
                joint.name
            );
            self.warn(text, &joint.range);
        }
        match &link.body {
            Some(body) => {
                let fixed = self.builder.body(frame, body);
                fixed
                    .map_err(|error| self.description.place(Finding::from(&error), &link.range))?;
            }
            None if matches!(joint.motion, Motion::Moving(_)) => {
                let text = format!("link `{}` has no <inertial>: it has no mass", link.name);
                self.warn(text, &link.range);
            }
            None => {}
        }
        self.shapes(frame, index)?;
        Ok(frame)
    }

    /// Adds the form of a link.
    fn shapes(&mut self, frame: FrameId, link: usize) -> Result<(), Finding> {
        let link = &self.description.links[link];
        for (form, range) in &link.shapes {
            let hull;
            let solid = match form {
                Form::Solid(solid) => solid,
                Form::Mesh(at, mesh) => {
                    let wrong = |what: &str| {
                        let text =
                            format!("no mesh: `{}` of link `{}` {what}", mesh.file, link.name);
                        self.description.finding(text, range)
                    };
                    let points = match mesh.points(self.beside, self.left) {
                        Ok((points, bytes)) => {
                            self.left = self.left.saturating_sub(bytes);
                            points
                        }
                        Err(Fault::Wrong(what)) => return Err(wrong(&what)),
                        Err(Fault::NotRead(why)) => {
                            self.unread.push((link.name, range, why));
                            continue;
                        }
                    };
                    hull =
                        Solid::around_points(at, &points).ok_or_else(|| wrong("is not finite"))?;
                    &hull
                }
            };
            let made = self.builder.shape(frame, solid);
            made.map_err(|error| self.description.place(Finding::from(&error), range))?;
        }
        Ok(())
    }

    fn tell_of_meshes(&mut self) {
        let Some((_, range, why)) = self.unread.first().cloned() else {
            return;
        };
        let names: Vec<&str> = self.unread.iter().map(|(name, ..)| *name).collect();
        let text = format!(
            "the meshes of {} for collisions are not read: nothing watches them ({why})",
            names.join(", ")
        );
        self.warn(text, range);
    }

    fn warn(&mut self, text: String, range: &std::ops::Range<usize>) {
        let warning = Finding::warning("mcs::model::urdf", text);
        self.warnings.push(self.description.place(warning, range));
    }
}

/// The joint as the model's builder takes it. Passed upwards, its own frame is its child's, and it turns the other way.
fn spec(joint: &JointText<'_>, kind: JointKind, parent: FrameId, up: bool) -> JointSpec {
    let mut spec = JointSpec::new(joint.name, kind, parent);
    spec.limits = joint.limits;
    spec.motor = joint.motor;
    if up {
        spec.axis = -joint.axis;
        spec.after = joint.origin.inverse();
    } else {
        spec.axis = joint.axis;
        spec.before = joint.origin;
    }
    spec
}

#[cfg(test)]
mod tests;
