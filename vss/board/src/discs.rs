//! Discs of known size and colours before calibrated cameras: where each one is, and how high it lies.
//!
//! Pixels of a disc's hue make blobs. A blob is taken for a disc at each height at which one may lie, and the rim of its upper
//! side is fitted to the edges in all pictures together. At a wrong height the pictures contradict each other, so two cameras tell
//! how many discs lie upon each other. Only that part of a rim is looked at behind which the camera sees what the disc lies on: the
//! nearer part has the disc's own side before it. Knows numbers and pictures only.

use nalgebra::{Isometry3, Matrix2, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use vss::components::components;

use crate::pose::View;

/// Places on a rim.
const PLACES: usize = 48;

/// How far along the normal an edge is looked for, px, and in which steps.
const REACH: f64 = 4.0;
const STEP: f64 = 0.25;

/// Behind an edge nothing changes any more over so many steps.
const PLATEAU: usize = 4;

/// An edge differs by so many levels at least.
const LEAST_EDGE: f64 = 24.0;

/// An edge that is not there, or is far away, counts as one so far from its place, px.
const MISSING: f64 = 2.0;

/// Root of the mean square of the edges' distances beyond which a blob is no disc, px.
const MOST_OFF: f64 = 1.0;

/// Fewest edges that make a disc.
const FEWEST: usize = 12;

/// The step of differences, m.
const SMALL: f64 = 1e-4;

/// Two finds that are nearer than this part of the radius are one disc.
const SAME: f64 = 0.5;

/// A pixel is of a colour when its red and green parts are not further off, and its light is this part of the colour's.
const HUE: f64 = 0.1;
const LIGHT: (f64, f64) = (0.45, 1.25);

/// What the discs are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DiscForm {
    /// Radius, m.
    pub radius_m: f64,
    /// Height, m.
    pub height_m: f64,
    /// Colours, red, green and blue, 0 to 255. Greys are no colours.
    pub colours: Vec<[f64; 3]>,
}

/// A disc that was seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeenDisc {
    /// The middle of its lower side in the frame that was asked for, m.
    pub at: Point3<f64>,
    /// Which of the colours.
    pub colour: usize,
    /// Root of the mean square of its edges' distances from where they should be, px.
    pub rms_px: f64,
    /// Standard deviation of its place in each direction, m, as the edges tell it: what is not known of the cameras' places
    /// moves all discs alike, and the frame, if that was seen by them.
    pub sd_m: f64,
    /// How many cameras saw it. One alone does not tell heights.
    pub cameras: usize,
}

/// All discs before the cameras, in a frame whose z axis they stand along, with their lower sides at one of `floors` (m). The
/// first of these is taken where one camera alone sees a disc.
#[must_use]
pub fn find_discs(
    views: &[View],
    base_t_frame: &Isometry3<f64>,
    floors: &[f64],
    form: &DiscForm,
) -> Vec<SeenDisc> {
    let mut found: Vec<SeenDisc> = Vec::new();
    for view in views {
        for (colour, rgb) in form.colours.iter().enumerate() {
            for (middle, area) in blobs(view, rgb) {
                let search = Search {
                    views,
                    base_t_frame,
                    form,
                    colour,
                };
                let Some(disc) = search.disc(view, middle, area, floors) else {
                    continue;
                };
                let place = disc.at;
                let near = |other: &&mut SeenDisc| (other.at - place).norm() < SAME * form.radius_m;
                match found.iter_mut().find(near) {
                    Some(known) if disc.rms_px < known.rms_px => *known = disc,
                    Some(_) => {}
                    None => found.push(disc),
                }
            }
        }
    }
    found
}

