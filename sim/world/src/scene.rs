//! What there is to see of the world at one moment. Plain data, so that it can be seen in another process than the
//! world's.

use std::time::Duration;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

pub use vss_tools::laser::LaserOrder;

use vss_tools::laser::Beam;

use crate::{
    cell::{Cell, LaserSpec, Origin},
    shapes::Shape,
};

/// The world at one moment, as far as it can be seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneState {
    /// Time of the app at which the world was so.
    pub stamp: Duration,
    /// Which of the world's ticks left it so.
    pub tick: u64,
    /// How light it is in the room: all greys of the cell times this.
    pub light: f64,
    /// The links of the arms that have a form or carry a camera, then the objects; in the order of [`Cell::bodies`].
    pub bodies: Vec<SceneBody>,
    /// The lamps, in the order of the cell's file.
    pub lamps: Vec<SceneLamp>,
    /// Beams of the laser scanners that shine, several for a line.
    pub beams: Vec<SceneBeam>,
    /// What is wrong with each camera of the cell's file, in its order.
    pub camera_faults: Vec<Option<CameraFault>>,
}

/// A beam of light in the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneBeam {
    /// The light.
    pub beam: Beam,
    /// Radius of the spot that it makes, m.
    pub radius: f64,
    /// Grey levels of the spot.
    pub brightness: f64,
}

/// The beams of a scanner that does what it is ordered to.
pub fn beams(order: LaserOrder, spec: &LaserSpec) -> impl Iterator<Item = SceneBeam> {
    let (from, to, count) = match order {
        LaserOrder::Off => ([0.0; 2], [0.0; 2], 0),
        LaserOrder::Spot(at) => (at, at, 1),
        LaserOrder::Line(from, to) => (from, to, LINE),
    };
    let share = if count > 1 { LINE_SHARE } else { 1.0 };
    (0..count).map(move |step| {
        let t = f64::from(step) / f64::from(count.max(2) - 1);
        let command = std::array::from_fn(|k| from[k] + t * (to[k] - from[k]));
        SceneBeam {
            beam: spec.scanner.beam(command),
            radius: spec.radius,
            brightness: spec.brightness * share,
        }
    })
}

/// Spots that a line is made of, and what each has of the brightness of a spot that stands.
pub const LINE: u32 = 160;
const LINE_SHARE: f64 = 0.6;

/// What a camera can be told to do wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum CameraFault {
    /// New frames have the pixels of the last one before.
    Freeze,
    /// The last frame before comes again and again.
    Repeat,
    /// Stamps are an hour ahead.
    Jump,
    /// Pictures have half of their rows.
    Shrink,
    /// Pictures are black.
    Black,
    /// A hand covers the lens.
    Cover,
}

/// A body in the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneBody {
    /// `ARM.LINK`, or the object's name.
    pub name: String,
    /// Pose of its frame, `world_T_body`, m.
    pub pose: Isometry3<f64>,
    /// Its form and grey, in its frame.
    pub shapes: Vec<Shape>,
}

/// A lamp in the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneLamp {
    /// Its name in the cell.
    pub name: String,
    /// Its centre in the world, m.
    pub centre: Point3<f64>,
    /// Radius, m.
    pub radius: f64,
    /// Grey levels of its surface.
    pub brightness: f64,
    /// Whether it shines.
    pub on: bool,
}

impl Default for SceneState {
    /// Nothing in a room as light as its cell has it.
    fn default() -> Self {
        Self {
            stamp: Duration::ZERO,
            tick: 0,
            light: 1.0,
            bodies: Vec::new(),
            lamps: Vec::new(),
            beams: Vec::new(),
            camera_faults: Vec::new(),
        }
    }
}

impl SceneState {
    /// Appends its bytes, in postcard.
    ///
    /// # Errors
    /// It cannot be encoded.
    pub fn encode(&self, bytes: Vec<u8>) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_extend(self, bytes)
    }

    /// What [`Self::encode`] made.
    ///
    /// # Errors
    /// It is none.
    pub fn decode(bytes: &[u8]) -> Result<Self, postcard::Error> {
        postcard::from_bytes(bytes)
    }

    /// The scene of `cell` with each body where `pose_of` says, and the lamps as at the start.
    #[must_use]
    pub fn of(cell: &Cell, mut pose_of: impl FnMut(&Origin) -> Isometry3<f64>) -> Self {
        let bodies = cell.bodies.iter().map(|body| SceneBody {
            name: body.name.clone(),
            pose: pose_of(&body.origin),
            shapes: body.shapes.clone(),
        });
        let bodies = bodies.collect();
        let lamps = cell.lamps.iter().map(|lamp| SceneLamp {
            name: lamp.name.clone(),
            centre: match &lamp.mount {
                Some(mount) => pose_of(&Origin::Link(*mount)) * lamp.offset,
                None => lamp.offset,
            },
            radius: lamp.radius,
            brightness: lamp.brightness,
            on: lamp.on,
        });
        Self {
            lamps: lamps.collect(),
            camera_faults: vec![None; cell.cameras.len()],
            bodies,
            ..Self::default()
        }
    }

    /// The body of that name.
    #[must_use]
    pub fn body(&self, name: &str) -> Option<&SceneBody> {
        self.bodies.iter().find(|body| body.name == name)
    }
}
