use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;
use crate::camera::{Distortion, Intrinsics};

fn scanner() -> Scanner {
    Scanner {
        world_t_scanner: Isometry3::new(Vector3::new(0.3, -0.2, 1.5), Vector3::new(2.9, 0.3, 0.2)),
        offset: 0.018,
        gain: [0.06, -0.055],
        zero: [0.004, -0.006],
    }
}

fn camera() -> Camera {
    let world_t_camera = Isometry3::new(Vector3::new(-0.4, 0.1, 1.6), Vector3::new(3.0, -0.2, 0.1));
    Camera {
        rotation: world_t_camera.rotation.inverse(),
        centre: world_t_camera.translation.vector.into(),
        intrinsics: Intrinsics {
            fx: 600.0,
            fy: 590.0,
            cx: 250.0,
            cy: 240.0,
        },
        distortion: Distortion {
            k1: -0.1,
            k2: 0.02,
            p1: 3e-4,
            p2: -2e-4,
            k3: 0.0,
        },
    }
}

/// Where a beam meets the plane at that height.
fn at_height(beam: &Beam, z: f64) -> Point3<f64> {
    beam.origin + beam.direction.into_inner() * ((z - beam.origin.z) / beam.direction.z)
}

proptest! {
    #[test]
    fn the_beam_sent_to_a_point_meets_it(a in -5.0..5.0_f64, b in -5.0..5.0_f64, z in -0.2..0.8_f64) {
        let point = at_height(&scanner().beam([a, b]), z);
        let [x, y] = scanner().aim(&point).unwrap();
        prop_assert!((x - a).abs() < 1e-9 && (y - b).abs() < 1e-9);
    }

    #[test]
    fn a_spot_and_a_point_of_a_line_are_where_they_were(a in -3.0..3.0_f64, b in -3.0..3.0_f64, z in 0.0..0.6_f64) {
        let (beam, camera) = (scanner().beam([a, b]), camera());
        let point = at_height(&beam, z);
        if let Some(pixel) = camera.project(&point) {
            let met = on_beam(&camera, pixel, &beam).unwrap();
            prop_assert!((met.place - point).norm() < 1e-6 && met.gap < 1e-6, "{met:?}");
            let light = Plane { normal: Vector3::y_axis(), distance: point.y };
            let met = on_plane(&camera, pixel, &light);
            if let Ok(met) = met {
                prop_assert!((met.place - point).norm() < 1e-6, "{met:?}");
            }
            // A spot beside the beam is told by the gap.
            let beside = on_beam(&camera, pixel + Vector2::new(30.0, 30.0), &beam);
            prop_assert!(beside.is_err() || beside.unwrap().gap > 1e-3);
        }
    }
}

#[test]
fn a_beam_along_the_cameras_ray_is_refused() {
    let camera = camera();
    let pixel = Vector2::new(260.0, 250.0);
    let (_, sight) = ray(&camera, pixel).unwrap();
    let direction = Unit::new_normalize(sight);
    let beam = Beam {
        origin: camera.centre + Vector3::new(1e-3, 0.0, 0.0),
        direction,
    };
    assert!(matches!(
        on_beam(&camera, pixel, &beam),
        Err(NoLaser::Parallel(_))
    ));
    let along = Plane {
        normal: Unit::new_normalize(direction.cross(&Vector3::x())),
        distance: 0.0,
    };
    assert!(matches!(
        on_plane(&camera, pixel, &along),
        Err(NoLaser::Parallel(_))
    ));
}

#[test]
fn the_plane_of_light_goes_through_what_the_line_met() {
    // One mirror stands still, the other one turns: on two floors.
    let points: Vec<Point3<f64>> = (-10..=10)
        .flat_map(|k| [0.0, 0.3].map(|z| at_height(&scanner().beam([f64::from(k) * 0.4, 1.0]), z)))
        .collect();
    let FittedPlane { plane, rms_m, .. } = plane_through(&points).unwrap();
    assert!(rms_m < 1e-9, "{rms_m}");
    for point in &points {
        assert!((plane.normal.dot(&point.coords) - plane.distance).abs() < 1e-9);
    }
    // One floor alone is a line.
    let line: Vec<Point3<f64>> = points.iter().step_by(2).copied().collect();
    assert_eq!(plane_through(&line), Err(NoLaser::Undetermined));
    assert_eq!(plane_through(&line[..2]), Err(NoLaser::TooFew(2, 4)));
}

#[test]
fn a_scanner_is_calibrated_from_points_on_two_planes() {
    let truth = scanner();
    let mut met = Vec::new();
    for z in [0.0, 0.4] {
        for a in -3..=3 {
            for b in -3..=3 {
                let command = [1.5 * f64::from(a), 1.5 * f64::from(b)];
                met.push((command, at_height(&truth.beam(command), z)));
            }
        }
    }
    let start = Scanner {
        world_t_scanner: Isometry3::new(
            Vector3::new(0.32, -0.18, 1.45),
            Vector3::new(2.85, 0.32, 0.15),
        ),
        offset: 0.01,
        gain: [0.055, -0.06],
        zero: [0.0, 0.0],
    };
    let found = calibrate(&met, &start).unwrap();
    assert!(found.rms_m < 1e-6, "{found:?}");
    for command in [[0.7, -3.3], [-4.0, 2.0], [5.0, 5.0]] {
        for z in [-0.1, 0.2, 0.7] {
            let (one, other) = (found.scanner.beam(command), truth.beam(command));
            let off = at_height(&one, z) - at_height(&other, z);
            assert!(off.norm() < 1e-5, "{command:?} {z}: {off}");
        }
    }
    assert_eq!(
        calibrate(&met[..5], &start),
        Err(NoLaser::TooFew(5, FEWEST_POINTS))
    );
    // The same point again and again leaves all but two unknowns open.
    assert_eq!(calibrate(&[met[0]; 20], &start), Err(NoLaser::Undetermined));
}

