//! The calibration of `configs/` with many seeds and cameras, in virtual time: whether its errors are as large as it predicts.
//!
//! `CTOS_RUNS=200` makes so many runs; without it there are few.

use std::{
    fmt::Write as _,
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde_json::Value;

use crate::harness::{Scratch, VIRTUAL};

/// Runs that show a gross mistake only.
const FEW: u64 = 3;

/// What is compared: the error of the result and the standard deviation that it names.
const QUANTITIES: [(&str, &str); 3] = [
    ("position_error_m", "position_sd_m"),
    ("rotation_error_rad", "rotation_sd_rad"),
    ("focal_error_rel", "focal_sd_rel"),
];

/// The cell with other cameras: each number of a camera's place and lens changed at random, as far as such cameras differ.
fn other_cameras(cell: &str, rng: &mut ChaCha8Rng) -> String {
    let (mut text, mut in_camera) = (String::new(), false);
    for line in cell.lines() {
        if line.starts_with("[[") {
            in_camera = line == "[[camera]]";
        }
        let (key, value) = line.split_once(" = ").unwrap_or((line, ""));
        let spread = match key {
            "fx" | "fy" => 15.0,
            "cx" | "cy" => 6.0,
            "k1" => 0.03,
            "k2" => 0.01,
            "p1" | "p2" => 5e-4,
            "position" => 0.08,
            "look_at" => 0.03,
            _ => 0.0,
        };
        if !in_camera || spread == 0.0 {
            writeln!(text, "{line}").unwrap();
            continue;
        }
        let numbers = value.trim_matches(['[', ']']).split(',').map(|number| {
            let number: f64 = number.trim().parse().unwrap();
            format!("{:.6}", number + rng.random_range(-spread..spread))
        });
        let numbers = numbers.collect::<Vec<_>>().join(", ");
        if value.starts_with('[') {
            writeln!(text, "{key} = [{numbers}]").unwrap();
        } else {
            writeln!(text, "{key} = {numbers}").unwrap();
        }
    }
    text
}

/// Error over standard deviation of each quantity, for each camera of a run.
fn run(seed: u64) -> Vec<[f64; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let scratch = Scratch::new();
    let cell = other_cameras(&scratch.read("configs/cell.toml"), &mut rng);
    scratch.write("configs/cell.toml", cell);
    let seed = format!("seed={seed}");
    let ended = scratch.boot(&[&VIRTUAL[..], &["--set", &seed, "--json"]].concat());
    let result = ended.must_exit(0).json();
    let cameras = result["cameras"].as_array().unwrap();
    let number = |camera: &Value, key: &str| camera[key].as_f64().unwrap();
    cameras
        .iter()
        .map(|camera| QUANTITIES.map(|(error, sd)| number(camera, error) / number(camera, sd)))
        .collect()
}

#[test]
#[allow(clippy::print_stdout, reason = "what was measured is told, too")]
fn errors_of_calibrated_cameras_have_the_size_that_is_predicted() {
    let asked = std::env::var("CTOS_RUNS").ok();
    let runs = asked.map_or(FEW, |runs| runs.parse().unwrap());
    let (next, found) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= runs {
                        break;
                    }
                    found.lock().unwrap().extend(run(1000 + seed));
                }
            });
        }
    });
    let found = found.into_inner().unwrap();
    assert_eq!(found.len() as u64, 2 * runs);
    let count = found.len() as f64;
    let rms: Vec<f64> = (0..QUANTITIES.len())
        .map(|k| (found.iter().map(|one| one[k] * one[k]).sum::<f64>() / count).sqrt())
        .collect();
    println!("errors over standard deviations, rms over {count} cameras: {QUANTITIES:?} {rms:.3?}");
    // The root mean square of so many normal deviates scatters by 1/sqrt(2 n).
    let allowed = (3.5 / (2.0 * count).sqrt()).max(0.1);
    for ((error, _), rms) in QUANTITIES.iter().zip(&rms) {
        assert!(
            (rms - 1.0).abs() <= allowed,
            "{error} over its standard deviation has rms {rms:.3} over {count} cameras: {rms:.3?}"
        );
    }
}
