//! Poses of models of many shapes: exact and noisy, with wrong matches, and those that must be refused.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::*;

fn lens() -> (Intrinsics, Distortion) {
    let intrinsics = Intrinsics {
        fx: 800.0,
        fy: 805.0,
        cx: 322.0,
        cy: 238.0,
    };
    let distortion = Distortion {
        k1: -0.25,
        k2: 0.12,
        p1: 1e-3,
        p2: -5e-4,
        k3: -0.02,
    };
    (intrinsics, distortion)
}

fn found(matches: &[Match]) -> Result<ModelPose, NoModelPose> {
    let (intrinsics, distortion) = lens();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    model_pose(matches, &intrinsics, &distortion, &mut rng)
}

/// Points in a box of 0.2 x 0.15 x `depth` m.
fn model(n: usize, depth: f64, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let mut within = |side: f64| side * (rng.random::<f64>() - 0.5);
    let points = (0..n).map(|_| Point3::new(within(0.2), within(0.15), within(depth)));
    points.collect()
}

/// Turned in any way, 0.5 to 1 m before the camera.
fn pose(rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let turn = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
    let mut within = |side: f64| side * (rng.random::<f64>() - 0.5);
    let shift = Vector3::new(within(0.2), within(0.15), 0.75 + within(0.5));
    Isometry3::new(shift, turn)
}

fn seen(
    points: &[Point3<f64>],
    pose: &Isometry3<f64>,
    noise: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<Match> {
    let (intrinsics, distortion) = lens();
    let camera = Camera {
        rotation: pose.rotation,
        centre: pose.inverse() * Point3::origin(),
        intrinsics,
        distortion,
    };
    let see = |point: &Point3<f64>| {
        let mut drawn = || noise * rng.sample::<f64, _>(StandardNormal);
        let pixel = camera.project_unchecked(point).unwrap() + Vector2::new(drawn(), drawn());
        Match {
            point: *point,
            pixel,
        }
    };
    points.iter().map(see).collect()
}

fn apart(one: &Isometry3<f64>, other: &Isometry3<f64>) -> (f64, f64) {
    let between = one.inverse() * other;
    (between.translation.vector.norm(), between.rotation.angle())
}

#[test]
fn exact_matches_give_the_exact_pose_of_deep_and_of_flat_models() {
    for seed in 0..40 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for (n, depth) in [(5, 0.2), (8, 0.1), (8, 0.0), (30, 0.15)] {
            let truth = pose(&mut rng);
            let matches = seen(&model(n, depth, &mut rng), &truth, 0.0, &mut rng);
            let found = found(&matches).unwrap();
            let (shift, turn) = apart(&found.camera_t_model, &truth);
            assert!(
                shift < 1e-7 && turn < 1e-7,
                "{seed} {n} {depth}: {shift} {turn}"
            );
            assert!(found.rejected.is_empty() && found.rms_px < 1e-6);
        }
    }
}

#[test]
fn predicted_intervals_cover_the_truth() {
    let sets: u64 = std::env::var("CTOS_SETS").map_or(200, |sets| sets.parse().unwrap());
    let slack = if sets < 1000 { 0.02 } else { 0.0 };
    let (mut within, mut squares, mut count) = (0.0, [0.0; 6], 0.0);
    for seed in 0..sets {
        let mut rng = ChaCha8Rng::seed_from_u64(500 + seed);
        let truth = pose(&mut rng);
        let matches = seen(&model(20, 0.15, &mut rng), &truth, 0.4, &mut rng);
        let found = found(&matches).unwrap();
        let vector = found.camera_t_model.rotation.scaled_axis();
        // The rotation vector of the truth that is nearest to the one found.
        let near = truth.rotation.scaled_axis();
        let turned = near * (1.0 - std::f64::consts::TAU / near.norm());
        let near = if (near - vector).norm() < (turned - vector).norm() {
            near
        } else {
            turned
        };
        let shift = found.camera_t_model.translation.vector - truth.translation.vector;
        let errors = (vector - near)
            .iter()
            .chain(shift.iter())
            .copied()
            .collect::<Vec<f64>>();
        for (k, (error, sd)) in errors.iter().zip(found.sd()).enumerate() {
            squares[k] += (error / sd).powi(2);
            within += f64::from(u8::from(error.abs() <= 1.96 * sd));
        }
        count += 1.0;
        assert!((0.5..1.6).contains(&(found.noise_px / 0.4)));
    }
    let part = within / (6.0 * count);
    assert!((0.93 - slack..0.97 + slack).contains(&part), "{part}");
    for square in squares {
        let rms = (square / count).sqrt();
        assert!((0.85..1.2).contains(&rms), "{squares:?}");
    }
}

