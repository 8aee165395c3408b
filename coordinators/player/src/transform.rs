//! The Transform Coordinator of the checkers player: the functions of `nets/checkers/transform.net`, which bring together places in
//! pictures, on the board and on the table.
//!
//! For each camera a PSOM, an object of the transform's daemon, relates pixels and the table. It is trained from points that are known
//! in both when this process begins, and completes what is not known (SORMA technical report, section 2.1.3).

use std::{cell::Cell, collections::BTreeMap, rc::Rc};

use coordinators::{
    dom::DomStore,
    handler::NetArgs,
    served::{self, Served},
};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::{Context, HandlerError},
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;
use sorma::{Method, Transport};

use crate::{
    player::is_mirrored,
    wire::{self, CORNERS, MARKERS, Marked, Marks, Pose, apart},
};

/// Cameras that see a marker so far apart do not see the same, m.
const AGREE_M: f64 = 0.006;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransformArgs {
    /// The data object manager.
    #[serde(default = "crate::coordinator::dom")]
    dom: String,
    /// The task whose arguments say what is played.
    #[serde(default = "crate::room::player")]
    player: String,
    /// The map of each camera.
    #[serde(default)]
    maps: BTreeMap<String, MapArgs>,
}

/// A map between pixels and the table.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct MapArgs {
    /// An object of the class `psom`, such as `psom.left@transform_daemon`.
    object: String,
    /// The points that are known: a table of x and y (m), u and v (px) on a full grid of x and y, relative to the configuration's folder.
    known: String,
}

/// What the functions share.
#[derive(Clone)]
pub struct Transform {
    args: Rc<TransformArgs>,
    store: DomStore,
    /// Whether the maps are trained. Their daemon lives as long as this process.
    trained: Rc<Cell<bool>>,
}

impl NetArgs for TransformArgs {
    const HANDLER: &'static str = "checkers.transform";
    type State = Transform;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Transform> {
        let state = Transform {
            args: Rc::new(self),
            store,
            trained: Rc::default(),
        };
        // Between two requests there is nothing to know.
        let library = Library::new(state).kept(|_| (), |_, ()| ());
        library.action("adapt", adapt).action("locate", locate)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "player", &self.player, findings);
        for (camera, map) in &self.maps {
            let key = format!("maps.{camera}.object");
            let example = "psom.left@transform_daemon";
            served::check((&key, &map.object), example, task, app, findings);
            if let Err(error) = app.read(&map.known) {
                let place = task.args.locate(&format!("maps.{camera}.known"));
                let finding = Finding::error("checkers::player::args", error.to_string());
                findings.push(
                    finding
                        .at(place.unwrap_or_else(|| task.place.clone()))
                        .help("name a table with the columns x,y,u,v"),
                );
            }
        }
    }
}

fn state(action: &Action<Transform>) -> Transform {
    action.with_state(|state| state.clone())
}

/// Where the board is, by its markers.
async fn adapt(action: Action<Transform>) -> Acted {
    let state = state(&action);
    let cx = action.cx();
    let marks: Marks = wire::fetch(cx, &state.store, wire::MARKS).await?;
    let marks = match marks {
        Marks::Table(seen) => MARKERS.into_iter().zip(seen).collect(),
        Marks::Pictures(pictures) => on_table(cx, &state, &pictures).await?,
    };
    let pose = Pose::of_marks(&marks, is_mirrored(cx, &state.args.player));
    wire::keep(cx, &state.store, wire::BOARD, &pose).await
}

/// The markers on the board, and where the cameras see them on the table, on the average.
async fn on_table(
    cx: &Context,
    state: &Transform,
    pictures: &[Marked],
) -> Result<Vec<([f64; 2], [f64; 2])>, HandlerError> {
    train(cx, state).await?;
    let mut all = Vec::new();
    for (nth, corner) in CORNERS.into_iter().enumerate() {
        let mut places = Vec::new();
        for picture in pictures {
            let pixel = picture.markers.get(nth).copied().unwrap_or_default();
            places.push(completed(cx, state, &picture.camera, pixel).await?);
        }
        let count = places.len().max(1) as f64;
        let mean = [0, 1].map(|axis| places.iter().map(|at| at[axis]).sum::<f64>() / count);
        if let Some(far) = places.iter().find(|place| apart(**place, mean) > AGREE_M) {
            let off = 1e3 * apart(*far, mean);
            let text = format!("the cameras see a marker {off:.0} mm apart: has one been moved?");
            return Err(HandlerError::new(text));
        }
        all.push((corner, mean));
    }
    Ok(all)
}

/// Trains the maps, once.
async fn train(cx: &Context, state: &Transform) -> Acted {
    if state.trained.get() {
        return Ok(());
    }
    for map in state.args.maps.values() {
        let object = Served::named(&map.object).map_err(HandlerError::new)?;
        let text = format!("-train {} -params 2", cx.path(&map.known).display());
        object.ask(cx, Method::Ctrl, Transport::text(text)).await?;
    }
    state.trained.set(true);
    Ok(())
}

/// The place on the table that a camera sees in a pixel.
async fn completed(
    cx: &Context,
    state: &Transform,
    camera: &str,
    [u, v]: [f64; 2],
) -> Result<[f64; 2], HandlerError> {
    let map = state.args.maps.get(camera);
    let map = map.ok_or_else(|| HandlerError::new(format!("`maps` has no camera `{camera}`")))?;
    let object = Served::named(&map.object).map_err(HandlerError::new)?;
    let mut body = Transport::text("complete");
    body.floats = vec![u, v, 1.0, 1.0];
    // The pixel of the nearest point of the map, its place, and how far it is.
    let answer = object.ask(cx, Method::Exec, body).await?;
    match answer.floats.as_slice() {
        [_, _, x, y, _] => Ok([*x, *y]),
        _ => Err(HandlerError::new(format!(
            "{object} is no map of the table"
        ))),
    }
}

/// Where the ends of the errand are on the table.
async fn locate(action: Action<Transform>) -> Acted {
    let Transform { store, .. } = state(&action);
    let cx = action.cx();
    let errand: wire::Errand = wire::fetch(cx, &store, wire::ERRAND).await?;
    let pose: Pose = wire::fetch(cx, &store, wire::BOARD).await?;
    wire::keep(cx, &store, wire::POINTS, &errand.ends(&pose)).await
}
