//! What there is to see of a running app, as one stream: solids and where they are, pictures, how far a job is.
//!
//! A task that has something to show answers [`FollowScene`]: the [`View`] and everything that is known once, then what has
//! changed. A follower asks again when it has taken in the last [`Batch`]. So a slow viewer is not pressed, a stuck one costs
//! nothing, and nobody looks at the world while nobody follows. The [`Stage`] does that for a task, at most every [`PERIOD`].
//!
//! This crate knows no robot, no camera and no screen: motion, vision and coordinators show what they know, and displays
//! draw it.

pub mod follow;
pub mod known;
pub mod picture;
mod stage;
pub mod track;

use ctos::Blob;
use serde::{Deserialize, Serialize};

pub use stage::{Seen, Source, Stage};

/// The page of `docs` whose example is run as a test.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/bridges.md")]
    mod bridges {}
}

/// The least time between two looks at what a task shows: about 16 a second.
pub const PERIOD: std::time::Duration = std::time::Duration::from_millis(60);

/// The longest that a task waits for something to change before it answers, ms.
pub const MOST_PATIENCE_MS: u32 = 5_000;

/// The most that may follow one task at a time.
pub const MOST_FOLLOWERS: usize = 64;

ctos::command! {
    /// Shows what has changed of a scene since a moment, and waits until there is something
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct FollowScene {
        /// The moment; none: everything.
        pub after: Option<Mark>,
        /// How long to wait for something to change, ms; at most [`MOST_PATIENCE_MS`].
        pub patience_ms: u32,
    } => Batch, 0x04a0, "follow_scene"
}

/// A moment of what one task shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mark {
    /// Which run: when its task began, ns since the start of the app. A restarted task begins another.
    pub run: u64,
    /// Counts the changes.
    pub seq: u64,
}

/// What has changed since a [`Mark`]. Of a part that moved twice, only the last pose is told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Batch {
    /// What to ask from next.
    pub mark: Mark,
    /// When that was, ns since the start of the app.
    pub at_ns: u64,
    /// The parts, for those that are new, or when there are others; `moved` then has each of them.
    pub view: Option<View>,
    /// Where parts are now.
    pub moved: Vec<Moved>,
    /// What there is to say now, if that has changed.
    pub said: Option<Said>,
    /// The latest picture of each camera that has a new one, or new marks on it.
    pub pictures: Vec<Picture>,
}

impl Batch {
    /// Whether it tells something.
    #[must_use]
    pub fn is_news(&self) -> bool {
        let Self { view, said, .. } = self;
        let quiet = view.is_none() && said.is_none();
        !(quiet && self.moved.is_empty() && self.pictures.is_empty())
    }
}

/// How something is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layer {
    /// It was measured, or computed from what was measured.
    #[default]
    Measured,
    /// A simulator says so. No robot knows it.
    Truth,
}

/// What does not change while things move.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct View {
    /// How it is known.
    pub layer: Layer,
    /// The parts; a [`Moved`] names them by index.
    pub parts: Vec<Part>,
}

/// A part of the scene.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// The part that carries it. Poses are in the frame of the scene all the same.
    pub parent: Option<String>,
    /// What it is, in a word or two: `link`, `tool`.
    pub kind: String,
    /// Its form, in its own frame. Without solids it is told and not drawn.
    pub solids: Vec<Solid>,
    /// Its colour: red, green and blue.
    pub colour: [u8; 3],
    /// What is measured at it; NaN is told where nothing is. A link has the position of its joint first, under the joint's
    /// name, then `error`, `velocity` and `effort`.
    pub numbers: Vec<Number>,
}

/// What a number at a part is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Number {
    /// Its name.
    pub name: String,
    /// Its unit: `rad`, `m`, `N m`.
    pub unit: String,
    /// A smaller change is not told.
    pub resolution: f64,
}

