//! Tools: one step of a Service each. A Tool that needs hardware asks the Vision Module Manager for it, calls the
//! Vision Module, gives the hardware back, and gets the result directly from the Vision Module.

mod disk;

use std::collections::BTreeMap;

use ctos::{
    diagnostic::Source,
    message::{Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled, HandlerError},
};
use nalgebra::{Point3, Vector2};
use serde::Deserialize;

use crate::{
    camera_info::CameraInfo,
    command::{
        AcquireVm, DisplayImage, DisplayMark, LocateSpot, LocateTarget, MarkSpot, Outcome,
        ReleaseVm, ShowImage, Snap, SnapNow, VisionError,
    },
    concurrent::answer,
    frame::Frame,
    pose::{TargetPose, find_target},
    service::ask,
    spot::{SpotOptions, SpotsOptions, find_spot, find_spots},
};

pub use disk::{DISK_FIND_COMMANDS, DiskFindTool};
pub(crate) use disk::{DiskFindArgs, disk_about};

/// The commands of `vss.tool_snap`.
pub const SNAP_COMMANDS: &[CommandInfo] = &[Snap::INFO];
/// The commands of `vss.tool_image_disp`.
pub const IMAGE_DISP_COMMANDS: &[CommandInfo] = &[ShowImage::INFO];
/// The commands of `vss.tool_spot_find`.
pub const SPOT_FIND_COMMANDS: &[CommandInfo] = &[LocateSpot::INFO];
/// The commands of `vss.tool_target_find`.
pub const TARGET_FIND_COMMANDS: &[CommandInfo] = &[LocateTarget::INFO];
/// The commands of `vss.tool_spot_disp`.
pub const SPOT_DISP_COMMANDS: &[CommandInfo] = &[MarkSpot::INFO];

/// The frame with its pixels, which are fetched from the snapshot buffer where they were left if they did not come with the
/// message. A record holds what was fetched.
///
/// # Errors
/// [`Outcome::Unseen`] when later frames took their place, or the camera's chassis has ended.
pub fn fetched(cx: &Context, frame: Frame) -> Result<Frame, VisionError> {
    let unseen = |reason: String| VisionError::new(Outcome::Unseen, reason);
    let fetch = |frame: Frame| frame.fetched().map_err(|error| error.to_string());
    if !frame.is_elsewhere() {
        return fetch(frame).map_err(unseen);
    }
    let whole = cx.outside("the pixels of a frame", || fetch(frame));
    whole.map_err(unseen)
}

/// Calls a Vision Module while the manager grants its hardware to this Tool.
async fn with_vm<C: Command>(
    cx: &Context,
    vmm: &str,
    vm: &str,
    request: C,
) -> Result<C::Reply, VisionError> {
    let grant = ask(cx, vmm, AcquireVm { vm: vm.to_owned() }).await?;
    let result = ask(cx, vm, request).await;
    // Whatever the Vision Module said, the next Tool must get its turn.
    if let Err(error) = ask(cx, vmm, ReleaseVm { grant }).await {
        tracing::warn!(vm, %error, "hardware not given back; the manager will take it");
    }
    result
}

/// The Vision Module Manager and, per camera, the Vision Module; the catalog writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PerCameraArgs {
    vmm: String,
    vms: BTreeMap<String, String>,
}

/// The Vision Module Manager and the one Vision Module; the catalog writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SharedArgs {
    vmm: String,
    vm: String,
}

/// toolSnap: a picture from a camera.
#[derive(Debug)]
pub struct SnapTool {
    args: PerCameraArgs,
}

impl SnapTool {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for SnapTool {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != Snap::CODE {
            return cx.default_processing(message);
        }
        let PerCameraArgs { vmm, vms } = self.args.clone();
        answer::<Snap, _, _>(cx, message, |cx, Snap { camera }| async move {
            let Some(vm) = vms.get(&camera) else {
                let names: Vec<&str> = vms.keys().map(String::as_str).collect();
                let known = names.join(", ");
                let reason = format!("no camera is called `{camera}`; there are: {known}");
                return Ok(Err(VisionError::new(Outcome::Refused, reason)));
            };
            Ok(with_vm(&cx, &vmm, vm, SnapNow {}).await)
        })
    }
}

/// toolImageDisp: a picture on the monitor.
#[derive(Debug)]
pub struct ImageDispTool {
    args: SharedArgs,
}

