//! The cell file: the arms and what is false about their models, lamps, cameras, objects, what stands in the room.
//!
//! Every mistake in the file is a finding with its place. Units are in the reference below and in
//! `configs/cell.toml`: m, kg, px, grey levels; angles in degrees, as in the arms' data sheets.

mod overlap;
mod text;

use std::{path::Path, time::Duration};

use ctos_config::diagnostic::{Finding, Findings, Source};
use mcs_model::{Body, FrameId, Model};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use vss_tools::laser::Scanner;

use crate::{
    camera::truth::CameraTruth,
    scene::SceneState,
    shapes::{Shape, Solid},
    wrist::Electronics,
};

/// How the file of a model is read that the cell names, relative to the cell's file.
pub type ReadModel<'a> = &'a dyn Fn(&str) -> Result<Source, Finding>;

/// A checked cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// The arms, in the file's order, as are all lists here.
    pub arms: Vec<ArmSpec>,
    /// The lamps.
    pub lamps: Vec<LampSpec>,
    /// Grey of the floor when lit from straight above.
    pub floor_grey: f64,
    /// What stands in the room, world frame.
    pub room: Vec<Shape>,
    /// What is painted on it, world frame: it can be seen and not be touched.
    pub marks: Vec<Shape>,
    /// What can be moved.
    pub objects: Vec<ObjectSpec>,
    /// The cameras.
    pub cameras: Vec<CameraSpec>,
    /// The laser scanners.
    pub lasers: Vec<LaserSpec>,
    /// The force-torque sensors.
    pub sensors: Vec<SensorSpec>,
    /// The furniture that feels.
    pub plates: Vec<PlateSpec>,
    /// What can be seen and may move: links of the arms, then objects.
    pub bodies: Vec<BodySpec>,
}

/// An arm as it is in truth.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmSpec {
    /// Its name.
    pub name: String,
    /// Its joints and bodies, on its base in the world.
    pub model: Model,
    /// The same as its file says, nothing of it false.
    pub nominal: Model,
    /// Pose of its base frame, `world_T_base`, m.
    pub base: Isometry3<f64>,
    /// Joint positions at the start, rad or m.
    pub start: Vec<f64>,
    /// Whether the joints have the friction of the model's motors.
    pub friction: bool,
    /// Coefficient of friction of its links against what has the same.
    pub surface: f64,
    /// Where the frame of its tip stands in that of the model, m.
    pub tip_offset: Vector3<f64>,
    /// Its outer form, each part in the frame that carries it.
    pub shapes: Vec<(FrameId, Shape)>,
    /// What is soft around it. It is not drawn.
    pub pads: Vec<PadSpec>,
}

/// A soft form around a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PadSpec {
    /// The frame that carries it.
    pub frame: FrameId,
    /// Its outer form, in that frame.
    pub solid: Solid,
    /// Its spring, N/m.
    pub stiffness: f64,
    /// Its damper, N s/m.
    pub damping: f64,
}

/// A piece of furniture that feels with what arms press it. The weight of what rests on it is taken off.
#[derive(Debug, Clone, PartialEq)]
pub struct PlateSpec {
    /// Its name.
    pub name: String,
    /// Which piece, by index in [`Cell::room`].
    pub piece: usize,
    /// A larger force cuts the power of all arms, N; infinite for none.
    pub cuts_n: f64,
}

impl ArmSpec {
    /// Where a frame is in truth that the model puts at `pose` in the world.
    #[must_use]
    pub fn truly(&self, frame: FrameId, pose: Isometry3<f64>) -> Isometry3<f64> {
        if self.model.frames().first() == Some(self.model.at(frame)) {
            self.base
        } else if frame == self.model.tip() {
            pose * Translation3::from(self.tip_offset)
        } else {
            pose
        }
    }
}

/// A frame of an arm that carries something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mount {
    /// The arm, by index in [`Cell::arms`].
    pub arm: usize,
    /// Which of its frames.
    pub frame: FrameId,
}

/// Whose pose a body has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// That of an arm's frame.
    Link(Mount),
    /// That of an object, by index in [`Cell::objects`].
    Object(usize),
}

/// A body that can be seen.
#[derive(Debug, Clone, PartialEq)]
pub struct BodySpec {
    /// `ARM.FRAME`, or the object's name.
    pub name: String,
    /// Whose pose it has.
    pub origin: Origin,
    /// Whether it never moves.
    pub still: bool,
    /// Its form, in its frame.
    pub shapes: Vec<Shape>,
}

impl BodySpec {
    /// Whether it is a link that feels what touches it.
    #[must_use]
    pub fn is_touchable(&self) -> bool {
        matches!(self.origin, Origin::Link(_)) && !self.still && !self.shapes.is_empty()
    }
}

/// A lamp.
#[derive(Debug, Clone, PartialEq)]
pub struct LampSpec {
    /// Its name.
    pub name: String,
    /// What carries it; `None` in the room.
    pub mount: Option<Mount>,
    /// Its centre in the frame that carries it, m.
    pub offset: Point3<f64>,
    /// Its radius, m.
    pub radius: f64,
    /// Grey levels of its surface, 0 for a lamp that is broken; the peak of a blurred spot is lower.
    pub brightness: f64,
    /// Whether it shines at the start.
    pub on: bool,
}

/// A rigid body that moves as forces want, or that somebody holds.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectSpec {
    /// Its name.
    pub name: String,
    /// Form and grey, in its own frame, whose origin is its centre of mass.
    pub shape: Shape,
    /// What is painted on it, in its own frame: it can be seen and not be touched.
    pub marks: Vec<Shape>,
    /// Mass, kg, spread evenly.
    pub mass: f64,
    /// Coefficient of friction against what has the same.
    pub friction: f64,
    /// Whether it stays where it is put, whatever presses on it.
    pub held: bool,
    /// Its pose at the start, `world_T_object`, m.
    pub start: Isometry3<f64>,
}

