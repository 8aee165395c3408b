//! What tasks show, as messages for viewers.

use std::{borrow::Cow, collections::BTreeMap, sync::Arc, time::Duration};

use ctos::record::ChannelSchema;
use foxglove::{
    Encode,
    messages::{
        CameraCalibration, CircleAnnotation, Color, CompressedImage, FrameTransform,
        FrameTransforms, ImageAnnotations, JointState, JointStates, Log, Point2, PointsAnnotation,
        SceneEntity, SceneEntityDeletion, SceneUpdate, Timestamp, log, points_annotation,
        scene_entity_deletion,
    },
};
use jpeg_encoder::{ColorType, Encoder};
use scene::{
    Batch, Layer, Moved, Part, Picture, Solid,
    known::{Joint, Known, Lens, camera_frame, frame},
};
use serde_json::{Map, Value};

use crate::shapes;

/// The frame that all others are in.
pub const WORLD: &str = "world";

/// The least time between two pictures of a camera.
const PICTURE_PERIOD: Duration = Duration::from_millis(200);
/// Of JPEG, of 100.
const QUALITY: u8 = 80;
/// The least diameter of a mark, px.
const LEAST_MARK: f64 = 6.0;
const MARK: Color = Color {
    r: 0.96,
    g: 0.45,
    b: 0.0,
    a: 1.0,
};
/// What a simulator says is drawn so thin.
const TRUTH: f64 = 0.35;

/// A message for viewers.
#[derive(Debug, Clone, PartialEq)]
pub struct Sent {
    /// Its channel.
    pub channel: String,
    /// The moment that it tells of, ns since the start of the app.
    pub at_ns: u64,
    /// How all of that channel is written.
    pub schema: Arc<ChannelSchema>,
    /// The message.
    pub bytes: Vec<u8>,
}

/// What cannot be shown to viewers.
#[derive(Debug, thiserror::Error)]
pub enum TranslateError {
    /// A picture.
    #[error("picture {number} of camera `{camera}` cannot be encoded: {reason}")]
    Picture {
        /// The camera.
        camera: String,
        /// The camera's own number of it.
        number: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// A message.
    #[error("a message for `{channel}` cannot be encoded: {reason}")]
    Message {
        /// Its channel.
        channel: String,
        /// What is wrong with it.
        reason: String,
    },
}

/// What is known of each task that shows something.
#[derive(Debug, Default)]
pub struct Translator {
    sources: BTreeMap<String, Known>,
    cameras: BTreeMap<String, Camera>,
}

/// What is known of a camera besides its pyramid.
#[derive(Debug, Default)]
struct Camera {
    /// When its latest translated picture was taken.
    at_ns: Option<u64>,
    size: Option<[u32; 2]>,
}

fn time(at_ns: u64) -> Timestamp {
    let at = Duration::from_nanos(at_ns);
    let seconds = u32::try_from(at.as_secs()).unwrap_or(u32::MAX);
    Timestamp::new_checked(seconds, at.subsec_nanos()).unwrap_or(Timestamp::MAX)
}

fn sent<M: Encode>(channel: String, at_ns: u64, message: &M) -> Result<Sent, TranslateError> {
    let mut bytes = Vec::new();
    if let Err(error) = message.encode(&mut bytes) {
        let reason = error.to_string();
        return Err(TranslateError::Message { channel, reason });
    }
    let schema = M::get_schema().map_or_else(ChannelSchema::default, |schema| ChannelSchema {
        name: schema.name.into(),
        language: schema.encoding.into(),
        text: schema.data,
        encoding: M::get_message_encoding().into(),
    });
    Ok(Sent {
        channel,
        at_ns,
        schema: Arc::new(schema),
        bytes,
    })
}

impl Translator {
    /// Takes in what `source` shows: what viewers are told of it.
    ///
    /// # Errors
    /// Something in it cannot be encoded; the rest is known from now on.
    pub fn take(&mut self, source: &str, batch: Batch) -> Result<Vec<Sent>, TranslateError> {
        let known = self.sources.entry(source.to_owned()).or_default();
        let news = known.take(batch);
        let mut all = Vec::new();
        if news.parts {
            all.push(solids(known, source)?);
        }
        if news.parts || news.moved {
            all.extend(places(known, source)?);
        }
        if news.said {
            all.extend(saying(known, source)?);
        }
        if news.parts {
            all.extend(self.lenses(source)?);
        }
        for picture in news.pictures {
            all.extend(self.picture(picture)?);
        }
        Ok(all)
    }

