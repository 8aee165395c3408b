//! Frames through a snapshot buffer: a Vision Module leaves each of its frames there, and any process of the host reads
//! them. The pixels are copied once into the buffer and once out of it, and neither side waits for the other (SORMA
//! technical report, section 1.7.2). Messages between chassis bring a frame without its pixels, which are then fetched from
//! its record. Knows no task.
//!
//! The opaque bytes of a record are the pixels. Its floats are [`FLOATS`]; the lines `camera NAME` and `link NAME` follow
//! them in the buffer's description.

use std::time::Duration;

use ctos::time::Clock;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use sorma_snapshot::{Layout, Place, Reader, Snapshot, SnapshotError, Writer, WriterState};

use super::{Carried, Frame, FrameError, Left, PixelFormat};

/// How many frames a buffer keeps: a frame can be fetched until so many later ones are there.
pub const SLOTS: usize = 8;

/// The floats of a record, by name and unit. The pose is that of the link, where there is one; else it is 0.
pub const FLOATS: [&str; 13] = [
    "number",
    "width px",
    "height px",
    "channels",
    "stamp ns",
    "exposure ns",
    "x m",
    "y m",
    "z m",
    "qx",
    "qy",
    "qz",
    "qw",
];

/// Why a frame cannot be left or read.
#[derive(Debug, thiserror::Error)]
pub enum BufferError {
    /// Of the buffer.
    #[error(transparent)]
    Buffer(#[from] SnapshotError),
    /// There is no frame, and why.
    #[error("snapshot buffer `{buffer}` has no frame: {reason}")]
    None {
        /// The buffer's name.
        buffer: String,
        /// Why.
        reason: &'static str,
    },
}

/// Leaves frames in a buffer.
#[derive(Debug)]
pub struct FrameWriter {
    app: String,
    buffer: String,
    clock: Clock,
    /// What the buffer is for: bytes of a picture and description.
    writer: Option<(usize, String, Writer)>,
}

impl FrameWriter {
    /// The buffer `buffer` of an app, which the first frame makes.
    #[must_use]
    pub fn new((app, buffer): (&str, &str), clock: &Clock) -> Self {
        Self {
            app: app.to_owned(),
            buffer: buffer.to_owned(),
            clock: clock.clone(),
            writer: None,
        }
    }

    /// Leaves a frame, and answers where. A larger picture than before, or another link, makes the buffer anew.
    ///
    /// # Errors
    /// Another process writes it, the name cannot be, or the system refuses.
    pub fn write(&mut self, frame: &Frame) -> Result<Left, BufferError> {
        let link = frame.carrier.as_ref().map_or("", |carrier| &carrier.link);
        let names = format!("camera {}\nlink {link}\n", frame.camera);
        let bytes = frame.pixels.len();
        let fits = |(most, known, _): &(usize, String, Writer)| *most >= bytes && *known == names;
        let (.., writer) = match &mut self.writer {
            Some(there) if fits(there) => there,
            there => {
                // The buffer has one writer at a time.
                *there = None;
                let layout = Layout::new(SLOTS, FLOATS.len()).bytes(bytes);
                let layout = layout.described(FLOATS.join("\n") + "\n" + &names);
                let place = Place::of_app(&self.app)?;
                let writer = Writer::create(&place, &self.buffer, layout, &self.clock)?;
                there.insert((bytes, names, writer))
            }
        };
        let mut floats = [0.0; FLOATS.len()];
        let (head, pose) = floats.split_at_mut(6);
        head.copy_from_slice(&[
            frame.number as f64,
            frame.width as f64,
            frame.height as f64,
            frame.format.bytes() as f64,
            frame.stamp.as_nanos() as f64,
            frame.exposure.as_nanos() as f64,
        ]);
        if let Some(Carried { world_t_link, .. }) = &frame.carrier {
            let (place, turn) = (&world_t_link.translation, &world_t_link.rotation);
            pose.copy_from_slice(&[place.x, place.y, place.z, turn.i, turn.j, turn.k, turn.w]);
        }
        let record = writer.write(&floats, &frame.pixels)?;
        Ok(Left {
            app: self.app.clone(),
            buffer: self.buffer.clone(),
            record,
        })
    }
}

/// Reads frames from a buffer, also from one that is made anew meanwhile.
#[derive(Debug)]
pub struct FrameReader {
    app: String,
    buffer: String,
    reader: Option<Reader>,
    record: Snapshot,
}

impl FrameReader {
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

