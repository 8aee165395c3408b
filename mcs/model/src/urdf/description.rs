//! What a URDF says: its links and joints as one tree, checked as a whole.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::f64::consts::PI;
use std::ops::{Range, RangeInclusive};

use ctos_config::diagnostic::{Finding, Source};
use nalgebra::{Matrix3, Vector3};
use roxmltree::{Document, Node};

use super::mesh::MeshText;
use super::{UNLIMITED, xml};
use crate::builder::{check_body, check_limits};
use crate::features::{Body, Friction, JointKind, Limits, Motor};
use crate::placement::Placement;
use crate::shapes::Solid;

/// A range of more rad than four turns was meant in degrees. A number beyond stands for no limit.
const DEGREES: RangeInclusive<f64> = 8.0 * PI..=1e3;

/// No part of a robot is farther from the one that carries it, m.
const FARTHEST: f64 = 100.0;

/// Axes shorter than this have no direction.
const NO_AXIS: f64 = 1e-9;

/// A joint's axis when none is said.
const USUAL_AXIS: [f64; 3] = [1.0, 0.0, 0.0];

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Motion {
    Fixed,
    Moving(JointKind),
    /// Of a type that URDF knows, but no model here has.
    Unsupported(&'static str),
}

/// A link.
#[derive(Debug)]
pub(super) struct LinkText<'a> {
    pub name: &'a str,
    pub body: Option<Body>,
    /// Its form for collisions, each part with its place in the file.
    pub shapes: Vec<(Form<'a>, Range<usize>)>,
    /// The joint that carries it, by index.
    pub carrier: Option<usize>,
    pub range: Range<usize>,
}

/// A part of a link's form.
#[derive(Debug)]
pub(super) enum Form<'a> {
    Solid(Solid),
    Mesh(Placement, MeshText<'a>),
}

/// A joint; links by index.
#[derive(Debug)]
pub(super) struct JointText<'a> {
    pub name: &'a str,
    pub motion: Motion,
    pub parent: usize,
    pub child: usize,
    pub origin: Placement,
    pub axis: Vector3<f64>,
    pub limits: Limits,
    pub motor: Motor,
    pub mimics: Option<&'a str>,
    pub range: Range<usize>,
    pub type_range: Range<usize>,
}

/// A robot.
#[derive(Debug)]
pub(super) struct Description<'a> {
    source: &'a Source,
    pub name: &'a str,
    pub links: Vec<LinkText<'a>>,
    pub joints: Vec<JointText<'a>>,
    names: HashMap<&'a str, usize>,
    /// The link that nothing carries.
    pub root: usize,
}

impl<'a> Description<'a> {
    /// Reads links and joints and makes sure that they are one tree.
    pub fn read(source: &'a Source, document: &'a Document<'a>) -> Result<Self, Finding> {
        let robot = document.root_element();
        if !robot.has_tag_name("robot") {
            let text = format!(
                "not a robot: the outermost element is <{}>, not <robot>",
                robot.tag_name().name()
            );
            return Err(
                xml::finding(source, text, xml::opening(robot)).help("is this a URDF file?")
            );
        }
        let unexpanded = robot
            .children()
            .find(|child| child.is_element() && child.tag_name().namespace().is_some());
        if let Some(element) = unexpanded {
            let text = format!(
                "not expanded: <{}> is of xacro or another language",
                element.tag_name().name()
            );
            return Err(xml::finding(source, text, xml::opening(element))
                .help("run xacro over the file first"));
        }
        xml::check_units(source, document)?;
        let mut description = Self {
            source,
            name: robot.attribute("name").unwrap_or("robot"),
            links: Vec::new(),
            joints: Vec::new(),
            names: HashMap::new(),
            root: 0,
        };
        for node in robot.children().filter(|child| child.has_tag_name("link")) {
            description.read_link(node)?;
        }
        if description.links.is_empty() {
            return Err(xml::finding(
                source,
                "no links: the robot has no <link>",
                xml::opening(robot),
            ));
        }
        let mut joints = HashMap::new();
        for node in robot.children().filter(|child| child.has_tag_name("joint")) {
            description.read_joint(node, &mut joints)?;
        }
        let drives = robot.children();
        for node in drives.filter(|child| child.has_tag_name("transmission")) {
            description.read_transmission(node, &joints)?;
        }
        description.root = description.only_root()?;
        description.all_hang_on_the_root()?;
        Ok(description)
    }