    /// All that is known of `source` but its pictures, for somebody who comes later.
    ///
    /// # Errors
    /// Something in it cannot be encoded.
    pub fn whole(&self, source: &str) -> Result<Vec<Sent>, TranslateError> {
        let Some(known) = self.sources.get(source) else {
            return Ok(Vec::new());
        };
        let mut all = Vec::new();
        if !known.view.parts.is_empty() {
            all.push(solids(known, source)?);
        }
        all.extend(places(known, source)?);
        all.extend(saying(known, source)?);
        all.extend(self.lenses(source)?);
        Ok(all)
    }

    /// The cameras whose pyramids `source` shows, as far as the size of their pictures is known.
    fn lenses(&self, source: &str) -> Result<Vec<Sent>, TranslateError> {
        let known = self.sources.get(source);
        let known = known.filter(|known| known.is_measured());
        let mut all = Vec::new();
        for (camera, corners, part) in known.into_iter().flat_map(Known::pyramids) {
            let Some(size) = self.cameras.get(camera).and_then(|known| known.size) else {
                continue;
            };
            let at_ns = known.map_or(0, |known| known.at_ns);
            let lens = Lens::of(corners, size)
                .map(|lens| calibration(lens, size, frame(source, part), time(at_ns)));
            if let Some(lens) = lens {
                all.push(sent(format!("/camera/{camera}/calibration"), at_ns, &lens)?);
            }
        }
        Ok(all)
    }

