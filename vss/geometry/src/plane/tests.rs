//! Calibration from a plane against known cameras.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const INTRINSICS: Intrinsics = Intrinsics {
    fx: 533.0,
    fy: 534.5,
    cx: 342.0,
    cy: 234.0,
};

const LENS: Distortion = Distortion {
    k1: -0.28,
    k2: 0.05,
    p1: 1.1e-3,
    p2: -3e-4,
    k3: 0.06,
};

/// A board of 9 x 6 corners, 25 mm apart, in `count` tilted views; corners with noise.
fn views(
    count: usize,
    noise: f64,
    tilt: f64,
    rng: &mut ChaCha8Rng,
) -> (Vec<Vec<Corner>>, Vec<Isometry3<f64>>) {
    let (mut views, mut poses) = (Vec::new(), Vec::new());
    while views.len() < count {
        let mut within = |half: f64| rng.random_range(-half..half);
        let turn = Vector3::new(within(tilt), within(tilt), within(0.4));
        let middle = Vector3::new(within(0.08), within(0.06), 0.4 + within(0.08));
        let rotation = UnitQuaternion::new(turn);
        let place = middle - rotation * Vector3::new(0.1, 0.0625, 0.0);
        let pose = Isometry3::from_parts(place.into(), rotation);
        let seen = Camera {
            distortion: LENS,
            ..camera(&pose, INTRINSICS)
        };
        let corner = |k: usize| {
            let on_plane = Point2::new(0.025 * (k % 9) as f64, 0.025 * (k / 9) as f64);
            let pixel = seen.project(&Point3::new(on_plane.x, on_plane.y, 0.0))?;
            let inside = (0.0..639.0).contains(&pixel.x) && (0.0..479.0).contains(&pixel.y);
            inside.then_some(Corner { on_plane, pixel })
        };
        if let Some(mut corners) = (0..54).map(corner).collect::<Option<Vec<_>>>() {
            for corner in &mut corners {
                let mut deviate = || -> f64 { rng.sample(StandardNormal) };
                corner.pixel += Vector2::new(deviate(), deviate()) * noise;
            }
            views.push(corners);
            poses.push(pose);
        }
    }
    (views, poses)
}

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn errors(found: &PlaneCalibration) -> [f64; 9] {
    let (i, d) = (&found.intrinsics, &found.distortion);
    [
        i.fx - INTRINSICS.fx,
        i.fy - INTRINSICS.fy,
        i.cx - INTRINSICS.cx,
        i.cy - INTRINSICS.cy,
        d.k1 - LENS.k1,
        d.k2 - LENS.k2,
        d.p1 - LENS.p1,
        d.p2 - LENS.p2,
        d.k3 - LENS.k3,
    ]
}

#[test]
fn exact_corners_give_the_exact_camera_and_poses() {
    let (views, poses) = views(8, 0.0, 0.6, &mut rng(1));
    let found = calibrate_plane(&views, 640, 480, LensModel::Brown5).unwrap();
    assert!(found.rms_px < 1e-6, "{}", found.rms_px);
    for error in errors(&found) {
        assert!(error.abs() < 1e-4, "{:?}", errors(&found));
    }
    for (view, pose) in found.views.iter().zip(&poses) {
        let off = view.camera_t_plane.inverse() * pose;
        assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6);
    }
}

#[test]
fn errors_have_the_size_of_the_answered_standard_deviations() {
    let runs = 40;
    let (mut squares, mut of_poses) = ([0.0; 9], 0.0);
    for seed in 0..runs {
        let (views, poses) = views(10, 0.2, 0.6, &mut rng(100 + seed));
        let found = calibrate_plane(&views, 640, 480, LensModel::Brown5).unwrap();
        for ((sum, error), sd) in squares.iter_mut().zip(errors(&found)).zip(found.sd) {
            *sum += (error / sd).powi(2) / runs as f64;
        }
        for (view, pose) in found.views.iter().zip(&poses) {
            let turn = view.camera_t_plane.rotation.scaled_axis() - pose.rotation.scaled_axis();
            let way = view.camera_t_plane.translation.vector - pose.translation.vector;
            let all = turn.iter().chain(way.iter());
            let ratios = all.zip(view.sd).map(|(error, sd)| (error / sd).powi(2));
            of_poses += ratios.sum::<f64>() / (runs * 60) as f64;
        }
        assert!(
            (found.noise_px / 0.2 - 1.0).abs() < 0.15,
            "{}",
            found.noise_px
        );
    }
    for square in squares {
        assert!((0.6..1.4).contains(&square.sqrt()), "{squares:?}");
    }
    assert!((0.85..1.15).contains(&of_poses.sqrt()), "{of_poses}");
}

#[test]
fn views_from_which_no_camera_follows_are_refused_with_their_reason() {
    let (good, _) = views(5, 0.1, 0.6, &mut rng(3));
    let refused =
        |views: &[Vec<Corner>]| calibrate_plane(views, 640, 480, LensModel::K1K2).unwrap_err();
    assert_eq!(refused(&good[..2]), PlaneError::TooFewViews(2));
    let mut few = good.clone();
    few[3].truncate(5);
    assert_eq!(refused(&few), PlaneError::TooFewPoints(3, 5));
    let mut line = good.clone();
    line[1].truncate(9);
    assert_eq!(refused(&line), PlaneError::OneLine(1));
    let mut mirrored = good.clone();
    for corner in &mut mirrored[2] {
        corner.on_plane.x = -corner.on_plane.x;
    }
    assert_eq!(refused(&mirrored), PlaneError::Mirrored(2));
    let (level, _) = views(5, 0.0, 1e-9, &mut rng(4));
    // Through a lens that bends lines, level views differ a little.
    for useless in [level, vec![good[0].clone(); 5]] {
        let told = refused(&useless).to_string();
        assert!(told.contains("tilt"), "{told}");
    }
}

/// 120 views are 729 unknowns.
#[test]
fn many_views_determine_a_camera_as_few_do() {
    let (views, _) = views(120, 0.05, 0.6, &mut rng(5));
    // Ten corners of each: what is slow is the number of unknowns.
    let views: Vec<Vec<Corner>> = views
        .into_iter()
        .map(|view| view.into_iter().step_by(5).collect())
        .collect();
    let found = calibrate_plane(&views, 640, 480, LensModel::Brown5).unwrap();
    for (error, sd) in errors(&found).iter().zip(found.sd) {
        assert!(
            error.abs() < 4.0 * sd,
            "{:?} {:?}",
            errors(&found),
            found.sd
        );
    }
}

/// The one that differs from the others is told, also when it is the first.
#[test]
fn the_view_that_is_mirrored_is_told_not_the_others() {
    let (mut views, _) = views(6, 0.05, 0.6, &mut rng(6));
    for corner in &mut views[0] {
        corner.on_plane.x = 0.2 - corner.on_plane.x;
    }
    let refused = calibrate_plane(&views, 640, 480, LensModel::Brown5);
    assert_eq!(refused.unwrap_err(), PlaneError::Mirrored(0));
}
