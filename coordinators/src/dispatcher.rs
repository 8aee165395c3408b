//! The Dispatcher: the functions of `dispatcher.net`, which translates Organization Level commands
//! into requests to the Coordinators (CIRSSE report 108, section 7, figure 10).
//!
//! `calibrate_camera` moves the lamp through the positions of a file, collects where the lamp was and
//! where each camera saw it, and has the Vision Services System compute the cameras. Nothing here knows
//! where the cameras really are.

use std::{
    path::{Path, PathBuf},
    rc::Rc,
    time::Duration,
};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Findings, Source},
    registry::Registry,
    task::{Context, HandlerError},
};
use futures_util::future::join_all;
use mcs::tasks::{SERVO, args::ServoArgs};
use pnt::{
    library::{Acted, Action, Library},
    task::{COMMANDS, NetTask, check_args},
};
use serde::Deserialize;
use vss::{
    calibrate::{Calibration, LightPoint},
    camera_info::{CameraInfo, CameraPose, poses_to_yaml},
    command::Calibrate,
};

use crate::{
    dom::DomStore,
    objects::{
        CALIBRATIONS, Calibrations, CameraTable, DESTINATION, Destination, OBSERVATIONS,
        Observations, POSITION, ReachedPosition, SPOTS, Spots,
    },
    positions::{self, Position},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.dispatcher";

/// A camera that has seen no spot at so many positions is given up.
const HOPELESS_AFTER: u32 = 10;

/// How long computing one camera may take.
const CALIBRATE_LIMIT: Duration = Duration::from_secs(60);

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct DispatcherArgs {
    /// The net; read by [`pnt::task::settings`].
    #[serde(rename = "net")]
    _net: String,
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
}

fn lamp_task() -> String {
    "world".to_owned()
}

/// What the functions share.
struct Dispatcher {
    args: Rc<DispatcherArgs>,
    store: DomStore,
    positions: Rc<[Position]>,
    /// The loop variable: positions that have not been read yet.
    left: usize,
    observations: Observations,
}

impl Dispatcher {
    /// Number of the position in work, from 0.
    fn index(&self) -> usize {
        self.positions.len().saturating_sub(self.left + 1)
    }
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &COMMANDS, |cx| {
            let args: DispatcherArgs = cx.args()?;
            let store = DomStore::new(&args.dom);
            NetTask::from_args(cx, library(args, store.clone()), Some(Rc::new(store)))
        })
        .check_in_app(check);
    registry.app_check(|app, registry, findings| {
        for task in app.tasks.iter().filter(|task| task.handler == HANDLER) {
            if let Ok(args) = task.args.parse::<DispatcherArgs>()
                && let Err(finding) = registry.command_of(app, &args.lamp, "set_lamp")
            {
                let place = task.args.locate("lamp");
                findings.push(finding.at(place.unwrap_or_else(|| task.place.clone())));
            }
        }
    });
}

fn check(task: &TaskConfig, app: &App, findings: &mut Findings) {
    let Some(args) = findings.keep(task.args.parse::<DispatcherArgs>()) else {
        return;
    };
    crate::need_task(task, app, "dom", &args.dom, findings);
    crate::need_task(task, app, "vsm", &args.vsm, findings);
    check_positions(task, app, &args.positions, findings);
    let store = DomStore::new(&args.dom);
    check_args(task, app, &library(args, store).names(), findings);
}

