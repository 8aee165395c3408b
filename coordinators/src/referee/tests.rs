//! The verdict from known inputs.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use vss::calibrate::{LightPoint, RejectReason, RejectedPoint};

use super::*;
use crate::{
    objects::UnusedPosition,
    rig::{calibration, camera},
};

fn camera_verdict(name: &str) -> CameraVerdict {
    CameraVerdict {
        name: name.to_owned(),
        spots: 73,
        rejected: 3,
        missed: 2,
        outliers: 1,
        model: "K1K2P1P2".to_owned(),
        rms_px: 0.2042,
        rms_true_px: 0.2101,
        position_m: [-0.5213, 0.0604, 2.9108],
        true_position_m: [-0.52, 0.06, 2.91],
        focal_px: 417.93,
        true_focal_px: 417.85,
        position_error_m: 0.00156,
        position_sd_m: 0.0012,
        rotation_error_rad: 0.00061,
        rotation_sd_rad: 0.00055,
        focal_error_rel: 0.000191,
        focal_sd_rel: 0.0004,
    }
}

fn verdict() -> Verdict {
    Verdict {
        ok: true,
        positions: 76,
        positions_wanted: 77,
        rejected: 6,
        seconds: 143.27,
        moves: 76,
        max_tracking_error_rad: 0.0123,
        final_error_rad: 0.00021,
        cameras: vec![
            camera_verdict("ceiling_west"),
            camera_verdict("ceiling_east"),
        ],
    }
}

#[test]
fn the_table_reads_well() {
    let mut verdict = verdict();
    verdict.cameras.truncate(1);
    let unused = [UnusedPosition {
        line: 14,
        reason: "position 12 cannot be reached: joint 2 would have to turn to 270 degrees"
            .to_owned(),
    }];
    let text = table::text(&verdict, &unused, "written: out/ceiling_west.yaml");
    let expected = "\
Camera calibration

ceiling_west: spots used 73, missed 2, outliers 1; lens model K1K2P1P2
                        estimate       true         error           sd  error/sd
────────────────────────────────────────────────────────────────────────────────
position x, m            -0.5213    -0.5200       1.30 mm
         y, m             0.0604     0.0600       0.40 mm
         z, m             2.9108     2.9100       0.80 mm
         distance                                 1.56 mm      1.20 mm      1.30
orientation                                     0.61 mrad    0.55 mrad      1.11
focal length, px          417.93     417.85       0.019 %      0.040 %      0.48
reprojection RMS, px      0.2042     0.2101

positions reached       76 of 77
spots rejected          6
moves                   76 in 143.3 s
joint tracking error    at most 12.30 mrad
  after settling        at most 0.210 mrad

Nothing could be used of
  line 14: position 12 cannot be reached: joint 2 would have to turn to 270 deg…
written: out/ceiling_west.yaml
";
    assert_eq!(text, expected, "\n{text}");
}

#[test]
fn no_line_is_wider_than_a_terminal_and_long_lists_are_cut() {
    let unused: Vec<_> = (0..40)
        .map(|line| UnusedPosition {
            line,
            reason: "one reason\nof many words ".repeat(20),
        })
        .collect();
    let text = table::text(&verdict(), &unused, "");
    assert!(
        text.lines().all(|line| line.chars().count() <= 80),
        "{text}"
    );
    assert!(
        text.ends_with("  and 35 more lines of the positions file\n"),
        "{text}"
    );
    assert_eq!(
        text.lines()
            .filter(|line| line.starts_with("  line "))
            .count(),
        5
    );
}

#[test]
fn a_prediction_of_no_error_at_all_gives_no_ratio() {
    let mut verdict = verdict();
    verdict.cameras[0].position_sd_m = 0.0;
    let text = table::text(&verdict, &[], "");
    assert!(!text.contains("inf") && !text.contains("NaN"), "{text}");
}

#[test]
fn the_json_has_the_fields_that_programs_read() {
    let json: serde_json::Value =
        serde_json::from_str(&serde_json::to_string(&verdict()).unwrap()).unwrap();
    for field in [
        "positions",
        "rejected",
        "seconds",
        "max_tracking_error_rad",
        "cameras",
    ] {
        assert!(!json[field].is_null(), "{field}");
    }
    for field in [
        "name",
        "rms_px",
        "rms_true_px",
        "position_error_m",
        "rotation_error_rad",
        "focal_error_rel",
        "position_sd_m",
        "rotation_sd_rad",
        "focal_sd_rel",
    ] {
        assert!(!json["cameras"][1][field].is_null(), "{field}");
    }
}

#[test]
fn errors_are_the_distance_the_angle_and_the_relative_focal_length_to_the_truth() {
    let truth = camera(Point3::new(0.5, -0.1, 2.9));
    let mut estimate = truth;
    estimate.centre += Vector3::new(0.003, 0.0, -0.004);
    estimate.rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.002) * truth.rotation;
    estimate.intrinsics.fx *= 1.01;
    estimate.intrinsics.fy *= 1.01;
    let seen = |x: f64, du: f64| {
        let pixel = truth.project(&Point3::new(x, 0.2, 0.8)).unwrap();
        LightPoint {
            x,
            y: 0.2,
            z: 0.8,
            u: pixel.x + du,
            v: pixel.y,
        }
    };
    let table = CameraTable {
        camera: "west".to_owned(),
        width: 500,
        height: 500,
        // The third one is an outlier and counts for nothing but the number of rejected spots.
        points: vec![seen(0.0, 0.3), seen(0.1, -0.3), seen(0.2, 50.0)],
        missed: 4,
        last_miss: String::new(),
    };
    let mut calibration = calibration(estimate, 2);
    calibration.rejected = vec![RejectedPoint {
        row: 2,
        du: 50.0,
        dv: 0.0,
        reason: RejectReason::Outlier { limit_px: 1.0 },
    }];
    let verdict = verdict_of("west", &calibration, &truth, &table).unwrap();
    assert!((verdict.position_error_m - 0.005).abs() < 1e-12);
    assert!((verdict.rotation_error_rad - 0.002).abs() < 1e-9);
    assert!((verdict.focal_error_rel - 0.01).abs() < 1e-12);
    assert!((verdict.rms_true_px - 0.3).abs() < 1e-9);
    assert_eq!((verdict.spots, verdict.missed, verdict.outliers), (2, 4, 1));
    assert_eq!(verdict.rejected, 5);
}

#[test]
fn a_camera_that_the_world_does_not_know_is_named() {
    let error = named(&[], "west").unwrap_err().to_string();
    assert_eq!(error, "the world has no camera `west`");
}