#[test]
fn with_wrong_matches_the_pose_is_that_of_the_right_ones() {
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(900 + seed);
        let truth = pose(&mut rng);
        let mut matches = seen(&model(30, 0.15, &mut rng), &truth, 0.3, &mut rng);
        let right = found(&matches[12..]).unwrap();
        for one in &mut matches[..12] {
            one.pixel = Vector2::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
        }
        let found = found(&matches).unwrap();
        let missed = (0..12).filter(|row| !found.rejected.contains(row)).count();
        // A wrong pixel may lie near by chance.
        assert!(missed <= 1, "{seed}: {:?}", found.rejected);
        if missed == 0 && found.rejected.len() == 12 + right.rejected.len() {
            let (shift, turn) = apart(&found.camera_t_model, &right.camera_t_model);
            assert!(shift < 1e-6 && turn < 1e-6, "{seed}: {shift} {turn}");
        }
        let (shift, turn) = apart(&found.camera_t_model, &truth);
        assert!(shift < 0.02 && turn < 0.05, "{seed}: {shift} {turn}");
    }
}

#[test]
fn matches_without_one_pose_are_refused_with_their_reason() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let truth = Isometry3::new(Vector3::new(0.02, 0.01, 0.7), Vector3::new(0.4, -0.5, 0.3));
    let points = model(12, 0.12, &mut rng);
    let good = seen(&points, &truth, 0.2, &mut rng);
    assert!(found(&good).is_ok());
    assert_eq!(found(&good[..3]), Err(NoModelPose::TooFew(3)));
    let same: Vec<Match> = (0..12).map(|k| good[k % 3]).collect();
    assert_eq!(found(&same), Err(NoModelPose::TooFew(3)));
    let mut broken = good.clone();
    broken[5].pixel.x = f64::NAN;
    assert_eq!(found(&broken), Err(NoModelPose::NotFinite(5)));
    let mut outside = good.clone();
    outside[4].pixel = Vector2::new(5000.0, 240.0);
    let refused = found(&outside).unwrap_err();
    assert!(
        matches!(refused, NoModelPose::NoRay { row: 4, .. }),
        "{refused}"
    );
    let line: Vec<_> = (0..12)
        .map(|k| Point3::new(0.01 * f64::from(k), 0.0, 0.0))
        .collect();
    let refused = found(&seen(&line, &truth, 0.2, &mut rng)).unwrap_err();
    assert!(matches!(refused, NoModelPose::OneLine(_)), "{refused}");
    let changed = |change: &dyn Fn(usize, &mut Match)| {
        let mut matches = good.clone();
        for (row, one) in matches.iter_mut().enumerate() {
            change(row, one);
        }
        found(&matches).unwrap_err()
    };
    let nowhere = |why: NoModelPose| matches!(why, NoModelPose::Nowhere { matches: 12, .. });
    assert!(
        nowhere(changed(&|_, one| one.point.x = -one.point.x)),
        "mirrored"
    );
    assert!(
        nowhere(changed(
            &|row, one| one.pixel = good[(row * 5 + 3) % 12].pixel
        )),
        "other rows"
    );
    assert!(
        nowhere(changed(&|_, one| one.pixel = one.pixel.yx())),
        "u and v swapped"
    );
    assert!(
        nowhere(changed(&|_, one| one.pixel.y = 479.0 - one.pixel.y)),
        "v upwards"
    );
}

/// Eight places of nothing agree with some pose in half of their rows one time in three.
#[test]
fn matches_that_have_nothing_to_do_with_one_another_give_no_pose() {
    let mut taken = 0;
    for seed in 0..200 {
        let mut rng = ChaCha8Rng::seed_from_u64(4000 + seed);
        let points = model(8, 0.15, &mut rng);
        let nothing = points.iter().map(|point| Match {
            point: *point,
            pixel: Vector2::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)),
        });
        let nothing: Vec<Match> = nothing.collect();
        taken += u32::from(found(&nothing).is_ok());
    }
    assert!(taken <= 2, "{taken} of 200");
}

