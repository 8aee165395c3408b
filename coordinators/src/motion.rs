//! The Motion Coordinator: the functions of `motion.net` (CIRSSE report 108, section 7, figure 12).
//!
//! It knows more than one way to take a pose: the elbow posture nearest to the present joints first,
//! the others when that one is refused. Only what none of them solves is passed up.

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    registry::Registry,
    task::{Context, HandlerError},
};
use mcs::{
    client::{Manipulator, MotionError, Move, PathKind, Plan, PlanReport, Target},
    model::inverse::Elbow,
    state::State,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::{
    arm::{Arm, ArmKeys},
    dom::DomStore,
    handler::{self, NetArgs},
    objects::{
        DESTINATION, Destination, GIVEN_PATH, GivenPath, MOTIONS, MotionLog, PATH, POSITION,
        PROBLEM, PathSpec, Problem, ReachedPosition,
    },
    outcome::{Failure, Outcome},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.motion";

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
    /// How long a protective stop is waited out before the request fails, s.
    #[serde(default = "resume_within_s")]
    resume_within_s: f64,
    /// How long an MCS that is gone, and may be started again, is waited for, s. A motion that was under
    /// way is lost all the same.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

impl MotionArgs {
    fn arm<'a>(&'a self, cx: &'a Context) -> Arm<'a> {
        Arm {
            cx,
            mcs: &self.mcs,
            within_s: self.service_within_s,
        }
    }
}

pub(crate) fn resume_within_s() -> f64 {
    60.0
}

pub(crate) fn mcs_task() -> String {
    "mcs".to_owned()
}

fn speed() -> f64 {
    0.8
}

/// What the functions share. Who holds the manipulator is not here: MCS knows.
pub(crate) struct Coordinator {
    args: Rc<MotionArgs>,
    store: DomStore,
    /// Whether a path to the destination was given beforehand, so that none has to be planned.
    path_given: bool,
    /// What ended the latest motion before its end.
    ended: Option<Failure>,
    /// The command that the log is of.
    command: u32,
    log: MotionLog,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    handler::register::<MotionArgs>(registry);
}

impl NetArgs for MotionArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Coordinator;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Coordinator> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        let keys = ArmKeys {
            mcs: &self.mcs,
            resume_within_s: self.resume_within_s,
            service_within_s: self.service_within_s,
            speeds: &[("speed", self.speed)],
            park_deg: None,
        };
        keys.check(task, app, "coordinators::motion::speed", findings);
    }
}

fn library(args: MotionArgs, store: DomStore) -> Library<Coordinator> {
    let state = Coordinator {
        args: Rc::new(args),
        store,
        path_given: false,
        ended: None,
        command: 0,
        log: MotionLog::default(),
    };
    let save = |state: &Coordinator| {
        let ended = state.ended.clone();
        (state.path_given, ended, state.command, state.log)
    };
    Library::new(state)
        .kept(save, |state, (path_given, ended, command, log)| {
            (state.path_given, state.ended) = (path_given, ended);
            (state.command, state.log) = (command, log);
        })
        .enabling("path_given", |state: &Coordinator| state.path_given)
        .enabling("stopped", |state: &Coordinator| {
            let ended = state.ended.as_ref();
            ended.is_some_and(|failure| failure.outcome == Outcome::Stopped)
        })
        .action("look_for_path", look_for_path)
        .action("validate_path", validate_path)
        .action("plan_path", plan_path)
        .action("move_manip", move_manip)
        .action("await_resume", await_resume)
        .action("find_pos", find_pos)
        .action("release_robot", release_robot)
}

type Act = Action<Coordinator>;

fn parts(action: &Act) -> (Context, Rc<MotionArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}

/// Tells the Dispatcher why a request could not be done.
async fn pass_up(action: &Act, acted: Result<(), Failure>) -> Acted {
    let Err(failure) = acted else { return Ok(()) };
    let (cx, _, store) = parts(action);
    if let Ok(destination) = store.fetch::<Destination>(&cx, DESTINATION).await {
        let problem = Problem {
            stamp: destination.stamp,
            transition: action.transition().to_owned(),
            failure: failure.clone(),
        };
        if let Err(untold) = store.store(&cx, PROBLEM, &problem).await {
            tracing::warn!(%failure, %untold, "why a request failed could not be passed up");
        }
    }
    Err(failure.into())
}

/// Asks MCS, again while it is gone and may be started again: for what may be done twice.
async fn ask<T, F: Future<Output = Result<T, MotionError>>>(
    cx: &Context,
    args: &MotionArgs,
    request: impl Fn(Manipulator) -> F,
) -> Result<T, Failure> {
    args.arm(cx).ask(request).await
}

/// Sees whether a path to this destination was given beforehand.
async fn look_for_path(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let looked = async {
        let destination: Destination = store.fetch(&cx, DESTINATION).await?;
        let given = store.fetch::<GivenPath>(&cx, GIVEN_PATH).await;
        let fits = given.is_ok_and(|path| path.base_t_tool == destination.base_t_tool);
        action.with_state(|state| state.path_given = fits);
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
        Ok(store.store(&cx, PATH, &path).await?)
    };
    let validated: Result<(), Failure> = validated.await;
    if validated.is_err() {
        action.with_state(|state| state.path_given = false);
    }
    Ok(validated?)
}

/// Plans from the manipulator's present position to the destination, and stores the path.
async fn plan_path(action: Act) -> Acted {
    let planned = plan_to_destination(&action).await;
    pass_up(&action, planned).await
}

