//! The Motion Coordinator: the functions of `motion.net` (CIRSSE report 108, section 7, figure 12).
//!
//! It knows more than one way to take a pose: the elbow posture nearest to the present joints first,
//! the others when that one is refused. Only what none of them solves is passed up.

use std::rc::Rc;

use ctos::{
    diagnostic::Finding,
    registry::Registry,
    task::{Context, HandlerError},
};
use mcs::{
    arm::Elbow,
    client::{Acquire, Move, PathKind, Plan, PlanReport, ReadPosition, Release, Target},
};
use pnt::{
    library::{Acted, Action, Library},
    task::{COMMANDS, NetTask, check_args},
};
use serde::Deserialize;

use crate::{
    dom::DomStore,
    objects::{
        DESTINATION, Destination, MOTIONS, MotionLog, PATH, POSITION, PathSpec, ReachedPosition,
    },
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.motion";

/// How much longer than planned a motion may take, to settle and to be waited for.
const MOVE_MARGIN_S: f64 = 10.0;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MotionArgs {
    /// The net; read by [`pnt::task::settings`].
    #[serde(rename = "net")]
    _net: String,
    /// The client interface of MCS.
    #[serde(default = "mcs_task")]
    mcs: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// Fraction of full joint speed.
    #[serde(default = "speed")]
    speed: f64,
}

fn mcs_task() -> String {
    "mcs".to_owned()
}

fn speed() -> f64 {
    0.8
}

/// What the functions share.
struct Motion {
    args: Rc<MotionArgs>,
    store: DomStore,
    acquired: bool,
    /// Whether a path was given with the request instead of being planned here.
    path_given: bool,
    log: MotionLog,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &COMMANDS, |cx| {
            let args: MotionArgs = cx.args()?;
            let store = DomStore::new(&args.dom);
            NetTask::from_args(cx, library(args, store.clone()), Some(Rc::new(store)))
        })
        .check_in_app(|task, app, findings| {
            if let Some(args) = findings.keep(task.args.parse::<MotionArgs>()) {
                let names = library(args.clone(), DomStore::new(&args.dom)).names();
                check_args(task, app, &names, findings);
                crate::need_task(task, app, "mcs", &args.mcs, findings);
                crate::need_task(task, app, "dom", &args.dom, findings);
                if !(args.speed > 0.0 && args.speed <= 1.0) {
                    let place = task.args.locate("speed");
                    findings.push(
                        Finding::error(
                            "coordinators::motion::speed",
                            format!("`speed` is {}", args.speed),
                        )
                        .at(place.unwrap_or_else(|| task.place.clone()))
                        .help("give a fraction of full speed, above 0 and up to 1"),
                    );
                }
            }
        });
}

fn library(args: MotionArgs, store: DomStore) -> Library<Motion> {
    let state = Motion {
        args: Rc::new(args),
        store,
        acquired: false,
        path_given: false,
        log: MotionLog::default(),
    };
    Library::new(state)
        .enabling("path_given", |motion: &Motion| motion.path_given)
        .action("validate_path", validate_path)
        .action("plan_path", plan_path)
        .action("move_manip", move_manip)
        .action("find_pos", find_pos)
        .action("release_robot", release_robot)
}

type Act = Action<Motion>;

fn parts(action: &Act) -> (Context, Rc<MotionArgs>, DomStore) {
    let (args, store) = action.with_state(|motion| (motion.args.clone(), motion.store.clone()));
    (action.cx().clone(), args, store)
}

/// Checks that a path given beforehand can still be driven from where the arm is.
async fn validate_path(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let path: PathSpec = store.fetch(&cx, PATH).await?;
    plan(&cx, &args, path.target, path.kind, None).await?;
    Ok(())
}

/// Plans from the manipulator's present position to the destination, and stores the path.
async fn plan_path(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let destination: Destination = store.fetch(&cx, DESTINATION).await?;
    acquire(&action, &cx, &args).await?;
    let pose = Target::Pose(destination.base_t_tool);
    let mut first_refusal = None;
    for elbow in [None, Some(Elbow::Above), Some(Elbow::Below)] {
        match plan(&cx, &args, pose, PathKind::Joint, elbow).await {
            Ok(planned) => {
                let path = PathSpec {
                    target: Target::Joints(planned.joints),
                    kind: PathKind::Joint,
                    speed: args.speed,
                    duration_s: planned.duration_s,
                };
                return store.store(&cx, PATH, &path).await;
            }
            Err(refusal) => {
                first_refusal.get_or_insert(refusal);
            }
        }
    }
    let reason = first_refusal.map_or_else(String::new, |refusal| refusal.to_string());
    Err(HandlerError::new(format!(
        "position {} cannot be reached: {reason}",
        destination.index + 1
    )))
}

async fn plan(
    cx: &Context,
    args: &MotionArgs,
    target: Target,
    path: PathKind,
    elbow: Option<Elbow>,
) -> Result<PlanReport, HandlerError> {
    let mcs = cx.task(&args.mcs).await?;
    let speed = args.speed;
    let request = Plan {
        target,
        path,
        speed,
        elbow,
    };
    let planned = cx.call(&mcs, request).await;
    planned.map_err(|error| HandlerError::new(error.reason()))
}

/// Reserves the manipulator, once per command.
async fn acquire(action: &Act, cx: &Context, args: &MotionArgs) -> Acted {
    if !action.with_state(|motion| motion.acquired) {
        let mcs = cx.task(&args.mcs).await?;
        cx.call(&mcs, Acquire {}).await?;
        action.with_state(|motion| {
            motion.acquired = true;
            motion.log = MotionLog::default();
        });
    }
    Ok(())
}

/// Drives the path, and waits until the arm has settled.
async fn move_manip(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let path: PathSpec = store.fetch(&cx, PATH).await?;
    let mcs = cx.task(&args.mcs).await?;
    let request = Move {
        target: path.target,
        path: path.kind,
        speed: path.speed,
        elbow: None,
    };
    let limit = std::time::Duration::from_secs_f64(path.duration_s + MOVE_MARGIN_S);
    let moved = cx.call(&mcs, request).deadline(limit).await;
    let report = moved.map_err(|error| HandlerError::new(error.reason()))?;
    let log = action.with_state(|motion| {
        let log = &mut motion.log;
        log.moves += 1;
        log.max_tracking_error_rad = log
            .max_tracking_error_rad
            .max(report.max_tracking_error_rad);
        log.max_final_error_rad = log.max_final_error_rad.max(report.final_error_rad);
        *log
    });
    store.store(&cx, MOTIONS, &log).await
}

/// Reads the joints back and stores where the tool is by forward kinematics.
async fn find_pos(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let destination: Destination = store.fetch(&cx, DESTINATION).await?;
    let mcs = cx.task(&args.mcs).await?;
    let position = cx.call(&mcs, ReadPosition {}).await?;
    let [_, _, _, x, _, _, _, y, _, _, _, z, ..] = position.base_t_tool;
    let reached = ReachedPosition {
        index: destination.index,
        joints: position.joints,
        lamp: [x, y, z],
    };
    store.store(&cx, POSITION, &reached).await
}

/// Brings the arm to rest, switches it off and gives it back.
async fn release_robot(action: Act) -> Acted {
    let (cx, args, _) = parts(&action);
    if action.with_state(|motion| std::mem::take(&mut motion.acquired)) {
        let mcs = cx.task(&args.mcs).await?;
        cx.call(&mcs, Release {}).await?;
    }
    Ok(())
}
