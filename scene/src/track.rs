//! What a follower knows of a scene and its pictures, as it goes to pages and into records (`/scene/TASK`,
//! `/picture/CAMERA`): poses as rows of rounded numbers, pictures as PNG.

use std::collections::VecDeque;

use base64::{Engine as _, prelude::BASE64_STANDARD as BASE64};
use serde::{Deserialize, Serialize};

use crate::{Batch, Drawing, Found, Moved, Picture, Said, View};

/// Index of a part, its origin (m), its turn as x, y, z, w, then its numbers. What is no number is none.
pub type Row = Vec<Option<f64>>;

/// What changed of a scene at a moment.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneStep {
    /// The moment, ns since the start of the app.
    pub at_ns: u64,
    /// The parts, when there are others from now on; each of them has a row then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<View>,
    /// The parts that moved.
    pub moved: Vec<Row>,
    /// What there is to say, if that has changed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub said: Option<Said>,
}

/// To 0.01 mm, or to 1e-5 of a turn or of another unit: more nobody sees.
fn rounded(value: f64) -> Option<f64> {
    value.is_finite().then(|| (value * 1e5).round() / 1e5)
}

fn row(moved: &Moved) -> Row {
    let index = std::iter::once(f64::from(moved.part));
    let pose = moved.pose.at.iter().chain(&moved.pose.turn).copied();
    let all = index.chain(pose).chain(moved.numbers.iter().copied());
    all.map(rounded).collect()
}

impl SceneStep {
    /// A step of a live stream.
    #[must_use]
    pub fn new(batch: &Batch) -> Self {
        Self {
            at_ns: batch.at_ns,
            view: batch.view.clone(),
            moved: batch.moved.iter().map(row).collect(),
            said: batch.said.clone(),
        }
    }

    fn is_nothing(&self) -> bool {
        self.view.is_none() && self.moved.is_empty() && self.said.is_none()
    }

    /// Follows another step: this is the whole scene then, as it is after it.
    fn apply(&mut self, step: &Self) {
        self.at_ns = step.at_ns;
        if step.view.is_some() {
            self.view.clone_from(&step.view);
            self.moved.clear();
        }
        for row in &step.moved {
            let same = |known: &&mut Row| known.first() == row.first();
            match self.moved.iter_mut().find(same) {
                Some(known) => known.clone_from(row),
                None => self.moved.push(row.clone()),
            }
        }
        if step.said.is_some() {
            self.said.clone_from(&step.said);
        }
    }
}

/// What one task shows, with a past of at most so many steps as are asked for.
#[derive(Debug, Default)]
pub struct SceneTrack {
    /// The whole before the past that is kept.
    base: SceneStep,
    past: VecDeque<SceneStep>,
    /// The whole as it is now.
    head: SceneStep,
    /// Why nothing is known of it now.
    pub gone: Option<String>,
}

impl SceneTrack {
    /// Takes a step in; as it is to be told, if there is something in it. A task that comes back as it was begins no new scene.
    pub fn take(&mut self, mut step: SceneStep, most: usize) -> Option<SceneStep> {
        if step.view.is_some() && step.view == self.head.view {
            step.view = None;
        }
        if step.said == self.head.said {
            step.said = None;
        }
        step.moved.retain(|row| {
            let same = |known: &&Row| known.first() == row.first();
            step.view.is_some() || self.head.moved.iter().find(same) != Some(row)
        });
        if step.is_nothing() {
            return None;
        }
        self.head.apply(&step);
        self.past.push_back(step.clone());
        while self.past.len() > most {
            if let Some(oldest) = self.past.pop_front() {
                self.base.apply(&oldest);
            }
        }
        Some(step)
    }

    /// The whole before the past, and the past.
    #[must_use]
    pub fn steps(&self) -> Vec<&SceneStep> {
        let base = std::iter::once(&self.base).filter(|base| !base.is_nothing());
        base.chain(&self.past).collect()
    }

    /// The whole as it is now.
    #[must_use]
    pub fn head(&self) -> &SceneStep {
        &self.head
    }
}