    fn picture(&mut self, picture: Picture) -> Result<Vec<Sent>, TranslateError> {
        let frame_id = camera_frame(&self.sources, &picture.camera);
        let Picture {
            camera,
            number,
            at_ns,
            taken,
            size,
            pixels,
            marks,
            drawing,
        } = picture;
        let known = self.cameras.entry(camera.clone()).or_default();
        let resized = known.size.replace(size) != Some(size);
        let period = PICTURE_PERIOD.as_nanos() as u64;
        let (timestamp, mut all) = (Some(time(at_ns)), Vec::new());
        // The same picture with more marks on it is told again: its marks only.
        let again = known.at_ns == Some(at_ns);
        let early = known.at_ns.is_some_and(|last| at_ns < last + period);
        if early && !again {
            return Ok(all);
        }
        known.at_ns = Some(at_ns);
        if !again {
            let image = CompressedImage {
                timestamp,
                frame_id,
                data: jpeg(&camera, number, size, &pixels)?.into(),
                format: "jpeg".to_owned(),
            };
            all.push(sent(format!("/camera/{camera}/image"), at_ns, &image)?);
        }
        let [across, down] =
            [0, 1].map(|axis| f64::from(size[axis]) / f64::from(taken[axis].max(1)));
        // Middles of pixels, in the small picture.
        let place = |[u, v]: [f64; 2]| Point2 {
            x: (u + 0.5) * across - 0.5,
            y: (v + 0.5) * down - 0.5,
        };
        let circle = |mark: &scene::Found| {
            let wide = mark.sd.map_or(0.0, |[u, v]| 6.0 * u.max(v) * across);
            CircleAnnotation {
                timestamp,
                position: Some(place(mark.at)),
                diameter: wide.max(LEAST_MARK),
                thickness: 1.5,
                fill_color: None,
                outline_color: Some(MARK),
                metadata: Vec::new(),
            }
        };
        let outline = |outline: &scene::Outline| {
            let [r, g, b] = outline.colour.map(|part| f64::from(part) / 255.0);
            PointsAnnotation {
                timestamp,
                r#type: points_annotation::Type::LineLoop.into(),
                points: outline.corners.iter().copied().map(place).collect(),
                outline_color: Some(Color {
                    r,
                    g,
                    b,
                    a: outline.strength,
                }),
                thickness: outline.width * across,
                ..PointsAnnotation::default()
            }
        };
        let annotations = ImageAnnotations {
            timestamp,
            circles: marks.iter().map(circle).collect(),
            points: drawing.outlines.iter().map(outline).collect(),
            ..ImageAnnotations::default()
        };
        all.push(sent(
            format!("/camera/{camera}/marks"),
            at_ns,
            &annotations,
        )?);
        if resized {
            let sources: Vec<String> = self.sources.keys().cloned().collect();
            for source in sources {
                all.extend(self.lenses(&source)?);
            }
        }
        Ok(all)
    }
}

fn jpeg(
    camera: &str,
    number: u64,
    size: [u32; 2],
    pixels: &[u8],
) -> Result<Vec<u8>, TranslateError> {
    let failed = |reason: String| TranslateError::Picture {
        camera: camera.to_owned(),
        number,
        reason,
    };
    let [width, height] = size;
    if u64::from(width) * u64::from(height) != pixels.len() as u64 {
        let count = pixels.len();
        return Err(failed(format!("{width} x {height} px, and {count} bytes")));
    }
    let sides = u16::try_from(width).ok().zip(u16::try_from(height).ok());
    let (width, height) = sides.ok_or_else(|| failed("it is too large".to_owned()))?;
    let mut bytes = Vec::new();
    Encoder::new(&mut bytes, QUALITY)
        .encode(pixels, width, height, ColorType::Luma)
        .map_err(|error| failed(error.to_string()))?;
    Ok(bytes)
}

/// The solids of all parts, in place of those that were shown before.
fn solids(known: &Known, source: &str) -> Result<Sent, TranslateError> {
    let timestamp = Some(time(known.at_ns));
    let alpha = match known.view.layer {
        Layer::Measured => 1.0,
        Layer::Truth => TRUTH,
    };
    let parts = known.view.parts.iter();
    let drawn = parts.filter(|part| !part.solids.is_empty());
    let entity = |part: &Part| {
        let mut entity = SceneEntity {
            timestamp,
            frame_id: frame(source, part),
            id: part.name.clone(),
            frame_locked: true,
            ..SceneEntity::default()
        };
        let fill = shapes::colour(part.colour, alpha);
        for solid in &part.solids {
            shapes::add(&mut entity, solid, fill);
        }
        entity
    };
    let update = SceneUpdate {
        deletions: vec![SceneEntityDeletion {
            timestamp,
            r#type: scene_entity_deletion::Type::All as i32,
            id: String::new(),
        }],
        entities: drawn.map(entity).collect(),
    };
    sent(format!("/solids/{source}"), known.at_ns, &update)
}

/// The arrows of parts along their numbers, each in place of the one before; none where no part has one.
fn vectors(known: &Known, source: &str) -> Result<Option<Sent>, TranslateError> {
    let timestamp = Some(time(known.at_ns));
    let entity = |(part, moved): (&Part, &Moved)| {
        let arrows = part.solids.iter().filter_map(|solid| match solid {
            Solid::Vector { first, scale, .. } => Some((*first, *scale)),
            _ => None,
        });
        let mut arrows = arrows.peekable();
        arrows.peek()?;
        let mut entity = SceneEntity {
            timestamp,
            frame_id: frame(source, part),
            id: part.name.clone(),
            frame_locked: true,
            ..SceneEntity::default()
        };
        for (first, scale) in arrows {
            if let Some(vector) = moved.vector(first) {
                let fill = shapes::colour(part.colour, 1.0);
                shapes::add_vector(&mut entity, vector.map(|part| part * scale), fill);
            }
        }
        Some(entity)
    };
    let entities: Vec<SceneEntity> = known.placed().filter_map(entity).collect();
    if entities.is_empty() {
        return Ok(None);
    }
    let update = SceneUpdate {
        deletions: Vec::new(),
        entities,
    };
    sent(format!("/vectors/{source}"), known.at_ns, &update).map(Some)
}

/// Where all parts are, and their numbers. All of them each time: a viewer that jumps to a moment reads the last
/// message before it.
fn places(known: &Known, source: &str) -> Result<Vec<Sent>, TranslateError> {
    let timestamp = Some(time(known.at_ns));
    let mut transforms = FrameTransforms::default();
    let joints = JointStates {
        timestamp,
        joints: known.joints().map(joint).collect(),
    };
    let mut numbers = Map::new();
    for (part, moved) in known.placed() {
        transforms.transforms.push(FrameTransform {
            timestamp,
            parent_frame_id: WORLD.to_owned(),
            child_frame_id: frame(source, part),
            translation: Some(shapes::vector(moved.pose.at)),
            rotation: Some(shapes::quaternion(moved.pose.turn)),
        });
        if !part.numbers.is_empty() {
            numbers.insert(part.name.clone(), named(part, moved));
        }
    }
    let mut all = Vec::new();
    if !transforms.transforms.is_empty() {
        all.push(sent(format!("/tf/{source}"), known.at_ns, &transforms)?);
    }
    if !joints.joints.is_empty() {
        all.push(sent(format!("/joints/{source}"), known.at_ns, &joints)?);
    }
    all.extend(vectors(known, source)?);
    if !numbers.is_empty() {
        all.push(Sent {
            channel: format!("/numbers/{source}"),
            at_ns: known.at_ns,
            schema: Arc::new(ChannelSchema {
                name: Cow::Borrowed("ctos.Numbers"),
                language: Cow::Borrowed("jsonschema"),
                text: Cow::Borrowed(br#"{"type":"object","additionalProperties":{"type":"object","additionalProperties":{"type":["number","null"]}}}"#),
                encoding: Cow::Borrowed("json"),
            }),
            bytes: Value::Object(numbers).to_string().into_bytes(),
        });
    }
    Ok(all)
}

fn saying(known: &Known, source: &str) -> Result<Option<Sent>, TranslateError> {
    let Some(said) = known.said.as_ref().filter(|said| !said.words.is_empty()) else {
        return Ok(None);
    };
    let level = match said.fault {
        true => log::Level::Warning,
        false => log::Level::Info,
    };
    let log = Log {
        timestamp: Some(time(known.at_ns)),
        level: level as i32,
        message: said.words.clone(),
        name: source.to_owned(),
        ..Log::default()
    };
    sent(format!("/said/{source}"), known.at_ns, &log).map(Some)
}

fn joint(joint: Joint) -> JointState {
    JointState {
        name: joint.name,
        position: joint.position,
        velocity: joint.velocity,
        acceleration: None,
        effort: joint.effort,
    }
}

fn calibration(
    lens: Lens,
    size: [u32; 2],
    frame_id: String,
    timestamp: Timestamp,
) -> CameraCalibration {
    let (k, p) = lens.matrices();
    CameraCalibration {
        timestamp: Some(timestamp),
        frame_id,
        width: size[0],
        height: size[1],
        k: k.into(),
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: p.into(),
        ..CameraCalibration::default()
    }
}

/// The numbers of a part, under names with their units: `error_rad`, `velocity_rad_per_s`.
fn named(part: &Part, moved: &Moved) -> Value {
    let numbers = part.numbers.iter().zip(&moved.numbers);
    let named = numbers.map(|(number, value)| {
        let unit = number.unit.replace('/', "_per_").replace(' ', "_");
        let name = number.name.replace(' ', "_");
        let name = if unit.is_empty() {
            name
        } else {
            format!("{name}_{unit}")
        };
        (name, Value::from(*value))
    });
    Value::Object(named.collect())
}

#[cfg(test)]
mod tests;
