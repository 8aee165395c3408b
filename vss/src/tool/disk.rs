//! toolDiskFind: the disc before the camera on a hand, and the move that takes the gripper to where it grips the disc. Computes only,
//! so it needs no Vision Module.

use std::collections::{BTreeMap, VecDeque};

use ctos::{
    message::{Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled, HandlerError},
};
use serde::Deserialize;
use vss_image::{
    Format, Picture,
    board::{Disc, disc_near},
};

use super::fetched;
use crate::{
    command::{DiskSight, LocateDisk, Outcome, VisionError},
    frame::{Frame, PixelFormat},
    visual_jacobian::{EXAMPLES, Example, Seen, VisualJacobian},
};

/// The commands of `vss.tool_disk_find`.
pub const DISK_FIND_COMMANDS: &[CommandInfo] = &[LocateDisk::INFO];

/// Places where a disc is looked for, along each axis, in radii from the middle. Each finds what is within 1.1 radii, and all of
/// them what is within two.
const AROUND: [f64; 3] = [0.0, -1.5, 1.5];
const WITHIN: f64 = 2.0;

/// Arguments of toolDiskFind.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DiskFindArgs {
    /// About how large a disc is in the picture, px.
    radius_px: f64,
    /// About where it is, px; the middle of the picture when nothing is said.
    at: Option<[f64; 2]>,
    /// Standard deviation of a disc's middle in a picture, px.
    #[serde(default = "usual_sd")]
    sd_px: f64,
    /// Standard deviation of its radius, px.
    #[serde(default = "usual_sd")]
    sd_radius_px: f64,
}

fn usual_sd() -> f64 {
    0.3
}

/// What was taught about one camera.
#[derive(Debug, Default)]
struct Taught {
    /// The last ones, four at most.
    examples: VecDeque<Example>,
    map: Option<VisualJacobian>,
}

/// toolDiskFind.
#[derive(Debug)]
pub struct DiskFindTool {
    args: DiskFindArgs,
    taught: BTreeMap<String, Taught>,
}

impl DiskFindTool {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: DiskFindArgs = cx.args()?;
        let sizes = [args.radius_px - 2.0, args.sd_px, args.sd_radius_px];
        if !sizes.iter().all(|size| size.is_finite() && *size > 0.0) {
            let text = "`radius_px` is 3 px or more, `sd_px` and `sd_radius_px` are larger than 0";
            return Err(HandlerError::new(text));
        }
        Ok(Self {
            args,
            taught: BTreeMap::new(),
        })
    }

    fn locate(&mut self, frame: Frame, offset: Option<[f64; 2]>) -> Result<DiskSight, VisionError> {
        let camera = frame.camera.clone();
        let disc = self.disc(frame)?;
        let seen = Seen {
            u: disc.u,
            v: disc.v,
            radius: disc.radius,
        };
        let taught = self.taught.entry(camera).or_default();
        let correction = match offset {
            Some(offset) => {
                let [sd, sd_radius] = [self.args.sd_px, self.args.sd_radius_px];
                taught.teach(Example { offset, seen }, sd, sd_radius)?;
                None
            }
            None => Some(taught.correction(&seen)?),
        };
        Ok(DiskSight {
            seen,
            sd_px: disc.sd_px,
            examples: taught.examples.len(),
            correction,
        })
    }

    fn disc(&self, frame: Frame) -> Result<Disc, VisionError> {
        let (width, height) = (frame.width as f64, frame.height as f64);
        let radius = self.args.radius_px;
        let [u, v] = self.args.at.unwrap_or([0.5 * width, 0.5 * height]);
        let picture = Picture {
            width: frame.width,
            height: frame.height,
            format: match frame.format {
                PixelFormat::Grey8 => Format::Grey8,
                PixelFormat::Rgb8 => Format::Rgb8,
            },
            pixels: frame.pixels.into(),
            notes: Vec::new(),
        };
        disk_about(&picture, [u, v], radius).map_err(|why| VisionError::new(Outcome::Unseen, why))
    }
}

/// The disc that is known best among those that are seen about `at` with about that radius, px; else why there is none.
pub(crate) fn disk_about(picture: &Picture, at: [f64; 2], radius: f64) -> Result<Disc, String> {
    let [u, v] = at;
    let places = AROUND
        .iter()
        .flat_map(|x| AROUND.map(|y| (x * radius, y * radius)));
    let found = places.filter_map(|(x, y)| disc_near(picture, [u + x, v + y], radius).ok());
    let worth = |disc: &Disc| disc.sd_px[0].hypot(disc.sd_px[1]);
    let best = found.min_by(|a, b| worth(a).total_cmp(&worth(b)));
    best.ok_or_else(|| {
        format!(
            "no disc of about {radius} px is within {:.0} px of ({u:.0}, {v:.0})",
            WITHIN * radius
        )
    })
}

impl Taught {
    /// Takes an example in; the fourth one makes the map, and each later one makes it anew without the oldest.
    fn teach(&mut self, example: Example, sd: f64, sd_radius: f64) -> Result<(), VisionError> {
        if self.examples.len() == EXAMPLES {
            self.examples.pop_front();
        }
        self.examples.push_back(example);
        let Some(examples) = self.examples.make_contiguous().first_chunk::<EXAMPLES>() else {
            return Ok(());
        };
        let map = VisualJacobian::train(examples, sd, sd_radius);
        self.map = Some(map.map_err(|why| VisionError::new(Outcome::Refused, why))?);
        Ok(())
    }

    fn correction(
        &mut self,
        seen: &Seen,
    ) -> Result<crate::visual_jacobian::Correction, VisionError> {
        let Some(map) = &mut self.map else {
            let text = format!(
                "{} of {EXAMPLES} examples are taught: a correction needs all of them",
                self.examples.len()
            );
            return Err(VisionError::new(Outcome::Refused, text));
        };
        let found = map.correction(seen).filter(|found| found.good);
        found.ok_or_else(|| {
            let text = format!(
                "the disc at ({:.0}, {:.0}) with a radius of {:.1} px is not the one that was taught, or not from there",
                seen.u, seen.v, seen.radius
            );
            VisionError::new(Outcome::Unseen, text)
        })
    }
}

impl EventHandler for DiskFindTool {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != LocateDisk::CODE {
            return cx.default_processing(message);
        }
        let (LocateDisk { frame, taught }, reply) = message.open::<LocateDisk>()?;
        let found = fetched(cx, frame).and_then(|frame| self.locate(frame, taught));
        reply.ok(found)
    }
}
