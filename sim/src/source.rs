//! A camera of the cell as a source of frames: takes the scene from the world's snapshot buffer, or asks its task for it,
//! then renders here.

use ctos::{Context, config::Node, task::HandlerError};
use futures_util::future::LocalBoxFuture;
use rand::Rng;
use serde::Deserialize;
use vss::{
    frame::{Frame, FrameError},
    source::FrameSource,
};

use crate::{
    camera::Renderer, cell::Cell, scene::SceneState, scenes::SceneReader, world_task::GetScene,
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
}

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
    renderer: Renderer,
    taken: u64,
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
        } = args.parse()?;
        let cell = Cell::read(&cx.app().file_at(&cell))?;
        let camera = cell.camera(name)?;
        let seed = cx.rng("image noise").next_u64();
        Ok(Self {
            name: name.to_owned(),
            world,
            scenes: scenes.map(|buffer| SceneReader::new(&cx.app().name, &buffer)),
            renderer: Renderer::new(&cell, camera, seed),
            taken: 0,
        })
    }

    /// Takes a picture of the world as it is in the middle of the exposure, which begins now; its stamp is that of the
    /// scene.
    ///
    /// # Errors
    /// When the world's task does not answer, or leaves no scenes.
    pub async fn take(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let exposure = self.renderer.exposure();
        if !exposure.is_zero() {
            cx.sleep(exposure / 2).await;
        }
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
        let mut pixels = vec![0; width * height];
        self.renderer.render_into(&scene, number, &mut pixels);
        Ok(Frame {
            camera: self.name.clone(),
            number,
            stamp: scene.stamp,
            exposure,
            carrier: self.renderer.carrier(&scene),
            ..Frame::grey8(width, height, pixels)
        })
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
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}
