//! Solids seen along the rays of a camera: exact hits, and the part of the picture a solid can be in.
//!
//! Everything here is in the camera frame (origin at the camera's centre), so a ray is a direction.
//! The tests are analytic; no ray goes through the physics engine.

use std::ops::Range;

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::shapes::{Paint, Shape, Solid};
use crate::truth::CameraTruth;

/// Light from the lamps of the room, world frame: mostly from above.
const LIGHT: [f64; 3] = [0.25, 0.35, 0.9];

/// Share of the light that comes from everywhere.
const AMBIENT: f64 = 0.75;

/// A shape put before a camera.
#[derive(Debug, Clone)]
pub struct Seen {
    form: Form,
    /// What it reflects in each channel of the picture.
    pub tone: [f32; 3],
    light: Vector3<f64>,
}

#[derive(Debug, Clone)]
enum Form {
    Ball {
        centre: Vector3<f64>,
        radius: f64,
    },
    Capsule {
        a: Vector3<f64>,
        b: Vector3<f64>,
        radius: f64,
    },
    Block {
        /// Camera to block axes.
        turn: Matrix3<f64>,
        /// The camera's centre in the block's frame.
        eye: Vector3<f64>,
        half: Vector3<f64>,
    },
    Cylinder {
        /// Camera to cylinder axes.
        turn: Matrix3<f64>,
        /// The camera's centre in the cylinder's frame.
        eye: Vector3<f64>,
        half: f64,
        radius: f64,
    },
    Disc {
        centre: Vector3<f64>,
        normal: Vector3<f64>,
        radius: f64,
    },
}

/// What a colour is in each channel of a picture, which has one (grey) or three.
pub fn tone(paint: Paint, colour: bool) -> [f32; 3] {
    let tone = if colour {
        paint.rgb()
    } else {
        [paint.grey(), 0.0, 0.0]
    };
    tone.map(|level| level as f32)
}

/// Columns and rows `[first, end)` of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// The first column, and that behind the last.
    pub columns: [usize; 2],
    /// The first row, and that behind the last.
    pub rows: [usize; 2],
}

impl Window {
    /// Its pixels, a run for each row, in a picture of that width.
    pub fn runs(&self, width: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let [first, end] = self.columns;
        (self.rows[0]..self.rows[1]).map(move |row| row * width + first..row * width + end)
    }
}

impl Seen {
    /// A shape in a frame with pose `camera_t_frame`, lit in the world behind `camera_t_world`, for a picture that is in
    /// colour or not.
    pub fn new(
        shape: &Shape,
        camera_t_frame: &Isometry3<f64>,
        camera_t_world: &Isometry3<f64>,
        colour: bool,
    ) -> Self {
        let form = match shape.solid {
            Solid::Capsule { a, b, radius } if a == b => Form::Ball {
                centre: (camera_t_frame * a).coords,
                radius,
            },
            Solid::Capsule { a, b, radius } => Form::Capsule {
                a: (camera_t_frame * a).coords,
                b: (camera_t_frame * b).coords,
                radius,
            },
            Solid::Block { centre, half } => {
                let back = camera_t_frame.inverse();
                Form::Block {
                    turn: back.rotation.to_rotation_matrix().into_inner(),
                    eye: back.translation.vector - centre.coords,
                    half,
                }
            }
            Solid::Cylinder { half, radius } => {
                let back = camera_t_frame.inverse();
                Form::Cylinder {
                    turn: back.rotation.to_rotation_matrix().into_inner(),
                    eye: back.translation.vector,
                    half,
                    radius,
                }
            }
            Solid::Disc {
                centre,
                normal,
                radius,
            } => Form::Disc {
                centre: (camera_t_frame * centre).coords,
                normal: camera_t_frame * normal,
                radius,
            },
        };
        Self {
            form,
            tone: tone(shape.paint, colour),
            light: camera_t_world * Vector3::from(LIGHT).normalize(),
        }
    }

