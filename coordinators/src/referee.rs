//! The referee: holds the result of a calibration against the truth, which only a stand-in for the
//! world can know. It runs when everything is done; nothing that estimates may ask it.

use std::fmt::Write;

use ctos::{
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError},
};
use serde::{Deserialize, Serialize};
use vss::{
    calibrate::Calibration,
    camera::Camera,
    command::{NamedCamera, TrueCameras},
};

use crate::{
    dom::DomStore,
    objects::{
        CALIBRATIONS, Calibrations, CameraTable, MOTIONS, MotionLog, OBSERVATIONS, Observations,
    },
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.referee";

ctos::command! {
    /// Judges the calibration in the DOM.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Judge {
        /// How long the command took, s of the app's time.
        pub seconds: f64,
        /// What the Dispatcher noted, line by line.
        pub notes: String,
    } => AppResult, 0x0610, "judge"
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RefereeArgs {
    /// The task that knows the true cameras.
    #[serde(default = "world_task")]
    world: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
}

fn world_task() -> String {
    "world".to_owned()
}

/// One camera's verdict, as it stands in the JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct CameraVerdict {
    name: String,
    spots: usize,
    rejected: usize,
    model: String,
    rms_px: f64,
    rms_true_px: f64,
    position_m: [f64; 3],
    true_position_m: [f64; 3],
    focal_px: f64,
    true_focal_px: f64,
    position_error_m: f64,
    position_sd_m: f64,
    rotation_error_rad: f64,
    rotation_sd_rad: f64,
    focal_error_rel: f64,
    focal_sd_rel: f64,
}

/// The whole verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Verdict {
    ok: bool,
    positions: u32,
    rejected: usize,
    seconds: f64,
    moves: u32,
    max_tracking_error_rad: f64,
    final_error_rad: f64,
    cameras: Vec<CameraVerdict>,
}

struct Referee {
    args: RefereeArgs,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[Judge::INFO], |cx| {
            Ok(Referee { args: cx.args()? })
        })
        .check_in_app(|task, app, findings| {
            if let Some(args) = findings.keep(task.args.parse::<RefereeArgs>()) {
                crate::need_task(task, app, "world", &args.world, findings);
                crate::need_task(task, app, "dom", &args.dom, findings);
            }
        });
}

impl EventHandler for Referee {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Judge::CODE => {
                let (request, reply) = message.open::<Judge>()?;
                reply.ok(self.judge(cx, &request).await?)
            }
            _ => cx.default_processing(message),
        }
    }
}

impl Referee {
    async fn judge(&self, cx: &Context, request: &Judge) -> Result<AppResult, HandlerError> {
        let store = DomStore::new(&self.args.dom);
        let calibrations: Calibrations = store.fetch(cx, CALIBRATIONS).await?;
        let observations: Observations = store.fetch(cx, OBSERVATIONS).await?;
        let motions: MotionLog = store.fetch(cx, MOTIONS).await?;
        let world = cx.task(&self.args.world).await?;
        let truths = cx.call(&world, TrueCameras {}).await?;
        let mut cameras = Vec::new();
        for (name, calibration) in &calibrations.cameras {
            let truth = named(&truths, name)?;
            let mut tables = observations.cameras.iter();
            let table = tables
                .find(|table| table.camera == *name)
                .ok_or_else(|| HandlerError::new(format!("camera `{name}` has no table")))?;
            cameras.push(verdict(name, calibration, truth, table)?);
        }
        let verdict = Verdict {
            ok: true,
            positions: observations.reached,
            rejected: cameras.iter().map(|camera| camera.rejected).sum(),
            seconds: request.seconds,
            moves: motions.moves,
            max_tracking_error_rad: motions.max_tracking_error_rad,
            final_error_rad: motions.max_final_error_rad,
            cameras,
        };
        Ok(AppResult {
            ok: true,
            text: table(&verdict, &request.notes),
            json: serde_json::to_string(&verdict)?,
        })
    }
}

fn named<'a>(truths: &'a [NamedCamera], name: &str) -> Result<&'a Camera, HandlerError> {
    let mut truths = truths.iter();
    truths
        .find(|truth| truth.name == name)
        .map(|truth| &truth.camera)
        .ok_or_else(|| HandlerError::new(format!("the world has no camera `{name}`")))
}

