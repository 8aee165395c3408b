//! Hand-eye calibration: moves an arm that carries a camera to poses, looks from each for a target that stands still, and
//! computes where the camera sits on the link that carries it. Ends the app with the answer.
//!
//! The frames carry the pose of the link at their stamps, so nothing here knows the arm's model.

use std::{fmt::Write as _, time::Duration};

use ctos::{
    diagnostic::Finding,
    message::Message,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Phase},
};
use mcs::{
    Joints,
    client::{Manipulator, Move, PathKind, Target},
};
use nalgebra::Isometry3;
use serde::Deserialize;
use vss::{
    command::{FindTarget, Outcome, TargetReport, TrueCameras, VisionError},
    handeye::{HandEye, Sample, hand_eye},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.hand_eye";

/// No motion takes longer.
const LONGEST_MOVE: Duration = Duration::from_secs(120);

/// No look takes longer.
const LONGEST_LOOK: Duration = Duration::from_secs(60);

/// Fewest poses that may be asked for.
const FEWEST: usize = 3;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct HandEyeArgs {
    /// The client interface of the arm.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The Services Manager of the camera.
    #[serde(default = "vsm_task")]
    vsm: String,
    /// The camera.
    camera: String,
    /// Joint positions to look from, degrees, or m of a joint that slides.
    poses: Vec<Vec<f64>>,
    /// Joints of those that slide, by index from 0.
    #[serde(default)]
    sliding: Vec<usize>,
    /// Fraction of full speed.
    #[serde(default = "half")]
    speed: f64,
    /// The task of a simulated world, which tells how far the answer is off.
    world: Option<String>,
}

fn mcs_task() -> String {
    "mcs".to_owned()
}

fn vsm_task() -> String {
    "vsm".to_owned()
}

const fn half() -> f64 {
    0.5
}

/// The event handler.
struct HandEyeTask {
    args: HandEyeArgs,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[], |cx| Ok(HandEyeTask { args: cx.args()? }))
        .checked_args::<HandEyeArgs>(|args, task, app, findings| {
            crate::need_task(task, app, "mcs", &args.mcs, findings);
            crate::need_task(task, app, "vsm", &args.vsm, findings);
            if let Some(world) = &args.world {
                crate::need_task(task, app, "world", world, findings);
            }
            let mut refuse = |key: &str, text: String, help: &str| {
                let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
                let finding = Finding::error("coordinators::hand_eye::args", text);
                findings.push(finding.at(place).help(help));
            };
            if args.poses.len() < FEWEST {
                let text = format!("there are {} poses to look from", args.poses.len());
                let help = format!("name {FEWEST} or more, 10 to be good, turned about two axes");
                refuse("poses", text, &help);
            }
            if !(args.speed > 0.0 && args.speed <= 1.0) {
                let text = format!("`speed` is {}", args.speed);
                refuse("speed", text, "give a number above 0, up to 1");
            }
        });
}

impl EventHandler for HandEyeTask {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (child, args) = (cx.clone(), self.args.clone());
            cx.spawn(async move {
                let result = calibrate(&child, &args).await;
                child.finish(result.unwrap_or_else(|error| failure(&error)));
            });
        }
        Ok(())
    }
}

fn failure(error: &HandlerError) -> AppResult {
    let reason = error.to_string();
    AppResult {
        ok: false,
        json: serde_json::json!({ "ok": false, "reason": reason }).to_string(),
        text: reason,
    }
}

async fn calibrate(cx: &Context, args: &HandEyeArgs) -> Result<AppResult, HandlerError> {
    let arm = Manipulator::find(cx, &args.mcs).await?;
    arm.acquire().await?;
    let looked = look_from_all(cx, args, &arm).await;
    // Whatever was seen, the arm is given back.
    arm.release().await?;
    let looks = looked?;
    let found = hand_eye(&looks.samples).map_err(|why| HandlerError::new(why.to_string()))?;
    Ok(told(&args.camera, &looks, &found))
}

/// What was seen.
#[derive(Default)]
struct Looks {
    /// The link that carries the camera.
    link: String,
    samples: Vec<Sample>,
    /// From which poses nothing was seen, with the reasons.
    missed: Vec<String>,
    /// Where the camera truly is on the link, if a simulated world tells.
    truth: Option<Isometry3<f64>>,
}

