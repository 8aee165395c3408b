//! Pictures of the scene: what a ceiling camera with a real lens and a noisy sensor would give.
//!
//! [`truth`] is the exact projection, `raster` what a ray meets, `lamp` the bright spot, `noise` the
//! sensor. This module knows no physics: a picture is made from a [`SceneState`] alone,
//! so it can be made in another process than the world's.

mod lamp;
mod noise;
mod raster;
pub mod truth;

pub use lamp::LampView;
use nalgebra::Vector3;
pub use noise::Noise;

use self::{lamp::Spot, raster::Seen, truth::CameraTruth};
use crate::{
    cell::{CameraSpec, Cell},
    scene::SceneState,
    shapes::{self, ArmShape},
};

/// One camera of the cell, ready to take pictures.
///
/// What never moves (floor, furniture, pedestal) is drawn once; a picture then costs the moving
/// links, each within the part of the picture it can be in, the lamp and the noise.
#[derive(Debug, Clone)]
pub struct Renderer {
    camera: CameraTruth,
    rays: Vec<Vector3<f64>>,
    still_light: Vec<f32>,
    still_depth: Vec<f32>,
    still: Vec<Seen>,
    arm: Vec<ArmShape>,
    moving: Vec<Seen>,
    light: Vec<f32>,
    depth: Vec<f32>,
    spot: Spot,
    noise: Noise,
}

impl Renderer {
    /// A renderer for one camera of `cell`; `seed` fixes the image noise.
    #[must_use]
    pub fn new(cell: &Cell, camera: &CameraSpec, seed: u64) -> Self {
        let truth = camera.truth.clone();
        let (still_arm, arm): (Vec<_>, Vec<_>) = shapes::arm(&cell.lamp.offset, cell.lamp.radius)
            .into_iter()
            .partition(|part| part.link == 0);
        let pose = truth.camera_t_world;
        let still: Vec<Seen> = still_arm
            .iter()
            .map(|part| &part.shape)
            .chain(&cell.room)
            .map(|shape| Seen::new(shape, &pose, &pose))
            .collect();
        let mut renderer = Self {
            rays: rays(&truth),
            still_light: Vec::new(),
            still_depth: Vec::new(),
            still,
            moving: Vec::with_capacity(arm.len()),
            arm,
            light: Vec::new(),
            depth: Vec::new(),
            spot: Spot {
                brightness: cell.lamp.brightness,
                radius: cell.lamp.radius,
                blur: camera.blur,
            },
            noise: Noise::new(seed, &truth.name, camera.read_noise, camera.shot_noise),
            camera: truth,
        };
        renderer.draw_still(cell.floor_grey);
        renderer
    }

    /// The camera as it truly is.
    #[must_use]
    pub fn truth(&self) -> &CameraTruth {
        &self.camera
    }

    /// Frame `number` of `scene`: `width * height` grey values, first row first.
    pub fn render(&mut self, scene: &SceneState, number: u64) -> Vec<u8> {
        let mut pixels = vec![0; self.rays.len()];
        self.render_into(scene, number, &mut pixels);
        pixels
    }

    /// [`Self::render`] into memory of somebody else's, of `width * height` bytes.
    pub fn render_into(&mut self, scene: &SceneState, number: u64, pixels: &mut [u8]) {
        self.draw(scene);
        self.noise.expose(number, &self.light, pixels);
    }

    /// The picture before the sensor: grey levels without noise or rounding.
    pub fn light(&mut self, scene: &SceneState) -> &[f32] {
        self.draw(scene);
        &self.light
    }

    /// How this camera sees the lamp, lit or not; `None` when its centre is outside the picture.
    pub fn lamp_view(&mut self, scene: &SceneState) -> Option<LampView> {
        self.place(scene);
        let solids = self.still.iter().chain(&self.moving);
        self.spot.view(&self.camera, &scene.lamp, solids)
    }

    fn draw(&mut self, scene: &SceneState) {
        self.place(scene);
        self.light.clone_from(&self.still_light);
        self.depth.clone_from(&self.still_depth);
        for solid in &self.moving {
            draw_solid(
                solid,
                &self.camera,
                &self.rays,
                &mut self.light,
                &mut self.depth,
            );
        }
        if scene.lamp_on {
            let solids = self.still.iter().chain(&self.moving);
            self.spot
                .add(&mut self.light, &self.camera, &scene.lamp, solids);
        }
    }

    /// Puts the moving links before the camera.
    fn place(&mut self, scene: &SceneState) {
        let pose = self.camera.camera_t_world;
        self.moving.clear();
        for part in &self.arm {
            if let Some(link) = scene.links.get(part.link) {
                self.moving
                    .push(Seen::new(&part.shape, &(pose * link), &pose));
            }
        }
    }

    fn draw_still(&mut self, floor_grey: f64) {
        let pose = self.camera.camera_t_world;
        for ray in &self.rays {
            let (depth, grey) =
                raster::floor(&pose, ray, floor_grey).unwrap_or((f64::INFINITY, floor_grey / 2.0));
            self.still_light.push(grey as f32);
            self.still_depth.push(depth as f32);
        }
        for solid in &self.still {
            draw_solid(
                solid,
                &self.camera,
                &self.rays,
                &mut self.still_light,
                &mut self.still_depth,
            );
        }
    }
}

/// Unit direction of every pixel, camera frame.
fn rays(camera: &CameraTruth) -> Vec<Vector3<f64>> {
    (0..camera.height)
        .flat_map(|row| (0..camera.width).map(move |column| (column, row)))
        .map(|(column, row)| {
            // A cell with a pixel that no direction reaches is refused before it comes here; the
            // axis stands in so that the pixel still has a ray.
            camera
                .direction(column as f64, row as f64)
                .map_or_else(Vector3::z, |ray| ray.normalize())
        })
        .collect()
}

fn draw_solid(
    solid: &Seen,
    camera: &CameraTruth,
    rays: &[Vector3<f64>],
    light: &mut [f32],
    depth: &mut [f32],
) {
    let Some(window) = solid.window(camera) else {
        return;
    };
    for row in window.rows[0]..window.rows[1] {
        let start = row * camera.width;
        let run = start + window.columns[0]..start + window.columns[1];
        let (Some(rays), Some(light), Some(depth)) = (
            rays.get(run.clone()),
            light.get_mut(run.clone()),
            depth.get_mut(run),
        ) else {
            return;
        };
        for ((ray, light), depth) in rays.iter().zip(light).zip(depth) {
            if let Some(distance) = solid.hit(ray)
                && (distance as f32) < *depth
            {
                *depth = distance as f32;
                *light = solid.shade(ray, distance) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests;
