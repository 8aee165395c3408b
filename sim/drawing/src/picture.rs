//! A picture while it is drawn: which solid each pixel shows, how far it is, and its light.
//!
//! A pass finds the nearest solid of each pixel's centre, a second one shades it, and a third one gives pixels on edges what
//! each side covers of them: without that no edge would lie between pixels, and no centroid between them either.

use nalgebra::Vector3;

use crate::{
    raster::{Floor, Seen, Window},
    truth::CameraTruth,
};

/// What a pixel shows that shows nothing.
const SKY: u16 = 0;
const FLOOR: u16 = 1;
/// The first solid.
const SOLID: u16 = 2;

/// Points of a pixel at which is looked on edges, in sixteenths of a pixel: one in each column and row (van der Corput's
/// sequence). The first four are near the corners.
const POINTS: [[f64; 2]; 16] = [
    [0.0, 0.0],
    [15.0, 15.0],
    [3.0, 12.0],
    [12.0, 3.0],
    [1.0, 8.0],
    [2.0, 4.0],
    [4.0, 2.0],
    [5.0, 10.0],
    [6.0, 6.0],
    [7.0, 14.0],
    [8.0, 1.0],
    [9.0, 9.0],
    [10.0, 5.0],
    [11.0, 13.0],
    [13.0, 11.0],
    [14.0, 7.0],
];

/// After so many points that all show what the centre shows, a pixel counts as no edge.
const CORNERS: usize = 4;

/// What a camera sees before its lens blurs it and its sensor adds noise.
#[derive(Debug, Clone, Default)]
pub struct Picture {
    /// Grey levels, or those of red, green and blue, pixel by pixel.
    pub light: Vec<f32>,
    depth: Vec<f32>,
    /// What is seen: [`SKY`], [`FLOOR`], or a solid by index from [`SOLID`].
    shown: Vec<u16>,
    /// Light of pixels on edges, until all are known.
    edges: Vec<(usize, [f32; 3])>,
}

/// What is drawn, and from where.
pub struct View<'a> {
    /// The camera.
    pub camera: &'a CameraTruth,
    /// Unit direction of each pixel, camera frame.
    pub rays: &'a [Vector3<f64>],
    /// The floor below all.
    pub floor: &'a Floor,
    /// What stands on it, by index.
    pub solids: &'a [Seen],
    /// Channels of the picture: 1 or 3.
    pub channels: usize,
}

fn number(solid: usize) -> u16 {
    // Solids beyond the last number would share it: their edges against each other would be hard.
    u16::try_from(solid).map_or(u16::MAX, |solid| solid.saturating_add(SOLID))
}

fn solid(number: u16) -> Option<usize> {
    number.checked_sub(SOLID).map(usize::from)
}

impl Picture {
    /// Floor and sky.
    pub fn empty(&mut self, view: &View<'_>, tone: [f32; 3]) {
        let pixels = view.rays.len();
        self.depth.clear();
        self.shown.clear();
        self.light.clear();
        self.light.reserve(pixels * view.channels);
        for ray in view.rays {
            let (shown, depth, shade) = match view.floor.hit(ray) {
                Some(distance) => (FLOOR, distance, view.floor.shade(ray, distance)),
                None => (SKY, f64::INFINITY, 0.5),
            };
            self.shown.push(shown);
            self.depth.push(depth as f32);
            let levels = tone.iter().take(view.channels);
            self.light.extend(levels.map(|level| level * shade as f32));
        }
    }

    /// Becomes what another one is.
    pub fn begin_with(&mut self, other: &Self) {
        self.light.clone_from(&other.light);
        self.depth.clone_from(&other.depth);
        self.shown.clone_from(&other.shown);
    }

    /// Draws the solids from index `first` on.
    pub fn draw(&mut self, view: &View<'_>, first: usize) {
        let windows = || {
            let solids = view.solids.iter().enumerate().skip(first);
            solids.filter_map(|(index, solid)| {
                Some((number(index), solid, solid.window(view.camera)?))
            })
        };
        for (number, solid, window) in windows() {
            self.cover(view, (number, solid), &window);
        }
        for (number, solid, window) in windows() {
            self.shade(view, (number, solid), &window);
        }
        self.soften(view, number(first));
    }

    fn cover(&mut self, view: &View<'_>, (number, solid): (u16, &Seen), window: &Window) {
        for run in window.runs(view.camera.width) {
            let (Some(rays), Some(depth), Some(shown)) = (
                view.rays.get(run.clone()),
                self.depth.get_mut(run.clone()),
                self.shown.get_mut(run),
            ) else {
                return;
            };
            solid.hits(rays, |index, distance| {
                if (distance as f32) < depth[index] {
                    (depth[index], shown[index]) = (distance as f32, number);
                }
            });
        }
    }

