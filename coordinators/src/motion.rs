//! The Motion Coordinator: the functions of `motion.net` (CIRSSE report 108, section 7, figure 12).
//!
//! It knows more than one way to take a pose: the elbow posture nearest to the present joints first,
//! the others when that one is refused. Only what none of them solves is passed up.

use std::{rc::Rc, time::Duration};

use ctos::{
    call::{CallError, Fault},
    diagnostic::Finding,
    registry::{Registry, Vocabulary},
    task::{Context, HandlerError},
};
use mcs::{
    arm::Elbow,
    client::{Acquire, Move, PathKind, Plan, PlanReport, ReadPosition, Release, Stop, Target},
};
use pnt::{
    check::FunctionNames,
    library::{Acted, Action, Library},
    task::{COMMANDS, NetTask, args as net_args, args_of, check_args},
};
use serde::Deserialize;

use crate::{
    dom::DomStore,
    objects::{
        DESTINATION, Destination, GIVEN_PATH, GivenPath, MOTIONS, MotionLog, PATH, POSITION,
        PROBLEM, PathSpec, Problem, ReachedPosition,
    },
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.motion";

/// How much longer than planned a motion may take, to settle and to be waited for.
const MOVE_MARGIN_S: f64 = 10.0;

/// How long the manipulator may take to come to rest and change its power state.
const STATE_LIMIT: Duration = Duration::from_secs(40);

/// The transition that gives the manipulator back.
pub(crate) const RELEASE: &str = "do_release_robot";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MotionArgs {
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
    /// Whether the manipulator is known to be reserved for this task.
    acquired: bool,
    /// Whether it is, or may be.
    to_release: bool,
    /// Whether a path to the destination was given beforehand, so that none has to be planned.
    path_given: bool,
    log: MotionLog,
}

fn names(args: &MotionArgs) -> FunctionNames {
    library(args.clone(), DomStore::new(&args.dom)).names()
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &COMMANDS, |cx| {
            let args: MotionArgs = args_of(cx)?;
            let store = DomStore::new(&args.dom);
            NetTask::from_args(cx, library(args, store.clone()), Some(Rc::new(store)))
        })
        .speaks(|task| match net_args::<MotionArgs>(task) {
            Ok(args) => names(&args).vocabulary(),
            Err(_) => Vocabulary::new(),
        })
        .check_in_app(|task, app, findings| {
            if let Some(args) = findings.keep(net_args::<MotionArgs>(task)) {
                check_args(task, app, &names(&args), findings);
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
        to_release: false,
        path_given: false,
        log: MotionLog::default(),
    };
    let save = |state: &Motion| {
        let held = (state.acquired, state.to_release);
        (held, state.path_given, state.log)
    };
    Library::new(state)
        .kept(save, |state, (held, path_given, log)| {
            (state.acquired, state.to_release) = held;
            (state.path_given, state.log) = (path_given, log);
        })
        .enabling("path_given", |motion: &Motion| motion.path_given)
        .action("look_for_path", look_for_path)
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

/// Tells the Dispatcher why a request could not be done.
async fn pass_up(action: &Act, acted: Acted) -> Acted {
    let Err(error) = acted else { return acted };
    let (cx, _, store) = parts(action);
    if let Ok(destination) = store.fetch::<Destination>(&cx, DESTINATION).await {
        let problem = Problem {
            stamp: destination.stamp,
            transition: action.transition().to_owned(),
            reason: error.to_string(),
        };
        if let Err(untold) = store.store(&cx, PROBLEM, &problem).await {
            tracing::warn!(%error, %untold, "why a request failed could not be passed up");
        }
    }
    Err(error)
}

/// Sees whether a path to this destination was given beforehand.
async fn look_for_path(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let looked = async {
        let destination: Destination = store.fetch(&cx, DESTINATION).await?;
        let given = store.fetch::<GivenPath>(&cx, GIVEN_PATH).await;
        let fits = given.is_ok_and(|path| path.base_t_tool == destination.base_t_tool);
        action.with_state(|motion| motion.path_given = fits);
        Ok(())
    };
    let looked = looked.await;
    pass_up(&action, looked).await
}

/// Checks that a path given beforehand can still be driven from where the arm is. One that cannot is
/// not given: a path is then planned.
async fn validate_path(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let validated = async {
        let path: GivenPath = store.fetch(&cx, GIVEN_PATH).await?;
        acquire(&action, &cx, &args).await?;
        let request = Plan {
            target: path.target,
            path: path.kind,
            speed: path.speed,
            acceleration: None,
            elbow: None,
        };
        let planned = plan(&cx, &args, request).await?;
        let path = PathSpec {
            target: path.target,
            kind: path.kind,
            speed: path.speed,
            duration_s: planned.duration_s,
        };
        store.store(&cx, PATH, &path).await
    };
    let validated = validated.await;
    if validated.is_err() {
        action.with_state(|motion| motion.path_given = false);
    }
    validated
}

/// Plans from the manipulator's present position to the destination, and stores the path.
async fn plan_path(action: Act) -> Acted {
    let planned = plan_to_destination(&action).await;
    pass_up(&action, planned).await
}

async fn plan_to_destination(action: &Act) -> Acted {
    let (cx, args, store) = parts(action);
    let destination: Destination = store.fetch(&cx, DESTINATION).await?;
    acquire(action, &cx, &args).await?;
    let mut first_refusal = None;
    for elbow in [None, Some(Elbow::Above), Some(Elbow::Below)] {
        let request = Plan {
            target: Target::Pose(destination.base_t_tool),
            path: PathKind::Joint,
            speed: args.speed,
            acceleration: None,
            elbow,
        };
        match plan(&cx, &args, request).await {
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
        destination.stamp.index + 1
    )))
}

async fn plan(cx: &Context, args: &MotionArgs, request: Plan) -> Result<PlanReport, HandlerError> {
    let mcs = cx.task(&args.mcs).await?;
    let planned = cx.call(&mcs, request).await;
    planned.map_err(|error| HandlerError::new(error.reason()))
}

/// Reserves the manipulator, once per command.
async fn acquire(action: &Act, cx: &Context, args: &MotionArgs) -> Acted {
    if action.with_state(|motion| motion.acquired) {
        return Ok(());
    }
    action.with_state(|motion| motion.log = MotionLog::default());
    let mcs = cx.task(&args.mcs).await?;
    if action.with_state(|motion| motion.to_release) {
        // A reservation that was never answered, or not given back, would stand in the way. If there
        // is none after all, this is refused and does no harm.
        let _ = cx.call(&mcs, Release {}).deadline(STATE_LIMIT).await;
    }
    let acquired = cx.call(&mcs, Acquire {}).deadline(STATE_LIMIT).await;
    // Without an answer it may be reserved all the same, and is to be given back at the end.
    let refused = |error: &CallError| matches!(error.fault, Fault::Refused { .. });
    let ours = !acquired.as_ref().is_err_and(refused);
    action.with_state(|motion| {
        motion.acquired = acquired.is_ok();
        motion.to_release |= ours;
    });
    match acquired {
        Ok(_) => Ok(()),
        Err(error) => Err(HandlerError::new(error.reason())),
    }
}

/// Drives the path, and waits until the arm has settled.
async fn move_manip(action: Act) -> Acted {
    let moved = drive(&action).await;
    pass_up(&action, moved).await
}

async fn drive(action: &Act) -> Acted {
    let (cx, args, store) = parts(action);
    let path: PathSpec = store.fetch(&cx, PATH).await?;
    let mcs = cx.task(&args.mcs).await?;
    let request = Move {
        target: path.target,
        path: path.kind,
        speed: path.speed,
        acceleration: None,
        elbow: None,
    };
    let limit = Duration::try_from_secs_f64(path.duration_s + MOVE_MARGIN_S)?;
    let report = match cx.call(&mcs, request).deadline(limit).await {
        Ok(report) => report,
        Err(error) => {
            if !matches!(error.fault, Fault::Refused { .. }) {
                // Nobody knows whether it still moves. It must not when the next position begins.
                cx.call(&mcs, Stop {}).await?;
            }
            return Err(HandlerError::new(error.reason()));
        }
    };
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
    let found = read_back(&action).await;
    pass_up(&action, found).await
}

async fn read_back(action: &Act) -> Acted {
    let (cx, args, store) = parts(action);
    let destination: Destination = store.fetch(&cx, DESTINATION).await?;
    let mcs = cx.task(&args.mcs).await?;
    let position = cx.call(&mcs, ReadPosition {}).await;
    let position = position.map_err(|error| HandlerError::new(error.reason()))?;
    let [_, _, _, x, _, _, _, y, _, _, _, z, ..] = position.base_t_tool;
    let reached = ReachedPosition {
        stamp: destination.stamp,
        joints: position.joints,
        lamp: [x, y, z],
    };
    store.store(&cx, POSITION, &reached).await
}

/// Brings the arm to rest, switches it off and gives it back.
async fn release_robot(action: Act) -> Acted {
    let (cx, args, _) = parts(&action);
    if !action.with_state(|motion| motion.to_release) {
        return Ok(());
    }
    let released = crate::insist(|| async {
        let mcs = cx.task(&args.mcs).await?;
        let released = cx.call(&mcs, Release {}).deadline(STATE_LIMIT).await;
        released.map_err(|error| {
            HandlerError::new(format!(
                "the manipulator could not be given back: {}",
                error.reason()
            ))
        })?;
        Ok(())
    });
    let released = released.await;
    // What could not be given back now is tried again after the next command.
    action.with_state(|motion| {
        motion.acquired = false;
        motion.to_release = released.is_err();
    });
    pass_up(&action, released).await
}

#[cfg(test)]
mod tests;