    /// The latest frame.
    ///
    /// # Errors
    /// There is none, nobody leaves one any more, or what is there is none.
    pub fn latest(&mut self) -> Result<Frame, BufferError> {
        let written = |reader: &Reader| matches!(reader.writer(), WriterState::Writing(_));
        let reader = match self.reader.take().filter(written) {
            Some(reader) => reader,
            None => Reader::open(&Place::of_app(&self.app)?, &self.buffer)?,
        };
        if !written(&reader) {
            let reason = "the process that left frames there has ended";
            return Err(none(&self.buffer, reason));
        }
        let reader = self.reader.insert(reader);
        if !reader.latest(&mut self.record)? {
            return Err(none(&self.buffer, "nobody has left one yet"));
        }
        let description = reader.layout().description.as_str();
        taken(&self.buffer, description, &mut self.record)
    }
}

fn none(buffer: &str, reason: &'static str) -> BufferError {
    BufferError::None {
        buffer: buffer.to_owned(),
        reason,
    }
}

/// The frame of a record. The pixels move out of it: they are not copied again.
fn taken(buffer: &str, description: &str, record: &mut Snapshot) -> Result<Frame, BufferError> {
    let pixels = std::mem::take(&mut record.opaque);
    frame(description, &record.floats, pixels)
        .filter(Frame::is_whole)
        .ok_or_else(|| none(buffer, "the records are of another kind"))
}

/// The frame that was left there, whether or not its writer still lives.
fn fetch(left: &Left) -> Result<Frame, BufferError> {
    let mut reader = Reader::open(&Place::of_app(&left.app)?, &left.buffer)?;
    let mut record = Snapshot::default();
    reader.seek(left.record.saturating_sub(1));
    match reader.next(&mut record)? {
        Some(_) if record.count == left.record => {
            taken(&left.buffer, &reader.layout().description, &mut record)
        }
        _ => Err(none(&left.buffer, "the record was written over")),
    }
}

impl Frame {
    /// Whether its pixels stay where they were left, and are to be fetched before anything is computed.
    #[must_use]
    pub fn is_elsewhere(&self) -> bool {
        self.left.is_some() && self.pixels.is_empty()
    }