/// Middles (px) and areas (px²) of what has a colour's hue in a picture.
fn blobs(view: &View, rgb: &[f64; 3]) -> Vec<(Vector2<f64>, f64)> {
    let wanted = Hue::of(*rgb);
    let frame = &view.frame;
    let places = (0..frame.height).flat_map(|v| (0..frame.width).map(move |u| (u, v)));
    let mask = places.map(|(u, v)| {
        let is = frame.rgb(u, v).is_some_and(|rgb| {
            let hue = Hue::of(rgb.map(f64::from));
            let light = hue.light / wanted.light;
            (hue.parts - wanted.parts).norm() < HUE && (LIGHT.0..LIGHT.1).contains(&light)
        });
        u8::from(is)
    });
    let mask: Vec<u8> = mask.collect();
    let blobs = components(&mask, frame.width, 1).into_iter();
    let blobs = blobs.map(|blob| {
        let (u, v) = blob.centroid();
        (Vector2::new(u, v), blob.area as f64)
    });
    blobs.collect()
}

/// A colour without its light: the parts that are red and green.
struct Hue {
    parts: Vector2<f64>,
    light: f64,
}

impl Hue {
    fn of([red, green, blue]: [f64; 3]) -> Self {
        let light = (red + green + blue).max(1.0);
        Self {
            parts: Vector2::new(red, green) / light,
            light,
        }
    }
}

struct Search<'a> {
    views: &'a [View],
    base_t_frame: &'a Isometry3<f64>,
    form: &'a DiscForm,
    colour: usize,
}

/// An edge beside its place.
struct Edge {
    /// How far outside, px.
    off: f64,
    /// Pixels along the normal for a metre along x and y.
    slope: Vector2<f64>,
}

