//! A camera of the cell as a source of frames: asks the world's task for the scene, then renders here.

use ctos::{Context, config::Node, task::HandlerError};
use futures_util::future::LocalBoxFuture;
use rand::Rng;
use serde::Deserialize;
use vss::{
    frame::{Frame, FrameError},
    source::FrameSource,
};

use crate::{camera::Renderer, cell::Cell, world_task::GetScene};

/// Arguments of a camera.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraArgs {
    /// Path of the cell file, relative to the configuration's folder.
    pub cell: String,
    /// The task that owns the world.
    #[serde(default = "world_task")]
    pub world: String,
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

    /// Takes a picture of the world as it is now; its stamp is that of the scene.
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
            stamp: scene.stamp,
            number,
        })
    }
}

impl FrameSource for SimCamera {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}
