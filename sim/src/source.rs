//! A camera of the cell as a source of frames: takes the scene from the world's snapshot buffer, or asks its task for it,
//! then renders here.

use std::time::Duration;

use ctos::{Context, config::Node, task::HandlerError};
use futures_util::future::LocalBoxFuture;
use rand::Rng;
use serde::Deserialize;
use vss::{
    frame::{Frame, FrameError},
    source::FrameSource,
};

use crate::{
    camera::Renderer,
    cell::Cell,
    scene::{CameraFault, SceneState},
    scenes::SceneReader,
    world_task::GetScene,
};

/// Arguments of a camera.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraArgs {
    /// Path of the cell file, relative to the configuration's folder.
    pub cell: String,
    /// The task that owns the world.
    #[serde(default = "world_task")]
    pub world: String,
    /// The snapshot buffer in which the world leaves scenes, on this host; its task is asked when none is named.
    pub scenes: Option<String>,
    /// Whose clock its stamps are of.
    #[serde(default)]
    pub stamps: Stamps,
}

/// Whose clock the stamps of a camera are of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stamps {
    /// The world's, of the tick that left the scene.
    #[default]
    World,
    /// The camera's own, as of a real one: the middle of the exposure, up to a tick of the world after the scene.
    Camera,
}

/// By how much the stamps of a camera are ahead that jumps in time.
const JUMP: Duration = Duration::from_secs(3600);

/// The world's task when nobody says which.
pub fn world_task() -> String {
    "world".to_owned()
}

/// A simulated camera.
#[derive(Debug)]
pub struct SimCamera {
    name: String,
    world: String,
    scenes: Option<SceneReader>,
    stamps: Stamps,
    renderer: Renderer,
    taken: u64,
    /// Which camera of the cell it is.
    index: usize,
    /// The last frame without a fault.
    last: Option<Frame>,
}

impl SimCamera {
    /// The camera called `name` of the cell that `args` name.
    ///
    /// # Errors
    /// Bad arguments, a bad cell file or a camera that it does not have.
    pub fn new(cx: &Context, name: &str, args: &Node) -> Result<Self, HandlerError> {
        let CameraArgs {
            cell,
            world,
            scenes,
            stamps,
        } = args.parse()?;
        let cell = Cell::read(&cx.app().file_at(&cell))?;
        let camera = cell.camera(name)?;
        let mut cameras = cell.cameras.iter();
        let index = cameras.position(|camera| camera.truth.name == name);
        let index = index.unwrap_or(usize::MAX);
        let seed = cx.rng("image noise").next_u64();
        Ok(Self {
            name: name.to_owned(),
            world,
            scenes: scenes.map(|buffer| SceneReader::new(&cx.app().name, &buffer)),
            stamps,
            renderer: Renderer::new(&cell, camera, seed),
            taken: 0,
            index,
            last: None,
        })
    }

    /// Takes a picture of the world as it is in the middle of the exposure, which begins now; its stamp is that of the
    /// scene, or the moment by the clock here.
    ///
    /// # Errors
    /// When the world's task does not answer, or leaves no scenes.
    pub async fn take(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let exposure = self.renderer.exposure();
        if !exposure.is_zero() {
            cx.sleep(exposure / 2).await;
        }
        let middle = cx.now().since_start();
        let scene = self.scene(cx).await.map_err(|reason| FrameError::Fault {
            camera: self.name.clone(),
            reason,
        })?;
        if !exposure.is_zero() {
            cx.sleep(exposure / 2).await;
        }
        let number = self.taken;
        self.taken += 1;
        let (width, height) = {
            let truth = self.renderer.truth();
            (truth.width, truth.height)
        };
        let pixels = self.renderer.render(&scene, number);
        let frame = Frame {
            camera: self.name.clone(),
            number,
            stamp: match self.stamps {
                Stamps::World => scene.stamp,
                Stamps::Camera => middle,
            },
            exposure,
            carrier: self.renderer.carrier(&scene),
            format: self.renderer.format(),
            ..Frame::grey8(width, height, pixels)
        };
        let fault = scene.camera_faults.get(self.index).copied().flatten();
        Ok(match (fault, &self.last) {
            (Some(fault), Some(last)) => self.spoilt(fault, frame, last),
            (Some(fault), None) => self.spoilt(fault, frame.clone(), &frame),
            (None, _) => self.last.insert(frame).clone(),
        })
    }

    /// What a camera with a fault makes of a frame; `last` is the last one before the fault.
    fn spoilt(&self, fault: CameraFault, frame: Frame, last: &Frame) -> Frame {
        match fault {
            CameraFault::Freeze => Frame {
                pixels: last.pixels.clone(),
                ..frame
            },
            CameraFault::Repeat => last.clone(),
            CameraFault::Jump => Frame {
                stamp: frame.stamp + JUMP,
                ..frame
            },
            CameraFault::Shrink => {
                let height = frame.height / 2;
                let bytes = frame.width * height * frame.format.bytes();
                let kept = frame.pixels.iter().take(bytes).copied();
                Frame {
                    height,
                    pixels: kept.collect(),
                    ..frame
                }
            }
            CameraFault::Black => Frame {
                pixels: vec![0; frame.pixels.len()].into(),
                ..frame
            },
            CameraFault::Cover => Frame {
                pixels: self.renderer.covered(frame.number).into(),
                ..frame
            },
        }
    }

    /// The world as it is now. A record holds it, wherever it comes from.
    async fn scene(&mut self, cx: &Context) -> Result<SceneState, String> {
        if let Some(scenes) = &mut self.scenes {
            let read = || scenes.latest().map_err(|error| error.to_string());
            return cx.outside("the latest scene", read);
        }
        let world = cx.task(&self.world).await;
        let world = world.map_err(|error| error.to_string())?;
        let scene = cx.call(&world, GetScene {}).await;
        scene.map_err(|error| error.to_string())
    }
}

impl FrameSource for SimCamera {
    fn is_live(&self) -> bool {
        true
    }

    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}