impl Search<'_> {
    /// The disc that a blob of one picture is, at the floor where the pictures agree best.
    fn disc(
        &self,
        view: &View,
        middle: Vector2<f64>,
        area: f64,
        floors: &[f64],
    ) -> Option<SeenDisc> {
        let mut all: Vec<(f64, SeenDisc)> = Vec::new();
        for floor in floors {
            let half = floor + 0.5 * self.form.height_m;
            let Some(start) = view.on_plane(middle, self.base_t_frame, half) else {
                continue;
            };
            let Some(expected) = self.area(view, start, *floor) else {
                continue;
            };
            // Too small or too large for a disc, which may be half covered.
            let share = area / expected;
            if (0.3..2.0).contains(&share) {
                all.extend(self.fitted(start, *floor));
            }
        }
        let least = all.iter().min_by(|one, other| one.0.total_cmp(&other.0))?;
        let limit = match least.1.cameras {
            // All heights fit one camera about as well.
            0 | 1 => 2.0 * least.0 + 0.05,
            _ => least.0,
        };
        all.into_iter()
            .find(|(cost, _)| *cost <= limit)
            .map(|(_, disc)| disc)
    }

    /// The area that the upper side of a disc has in a picture, px².
    fn area(&self, view: &View, at: Point2<f64>, floor: f64) -> Option<f64> {
        let pixel = |x: f64, y: f64| {
            let point = Point3::new(at.x + x, at.y + y, floor + self.form.height_m);
            view.camera.project(&(self.base_t_frame * point))
        };
        let r = self.form.radius_m;
        let (x, y) = (
            pixel(r, 0.0)? - pixel(-r, 0.0)?,
            pixel(0.0, r)? - pixel(0.0, -r)?,
        );
        Some(0.25 * std::f64::consts::PI * (x.x * y.y - x.y * y.x).abs())
    }

    /// The disc on a floor near a place whose rim fits best; with the mean square that the edges leave, which counts those that
    /// are missing.
    fn fitted(&self, start: Point2<f64>, floor: f64) -> Option<(f64, SeenDisc)> {
        let mut at = start;
        for _ in 0..8 {
            let (edges, ..) = self.edges(at, floor);
            let step = step(&edges)?;
            at += step;
            if (at - start).norm() > self.form.radius_m {
                return None;
            }
            if step.norm() < 1e-6 {
                break;
            }
        }
        let (edges, missing, cameras) = self.edges(at, floor);
        if edges.len() < FEWEST {
            return None;
        }
        let squares: f64 = edges.iter().map(|edge| edge.off * edge.off).sum();
        let cost = (squares + missing as f64 * MISSING * MISSING) / (edges.len() + missing) as f64;
        let rms_px = (squares / edges.len() as f64).sqrt();
        let normal = normal(&edges).try_inverse()?;
        // Neighbouring places see the same pixels: a third of them tell something of their own.
        let sd_m = rms_px * (3.0 * 0.5 * normal.trace()).sqrt();
        (rms_px < MOST_OFF).then(|| {
            let disc = SeenDisc {
                at: Point3::new(at.x, at.y, floor),
                colour: self.colour,
                rms_px,
                sd_m,
                cameras,
            };
            (cost, disc)
        })
    }

    /// The edges of a rim in all pictures, how many are missing, and how many cameras see the most of it.
    fn edges(&self, at: Point2<f64>, floor: f64) -> (Vec<Edge>, usize, usize) {
        let (mut all, mut missing, mut cameras) = (Vec::new(), 0, 0);
        for view in self.views {
            let (mut seen, mut looked) = (0, 0);
            let eye = self.base_t_frame.inverse() * view.camera.centre;
            let towards = eye.xy() - at;
            // From straight above no side is seen.
            let steep = towards.norm() < 0.05 * (eye.z - floor).abs();
            for nth in 0..PLACES {
                let angle = std::f64::consts::TAU * nth as f64 / PLACES as f64;
                let out = Vector2::new(angle.cos(), angle.sin());
                if !steep && out.dot(&towards) > 0.05 * towards.norm() {
                    continue;
                }
                looked += 1;
                match self.edge(view, at, floor, out) {
                    Some(edge) => {
                        seen += 1;
                        all.push(edge);
                    }
                    None => missing += 1,
                }
            }
            cameras += usize::from(2 * seen > looked);
        }
        (all, missing, cameras)
    }

    /// The edge at one place of a rim.
    fn edge(&self, view: &View, at: Point2<f64>, floor: f64, out: Vector2<f64>) -> Option<Edge> {
        let top = floor + self.form.height_m;
        let pixel = |point: Point2<f64>| {
            let point = self.base_t_frame * Point3::new(point.x, point.y, top);
            view.camera.project(&point)
        };
        let rim = at + out * self.form.radius_m;
        let here = pixel(rim)?;
        let by = |step: Vector2<f64>| Some((pixel(rim + step)? - here) / SMALL);
        let moves =
            Matrix2::from_columns(&[by(Vector2::new(SMALL, 0.0))?, by(Vector2::new(0.0, SMALL))?]);
        let along = moves * Vector2::new(-out.y, out.x);
        let normal = Vector2::new(along.y, -along.x).normalize();
        let normal = normal * normal.dot(&(moves * out)).signum();
        let off = edge_along(view, here, normal, &self.form.colours[self.colour])?;
        Some(Edge {
            off,
            slope: moves.tr_mul(&normal),
        })
    }
}

/// How far outside a place on the normal the colour ends, px.
fn edge_along(
    view: &View,
    here: Vector2<f64>,
    normal: Vector2<f64>,
    rgb: &[f64; 3],
) -> Option<f64> {
    let steps = (REACH / STEP) as i32;
    let wanted = Vector3::from(*rgb);
    let off = |k: i32| {
        let colour = view.colour(here + normal * (STEP * f64::from(k)))?;
        Some((colour - wanted).norm())
    };
    let profile: Option<Vec<f64>> = (-steps..=steps).map(off).collect();
    let profile = profile?;
    let inside = profile.iter().copied().fold(f64::INFINITY, f64::min);
    let first = profile.iter().position(|one| *one <= inside + 1e-9)?;
    // The first strong edge outwards from where the colour is purest, as far as the change goes on.
    let mut outside = inside;
    let mut end = first;
    for (k, value) in profile.iter().enumerate().skip(first) {
        let height = *value - inside;
        let before = k.checked_sub(PLATEAU).and_then(|k| profile.get(k));
        let rise = before.map_or(height, |before| value - before);
        if outside - inside > LEAST_EDGE && rise < 0.08 * height {
            break;
        }
        if *value > outside {
            (outside, end) = (*value, k);
        }
    }
    if outside - inside < LEAST_EDGE {
        return None;
    }
    let level = 0.5 * (inside + outside);
    let crossing = (first..end).rev().find_map(|k| {
        let (low, high) = (profile.get(k)?, profile.get(k + 1)?);
        (*low <= level && *high > level).then(|| k as f64 + (level - low) / (high - low))
    })?;
    Some((crossing - f64::from(steps)) * STEP)
}