async fn plan_to_destination(action: &Act) -> Result<(), Failure> {
    let (cx, args, store) = parts(action);
    let destination: Destination = store.fetch(&cx, DESTINATION).await?;
    acquire(action, &cx, &args).await?;
    let mut first_reason = None;
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
                return Ok(store.store(&cx, PATH, &path).await?);
            }
            Err(failure) if failure.outcome == Outcome::Unreachable => {
                first_reason.get_or_insert(failure.reason);
            }
            Err(failure) => return Err(failure),
        }
    }
    let position = destination.stamp.index + 1;
    let reason = first_reason.unwrap_or_default();
    Err(Failure::new(
        Outcome::Unreachable,
        format!("position {position} cannot be reached: {reason}"),
    ))
}

async fn plan(cx: &Context, args: &MotionArgs, request: Plan) -> Result<PlanReport, Failure> {
    let planned = ask(cx, args, |arm| {
        let request = request.clone();
        async move { arm.plan(request).await }
    });
    planned.await
}

/// Reserves the manipulator for a command; later on, sees that it is still reserved for it.
async fn acquire(action: &Act, cx: &Context, args: &MotionArgs) -> Result<(), Failure> {
    let destination: Destination = parts(action).2.fetch(cx, DESTINATION).await?;
    let command = destination.stamp.command;
    if action.with_state(|state| state.command) == command {
        return still_held(cx, args).await;
    }
    ask(cx, args, |arm| async move { arm.acquire().await }).await?;
    action.with_state(|state| {
        state.command = command;
        state.log = MotionLog::default();
    });
    Ok(())
}

/// What was measured before holds only while MCS has kept the manipulator for this task.
async fn still_held(cx: &Context, args: &MotionArgs) -> Result<(), Failure> {
    let status = ask(cx, args, |arm| async move { arm.status().await }).await?;
    if status.holder.as_deref() == Some(cx.name()) {
        return Ok(());
    }
    if status.state == State::Estopped {
        // It cannot be acquired; the error says what stopped it.
        ask(cx, args, |arm| async move { arm.acquire().await }).await?;
    }
    Err(Failure::new(
        Outcome::Lost,
        format!(
            "the manipulator is no longer reserved for `{}`: MCS was started again, or somebody gave it back",
            cx.name()
        ),
    ))
}

/// Drives the path, and waits until the arm has settled.
async fn move_manip(action: Act) -> Acted {
    let moved = drive(&action).await;
    action.with_state(|state| state.ended = moved.as_ref().err().cloned());
    pass_up(&action, moved).await
}

async fn drive(action: &Act) -> Result<(), Failure> {
    let (cx, args, store) = parts(action);
    let path: PathSpec = store.fetch(&cx, PATH).await?;
    let request = Move {
        target: path.target,
        path: path.kind,
        speed: path.speed,
        acceleration: None,
        elbow: None,
        guards: Vec::new(),
        blend: 0.0.into(),
    };
    let report = args.arm(&cx).go(request, path.duration_s).await?;
    let log = action.with_state(|state| {
        let log = &mut state.log;
        log.moves += 1;
        log.max_tracking_error_rad = log
            .max_tracking_error_rad
            .max(report.max_tracking_error_rad);
        log.max_final_error_rad = log.max_final_error_rad.max(report.final_error_rad);
        *log
    });
    Ok(store.store(&cx, MOTIONS, &log).await?)
}

/// Waits until somebody ends the protective stop that ended the motion; the way is then planned anew.
async fn await_resume(action: Act) -> Acted {
    let resumed = resumed(&action).await;
    pass_up(&action, resumed).await
}

async fn resumed(action: &Act) -> Result<(), Failure> {
    let (cx, args, _) = parts(action);
    let ended = action.with_state(|state| state.ended.clone());
    let reason = ended.map_or_else(String::new, |ended| ended.reason);
    args.arm(&cx).resumed(args.resume_within_s, &reason).await
}

/// Reads the joints back and stores where the tool is by forward kinematics.
async fn find_pos(action: Act) -> Acted {
    let found = read_back(&action).await;
    pass_up(&action, found).await
}

async fn read_back(action: &Act) -> Result<(), Failure> {
    let (cx, args, store) = parts(action);
    let destination: Destination = store.fetch(&cx, DESTINATION).await?;
    let position = ask(&cx, &args, |arm| async move { arm.position().await }).await?;
    still_held(&cx, &args).await?;
    let [_, _, _, x, _, _, _, y, _, _, _, z, ..] = position.base_t_tool;
    let reached = ReachedPosition {
        stamp: destination.stamp,
        joints: position.joints,
        lamp: [x, y, z],
    };
    Ok(store.store(&cx, POSITION, &reached).await?)
}

/// Brings the arm to rest, switches it off and gives it back, if this task holds it.
async fn release_robot(action: Act) -> Acted {
    let (cx, args, _) = parts(&action);
    let released = crate::insist(|| async {
        let release = async {
            let arm = Manipulator::find(&cx, &args.mcs).await?;
            if arm.status().await?.holder.as_deref() == Some(cx.name()) {
                arm.release().await?;
            }
            Ok(())
        };
        let released: Result<(), MotionError> = release.await;
        released.map_err(|error| {
            HandlerError::new(format!("the manipulator could not be given back: {error}"))
        })
    });
    let released = released.await;
    pass_up(&action, released.map_err(Failure::from)).await
}

#[cfg(test)]
mod tests;
