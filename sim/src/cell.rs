//! The cell file: where the arm starts, its lamp, the cameras, what stands in the room.
//!
//! Every mistake in the file is a finding with its place. Units are in the reference below and in
//! `configs/cell.toml`: m, px, grey levels; joint angles in degrees, as in the arm's data sheets.

use std::{ops::Range, path::Path};

use ctos::diagnostic::{Finding, Findings, Source};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::Deserialize;
use toml::Spanned;

use crate::{
    camera::truth::{CameraTruth, Distortion},
    puma560::{self, JOINTS},
    scene::SceneState,
    shapes::{self, Shape, Solid},
    world::WorldSetup,
};

/// A checked cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Joint angles at the start, rad.
    pub start: [f64; JOINTS],
    /// Whether the joints have the friction of the real arm.
    pub friction: bool,
    /// The lamp on the wrist.
    pub lamp: LampSpec,
    /// Grey of the floor when lit from straight above.
    pub floor_grey: f64,
    /// What stands in the room, world frame.
    pub room: Vec<Shape>,
    /// The cameras, in the file's order.
    pub cameras: Vec<CameraSpec>,
}

/// The lamp on the wrist.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LampSpec {
    /// Its centre in frame 6, m.
    pub offset: Point3<f64>,
    /// Its radius, m.
    pub radius: f64,
    /// Grey levels of its surface, 0 for a lamp that is broken; the peak of a blurred spot is lower.
    pub brightness: f64,
    /// Whether it shines at the start.
    pub on: bool,
}

/// A camera with its sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSpec {
    /// Its exact geometry.
    pub truth: CameraTruth,
    /// Standard deviation of a pixel's value in the dark, grey levels.
    pub read_noise: f64,
    /// Variance that grows with the light, grey levels; 0 for none.
    pub shot_noise: f64,
    /// Standard deviation of the point spread (lens and pixel area), px.
    pub blur: f64,
}

impl Cell {
    /// Reads and checks a cell file.
    ///
    /// # Errors
    /// Everything that is wrong in it, each with its place.
    pub fn read(path: &Path) -> Result<Self, Findings> {
        Self::parse(&Source::read(path)?)
    }

    /// Checks the text of a cell file.
    ///
    /// # Errors
    /// Everything that is wrong in it, each with its place.
    pub fn parse(source: &Source) -> Result<Self, Findings> {
        let text: CellText =
            toml::from_str(source.text()).map_err(|error| syntax(source, &error))?;
        let mut check = Check {
            source,
            findings: Findings::new(),
        };
        let cell = text.check(&mut check);
        if check.findings.has_errors() {
            Err(check.findings)
        } else {
            Ok(cell)
        }
    }

    /// The camera called `name`.
    ///
    /// # Errors
    /// A finding without place that lists the cameras there are.
    pub fn camera(&self, name: &str) -> Result<&CameraSpec, Finding> {
        let known = || self.cameras.iter().map(|camera| camera.truth.name.as_str());
        self.cameras
            .iter()
            .find(|camera| camera.truth.name == name)
            .ok_or_else(|| {
                Finding::error(
                    "sim::cell::unknown_camera",
                    format!("the cell has no camera `{name}`"),
                )
                .suggest(name, known())
            })
    }

    /// What the physics needs of the cell.
    #[must_use]
    pub fn world(&self) -> WorldSetup {
        WorldSetup {
            start: self.start,
            friction: self.friction,
            arm: shapes::arm(&self.lamp.offset, self.lamp.radius),
            room: self.room.clone(),
        }
    }

