//! The picture of a lamp: a small shining ball behind a lens that is never quite sharp.
//!
//! The disc that a camera sees the ball as is cut into square cells about its centre, each with the part of it that the disc
//! covers. A cell that no solid hides adds a Gaussian point spread (which stands for the lens and for the area of a pixel) of
//! its light. Over the disc the projection is taken as even: its picture is an ellipse around the picture of the lamp's centre,
//! whatever the pixel grid. Spread along rows first and then along columns, a large lamp costs little more than its pixels.

use std::{f64::consts::TAU, ops::Range};

use nalgebra::{Matrix2, Point3, Vector2, Vector3};

use crate::{raster::Seen, truth::CameraTruth};

/// Cells of a lamp's shorter half-axis, at least.
const CELLS: f64 = 6.0;

/// Edge of a cell in point spreads, at most: what is not even in their sum is below 1e-12, and edges are 2 % wider.
const COARSEST: f64 = 0.75;

/// Point spreads beyond which there is no light.
const REACH: f64 = 5.0;

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
        solids: impl Iterator<Item = &'a Seen>,
    ) -> Option<LampView> {
        let (u, v) = camera.project(centre)?;
        let (right, bottom) = (camera.width as f64 - 0.5, camera.height as f64 - 0.5);
        if !((-0.5..right).contains(&u) && (-0.5..bottom).contains(&v)) {
            return None;
        }
        let mut visible = 1.0;
        if let Some(disc) = Disc::new(camera, centre, self.radius) {
            let before = disc.before(solids);
            let step = disc.shorter / CELLS;
            let (mut all, mut shining) = (0.0, 0.0);
            for down in cells(disc.half.y, step) {
                for right in cells(disc.half.x, step) {
                    let off = Vector2::new(right as f64, down as f64) * step;
                    let part = disc.covered(&off, step);
                    all += part;
                    if part > 0.0 && is_free(&disc.point(&off), &before) {
                        shining += part;
                    }
                }
            }
            visible = shining / all;
        }
        Some(LampView {
            centre: (u, v),
            visible,
        })
    }

    /// Adds the spot to a picture with that many channels, in grey levels: the light is white.
    pub fn add<'a>(
        &self,
        (light, channels): (&mut [f32], usize),
        camera: &CameraTruth,
        centre: &Point3<f64>,
        solids: impl Iterator<Item = &'a Seen>,
    ) {
        let Some(disc) = Disc::new(camera, centre, self.radius) else {
            return;
        };
        let before = disc.before(solids);
        let step = (disc.shorter / CELLS).min(COARSEST * self.blur);
        let across = Spread::new((disc.centre.x, disc.half.x), camera.width, step, self.blur);
        let along = Spread::new((disc.centre.y, disc.half.y), camera.height, step, self.blur);
        let mut row = vec![0.0_f32; camera.width];
        for (down, rows, down_weights) in along.cells() {
            row.fill(0.0);
            for (right, columns, weights) in across.cells() {
                let off = Vector2::new(right as f64, down as f64) * step;
                let part = disc.covered(&off, step);
                if part > 0.0 && is_free(&disc.point(&off), &before) {
                    let level = (self.brightness * part) as f32;
                    let pixels = row.get_mut(columns).unwrap_or_default();
                    for (pixel, weight) in pixels.iter_mut().zip(weights) {
                        *pixel += level * weight;
                    }
                }
            }
            for (at, weight) in rows.zip(down_weights) {
                let first = channels * (at * camera.width + across.pixels.start);
                let run = first..channels * (at * camera.width + across.pixels.end);
                let pixels = light.get_mut(run).unwrap_or_default();
                let levels = row.get(across.pixels.clone()).unwrap_or_default();
                for (pixel, level) in pixels.chunks_exact_mut(channels).zip(levels) {
                    pixel.iter_mut().for_each(|pixel| *pixel += level * weight);
                }
            }
        }
    }
}

/// The disc that a camera sees a ball as.
struct Disc {
    /// Its centre, camera frame, m.
    middle: Vector3<f64>,
    /// Two half-axes of it, camera frame, m.
    axes: [Vector3<f64>; 2],
    /// Where its centre projects, px.
    centre: Vector2<f64>,
    /// From pixels off the centre to parts of the axes.
    inverse: Matrix2<f64>,
    /// Half the width and the height of its picture, px.
    half: Vector2<f64>,
    /// The shorter half-axis of its picture, px.
    shorter: f64,
}

