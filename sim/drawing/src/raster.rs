//! Solids seen along the rays of a camera: exact hits, and which tiles of the picture a solid can be in.
//!
//! Everything here is in the camera frame (origin at the camera's centre), so a ray is a direction.
//! The tests are analytic; no ray goes through the physics engine.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::rays::Tile;
use crate::shapes::{Paint, Shape, Solid};

/// Light from the lamps of the room, world frame: mostly from above.
const LIGHT: [f64; 3] = [0.25, 0.35, 0.9];

/// Share of the light that comes from everywhere.
const AMBIENT: f64 = 0.75;

/// A shape put before a camera.
#[derive(Debug, Clone)]
pub struct Seen {
    form: Form,
    /// Centre and radius of a ball that it is in.
    ball: (Vector3<f64>, f64),
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

/// A plane that does not go through the camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plane {
    /// Its unit normal, away from the camera, and how far it is along that, m.
    row: Vector3<f64>,
    way: f64,
}

/// One plane counts as nearer than another by this share at least: depths are rounded.
const NEARER: f64 = 1e-6;

impl Plane {
    /// Distance along a ray that meets it.
    pub fn distance(&self, ray: &Vector3<f64>) -> f64 {
        self.way / self.row.dot(ray)
    }

    /// Whether all rays of a tile, which all meet this one, meet it before the other plane, if they meet that at all.
    pub fn is_before(&self, other: &Self, tile: &Tile) -> bool {
        // Of two quotients with positive divisors the smaller one is told by products, which are linear in the ray.
        let later = other.row * (self.way * (1.0 + NEARER)) - self.row * other.way;
        later.dot(&tile.axis) + later.norm() * tile.spread < 0.0
    }
}

/// A plane surface before a tile all of whose rays meet it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Face {
    /// The plane that it is in.
    pub plane: Plane,
    /// How much of its tone it shows, by Lambert's law.
    pub shade: f64,
}

impl Face {
    /// Tells `found` for each of `rays`, which are of the tile: its index and the distance.
    pub fn hits(&self, rays: &[Vector3<f64>], found: impl FnMut(usize, f64)) {
        each(rays, found, |ray| Some(self.plane.distance(ray)));
    }
}

/// What is so near to an edge of a block, m, counts as no part of a face.
const EDGE: f64 = 1e-6;

impl Form {
    fn ball(&self) -> (Vector3<f64>, f64) {
        match self {
            Self::Ball { centre, radius } | Self::Disc { centre, radius, .. } => (*centre, *radius),
            Self::Capsule { a, b, radius } => ((a + b) / 2.0, (b - a).norm() / 2.0 + radius),
            Self::Block { turn, eye, half } => (-turn.tr_mul(eye), half.norm()),
            Self::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => (-turn.tr_mul(eye), half.hypot(*radius)),
        }
    }

    fn is_around_the_eye(&self) -> bool {
        match self {
            Self::Ball { centre, radius } => centre.norm() < *radius,
            Self::Capsule { a, b, radius } => {
                let axis = b - a;
                let along = (-axis.dot(a) / axis.norm_squared()).clamp(0.0, 1.0);
                (a + axis * along).norm() < *radius
            }
            Self::Block { eye, half, .. } => eye.iter().zip(half).all(|(x, half)| x.abs() < *half),
            Self::Cylinder {
                eye, half, radius, ..
            } => eye.z.abs() < *half && eye.xy().norm() < *radius,
            Self::Disc { .. } => false,
        }
    }

    /// False when the ray nowhere comes within `slack` of it. A ball and a disc are as good as the ball that they are in.
    fn comes_within(&self, ray: &Vector3<f64>, slack: f64) -> bool {
        match self {
            Self::Ball { .. } | Self::Disc { .. } => true,
            Self::Capsule { a, b, radius } => {
                // The place of the segment that is nearest to the ray's line; behind the camera, that nearest to the camera.
                let axis = b - a;
                let nearest = |from: &Vector3<f64>, along: &Vector3<f64>| {
                    let place = -from.dot(along) / along.norm_squared().max(1e-30);
                    a + axis * place.clamp(0.0, 1.0)
                };
                let across = |v: &Vector3<f64>| v - ray * ray.dot(v);
                let (line, eye) = (nearest(&across(a), &across(&axis)), nearest(a, &axis));
                let distance = if line.dot(ray) >= 0.0 || eye.dot(ray) > 0.0 {
                    across(&line).norm()
                } else {
                    eye.norm()
                };
                distance <= radius + slack
            }
            Self::Block { turn, eye, half } => {
                let ray = turn * ray;
                let [x, y, z] = [0, 1, 2].map(|k| slab(eye[k], ray[k], half[k] + slack));
                meet([x, y, z])
            }
            Self::Cylinder {
                turn,
                eye,
                half,
                radius,
            } => {
                let ray = turn * ray;
                let side = circle(eye, &ray, radius + slack);
                meet([slab(eye.z, ray.z, half + slack), side])
            }
        }
    }
}

/// Whether a ray comes as near to a point.
fn comes_within(ray: &Vector3<f64>, centre: &Vector3<f64>, distance: f64) -> bool {
    let along = ray.dot(centre).max(0.0);
    centre.norm_squared() - along * along <= distance * distance
}

