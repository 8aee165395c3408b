//! What a camera needs to know of the world at one moment, and how it gets from the servo to the
//! cameras without holding the servo up.

use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use triple_buffer::{Input, Output, triple_buffer};

use crate::puma560::{self, JOINTS};

/// The world at one moment, as far as it can be seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SceneState {
    /// Simulated time since the world began.
    pub stamp: Duration,
    /// Poses of the base and of the six link frames, `world_T_link`, m.
    pub links: [Isometry3<f64>; JOINTS + 1],
    /// Centre of the wrist lamp in the world, m.
    pub lamp: Point3<f64>,
    /// Whether the lamp shines.
    pub lamp_on: bool,
}

impl SceneState {
    /// The scene with the arm at rest at `joints` (rad) and the lamp at `lamp_offset` (m, frame 6).
    #[must_use]
    pub fn at(joints: &[f64; JOINTS], lamp_offset: &Point3<f64>, lamp_on: bool) -> Self {
        let links = puma560::link_poses(joints);
        let [.., wrist] = &links;
        Self {
            stamp: Duration::ZERO,
            lamp: wrist * lamp_offset,
            links,
            lamp_on,
        }
    }
}

/// The reading side of a world's scene: shared by all tasks of the chassis that holds the world.
#[derive(Debug)]
pub struct SceneReader {
    latest: Mutex<Output<SceneState>>,
    lamp_on: AtomicBool,
}

impl SceneReader {
    /// The latest scene. The lamp's switch counts at once, also while the arm's servo stands still.
    #[must_use]
    pub fn latest(&self) -> SceneState {
        // Readers share this lock among themselves; the servo never takes it. A reader that
        // panicked cannot have left the buffer half read, so a poisoned lock is as good as new.
        let mut output = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        SceneState {
            lamp_on: self.lamp_on.load(Ordering::Acquire),
            ..*output.read()
        }
    }

    /// Switches the lamp.
    pub fn set_lamp(&self, on: bool) {
        self.lamp_on.store(on, Ordering::Release);
    }
}

/// The writing side: wait-free, no allocation.
pub type SceneWriter = Input<SceneState>;

/// A channel from one world to any number of readers, which starts with `first`.
#[must_use]
pub fn channel(first: SceneState) -> (SceneWriter, SceneReader) {
    let (input, output) = triple_buffer(&first);
    let reader = SceneReader {
        latest: Mutex::new(output),
        lamp_on: AtomicBool::new(first.lamp_on),
    };
    (input, reader)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_sees_the_last_scene_written_and_the_lamp_as_switched() {
        let offset = Point3::new(0.0, 0.0, 0.1);
        let first = SceneState::at(&[0.0; 6], &offset, true);
        let (mut writer, reader) = channel(first);
        assert_eq!(reader.latest(), first);
        let second = SceneState::at(&[0.1; 6], &offset, true);
        writer.write(first);
        writer.write(second);
        assert_eq!(reader.latest(), second);
        reader.set_lamp(false);
        assert!(!reader.latest().lamp_on);
        assert_eq!(reader.latest().lamp, second.lamp);
    }
}
