//! Pictures of the scene: what a ceiling camera with a real lens and a noisy sensor would give.
//!
//! [`truth`] is the exact projection, `raster` what a ray meets, `lamp` the bright spot, `noise` the
//! sensor. This module knows no physics: a picture is made from a [`SceneState`] alone,
//! so it can be made in another process than the world's.

mod lamp;
mod noise;
mod raster;
pub mod truth;

use std::time::Duration;

pub use lamp::LampView;
use nalgebra::{Isometry3, Vector3};
pub use noise::Noise;
use vss::frame::Carried;

use self::{lamp::Spot, raster::Seen, truth::CameraTruth};
use crate::{
    cell::{CameraSpec, Cell},
    scene::{SceneLamp, SceneState},
    shapes::Shape,
};

impl CameraSpec {
    /// The camera as it truly is in `scene`.
    #[must_use]
    pub fn at(&self, scene: &SceneState) -> CameraTruth {
        let mut truth = self.truth.clone();
        if let Some((body, camera_t_body)) = &self.mount
            && let Some(body) = scene.bodies.get(*body)
        {
            truth.camera_t_world = camera_t_body * body.pose.inverse();
        }
        truth
    }
}

/// One camera of the cell, ready to take pictures.
///
/// What never moves (floor, furniture, pedestals) is drawn once, unless something carries the camera; a picture then
/// costs the bodies that move, each within the part of the picture it can be in, the lamps and the noise.
#[derive(Debug, Clone)]
pub struct Renderer {
    spec: CameraSpec,
    camera: CameraTruth,
    floor_grey: f64,
    rays: Vec<Vector3<f64>>,
    /// What never moves, each with the pose of its frame in the world.
    still_shapes: Vec<(Shape, Isometry3<f64>)>,
    still_light: Vec<f32>,
    still_depth: Vec<f32>,
    still: Vec<Seen>,
    /// Which bodies of a scene move.
    moving_bodies: Vec<usize>,
    moving: Vec<Seen>,
    light: Vec<f32>,
    depth: Vec<f32>,
    noise: Noise,
}

impl Renderer {
    /// A renderer for one camera of `cell`; `seed` fixes the image noise.
    #[must_use]
    pub fn new(cell: &Cell, camera: &CameraSpec, seed: u64) -> Self {
        let truth = camera.truth.clone();
        let start = cell.start();
        let (mut still_shapes, mut moving_bodies) = (Vec::new(), Vec::new());
        for (index, (spec, body)) in cell.bodies.iter().zip(&start.bodies).enumerate() {
            if spec.still {
                still_shapes.extend(body.shapes.iter().map(|shape| (*shape, body.pose)));
            } else {
                moving_bodies.push(index);
            }
        }
        let room = cell
            .room
            .iter()
            .map(|shape| (*shape, Isometry3::identity()));
        still_shapes.extend(room);
        let mut renderer = Self {
            rays: rays(&truth),
            floor_grey: cell.floor_grey,
            still_shapes,
            still_light: Vec::new(),
            still_depth: Vec::new(),
            still: Vec::new(),
            moving_bodies,
            moving: Vec::new(),
            light: Vec::new(),
            depth: Vec::new(),
            noise: Noise::new(seed, &truth.name, camera.read_noise, camera.shot_noise),
            camera: truth,
            spec: camera.clone(),
        };
        renderer.draw_still();
        renderer
    }

    /// The camera as it truly was at the last picture.
    #[must_use]
    pub fn truth(&self) -> &CameraTruth {
        &self.camera
    }

    /// How long the shutter is open.
    #[must_use]
    pub fn exposure(&self) -> Duration {
        self.spec.exposure
    }

    /// The link that carries the camera, where it is in `scene`; `None` in the room.
    #[must_use]
    pub fn carrier(&self, scene: &SceneState) -> Option<Carried> {
        let (body, _) = self.spec.mount?;
        let body = scene.bodies.get(body)?;
        Some(Carried {
            link: body.name.clone(),
            world_t_link: body.pose,
        })
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

    /// How this camera sees a lamp (by index), lit or not; `None` when its centre is outside the picture.
    pub fn lamp_view(&mut self, scene: &SceneState, lamp: usize) -> Option<LampView> {
        self.place(scene);
        let lamp = scene.lamps.get(lamp)?;
        let solids = self.still.iter().chain(&self.moving);
        self.spot(lamp).view(&self.camera, &lamp.centre, solids)
    }

    fn spot(&self, lamp: &SceneLamp) -> Spot {
        Spot {
            brightness: lamp.brightness,
            radius: lamp.radius,
            blur: self.spec.blur,
        }
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
        for lamp in scene.lamps.iter().filter(|lamp| lamp.on) {
            let spot = self.spot(lamp);
            let solids = self.still.iter().chain(&self.moving);
            spot.add(&mut self.light, &self.camera, &lamp.centre, solids);
        }
    }

    /// Puts the camera where it is, and what moves before it.
    fn place(&mut self, scene: &SceneState) {
        if self.spec.mount.is_some() {
            self.camera = self.spec.at(scene);
            self.draw_still();
        }
        let pose = self.camera.camera_t_world;
        self.moving.clear();
        for body in self
            .moving_bodies
            .iter()
            .filter_map(|index| scene.bodies.get(*index))
        {
            let seen = |shape| Seen::new(shape, &(pose * body.pose), &pose);
            self.moving.extend(body.shapes.iter().map(seen));
        }
    }

    fn draw_still(&mut self) {
        let pose = self.camera.camera_t_world;
        let shapes = self.still_shapes.iter();
        self.still.clear();
        self.still
            .extend(shapes.map(|(shape, at)| Seen::new(shape, &(pose * at), &pose)));
        self.still_light.clear();
        self.still_depth.clear();
        for ray in &self.rays {
            let floor = raster::floor(&pose, ray, self.floor_grey);
            let (depth, grey) = floor.unwrap_or((f64::INFINITY, self.floor_grey / 2.0));
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
