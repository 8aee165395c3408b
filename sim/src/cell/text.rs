//! The text of a cell file: its keys, and what each may be.

use std::ops::Range;

use ctos::diagnostic::{Finding, Findings, Source};
use mcs::model::{
    Body, FrameId, JointKind, Model, Placement, built_in,
    file::{self, Inertias},
    urdf,
};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::Deserialize;
use toml::Spanned;

use super::{
    ArmSpec, BodySpec, CameraSpec, Cell, LampSpec, Mount, ObjectSpec, Origin, ReadModel,
    SensorSpec, overlap,
};
use crate::{
    camera::truth::{CameraTruth, Distortion},
    shapes::{self, Shape, Solid},
    wrist::Electronics,
};

/// As [`Cell::parse_with`].
pub(super) fn parse(source: &Source, model: ReadModel<'_>) -> Result<Cell, Findings> {
    let text: CellText = toml::from_str(source.text()).map_err(|error| syntax(source, &error))?;
    let mut check = Check {
        source,
        model,
        arms: Vec::new(),
        findings: Findings::new(),
    };
    let cell = text.check(&mut check);
    // Where things are means little while something else is wrong.
    if !check.findings.has_errors() {
        for (object, what, depth) in overlap::find(&cell) {
            let Some(text) = text.object.get(object) else {
                continue;
            };
            let message = format!(
                "object `{}` starts {:.1} mm deep in {what}",
                text.name.get_ref(),
                depth * 1e3
            );
            check.refuse(
                text.position.span(),
                message,
                "put it where nothing else is",
            );
        }
    }
    if check.findings.has_errors() {
        Err(check.findings)
    } else {
        Ok(cell)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CellText {
    #[serde(default)]
    arm: Vec<ArmText>,
    #[serde(default)]
    lamp: Vec<LampText>,
    #[serde(default)]
    room: RoomText,
    #[serde(default)]
    camera: Vec<CameraText>,
    #[serde(default)]
    furniture: Vec<FurnitureText>,
    #[serde(default)]
    object: Vec<ObjectText>,
    #[serde(default)]
    force_torque: Vec<SensorText>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmText {
    name: Spanned<String>,
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LampText {
    name: Spanned<String>,
    arm: Option<Spanned<String>>,
    link: Option<Spanned<String>>,
    offset: Spanned<[f64; 3]>,
    radius: Spanned<f64>,
    brightness: Spanned<f64>,
    #[serde(default = "yes")]
    on: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorText {
    name: Spanned<String>,
    arm: Spanned<String>,
    link: Option<Spanned<String>>,
    load: Option<LoadText>,
    compensates: Option<LoadText>,
    #[serde(default)]
    compensates_hand: bool,
    bias: Option<Spanned<[f64; 6]>>,
    noise: Option<Spanned<[f64; 2]>>,
    filter_hz: Option<Spanned<f64>>,
    #[serde(default = "one")]
    seed: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LoadText {
    mass: Spanned<f64>,
    centre: Spanned<[f64; 3]>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct RoomText {
    floor_grey: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FurnitureText {
    centre: Spanned<[f64; 3]>,
    size: Spanned<[f64; 3]>,
    grey: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ObjectText {
    name: Spanned<String>,
    shape: Spanned<FormText>,
    size: Option<Spanned<[f64; 3]>>,
    radius: Option<Spanned<f64>>,
    height: Option<Spanned<f64>>,
    mass: Spanned<f64>,
    friction: Option<Spanned<f64>>,
    grey: Spanned<f64>,
    position: Spanned<[f64; 3]>,
    rpy: Option<Spanned<[f64; 3]>>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "lowercase")]
enum FormText {
    Box,
    Sphere,
    Cylinder,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraText {
    name: Spanned<String>,
    arm: Option<Spanned<String>>,
    link: Option<Spanned<String>>,
    width: Spanned<u32>,
    height: Spanned<u32>,
    fx: Spanned<f64>,
    fy: Spanned<f64>,
    cx: Spanned<f64>,
    cy: Spanned<f64>,
    k1: Spanned<f64>,
    k2: Spanned<f64>,
    p1: Spanned<f64>,
    p2: Spanned<f64>,
    k3: Spanned<f64>,
    position: Spanned<[f64; 3]>,
    look_at: Spanned<[f64; 3]>,
    up: Spanned<[f64; 3]>,
    blur: Spanned<f64>,
    read_noise: Spanned<f64>,
    shot_noise: Spanned<f64>,
}

const fn yes() -> bool {
    true
}

const fn one() -> u64 {
    1
}

/// Grey of a floor that the file says nothing of.
const FLOOR_GREY: f64 = 24.0;

/// Friction of an object or of an arm's surface that the file says nothing of.
const FRICTION: f64 = 0.5;

/// Largest picture side, px: a picture stays within a few megabytes.
const LARGEST_SIDE: u32 = 4096;

const GREY: [f64; 2] = [0.0, 255.0];

struct Check<'a> {
    source: &'a Source,
    model: ReadModel<'a>,
    /// The names of all arms of the file, also of those that are no good.
    arms: Vec<String>,
    findings: Findings,
}

impl Check<'_> {
    fn refuse(&mut self, span: Range<usize>, message: String, help: &str) {
        self.findings.push(
            Finding::error("sim::cell::bad_value", message)
                .at(self.source.at(span))
                .help(help),
        );
    }

    /// A number within `low..=high`; said of `what`, in `unit`.
    fn number(
        &mut self,
        value: &Spanned<f64>,
        what: &str,
        unit: &str,
        [low, high]: [f64; 2],
    ) -> f64 {
        let number = *value.get_ref();
        if !(low..=high).contains(&number) {
            self.refuse(
                value.span(),
                format!("{what} is {number} {unit}"),
                &format!("give a number from {low} to {high} {unit}"),
            );
        }
        number
    }

    /// Numbers within `low..=high` each.
    fn each<const N: usize>(
        &mut self,
        values: &Spanned<[f64; N]>,
        what: &str,
        [low, high]: [f64; 2],
    ) -> [f64; N] {
        let numbers = *values.get_ref();
        if !numbers.iter().all(|number| (low..=high).contains(number)) {
            self.refuse(
                values.span(),
                format!("{what} is {numbers:?}"),
                &format!("give numbers from {low} to {high}: N, then N m"),
            );
        }
        numbers
    }

    /// Three coordinates within `reach` of the origin, m.
    fn point(&mut self, value: &Spanned<[f64; 3]>, what: &str, reach: f64) -> Vector3<f64> {
        let point = Vector3::from(*value.get_ref());
        if !point.iter().all(|x| (-reach..=reach).contains(x)) {
            self.refuse(
                value.span(),
                format!("{what} is {:?}", value.get_ref()),
                &format!("give three numbers from {} to {reach} m", -reach),
            );
        }
        point
    }

    /// Angles about x, y and z, degrees: none when nothing is said.
    fn turn(&mut self, value: Option<&Spanned<[f64; 3]>>) -> [f64; 3] {
        let Some(value) = value else {
            return [0.0; 3];
        };
        if !value
            .get_ref()
            .iter()
            .all(|angle| (-360.0..=360.0).contains(angle))
        {
            self.refuse(
                value.span(),
                format!("the turn is {:?} degrees", value.get_ref()),
                "give three angles from -360 to 360 degrees, about x, then y, then z",
            );
        }
        *value.get_ref()
    }

    /// A factor on what the model says: 1 when nothing is said.
    fn factor(&mut self, value: Option<&Spanned<f64>>, what: &str) -> f64 {
        value.map_or(1.0, |value| self.number(value, what, "", [0.01, 100.0]))
    }

    /// Refuses a name that is empty or taken.
    fn name(&mut self, what: &str, name: &Spanned<String>, taken: &mut Vec<String>) -> String {
        let given = name.get_ref().clone();
        if given.is_empty() || taken.contains(&given) {
            self.refuse(
                name.span(),
                format!("{what} cannot be called `{given}`: the name is empty or taken"),
                &format!(
                    "give every {} its own name",
                    what.split_once(' ').map_or(what, |(_, noun)| noun)
                ),
            );
        }
        taken.push(given.clone());
        given
    }

    /// What carries something: the tip of `arm`, or its `link`; nothing when no arm is named.
    fn mount(
        &mut self,
        arms: &[ArmSpec],
        arm: Option<&Spanned<String>>,
        link: Option<&Spanned<String>>,
    ) -> Option<Mount> {
        let Some(arm) = arm else {
            if let Some(link) = link {
                self.refuse(
                    link.span(),
                    format!("link `{}` is of no arm", link.get_ref()),
                    "say which one besides: `arm = \"NAME\"`",
                );
            }
            return None;
        };
        let names = || arms.iter().map(|arm| arm.name.as_str());
        let Some(index) = names().position(|name| name == arm.get_ref()) else {
            if self.arms.contains(arm.get_ref()) {
                return None;
            }
            let message = format!("the cell has no arm `{}`", arm.get_ref());
            self.findings.push(
                Finding::error("sim::cell::unknown_arm", message)
                    .at(self.source.at(arm.span()))
                    .suggest(arm.get_ref(), names()),
            );
            return None;
        };
        let model = &arms.get(index)?.model;
        let frame = match link {
            None => model.tip(),
            Some(link) => self.frame(model, link)?,
        };
        Some(Mount { arm: index, frame })
    }

    fn frame(&mut self, model: &Model, link: &Spanned<String>) -> Option<FrameId> {
        let found = model.frame(link.get_ref());
        if found.is_none() {
            let message = format!("model `{}` has no frame `{}`", model.name(), link.get_ref());
            let names = model.frames().iter().map(|frame| frame.name.as_str());
            self.findings.push(
                Finding::error("sim::cell::unknown_link", message)
                    .at(self.source.at(link.span()))
                    .suggest(link.get_ref(), names),
            );
        }
        found
    }

    /// The model of that name, or of that file.
    fn model(&mut self, name: &Spanned<String>) -> Option<Model> {
        let (given, inertias) = (name.get_ref().as_str(), Inertias::Engine);
        let read = match built_in::model(given, inertias) {
            Some(model) => model,
            None if given.ends_with(".urdf") => (self.model)(given)
                .and_then(|source| urdf::parse(&source, None, None))
                .map(|read| read.model)
                .map_err(Findings::from),
            None if given.ends_with(".toml") => (self.model)(given)
                .map_err(Findings::from)
                .and_then(|source| file::parse(&source, inertias)),
            None => {
                let message = format!("there is no model `{given}`");
                Err(Finding::error("sim::cell::unknown_model", message)
                    .suggest(given, built_in::NAMES)
                    .into())
            }
        };
        match read {
            Ok(model) => Some(model),
            Err(found) => {
                for finding in found.into_sorted() {
                    let place = finding.place.clone();
                    self.findings
                        .push(finding.at(place.unwrap_or_else(|| self.source.at(name.span()))));
                }
                None
            }
        }
    }
}

impl CellText {
    fn check(&self, check: &mut Check<'_>) -> Cell {
        let floor_grey = self.room.floor_grey.as_ref().map_or(FLOOR_GREY, |grey| {
            check.number(grey, "the floor's grey", "grey levels", GREY)
        });
        let (mut names, mut arms) = (Vec::new(), Vec::new());
        for arm in &self.arm {
            let name = check.name("an arm", &arm.name, &mut names);
            arms.extend(arm.check(name, check));
        }
        check.arms = names;
        let mut names = Vec::new();
        let mut lamps = Vec::new();
        for lamp in &self.lamp {
            let name = check.name("a lamp", &lamp.name, &mut names);
            let lamp = lamp.check(name, &arms, floor_grey, check);
            // Nobody knows how a lamp is held by an arm whose form nobody knows.
            if let Some(Mount { arm, frame }) = lamp.mount
                && let Some(arm) = arms.get_mut(arm)
                && !arm.shapes.is_empty()
            {
                let on = &arm.model.at(frame).name;
                let rod = shapes::rod(on, &lamp.offset, lamp.radius);
                arm.shapes.extend(rod.map(|rod| (frame, rod)));
            }
            lamps.push(lamp);
        }
        let room = self
            .furniture
            .iter()
            .map(|item| item.check(check))
            .collect();
        let mut names = Vec::new();
        let mut objects = Vec::new();
        for object in &self.object {
            let name = check.name("an object", &object.name, &mut names);
            objects.push(object.check(name, check));
        }
        let mut names = Vec::new();
        let mut mounts = Vec::new();
        let mut cameras = Vec::new();
        for camera in &self.camera {
            check.name("a camera", &camera.name, &mut names);
            mounts.push(check.mount(&arms, camera.arm.as_ref(), camera.link.as_ref()));
            cameras.push(camera.check(check));
        }
        let mut names = Vec::new();
        let mut sensors = Vec::new();
        for sensor in &self.force_torque {
            let name = check.name("a sensor", &sensor.name, &mut names);
            sensors.extend(sensor.check(name, &mut arms, check));
        }
        // A load may hang on other sensors besides its own.
        for sensor in &mut sensors {
            if let Some(arm) = arms.get(sensor.mount.arm) {
                let frame = sensor.mount.frame;
                sensor.hanging.extend(hanging(&arm.model, frame));
            }
        }
        let mut cell = Cell {
            bodies: bodies(&arms, &objects, &mounts),
            sensors,
            arms,
            lamps,
            floor_grey,
            room,
            objects,
            cameras,
        };
        // A camera that is carried was described in the frame of what carries it.
        let start = cell.start();
        for (camera, mount) in cell.cameras.iter_mut().zip(mounts) {
            let carries =
                |body: &BodySpec| mount.is_some_and(|mount| body.origin == Origin::Link(mount));
            if let Some(index) = cell.bodies.iter().position(carries)
                && let Some(body) = start.bodies.get(index)
            {
                let camera_t_body = camera.truth.camera_t_world;
                camera.truth.camera_t_world = camera_t_body * body.pose.inverse();
                camera.mount = Some((index, camera_t_body));
            }
        }
        cell
    }
}

/// The frames of the arms that have a form or carry a camera, then the objects.
fn bodies(arms: &[ArmSpec], objects: &[ObjectSpec], mounts: &[Option<Mount>]) -> Vec<BodySpec> {
    let mut all: Vec<BodySpec> = Vec::new();
    for (index, arm) in arms.iter().enumerate() {
        for frame in arm.model.frames() {
            let Some(id) = arm.model.frame(&frame.name) else {
                continue;
            };
            let mount = Mount {
                arm: index,
                frame: id,
            };
            let shapes = arm.shapes.iter().filter(|(on, _)| *on == id);
            let shapes: Vec<Shape> = shapes.map(|(_, shape)| *shape).collect();
            if !shapes.is_empty() || mounts.contains(&Some(mount)) {
                all.push(BodySpec {
                    name: format!("{}.{}", arm.name, frame.name),
                    origin: Origin::Link(mount),
                    still: frame.carrier.is_none(),
                    shapes,
                });
            }
        }
    }
    all.extend(objects.iter().enumerate().map(|(index, object)| BodySpec {
        name: object.name.clone(),
        origin: Origin::Object(index),
        still: false,
        shapes: vec![object.shape],
    }));
    all
}

impl ArmText {
    fn check(&self, name: String, check: &mut Check<'_>) -> Option<ArmSpec> {
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
            let frame = check.frame(model, &capsule.link);
            all.extend(frame.map(|frame| (frame, Shape { solid, grey })));
        }
        all
    }
}

impl LampText {
    fn check(
        &self,
        name: String,
        arms: &[ArmSpec],
        floor_grey: f64,
        check: &mut Check<'_>,
    ) -> LampSpec {
        let brightness = check.number(
            &self.brightness,
            "the lamp's brightness",
            "grey levels",
            GREY,
        );
        if floor_grey + brightness > 255.0 {
            check.findings.push(
                Finding::warning(
                    "sim::cell::saturates",
                    format!(
                        "a lamp of {brightness} on a floor of {floor_grey} grey levels saturates the sensor"
                    ),
                )
                .at(check.source.at(self.brightness.span()))
                .help("keep their sum below 255, or centres of spots will be worse"),
            );
        }
        let mount = check.mount(arms, self.arm.as_ref(), self.link.as_ref());
        // From a joint a lamp is not further away than this; in the room it may be anywhere.
        let reach = if self.arm.is_some() { 0.5 } else { 10.0 };
        LampSpec {
            name,
            mount,
            offset: check.point(&self.offset, "the lamp's offset", reach).into(),
            radius: check.number(&self.radius, "the lamp's radius", "m", [1e-3, 0.1]),
            brightness,
            on: self.on,
        }
    }
}

/// The frames that hang on a frame, each with what is fixed to it.
fn hanging(model: &Model, frame: FrameId) -> impl Iterator<Item = (FrameId, Body)> {
    let all = model.hanging(frame);
    all.map(|(frame, body)| (frame, *body))
}

impl LoadText {
    fn check(&self, check: &mut Check<'_>) -> Body {
        let mass = check.number(&self.mass, "the mass behind a sensor", "kg", [0.0, 100.0]);
        let what = "the centre of what hangs behind a sensor";
        let centre = check.point(&self.centre, what, 1.0);
        Body::diagonal(mass, centre.into(), [0.0; 3])
    }
}

impl SensorText {
    /// The sensor, of what hangs on it only its load; that becomes part of its arm.
    fn check(
        &self,
        name: String,
        arms: &mut [ArmSpec],
        check: &mut Check<'_>,
    ) -> Option<SensorSpec> {
        let usual = Electronics::default();
        let mut load = |text: &Option<LoadText>| {
            let text = text.as_ref();
            text.map_or_else(Body::default, |text| text.check(check))
        };
        let (load, compensates) = (load(&self.load), load(&self.compensates));
        let bias = self.bias.as_ref();
        let bias = bias.map_or(usual.bias, |bias| {
            check.each(bias, "the bias of a sensor", [-1000.0, 1000.0])
        });
        let noise = self.noise.as_ref();
        let noise = noise.map_or(usual.noise, |noise| {
            check.each(noise, "the noise of a sensor", [0.0, 100.0])
        });
        let filter_hz = self.filter_hz.as_ref().map_or(usual.filter_hz, |corner| {
            check.number(corner, "the filter of a sensor", "Hz", [0.01, 1e6])
        });
        let mount = check.mount(arms, Some(&self.arm), self.link.as_ref())?;
        let arm = arms.get_mut(mount.arm)?;
        arm.model = arm.model.clone().with_body(mount.frame, &load);
        let mut known = vec![(mount.frame, compensates)];
        if self.compensates_hand {
            known.extend(hanging(&arm.nominal, mount.frame));
        }
        Some(SensorSpec {
            name,
            mount,
            hanging: vec![(mount.frame, load)],
            known,
            electronics: Electronics {
                bias,
                noise,
                filter_hz,
                seed: self.seed,
            },
        })
    }
}

impl ObjectText {
    fn check(&self, name: String, check: &mut Check<'_>) -> ObjectSpec {
        let origin = check.point(&self.position, "the position of an object", 10.0);
        ObjectSpec {
            shape: Shape {
                solid: self.solid(check),
                grey: check.number(&self.grey, "the grey of an object", "grey levels", GREY),
            },
            mass: check.number(&self.mass, "the mass of an object", "kg", [1e-4, 1000.0]),
            friction: self.friction.as_ref().map_or(FRICTION, |friction| {
                check.number(friction, "the friction of an object", "", [0.0, 10.0])
            }),
            start: Placement::from_degrees(origin.into(), check.turn(self.rpy.as_ref())).isometry(),
            name,
        }
    }

    fn solid(&self, check: &mut Check<'_>) -> Solid {
        let mut length = |value: Option<&Spanned<f64>>, what: &str| match value {
            Some(value) => check.number(value, what, "m", [1e-3, 10.0]),
            None => {
                let message = format!("object `{}` has no {what}", self.name.get_ref());
                check.refuse(self.shape.span(), message, FORMS);
                1.0
            }
        };
        match self.shape.get_ref() {
            FormText::Sphere => Solid::Capsule {
                a: Point3::origin(),
                b: Point3::origin(),
                radius: length(self.radius.as_ref(), "radius"),
            },
            FormText::Cylinder => Solid::Cylinder {
                half: length(self.height.as_ref(), "height") / 2.0,
                radius: length(self.radius.as_ref(), "radius"),
            },
            FormText::Box => {
                let size = self.size.as_ref().map(|size| {
                    (
                        size.span(),
                        check.point(size, "the size of an object", 10.0),
                    )
                });
                let (span, size) = size.unwrap_or((self.shape.span(), Vector3::zeros()));
                if size.min() < 1e-3 {
                    let message = format!(
                        "object `{}` has no size, or is thinner than 1 mm",
                        self.name.get_ref()
                    );
                    check.refuse(span, message, FORMS);
                }
                Solid::Block {
                    centre: Point3::origin(),
                    half: size / 2.0,
                }
            }
        }
    }
}

/// What each form needs.
const FORMS: &str = "a box has `size`, its edge lengths along x, y and z; a sphere `radius`; a cylinder `radius` and `height` along z; all in m";

impl FurnitureText {
    fn check(&self, check: &mut Check<'_>) -> Shape {
        let centre = check.point(&self.centre, "the centre of a piece of furniture", 10.0);
        let size = check.point(&self.size, "the size of a piece of furniture", 10.0);
        if size.min() < 1e-3 {
            check.refuse(
                self.size.span(),
                "a piece of furniture is thinner than 1 mm".to_owned(),
                "give its full edge lengths along x, y and z, m",
            );
        }
        Shape {
            solid: Solid::Block {
                centre: centre.into(),
                half: size / 2.0,
            },
            grey: check.number(
                &self.grey,
                "the grey of a piece of furniture",
                "grey levels",
                GREY,
            ),
        }
    }
}

impl CameraText {
    fn check(&self, check: &mut Check<'_>) -> CameraSpec {
        let before = check.findings.iter().count();
        let [width, height] =
            [(&self.width, "width"), (&self.height, "height")].map(|(side, what)| {
                if !(16..=LARGEST_SIDE).contains(side.get_ref()) {
                    check.refuse(
                        side.span(),
                        format!("the picture's {what} is {} px", side.get_ref()),
                        &format!("give a whole number from 16 to {LARGEST_SIDE}"),
                    );
                }
                *side.get_ref()
            });
        let size = f64::from(width.max(height));
        let mut focal = |value, what| check.number(value, what, "px", [0.1 * size, 100.0 * size]);
        let focal = [focal(&self.fx, "fx"), focal(&self.fy, "fy")];
        let principal = [
            check.number(&self.cx, "cx", "px", [0.0, f64::from(width)]),
            check.number(&self.cy, "cy", "px", [0.0, f64::from(height)]),
        ];
        let mut term = |value, what| check.number(value, what, "", [-10.0, 10.0]);
        let distortion = Distortion {
            k1: term(&self.k1, "k1"),
            k2: term(&self.k2, "k2"),
            p1: term(&self.p1, "p1"),
            p2: term(&self.p2, "p2"),
            k3: term(&self.k3, "k3"),
        };
        let camera_t_world = self.pose(check);
        let spec = CameraSpec {
            mount: None,
            truth: CameraTruth {
                name: self.name.get_ref().clone(),
                width: width as usize,
                height: height as usize,
                focal,
                principal,
                distortion,
                camera_t_world,
                valid_radius: distortion.monotonic_radius(),
            },
            read_noise: check.number(
                &self.read_noise,
                "the read noise",
                "grey levels",
                [0.0, 64.0],
            ),
            shot_noise: check.number(
                &self.shot_noise,
                "the shot noise",
                "grey levels",
                [0.0, 64.0],
            ),
            blur: check.number(&self.blur, "the blur", "px", [0.3, 10.0]),
        };
        // The lens can only be judged when the numbers it is made of are sound.
        if check.findings.iter().count() == before && !spec.truth.covers_picture() {
            let radius = spec.truth.valid_radius;
            check.refuse(
                self.k1.span(),
                format!(
                    "the distortion of camera `{}` turns back inside the picture (it grows only up \
                     to {radius:.2} focal lengths from the axis)",
                    spec.truth.name
                ),
                "make k1, k2, k3 weaker or the focal length longer",
            );
        }
        spec
    }

    fn pose(&self, check: &mut Check<'_>) -> Isometry3<f64> {
        let position = check.point(&self.position, "the camera's position", 100.0);
        let look_at = check.point(&self.look_at, "the point looked at", 100.0);
        let up = check.point(&self.up, "the upward direction", 100.0);
        CameraTruth::pose(&position.into(), &look_at.into(), &up).unwrap_or_else(|| {
            check.refuse(
                self.look_at.span(),
                format!(
                    "camera `{}` has no definite direction of view",
                    self.name.get_ref()
                ),
                "`look_at` must differ from `position`, and `up` must not point along the view",
            );
            Isometry3::identity()
        })
    }
}

/// A finding for a text that is no TOML or does not have the form of a cell.
fn syntax(source: &Source, error: &toml::de::Error) -> Finding {
    let message = error.message();
    let mut finding = Finding::error("sim::cell::form", message.trim().to_owned())
        .help("see `docs/simulator.md` for every key");
    // Serde says "unknown field `x`, expected one of `a`, `b`": the quoted words are the names.
    let mut words = message.split('`').skip(1).step_by(2);
    if message.starts_with("unknown field")
        && let Some(given) = words.next()
    {
        finding = finding.suggest(given, words);
    }
    match error.span() {
        Some(span) => finding.at(source.at(span)),
        None => finding.at(source.at_line(1)),
    }
}