    /// Centre and radius of a ball that it is in.
    pub(crate) fn ball(&self) -> (Vector3<f64>, f64) {
        match &self.form {
            Form::Ball { centre, radius } | Form::Disc { centre, radius, .. } => (*centre, *radius),
            Form::Capsule { a, b, radius } => ((a + b) / 2.0, (b - a).norm() / 2.0 + radius),
            Form::Block { turn, eye, half } => (-turn.tr_mul(eye), half.norm()),
            Form::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => (-turn.tr_mul(eye), half.hypot(*radius)),
        }
    }

    /// Distance along the unit direction `ray` to the first point of the solid.
    pub fn hit(&self, ray: &Vector3<f64>) -> Option<f64> {
        match &self.form {
            Form::Ball { centre, radius } => hit_ball(centre, *radius, ray),
            Form::Capsule { a, b, radius } => hit_capsule(a, b, *radius, ray),
            Form::Block { turn, eye, half } => hit_block(eye, half, &(turn * ray)),
            Form::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => hit_cylinder(eye, *half, *radius, &(turn * ray)),
            Form::Disc {
                centre,
                normal,
                radius,
            } => hit_disc(centre, normal, *radius, ray),
        }
    }

    /// Distance to the first point of the solid along the z axis of another frame, `frame_t_camera`.
    pub fn hit_from(&self, frame_t_camera: &Isometry3<f64>) -> Option<f64> {
        let form = match &self.form {
            Form::Ball { centre, radius } => Form::Ball {
                centre: (frame_t_camera * Point3::from(*centre)).coords,
                radius: *radius,
            },
            Form::Capsule { a, b, radius } => Form::Capsule {
                a: (frame_t_camera * Point3::from(*a)).coords,
                b: (frame_t_camera * Point3::from(*b)).coords,
                radius: *radius,
            },
            Form::Block { turn, eye, half } => {
                let (turn, eye) = seen_from(frame_t_camera, turn, eye);
                Form::Block {
                    turn,
                    eye,
                    half: *half,
                }
            }
            Form::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => {
                let (turn, eye) = seen_from(frame_t_camera, turn, eye);
                Form::Cylinder {
                    turn,
                    eye,
                    half: *half,
                    radius: *radius,
                }
            }
            Form::Disc {
                centre,
                normal,
                radius,
            } => Form::Disc {
                centre: (frame_t_camera * Point3::from(*centre)).coords,
                normal: frame_t_camera * normal,
                radius: *radius,
            },
        };
        let moved = Self {
            form,
            ..self.clone()
        };
        moved.hit(&Vector3::z())
    }

    /// Tells `found` for each of `rays` that hits: its index and the distance.
    pub fn hits(&self, rays: &[Vector3<f64>], found: impl FnMut(usize, f64)) {
        // The form is looked at once, not for each ray.
        match &self.form {
            Form::Ball { centre, radius } => {
                each(rays, found, |ray| hit_ball(centre, *radius, ray));
            }
            Form::Capsule { a, b, radius } => {
                each(rays, found, |ray| hit_capsule(a, b, *radius, ray));
            }
            Form::Block { turn, eye, half } => {
                each(rays, found, |ray| hit_block(eye, half, &(turn * ray)));
            }
            Form::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => each(rays, found, |ray| {
                hit_cylinder(eye, *half, *radius, &(turn * ray))
            }),
            Form::Disc {
                centre,
                normal,
                radius,
            } => each(rays, found, |ray| hit_disc(centre, normal, *radius, ray)),
        }
    }

