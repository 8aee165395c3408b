//! Scenes through a snapshot buffer: the world leaves one after every tick, and cameras in any process of the host read
//! the latest. Neither waits for the other (SORMA technical report, section 1.7.2). Knows no task.
//!
//! The opaque bytes of a record are the whole [`SceneState`]. Its floats are the poses of the bodies, so that programs that
//! know nothing of scenes can watch them too.

use ctos::time::Clock;
use sorma_snapshot::{Layout, Place, Reader, Snapshot, SnapshotError, Writer, WriterState};

use crate::scene::{LINE, SceneState};

/// How many scenes a buffer keeps.
const SLOTS: usize = 64;

/// The numbers of a scene grow by so many bytes at most: its stamp and its tick. A fault of a camera takes one more.
const GROWTH: usize = 32;

/// Bytes of a beam: eight numbers.
const BEAM: usize = 64;

/// What a float of each body is.
const POSE: [&str; 7] = ["x m", "y m", "z m", "qx", "qy", "qz", "qw"];

/// Why a scene cannot be left or read.
#[derive(Debug, thiserror::Error)]
pub enum ScenesError {
    /// Of the buffer.
    #[error(transparent)]
    Buffer(#[from] SnapshotError),
    /// What is in it is no scene of this program's.
    #[error("the records of snapshot buffer `{buffer}` are no scenes: {reason}")]
    Foreign {
        /// The buffer's name.
        buffer: String,
        /// What is wrong with them.
        reason: String,
    },
    /// The process of the world has ended: what is there is old.
    #[error("the process that left scenes in snapshot buffer `{buffer}` has ended")]
    Ended {
        /// The buffer's name.
        buffer: String,
    },
    /// There is none yet.
    #[error(
        "snapshot buffer `{buffer}` has no scene yet; the world leaves the first one at its start"
    )]
    None {
        /// The buffer's name.
        buffer: String,
    },
}

/// Leaves scenes in a buffer.
#[derive(Debug)]
pub struct SceneWriter {
    buffer: String,
    writer: Writer,
    floats: Vec<f64>,
    bytes: Vec<u8>,
}

impl SceneWriter {
    /// The buffer `buffer` of the app, with `scene` as its first record; it has room for the lines of that many `lasers`.
    ///
    /// # Errors
    /// Another process writes it, the name cannot be, or the system refuses.
    pub fn create(
        (app, buffer): (&str, &str),
        scene: &SceneState,
        lasers: usize,
        clock: &Clock,
    ) -> Result<Self, ScenesError> {
        let bytes = scene.encode(Vec::new());
        let bytes = bytes.map_err(|error| foreign(buffer, error))?;
        let layout = Layout::new(SLOTS, POSE.len() * scene.bodies.len());
        let growth = GROWTH + scene.camera_faults.len() + lasers * LINE as usize * BEAM;
        let layout = layout.bytes(bytes.len() + growth);
        let layout = layout.described(description(scene));
        let mut own = Self {
            buffer: buffer.to_owned(),
            writer: Writer::create(&Place::of_app(app)?, buffer, layout, clock)?,
            floats: Vec::new(),
            bytes,
        };
        own.write(scene)?;
        Ok(own)
    }

    /// Leaves a scene with the bodies of the first one.
    ///
    /// # Errors
    /// It has other bodies, or the buffer is gone.
    pub fn write(&mut self, scene: &SceneState) -> Result<(), ScenesError> {
        self.bytes.clear();
        let bytes = std::mem::take(&mut self.bytes);
        let written = scene.encode(bytes);
        self.bytes = written.map_err(|error| foreign(&self.buffer, error))?;
        self.floats.clear();
        for body in &scene.bodies {
            let (place, turn) = (&body.pose.translation, &body.pose.rotation);
            self.floats.extend([place.x, place.y, place.z]);
            self.floats.extend([turn.i, turn.j, turn.k, turn.w]);
        }
        self.writer.write(&self.floats, &self.bytes)?;
        Ok(())
    }
}

/// A line for each float.
fn description(scene: &SceneState) -> String {
    let mut text = String::new();
    for body in &scene.bodies {
        for what in POSE {
            text += &format!("{}.{what}\n", body.name);
        }
    }
    text
}

fn foreign(buffer: &str, reason: impl ToString) -> ScenesError {
    ScenesError::Foreign {
        buffer: buffer.to_owned(),
        reason: reason.to_string(),
    }
}