/// A laser scanner with two mirrors, or a pointer that an arm carries.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserSpec {
    /// Its name.
    pub name: String,
    /// What carries a pointer, whose frame is then given in that of the link; `None` in the room.
    pub mount: Option<Mount>,
    /// Its exact geometry.
    pub scanner: Scanner,
    /// Radius of the spot that it makes, m.
    pub radius: f64,
    /// Grey levels of the spot; the peak of a blurred one is lower.
    pub brightness: f64,
}

/// A force-torque sensor. On it hang its load, every form that its frame carries, and all that was set on that frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorSpec {
    /// Its name.
    pub name: String,
    /// Where it is.
    pub mount: Mount,
    /// The frames of the arm that it feels, and what is fixed to each in truth, in the frame's axes.
    pub hanging: Vec<(FrameId, Body)>,
    /// What it knows of that, and takes off.
    pub known: Vec<(FrameId, Body)>,
    /// What it makes of what acts on it.
    pub electronics: Electronics,
}

impl SensorSpec {
    /// Whether it feels what touches that frame.
    #[must_use]
    pub fn feels(&self, mount: Mount) -> bool {
        let mut frames = self.hanging.iter();
        mount.arm == self.mount.arm && frames.any(|(frame, _)| *frame == mount.frame)
    }
}

/// A camera with its sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSpec {
    /// Its exact geometry; of one that is carried, with everything at the start.
    pub truth: CameraTruth,
    /// The body that carries it, by index in [`Cell::bodies`], and that body's frame in the camera's, `camera_T_body`.
    pub mount: Option<(usize, Isometry3<f64>)>,
    /// Standard deviation of a pixel's value in the dark, grey levels.
    pub read_noise: f64,
    /// Variance that grows with the light, grey levels; 0 for none.
    pub shot_noise: f64,
    /// Standard deviation of the point spread (lens and pixel area), px.
    pub blur: f64,
    /// Whether its pictures are in colour.
    pub colour: bool,
    /// How long the shutter is open. What moves meanwhile is seen as it was in the middle.
    pub exposure: Duration,
}

impl Cell {
    /// The links that feel what touches them.
    pub fn touchable(&self) -> impl Iterator<Item = &BodySpec> {
        self.bodies.iter().filter(|body| body.is_touchable())
    }

    /// Reads and checks a cell file. Files of models are taken relative to it.
    ///
    /// # Errors
    /// Everything that is wrong in it, each with its place.
    pub fn read(path: &Path) -> Result<Self, Findings> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let model = |name: &str| Source::read(&folder.join(name));
        Self::parse_with(&Source::read(path)?, &model)
    }

    /// Checks the text of a cell file whose models are all built in.
    ///
    /// # Errors
    /// Everything that is wrong in it, each with its place.
    pub fn parse(source: &Source) -> Result<Self, Findings> {
        Self::parse_with(source, &|name| Source::read(Path::new(name)))
    }

    /// Checks the text of a cell file; `model` reads the files of models that it names.
    ///
    /// # Errors
    /// Everything that is wrong in it, each with its place.
    pub fn parse_with(source: &Source, model: ReadModel<'_>) -> Result<Self, Findings> {
        text::parse(source, model)
    }

    /// The name of a sensor that can be a slot: the force-torque sensors, then the furniture that feels.
    #[must_use]
    pub fn sensor(&self, index: usize) -> Option<&str> {
        let wrists = self.sensors.iter().map(|sensor| &sensor.name);
        let plates = self.plates.iter().map(|plate| &plate.name);
        wrists.chain(plates).nth(index).map(String::as_str)
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

    /// The index of the arm called `name`; the only one, when none is named.
    ///
    /// # Errors
    /// A finding without place that lists the arms there are.
    pub fn arm(&self, name: Option<&str>) -> Result<usize, Finding> {
        let unknown = |message: String| Finding::error("sim::cell::unknown_arm", message);
        let names = || self.arms.iter().map(|arm| arm.name.as_str());
        match name {
            Some(name) => names().position(|known| known == name).ok_or_else(|| {
                unknown(format!("the cell has no arm `{name}`")).suggest(name, names())
            }),
            None if self.arms.len() == 1 => Ok(0),
            None => Err(unknown(format!(
                "the cell has {} arms, and none is named",
                self.arms.len()
            ))
            .help("say which one: `arm = \"NAME\"`")),
        }
    }

    /// The scene with the arms at rest at `joints` (rad or m, for each arm), objects and lamps as at the start.
    #[must_use]
    pub fn scene(&self, joints: &[&[f64]]) -> SceneState {
        SceneState::of(self, |origin| match origin {
            Origin::Link(Mount { arm, frame }) => match (self.arms.get(*arm), joints.get(*arm)) {
                (Some(arm), Some(joints)) => {
                    let mut data = arm.model.data();
                    let pose = arm.model.placement(&mut data, joints, *frame);
                    arm.truly(*frame, pose.isometry())
                }
                _ => Isometry3::identity(),
            },
            Origin::Object(index) => self
                .objects
                .get(*index)
                .map_or_else(Isometry3::identity, |object| object.start),
        })
    }

    /// The scene with everything as at the start.
    #[must_use]
    pub fn start(&self) -> SceneState {
        let joints: Vec<&[f64]> = self.arms.iter().map(|arm| arm.start.as_slice()).collect();
        self.scene(&joints)
    }
}

#[cfg(test)]
mod tests;