    /// The scene with the arm at rest at `joints`, rad, and the lamp as at the start.
    #[must_use]
    pub fn scene(&self, joints: &[f64; JOINTS]) -> SceneState {
        SceneState::at(joints, &self.lamp.offset, self.lamp.on)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CellText {
    arm: ArmText,
    lamp: LampText,
    #[serde(default)]
    room: RoomText,
    #[serde(default)]
    camera: Vec<CameraText>,
    #[serde(default)]
    furniture: Vec<FurnitureText>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmText {
    start_deg: Spanned<[f64; JOINTS]>,
    #[serde(default)]
    friction: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LampText {
    offset: Spanned<[f64; 3]>,
    radius: Spanned<f64>,
    brightness: Spanned<f64>,
    #[serde(default = "yes")]
    on: bool,
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
struct CameraText {
    name: Spanned<String>,
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

/// Grey of a floor that the file says nothing of.
const FLOOR_GREY: f64 = 24.0;

/// Largest picture side, px: a picture stays within a few megabytes.
const LARGEST_SIDE: u32 = 4096;

struct Check<'a> {
    source: &'a Source,
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
}

impl CellText {
    fn check(&self, check: &mut Check<'_>) -> Cell {
        let floor_grey = self.room.floor_grey.as_ref().map_or(FLOOR_GREY, |grey| {
            check.number(grey, "the floor's grey", "grey levels", GREY)
        });
        let lamp = self.lamp.check(check);
        if floor_grey + lamp.brightness > 255.0 {
            check.findings.push(
                Finding::warning(
                    "sim::cell::saturates",
                    format!(
                        "a lamp of {} on a floor of {floor_grey} grey levels saturates the sensor",
                        lamp.brightness
                    ),
                )
                .at(check.source.at(self.lamp.brightness.span()))
                .help("keep their sum below 255, or centres of spots will be worse"),
            );
        }
        Cell {
            start: self.arm.start(check),
            friction: self.arm.friction,
            lamp,
            floor_grey,
            room: self
                .furniture
                .iter()
                .map(|item| item.check(check))
                .collect(),
            cameras: self.cameras(check),
        }
    }

    fn cameras(&self, check: &mut Check<'_>) -> Vec<CameraSpec> {
        let mut names: Vec<&str> = Vec::new();
        for camera in &self.camera {
            let name = camera.name.get_ref().as_str();
            if name.is_empty() || names.contains(&name) {
                check.refuse(
                    camera.name.span(),
                    format!("a camera cannot be called `{name}`: the name is empty or taken"),
                    "give every camera its own name",
                );
            }
            names.push(name);
        }
        self.camera
            .iter()
            .map(|camera| camera.check(check))
            .collect()
    }
}

const GREY: [f64; 2] = [0.0, 255.0];

impl ArmText {
    fn start(&self, check: &mut Check<'_>) -> [f64; JOINTS] {
        let links = puma560::links();
        for (index, (angle, link)) in self.start_deg.get_ref().iter().zip(&links).enumerate() {
            let [low, high] = link.limits.map(f64::to_degrees);
            // The limits come from degrees by way of radians: a start at the limit is in.
            if !(low - 1e-9..=high + 1e-9).contains(angle) {
                check.refuse(
                    self.start_deg.span(),
                    format!("joint {} cannot start at {angle} degrees", index + 1),
                    &format!("its limits are {low:.0} to {high:.0} degrees"),
                );
            }
        }
        let mut start = self.start_deg.get_ref().map(f64::to_radians);
        for (angle, link) in start.iter_mut().zip(&links) {
            *angle = angle.max(link.limits[0]).min(link.limits[1]);
        }
        start
    }
}

impl LampText {
    fn check(&self, check: &mut Check<'_>) -> LampSpec {
        LampSpec {
            offset: check.point(&self.offset, "the lamp's offset", 0.5).into(),
            radius: check.number(&self.radius, "the lamp's radius", "m", [1e-3, 0.1]),
            brightness: check.number(
                &self.brightness,
                "the lamp's brightness",
                "grey levels",
                GREY,
            ),
            on: self.on,
        }
    }
}

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
        .help("see `configs/cell.toml` for every key");
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

#[cfg(test)]
mod tests;
