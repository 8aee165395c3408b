//! Services: high-level vision operations, each a series of calls to Tools. Several requests run beside each other; what
//! cannot is held up by the Vision Module Manager, not here.

use std::f64::consts::TAU;

use ctos::{
    message::{Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled, HandlerError},
};
use futures_util::future::join;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use scene::Outline;
use serde::Deserialize;

use crate::{
    calibrate::calibrate,
    command::{
        Calibrate, DiskOffset, DiskReport, DiskSight, Drawing, FindPair, FindTarget, LocateDisk,
        LocateSpot, LocateTarget, Mark, MarkSpot, ShowImage, Snap, SpotFind, SpotReport,
        TargetReport, VisionError,
    },
    concurrent::answer,
    visual_jacobian::{Correction, EXAMPLES, Seen},
};

/// The commands of `vss.svc_spot_find`.
pub const SPOT_FIND_COMMANDS: &[CommandInfo] = &[SpotFind::INFO];
/// The commands of `vss.svc_pair_find`.
pub const PAIR_FIND_COMMANDS: &[CommandInfo] = &[FindPair::INFO];
/// The commands of `vss.svc_target_find`.
pub const TARGET_FIND_COMMANDS: &[CommandInfo] = &[FindTarget::INFO];
/// The commands of `vss.svc_disk_find`.
pub const DISK_FIND_COMMANDS: &[CommandInfo] = &[DiskOffset::INFO];
/// The commands of `vss.svc_calibrate`.
pub const CALIBRATE_COMMANDS: &[CommandInfo] = &[Calibrate::INFO];

/// The tasks of the four Tools of SpotFind; the catalog writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SpotFindArgs {
    snap: String,
    image_disp: String,
    spot_find: String,
    spot_disp: String,
}

/// The Service SpotFind: toolSnap, toolImageDisp, toolSpotFind, toolSpotDisp (CIRSSE report 108, section 5).
#[derive(Debug)]
pub struct SpotFindService {
    args: SpotFindArgs,
}

impl SpotFindService {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for SpotFindService {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            SpotFind::CODE => {
                let tools = self.args.clone();
                answer::<SpotFind, _, _>(cx, message, |cx, request| async move {
                    Ok(find_spot(cx, tools, request.camera).await)
                })
            }
            _ => cx.default_processing(message),
        }
    }
}

async fn find_spot(
    cx: Context,
    tools: SpotFindArgs,
    camera: String,
) -> Result<SpotReport, VisionError> {
    let frame = ask(
        &cx,
        &tools.snap,
        Snap {
            camera: camera.clone(),
        },
    )
    .await??;
    let picture = ShowImage {
        camera: camera.clone(),
        frame: frame.clone(),
        drawing: Drawing::default(),
    };
    // A dark monitor must not cost a measurement.
    if let Err(error) = ask(&cx, &tools.image_disp, picture).await {
        tracing::warn!(camera, %error, "picture not shown");
    }
    let (stamp, number) = (frame.stamp, frame.number);
    let (width, height) = (frame.width, frame.height);
    let located = ask(&cx, &tools.spot_find, LocateSpot { frame }).await?;
    let spot = located.map_err(|error| {
        let reason = format!("camera `{camera}`: {error}");
        VisionError { reason, ..error }
    })?;
    let mark = Mark {
        u: spot.u,
        v: spot.v,
        sd: [spot.sd_u, spot.sd_v],
    };
    if let Err(error) = ask(
        &cx,
        &tools.spot_disp,
        MarkSpot {
            camera: camera.clone(),
            mark,
        },
    )
    .await
    {
        tracing::warn!(camera, %error, "marker not shown");
    }
    Ok(SpotReport {
        camera,
        u: spot.u,
        v: spot.v,
        sd_u: spot.sd_u,
        sd_v: spot.sd_v,
        amplitude: spot.amplitude,
        sigma: spot.sigma,
        area: spot.area,
        flags: spot.flags,
        stamp,
        frame: number,
        width,
        height,
    })
}

/// The Service PairFind: SpotFind with two cameras at once.
#[derive(Debug)]
pub struct PairFindService {
    args: SpotFindArgs,
}

impl PairFindService {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for PairFindService {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != FindPair::CODE {
            return cx.default_processing(message);
        }
        let tools = self.args.clone();
        answer::<FindPair, _, _>(cx, message, |cx, FindPair { cameras }| async move {
            let [left, right] = cameras.map(|camera| find_spot(cx.clone(), tools.clone(), camera));
            let (left, right) = join(left, right).await;
            Ok(left.and_then(|left| Ok([left, right?])))
        })
    }
}

/// The tasks of the two Tools of TargetFind; the catalog writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TargetFindArgs {
    snap: String,
    target: String,
}

/// The Service TargetFind: toolSnap, toolTargetFind.
#[derive(Debug)]
pub struct TargetFindService {
    args: TargetFindArgs,
}

impl TargetFindService {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for TargetFindService {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != FindTarget::CODE {
            return cx.default_processing(message);
        }
        let tools = self.args.clone();
        answer::<FindTarget, _, _>(cx, message, |cx, FindTarget { camera }| async move {
            Ok(find_target(cx, tools, camera).await)
        })
    }
}

