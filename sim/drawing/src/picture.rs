//! A picture while it is drawn: which solid each pixel shows, how far it is, and its light.
//!
//! A pass finds the nearest solid of each pixel's centre, a second one shades it, and a third one gives pixels on edges what
//! each side covers of them: without that no edge would lie between pixels, and no centroid between them either.

use nalgebra::Vector3;

use crate::{
    raster::{Face, Floor, Plane, Seen},
    rays::{Rays, Tile},
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

/// Pixels of a row that are looked at together for edges.
const STRETCH: usize = 32;

/// What was done in a tile.
#[derive(Debug, Clone, Copy, Default)]
struct Drawn {
    /// Whether any pixel shows something new.
    is_drawn: bool,
    /// What has one face behind all pixels, and how much of its tone that shows.
    face: Option<(u16, f64)>,
    /// Whether nothing else is seen there.
    is_whole: bool,
}

/// What a camera sees before its lens blurs it and its sensor adds noise.
#[derive(Debug, Clone, Default)]
pub struct Picture {
    /// Grey levels, or those of red, green and blue, pixel by pixel.
    pub light: Vec<f32>,
    depth: Vec<f32>,
    /// The plane that fills a tile, as long as nobody has asked for the depth of its pixels.
    unmeasured: Vec<Option<Plane>>,
    /// What is seen: [`SKY`], [`FLOOR`], or a solid by index from [`SOLID`].
    shown: Vec<u16>,
    /// Light of pixels on edges, until all are known.
    edges: Vec<(usize, [f32; 3])>,
}

/// What is drawn, and from where.
pub struct View<'a> {
    /// The camera.
    pub camera: &'a CameraTruth,
    /// The directions of its pixels.
    pub rays: &'a Rays,
    /// The floor below all.
    pub floor: &'a Floor,
    /// What the floor reflects in each channel.
    pub floor_tone: [f32; 3],
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

/// What fills a tile with one face, if `met` are all the solids that its rays may meet.
fn alone(view: &View<'_>, tile: &Tile, met: &[(usize, &Seen)]) -> Option<(u16, Face)> {
    if met.is_empty() {
        return view.floor.face(tile).map(|face| (FLOOR, face));
    }
    let floor = view.floor.plane();
    let faces = met.iter().filter_map(|(index, solid)| {
        let face = solid.face(tile)?;
        Some((*index, face))
    });
    let is_first = |(index, face): &(usize, Face)| {
        let mut others = met.iter().filter(|(other, _)| other != index);
        face.plane.is_before(&floor, tile) && others.all(|(_, other)| other.is_behind(&face.plane))
    };
    let (index, face) = faces.into_iter().find(is_first)?;
    Some((number(index), face))
}

impl Picture {
    /// Floor and sky, and what stands there.
    pub fn draw_all(&mut self, view: &View<'_>) {
        let pixels = view.rays.all().len();
        self.shown.resize(pixels, SKY);
        self.depth.resize(pixels, f32::INFINITY);
        self.light.resize(pixels * view.channels, 0.0);
        let drawn = self.cover_all(view);
        self.shade(view, SKY, &drawn);
        self.soften(view, SOLID, &drawn);
    }

    /// Finds all depths, for a picture that others begin with.
    pub fn measure_all(&mut self, view: &View<'_>) {
        for (index, tile) in view.rays.tiles().iter().enumerate() {
            self.measure(index, tile, view.rays.all());
        }
    }

    /// Becomes what another one is.
    pub fn begin_with(&mut self, other: &Self) {
        self.light.clone_from(&other.light);
        self.depth.clone_from(&other.depth);
        self.shown.clone_from(&other.shown);
        self.unmeasured.clone_from(&other.unmeasured);
    }

    /// Draws the solids from index `first` on.
    pub fn draw(&mut self, view: &View<'_>, first: usize) {
        let drawn = self.cover(view, first);
        self.shade(view, number(first), &drawn);
        self.soften(view, number(first), &drawn);
    }

    /// Finds the depths of a tile that one plane fills.
    fn measure(&mut self, index: usize, tile: &Tile, rays: &[Vector3<f64>]) {
        let Some(plane) = self.unmeasured[index].take() else {
            return;
        };
        for run in &tile.runs {
            let pixels = self.depth[run.clone()].iter_mut().zip(&rays[run.clone()]);
            for (depth, ray) in pixels {
                *depth = plane.distance(ray) as f32;
            }
        }
    }

    /// Finds the nearest of floor, sky and all solids of each pixel; what there is in each tile.
    fn cover_all(&mut self, view: &View<'_>) -> Vec<Drawn> {
        let (rays, tiles) = (view.rays.all(), view.rays.tiles());
        let solids = view.solids.iter().enumerate();
        let solids: Vec<_> = solids
            .filter(|(_, solid)| !solid.is_around_the_eye())
            .collect();
        self.unmeasured.clear();
        let mut met = Vec::with_capacity(solids.len());
        let each = tiles.iter().enumerate().map(|(index, tile)| {
            met.clear();
            met.extend(solids.iter().filter(|(_, solid)| solid.may_meet(tile)));
            let alone = alone(view, tile, &met);
            self.unmeasured.push(alone.map(|(_, face)| face.plane));
            let mut drawn = Drawn {
                is_drawn: true,
                face: alone.map(|(number, face)| (number, face.shade)),
                is_whole: alone.is_some(),
            };
            if let Some((number, _)) = alone {
                for run in &tile.runs {
                    self.shown[run.clone()].fill(number);
                }
                return drawn;
            }
            for at in tile.runs.iter().cloned().flatten() {
                let hit = view.floor.hit(&rays[at]);
                self.shown[at] = if hit.is_some() { FLOOR } else { SKY };
                self.depth[at] = hit.map_or(f32::INFINITY, |distance| distance as f32);
            }
            for (solid, seen) in &met {
                self.cover_tile((index, tile), rays, (number(*solid), seen), &mut drawn);
            }
            drawn
        });
        each.collect()
    }

    /// Finds the nearest solid from index `first` on of each pixel; what it did in each tile.
    fn cover(&mut self, view: &View<'_>, first: usize) -> Vec<Drawn> {
        let (rays, tiles) = (view.rays.all(), view.rays.tiles());
        let mut all = vec![Drawn::default(); tiles.len()];
        let solids = view.solids.iter().enumerate().skip(first);
        for (index, solid) in solids.filter(|(_, solid)| !solid.is_around_the_eye()) {
            let number = number(index);
            let met = tiles.iter().enumerate().zip(&mut all);
            for (tile, drawn) in met.filter(|((_, tile), _)| solid.may_meet(tile)) {
                self.cover_tile(tile, rays, (number, solid), drawn);
            }
        }
        all
    }

    /// Finds where a solid that may meet a tile is nearer than what is there.
    fn cover_tile(
        &mut self,
        (index, tile): (usize, &Tile),
        rays: &[Vector3<f64>],
        (number, solid): (u16, &Seen),
        drawn: &mut Drawn,
    ) {
        self.measure(index, tile, rays);
        let face = solid.face(tile);
        if let Some(face) = face {
            drawn.face = Some((number, face.shade));
        }
        for run in &tile.runs {
            let depth = &mut self.depth[run.clone()];
            let shown = &mut self.shown[run.clone()];
            let rays = &rays[run.clone()];
            let found = |index: usize, distance: f64| {
                if (distance as f32) < depth[index] {
                    (depth[index], shown[index]) = (distance as f32, number);
                    drawn.is_drawn = true;
                }
            };
            match face {
                Some(face) => face.hits(rays, found),
                None => solid.hits(rays, found),
            }
        }
    }

    /// Gives each pixel of a tile in which something was drawn its light, if it shows `first` or what has a larger number.
    fn shade(&mut self, view: &View<'_>, first: u16, drawn: &[Drawn]) {
        let rays = view.rays.all();
        let tiles = view.rays.tiles().iter().zip(drawn);
        for (tile, drawn) in tiles.filter(|(_, drawn)| drawn.is_drawn) {
            if let (true, Some((number, shade))) = (drawn.is_whole, drawn.face) {
                let seen = solid(number).and_then(|one| view.solids.get(one));
                let tone = seen.map_or(view.floor_tone, |solid| solid.tone);
                let levels = tone.map(|level| level * shade as f32);
                for run in &tile.runs {
                    let light = &mut self.light[view.channels * run.start..view.channels * run.end];
                    for pixel in light.chunks_exact_mut(view.channels) {
                        pixel.copy_from_slice(&levels[..view.channels]);
                    }
                }
                continue;
            }
            for at in tile.runs.iter().cloned().flatten() {
                let shown = self.shown[at];
                if shown < first {
                    continue;
                }
                let (tone, shade) = match (
                    solid(shown).and_then(|one| view.solids.get(one)),
                    drawn.face,
                ) {
                    (Some(solid), Some((number, shade))) if number == shown => (solid.tone, shade),
                    (Some(solid), _) => {
                        let depth = f64::from(self.depth[at]);
                        (solid.tone, solid.shade(&rays[at], depth))
                    }
                    (None, _) => {
                        let hit = view.floor.hit(&rays[at]);
                        let shade = hit.map_or(0.5, |far| view.floor.shade(&rays[at], far));
                        (view.floor_tone, shade)
                    }
                };
                let light = self.light[view.channels * at..].iter_mut();
                for (light, level) in light.take(view.channels).zip(tone) {
                    *light = level * shade as f32;
                }
            }
        }
    }

    /// Gives pixels on edges what each side covers of them, where a solid from number `first` on has part in the edge.
    fn soften(&mut self, view: &View<'_>, first: u16, drawn: &[Drawn]) {
        let (width, height) = (view.camera.width, view.camera.height);
        let mut edges = std::mem::take(&mut self.edges);
        edges.clear();
        let mut differ = Vec::with_capacity(width);
        // Rows of tiles in which something was drawn, and their neighbours. What fills a tile and those around it has no edge.
        let mut touched = vec![false; height];
        let across = view.rays.across();
        let is_even = |index: usize| {
            let whole = |index: usize| drawn[index].face.filter(|_| drawn[index].is_whole);
            let number = |index: usize| whole(index).map(|(number, _)| number);
            let left = if index.is_multiple_of(across) {
                index
            } else {
                index - 1
            };
            let above = index.checked_sub(across).unwrap_or(index);
            number(index).is_some_and(|own| [left, above].map(number) == [Some(own); 2])
        };
        let tiles = view.rays.tiles().iter().zip(drawn).enumerate();
        let edged = tiles.filter(|(index, (_, drawn))| drawn.is_drawn && !is_even(*index));
        for (_, (tile, _)) in edged {
            let rows = tile.runs.iter().map(|run| run.start / width);
            for row in rows.flat_map(|row| row.saturating_sub(1)..(row + 2).min(height)) {
                touched[row] = true;
            }
        }
        for row in (0..height).filter(|row| touched[*row]) {
            let above = row.saturating_sub(1) * width;
            let below = (row + 1).min(height - 1) * width;
            // Most of a picture has no edge: columns in which the three rows differ, or the next column does.
            let three = self.shown[row * width..].iter();
            let three = three.zip(&self.shown[above..]).zip(&self.shown[below..]);
            differ.clear();
            differ.extend(
                three
                    .take(width)
                    .map(|((own, above), below)| own ^ above | own ^ below),
            );
            let own = &self.shown[row * width..][..width];
            for (differ, pair) in differ.iter_mut().zip(own.windows(2)) {
                *differ |= pair[0] ^ pair[1];
            }
            // Whole stretches without an edge are passed at once.
            let stretches = (0..width).step_by(STRETCH).filter(|from| {
                let beside = from.saturating_sub(1)..(from + STRETCH + 1).min(width);
                differ[beside].iter().fold(0, |all, differ| all | differ) != 0
            });
            for column in stretches.flat_map(|from| from..(from + STRETCH).min(width)) {
                let (left, right) = (column.saturating_sub(1), (column + 1).min(width - 1));
                if differ[left] | differ[column] | differ[right] == 0 {
                    continue;
                }
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
        let (own, rays) = (around[0], view.rays.all());
        let across = (rays[around[2]] - rays[around[1]]) / (right - left) as f64;
        let rows = (around[7] - around[4]) / view.camera.width;
        let down = (rays[around[7]] - rays[around[4]]) / rows as f64;
        for (turn, [u, v]) in POINTS.iter().enumerate() {
            let [u, v] = [u, v].map(|sixteenth| (sixteenth + 0.5) / 16.0 - 0.5);
            let ray = (rays[own] + across * u + down * v).normalize();
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

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3};
    use proptest::prelude::*;

    use super::*;
    use crate::{
        raster::tone,
        shapes::{Paint, Shape, Solid},
        truth::Distortion,
    };

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn every_pixel_shows_the_nearest_of_all_and_knows_its_depth_whatever_fills_tiles(
            eye in prop::array::uniform3(-1.0..1.0_f64), at in prop::array::uniform3(-0.3..0.3_f64), radius in 0.01..0.2_f64,
        ) {
            let distortion = Distortion { k1: -0.15, k2: 0.04, p1: 5e-4, p2: -5e-4, k3: 0.0 };
            let position = Point3::new(eye[0], eye[1], 1.3 + eye[2]);
            let camera = CameraTruth {
                name: "c".into(),
                width: 120,
                height: 90,
                focal: [110.0, 111.0],
                principal: [61.0, 44.0],
                distortion,
                camera_t_world: CameraTruth::pose(&position, &at.into(), &nalgebra::Vector3::new(0.1, 1.0, 0.0)).unwrap(),
                valid_radius: distortion.monotonic_radius(),
            };
            // A table, a board on it, paint on that, and what lies and hangs there.
            let block = |half: [f64; 3]| Solid::Block { centre: Point3::origin(), half: half.into() };
            let disc = Solid::Disc { centre: Point3::origin(), normal: nalgebra::Vector3::z(), radius };
            let ball = Solid::Capsule { a: Point3::origin(), b: Point3::origin(), radius };
            let solids = [
                (block([0.6, 0.4, 0.02]), [0.0, 0.0, 0.02]),
                (block([0.3, 0.3, 0.01]), [0.1, 0.0, 0.05]),
                (disc, [0.1, 0.0, 0.06]),
                (Solid::Cylinder { half: 0.01, radius: 0.05 }, [at[0], at[1], 0.07]),
                (ball, [at[1], at[0], 0.3]),
                (block([0.05, 0.2, 0.01]), [at[0], at[1], 0.045]),
            ];
            let pose = camera.camera_t_world;
            let seen = solids.map(|(solid, [x, y, z])| {
                let shape = Shape { solid, paint: Paint::Grey(100.0) };
                Seen::new(&shape, &(pose * Isometry3::translation(x, y, z)), &pose, false)
            });
            let (rays, floor) = (Rays::new(&camera), Floor::new(&pose));
            let view = View {
                camera: &camera,
                rays: &rays,
                floor: &floor,
                floor_tone: tone(Paint::Grey(50.0), false),
                solids: &seen,
                channels: 1,
            };
            let mut picture = Picture::default();
            picture.draw_all(&view);
            picture.measure_all(&view);
            for (at, ray) in rays.all().iter().enumerate() {
                let hit = floor.hit(ray);
                let mut nearest = hit.map_or((f32::INFINITY, SKY), |far| (far as f32, FLOOR));
                for (index, solid) in seen.iter().enumerate().filter(|(_, solid)| !solid.is_around_the_eye()) {
                    if let Some(far) = solid.hit(ray).filter(|far| (*far as f32) < nearest.0) {
                        nearest = (far as f32, number(index));
                    }
                }
                prop_assert_eq!((picture.depth[at], picture.shown[at]), nearest);
            }
            // What is even in its light is so without tiles too: the edges are softened, and nothing else.
            let mut shaded = picture.clone();
            let all = Drawn { is_drawn: true, ..Drawn::default() };
            let drawn = vec![all; rays.tiles().len()];
            shaded.shade(&view, SKY, &drawn);
            shaded.soften(&view, SOLID, &drawn);
            prop_assert_eq!(picture.light, shaded.light);
        }
    }
}
