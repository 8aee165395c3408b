//! Chequered patterns before a camera, for tests; those of the service objects use the same file.

use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::camera::{Camera, Distortion, Intrinsics};
use crate::frame::Frame;

const LENS: Distortion = Distortion {
    k1: -0.25,
    k2: 0.08,
    p1: 5e-4,
    p2: -3e-4,
    k3: 0.0,
};

/// A camera before a pattern whose fields are 1 wide.
pub(crate) fn camera(turn: Vector3<f64>, distance: f64, columns: usize, rows: usize) -> Camera {
    let rotation = UnitQuaternion::new(turn);
    let middle = Vector3::new(0.5 * (columns as f64 - 1.0), 0.5 * (rows as f64 - 1.0), 0.0);
    let place = Vector3::new(0.1, -0.05, distance) - rotation * middle;
    let pose = Isometry3::from_parts(place.into(), rotation);
    Camera {
        rotation: pose.rotation,
        centre: pose.inverse().translation.vector.into(),
        intrinsics: Intrinsics {
            fx: 500.0,
            fy: 502.0,
            cx: 161.0,
            cy: 119.0,
        },
        distortion: LENS,
    }
}

/// The pattern of `columns` x `rows` inner corners, whose first is at the origin of the plane, on a white sheet.
pub(crate) fn rendered(
    camera: &Camera,
    columns: usize,
    rows: usize,
    noise: f64,
    seed: u64,
) -> Frame {
    let (width, height, parts) = (320, 240, 16);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rotation: Matrix3<f64> = camera.rotation.inverse().to_rotation_matrix().into_inner();
    let part = |k: usize| (k as f64 + 0.5) / parts as f64 - 0.5;
    // Where a ray meets the plane, fields from the outer corner.
    let met = |u: f64, v: f64| {
        let ray = rotation * camera.ray(Vector2::new(u, v))?;
        let on = camera.centre - ray * (camera.centre.z / ray.z);
        Some((on.x + 1.0, on.y + 1.0))
    };
    let grey = |u: f64, v: f64| {
        let Some((x, y)) = met(u, v) else {
            return 100.0;
        };
        let inside = x > 0.0 && y > 0.0 && x < columns as f64 + 1.0 && y < rows as f64 + 1.0;
        if inside && (x.floor() + y.floor()) as i64 % 2 == 0 {
            40.0
        } else {
            200.0
        }
    };
    // A pixel sees a twentieth of a field, and less than a fifth of a tilted one: far from all lines it has one colour.
    let plain = |u: f64, v: f64| {
        let from_line = |x: f64| (x - x.round()).abs();
        met(u, v).is_some_and(|(x, y)| from_line(x).min(from_line(y)) > 0.2)
    };
    let sampled: Vec<f64> = (0..width * height)
        .map(|at| {
            let (u, v) = ((at % width) as f64, (at / width) as f64);
            if plain(u, v) {
                return grey(u, v);
            }
            // No two samples share a column or a row, so that edges along these are not seen in steps.
            let parts = (0..parts).map(|k| grey(u + part(7 * k % parts), v + part(k)));
            parts.sum::<f64>() / 16.0
        })
        .collect();
    // A lens is never quite sharp: 1 2 1 in both directions.
    let at = |u: usize, v: usize| sampled[v.min(height - 1) * width + u.min(width - 1)];
    let pixels: Vec<u8> = (0..width * height)
        .map(|k| {
            let (u, v) = (k % width, k / width);
            let row =
                |v: usize| 0.25 * at(u.saturating_sub(1), v) + 0.5 * at(u, v) + 0.25 * at(u + 1, v);
            let value = 0.25 * row(v.saturating_sub(1)) + 0.5 * row(v) + 0.25 * row(v + 1);
            let deviate: f64 = rng.sample(StandardNormal);
            (value + noise * deviate).round().clamp(0.0, 255.0) as u8
        })
        .collect();
    Frame::grey8(width, height, pixels)
}

pub(crate) fn truth(camera: &Camera, columns: usize, rows: usize) -> Vec<Vector2<f64>> {
    let corner = |k: usize| Point3::new((k % columns) as f64, (k / columns) as f64, 0.0);
    (0..columns * rows)
        .map(|k| camera.project(&corner(k)).unwrap())
        .collect()
}