impl ImageDispTool {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for ImageDispTool {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != ShowImage::CODE {
            return cx.default_processing(message);
        }
        let SharedArgs { vmm, vm } = self.args.clone();
        answer::<ShowImage, _, _>(cx, message, |cx, request| async move {
            let ShowImage {
                camera,
                frame,
                drawing,
            } = request;
            let picture = DisplayImage {
                camera,
                frame,
                drawing,
            };
            Ok(with_vm(&cx, &vmm, &vm, picture).await?)
        })
    }
}

/// toolSpotFind: computes only, so it needs no Vision Module.
#[derive(Debug)]
pub struct SpotFindTool {
    options: SpotOptions,
}

impl SpotFindTool {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self {
            options: cx.args()?,
        })
    }
}

impl EventHandler for SpotFindTool {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != LocateSpot::CODE {
            return cx.default_processing(message);
        }
        let (LocateSpot { frame }, reply) = message.open::<LocateSpot>()?;
        let found =
            fetched(cx, frame).and_then(|frame| Ok(find_spot(&frame.into_grey(), &self.options)?));
        reply.ok(found)
    }
}

/// Arguments of toolTargetFind.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TargetFindArgs {
    /// Places of the target's lights in its own frame, m; they lie in the plane z = 0.
    lights: Vec<[f64; 2]>,
    /// The lens of each camera that looks for it: camera to a `camera_info` file, relative to the configuration's folder.
    cameras: BTreeMap<String, String>,
    /// Grey value from which a pixel is of a light.
    threshold: u8,
    /// Fewest pixels of a light.
    #[serde(default = "least_area")]
    min_area: u64,
}

fn least_area() -> u64 {
    4
}

/// toolTargetFind: where a target of known lights stands. Computes only, so it needs no Vision Module.
#[derive(Debug)]
pub struct TargetFindTool {
    lights: Vec<Point3<f64>>,
    lenses: BTreeMap<String, CameraInfo>,
    spots: SpotsOptions,
}

impl TargetFindTool {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        let args: TargetFindArgs = cx.args()?;
        let mut lenses = BTreeMap::new();
        for (camera, file) in &args.cameras {
            let source = Source::read(&cx.app().file_at(file))?;
            let lens = CameraInfo::from_yaml(source.text());
            let lens = lens.map_err(|error| HandlerError::new(format!("`{file}`: {error}")))?;
            lenses.insert(camera.clone(), lens);
        }
        let lights = args.lights.iter();
        Ok(Self {
            lights: lights.map(|[x, y]| Point3::new(*x, *y, 0.0)).collect(),
            lenses,
            spots: SpotsOptions {
                threshold: Some(args.threshold),
                min_area: args.min_area,
                border: false,
                ..SpotsOptions::default()
            },
        })
    }

    fn locate(&self, frame: Frame) -> Result<TargetPose, VisionError> {
        let Some(lens) = self.lenses.get(&frame.camera) else {
            let known: Vec<&str> = self.lenses.keys().map(String::as_str).collect();
            let text = format!(
                "the lens of camera `{}` is not known; those are of: {}",
                frame.camera,
                known.join(", ")
            );
            return Err(VisionError::new(Outcome::Refused, text));
        };
        let found = find_spots(&frame.into_grey(), &self.spots)?;
        let spots = found.spots.iter();
        let places: Vec<Vector2<f64>> = spots.map(|spot| Vector2::new(spot.u, spot.v)).collect();
        find_target(&self.lights, &places, &lens.intrinsics, &lens.distortion)
            .map_err(|error| VisionError::new(Outcome::Unseen, error))
    }
}

impl EventHandler for TargetFindTool {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != LocateTarget::CODE {
            return cx.default_processing(message);
        }
        let (LocateTarget { frame }, reply) = message.open::<LocateTarget>()?;
        reply.ok(fetched(cx, frame).and_then(|frame| self.locate(frame)))
    }
}

/// toolSpotDisp: a marker on top of the picture on the monitor.
#[derive(Debug)]
pub struct SpotDispTool {
    args: SharedArgs,
}

impl SpotDispTool {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for SpotDispTool {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != MarkSpot::CODE {
            return cx.default_processing(message);
        }
        let SharedArgs { vmm, vm } = self.args.clone();
        answer::<MarkSpot, _, _>(cx, message, |cx, MarkSpot { camera, mark }| async move {
            Ok(with_vm(&cx, &vmm, &vm, DisplayMark { camera, mark }).await?)
        })
    }
}
