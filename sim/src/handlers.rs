//! The simulator inside an app: the world's task, the channel driver and the frame source by name.
//!
//! The channel driver `sim.puma560` creates the world on its chassis; the task `sim.world` of the same
//! chassis shows it to others by message, so a camera may render on any chassis.

use std::sync::Arc;

use ctos::{
    Context,
    config::{App, Node},
    diagnostic::{Finding, Findings, Source},
    message::{Command, Message},
    registry::Registry,
    task::{EventHandler, Handled, HandlerError},
};
use futures_util::future::LocalBoxFuture;
use mcs::driver::{ChannelDriver, DriverRegistry};
use rand::Rng;
use serde::Deserialize;
use vss::{
    command::{NamedCamera, TrueCameras},
    frame::{Frame, FrameError},
    source::{FrameSource, FrameSources},
};

use crate::{
    camera::Renderer,
    cell::Cell,
    driver::SimArm,
    scene::{SceneReader, SceneState},
};

/// Name of the channel driver.
pub const ARM: &str = "sim.puma560";

/// Name of the frame source.
pub const CAMERA: &str = "sim.camera";

/// Name of the world's event handler.
pub const WORLD: &str = "sim.world";

/// What the world of a chassis is shared under.
const SHARED: &str = "sim.world";

ctos::command! {
    /// Asks what there is to see.
    #[derive(Debug, Clone, PartialEq)]
    pub struct GetScene => SceneState, 0x0501, "get_scene"
}
ctos::command! {
    /// Switches the wrist lamp.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SetLamp {
        /// Whether it shall shine.
        pub on: bool,
    } => (), 0x0502, "set_lamp"
}
/// Arguments that name a cell file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmArgs {
    /// Path of the cell file, relative to the configuration's folder.
    cell: String,
}

/// Arguments of a camera.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraArgs {
    /// Path of the cell file, relative to the configuration's folder.
    cell: String,
    /// The task that shows the world.
    #[serde(default = "world_task")]
    world: String,
}

fn world_task() -> String {
    "world".to_owned()
}

/// What the world's task needs of the world: shared on the chassis by the channel driver.
#[derive(Debug)]
struct SharedWorld {
    scene: SceneReader,
    cameras: Vec<NamedCamera>,
}

/// Registers everything that the simulator offers: the event handler [`WORLD`], the channel driver
/// [`ARM`] and the frame source [`CAMERA`].
pub fn register(registry: &mut Registry, drivers: &mut DriverRegistry, sources: &mut FrameSources) {
    register_world(registry);
    drivers
        .driver(ARM, open_arm)
        .check(|_, app, args, findings| check_arm(&|path| app.read(path), args, findings));
    sources.source(CAMERA, |cx, name, args| {
        let source: Box<dyn FrameSource> = Box::new(SimCamera::new(cx, name, args)?);
        Ok(source)
    });
    // A frame source's own check does not know the configuration's folder, where cell files are.
    registry.app_check("sim::cameras", |app, _, findings| {
        check_cameras(app, findings)
    });
}

fn register_world(registry: &mut Registry) {
    registry.handler(
        WORLD,
        &[GetScene::INFO, SetLamp::INFO, TrueCameras::INFO],
        |_| Ok(WorldTask),
    );
}

/// Checks every task that is a camera of this simulator, and that the task it asks is there.
fn check_cameras(app: &App, findings: &mut Findings) {
    for task in &app.tasks {
        let text = |key: &str| task.args.get(key).and_then(Node::as_str);
        let (Some(CAMERA), Some(camera)) = (text("source"), text("camera")) else {
            continue;
        };
        let args = task.args.get("args").cloned().unwrap_or_else(Node::table);
        check_camera(&|path| app.read(path), camera, &args, findings);
        let Ok(CameraArgs { world, .. }) = args.parse() else {
            continue;
        };
        if app.task(&world).is_none_or(|task| task.handler != WORLD) {
            let finding = Finding::error(
                "sim::camera::no_world",
                format!(
                    "camera `{camera}` asks `{world}`, which is no task with handler `{WORLD}`"
                ),
            )
            .help(format!(
                "add `[task.{world}]` with handler `{WORLD}` on the chassis of the servo, or say \
                 `world = \"NAME\"` in the camera's arguments"
            ));
            findings.push(finding.at(task.place.clone()));
        }
    }
}

/// Creates the arm and its world; the driver's arguments name the cell file.
///
/// # Errors
/// Bad arguments, a bad cell file, or a world already on this chassis.
pub fn open_arm(cx: &Context, args: &Node) -> Result<Box<dyn ChannelDriver>, HandlerError> {
    let ArmArgs { cell } = args.parse()?;
    let cell = Cell::read(&cx.app().file_at(&cell))?;
    let (arm, scene) = SimArm::new(ARM, &cell)?;
    let cameras = cell
        .cameras
        .into_iter()
        .map(|camera| camera.truth.named())
        .collect();
    cx.share(SHARED, Arc::new(SharedWorld { scene, cameras }));
    Ok(Box::new(arm))
}