    fn shade(&mut self, view: &View<'_>, (number, solid): (u16, &Seen), window: &Window) {
        let channels = view.channels;
        for run in window.runs(view.camera.width) {
            let light = channels * run.start..channels * run.end;
            let (Some(rays), Some(depth), Some(shown), Some(light)) = (
                view.rays.get(run.clone()),
                self.depth.get(run.clone()),
                self.shown.get(run),
                self.light.get_mut(light),
            ) else {
                return;
            };
            let pixels = rays.iter().zip(depth).zip(shown);
            for (((ray, depth), shown), light) in pixels.zip(light.chunks_exact_mut(channels)) {
                if *shown == number {
                    let shade = solid.shade(ray, f64::from(*depth)) as f32;
                    for (light, level) in light.iter_mut().zip(solid.tone) {
                        *light = level * shade;
                    }
                }
            }
        }
    }

    /// Gives pixels on edges what each side covers of them, where a solid from number `first` on has part in the edge.
    fn soften(&mut self, view: &View<'_>, first: u16) {
        let (width, height) = (view.camera.width, view.camera.height);
        let mut edges = std::mem::take(&mut self.edges);
        edges.clear();
        for row in 0..height {
            let above = row.saturating_sub(1) * width;
            let below = (row + 1).min(height - 1) * width;
            for column in 0..width {
                let (left, right) = (column.saturating_sub(1), (column + 1).min(width - 1));
                let own = row * width + column;
                let around = [
                    own,
                    row * width + left,
                    row * width + right,
                    above + left,
                    above + column,
                    above + right,
                    below + left,
                    below + column,
                    below + right,
                ];
                let shown = around.map(|at| self.shown[at]);
                if shown.iter().all(|other| *other == shown[0])
                    || shown.iter().all(|other| *other < first)
                {
                    continue;
                }
                if let Some(light) = self.mixed(view, &around, (left, right)) {
                    edges.push((own, light));
                }
            }
        }
        for (at, light) in &edges {
            let pixel = self.light[view.channels * at..].iter_mut();
            for (pixel, light) in pixel.take(view.channels).zip(light) {
                *pixel = *light;
            }
        }
        self.edges = edges;
    }

    /// The light of a pixel on an edge. Each side has the light of the nearest pixel of the nine that shows it, the first of
    /// which is the pixel itself. `None` when the edge is outside it.
    fn mixed(
        &self,
        view: &View<'_>,
        around: &[usize; 9],
        (left, right): (usize, usize),
    ) -> Option<[f32; 3]> {
        // What there is, where its light is, and how many points show it.
        let mut sides = [(SKY, 0, 0_u8); 9];
        let mut count = 0;
        for at in around {
            let shown = self.shown[*at];
            if sides[..count].iter().all(|side| side.0 != shown) {
                sides[count] = (shown, *at, 0);
                count += 1;
            }
        }
        let sides = &mut sides[..count];
        let own = around[0];
        let across = (view.rays[around[2]] - view.rays[around[1]]) / (right - left) as f64;
        let rows = (around[7] - around[4]) / view.camera.width;
        let down = (view.rays[around[7]] - view.rays[around[4]]) / rows as f64;
        for (turn, [u, v]) in POINTS.iter().enumerate() {
            let [u, v] = [u, v].map(|sixteenth| (sixteenth + 0.5) / 16.0 - 0.5);
            let ray = (view.rays[own] + across * u + down * v).normalize();
            let mut nearest = (f64::INFINITY, None);
            for (index, (shown, ..)) in sides.iter().enumerate() {
                let hit = match solid(*shown) {
                    Some(solid) => view.solids.get(solid).and_then(|solid| solid.hit(&ray)),
                    None if *shown == FLOOR => view.floor.hit(&ray),
                    None => None,
                };
                if let Some(distance) = hit.filter(|distance| *distance < nearest.0) {
                    nearest = (distance, Some(index));
                }
            }
            // What none of them hits is the sky, or what only the centre shows.
            let sky = || sides.iter().position(|side| side.0 == SKY);
            let index = nearest.1.or_else(sky).unwrap_or(0);
            sides[index].2 += 1;
            if turn + 1 == CORNERS && usize::from(sides[0].2) == CORNERS {
                return None;
            }
        }
        let mut light = [0.0; 3];
        for (_, at, points) in sides {
            let share = f32::from(*points) / POINTS.len() as f32;
            let levels = self.light[view.channels * *at..].iter();
            for (light, level) in light.iter_mut().zip(levels.take(view.channels)) {
                *light += share * level;
            }
        }
        Some(light)
    }
}
