//! The referee: holds the result of a calibration against the truth, which only a stand-in for the
//! world can know. It runs when everything is done; nothing that estimates may ask it.
//!
//! A spot counts as rejected when a camera missed it at a position that the arm reached (after all
//! retries), or when it was seen and is an outlier of the fit. For each camera used and rejected spots
//! together are the reached positions; `rejected` of the whole verdict is the sum over cameras.

pub(crate) mod bodies;
mod table;

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

/// One camera's verdict, as it stands in the JSON. Spots used and rejected together are the
/// positions that were reached.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct CameraVerdict {
    name: String,
    /// Spots that the estimate stands on.
    spots: usize,
    /// Missed spots and outliers together.
    rejected: usize,
    /// Reached positions at which no spot was seen.
    missed: usize,
    /// Spots that do not fit the estimate.
    outliers: usize,
    model: String,
    /// Root of the mean over the used spots of du2 + dv2 against the estimate.
    rms_px: f64,
    /// The same spots against the true camera.
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
    /// Positions that the arm reached.
    positions: u32,
    /// Positions in the file.
    positions_wanted: u32,
    /// Rejected spots of all cameras: missed ones and outliers.
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
        .checked_args::<RefereeArgs>(|args, task, app, findings| {
            crate::need_task(task, app, "world", &args.world, findings);
            crate::need_task(task, app, "dom", &args.dom, findings);
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
            cameras.push(verdict_of(name, calibration, truth, table)?);
        }
        let verdict = Verdict {
            ok: true,
            positions: observations.reached,
            positions_wanted: observations.wanted,
            rejected: cameras.iter().map(|camera| camera.rejected).sum(),
            seconds: request.seconds,
            moves: motions.moves,
            max_tracking_error_rad: motions.max_tracking_error_rad,
            final_error_rad: motions.max_final_error_rad,
            cameras,
        };
        Ok(AppResult {
            ok: true,
            text: table::text(&verdict, &observations.unused, &request.notes),
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

fn verdict_of(
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
    let (missed, outliers) = (table.missed as usize, calibration.rejected.len());
    Ok(CameraVerdict {
        name: name.to_owned(),
        spots: calibration.used,
        rejected: missed + outliers,
        missed,
        outliers,
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

#[cfg(test)]
mod tests;