/// A solid in the frame of its part, m.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Solid {
    /// All points within `radius` of the segment from `a` to `b`; a ball when they are equal.
    Capsule {
        /// One end of the axis.
        a: [f64; 3],
        /// The other end.
        b: [f64; 3],
        /// Radius, m.
        radius: f64,
    },
    /// A box.
    Block {
        /// Where its centre and its edges are.
        pose: Pose,
        /// Half its edge lengths.
        half: [f64; 3],
    },
    /// A cylinder about the z axis at `pose`.
    Cylinder {
        /// Where its centre and its axis are.
        pose: Pose,
        /// Half its height, m.
        half: f64,
        /// Radius, m.
        radius: f64,
    },
    /// A convex body by the triangles of its surface.
    Hull {
        /// Where the frame of its corners is.
        pose: Pose,
        /// The corners, m.
        corners: Vec<[f64; 3]>,
        /// The triangles by the numbers of their corners, counterclockwise as seen from outside.
        triangles: Vec<[u32; 3]>,
    },
    /// The axes of the frame, drawn so long, m.
    Axes(f64),
    /// An arrow from the origin, along three of the part's numbers: a force, or a way. Zeros and what is not known draw nothing.
    Vector {
        /// The index of the first of them, in the part's axes.
        first: u32,
        /// How long one of their units is drawn, m.
        scale: f64,
        /// Whether it is an axis to turn about, such as a moment: its arrow has two heads.
        turns: bool,
    },
    /// What a camera at the origin sees up to `depth` along z: the four corners there, in its frame, in turn.
    Frustum {
        /// The corners, m.
        corners: [[f64; 3]; 4],
        /// The camera whose picture fills it.
        camera: String,
    },
}

/// Where a frame is in the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Its origin, m.
    pub at: [f64; 3],
    /// Its turn, as a unit quaternion: x, y, z, w.
    pub turn: [f64; 4],
}

impl Default for Pose {
    fn default() -> Self {
        Self {
            at: [0.0; 3],
            turn: [0.0, 0.0, 0.0, 1.0],
        }
    }
}

/// Where a part is now, and what is measured at it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Moved {
    /// Its index among the parts of the view.
    pub part: u32,
    /// Where it is.
    pub pose: Pose,
    /// Its numbers, in the order of [`Part::numbers`].
    pub numbers: Vec<f64>,
}

impl Moved {
    /// The vector whose first number has the index `first`; none where a number is not known, or where all are zero.
    #[must_use]
    pub fn vector(&self, first: u32) -> Option<[f64; 3]> {
        let first = usize::try_from(first).ok()?;
        let numbers = self.numbers.get(first..first.checked_add(3)?)?;
        let vector: [f64; 3] = numbers.try_into().ok()?;
        let length = vector.iter().map(|part| part * part).sum::<f64>();
        (length.is_finite() && length > 0.0).then_some(vector)
    }
}

/// What a task says about what it shows.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Said {
    /// How it is, in words; empty when there is nothing to say.
    pub words: String,
    /// Whether that is wrong.
    pub fault: bool,
    /// How far a job is.
    pub job: Option<Job>,
}

/// How far a job is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Job {
    /// Steps that are done.
    pub done: u64,
    /// All steps.
    pub total: u64,
    /// What a step is: `position`.
    pub step: String,
    /// What else there is to say of it.
    pub words: String,
}

/// A grey picture that a camera took, made small, with what was found in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// The camera's name.
    pub camera: String,
    /// The camera's own number of it.
    pub number: u64,
    /// The middle of its exposure, ns since the start of the app.
    pub at_ns: u64,
    /// Its size as it was taken, px. Marks are in these pixels.
    pub taken: [u32; 2],
    /// Its size here, px.
    pub size: [u32; 2],
    /// A byte for each pixel, first row first.
    pub pixels: Blob,
    /// What was found.
    pub marks: Vec<Found>,
    /// What is drawn over it.
    pub drawing: Drawing,
}

/// What is drawn over a picture: what somebody has read in it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Drawing {
    /// The outlines, the first one below.
    pub outlines: Vec<Outline>,
    /// What was read, in a few words.
    pub said: String,
}

impl Drawing {
    /// Whether nothing is drawn and nothing is said.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.outlines.is_empty() && self.said.is_empty()
    }
}

/// A closed line over a picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outline {
    /// Its corners in turn, column and row as the camera took the picture, px.
    pub corners: Vec<[f64; 2]>,
    /// Red, green and blue.
    pub colour: [u8; 3],
    /// How much of the picture it hides: 1 all of it, 0 nothing.
    pub strength: f64,
    /// How wide it is, px of the picture as it was taken.
    pub width: f64,
    /// What stands in its middle.
    pub text: String,
}

/// Something found in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Column and row as the camera took it, px.
    pub at: [f64; 2],
    /// Predicted standard deviation of both, px; none when nobody says.
    pub sd: Option<[f64; 2]>,
}
