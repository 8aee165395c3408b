//! The picture of the wrist lamp: a small shining ball behind a lens that is never quite sharp.
//!
//! The ball's disc is cut into points of equal area; each point that no solid hides adds a Gaussian
//! point spread (which stands for the lens and for the area of a pixel) of its share of the light. A
//! lamp seen in full therefore has its spot centred where its centre projects, whatever the pixel grid.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};

use crate::{raster::Seen, truth::CameraTruth};

const RINGS: u32 = 5;
const PER_RING: u32 = 12;

/// The lamp before one camera.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    /// Grey levels of the shining surface.
    pub brightness: f64,
    /// Radius of the ball, m.
    pub radius: f64,
    /// Standard deviation of the point spread, px.
    pub blur: f64,
}

/// How a camera sees the lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LampView {
    /// Where the lamp's centre projects, px.
    pub centre: (f64, f64),
    /// The share of its disc that nothing hides, 0 to 1.
    pub visible: f64,
}

impl Spot {
    /// How `camera` sees the lamp at `centre` (m, world); `None` outside the picture.
    pub fn view<'a>(
        &self,
        camera: &CameraTruth,
        centre: &Point3<f64>,
        solids: impl Iterator<Item = &'a Seen> + Clone,
    ) -> Option<LampView> {
        let (u, v) = camera.project(centre)?;
        let (right, bottom) = (camera.width as f64 - 0.5, camera.height as f64 - 0.5);
        if !((-0.5..right).contains(&u) && (-0.5..bottom).contains(&v)) {
            return None;
        }
        let shining = self
            .points(camera, centre)
            .filter(|point| is_free(point, solids.clone()))
            .count();
        Some(LampView {
            centre: (u, v),
            visible: shining as f64 / f64::from(RINGS * PER_RING),
        })
    }

    /// Adds the spot to a picture with that many channels, in grey levels: the light is white.
    pub fn add<'a>(
        &self,
        (light, channels): (&mut [f32], usize),
        camera: &CameraTruth,
        centre: &Point3<f64>,
        solids: impl Iterator<Item = &'a Seen> + Clone,
    ) {
        let Some(area) = self.area(camera, centre) else {
            return;
        };
        let share = self.brightness * area / f64::from(RINGS * PER_RING);
        for point in self.points(camera, centre) {
            let place = camera.project(&(camera.camera_t_world.inverse() * Point3::from(point)));
            if let Some(place) = place
                && is_free(&point, solids.clone())
            {
                self.spread((light, channels), camera, place, share);
            }
        }
    }

    /// Points of the disc that the camera sees the ball as, camera frame.
    fn points(
        &self,
        camera: &CameraTruth,
        centre: &Point3<f64>,
    ) -> impl Iterator<Item = Vector3<f64>> + use<> {
        let centre = (camera.camera_t_world * centre).coords;
        let [right, down] = disc_axes(&centre);
        let radius = self.radius;
        (0..RINGS * PER_RING).map(move |index| {
            let (ring, step) = (f64::from(index / PER_RING), f64::from(index % PER_RING));
            let r = radius * ((ring + 0.5) / f64::from(RINGS)).sqrt();
            // Every other ring is turned by half a step: no direction of the disc is preferred.
            let angle = TAU * (step + (ring * 0.5).fract()) / f64::from(PER_RING);
            centre + (right * angle.cos() + down * angle.sin()) * r
        })
    }

    /// Area of the lamp's picture, px^2.
    fn area(&self, camera: &CameraTruth, centre: &Point3<f64>) -> Option<f64> {
        let middle = (camera.camera_t_world * centre).coords;
        let project = |point: Vector3<f64>| {
            camera.project(&(camera.camera_t_world.inverse() * Point3::from(point)))
        };
        let half = |axis: Vector3<f64>| {
            let (one, other) = (project(middle + axis)?, project(middle - axis)?);
            Some(((one.0 - other.0) / 2.0, (one.1 - other.1) / 2.0))
        };
        let [right, down] = disc_axes(&middle);
        let (a, b) = (half(right * self.radius)?, half(down * self.radius)?);
        Some(PI * (a.0 * b.1 - a.1 * b.0).abs())
    }

    fn spread(
        &self,
        (light, channels): (&mut [f32], usize),
        camera: &CameraTruth,
        place: (f64, f64),
        amount: f64,
    ) {
        let reach = (5.0 * self.blur).ceil();
        let peak = amount / (TAU * self.blur * self.blur);
        let bell = |distance: f64| (-0.5 * (distance / self.blur).powi(2)).exp();
        // A float becomes an index with saturation at 0, so a spot beyond the border is cut there.
        let span = |centre: f64, size: usize| {
            let first = (centre - reach).ceil() as usize;
            let end = ((centre + reach).floor() + 1.0) as usize;
            first..end.min(size).max(first)
        };
        for row in span(place.1, camera.height) {
            let across = peak * bell(row as f64 - place.1);
            let start = row * camera.width;
            let columns = span(place.0, camera.width);
            let run = channels * (start + columns.start)..channels * (start + columns.end);
            let pixels = light.get_mut(run).unwrap_or_default();
            for (column, pixel) in columns.zip(pixels.chunks_exact_mut(channels)) {
                let level = (across * bell(column as f64 - place.0)) as f32;
                pixel.iter_mut().for_each(|pixel| *pixel += level);
            }
        }
    }
}

/// Two unit vectors that span the plane across the line of sight to `centre`.
fn disc_axes(centre: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let sight = centre.normalize();
    let helper = if sight.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let one = sight.cross(&helper).normalize();
    [one, sight.cross(&one)]
}

/// Whether nothing stands between the camera and a point (camera frame).
fn is_free<'a>(point: &Vector3<f64>, mut solids: impl Iterator<Item = &'a Seen>) -> bool {
    let distance = point.norm();
    let ray = point / distance;
    !solids.any(|solid| solid.hit(&ray).is_some_and(|hit| hit < distance))
}
