//! Pictures of the scene: what a ceiling camera with a real lens and a noisy sensor would give.
//!
//! [`truth`] is the exact projection, `raster` what a ray meets, `picture` what each pixel shows of it, `lamp` the bright
//! spot, `noise` the sensor. This module knows no physics: a picture is made from a [`SceneState`] alone,
//! so it can be made in another process than the world's.

use std::time::Duration;

use nalgebra::{Isometry3, Point3, Vector3};
use vss_tools::{
    frame::{Carried, PixelFormat},
    laser::Beam,
};

use crate::{
    cell::{CameraSpec, Cell},
    scene::{SceneBeam, SceneLamp, SceneState},
    shapes::{Paint, Shape},
};
pub use sim_drawing::{lamp::LampView, noise::Noise, truth};
use sim_drawing::{
    lamp::Spot,
    picture::{Picture, View},
    raster::{self, Floor, Seen},
    rays::Rays,
    truth::CameraTruth,
};

/// What little light comes through what covers a lens, grey levels.
const COVERED: f32 = 18.0;

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
    rays: Rays,
    /// What never moves, each with the pose of its frame in the world.
    still_shapes: Vec<(Shape, Isometry3<f64>)>,
    still: Picture,
    /// Which bodies of a scene move.
    moving_bodies: Vec<usize>,
    /// All that can be seen, what never moves first.
    solids: Vec<Seen>,
    now: Picture,
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
        let room = cell.room.iter().chain(&cell.marks);
        still_shapes.extend(room.map(|shape| (*shape, Isometry3::identity())));
        let mut renderer = Self {
            rays: Rays::new(&truth),
            floor_grey: cell.floor_grey,
            still_shapes,
            still: Picture::default(),
            moving_bodies,
            solids: Vec::new(),
            now: Picture::default(),
            noise: Noise::new(seed, &truth.name, camera.read_noise, camera.shot_noise),
            camera: truth,
            spec: camera.clone(),
        };
        renderer.draw_still();
        renderer
    }

    /// What the bytes of its pictures are.
    #[must_use]
    pub fn format(&self) -> PixelFormat {
        if self.spec.colour {
            PixelFormat::Rgb8
        } else {
            PixelFormat::Grey8
        }
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

    /// Frame `number` of `scene`: `width * height` grey values, or three times as many of red, green and blue, first row
    /// first.
    pub fn render(&mut self, scene: &SceneState, number: u64) -> Vec<u8> {
        let mut pixels = vec![0; self.rays.all().len() * self.format().bytes()];
        self.render_into(scene, number, &mut pixels);
        pixels
    }

    /// [`Self::render`] into memory of somebody else's, of as many bytes.
    pub fn render_into(&mut self, scene: &SceneState, number: u64, pixels: &mut [u8]) {
        self.draw(scene);
        self.noise.expose(number, &self.now.light, pixels);
    }

    /// Frame `number` of a camera whose lens is covered: noise on an even grey.
    #[must_use]
    pub fn covered(&self, number: u64) -> Vec<u8> {
        let light = vec![COVERED; self.rays.all().len() * self.format().bytes()];
        let mut pixels = vec![0; light.len()];
        self.noise.clone().expose(number, &light, &mut pixels);
        pixels
    }

    /// The picture before the sensor: levels without noise or rounding, in the order of [`Self::render`].
    pub fn light(&mut self, scene: &SceneState) -> &[f32] {
        self.draw(scene);
        &self.now.light
    }

    /// How this camera sees a lamp (by index), lit or not; `None` when its centre is outside the picture.
    pub fn lamp_view(&mut self, scene: &SceneState, lamp: usize) -> Option<LampView> {
        self.place(scene);
        let lamp = scene.lamps.get(lamp)?;
        let solids = self.solids.iter();
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
        let mut now = std::mem::take(&mut self.now);
        if self.spec.mount.is_some() {
            // What was drawn for this picture alone.
            std::mem::swap(&mut now, &mut self.still);
        } else {
            now.begin_with(&self.still);
        }
        let floor = Floor::new(&self.camera.camera_t_world);
        let still = self.still_shapes.len();
        now.draw(&self.view(&floor), still);
        if scene.light.to_bits() != 1.0_f64.to_bits() {
            let share = scene.light as f32;
            now.light.iter_mut().for_each(|level| *level *= share);
        }
        for lamp in scene.lamps.iter().filter(|lamp| lamp.on) {
            let spot = self.spot(lamp);
            let picture = (now.light.as_mut_slice(), self.format().bytes());
            spot.add(picture, &self.camera, &lamp.centre, self.solids.iter());
        }
        for beam in &scene.beams {
            self.shine(beam, &mut now.light);
        }
        self.now = now;
    }

    /// Adds the spot of a beam to a picture, where it meets the first thing.
    fn shine(&self, beam: &SceneBeam, light: &mut [f32]) {
        let Some(place) = self.meets(&beam.beam) else {
            return;
        };
        let spot = Spot {
            brightness: beam.brightness,
            radius: beam.radius,
            blur: self.spec.blur,
        };
        // What it lies on does not hide it.
        let eye = self.camera.position();
        let near = place + (eye - place).normalize() * (2.0 * beam.radius);
        let centre = self.camera.camera_t_world * near;
        let distance = centre.coords.norm();
        let hidden = |solid: &Seen| {
            let hit = solid.hit(&(centre.coords / distance));
            hit.is_some_and(|hit| hit < distance)
        };
        if !self.solids.iter().any(hidden) {
            let picture = (light, self.format().bytes());
            spot.add(picture, &self.camera, &place, std::iter::empty());
        }
    }

    /// Where a beam meets the first thing that this camera knows of: floor or solid; `None` when it meets nothing.
    fn meets(&self, beam: &Beam) -> Option<Point3<f64>> {
        // A camera that looks along the beam from its origin.
        let helper = if beam.direction.x.abs() < 0.9 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let ahead = beam.origin + beam.direction.into_inner();
        let along = CameraTruth::pose(&beam.origin, &ahead, &helper)?;
        let back = along * self.camera.camera_t_world.inverse();
        let floor = Floor::new(&along);
        let hits = self.solids.iter().filter_map(|solid| solid.hit_from(&back));
        let nearest = hits
            .chain(floor.hit(&Vector3::z()))
            .min_by(f64::total_cmp)?;
        Some(beam.origin + beam.direction.into_inner() * nearest)
    }

    fn view<'a>(&'a self, floor: &'a Floor) -> View<'a> {
        View {
            camera: &self.camera,
            rays: &self.rays,
            floor,
            floor_tone: raster::tone(Paint::Grey(self.floor_grey), self.spec.colour),
            solids: &self.solids,
            channels: self.format().bytes(),
        }
    }

    /// Puts the camera where it is, and what moves before it.
    fn place(&mut self, scene: &SceneState) {
        if self.spec.mount.is_some() {
            self.camera = self.spec.at(scene);
            self.draw_still();
        }
        let (pose, colour) = (self.camera.camera_t_world, self.spec.colour);
        self.solids.truncate(self.still_shapes.len());
        for body in self
            .moving_bodies
            .iter()
            .filter_map(|index| scene.bodies.get(*index))
        {
            let seen = |shape| Seen::new(shape, &(pose * body.pose), &pose, colour);
            self.solids.extend(body.shapes.iter().map(seen));
        }
    }

    fn draw_still(&mut self) {
        let (pose, colour) = (self.camera.camera_t_world, self.spec.colour);
        let shapes = self.still_shapes.iter();
        self.solids.clear();
        self.solids
            .extend(shapes.map(|(shape, at)| Seen::new(shape, &(pose * at), &pose, colour)));
        let mut still = std::mem::take(&mut self.still);
        let floor = Floor::new(&pose);
        let view = self.view(&floor);
        still.draw_all(&view);
        if self.spec.mount.is_none() {
            still.measure_all(&view);
        }
        self.still = still;
    }
}

#[cfg(test)]
mod tests;
