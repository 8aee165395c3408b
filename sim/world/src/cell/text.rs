//! The text of a cell file: its keys, and what each may be. Each kind of entry has a file of its own.

mod arm;
mod camera;
mod check;
mod lamp;
mod laser;
mod sensor;
mod thing;

use ctos_config::diagnostic::{Finding, Findings, Source};
use serde::Deserialize;
use toml::Spanned;

use self::{
    arm::ArmText,
    camera::CameraText,
    check::{Check, GREY},
    lamp::LampText,
    laser::LaserText,
    sensor::{SensorText, hanging},
    thing::{FurnitureText, MarkText, ObjectText},
};
use super::{ArmSpec, BodySpec, Cell, Mount, ObjectSpec, Origin, ReadModel, overlap};
use crate::shapes::{self, Shape};

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
    mark: Vec<MarkText>,
    #[serde(default)]
    laser: Vec<LaserText>,
    #[serde(default)]
    object: Vec<ObjectText>,
    #[serde(default)]
    force_torque: Vec<SensorText>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct RoomText {
    floor_grey: Option<Spanned<f64>>,
}

/// Grey of a floor that the file says nothing of.
const FLOOR_GREY: f64 = 24.0;

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
        let marks = self.mark.iter().map(|mark| mark.check(check)).collect();
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
        let mut lasers = Vec::new();
        for laser in &self.laser {
            let name = check.name("a laser", &laser.name, &mut names);
            lasers.push(laser.check(name, &arms, check));
        }
        let mut names = Vec::new();
        let mut sensors = Vec::new();
        for sensor in &self.force_torque {
            let name = check.name("a sensor", &sensor.name, &mut names);
            sensors.extend(sensor.check(name, &mut arms, check));
        }
        // Both are slots, and told apart by their names.
        let mut plates = Vec::new();
        for (piece, item) in self.furniture.iter().enumerate() {
            if let Some(plate) = &item.feels {
                let name = check.name("a sensor", &plate.name, &mut names);
                plates.push(plate.check(name, piece, check));
            }
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
            plates,
            arms,
            lamps,
            floor_grey,
            room,
            marks,
            objects,
            cameras,
            lasers,
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
    all.extend(objects.iter().enumerate().map(|(index, object)| {
        BodySpec {
            name: object.name.clone(),
            origin: Origin::Object(index),
            still: false,
            shapes: std::iter::once(object.shape)
                .chain(object.marks.iter().copied())
                .collect(),
        }
    }));
    all
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