    /// How much of its tone the point at `distance` along `ray` shows, by Lambert's law.
    pub fn shade(&self, ray: &Vector3<f64>, distance: f64) -> f64 {
        let point = ray * distance;
        let normal = match &self.form {
            Form::Ball { centre, .. } => (point - centre).normalize(),
            Form::Capsule { a, b, .. } => {
                let axis = b - a;
                let length = axis.norm_squared();
                let along = if length > 0.0 {
                    ((point - a).dot(&axis) / length).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                (point - a - axis * along).normalize()
            }
            Form::Block { turn, eye, half } => {
                let local = (eye + turn * point).component_div(half);
                let mut normal = Vector3::zeros();
                let face = local.iamax();
                normal[face] = local[face].signum();
                turn.transpose() * normal
            }
            Form::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => {
                let local = eye + turn * point;
                let side = local.xy() / *radius;
                let normal = if local.z.abs() / half > side.norm() {
                    Vector3::z() * local.z.signum()
                } else {
                    Vector3::new(side.x, side.y, 0.0).normalize()
                };
                turn.transpose() * normal
            }
            // The side that the camera sees.
            Form::Disc { normal, .. } => normal * -normal.dot(ray).signum(),
        };
        lambert(1.0, normal.dot(&self.light))
    }

    /// The part of the picture outside which the solid cannot be seen; `None` when it cannot be
    /// seen at all.
    pub fn window(&self, camera: &CameraTruth) -> Option<Window> {
        let whole = Window {
            columns: [0, camera.width],
            rows: [0, camera.height],
        };
        let mut extent = Extent::default();
        match &self.form {
            Form::Ball { centre, radius } => extent.ball(centre, *radius),
            Form::Capsule { a, b, radius } => {
                extent.ball(a, *radius);
                extent.ball(b, *radius);
            }
            Form::Block { turn, eye, half } => {
                let centre = -turn.tr_mul(eye);
                for corner in 0..8_u32 {
                    let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
                    let signs = Vector3::new(sign(0), sign(1), sign(2));
                    let point = centre + turn.tr_mul(&half.component_mul(&signs));
                    extent.ball(&point, 0.0);
                }
            }
            Form::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => {
                let (centre, axis) = (-turn.tr_mul(eye), turn.row(2).transpose());
                for end in [centre - axis * *half, centre + axis * *half] {
                    extent.disc(&end, &axis, *radius);
                }
            }
            Form::Disc {
                centre,
                normal,
                radius,
            } => extent.disc(centre, normal, *radius),
        }
        match extent.of {
            [_, 0] => distorted(camera, extent.low, extent.high, whole),
            [0, _] => None,
            _ => Some(whole),
        }
    }
}

/// The turn and the place of the origin of a solid, by those that a camera has of it, for another frame.
fn seen_from(
    frame_t_camera: &Isometry3<f64>,
    turn: &Matrix3<f64>,
    eye: &Vector3<f64>,
) -> (Matrix3<f64>, Vector3<f64>) {
    let back = frame_t_camera.inverse();
    let rotation = back.rotation.to_rotation_matrix().into_inner();
    (turn * rotation, eye + turn * back.translation.vector)
}

/// Tells `found` for each of `rays` that `hit` says a distance of.
fn each(
    rays: &[Vector3<f64>],
    mut found: impl FnMut(usize, f64),
    hit: impl Fn(&Vector3<f64>) -> Option<f64>,
) {
    for (index, ray) in rays.iter().enumerate() {
        if let Some(distance) = hit(ray) {
            found(index, distance);
        }
    }
}

/// The ideal rectangle (focal length 1) that the hull of balls and discs lies in.
#[derive(Debug)]
struct Extent {
    low: [f64; 2],
    high: [f64; 2],
    /// How many of them are wholly before the camera, and how many are not.
    of: [u32; 2],
}

impl Default for Extent {
    fn default() -> Self {
        Self {
            low: [f64::INFINITY; 2],
            high: [f64::NEG_INFINITY; 2],
            of: [0; 2],
        }
    }
}

impl Extent {
    fn ball(&mut self, centre: &Vector3<f64>, radius: f64) {
        self.rim(centre, radius, &Matrix3::identity());
    }

    fn disc(&mut self, centre: &Vector3<f64>, normal: &Vector3<f64>, radius: f64) {
        // What is across the normal.
        let across = Matrix3::identity() - normal * normal.transpose();
        self.rim(centre, radius, &across);
    }