    /// A finding at a place of the file.
    pub fn finding(&self, text: String, range: &Range<usize>) -> Finding {
        xml::finding(self.source, text, range.clone())
    }

    /// The finding at a place of the file.
    pub fn place(&self, finding: Finding, range: &Range<usize>) -> Finding {
        finding.at(self.source.at(range.clone()))
    }

    /// The link of that name, which was asked for as `what`.
    pub fn link(&self, name: &str, what: &str) -> Result<usize, Finding> {
        self.names.get(name).copied().ok_or_else(|| {
            let text = format!(
                "unknown link: the {what} `{name}` is no link of robot `{}`",
                self.name
            );
            let range = self.links[self.root].range.clone();
            self.finding(text, &range)
                .suggest(name, self.names.keys().copied())
        })
    }

    /// The only link that carries nothing.
    pub fn only_leaf(&self) -> Result<usize, Finding> {
        let mut carries = vec![false; self.links.len()];
        for joint in &self.joints {
            carries[joint.parent] = true;
        }
        let mut leaves = (0..self.links.len()).filter(|link| !carries[*link]);
        match (leaves.next(), leaves.next()) {
            (Some(leaf), None) => Ok(leaf),
            (first, second) => {
                let name = |link: Option<usize>| link.map_or("none", |link| self.links[link].name);
                let text = format!(
                    "no tip: several links carry nothing, `{}` and `{}` among them",
                    name(first),
                    name(second)
                );
                let range = self.links[self.root].range.clone();
                Err(self.finding(text, &range).help("say which with -tip LINK"))
            }
        }
    }

    fn read_link(&mut self, node: Node<'a, 'a>) -> Result<(), Finding> {
        let (name, range) = xml::attribute(self.source, node, "name")?;
        match self.names.entry(name) {
            Entry::Occupied(_) => {
                return Err(self.finding(
                    format!("duplicate name: there is a link `{name}` already"),
                    &range,
                ));
            }
            Entry::Vacant(free) => free.insert(self.links.len()),
        };
        let body = match xml::child(node, "inertial") {
            Some(inertial) => Some(self.body(name, inertial)?),
            None => None,
        };
        let mut shapes = Vec::new();
        for collision in node
            .children()
            .filter(|child| child.has_tag_name("collision"))
        {
            shapes.push((self.form(name, collision)?, xml::opening(collision)));
        }
        self.links.push(LinkText {
            name,
            body,
            shapes,
            carrier: None,
            range,
        });
        Ok(())
    }

    fn body(&self, link: &str, inertial: Node<'_, '_>) -> Result<Body, Finding> {
        let source = self.source;
        let part = |name: &str| {
            xml::child(inertial, name).ok_or_else(|| {
                let text =
                    format!("missing {name}: the <inertial> of link `{link}` has no <{name}>");
                xml::finding(source, text, xml::opening(inertial))
            })
        };
        let (mass, tensor) = (part("mass")?, part("inertia")?);
        xml::attribute(source, mass, "value")?;
        let [value] = xml::numbers(source, mass, "value", [0.0])?;
        let number = |name: &str| {
            xml::attribute(source, tensor, name)?;
            xml::numbers(source, tensor, name, [0.0]).map(|[number]| number)
        };
        let product = |name: &str| xml::numbers(source, tensor, name, [0.0]).map(|[number]| number);
        let (xx, yy, zz) = (number("ixx")?, number("iyy")?, number("izz")?);
        let (xy, xz, yz) = (product("ixy")?, product("ixz")?, product("iyz")?);
        let own = Body {
            mass: value,
            centre: Vector3::zeros(),
            inertia: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        };
        let body = own.seen_from(&self.origin(inertial)?);
        check_body(&own, link).map_err(|error| {
            let at = if own.mass < 0.0 { mass } else { tensor };
            self.place(Finding::from(&error), &xml::opening(at))
        })?;
        Ok(body)
    }