/// What one wrong match among few costs: the others must still make the pose.
#[test]
fn one_wrong_match_of_seven_is_left_out() {
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(5000 + seed);
        let truth = pose(&mut rng);
        let mut matches = seen(&model(7, 0.15, &mut rng), &truth, 0.2, &mut rng);
        matches[3].pixel += Vector2::new(70.0, -50.0);
        let found = found(&matches).unwrap();
        assert_eq!(found.rejected, [3], "{seed}");
    }
}

#[test]
fn a_square_seen_from_straight_above_is_found() {
    let corners = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]];
    let corners = corners.map(|[x, y]| Point3::new(x, y, 0.0));
    let truth = Isometry3::new(
        Vector3::new(0.0, 0.0, 0.5),
        Vector3::new(std::f64::consts::PI, 0.0, 0.0),
    );
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut intrinsics, distortion) = (lens().0, Distortion::default());
    intrinsics.fy = intrinsics.fx;
    let camera = Camera {
        rotation: truth.rotation,
        centre: truth.inverse() * Point3::origin(),
        intrinsics,
        distortion,
    };
    let matches = corners.map(|point| Match {
        point,
        pixel: camera.project(&point).unwrap(),
    });
    let found = model_pose(&matches, &intrinsics, &distortion, &mut rng).unwrap();
    let (shift, turn) = apart(&found.camera_t_model, &truth);
    assert!(shift < 1e-6 && turn < 1e-4, "{shift} {turn}");
}

#[test]
fn millimetres_for_metres_are_told() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let truth = pose(&mut rng);
    let mut matches = seen(&model(12, 0.12, &mut rng), &truth, 0.2, &mut rng);
    for one in &mut matches {
        one.point *= 1000.0;
    }
    let refused = found(&matches).unwrap_err();
    assert!(matches!(refused, NoModelPose::TooFar(_)), "{refused}");
}

/// To compare each row with all others would take minutes.
#[test]
fn a_table_of_half_a_million_rows_is_looked_through_at_once() {
    let match_of = |k: u32| Match {
        point: Point3::new(1e-5 * f64::from(k), f64::from(k % 7), f64::from(k % 11)),
        pixel: Vector2::new(f64::from(k % 640), f64::from(k % 480)),
    };
    let matches: Vec<Match> = (0..500_000).map(match_of).collect();
    let rays = checked(&matches, &lens().0, &Distortion::default());
    assert_eq!(rays.unwrap().len(), matches.len());
}

/// Far away a small plane looks the same tilted to either side.
#[test]
fn a_small_flat_model_that_can_be_tilted_either_way_is_refused_as_ambiguous() {
    let mut refused = 0;
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let points = model(6, 0.0, &mut rng);
        let truth = Isometry3::new(Vector3::new(0.1, -0.1, 6.0), Vector3::new(0.5, 0.2, 0.0));
        match found(&seen(&points, &truth, 0.3, &mut rng)) {
            Err(NoModelPose::Ambiguous {
                first_px,
                second_px,
                turn_rad,
            }) => {
                assert!(first_px <= second_px && turn_rad > 0.1);
                refused += 1;
            }
            Err(other) => panic!("{other}"),
            // What is answered must be right.
            Ok(found) => {
                let (_, turn) = apart(&found.camera_t_model, &truth);
                let sd = found.sd()[..3].iter().fold(0.0, |a: f64, b| a.max(*b));
                assert!(turn < 5.0 * sd, "{seed}: {turn} {sd}");
            }
        }
    }
    assert!(refused >= 15, "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn no_matches_panic(
        rows in prop::collection::vec(prop::array::uniform5(-1.0..1.0_f64), 0..14),
        scale in prop::sample::select(vec![1e-300, 1e-9, 1.0, 1e9, 1e155]),
        exact in any::<bool>(),
    ) {
        let matches: Vec<Match> = rows.iter().map(|r| {
            let number = |x: f64| if exact { x.round() } else { x } * scale;
            Match {
                point: Point3::new(number(r[0]), number(r[1]), number(r[2])),
                pixel: Vector2::new(320.0 + 300.0 * r[3], 240.0 + 220.0 * r[4]),
            }
        }).collect();
        if let Ok(found) = found(&matches) {
            prop_assert!(found.rms_px.is_finite() && found.sd().iter().all(|sd| sd.is_finite()));
        }
    }
}