    /// The frame with its pixels, which are copied out of the buffer if they did not come along.
    ///
    /// # Errors
    /// [`FrameError::Gone`] when [`SLOTS`] later frames were left meanwhile, or the process that left them has ended.
    pub fn fetched(mut self) -> Result<Self, FrameError> {
        let Some(left) = self.left.take().filter(|_| self.pixels.is_empty()) else {
            return Ok(self);
        };
        let same = |there: &Self| there.number == self.number && there.stamp == self.stamp;
        let reason = match fetch(&left) {
            Ok(there) if same(&there) => {
                let (camera, bytes) = (&self.camera, there.pixels.len());
                tracing::debug!(camera, frame = self.number, bytes, "pixels fetched");
                let pixels = there.pixels;
                return Ok(Self { pixels, ..self });
            }
            Ok(there) => format!("frame {} is in their place", there.number),
            Err(error) => error.to_string(),
        };
        Err(FrameError::Gone {
            camera: self.camera,
            number: self.number,
            reason,
        })
    }
}

/// The frame that a record of a snapshot buffer is: its description, its numbers as [`FLOATS`] names them, and its pixels.
/// `None` where they are no frame's.
#[must_use]
pub fn frame(description: &str, floats: &[f64], pixels: Vec<u8>) -> Option<Frame> {
    let &[
        number,
        width,
        height,
        channels,
        stamp,
        exposure,
        x,
        y,
        z,
        qx,
        qy,
        qz,
        qw,
    ] = floats
    else {
        return None;
    };
    let name = |key: &str| {
        let mut lines = description.lines().skip(FLOATS.len());
        lines.find_map(|line| line.strip_prefix(key))
    };
    let (camera, link) = (name("camera ")?.to_owned(), name("link ")?);
    let turn = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-9);
    let carrier = turn.filter(|_| !link.is_empty()).map(|turn| Carried {
        link: link.to_owned(),
        world_t_link: Isometry3::from_parts(Translation3::new(x, y, z), turn),
    });
    let format = match channels {
        1.0 => PixelFormat::Grey8,
        3.0 => PixelFormat::Rgb8,
        _ => return None,
    };
    // A float becomes an integer with saturation; a size that is none does not fit the pixels.
    let time = |ns: f64| Duration::from_nanos(ns as u64);
    Some(Frame {
        camera,
        number: number as u64,
        format,
        stamp: time(stamp),
        exposure: time(exposure),
        carrier,
        ..Frame::grey8(width as usize, height as usize, pixels)
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn carried() -> Frame {
        Frame {
            camera: "wrist".into(),
            number: 7,
            stamp: Duration::new(3, 141_592_653),
            exposure: Duration::from_millis(8),
            carrier: Some(Carried {
                link: "puma.link6".into(),
                world_t_link: Isometry3::new(
                    Vector3::new(0.1, -0.2, 0.3),
                    Vector3::new(0.4, 0.5, -0.6),
                ),
            }),
            ..Frame::rgb8(3, 2, (0..18).collect::<Vec<u8>>())
        }
    }

    #[test]
    fn a_frame_comes_out_of_the_buffer_as_it_went_in() {
        let app = format!("vss-frames-{}", std::process::id());
        let mut reader = FrameReader::new(&app, "left");
        assert!(reader.latest().is_err());
        let mut writer = FrameWriter::new((&app, "left"), &Clock::real());
        let grey = Frame {
            camera: "left".into(),
            stamp: Duration::from_secs(5),
            ..Frame::grey8(2, 2, vec![1, 2, 3, 4])
        };
        for frame in [&grey, &carried(), &grey] {
            writer.write(frame).unwrap();
            let read = reader.latest().unwrap();
            let poses = [&read, frame].map(|frame| frame.carrier.as_ref().map(|c| c.world_t_link));
            if let [Some(read), Some(written)] = poses {
                assert!((read.inverse() * written).rotation.angle() < 1e-12);
            }
            let without = |frame: &Frame| Frame {
                carrier: None,
                ..frame.clone()
            };
            assert_eq!(without(&read), without(frame));
        }
        drop(writer);
        assert!(reader.latest().is_err(), "nobody leaves frames any more");
    }

    /// What another chassis gets: a message without the pixels, which are copied out of the buffer there.
    #[test]
    fn a_frame_that_was_left_crosses_without_its_pixels_and_is_fetched_whole() {
        let app = format!("vss-crossing-{}", std::process::id());
        let mut writer = FrameWriter::new((&app, "frames.left"), &Clock::real());
        let numbered = |number: u64| Frame {
            camera: "left".into(),
            number,
            stamp: Duration::from_millis(40 * number),
            ..Frame::grey8(500, 500, vec![number as u8; 250_000])
        };
        let mut sent = Vec::new();
        for number in 0..SLOTS as u64 + 2 {
            let mut frame = numbered(number);
            frame.left = Some(writer.write(&frame).unwrap());
            // Here it keeps its pixels, without a copy.
            let place = frame.pixels.as_ptr();
            assert_eq!(frame.clone().fetched().unwrap().pixels.as_ptr(), place);
            sent.push(postcard::to_allocvec(&frame).unwrap());
            assert!(sent[0].len() < 200, "{} bytes", sent[0].len());
        }
        let come: Vec<Frame> = sent
            .iter()
            .map(|bytes| postcard::from_bytes(bytes).unwrap())
            .collect();
        assert!(come.iter().all(Frame::is_elsewhere));
        let (gone, there) = come.split_at(2);
        for (frame, number) in there.iter().zip(2..) {
            assert_eq!(frame.clone().fetched().unwrap(), numbered(number));
        }
        for frame in gone {
            let why = frame.clone().fetched().unwrap_err().to_string();
            assert!(why.contains("camera `left` are gone"), "{why}");
        }
        drop(writer);
        assert!(matches!(
            there[0].clone().fetched(),
            Err(FrameError::Gone { number: 2, .. })
        ));
    }

    /// A copy needs room for the pixels. The way in has it in the buffer, and takes none besides; the way out takes it once.
    #[test]
    fn pixels_are_copied_once_into_the_buffer_and_once_out_of_it() {
        const PIXELS: u64 = 500 * 500;
        let app = format!("vss-copies-{}", std::process::id());
        let mut writer = FrameWriter::new((&app, "frames.left"), &Clock::real());
        let frame = Frame {
            camera: "left".into(),
            ..Frame::grey8(500, 500, vec![7; PIXELS as usize])
        };
        // The first one makes the buffer.
        writer.write(&frame).unwrap();
        let (mut left, mut sent, mut there) = (None, Vec::new(), None);
        let room = |work: &mut dyn FnMut()| allocation_counter::measure(work).bytes_total;
        let leaving = room(&mut || left = Some(writer.write(&frame).unwrap()));
        let frame = Frame { left, ..frame };
        let passing = room(&mut || drop(frame.clone().fetched().unwrap()));
        let sending = room(&mut || sent = postcard::to_allocvec(&frame).unwrap());
        let fetching = room(&mut || {
            let come: Frame = postcard::from_bytes(&sent).unwrap();
            there = Some(come.fetched().unwrap());
        });
        assert!(
            leaving + passing + sending < 10_000,
            "{leaving} {passing} {sending}"
        );
        assert!((PIXELS..PIXELS + 20_000).contains(&fetching), "{fetching}");
        assert_eq!(there.unwrap().pixels, frame.pixels);
    }

    #[test]
    fn what_is_no_frame_is_told_by_the_buffers_name() {
        let app = format!("vss-foreign-{}", std::process::id());
        let place = Place::of_app(&app).unwrap();
        let mut writer =
            Writer::create(&place, "left", Layout::new(2, 1).bytes(8), &Clock::real()).unwrap();
        let mut reader = FrameReader::new(&app, "left");
        let none = reader.latest().unwrap_err().to_string();
        assert!(none.contains("`left` has no frame: nobody"), "{none}");
        writer.write(&[1.0], &[255; 8]).unwrap();
        let foreign = reader.latest().unwrap_err().to_string();
        assert!(foreign.contains("of another kind"), "{foreign}");
    }
}