/// Reads the latest scene of a buffer, also of one that is made anew meanwhile.
#[derive(Debug)]
pub struct SceneReader {
    app: String,
    buffer: String,
    reader: Option<Reader>,
    record: Snapshot,
}

impl SceneReader {
    /// A reader of the buffer `buffer` of an app, which need not be there yet.
    #[must_use]
    pub fn new(app: &str, buffer: &str) -> Self {
        Self {
            app: app.to_owned(),
            buffer: buffer.to_owned(),
            reader: None,
            record: Snapshot::default(),
        }
    }

    /// The latest scene.
    ///
    /// # Errors
    /// There is none, nobody leaves one any more, or what is there is none.
    pub fn latest(&mut self) -> Result<SceneState, ScenesError> {
        let written = |reader: &Reader| matches!(reader.writer(), WriterState::Writing(_));
        let reader = match self.reader.take().filter(written) {
            Some(reader) => reader,
            None => Reader::open(&Place::of_app(&self.app)?, &self.buffer)?,
        };
        let buffer = || self.buffer.clone();
        if !written(&reader) {
            return Err(ScenesError::Ended { buffer: buffer() });
        }
        if !self.reader.insert(reader).latest(&mut self.record)? {
            return Err(ScenesError::None { buffer: buffer() });
        }
        let scene = SceneState::decode(&self.record.opaque);
        scene.map_err(|error| foreign(&self.buffer, error))
    }
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;

    use super::*;
    use crate::cell::Cell;

    fn scene() -> SceneState {
        let text = include_str!("../../configs/cell.toml");
        Cell::parse(&Source::new("cell.toml", text))
            .unwrap()
            .start()
    }

    /// An app that no other test has.
    fn app(test: &str) -> String {
        format!("sim-scenes-{test}-{}", std::process::id())
    }

    #[test]
    fn a_scene_comes_out_of_the_buffer_as_it_went_in_with_its_stamp() {
        let (app, clock, mut scene) = (app("whole"), Clock::real(), scene());
        let mut reader = SceneReader::new(&app, "scenes");
        assert!(reader.latest().is_err());
        let mut writer = SceneWriter::create((&app, "scenes"), &scene, 0, &clock).unwrap();
        assert_eq!(reader.latest().unwrap(), scene);
        for tick in [1, 1000, u64::MAX] {
            scene.tick = tick;
            scene.stamp = std::time::Duration::from_nanos(tick / 3);
            scene.bodies[1].pose.translation.x = 0.25;
            scene.lamps[0].on ^= true;
            writer.write(&scene).unwrap();
            assert_eq!(reader.latest().unwrap(), scene);
        }
        // Any program can tell what the floats are.
        let other = Reader::open(&Place::of_app(&app).unwrap(), "scenes").unwrap();
        let expected = format!("{}.x", scene.bodies[1].name);
        assert_eq!(other.layout().name_of(7), Some(expected.as_str()));
        assert_eq!(reader.record.floats[7], 0.25);
    }

    #[test]
    fn a_reader_goes_on_with_the_buffer_of_the_next_world() {
        let (app, clock, mut scene) = (app("next"), Clock::real(), scene());
        let writer = SceneWriter::create((&app, "scenes"), &scene, 0, &clock).unwrap();
        let mut reader = SceneReader::new(&app, "scenes");
        assert_eq!(reader.latest().unwrap().tick, 0);
        drop(writer);
        assert!(reader.latest().is_err(), "nobody leaves scenes any more");
        scene.bodies.pop();
        scene.tick = 7;
        let _writer = SceneWriter::create((&app, "scenes"), &scene, 0, &clock).unwrap();
        assert_eq!(reader.latest().unwrap(), scene);
    }

    #[test]
    fn what_is_no_scene_is_told_by_the_buffers_name() {
        let (app, clock) = (app("foreign"), Clock::real());
        let layout = Layout::new(2, 1).bytes(8);
        let place = Place::of_app(&app).unwrap();
        let mut writer = Writer::create(&place, "scenes", layout, &clock).unwrap();
        let mut reader = SceneReader::new(&app, "scenes");
        let none = reader.latest().unwrap_err().to_string();
        assert!(none.contains("`scenes` has no scene yet"), "{none}");
        writer.write(&[1.0], &[255; 8]).unwrap();
        let foreign = reader.latest().unwrap_err().to_string();
        assert!(
            foreign.contains("of snapshot buffer `scenes` are no scenes"),
            "{foreign}"
        );
    }
}
