//! The table that a person reads at the end of a calibration, at most 80 columns wide whatever the
//! number of cameras.

use std::fmt::{self, Write};

use super::{CameraVerdict, Verdict};
use crate::objects::UnusedPosition;

const WIDTH: usize = 80;

/// Unused positions that are listed one by one.
const LISTED: usize = 5;

/// The table, what was not used, and the notes.
pub(super) fn text(verdict: &Verdict, unused: &[UnusedPosition], notes: &str) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut text, verdict, unused, notes);
    text
}

fn write_all(
    text: &mut String,
    verdict: &Verdict,
    unused: &[UnusedPosition],
    notes: &str,
) -> fmt::Result {
    writeln!(text, "Camera calibration")?;
    for camera in &verdict.cameras {
        writeln!(text)?;
        write_camera(text, camera)?;
    }
    writeln!(text)?;
    write_run(text, verdict)?;
    write_unused(text, unused)?;
    for note in notes.lines() {
        writeln!(text, "{note}")?;
    }
    Ok(())
}

fn write_camera(text: &mut String, camera: &CameraVerdict) -> fmt::Result {
    writeln!(
        text,
        "{}: spots used {}, missed {}, outliers {}; lens model {}",
        camera.name, camera.spots, camera.missed, camera.outliers, camera.model
    )?;
    let head = ["", "estimate", "true", "error", "sd", "error/sd"];
    writeln!(text, "{}", line(head))?;
    writeln!(text, "{}", "─".repeat(WIDTH))?;
    let axes = ["position x, m", "         y, m", "         z, m"];
    for ((name, estimate), truth) in axes
        .into_iter()
        .zip(camera.position_m)
        .zip(camera.true_position_m)
    {
        let error = format!("{:.2} mm", (estimate - truth).abs() * 1e3);
        let cells = [name, &metres(estimate), &metres(truth), &error, "", ""];
        writeln!(text, "{}", line(cells))?;
    }
    let errors = [
        (
            "         distance",
            camera.position_error_m * 1e3,
            camera.position_sd_m * 1e3,
            "mm",
        ),
        (
            "orientation",
            camera.rotation_error_rad * 1e3,
            camera.rotation_sd_rad * 1e3,
            "mrad",
        ),
    ];
    for (name, error, sd, unit) in errors {
        let (error_text, sd_text) = (format!("{error:.2} {unit}"), format!("{sd:.2} {unit}"));
        let ratio = ratio(error, sd);
        writeln!(
            text,
            "{}",
            line([name, "", "", &error_text, &sd_text, &ratio])
        )?;
    }
    let cells = [
        "focal length, px",
        &format!("{:.2}", camera.focal_px),
        &format!("{:.2}", camera.true_focal_px),
        &format!("{:.3} %", camera.focal_error_rel * 1e2),
        &format!("{:.3} %", camera.focal_sd_rel * 1e2),
        &ratio(camera.focal_error_rel, camera.focal_sd_rel),
    ];
    writeln!(text, "{}", line(cells))?;
    let (rms, rms_true) = (
        format!("{:.4}", camera.rms_px),
        format!("{:.4}", camera.rms_true_px),
    );
    let cells = ["reprojection RMS, px", &rms, &rms_true, "", "", ""];
    writeln!(text, "{}", line(cells))
}

fn line([name, estimate, truth, error, sd, ratio]: [&str; 6]) -> String {
    let line = format!("{name:<21}{estimate:>11}{truth:>11}{error:>14}{sd:>13}{ratio:>10}");
    line.trim_end().to_owned()
}

fn metres(value: f64) -> String {
    format!("{value:.4}")
}

/// An error in terms of its predicted standard deviation.
fn ratio(error: f64, sd: f64) -> String {
    if sd > 0.0 {
        format!("{:.2}", error / sd)
    } else {
        "-".to_owned()
    }
}

fn write_run(text: &mut String, verdict: &Verdict) -> fmt::Result {
    let rows = [
        (
            "positions used",
            format!("{} of {}", verdict.positions, verdict.positions_wanted),
        ),
        ("spots rejected", verdict.rejected.to_string()),
        (
            "moves",
            format!("{} in {:.1} s", verdict.moves, verdict.seconds),
        ),
        (
            "joint tracking error",
            format!("at most {:.2} mrad", verdict.max_tracking_error_rad * 1e3),
        ),
        (
            "  after settling",
            format!("at most {:.3} mrad", verdict.final_error_rad * 1e3),
        ),
    ];
    for (name, value) in rows {
        writeln!(text, "{name:<24}{value}")?;
    }
    Ok(())
}

/// Which positions gave nothing and why, the first few of them.
fn write_unused(text: &mut String, unused: &[UnusedPosition]) -> fmt::Result {
    if unused.is_empty() {
        return Ok(());
    }
    writeln!(text, "\nNothing could be used of")?;
    for one in unused.iter().take(LISTED) {
        writeln!(
            text,
            "{}",
            shortened(&format!("  line {}: {}", one.line, one.reason))
        )?;
    }
    match unused.len().saturating_sub(LISTED) {
        0 => Ok(()),
        more => writeln!(text, "  and {more} more lines of the positions file"),
    }
}

/// A text in one line of the terminal.
fn shortened(text: &str) -> String {
    let text = text.replace(['\n', '\r'], " ");
    if text.chars().count() <= WIDTH {
        return text;
    }
    text.chars().take(WIDTH - 1).chain(['…']).collect()
}
