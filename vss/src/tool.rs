//! Tools: one step of a Service each. A Tool that needs hardware asks the Vision Module Manager for it, calls the
//! Vision Module, gives the hardware back, and gets the result directly from the Vision Module.

use std::collections::BTreeMap;

use ctos::{
    message::{Command, CommandInfo, Message},
    task::{Context, EventHandler, Handled, HandlerError},
};
use serde::Deserialize;

use crate::{
    command::{
        AcquireVm, DisplayImage, DisplayMark, LocateSpot, MarkSpot, Outcome, ReleaseVm, ShowImage,
        Snap, SnapNow, VisionError,
    },
    concurrent::answer,
    service::ask,
    spot::{SpotOptions, find_spot},
};

/// The commands of `vss.tool_snap`.
pub const SNAP_COMMANDS: &[CommandInfo] = &[Snap::INFO];
/// The commands of `vss.tool_image_disp`.
pub const IMAGE_DISP_COMMANDS: &[CommandInfo] = &[ShowImage::INFO];
/// The commands of `vss.tool_spot_find`.
pub const SPOT_FIND_COMMANDS: &[CommandInfo] = &[LocateSpot::INFO];
/// The commands of `vss.tool_spot_disp`.
pub const SPOT_DISP_COMMANDS: &[CommandInfo] = &[MarkSpot::INFO];

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
        answer::<ShowImage, _, _>(cx, message, |cx, ShowImage { camera, frame }| async move {
            Ok(with_vm(&cx, &vmm, &vm, DisplayImage { camera, frame }).await?)
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
        let found = find_spot(&frame.into_grey(), &self.options);
        reply.ok(found.map_err(VisionError::from))
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
