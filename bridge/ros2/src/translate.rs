//! What tasks show, as messages of ROS. Knows no network.

use std::collections::BTreeMap;

use scene::{
    Batch, Picture, Said,
    known::{Known, Lens, News, camera_frame, frame},
};

use crate::{
    args::{Args, Published, plain},
    messages::{
        CameraInfo, DiagnosticArray, DiagnosticStatus, Header, Image, JointState, KeyValue,
        RegionOfInterest, RosType, TFMessage, Time, Topic, TransformStamped, encode,
    },
};

/// The frame that all others are in.
const WORLD: &str = "world";

/// A message to be published.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Told {
    /// The topic.
    pub name: String,
    pub of: RosType,
    pub bytes: Vec<u8>,
}

/// What is known of all tasks that show something, and how it is told.
#[derive(Debug)]
pub(crate) struct Translator {
    args: Args,
    sources: BTreeMap<String, Known>,
    /// When the latest picture of a camera was taken, ns since the start of the app, and its size.
    cameras: BTreeMap<String, (u64, [u32; 2])>,
    /// ns since 1970 when the app was started.
    started_ns: u64,
}

impl Translator {
    pub fn new(args: Args, started_ns: u64) -> Self {
        Self {
            args,
            sources: BTreeMap::new(),
            cameras: BTreeMap::new(),
            started_ns,
        }
    }

    fn header(&self, at_ns: u64, frame_id: String) -> Header {
        let stamp = Time::of(self.started_ns.saturating_add(at_ns));
        Header { stamp, frame_id }
    }

    /// The topics that tell what `is` means; `usual` where the configuration names none.
    fn topics(&self, usual: Option<&str>, is: impl Fn(&Published) -> bool) -> Vec<String> {
        match &self.args.publish {
            None => usual.iter().map(|name| self.args.name(name)).collect(),
            Some(topics) => {
                let meant = topics.iter().filter(|(_, published)| is(published));
                meant.map(|(name, _)| self.args.name(name)).collect()
            }
        }
    }

    /// Takes in what `source` shows: what ROS is told of it.
    pub fn take(&mut self, source: &str, batch: Batch) -> Vec<Told> {
        let known = self.sources.entry(source.to_owned()).or_default();
        let at_ns = batch.at_ns;
        let News {
            parts,
            moved,
            said,
            pictures,
        } = known.take(batch);
        let mut all = Vec::new();
        if parts || moved {
            self.places(source, at_ns, &mut all);
        }
        if parts {
            self.infos(at_ns, &mut all);
        }
        if said {
            self.saying(Some(source), at_ns, Vec::new(), &mut all);
        }
        for picture in pictures {
            self.picture(picture, &mut all);
        }
        all
    }

    /// Everything but pictures as it is now, for those who came later; besides, how the bridge is.
    pub fn whole(&self, at_ns: u64, bridge: DiagnosticStatus) -> Vec<Told> {
        let mut all = Vec::new();
        for source in self.sources.keys() {
            self.places(source, at_ns, &mut all);
        }
        self.infos(at_ns, &mut all);
        self.saying(None, at_ns, vec![bridge], &mut all);
        all
    }

    fn infos(&self, at_ns: u64, all: &mut Vec<Told>) {
        for camera in self.cameras.keys() {
            self.info(camera, at_ns, all);
        }
    }

    fn places(&self, source: &str, at_ns: u64, all: &mut Vec<Told>) {
        let Some(known) = self.sources.get(source) else {
            return;
        };
        // What a simulator knows is told where that is asked for, and not as if it were measured.
        let usual = |name| known.is_measured().then_some(name);
        let mut joints = JointState {
            header: self.header(at_ns, String::new()),
            ..JointState::default()
        };
        for joint in known.joints() {
            joints.name.push(joint.name);
            joints.position.push(joint.position.unwrap_or(f64::NAN));
            joints.velocity.push(joint.velocity.unwrap_or(f64::NAN));
            joints.effort.push(joint.effort.unwrap_or(f64::NAN));
        }
        let of = |published: &Published| matches!(published, Published::Joints(of) if of.iter().any(|of| of == source));
        if !joints.name.is_empty() {
            told(self.topics(usual("joint_states"), of), &joints, all);
        }
        let header = self.header(at_ns, WORLD.to_owned());
        let transforms = known.placed().map(|(part, moved)| TransformStamped {
            header: header.clone(),
            child_frame_id: frame(source, part),
            translation: moved.pose.at,
            rotation: moved.pose.turn,
        });
        let frames = TFMessage {
            transforms: transforms.collect(),
        };
        let of = |published: &Published| matches!(published, Published::Frames(of) if of.iter().any(|of| of == source));
        if !frames.transforms.is_empty() {
            told(self.topics(usual("/tf"), of), &frames, all);
        }
    }

