//! Calibrating a camera from a moving light.

use divan::{Bencher, black_box};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use vss::{
    calibrate::{LightPoint, calibrate},
    camera::{Camera, Distortion, Intrinsics},
};

fn main() {
    divan::main();
}

/// `n` lights in 1.0 x 0.8 x 0.6 m seen from 2.2 m with 0.5 px of noise; every `wrong`th is somewhere else.
fn table(n: usize, wrong: usize) -> Vec<LightPoint> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let camera = Camera {
        rotation: UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        centre: Point3::new(0.0, 0.0, 2.2),
        intrinsics: Intrinsics {
            fx: 800.0,
            fy: 805.0,
            cx: 322.0,
            cy: 238.0,
        },
        distortion: Distortion {
            k1: -0.25,
            k2: 0.12,
            p1: 1e-3,
            p2: -5e-4,
            k3: -0.02,
        },
    };
    (0..n)
        .filter_map(|k| {
            let mut within = |half: f64| rng.random_range(-half..half);
            let p = Point3::new(within(0.5), within(0.4), within(0.3));
            let pixel = camera.project(&p)?;
            let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
            let (u, v) = (pixel.x + 0.5 * noise(), pixel.y + 0.5 * noise());
            let (u, v) = if wrong > 0 && k % wrong == 0 {
                (v, 0.7 * u)
            } else {
                (u, v)
            };
            Some(LightPoint {
                x: p.x,
                y: p.y,
                z: p.z,
                u,
                v,
            })
        })
        .collect()
}

#[divan::bench(args = [60, 400])]
fn clean(bencher: Bencher, lights: usize) {
    let table = table(lights, 0);
    bencher.bench_local(|| {
        calibrate(
            black_box(&table),
            640,
            480,
            &mut ChaCha8Rng::seed_from_u64(2),
        )
    });
}

#[divan::bench(args = [60, 400])]
fn with_a_quarter_wrong(bencher: Bencher, lights: usize) {
    let table = table(lights, 4);
    bencher.bench_local(|| {
        calibrate(
            black_box(&table),
            640,
            480,
            &mut ChaCha8Rng::seed_from_u64(2),
        )
    });
}
