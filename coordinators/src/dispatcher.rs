//! The Dispatcher: the functions of `dispatcher.net`, which translates Organization Level commands
//! into requests to the Coordinators (CIRSSE report 108, section 7, figure 10).
//!
//! `calibrate_camera` moves the lamp through the positions of a file, collects where the lamp was and
//! where each camera saw it, and has the Vision Services System compute the cameras. Nothing here knows
//! where the cameras really are.

use std::{path::PathBuf, rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    registry::Registry,
    task::{Context, HandlerError},
};
use futures_util::future::join_all;
use pnt::{
    library::{Acted, Action, Library},
    task::args as net_args,
};
use serde::Deserialize;
use vss::command::{Calibrate, Outcome as Vss, VisionError};

use crate::{
    dom::DomStore,
    handler::{self, NetArgs},
    motion,
    objects::{
        CALIBRATIONS, Calibrations, DESTINATION, Destination, OBSERVATIONS, Observations, POSITION,
        PROBLEM, Problem, ReachedPosition, SPOTS, Spots, Stamp,
    },
    outcome::{Failure, Outcome},
    positions::{self, Position},
    results,
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.dispatcher";

/// How long computing one camera may take.
const CALIBRATE_LIMIT: Duration = Duration::from_secs(60);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct DispatcherArgs {
    /// The file of positions, relative to the configuration's folder.
    positions: String,
    /// Where results are written, relative to the folder in which the app was started; without it
    /// none are.
    results: Option<PathBuf>,
    /// The task that switches the lamp with a command `set_lamp`.
    #[serde(default = "lamp_task")]
    lamp: String,
    /// The Vision Services Manager.
    #[serde(default = "crate::vision::vsm_task")]
    vsm: String,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
    /// How long a vision system that is gone, and may be started again, is waited for, s.
    #[serde(default = "crate::service_within_s")]
    service_within_s: f64,
}

fn lamp_task() -> String {
    "world".to_owned()
}

/// What the functions share.
struct Dispatcher {
    args: Rc<DispatcherArgs>,
    store: DomStore,
    positions: Rc<[Position]>,
    /// Number of the command in work, from 1.
    command: u32,
    /// The loop variable: positions that have not been read yet.
    left: usize,
    observations: Observations,
}

impl Dispatcher {
    /// Stamp of the position after which so many are left.
    fn stamp_at(&self, left: usize) -> Stamp {
        Stamp {
            command: self.command,
            index: self.positions.len().saturating_sub(left + 1),
        }
    }
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    handler::register::<DispatcherArgs>(registry);
    registry.app_check("coordinators::lamp", |app, registry, findings| {
        for task in app.tasks.iter().filter(|task| task.handler == HANDLER) {
            if let Ok(args) = net_args::<DispatcherArgs>(task)
                && let Err(finding) = registry.command_of(app, &args.lamp, "set_lamp")
            {
                let place = task.args.locate("lamp");
                findings.push(finding.at(place.unwrap_or_else(|| task.place.clone())));
            }
        }
    });
}

impl NetArgs for DispatcherArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Dispatcher;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Dispatcher> {
        library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        check(self, task, app, findings);
    }
}

fn check(args: &DispatcherArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    crate::need_task(task, app, "vsm", &args.vsm, findings);
    crate::check_seconds(task, "service_within_s", args.service_within_s, findings);
    check_positions(task, app, args, findings);
}

/// Reads the positions and, where the app has a manipulator, checks that it reaches them.
fn check_positions(task: &TaskConfig, app: &App, args: &DispatcherArgs, findings: &mut Findings) {
    let source = match app.read(&args.positions) {
        Ok(source) => source,
        Err(finding) => {
            let place = task.args.locate("positions");
            return findings.push(finding.at(place.unwrap_or_else(|| task.place.clone())));
        }
    };
    let positions = match positions::parse(&source) {
        Ok(positions) => positions,
        Err(found) => return findings.extend(found),
    };
    if let Some(arm) = mcs::manipulator(app) {
        positions::check_reach(&positions, &source, arm, findings);
    }
    positions::check_spread(&positions, &source, findings);
}