impl Disc {
    /// `None` when it has no picture.
    fn new(camera: &CameraTruth, centre: &Point3<f64>, radius: f64) -> Option<Self> {
        let (u, v) = camera.project(centre)?;
        let middle = (camera.camera_t_world * centre).coords;
        let back = camera.camera_t_world.inverse();
        let project = |point: Vector3<f64>| {
            let (u, v) = camera.project(&(back * Point3::from(point)))?;
            Some(Vector2::new(u, v))
        };
        let axes = disc_axes(&middle).map(|axis| axis * radius);
        let half =
            |axis: &Vector3<f64>| Some((project(middle + axis)? - project(middle - axis)?) / 2.0);
        let picture = Matrix2::from_columns(&[half(&axes[0])?, half(&axes[1])?]);
        let shorter = picture.singular_values().min();
        Some(Self {
            middle,
            axes,
            centre: Vector2::new(u, v),
            inverse: picture.try_inverse()?,
            half: Vector2::new(picture.row(0).norm(), picture.row(1).norm()),
            shorter,
        })
    }

    /// The part of a cell with edges of `step` that it covers, `off` its centre, px.
    fn covered(&self, off: &Vector2<f64>, step: f64) -> f64 {
        let place = self.inverse * off;
        let radius = place.norm();
        if radius < 0.5 {
            return 1.0;
        }
        // The distance from the edge to first order.
        let slope = self.inverse.tr_mul(&place).norm() / radius;
        (0.5 + (1.0 - radius) / (slope * step)).clamp(0.0, 1.0)
    }

    /// The point of it at `off` from its centre, px: camera frame, m.
    fn point(&self, off: &Vector2<f64>) -> Vector3<f64> {
        let place = self.inverse * off;
        self.middle + self.axes[0] * place.x + self.axes[1] * place.y
    }

    /// The solids that may hide a part of it.
    fn before<'a>(&self, solids: impl Iterator<Item = &'a Seen>) -> Vec<&'a Seen> {
        let radius = self.axes[0].norm();
        let near = |solid: &&Seen| {
            let (centre, reach) = solid.ball();
            // Between the camera and the disc.
            let part = centre.dot(&self.middle) / self.middle.norm_squared();
            let nearest = self.middle * part.clamp(0.0, 1.0);
            (centre - nearest).norm() <= reach + radius
        };
        solids.filter(near).collect()
    }
}

/// The numbers of the cells from `-half` to `half`, the middle one at 0.
fn cells(half: f64, step: f64) -> Range<i64> {
    let most = (half / step + 0.5).ceil() as i64;
    -most..most + 1
}

/// What each cell of one direction gives to the pixels around it.
struct Spread {
    /// For each cell its number, the first of its pixels, and how much of its light each of them gets.
    cells: Vec<(i64, usize, Vec<f32>)>,
    /// All of these pixels.
    pixels: Range<usize>,
}

impl Spread {
    /// Cells of a disc at `centre` that reaches `half` far, among `size` pixels.
    fn new((centre, half): (f64, f64), size: usize, step: f64, blur: f64) -> Self {
        let reach = (REACH * blur).ceil();
        let peak = step / (TAU.sqrt() * blur);
        let of = |number: i64| {
            let place = centre + number as f64 * step;
            // A float becomes an index with saturation at 0, so a spot beyond the border is cut there.
            let first = (place - reach).ceil() as usize;
            let end = ((place + reach).floor() + 1.0) as usize;
            let bell = |pixel: usize| {
                let far = (pixel as f64 - place) / blur;
                (peak * (-0.5 * far * far).exp()) as f32
            };
            let weights: Vec<f32> = (first..end.min(size)).map(bell).collect();
            (number, first, weights)
        };
        // Only cells whose light reaches the picture: a lamp can be larger than that.
        let outermost = cells(half, step);
        let first = ((-reach - centre) / step).floor() as i64;
        let last = ((size as f64 + reach - centre) / step).ceil() as i64;
        let inside = outermost.start.max(first)..outermost.end.min(last + 1);
        let cells: Vec<_> = inside.map(of).filter(|cell| !cell.2.is_empty()).collect();
        let start = cells.first().map_or(0, |(_, first, _)| *first);
        let end = cells
            .last()
            .map_or(0, |(_, first, weights)| first + weights.len());
        Self {
            cells,
            pixels: start..end.max(start),
        }
    }

    fn cells(&self) -> impl Iterator<Item = (i64, Range<usize>, &[f32])> {
        let cells = self.cells.iter();
        cells.map(|(number, first, weights)| (*number, *first..first + weights.len(), &**weights))
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
fn is_free(point: &Vector3<f64>, solids: &[&Seen]) -> bool {
    let distance = point.norm();
    let ray = point / distance;
    let hides = |solid: &&Seen| solid.hit(&ray).is_some_and(|hit| hit < distance);
    !solids.iter().any(hides)
}
