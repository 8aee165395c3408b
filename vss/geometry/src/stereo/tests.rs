//! Pairs of cameras whose geometry is known.
use super::*;
use crate::camera::tests::ceiling_camera;
use nalgebra::UnitQuaternion;

fn cameras() -> (Camera, Camera) {
    let left = ceiling_camera();
    let turn = UnitQuaternion::new(Vector3::new(0.02, 0.25, -0.05));
    let right = Camera {
        rotation: turn * left.rotation,
        centre: left.centre + Vector3::new(0.3, 0.05, -0.02),
        ..left
    };
    (left, right)
}

#[test]
fn pixels_of_a_point_give_the_point_back() {
    let (left, right) = cameras();
    for (x, y, z) in [(0.1, 0.2, 0.5), (-0.3, 0.1, 0.9), (0.0, 0.0, 0.2)] {
        let point = Point3::new(x, y, z);
        let pixels = (
            left.project(&point).unwrap(),
            right.project(&point).unwrap(),
        );
        let found = triangulate(&left, &right, pixels.0, pixels.1).unwrap();
        assert!(
            (found.point - point).norm() < 1e-8 && found.gap_m < 1e-8,
            "{found:?}"
        );
        // A row off by a pixel opens a gap of about its size in the world.
        let off = pixels.1 + Vector2::new(0.0, 1.0);
        let found = triangulate(&left, &right, pixels.0, off).unwrap();
        let pixel_m = (left.centre - point).norm() / left.focal();
        assert!(
            (0.3..3.0).contains(&(found.gap_m / pixel_m)),
            "{found:?} {pixel_m}"
        );
    }
}

#[test]
fn rays_that_are_parallel_or_part_are_refused() {
    let (left, right) = cameras();
    let point = Point3::new(0.1, 0.2, 0.5);
    let pixel = left.project(&point).unwrap();
    assert!(matches!(
        triangulate(&left, &left, pixel, pixel),
        Err(NoPoint::OnePlace(_))
    ));
    let mut beside = left;
    beside.centre.x += 1e-4;
    assert!(matches!(
        triangulate(&left, &beside, pixel, pixel),
        Err(NoPoint::Parallel(_))
    ));
    // Behind both cameras, where the lines of two other pixels meet.
    let behind = left.centre + (left.centre - point);
    let mirrored = |camera: &Camera| {
        let seen = camera.in_camera_frame(&behind);
        let i = camera.intrinsics;
        Vector2::new(i.fx * seen.x / seen.z + i.cx, i.fy * seen.y / seen.z + i.cy)
    };
    let found = triangulate(&left, &right, mirrored(&left), mirrored(&right));
    assert!(
        matches!(found, Err(NoPoint::Behind | NoPoint::NoRay(..))),
        "{found:?}"
    );
}

/// Over many noisy pixels, errors over standard deviations have an rms of 1, and so have gaps.
#[test]
fn points_and_gaps_scatter_as_predicted() {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let (left, right) = cameras();
    let (trials, sd) = (2000, 0.2);
    let (mut errors, mut gaps) = (0.0, 0.0);
    for _ in 0..trials {
        let mut within = |side: f64| rng.random_range(-side..side);
        let point = Point3::new(within(0.4), within(0.4), 0.6 + within(0.4));
        let mut noise = || sd * rng.sample::<f64, _>(rand_distr::StandardNormal);
        let mut pixel =
            |camera: &Camera| camera.project(&point).unwrap() + Vector2::new(noise(), noise());
        let found = triangulate(&left, &right, pixel(&left), pixel(&right)).unwrap();
        let (sds, gap) = found.sd(&left, &right, sd).unwrap();
        for (error, sd) in (found.point - point).iter().zip(sds) {
            errors += (error / sd).powi(2) / (3.0 * f64::from(trials));
        }
        gaps += (found.gap_m / gap).powi(2) / f64::from(trials);
    }
    assert!((errors.sqrt() - 1.0).abs() < 0.1, "{errors}");
    assert!((gaps.sqrt() - 1.0).abs() < 0.15, "{gaps}");
}