/// At how many of `count` positions each camera must have seen the lamp: what a command says with
/// `enough=N` or `enough=N%`, else half of them.
fn enough(arguments: &[String], count: usize) -> Result<u32, HandlerError> {
    let count = u32::try_from(count).unwrap_or(u32::MAX);
    let share = |percent: u32| (u64::from(count) * u64::from(percent)).div_ceil(100);
    let mut enough = share(50);
    for argument in arguments {
        let said = argument.strip_prefix("enough=");
        let number = said.and_then(|said| match said.strip_suffix('%') {
            Some(percent) => percent.parse().ok().map(share),
            None => said.parse().ok(),
        });
        enough = number.ok_or_else(|| {
            HandlerError::new(format!(
                "`{argument}` is no argument of this command; it takes `enough=N` or `enough=N%`, of the positions"
            ))
        })?;
    }
    match u32::try_from(enough) {
        Ok(enough) if enough <= count => Ok(enough),
        _ => Err(HandlerError::new(format!(
            "{enough} positions are to be enough, and the file has {count}"
        ))),
    }
}

fn library(args: DispatcherArgs, store: DomStore) -> Library<Dispatcher> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        positions: Rc::from([]),
        command: 0,
        left: 0,
        observations: Observations::default(),
    };
    let save = |state: &Dispatcher| {
        let positions = state.positions.to_vec();
        let observations = state.observations.clone();
        (state.command, state.left, positions, observations)
    };
    Library::new(state)
        .kept(save, |state, (command, left, positions, observations)| {
            state.positions = Rc::from(positions);
            (state.command, state.left) = (command, left);
            state.observations = observations;
        })
        .enabling("more_positions", |dispatcher: &Dispatcher| {
            dispatcher.left > 0
        })
        .action("init_calib", init_calib)
        .action("read_next_pos", read_next_pos)
        .action("store_point", store_point)
        .action("compute_calib", compute_calib)
        .action("end_calib", end_calib)
}

type Act = Action<Dispatcher>;

fn parts(action: &Act) -> (Context, Rc<DispatcherArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}

/// Prepares: lamp on, positions read, loop variable set.
async fn init_calib(action: Act) -> Acted {
    let (cx, args, _) = parts(&action);
    let positions = positions::read(&cx.app().file_at(&args.positions))?;
    let enough = enough(action.arguments(), positions.len())?;
    set_lamp(&cx, &args.lamp, true).await?;
    // What an action changes, it changes at its end: a process that dies before that begins it again.
    action.with_state(|state| {
        state.command = state.command.wrapping_add(1);
        state.left = positions.len();
        state.observations = Observations {
            wanted: u32::try_from(positions.len()).unwrap_or(u32::MAX),
            enough,
            ..Observations::default()
        };
        state.positions = positions.into();
    });
    Ok(())
}

async fn set_lamp(cx: &Context, task: &str, on: bool) -> Acted {
    let command = cx.registry().command_of(cx.app(), task, "set_lamp")?;
    let lamp = cx.task(task).await?;
    let data = postcard::to_stdvec(&on)?;
    cx.call_raw(&lamp, command, data, ctos::DEFAULT_DEADLINE)
        .await?;
    Ok(())
}

/// Counts the loop variable down and makes the next position the destination.
async fn read_next_pos(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let (left, stamp, position) = action.with_state(|state| {
        let left = state.left.saturating_sub(1);
        let stamp = state.stamp_at(left);
        (left, stamp, state.positions.get(stamp.index).copied())
    });
    let position = position.ok_or("the file of positions is empty")?;
    let destination = Destination {
        stamp,
        base_t_tool: position.row_major(),
    };
    store.store(&cx, DESTINATION, &destination).await?;
    action.with_state(|state| state.left = left);
    Ok(())
}

