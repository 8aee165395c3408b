//! Hand-eye calibrations whose answer is known, and those that have none.
use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

fn pose(turn: [f64; 3], shift: [f64; 3]) -> Isometry3<f64> {
    Isometry3::new(Vector3::from(shift), Vector3::from(turn))
}

fn truth() -> (Isometry3<f64>, Isometry3<f64>) {
    (
        pose([0.1, -0.2, 1.5], [0.03, -0.05, 0.08]),
        pose([2.0, 0.3, -0.5], [0.6, 0.1, 0.02]),
    )
}

/// Samples with noise of the seen pose, rad and m a coordinate.
fn samples(n: usize, axes: [f64; 3], noise: (f64, f64), seed: u64) -> Vec<Sample> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (x, y) = truth();
    (0..n)
        .map(|_| {
            let mut draw = |size: f64| rng.random_range(-size..=size);
            let turn = axes.map(&mut draw);
            let base_t_tool = pose(turn, [0.5 + draw(0.2), draw(0.2), 0.6 + draw(0.2)]);
            let seen = (base_t_tool * x).inverse() * y;
            let mut deviate = |sd: f64| {
                let drawn: f64 = rng.sample(StandardNormal);
                sd * drawn
            };
            let off = [0; 3].map(|_| deviate(noise.0));
            let by = [0; 3].map(|_| deviate(noise.1));
            let turned = UnitQuaternion::new(Vector3::from(off)) * seen.rotation;
            let shifted = seen.translation.vector + Vector3::from(by);
            Sample {
                base_t_tool,
                camera_t_target: Isometry3::from_parts(shifted.into(), turned),
            }
        })
        .collect()
}

fn errors(found: &HandEye) -> [f64; 6] {
    let x = truth().0;
    let turn = found.tool_t_camera.rotation.scaled_axis() - x.rotation.scaled_axis();
    let shift = found.tool_t_camera.translation.vector - x.translation.vector;
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}

#[test]
fn exact_samples_give_the_exact_place() {
    for n in [3, 4, 20] {
        let found = hand_eye(&samples(n, [0.8; 3], (0.0, 0.0), 1)).unwrap();
        assert!(
            errors(&found).iter().all(|error| error.abs() < 1e-9),
            "{n}: {found:?}"
        );
        let off = found.base_t_target.inverse() * truth().1;
        assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-9);
        assert!(found.rms_rad < 1e-9 && found.rms_m < 1e-9);
    }
}

#[test]
fn errors_have_the_size_that_is_answered_and_residuals_that_of_the_noise() {
    let (mut squares, runs) = ([0.0; 6], 100);
    for seed in 0..runs {
        let found = hand_eye(&samples(20, [0.7; 3], (2e-3, 5e-4), seed)).unwrap();
        for ((sum, error), sd) in squares.iter_mut().zip(errors(&found)).zip(found.sd) {
            *sum += (error / sd).powi(2) / runs as f64;
        }
        assert!((found.rms_rad / (2e-3 * 3_f64.sqrt()) - 1.0).abs() < 0.4);
        assert!((found.rms_m / (5e-4 * 3_f64.sqrt()) - 1.0).abs() < 0.4);
    }
    for square in squares {
        assert!((0.75..1.25).contains(&square.sqrt()), "{squares:?}");
    }
}

#[test]
fn samples_without_an_answer_are_refused_with_their_reason() {
    let two = samples(2, [0.8; 3], (0.0, 0.0), 1);
    assert_eq!(hand_eye(&two), Err(HandEyeError::TooFew(2)));
    let one_axis = samples(12, [0.0, 0.0, 0.8], (1e-4, 1e-4), 2);
    assert!(matches!(hand_eye(&one_axis), Err(HandEyeError::OneAxis(_))));
    let large = samples(12, [0.8; 3], (1e-4, 1e-4), 4)
        .into_iter()
        .map(|mut one| {
            one.base_t_tool.translation.vector *= 1e3;
            one
        });
    let large = hand_eye(&large.collect::<Vec<_>>()).unwrap_err();
    assert!(
        large.to_string().contains("are these millimetres?"),
        "{large}"
    );
    // Poses of other moments, and inverses.
    let good = samples(12, [0.8; 3], (1e-4, 1e-4), 5);
    let shuffled: Vec<Sample> = (0..12)
        .map(|k| Sample {
            camera_t_target: good[(5 * k + 3) % 12].camera_t_target,
            ..good[k]
        })
        .collect();
    let inverse = |one: &Sample| Sample {
        base_t_tool: one.base_t_tool.inverse(),
        ..*one
    };
    let inverses: Vec<Sample> = good.iter().map(inverse).collect();
    let lengths = |one: &Sample| {
        let mut one = *one;
        one.camera_t_target.translation.vector *= 1e3;
        one
    };
    let lengths: Vec<Sample> = good.iter().map(lengths).collect();
    for wrong in [shuffled, inverses, lengths] {
        let refused = hand_eye(&wrong);
        assert!(
            matches!(refused, Err(HandEyeError::Disagree { .. })),
            "{refused:?}"
        );
    }
    let still = samples(12, [0.0; 3], (1e-4, 1e-4), 3);
    assert!(matches!(hand_eye(&still), Err(HandEyeError::NoTurns(_))));
}

#[test]
fn samples_that_do_not_agree_with_the_others_are_left_out_and_named() {
    for seed in 0..20 {
        let good = samples(15, [0.7; 3], (1e-3, 5e-4), 100 + seed);
        let mut some = good.clone();
        some[4].camera_t_target = pose([0.2, 0.0, 0.0], [0.0; 3]) * some[4].camera_t_target;
        some[9].camera_t_target.translation.vector.x += 0.1;
        let found = hand_eye(&some).unwrap();
        let rows: Vec<usize> = found.rejected.iter().map(|one| one.row).collect();
        assert_eq!(rows, [4, 9]);
        assert!((found.rejected[0].off_rad - 0.2).abs() < 0.01, "{found:?}");
        assert!((found.rejected[1].off_m - 0.1).abs() < 0.01, "{found:?}");
        let without: Vec<Sample> = (0..15)
            .filter(|k| ![4, 9].contains(k))
            .map(|k| good[k])
            .collect();
        let without = hand_eye(&without).unwrap();
        assert!(without.rejected.is_empty());
        assert_eq!(
            (found.tool_t_camera, found.sd),
            (without.tool_t_camera, without.sd)
        );
        // Noise alone is no reason.
        assert!(hand_eye(&good).unwrap().rejected.is_empty());
    }
}