async fn find_target(
    cx: Context,
    tools: TargetFindArgs,
    camera: String,
) -> Result<TargetReport, VisionError> {
    let snap = Snap {
        camera: camera.clone(),
    };
    let frame = ask(&cx, &tools.snap, snap).await??;
    let (stamp, number, carrier) = (frame.stamp, frame.number, frame.carrier.clone());
    let located = ask(&cx, &tools.target, LocateTarget { frame }).await?;
    let pose = located.map_err(|error| {
        let reason = format!("camera `{camera}`: {error}");
        VisionError { reason, ..error }
    })?;
    Ok(TargetReport {
        camera,
        pose,
        stamp,
        frame: number,
        carrier,
    })
}

/// The tasks of the three Tools of DiskFind; the catalog writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DiskFindArgs {
    snap: String,
    image_disp: String,
    disk: String,
}

/// The Service DiskFind: toolSnap, toolDiskFind, toolImageDisp.
#[derive(Debug)]
pub struct DiskFindService {
    args: DiskFindArgs,
}

impl DiskFindService {
    pub(crate) fn new(cx: &Context) -> Result<Self, HandlerError> {
        Ok(Self { args: cx.args()? })
    }
}

impl EventHandler for DiskFindService {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != DiskOffset::CODE {
            return cx.default_processing(message);
        }
        let tools = self.args.clone();
        answer::<DiskOffset, _, _>(cx, message, |cx, request| async move {
            Ok(find_disk(cx, tools, request).await)
        })
    }
}

async fn find_disk(
    cx: Context,
    tools: DiskFindArgs,
    DiskOffset { camera, taught }: DiskOffset,
) -> Result<DiskReport, VisionError> {
    let snap = Snap {
        camera: camera.clone(),
    };
    let frame = ask(&cx, &tools.snap, snap).await??;
    let (stamp, number) = (frame.stamp, frame.number);
    let request = LocateDisk {
        frame: frame.clone(),
        taught,
    };
    let located = ask(&cx, &tools.disk, request).await?;
    let drawing = match &located {
        Ok(disk) => drawn(disk),
        Err(error) => Drawing {
            said: error.reason.clone(),
            ..Drawing::default()
        },
    };
    let picture = ShowImage {
        camera: camera.clone(),
        frame,
        drawing,
    };
    // A dark monitor must not cost a measurement.
    if let Err(error) = ask(&cx, &tools.image_disp, picture).await {
        tracing::warn!(camera, %error, "picture not shown");
    }
    let disk = located.map_err(|error| {
        let reason = format!("camera `{camera}`: {error}");
        VisionError { reason, ..error }
    })?;
    Ok(DiskReport {
        camera,
        disk,
        stamp,
        frame: number,
    })
}

/// Corners of the ring around a disc, and how wide it is, px.
const CORNERS: u32 = 24;
const RING_PX: f64 = 2.0;
/// Its colour around a disc with a correction, and around an example.
const CORRECTED: [u8; 3] = [70, 200, 255];
const TAUGHT: [u8; 3] = [255, 150, 0];

/// A ring around a disc, and what it says to the hand.
fn drawn(disk: &DiskSight) -> Drawing {
    let Seen { u, v, radius } = disk.seen;
    let corners = (0..CORNERS).map(|corner| {
        let angle = TAU * f64::from(corner) / f64::from(CORNERS);
        [u + radius * angle.cos(), v + radius * angle.sin()]
    });
    let (colour, said) = match disk.correction {
        Some(Correction { by, .. }) => {
            // No zero has a sign.
            let [x, y] = by.map(|along| (along * 1e4).round() / 10.0 + 0.0);
            (CORRECTED, format!("move by {x:.1}, {y:.1} mm"))
        }
        None => (TAUGHT, format!("example {} of {EXAMPLES}", disk.examples)),
    };
    let outline = Outline {
        corners: corners.collect(),
        colour,
        strength: 1.0,
        width: RING_PX,
        text: String::new(),
    };
    Drawing {
        outlines: vec![outline],
        said,
    }
}

/// Calls a task by name; a refusal keeps the other's own words.
pub(crate) async fn ask<C: Command>(
    cx: &Context,
    task: &str,
    request: C,
) -> Result<C::Reply, VisionError> {
    let task = cx.task(task).await?;
    Ok(cx.call(&task, request).await?)
}

/// The Service Calibrate: a table of lights in, a camera with its uncertainty out.
#[derive(Debug)]
pub struct CalibrateService;

impl EventHandler for CalibrateService {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Calibrate::CODE => {
                let (request, reply) = message.open::<Calibrate>()?;
                let mut rng = ChaCha8Rng::seed_from_u64(request.seed);
                match calibrate(&request.points, request.width, request.height, &mut rng) {
                    Ok(calibration) => reply.ok(calibration),
                    Err(error) => reply.fail(format!("camera `{}`: {error}", request.camera)),
                }
            }
            _ => cx.default_processing(message),
        }
    }
}