    /// The form of a `<collision>`.
    fn form(&self, link: &str, collision: Node<'a, 'a>) -> Result<Form<'a>, Finding> {
        let source = self.source;
        let at = self.origin(collision)?;
        let form = xml::child(collision, "geometry")
            .and_then(|geometry| geometry.children().find(Node::is_element));
        let Some(form) = form else {
            let text = format!("missing geometry: a <collision> of link `{link}` has no form");
            return Err(xml::finding(source, text, xml::opening(collision)));
        };
        let one = |name: &str| {
            xml::attribute(source, form, name)?;
            xml::numbers(source, form, name, [0.0]).map(|[number]| number)
        };
        Ok(Form::Solid(match form.tag_name().name() {
            "box" => {
                xml::attribute(source, form, "size")?;
                let edges = xml::numbers(source, form, "size", [0.0; 3])?;
                let half = Vector3::from(edges) * 0.5;
                Solid::Block { at, half }
            }
            "cylinder" => Solid::around_cylinder(&at, one("radius")?, one("length")?),
            "capsule" => {
                let end = |z: f64| at.point(&Vector3::new(0.0, 0.0, z));
                let half = 0.5 * one("length")?;
                Solid::Capsule {
                    a: end(-half),
                    b: end(half),
                    radius: one("radius")?,
                }
            }
            "sphere" => Solid::sphere(at.origin, one("radius")?),
            "mesh" => {
                let (file, _) = xml::attribute(source, form, "filename")?;
                let scale = xml::numbers(source, form, "scale", [1.0; 3])?.into();
                return Ok(Form::Mesh(at, MeshText { file, scale }));
            }
            other => {
                let text = format!("unknown geometry: <{other}> of link `{link}`");
                return Err(xml::finding(source, text, xml::opening(form))
                    .help("URDF has box, cylinder, capsule, sphere and mesh"));
            }
        }))
    }

    fn origin(&self, node: Node<'_, '_>) -> Result<Placement, Finding> {
        let Some(origin) = xml::child(node, "origin") else {
            return Ok(Placement::identity());
        };
        let xyz = xml::numbers(self.source, origin, "xyz", [0.0; 3])?;
        if let Some(far) = xyz.iter().find(|part| part.abs() > FARTHEST) {
            let text = format!("too far: `xyz` of <origin> has {far} m, which looks like mm");
            return Err(
                xml::finding(self.source, text, xml::opening(origin)).help("lengths are in m")
            );
        }
        let rpy = xml::numbers(self.source, origin, "rpy", [0.0; 3])?;
        Ok(Placement::from_radians(xyz, rpy))
    }

    fn read_joint(
        &mut self,
        node: Node<'a, 'a>,
        joints: &mut HashMap<&'a str, usize>,
    ) -> Result<(), Finding> {
        let source = self.source;
        let (name, range) = xml::attribute(source, node, "name")?;
        if joints.insert(name, self.joints.len()).is_some() {
            return Err(self.finding(
                format!("duplicate name: there is a joint `{name}` already"),
                &range,
            ));
        }
        let (kind, type_range) = xml::attribute(source, node, "type")?;
        let motion = match kind {
            "fixed" => Motion::Fixed,
            "revolute" | "continuous" => Motion::Moving(JointKind::Revolute),
            "prismatic" => Motion::Moving(JointKind::Prismatic),
            "floating" => Motion::Unsupported("floating"),
            "planar" => Motion::Unsupported("planar"),
            _ => {
                let text = format!("unknown joint type: `{kind}` of joint `{name}`");
                return Err(self
                    .finding(text, &type_range)
                    .help("URDF has revolute, continuous, prismatic, fixed, floating and planar"));
            }
        };
        let parent = self.end(node, name, "parent")?;
        let child = self.end(node, name, "child")?;
        let axis = match xml::child(node, "axis") {
            Some(axis) => xml::numbers(source, axis, "xyz", USUAL_AXIS)?,
            None => USUAL_AXIS,
        };
        let axis = Vector3::from(axis);
        if matches!(motion, Motion::Moving(_)) && axis.norm() < NO_AXIS {
            return Err(self.finding(
                format!("no axis: the axis of joint `{name}` has no direction"),
                &range,
            ));
        }
        let limits = self.limits(node, name, kind, motion)?;
        let joint = JointText {
            name,
            motion,
            parent,
            child,
            origin: self.origin(node)?,
            axis,
            limits,
            motor: self.motor(node)?,
            mimics: xml::child(node, "mimic").and_then(|mimic| mimic.attribute("joint")),
            range: range.clone(),
            type_range,
        };
        let link = &mut self.links[child];
        if let Some(other) = link.carrier.replace(self.joints.len()) {
            let text = format!(
                "loop: link `{}` has two parents, by joint `{}` and by joint `{name}`",
                link.name, self.joints[other].name
            );
            return Err(self
                .finding(text, &range)
                .help("a chain that closes cannot be written in URDF"));
        }
        self.joints.push(joint);
        Ok(())
    }

    /// The link at one end of a joint.
    fn end(&self, node: Node<'a, 'a>, joint: &str, which: &str) -> Result<usize, Finding> {
        let element = xml::child(node, which).ok_or_else(|| {
            let text = format!("missing {which}: joint `{joint}` has no <{which}>");
            xml::finding(self.source, text, xml::opening(node))
        })?;
        let (name, range) = xml::attribute(self.source, element, "link")?;
        self.names.get(name).copied().ok_or_else(|| {
            let text = format!("unknown link: the {which} `{name}` of joint `{joint}` is no link");
            self.finding(text, &range)
                .suggest(name, self.names.keys().copied())
        })
    }

    fn limits(
        &self,
        node: Node<'_, '_>,
        joint: &str,
        kind: &str,
        motion: Motion,
    ) -> Result<Limits, Finding> {
        if !matches!(motion, Motion::Moving(_)) {
            return Ok(Limits::NONE);
        }
        let Some(limit) = xml::child(node, "limit") else {
            if kind == "continuous" {
                return Ok(Limits::NONE);
            }
            let text = format!("no limits: joint `{joint}` is {kind} and has no <limit>");
            return Err(xml::finding(self.source, text, xml::opening(node))
                .help("add <limit lower=\"..\" upper=\"..\" velocity=\"..\" effort=\"..\"/>, or make it continuous"));
        };
        let number = |name: &str, usual: f64| {
            xml::numbers(self.source, limit, name, [usual]).map(|[number]| number)
        };
        let (lower, upper) = match kind {
            "continuous" => (f64::NEG_INFINITY, f64::INFINITY),
            _ if !limit.has_attribute("lower") && !limit.has_attribute("upper") => {
                let text = format!(
                    "no limits: the <limit> of joint `{joint}` has neither `lower` nor `upper`, which is a range of 0"
                );
                return Err(xml::finding(self.source, text, xml::opening(limit))
                    .help("give both, or make the joint continuous, or fixed"));
            }
            _ => (number("lower", 0.0)?, number("upper", 0.0)?),
        };
        if kind == "revolute"
            && [lower, upper]
                .iter()
                .any(|end| DEGREES.contains(&end.abs()))
        {
            let text = format!(
                "too far: joint `{joint}` turns from {lower} to {upper} rad, which looks like degrees"
            );
            return Err(xml::finding(self.source, text, xml::opening(limit))
                .help("angles are in rad; make a joint that turns on and on continuous"));
        }
        let most = |name: &str| {
            let given = number(name, UNLIMITED)?;
            Ok::<f64, Finding>(if given < UNLIMITED {
                given
            } else {
                f64::INFINITY
            })
        };
        let velocity = most("velocity")?;
        if velocity == 0.0 {
            let text = format!("cannot move: the largest velocity of joint `{joint}` is 0");
            return Err(xml::finding(self.source, text, xml::opening(limit))
                .help("give its velocity in rad/s or m/s, or leave `velocity` out"));
        }
        let limits = Limits {
            lower,
            upper,
            velocity,
            torque: most("effort")?,
            ..Limits::NONE
        };
        let checked = check_limits(&limits, joint);
        checked.map_err(|error| self.place(Finding::from(&error), &xml::opening(limit)))?;
        Ok(limits)
    }

    /// The rotor of a joint, which URDF has no word for: `rotorInertia`, kg m^2 at the motor, in the actuator of a
    /// transmission with one joint. Without it a transmission says nothing about motion.
    fn read_transmission(
        &mut self,
        node: Node<'a, 'a>,
        joints: &HashMap<&'a str, usize>,
    ) -> Result<(), Finding> {
        let source = self.source;
        let ends = (xml::child(node, "joint"), xml::child(node, "actuator"));
        let (Some(driven), Some(actuator)) = ends else {
            return Ok(());
        };
        let Some((inertia, range)) = xml::number_within(source, actuator, "rotorInertia")? else {
            return Ok(());
        };
        if inertia < 0.0 {
            return Err(self.finding(format!("negative inertia: a rotor of {inertia}"), &range));
        }
        let gear = xml::number_within(source, actuator, "mechanicalReduction")?;
        if let Some((0.0, range)) = gear {
            return Err(self.finding("no gear: the reduction is 0".to_owned(), &range));
        }
        let gear = gear.map_or(1.0, |(gear, _)| gear);
        let (name, range) = xml::attribute(source, driven, "name")?;
        let joint = joints
            .get(name)
            .and_then(|joint| self.joints.get_mut(*joint));
        let Some(joint) = joint else {
            let text = format!("unknown joint: a transmission drives `{name}`");
            return Err(self
                .finding(text, &range)
                .suggest(name, joints.keys().copied()));
        };
        // Friction stays what it is at the joint.
        let friction = joint.motor.friction;
        joint.motor = Motor {
            rotor_inertia: inertia,
            gear_ratio: gear,
            friction: Friction {
                viscous: friction.viscous / (gear * gear),
                coulomb_forward: friction.coulomb_forward / gear.abs(),
                coulomb_backward: friction.coulomb_backward / gear.abs(),
            },
        };
        Ok(())
    }

    /// URDF knows of no rotor; its friction is at the joint.
    fn motor(&self, node: Node<'_, '_>) -> Result<Motor, Finding> {
        let Some(dynamics) = xml::child(node, "dynamics") else {
            return Ok(Motor::default());
        };
        let [viscous] = xml::numbers(self.source, dynamics, "damping", [0.0])?;
        let [coulomb] = xml::numbers(self.source, dynamics, "friction", [0.0])?;
        Ok(Motor {
            rotor_inertia: 0.0,
            gear_ratio: 1.0,
            friction: Friction {
                viscous,
                coulomb_forward: coulomb,
                coulomb_backward: -coulomb,
            },
        })
    }

    fn only_root(&self) -> Result<usize, Finding> {
        let mut roots = self
            .links
            .iter()
            .enumerate()
            .filter(|(_, link)| link.carrier.is_none());
        let Some((root, first)) = roots.next() else {
            let link = &self.links[0];
            let text = format!("loop: every link has a parent, link `{}` too", link.name);
            return Err(self
                .finding(text, &link.range)
                .help("one link must be the <child> of no joint"));
        };
        match roots.next() {
            None => Ok(root),
            Some((_, second)) => {
                let text = format!(
                    "two roots: nothing carries link `{}`, and nothing link `{}`",
                    first.name, second.name
                );
                Err(self
                    .finding(text, &second.range)
                    .help("join them with a joint, or remove what is not of this robot"))
            }
        }
    }

    /// A link that is not, though it has a parent, hangs in a loop of its own.
    fn all_hang_on_the_root(&self) -> Result<(), Finding> {
        let mut children = vec![Vec::new(); self.links.len()];
        for joint in &self.joints {
            children[joint.parent].push(joint.child);
        }
        let mut hangs = vec![false; self.links.len()];
        let mut next = vec![self.root];
        while let Some(link) = next.pop() {
            hangs[link] = true;
            next.append(&mut children[link]);
        }
        match self.links.iter().zip(hangs).find(|(_, hangs)| !hangs) {
            None => Ok(()),
            Some((link, _)) => {
                let text = format!(
                    "loop: link `{}` is carried by links that it carries",
                    link.name
                );
                Err(self.finding(text, &link.range))
            }
        }
    }
}