/// How a check reads a file that the configuration names.
type ReadFile<'a> = &'a dyn Fn(&str) -> Result<Source, Finding>;

/// Checks the arguments of [`open_arm`] and the cell file they name.
fn check_arm(read: ReadFile<'_>, args: &Node, findings: &mut Findings) {
    if let Some(ArmArgs { cell }) = findings.keep(args.parse()) {
        check_cell(read, &cell, args, findings);
    }
}

/// Checks the arguments of a camera called `camera`, its cell file, and that the cell has it.
fn check_camera(read: ReadFile<'_>, camera: &str, args: &Node, findings: &mut Findings) {
    if let Some(CameraArgs { cell, .. }) = findings.keep(args.parse())
        && let Some(cell) = check_cell(read, &cell, args, findings)
        && let Err(finding) = cell.camera(camera)
    {
        findings.push(placed(finding, args));
    }
}

fn check_cell(
    read: ReadFile<'_>,
    cell: &str,
    args: &Node,
    findings: &mut Findings,
) -> Option<Cell> {
    let parsed = read(cell).map_err(Findings::from);
    match parsed.and_then(|source| Cell::parse(&source)) {
        Ok(cell) => Some(cell),
        Err(found) => {
            // A file that cannot be read has no place of its own: the key that names it has.
            for finding in found.into_sorted() {
                findings.push(placed(finding, args));
            }
            None
        }
    }
}

fn placed(finding: Finding, args: &Node) -> Finding {
    match (
        &finding.place,
        args.locate("cell").or_else(|| args.place().cloned()),
    ) {
        (None, Some(place)) => finding.at(place),
        _ => finding,
    }
}

/// The event handler `sim.world`.
#[derive(Debug)]
struct WorldTask;

impl WorldTask {
    /// The world is looked up for each message: the servo that creates it may start later than this
    /// task, and may be started again.
    fn world(cx: &Context) -> Result<Arc<SharedWorld>, HandlerError> {
        cx.shared(SHARED).ok_or_else(|| {
            HandlerError::new(format!(
                "there is no world on chassis `{}`: put task `{}` on the chassis whose servo has the \
                 channel driver `{ARM}`",
                cx.chassis().name(),
                cx.name(),
            ))
        })
    }
}

impl EventHandler for WorldTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            GetScene::CODE => {
                let (GetScene {}, reply) = message.open::<GetScene>()?;
                reply.ok(Self::world(cx)?.scene.latest())
            }
            SetLamp::CODE => {
                let (SetLamp { on }, reply) = message.open::<SetLamp>()?;
                Self::world(cx)?.scene.set_lamp(on);
                reply.ok(())
            }
            TrueCameras::CODE => {
                let (TrueCameras {}, reply) = message.open::<TrueCameras>()?;
                reply.ok(Self::world(cx)?.cameras.clone())
            }
            _ => cx.default_processing(message),
        }
    }
}

/// A camera of the cell as a source of frames: asks the world's task for the scene, then renders
/// here.
#[derive(Debug)]
pub struct SimCamera {
    name: String,
    world: String,
    renderer: Renderer,
    taken: u64,
}

impl SimCamera {
    /// The camera called `name` of the cell that `args` name.
    ///
    /// # Errors
    /// Bad arguments, a bad cell file or a camera that it does not have.
    pub fn new(cx: &Context, name: &str, args: &Node) -> Result<Self, HandlerError> {
        let CameraArgs { cell, world } = args.parse()?;
        let cell = Cell::read(&cx.app().file_at(&cell))?;
        let camera = cell.camera(name)?;
        let seed = cx.rng("image noise").next_u64();
        Ok(Self {
            name: name.to_owned(),
            world,
            renderer: Renderer::new(&cell, camera, seed),
            taken: 0,
        })
    }

    /// Takes a picture of the world as it is now.
    ///
    /// # Errors
    /// When the world's task does not answer.
    pub async fn take(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let fault = |reason: String| FrameError::Fault {
            camera: self.name.clone(),
            reason,
        };
        let world = cx
            .task(&self.world)
            .await
            .map_err(|error| fault(error.to_string()))?;
        let scene = cx
            .call(&world, GetScene {})
            .await
            .map_err(|error| fault(error.to_string()))?;
        let number = self.taken;
        self.taken += 1;
        let (width, height) = {
            let truth = self.renderer.truth();
            (truth.width, truth.height)
        };
        let mut pixels = vec![0; width * height];
        self.renderer.render_into(&scene, number, &mut pixels);
        Ok(Frame {
            width,
            height,
            pixels: pixels.into(),
            stamp: cx.now().since_start(),
            number,
        })
    }
}

impl FrameSource for SimCamera {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}

#[cfg(test)]
mod tests;