/// A picture as a page shows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// The camera's name.
    pub camera: String,
    /// The camera's own number of it.
    pub number: u64,
    /// The middle of its exposure, ns since the start of the app.
    pub at_ns: u64,
    /// Its size as it was taken, in whose pixels the marks are.
    pub taken: [u32; 2],
    /// Its size here.
    pub size: [u32; 2],
    /// PNG, base64.
    pub png: String,
    /// What was found.
    pub marks: Vec<Found>,
    /// What is drawn over it.
    #[serde(default, skip_serializing_if = "Drawing::is_empty")]
    pub drawing: Drawing,
}

impl Shown {
    /// A picture that came, encoded.
    ///
    /// # Errors
    /// It has not the pixels that its size says.
    pub fn new(picture: Picture) -> Result<Self, png::EncodingError> {
        let mut bytes = Vec::new();
        let [width, height] = picture.size;
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&picture.pixels)?;
        writer.finish()?;
        Ok(Self {
            camera: picture.camera,
            number: picture.number,
            at_ns: picture.at_ns,
            taken: picture.taken,
            size: picture.size,
            png: BASE64.encode(bytes),
            marks: picture.marks,
            drawing: picture.drawing,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Mark, Number, Part, Pose};

    fn batch(at_ns: u64, xs: &[(u32, f64)], view: Option<View>) -> Batch {
        let moved = xs.iter().map(|(part, x)| Moved {
            part: *part,
            pose: Pose {
                at: [*x, 0.0, 0.0],
                ..Pose::default()
            },
            numbers: vec![f64::NAN],
        });
        Batch {
            mark: Mark { run: 0, seq: at_ns },
            at_ns,
            view,
            moved: moved.collect(),
            said: None,
            pictures: Vec::new(),
        }
    }

    fn view() -> View {
        let part = Part {
            numbers: vec![Number {
                name: "n".to_owned(),
                unit: "m".to_owned(),
                resolution: 1.0,
            }],
            ..Part::default()
        };
        View {
            parts: vec![part.clone(), part],
            ..View::default()
        }
    }

    #[test]
    fn a_bounded_past_and_what_stands_before_it_lead_to_the_present() {
        let mut track = SceneTrack::default();
        let first = batch(0, &[(0, 0.0), (1, 5.0)], Some(view()));
        assert!(track.take(SceneStep::new(&first), 3).is_some());
        for at in 1..=9_u32 {
            let step = batch(at.into(), &[(0, f64::from(at) / 3.0)], None);
            assert!(track.take(SceneStep::new(&step), 3).is_some());
        }
        let steps = track.steps();
        assert_eq!(steps.len(), 4);
        let mut whole = SceneStep::default();
        steps.into_iter().for_each(|step| whole.apply(step));
        assert_eq!(&whole, track.head());
        assert_eq!(whole.moved[0][1], Some(3.0));
        assert_eq!(whole.moved[1][1], Some(5.0));
        assert_eq!(whole.moved[0][8], None);
        assert!(whole.view.is_some());
    }

    #[test]
    fn a_task_that_comes_back_as_it_was_tells_nothing_new() {
        let mut track = SceneTrack::default();
        let first = SceneStep::new(&batch(0, &[(0, 0.0), (1, 5.0)], Some(view())));
        track.take(first.clone(), 9);
        assert_eq!(track.take(SceneStep { at_ns: 4, ..first }, 9), None);
    }

    #[test]
    fn a_picture_comes_out_of_its_png_as_it_went_in() {
        let pixels: Vec<u8> = (0..12).map(|at| 20 * at as u8).collect();
        let picture = Picture {
            camera: "west".to_owned(),
            number: 1,
            at_ns: 2,
            taken: [8, 6],
            size: [4, 3],
            pixels: pixels.clone().into(),
            marks: Vec::new(),
            drawing: Drawing::default(),
        };
        let shown = Shown::new(picture.clone()).unwrap();
        let bytes = BASE64.decode(shown.png).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        let mut read = vec![0; 12];
        reader.next_frame(&mut read).unwrap();
        assert_eq!(read, pixels);
        let short = Picture {
            size: [4, 4],
            ..picture
        };
        assert!(Shown::new(short).is_err());
    }
}