/// Reads the positions and, where the app has a servo, holds them against its arm.
fn check_positions(task: &TaskConfig, app: &App, file: &str, findings: &mut Findings) {
    let source = match Source::read(&app.folder.join(file)) {
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
    let servo = app.tasks.iter().find(|task| task.handler == SERVO);
    // The servo's own arguments are reported by its own check.
    let servo = servo.and_then(|servo| ServoArgs::read(servo, &mut Findings::new()));
    if let Some(servo) = servo {
        positions::check(&positions, &source, &servo.model(), &servo.tool(), findings);
    }
}

fn library(args: DispatcherArgs, store: DomStore) -> Library<Dispatcher> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        positions: Rc::from([]),
        left: 0,
        observations: Observations::default(),
    };
    Library::new(state)
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
    let positions = positions::read(&cx.path(&args.positions))?;
    set_lamp(&cx, &args.lamp, true).await?;
    action.with_state(|state| {
        state.left = positions.len();
        state.observations = Observations {
            wanted: u32::try_from(positions.len()).unwrap_or(u32::MAX),
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
    let (index, position) = action.with_state(|state| {
        state.left = state.left.saturating_sub(1);
        (state.index(), state.positions.get(state.index()).copied())
    });
    let position = position.ok_or("the file of positions is empty")?;
    let destination = Destination {
        index,
        base_t_tool: position.row_major(),
    };
    store.store(&cx, DESTINATION, &destination).await
}

/// Adds this position's lamp and spots to the table. Data of an earlier position (this one was
/// skipped) counts as missed.
async fn store_point(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let index = action.with_state(|state| state.index());
    let position = store.fetch::<ReachedPosition>(&cx, POSITION).await;
    let lamp = position.ok().filter(|position| position.index == index);
    let spots = store.fetch::<Spots>(&cx, SPOTS).await;
    let spots = spots
        .ok()
        .filter(|spots| spots.index == index && lamp.is_some());
    let observations = action.with_state(|state| {
        let observations = &mut state.observations;
        observations.reached += u32::from(lamp.is_some());
        match (&lamp, &spots) {
            (Some(lamp), Some(spots)) => add_point(observations, lamp, spots),
            _ => {
                for table in &mut observations.cameras {
                    table.missed += 1;
                }
            }
        }
        observations.clone()
    });
    store.store(&cx, OBSERVATIONS, &observations).await?;
    let (done, total) = (index as u64 + 1, u64::from(observations.wanted));
    cx.progress(done, total, &progress(&observations, spots.as_ref()));
    hopeless(&observations, spots.as_ref())
}

fn add_point(observations: &mut Observations, lamp: &ReachedPosition, spots: &Spots) {
    let [x, y, z] = lamp.lamp;
    for (camera, spot) in &spots.seen {
        let known = observations
            .cameras
            .iter()
            .position(|table| table.camera == *camera);
        let place = known.unwrap_or_else(|| {
            observations.cameras.push(CameraTable {
                camera: camera.clone(),
                ..CameraTable::default()
            });
            observations.cameras.len() - 1
        });
        let Some(table) = observations.cameras.get_mut(place) else {
            continue;
        };
        match spot {
            Some(spot) => {
                (table.width, table.height) = (spot.width, spot.height);
                let (u, v) = (spot.u, spot.v);
                table.points.push(LightPoint { x, y, z, u, v });
            }
            None => table.missed += 1,
        }
    }
}

fn progress(observations: &Observations, spots: Option<&Spots>) -> String {
    match spots {
        None => "skipped".to_owned(),
        Some(spots) if spots.reasons.is_empty() => {
            format!(
                "position, spot seen by {} cameras",
                observations.cameras.len()
            )
        }
        Some(spots) => format!("position, {}", spots.reasons.join("; ")),
    }
}

/// Gives up early when a camera has seen nothing at all.
fn hopeless(observations: &Observations, spots: Option<&Spots>) -> Acted {
    let blind = observations
        .cameras
        .iter()
        .find(|table| table.points.is_empty() && table.missed >= HOPELESS_AFTER);
    match blind {
        None => Ok(()),
        Some(table) => {
            let why = spots.map_or_else(String::new, |spots| {
                let own = format!("`{}`", table.camera);
                let mut reasons = spots.reasons.iter();
                let reason = reasons.find(|reason| reason.contains(&own));
                reason.map_or_else(String::new, |reason| format!(" ({reason})"))
            });
            Err(HandlerError::new(format!(
                "camera `{}` has seen no spot at {} positions{why}: is the lamp on, and does the camera look at the work volume?",
                table.camera, table.missed
            )))
        }
    }
}

/// Has every camera computed from its table, and writes the results.
async fn compute_calib(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let observations: Observations = store.fetch(&cx, OBSERVATIONS).await?;
    let vsm = cx.task(&args.vsm).await?;
    let seed = cx.app().seed;
    let calls = observations.cameras.into_iter().map(|table| {
        let request = Calibrate {
            camera: table.camera.clone(),
            width: table.width,
            height: table.height,
            points: table.points,
            seed,
        };
        let call = cx.call(&vsm, request).deadline(CALIBRATE_LIMIT);
        async move { (table.camera, call.await) }
    });
    let mut cameras = Vec::new();
    for (camera, answer) in join_all(calls).await {
        let calibration = answer.map_err(|error| HandlerError::new(error.reason()))?;
        cameras.push((camera, calibration));
    }
    if cameras.is_empty() {
        return Err("no camera saw anything: no position was reached".into());
    }
    if let Some(folder) = &args.results {
        for file in write_results(folder, &cameras)? {
            action.note(format!("written: {}", file.display()));
        }
    }
    store
        .store(&cx, CALIBRATIONS, &Calibrations { cameras })
        .await
}

/// Writes a ROS `camera_info` per camera and the poses of all of them. A file that was there before
/// is replaced only when the new one is complete.
fn write_results(
    folder: &Path,
    cameras: &[(String, Calibration)],
) -> Result<Vec<PathBuf>, HandlerError> {
    let failed = |path: &Path, error: std::io::Error| {
        HandlerError::new(format!("cannot write `{}`: {error}", path.display()))
    };
    std::fs::create_dir_all(folder).map_err(|error| failed(folder, error))?;
    let mut texts = Vec::new();
    for (name, calibration) in cameras {
        let info = CameraInfo::of(name, calibration).to_yaml()?;
        texts.push((folder.join(format!("{name}.yaml")), info));
    }
    let poses: Vec<CameraPose> = cameras
        .iter()
        .map(|(name, calibration)| CameraPose::of(name, calibration))
        .collect();
    texts.push((folder.join("poses.yaml"), poses_to_yaml(&poses)?));
    for (path, text) in &texts {
        let half = path.with_extension("yaml.part");
        std::fs::write(&half, text).map_err(|error| failed(&half, error))?;
        std::fs::rename(&half, path).map_err(|error| failed(path, error))?;
    }
    Ok(texts.into_iter().map(|(path, _)| path).collect())
}

/// Lamp off.
async fn end_calib(action: Act) -> Acted {
    let (cx, args, _) = parts(&action);
    set_lamp(&cx, &args.lamp, false).await
}