fn normal(edges: &[Edge]) -> Matrix2<f64> {
    edges
        .iter()
        .map(|edge| edge.slope * edge.slope.transpose())
        .sum()
}

/// How far the place moves that fits the edges better.
fn step(edges: &[Edge]) -> Option<Vector2<f64>> {
    if edges.len() < FEWEST {
        return None;
    }
    let right: Vector2<f64> = edges.iter().map(|edge| edge.slope * edge.off).sum();
    normal(edges).try_inverse().map(|inverse| inverse * right)
}

/// Which part of a round place looks as the empty field of a board does, 0 to 1: the most that one camera sees of it. The place
/// is in the board's frame, m. `fields` says how wide a field is; the first one, at the smallest x and y of a board of 8 by 8, is dark.
/// `None` where no camera sees it, or none sees the colours of the fields.
#[must_use]
pub fn bare(
    views: &[View],
    base_t_board: &Isometry3<f64>,
    field_m: f64,
    place: Point2<f64>,
    radius_m: f64,
) -> Option<f64> {
    let shares = views.iter().filter_map(|view| {
        let colour = |x: f64, y: f64| {
            let at = base_t_board * Point3::new(x, y, 0.0);
            view.colour(view.camera.project(&at)?)
        };
        // What fields look like, beside their corners, where no disc lies.
        let mut tones: [Vec<Vector3<f64>>; 2] = [Vec::new(), Vec::new()];
        for (x, y) in (-3..=3).flat_map(|x| (-3..=3).map(move |y| (x, y))) {
            for (side_x, side_y) in [(-1, -1), (-1, 1), (1, -1), (1, 1)] {
                let along =
                    |corner: i32, side: i32| (f64::from(corner) + 0.12 * f64::from(side)) * field_m;
                let tone = colour(along(x, side_x), along(y, side_y));
                // The field below and left of the middle corner is dark, as the first one is.
                let dark = (x + y).rem_euclid(2) == 0 && side_x == side_y
                    || (x + y).rem_euclid(2) == 1 && side_x != side_y;
                tones[usize::from(dark)].extend(tone);
            }
        }
        let [light, dark] = tones.map(|all| median(&all));
        let (light, dark) = (light?, dark?);
        let near = 0.35 * (light - dark).norm();
        let (mut alike, mut all) = (0, 0);
        for ring in 0..4 {
            for nth in 0..12 {
                let angle = std::f64::consts::TAU * f64::from(nth) / 12.0;
                let reach = radius_m * (f64::from(ring) + 0.5) / 4.0;
                let (x, y) = (place.x + reach * angle.cos(), place.y + reach * angle.sin());
                let (file, rank) = (x / field_m + 4.0, y / field_m + 4.0);
                let edge = |at: f64| (at - at.round()).abs() < 0.06;
                if edge(file) || edge(rank) {
                    continue;
                }
                let is_dark = (file.floor() + rank.floor()).rem_euclid(2.0) < 0.5;
                let expected = if is_dark { dark } else { light };
                let seen = colour(x, y)?;
                all += 1;
                alike += i32::from((seen - expected).norm() < near);
            }
        }
        (all > 0).then(|| f64::from(alike) / f64::from(all))
    });
    shares.max_by(f64::total_cmp)
}

/// The median of each channel.
fn median(all: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let channel = |k: usize| {
        let mut values: Vec<f64> = all.iter().map(|one| one[k]).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    Some(Vector3::new(channel(0)?, channel(1)?, channel(2)?))
}