/// Points with noise of 1 mm: the beams, the gains and the place are off by what is answered.
#[test]
fn a_calibrated_scanner_is_off_by_its_standard_deviations() {
    let truth = scanner();
    let (mut squares, sets) = ([0.0; UNKNOWN], 200);
    for seed in 0..sets {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = || {
            let drawn: f64 = rng.sample(StandardNormal);
            1e-3 * drawn
        };
        let mut met = Vec::new();
        for at in 0..50 {
            let command = [
                1.5 * f64::from(at % 5) - 3.0,
                1.5 * f64::from(at / 5 % 5) - 3.0,
            ];
            let point = at_height(&truth.beam(command), if at < 25 { 0.0 } else { 0.4 });
            met.push((command, point + Vector3::new(noise(), noise(), noise())));
        }
        let Fitted { scanner, sd, .. } = calibrate(&met, &truth).unwrap();
        let turn = scanner.world_t_scanner.rotation * truth.world_t_scanner.rotation.inverse();
        let turn = turn.scaled_axis();
        let shift =
            scanner.world_t_scanner.translation.vector - truth.world_t_scanner.translation.vector;
        let off = [
            turn.x,
            turn.y,
            turn.z,
            shift.x,
            shift.y,
            shift.z,
            scanner.offset - truth.offset,
            scanner.gain[0] - truth.gain[0],
            scanner.gain[1] - truth.gain[1],
            scanner.zero[0] - truth.zero[0],
        ];
        for ((square, off), sd) in squares.iter_mut().zip(off).zip(sd) {
            *square += (off / sd).powi(2) / sets as f64;
        }
    }
    for square in squares {
        assert!((0.85..1.15).contains(&square.sqrt()), "{squares:?}");
    }
}

/// Points with noise of 1 mm on an oblique plane away from the origin, as a line on two floors is met: normal and distance are off
/// by what is answered.
#[test]
fn a_plane_of_light_is_off_by_its_standard_deviations() {
    let normal = Unit::new_normalize(Vector3::new(0.5, -0.7, 0.4));
    let along = normal.cross(&Vector3::z()).normalize();
    let other = normal.cross(&along);
    let (mut squares, sets) = ([0.0; 4], 200);
    for seed in 0..sets {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = || {
            let drawn: f64 = rng.sample(StandardNormal);
            1e-3 * drawn
        };
        let points: Vec<Point3<f64>> = (0..40)
            .map(|k| {
                let (s, t) = (0.02 * f64::from(k % 20) - 0.2, f64::from(k / 20) * 0.1);
                let on = normal.into_inner() * 0.8 + along * (s + 0.3) + other * (t - 0.1);
                Point3::from(on + Vector3::new(noise(), noise(), noise()))
            })
            .collect();
        let FittedPlane { plane, sd, .. } = plane_through(&points).unwrap();
        let sign = plane.normal.dot(&normal).signum();
        let off = plane.normal.into_inner() * sign - normal.into_inner();
        let off = [off.x, off.y, off.z, plane.distance * sign - 0.8];
        for ((square, off), sd) in squares.iter_mut().zip(off).zip(sd) {
            *square += (off / sd).powi(2) / sets as f64;
        }
    }
    for square in squares {
        assert!((0.85..1.15).contains(&square.sqrt()), "{squares:?}");
    }
}

#[test]
fn points_in_millimetres_and_beams_that_no_mirror_sends_are_refused() {
    let truth = scanner();
    let mut met = Vec::new();
    for at in 0..40 {
        let command = [f64::from(at % 5) - 2.0, f64::from(at / 5) - 3.5];
        let point = at_height(&truth.beam(command), if at % 2 == 0 { 0.0 } else { 0.4 });
        met.push((command, point));
    }
    let large: Vec<_> = met.iter().map(|(c, p)| (*c, p * 1000.0)).collect();
    assert!(matches!(
        calibrate(&large, &truth),
        Err(NoLaser::TooLarge(_))
    ));
    let points: Vec<Point3<f64>> = met.iter().map(|(_, p)| p * 1000.0).collect();
    assert!(matches!(plane_through(&points), Err(NoLaser::TooLarge(_))));
    let enormous: Vec<Point3<f64>> = points.iter().map(|p| p * 1e200).collect();
    assert!(matches!(
        plane_through(&enormous),
        Err(NoLaser::TooLarge(_))
    ));
    // Points of other commands.
    let other = |k: usize| met[(17 * k + 3) % met.len()].1;
    let others = met.iter().enumerate();
    let others: Vec<_> = others
        .map(|(k, (command, _))| (*command, other(k)))
        .collect();
    assert!(matches!(
        calibrate(&others, &truth),
        Err(NoLaser::Disagree { .. } | NoLaser::Undetermined)
    ));
    let far: Vec<_> = met.iter().map(|([a, b], p)| ([*a * 1e6, *b], *p)).collect();
    assert!(matches!(calibrate(&far, &truth), Err(NoLaser::Turned(..))));
    assert!(matches!(truth.angles([1e9, 0.0]), Err(NoLaser::Turned(..))));
    // Nearly at a right angle to the axis.
    let beside = truth.world_t_scanner * Point3::new(50.0, 0.0, 1.0);
    assert_eq!(truth.aim(&beside), None);
}