    /// A ball, or what of it `across` (a projection) leaves. The plane x = m z touches it where the distance of its centre is the
    /// radius seen across that plane: a quadratic in m.
    fn rim(&mut self, centre: &Vector3<f64>, radius: f64, across: &Matrix3<f64>) {
        let square = radius * radius;
        let deep = radius * across.m33.max(0.0).sqrt();
        if centre.z - deep < 1e-3 {
            self.of[1] += 1;
            // The part before the camera counts, wherever it is seen.
            self.of[0] += u32::from(centre.z + deep >= 1e-3);
            return;
        }
        self.of[0] += 1;
        for axis in 0..2 {
            let a = centre.z * centre.z - square * across.m33;
            let b = centre[axis] * centre.z - square * across[(axis, 2)];
            let c = centre[axis] * centre[axis] - square * across[(axis, axis)];
            let root = (b * b - a * c).max(0.0).sqrt();
            self.low[axis] = self.low[axis].min((b - root) / a);
            self.high[axis] = self.high[axis].max((b + root) / a);
        }
    }
}

/// The window of an ideal rectangle after distortion: the lens model is continuous, so the border of
/// the rectangle becomes the border of its image.
fn distorted(camera: &CameraTruth, low: [f64; 2], high: [f64; 2], whole: Window) -> Option<Window> {
    const STEPS: u32 = 16;
    let reach = low[0]
        .abs()
        .max(high[0].abs())
        .hypot(low[1].abs().max(high[1].abs()));
    if reach >= camera.valid_radius {
        return Some(whole);
    }
    let mut from = [f64::INFINITY; 2];
    let mut to = [f64::NEG_INFINITY; 2];
    for step in 0..=STEPS {
        let t = f64::from(step) / f64::from(STEPS);
        let x = low[0] + t * (high[0] - low[0]);
        let y = low[1] + t * (high[1] - low[1]);
        for (x, y) in [(x, low[1]), (x, high[1]), (low[0], y), (high[0], y)] {
            let (u, v) = camera.pixel(x, y);
            from = [from[0].min(u), from[1].min(v)];
            to = [to[0].max(u), to[1].max(v)];
        }
    }
    // Between two of the border's points the curve bulges by far less than these two pixels. A
    // float becomes an index with saturation at 0.
    let first = |value: f64| (value - 2.0).floor() as usize;
    let end = |value: f64, size: usize| ((value + 3.0).ceil() as usize).min(size);
    let columns = [first(from[0]), end(to[0], camera.width)];
    let rows = [first(from[1]), end(to[1], camera.height)];
    (columns[0] < columns[1] && rows[0] < rows[1]).then_some(Window { columns, rows })
}

/// Grey of a surface whose unit normal has `cosine` with the light.
fn lambert(grey: f64, cosine: f64) -> f64 {
    grey * (AMBIENT + (1.0 - AMBIENT) * cosine.max(0.0))
}

/// The floor, z = 0 in the world, with the joints between its tiles.
#[derive(Debug, Clone)]
pub struct Floor {
    world_t_camera: Isometry3<f64>,
    /// Upwards, camera frame.
    up: Vector3<f64>,
}

impl Floor {
    /// The floor before a camera.
    #[must_use]
    pub fn new(camera_t_world: &Isometry3<f64>) -> Self {
        Self {
            world_t_camera: camera_t_world.inverse(),
            up: camera_t_world * Vector3::z(),
        }
    }

    /// Distance along the unit direction `ray`; `None` above the horizon.
    pub fn hit(&self, ray: &Vector3<f64>) -> Option<f64> {
        let rise = self.up.dot(ray);
        let distance = -self.world_t_camera.translation.vector.z / rise;
        (rise < -1e-9 && distance > 0.0).then_some(distance)
    }