async fn look_from_all(
    cx: &Context,
    args: &HandEyeArgs,
    arm: &Manipulator,
) -> Result<Looks, HandlerError> {
    let mut looks = Looks::default();
    for (number, pose) in (1..).zip(&args.poses) {
        let joints = pose.iter().enumerate().map(|(joint, position)| {
            if args.sliding.contains(&joint) {
                *position
            } else {
                position.to_radians()
            }
        });
        let joints: Vec<f64> = joints.collect();
        let joints = Joints::try_from(&joints[..])
            .map_err(|error| HandlerError::new(format!("pose {number}: {error}")))?;
        let request = Move {
            target: Target::Joints(joints),
            path: PathKind::Joint,
            speed: args.speed,
            acceleration: None,
            elbow: None,
            guards: Vec::new(),
            blend: 0.0.into(),
        };
        arm.go(request, LONGEST_MOVE)
            .await
            .map_err(|error| HandlerError::new(format!("pose {number}: {error}")))?;
        match look(cx, args).await {
            Ok(report) => {
                let Some(carrier) = report.carrier else {
                    let camera = &args.camera;
                    let text = format!(
                        "camera `{camera}` does not say what carries it: no link does, or its pose is not known"
                    );
                    return Err(HandlerError::new(text));
                };
                looks.samples.push(Sample {
                    base_t_tool: carrier.world_t_link,
                    camera_t_target: report.pose.camera_t_target,
                });
                looks.truth = truth(cx, args, &carrier.world_t_link).await?;
                looks.link = carrier.link;
            }
            Err(error) if error.outcome == Outcome::Unseen => {
                looks.missed.push(format!("pose {number}: {error}"));
            }
            Err(error) => return Err(HandlerError::new(format!("pose {number}: {error}"))),
        }
    }
    Ok(looks)
}

/// Where the camera truly is on its link, which stands still at `world_t_link`.
async fn truth(
    cx: &Context,
    args: &HandEyeArgs,
    world_t_link: &Isometry3<f64>,
) -> Result<Option<Isometry3<f64>>, HandlerError> {
    let Some(world) = &args.world else {
        return Ok(None);
    };
    let world = cx.task(world).await?;
    let truths = cx.call(&world, TrueCameras {}).await?;
    let truth = truths.iter().find(|truth| truth.name == args.camera);
    let camera_t_world = truth.map(|truth| truth.camera.camera_from_world());
    Ok(camera_t_world.map(|pose| world_t_link.inverse() * pose.inverse()))
}

async fn look(cx: &Context, args: &HandEyeArgs) -> Result<TargetReport, VisionError> {
    let vsm = cx.task(&args.vsm).await?;
    let camera = args.camera.clone();
    cx.call(&vsm, FindTarget { camera })
        .deadline(LONGEST_LOOK)
        .await?
}

fn told(camera: &str, looks: &Looks, found: &HandEye) -> AppResult {
    let turn = found.tool_t_camera.rotation.scaled_axis();
    let place = found.tool_t_camera.translation.vector;
    let numbers: Vec<f64> = turn.iter().chain(place.iter()).copied().collect();
    let error = looks.truth.map(|truth| {
        let turn = turn - truth.rotation.scaled_axis();
        let place = place - truth.translation.vector;
        turn.iter()
            .chain(place.iter())
            .copied()
            .collect::<Vec<f64>>()
    });
    let (link, samples) = (&looks.link, looks.samples.len());
    let mut text = format!("{camera} on {link}, from {samples} poses:\n");
    let names = ["rx", "ry", "rz", "x", "y", "z"];
    for (k, (name, (number, sd))) in names.iter().zip(numbers.iter().zip(found.sd)).enumerate() {
        let unit = if name.starts_with('r') { "rad" } else { "m" };
        let _ = write!(text, "  {name:>2} {number:9.5} {unit:<3}  sd {sd:.1e}");
        if let Some(off) = error.as_ref().and_then(|error| error.get(k)) {
            let _ = write!(text, "  off by {off:9.1e}");
        }
        text.push('\n');
    }
    let (rad, m) = (found.rms_rad, found.rms_m);
    let _ = writeln!(text, "  target off by {rad:.1e} rad and {m:.1e} m (rms)");
    for one in &found.rejected {
        let (number, rad, m) = (one.row + 1, one.off_rad, one.off_m);
        let _ = writeln!(
            text,
            "  sample {number} is left out: off by {rad:.1e} rad and {m:.1e} m"
        );
    }
    for miss in &looks.missed {
        let _ = writeln!(text, "  not seen from {miss}");
    }
    let json = serde_json::json!({
        "ok": true,
        "camera": camera,
        "link": link,
        "tool_t_camera": numbers,
        "sd": found.sd,
        "error": error,
        "rms_rad": rad,
        "rms_m": m,
        "samples": samples,
        "missed": looks.missed,
    });
    AppResult {
        ok: true,
        text,
        json: json.to_string(),
    }
}