/// Adds this position's lamp and spots to the table. Data of an earlier position means that this one
/// was not done, which only a position out of reach may be.
async fn store_point(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let (stamp, line, left) = action.with_state(|state| {
        let stamp = state.stamp_at(state.left);
        let position = state.positions.get(stamp.index);
        let line = position.map_or(0, |position| position.line);
        (stamp, line, state.left)
    });
    let lamp = store.fetch::<ReachedPosition>(&cx, POSITION).await;
    let lamp = lamp.ok().filter(|lamp| lamp.stamp == stamp);
    let spots = store.fetch::<Spots>(&cx, SPOTS).await;
    let spots = spots.ok().filter(|spots| spots.stamp == stamp);
    if let Some(failure) = spots.as_ref().and_then(|spots| spots.failure.as_ref()) {
        return Err(format!("the vision system has failed: {failure}").into());
    }
    let problem = match &lamp {
        Some(_) => None,
        None => match problem(&cx, &store, stamp).await {
            failure if failure.outcome == Outcome::Unreachable => Some(failure.reason),
            failure => return Err(failure.into()),
        },
    };
    let mut observations = action.with_state(|state| state.observations.clone());
    match (&lamp, &spots) {
        (Some(lamp), Some(spots)) => observations.add(line, lamp, spots),
        (Some(_), None) => return Err("the Vision Coordinator left no answer".into()),
        (None, _) => observations.skip(line, problem.as_deref().unwrap_or_default()),
    }
    store.store(&cx, OBSERVATIONS, &observations).await?;
    let (done, total) = (stamp.index as u64 + 1, u64::from(observations.wanted));
    let what = match (&problem, &spots) {
        (Some(problem), _) => format!("skipped: {problem}"),
        (None, Some(spots)) if spots.reasons.is_empty() => {
            format!("spot seen by {} cameras", spots.seen.len())
        }
        (None, spots) => spots.as_ref().map_or_else(String::new, Spots::why),
    };
    cx.progress(done, total, "position", &what);
    let hopeful = observations.hopeful(left);
    action.with_state(|state| state.observations = observations);
    hopeful
}

/// Why the Motion Coordinator did not do what was asked at this position.
async fn problem(cx: &Context, store: &DomStore, stamp: Stamp) -> Failure {
    let problem = store.fetch::<Problem>(cx, PROBLEM).await;
    match problem.ok().filter(|problem| problem.stamp == stamp) {
        Some(problem) => problem.failure,
        None => Failure::new(Outcome::Fault, "the Motion Coordinator gave no reason"),
    }
}

/// Has every camera computed from its table, and writes the results.
async fn compute_calib(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let observations: Observations = store.fetch(&cx, OBSERVATIONS).await?;
    observations.hopeful(0)?;
    let within = Duration::try_from_secs_f64(args.service_within_s).unwrap_or(Duration::MAX);
    let seed = cx.app().seed;
    let calls = observations.cameras.into_iter().map(|table| {
        let request = Calibrate {
            camera: table.camera.clone(),
            width: table.width,
            height: table.height,
            points: table.points,
            seed,
        };
        let (cx, args) = (&cx, &args);
        async move {
            let is_lost = |error: &VisionError| error.outcome == Vss::Lost;
            let asked = crate::patiently(cx, within, is_lost, || async {
                let vsm = cx.task(&args.vsm).await?;
                let call = cx.call(&vsm, request.clone());
                Ok(call.deadline(CALIBRATE_LIMIT).await?)
            });
            (table.camera, asked.await)
        }
    });
    let mut cameras = Vec::new();
    for (camera, answer) in join_all(calls).await {
        let calibration =
            answer.map_err(|error| HandlerError::new(format!("camera `{camera}`: {error}")))?;
        cameras.push((camera, calibration));
    }
    if let Some(folder) = &args.results {
        // A replay writes nothing.
        let written = cx.outside("the files of the results", || {
            results::write(folder, &cameras).map_err(|error| error.to_string())
        });
        for file in written? {
            action.note(format!("written: {}", file.display()));
        }
    }
    store
        .store(&cx, CALIBRATIONS, &Calibrations { cameras })
        .await
}

/// Lamp off. Tells also when the robot could not be given back.
async fn end_calib(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command);
    if let Ok(problem) = store.fetch::<Problem>(&cx, PROBLEM).await
        && problem.stamp.command == command
        && problem.transition == motion::RELEASE
    {
        action.note(problem.failure.reason);
    }
    crate::insist(|| set_lamp(&cx, &args.lamp, false)).await
}

#[cfg(test)]
mod tests;