    /// How much of its tone the point at `distance` along `ray` shows.
    pub fn shade(&self, ray: &Vector3<f64>, distance: f64) -> f64 {
        let point = self.world_t_camera * Point3::from(ray * distance);
        let joint =
            |x: f64| ((x / TILE).rem_euclid(1.0) - 0.5).abs() > 0.5 - JOINT_WIDTH / TILE / 2.0;
        let tone = if joint(point.x) || joint(point.y) {
            JOINT
        } else {
            1.0
        };
        lambert(tone, Vector3::from(LIGHT).normalize().z)
    }
}

/// Tone of the joints against that of the tiles.
const JOINT: f64 = 0.93;

/// Edge of a floor tile and width of the joints, m.
const TILE: f64 = 0.5;
const JOINT_WIDTH: f64 = 0.012;

fn hit_capsule(a: &Vector3<f64>, b: &Vector3<f64>, radius: f64, ray: &Vector3<f64>) -> Option<f64> {
    let axis = b - a;
    let length = axis.norm_squared();
    let along = axis.dot(ray);
    let start = -axis.dot(a);
    // Side of the cylinder: at^2 + 2bt + c = 0, from the distance of the ray to the axis.
    let qa = length - along * along;
    if qa > 1e-12 * length {
        let qb = -length * a.dot(ray) - start * along;
        let qc = length * (a.norm_squared() - radius * radius) - start * start;
        let h = qb * qb - qa * qc;
        if h < 0.0 {
            return None;
        }
        let t = (-qb - h.sqrt()) / qa;
        let place = start + t * along;
        if place > 0.0 && place < length {
            return (t > 0.0).then_some(t);
        }
        return hit_ball(if place <= 0.0 { a } else { b }, radius, ray);
    }
    // Along the axis, or a ball: the end that faces the camera.
    hit_ball(if along >= 0.0 { a } else { b }, radius, ray)
}

fn hit_ball(centre: &Vector3<f64>, radius: f64, ray: &Vector3<f64>) -> Option<f64> {
    let b = centre.dot(ray);
    let h = b * b - centre.norm_squared() + radius * radius;
    if h < 0.0 {
        return None;
    }
    let t = b - h.sqrt();
    (t > 0.0).then_some(t)
}

fn hit_block(eye: &Vector3<f64>, half: &Vector3<f64>, ray: &Vector3<f64>) -> Option<f64> {
    let mut enter = 0.0_f64;
    let mut leave = f64::INFINITY;
    for axis in 0..3 {
        let [first, last] = slab(eye[axis], ray[axis], half[axis])?;
        enter = enter.max(first);
        leave = leave.min(last);
    }
    (enter <= leave && enter > 0.0).then_some(enter)
}

fn hit_cylinder(eye: &Vector3<f64>, half: f64, radius: f64, ray: &Vector3<f64>) -> Option<f64> {
    // Between its two planes, and within the circle: the later of both entries, before the earlier exit.
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for span in [slab(eye.z, ray.z, half), circle(eye, ray, radius)] {
        let [first, last] = span?;
        enter = enter.max(first);
        leave = leave.min(last);
    }
    (enter <= leave && enter > 0.0).then_some(enter)
}

fn hit_disc(
    centre: &Vector3<f64>,
    normal: &Vector3<f64>,
    radius: f64,
    ray: &Vector3<f64>,
) -> Option<f64> {
    let t = normal.dot(centre) / normal.dot(ray);
    // In its own plane a disc is a line without width: t is no number, and nothing is seen.
    let off = (ray * t - centre).norm_squared();
    (t > PAINT && off <= radius * radius).then_some(t - PAINT)
}

/// A disc is painted on something, and is seen by so much before it, m.
const PAINT: f64 = 1e-4;

/// Where a ray is between the planes at plus and minus `half`, by one coordinate.
fn slab(eye: f64, ray: f64, half: f64) -> Option<[f64; 2]> {
    if ray.abs() < 1e-15 {
        return (eye.abs() <= half).then_some([0.0, f64::INFINITY]);
    }
    let (one, other) = ((-half - eye) / ray, (half - eye) / ray);
    Some([one.min(other), one.max(other)])
}

/// Where a ray is within `radius` of the z axis.
fn circle(eye: &Vector3<f64>, ray: &Vector3<f64>, radius: f64) -> Option<[f64; 2]> {
    let a = ray.xy().norm_squared();
    let b = ray.xy().dot(&eye.xy());
    let c = eye.xy().norm_squared() - radius * radius;
    if a < 1e-15 {
        return (c <= 0.0).then_some([0.0, f64::INFINITY]);
    }
    let root = (b * b - a * c).sqrt();
    // No root: the ray passes by.
    (!root.is_nan()).then(|| [(-b - root) / a, (-b + root) / a])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Distance of a point to a segment, the definition of a capsule.
    fn to_segment(p: &Vector3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        let axis = b - a;
        let along = ((p - a).dot(&axis) / axis.norm_squared().max(1e-300)).clamp(0.0, 1.0);
        (p - a - axis * along).norm()
    }

    fn near() -> impl Strategy<Value = Vector3<f64>> {
        (-0.5..0.5_f64, -0.5..0.5_f64, 1.5..2.5_f64).prop_map(|(x, y, z)| Vector3::new(x, y, z))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_capsule_is_hit_where_the_ray_first_comes_within_its_radius(
            a in near(), b in near(), radius in 0.02..0.2_f64, target in near(),
        ) {
            let ray = target.normalize();
            // Sphere tracing finds the first point at distance `radius` by the definition alone.
            let mut t = 0.0;
            let mut expected = None;
            while t < 5.0 {
                let gap = to_segment(&(ray * t), &a, &b) - radius;
                if gap < 1e-10 {
                    expected = Some(t);
                    break;
                }
                t += gap;
            }
            match (hit_capsule(&a, &b, radius, &ray), expected) {
                (Some(hit), Some(t)) => prop_assert!((hit - t).abs() < 1e-4, "{hit} {t}"),
                (None, None) => {}
                // A grazing ray may go either way by rounding.
                (hit, _) => {
                    let closest = (0..5000).map(|i| to_segment(&(ray * (f64::from(i) * 1e-3)), &a, &b))
                        .fold(f64::INFINITY, f64::min);
                    prop_assert!((closest - radius).abs() < 1e-3, "{hit:?} {expected:?}");
                }
            }
        }

        #[test]
        fn a_block_is_hit_on_its_surface(target in near(), half in 0.05..0.3_f64) {
            let half = Vector3::new(half, half * 0.5, half * 1.5);
            let eye = Vector3::new(0.1, 0.2, -2.0);
            let ray = target.normalize();
            if let Some(t) = hit_block(&eye, &half, &ray) {
                let depth = (eye + ray * t).component_div(&half).amax();
                prop_assert!((depth - 1.0).abs() < 1e-9);
            } else {
                for i in 0..4000 {
                    let point = eye + ray * (f64::from(i) * 1e-3);
                    prop_assert!(point.component_div(&half).amax() > 1.0 - 1e-9);
                }
            }
        }

        #[test]
        fn a_cylinder_is_hit_on_its_surface(target in near(), half in 0.05..0.3_f64) {
            let radius = half * 0.7;
            let eye = Vector3::new(0.1, 0.2, -2.0);
            let ray = target.normalize();
            let depth = |point: Vector3<f64>| (point.xy().norm() / radius).max(point.z.abs() / half);
            if let Some(t) = hit_cylinder(&eye, half, radius, &ray) {
                prop_assert!((depth(eye + ray * t) - 1.0).abs() < 1e-9);
            } else {
                for i in 0..4000 {
                    let point = eye + ray * (f64::from(i) * 1e-3);
                    prop_assert!(depth(point) > 1.0 - 1e-9);
                }
            }
        }

        #[test]
        fn nothing_of_a_capsule_is_seen_outside_its_window(
            a in near(), b in near(), radius in 0.02..0.2_f64,
        ) {
            let distortion = crate::truth::Distortion {
                k1: -0.15, k2: 0.04, p1: 5e-4, p2: -5e-4, k3: 0.0,
            };
            let camera = CameraTruth {
                name: "c".into(),
                width: 60,
                height: 40,
                focal: [45.0, 46.0],
                principal: [31.0, 18.0],
                distortion,
                camera_t_world: Isometry3::identity(),
                valid_radius: distortion.monotonic_radius(),
            };
            let shape = Shape {
                solid: Solid::Capsule { a: a.into(), b: b.into(), radius },
                paint: Paint::Grey(100.0),
            };
            let seen = Seen::new(&shape, &Isometry3::identity(), &Isometry3::identity(), false);
            let window = seen.window(&camera);
            for row in 0..camera.height {
                for column in 0..camera.width {
                    let ray = camera.direction(column as f64, row as f64).unwrap().normalize();
                    let inside = window.is_some_and(|w| {
                        (w.columns[0]..w.columns[1]).contains(&column)
                            && (w.rows[0]..w.rows[1]).contains(&row)
                    });
                    prop_assert!(inside || seen.hit(&ray).is_none());
                }
            }
        }
    }
}