/// Whether spans of a ray before the camera have a point in common.
fn meet<const N: usize>(spans: [Option<[f64; 2]>; N]) -> bool {
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for span in spans {
        let Some([first, last]) = span else {
            return false;
        };
        enter = enter.max(first);
        leave = leave.min(last);
    }
    enter <= leave
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
            ball: form.ball(),
            form,
            tone: tone(shape.paint, colour),
            light: camera_t_world * Vector3::from(LIGHT).normalize(),
        }
    }

    /// Centre and radius of a ball that it is in.
    pub(crate) fn ball(&self) -> (Vector3<f64>, f64) {
        self.ball
    }

    /// Whether the camera is inside it, and so does not see it.
    pub(crate) fn is_around_the_eye(&self) -> bool {
        self.form.is_around_the_eye()
    }

    /// False when no ray of the tile meets the solid.
    pub(crate) fn may_meet(&self, tile: &Tile) -> bool {
        let (centre, radius) = self.ball;
        // So far along the axis is the last of it; no ray is further from the axis there than `slack`.
        let last = tile.axis.dot(&centre) + radius;
        let slack = tile.spread * last / (1.0 - tile.spread * tile.spread / 2.0);
        last > 0.0
            && comes_within(&tile.axis, &centre, radius + slack)
            && self.form.comes_within(&tile.axis, slack)
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

    /// The face of a block that all rays of a tile meet, if it is one and the same.
    pub(crate) fn face(&self, tile: &Tile) -> Option<Face> {
        let Form::Block { turn, eye, half } = &self.form else {
            return None;
        };
        let axis = turn * tile.axis;
        // What every ray of the tile has along an axis of the block lies between these.
        let bounds = |k: usize| [axis[k] - tile.spread, axis[k] + tile.spread];
        let is_met = |k: &usize| {
            let [least, most] = bounds(*k);
            let gap = eye[*k].abs() - half[*k];
            if gap <= 0.0 || least * most <= 0.0 || least * eye[*k] >= 0.0 {
                return false;
            }
            let times = [gap / least.abs(), gap / most.abs()];
            (0..3).filter(|other| other != k).all(|other| {
                let room = half[other] - EDGE;
                let ways = bounds(other).map(|way| times.map(|time| eye[other] + time * way));
                ways.as_flattened().iter().all(|at| at.abs() < room)
            })
        };
        let k = (0..3).find(is_met)?;
        let side = eye[k].signum();
        let mut normal = Vector3::zeros();
        normal[k] = side;
        let normal = turn.transpose() * normal;
        Some(Face {
            plane: Plane {
                row: turn.row(k).transpose() * -side,
                way: eye[k].abs() - half[k],
            },
            shade: lambert(1.0, normal.dot(&self.light)),
        })
    }

    /// Whether all of it is behind a plane.
    pub(crate) fn is_behind(&self, plane: &Plane) -> bool {
        let (centre, radius) = self.ball;
        let half = match &self.form {
            Form::Block { turn, half, .. } => (turn * plane.row).abs().dot(half),
            _ => radius,
        };
        plane.row.dot(&centre) - half - PAINT > plane.way * (1.0 + NEARER)
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
    /// Grey of what has the tone 1 in the light, and of a joint.
    grey: [f64; 2],
}

impl Floor {
    /// The floor before a camera.
    #[must_use]
    pub fn new(camera_t_world: &Isometry3<f64>) -> Self {
        Self {
            world_t_camera: camera_t_world.inverse(),
            up: camera_t_world * Vector3::z(),
            grey: [1.0, JOINT].map(|tone| lambert(tone, Vector3::from(LIGHT).normalize().z)),
        }
    }

    /// Distance along the unit direction `ray`; `None` above the horizon.
    pub fn hit(&self, ray: &Vector3<f64>) -> Option<f64> {
        let rise = self.up.dot(ray);
        let distance = -self.world_t_camera.translation.vector.z / rise;
        (rise < -1e-9 && distance > 0.0).then_some(distance)
    }

    /// The floor as a plane.
    pub(crate) fn plane(&self) -> Plane {
        Plane {
            row: -self.up,
            way: self.world_t_camera.translation.vector.z,
        }
    }

    /// The floor before a tile all of whose rays meet it, where it has no joint.
    pub(crate) fn face(&self, tile: &Tile) -> Option<Face> {
        let plane = self.plane();
        let fall = plane.row.dot(&tile.axis);
        if plane.way <= 0.0 || fall - tile.spread < 1e-6 {
            return None;
        }
        // No ray meets it further from where the axis does.
        let [near, middle, far] =
            [tile.spread, 0.0, -tile.spread].map(|spread| plane.way / (fall + spread));
        let around = far * tile.spread + (far - middle).max(middle - near) + EDGE;
        let at = self.world_t_camera * Point3::from(tile.axis * middle);
        let is_even = |x: f64| {
            let [from, to] = [x - around, x + around].map(|x| x / TILE);
            let joint = JOINT_WIDTH / TILE / 2.0;
            let within = |x: f64| (joint..=1.0 - joint).contains(&(x - from.floor()));
            within(from) && within(to)
        };
        let shade = self.grey[0];
        (is_even(at.x) && is_even(at.y)).then_some(Face { plane, shade })
    }

    /// How much of its tone the point at `distance` along `ray` shows.
    pub fn shade(&self, ray: &Vector3<f64>, distance: f64) -> f64 {
        let point = self.world_t_camera * Point3::from(ray * distance);
        let joint =
            |x: f64| (x / TILE - (x / TILE).floor() - 0.5).abs() > 0.5 - JOINT_WIDTH / TILE / 2.0;
        self.grey[usize::from(joint(point.x) || joint(point.y))]
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
    use crate::{rays::Rays, truth::CameraTruth};

    /// Distance of a point to a segment, the definition of a capsule.
    fn to_segment(p: &Vector3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        let axis = b - a;
        let along = ((p - a).dot(&axis) / axis.norm_squared().max(1e-300)).clamp(0.0, 1.0);
        (p - a - axis * along).norm()
    }

    fn near() -> impl Strategy<Value = Vector3<f64>> {
        (-0.5..0.5_f64, -0.5..0.5_f64, 1.5..2.5_f64).prop_map(|(x, y, z)| Vector3::new(x, y, z))
    }

    #[test]
    fn a_wide_block_before_the_camera_has_a_face_behind_whole_tiles() {
        let camera = CameraTruth {
            name: "c".into(),
            width: 60,
            height: 40,
            focal: [45.0, 46.0],
            principal: [31.0, 18.0],
            distortion: crate::truth::Distortion::default(),
            camera_t_world: Isometry3::identity(),
            valid_radius: f64::INFINITY,
        };
        let solid = Solid::Block {
            centre: Point3::origin(),
            half: Vector3::new(2.0, 2.0, 0.1),
        };
        let shape = Shape {
            solid,
            paint: Paint::Grey(100.0),
        };
        let frame = Isometry3::translation(0.0, 0.0, 1.0);
        let seen = Seen::new(&shape, &frame, &Isometry3::identity(), false);
        let rays = Rays::new(&camera);
        assert!(rays.tiles().iter().all(|tile| seen.face(tile).is_some()));
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
        fn a_face_that_a_tile_has_before_it_is_what_each_of_its_rays_meets(
            place in near(), turn in prop::array::uniform3(-3.0..3.0_f64), half in 0.2..1.2_f64,
        ) {
            let camera = CameraTruth {
                name: "c".into(),
                width: 60,
                height: 40,
                focal: [45.0, 46.0],
                principal: [31.0, 18.0],
                distortion: crate::truth::Distortion::default(),
                camera_t_world: Isometry3::identity(),
                valid_radius: f64::INFINITY,
            };
            let rays = Rays::new(&camera);
            let half = Vector3::new(half, 0.8, half / 2.0);
            let solid = Solid::Block { centre: Point3::origin(), half };
            let shape = Shape { solid, paint: Paint::Grey(100.0) };
            let frame = Isometry3::new(place, turn.into());
            let seen = Seen::new(&shape, &frame, &Isometry3::identity(), false);
            for tile in rays.tiles() {
                let Some(face) = seen.face(tile) else { continue };
                for run in &tile.runs {
                    let own = &rays.all()[run.clone()];
                    let mut found = Vec::new();
                    face.hits(own, |_, distance| found.push(Some(distance)));
                    let expected: Vec<_> = own.iter().map(|ray| seen.hit(ray)).collect();
                    prop_assert_eq!(&found, &expected);
                    for (ray, distance) in own.iter().zip(expected.into_iter().flatten()) {
                        prop_assert_eq!(seen.shade(ray, distance), face.shade);
                    }
                }
            }
        }

        #[test]
        fn no_ray_of_what_is_left_out_meets_the_solid(
            a in near(), b in near(), radius in 0.02..0.2_f64, turn in near(), closer in 0.0..2.0_f64,
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
            let rays = Rays::new(&camera);
            let (half, normal) = (Vector3::new(radius, 0.3, radius / 2.0), Vector3::z());
            let solids = [
                Solid::Capsule { a: a.into(), b: b.into(), radius },
                Solid::Capsule { a: a.into(), b: a.into(), radius },
                Solid::Block { centre: Point3::origin(), half },
                Solid::Cylinder { half: 0.3, radius },
                Solid::Disc { centre: a.into(), normal, radius },
            ];
            // Before, beside, around and behind the camera.
            let frame = Isometry3::new(a - Vector3::z() * closer, turn);
            for solid in solids {
                let shape = Shape { solid, paint: Paint::Grey(100.0) };
                let seen = Seen::new(&shape, &frame, &Isometry3::identity(), false);
                let all = rays.tiles().iter();
                for tile in all.filter(|tile| seen.is_around_the_eye() || !seen.may_meet(tile)) {
                    let mut own = tile.runs.iter().flat_map(|run| &rays.all()[run.clone()]);
                    prop_assert!(own.all(|ray| seen.hit(ray).is_none()), "{solid:?}");
                }
            }
        }
    }
}