    /// What one task says, or all of them.
    fn saying(
        &self,
        only: Option<&str>,
        at_ns: u64,
        more: Vec<DiagnosticStatus>,
        all: &mut Vec<Told>,
    ) {
        let names = match &self.args.publish {
            None => vec![(self.args.name("/diagnostics"), None)],
            Some(topics) => {
                let said = topics
                    .iter()
                    .filter_map(|(name, published)| match published {
                        Published::Said(of) => Some((self.args.name(name), Some(of))),
                        _ => None,
                    });
                said.collect()
            }
        };
        for (name, of) in names {
            let sources = self.sources.iter().filter(|(source, known)| {
                let asked = of.map_or(known.is_measured(), |of| of.contains(source));
                asked && only.is_none_or(|only| only == **source)
            });
            let said = sources.filter_map(|(source, known)| Some((source, known.said.as_ref()?)));
            let mut status: Vec<_> = said
                .map(|(source, said)| diagnostic(source, said))
                .collect();
            status.extend(more.iter().cloned());
            let array = DiagnosticArray {
                header: self.header(at_ns, String::new()),
                status,
            };
            if !array.status.is_empty() {
                told(vec![name], &array, all);
            }
        }
    }

    fn picture(&mut self, picture: Picture, all: &mut Vec<Told>) {
        let Picture {
            camera,
            at_ns,
            size,
            pixels,
            ..
        } = picture;
        let [width, height] = size;
        if u64::from(width) * u64::from(height) != pixels.len() as u64 {
            let count = pixels.len();
            tracing::warn!(
                camera,
                width,
                height,
                count,
                "a picture has not the pixels of its size"
            );
            return;
        }
        // The same picture is shown again when something is found in it.
        if self
            .cameras
            .insert(camera.clone(), (at_ns, size))
            .map(|(at, _)| at)
            == Some(at_ns)
        {
            return;
        }
        let header = self.header(at_ns, camera_frame(&self.sources, &camera));
        let image = Image {
            header,
            height,
            width,
            encoding: "mono8".to_owned(),
            is_bigendian: 0,
            step: width,
            data: pixels,
        };
        let usual = format!("{}/image_raw", plain(&camera));
        let of =
            |published: &Published| matches!(published, Published::Picture(of) if *of == camera);
        told(self.topics(Some(&usual), of), &image, all);
        self.info(&camera, at_ns, all);
    }

    /// The lens of a camera that was computed, for the pictures of it.
    fn info(&self, camera: &str, at_ns: u64, all: &mut Vec<Told>) {
        let Some((_, size)) = self.cameras.get(camera) else {
            return;
        };
        let Some(lens) = self.lens(camera, *size) else {
            return;
        };
        let (k, p) = lens.matrices();
        let [width, height] = *size;
        let info = CameraInfo {
            header: self.header(at_ns, camera_frame(&self.sources, camera)),
            height,
            width,
            distortion_model: "plumb_bob".to_owned(),
            d: vec![0.0; 5],
            k,
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p,
            binning_x: 0,
            binning_y: 0,
            roi: RegionOfInterest::default(),
        };
        let usual = format!("{}/camera_info", plain(camera));
        let of = |published: &Published| matches!(published, Published::Lens(of) if of == camera);
        told(self.topics(Some(&usual), of), &info, all);
    }

    /// The lens of a camera, once it was computed.
    fn lens(&self, camera: &str, size: [u32; 2]) -> Option<Lens> {
        let measured = self.sources.values().filter(|known| known.is_measured());
        let mut pyramids = measured.flat_map(Known::pyramids);
        let (_, corners, _) = pyramids.find(|(of, _, _)| *of == camera)?;
        Lens::of(corners, size)
    }
}

fn diagnostic(source: &str, said: &Said) -> DiagnosticStatus {
    let value = |key: &str, value: String| KeyValue {
        key: key.to_owned(),
        value,
    };
    let values = said.job.iter().flat_map(|job| {
        let done = value("done", job.done.to_string());
        let total = value("total", job.total.to_string());
        [
            done,
            total,
            value("step", job.step.clone()),
            value("job", job.words.clone()),
        ]
    });
    DiagnosticStatus {
        level: if said.fault { 2 } else { 0 },
        name: source.to_owned(),
        message: said.words.clone(),
        hardware_id: String::new(),
        values: values.collect(),
    }
}

fn told<M: Topic>(names: Vec<String>, message: &M, all: &mut Vec<Told>) {
    if names.is_empty() {
        return;
    }
    match encode(message) {
        Ok(bytes) => all.extend(names.into_iter().map(|name| Told {
            name,
            of: M::TYPE,
            bytes: bytes.clone(),
        })),
        Err(error) => tracing::warn!(?names, %error, "a message cannot be written"),
    }
}

#[cfg(test)]
mod tests;