fn verdict(
    name: &str,
    calibration: &Calibration,
    truth: &Camera,
    table: &CameraTable,
) -> Result<CameraVerdict, HandlerError> {
    let estimate = &calibration.camera;
    let error = estimate.error_against(truth);
    let rms_true_px = calibration
        .rms_against(truth, &table.points)
        .ok_or("a spot cannot have been seen by the true camera")?;
    Ok(CameraVerdict {
        name: name.to_owned(),
        spots: calibration.used,
        rejected: table.missed as usize + calibration.rejected.len(),
        model: format!("{:?}", calibration.model),
        rms_px: calibration.rms_px,
        rms_true_px,
        position_m: estimate.centre.coords.into(),
        true_position_m: truth.centre.coords.into(),
        focal_px: estimate.focal(),
        true_focal_px: truth.focal(),
        position_error_m: error.position_m,
        position_sd_m: calibration.position_sd_m(),
        rotation_error_rad: error.rotation_rad,
        rotation_sd_rad: calibration.rotation_sd_rad(),
        focal_error_rel: error.focal_rel,
        focal_sd_rel: calibration.focal_sd_rel(),
    })
}

/// The table that a person reads at the end.
fn table(verdict: &Verdict, notes: &str) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_table(&mut text, verdict, notes);
    text
}

fn write_table(text: &mut String, verdict: &Verdict, notes: &str) -> std::fmt::Result {
    let width = 18;
    write!(text, "{:<34}", "Camera calibration")?;
    for camera in &verdict.cameras {
        write!(text, "{:>width$}", camera.name)?;
    }
    writeln!(text)?;
    writeln!(text, "{}", "─".repeat(34 + width * verdict.cameras.len()))?;
    let mut row = |label: &str, value: &dyn Fn(&CameraVerdict) -> String| {
        write!(text, "{label:<34}")?;
        for camera in &verdict.cameras {
            write!(text, "{:>width$}", value(camera))?;
        }
        writeln!(text)
    };
    row("spots used / rejected", &|c| {
        format!("{} / {}", c.spots, c.rejected)
    })?;
    row("lens model", &|c| c.model.clone())?;
    row("reprojection RMS, px", &|c| format!("{:.4}", c.rms_px))?;
    row("  same spots, true camera", &|c| {
        format!("{:.4}", c.rms_true_px)
    })?;
    for (index, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let part = |values: &[f64; 3]| values.get(index).copied().unwrap_or(f64::NAN);
        row(&format!("position {axis}, m: estimate"), &|c| {
            format!("{:.4}", part(&c.position_m))
        })?;
        row("               truth", &|c| {
            format!("{:.4}", part(&c.true_position_m))
        })?;
    }
    row("position error ± sd, mm", &|c| {
        format!(
            "{:.2} ± {:.2}",
            c.position_error_m * 1e3,
            c.position_sd_m * 1e3
        )
    })?;
    row("rotation error ± sd, mrad", &|c| {
        format!(
            "{:.2} ± {:.2}",
            c.rotation_error_rad * 1e3,
            c.rotation_sd_rad * 1e3
        )
    })?;
    row("focal length, px: estimate", &|c| {
        format!("{:.2}", c.focal_px)
    })?;
    row("                  truth", &|c| {
        format!("{:.2}", c.true_focal_px)
    })?;
    row("focal length error ± sd, %", &|c| {
        format!(
            "{:.3} ± {:.3}",
            c.focal_error_rel * 1e2,
            c.focal_sd_rel * 1e2
        )
    })?;
    writeln!(text)?;
    writeln!(
        text,
        "{} positions, {} rejected spots, {} moves in {:.1} s; joint tracking error at most {:.2} mrad, {:.3} mrad after settling",
        verdict.positions,
        verdict.rejected,
        verdict.moves,
        verdict.seconds,
        verdict.max_tracking_error_rad * 1e3,
        verdict.final_error_rad * 1e3,
    )?;
    for note in notes.lines() {
        writeln!(text, "{note}")?;
    }
    Ok(())
}
