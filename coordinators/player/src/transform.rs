//! The Transform Coordinator of the checkers player: the functions of `nets/checkers/transform.net`, which bring together places on the board and on the table.

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::wire;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransformArgs {
    /// The data object manager.
    #[serde(default = "dom")]
    dom: String,
    /// The task of the room.
    #[serde(default = "room")]
    room: String,
}

fn dom() -> String {
    "dom".to_owned()
}

fn room() -> String {
    "room".to_owned()
}

/// What the functions share.
pub struct Transform {
    args: TransformArgs,
    store: DomStore,
}

type Act = Action<Transform>;

impl NetArgs for TransformArgs {
    const HANDLER: &'static str = "checkers.transform";
    type State = Transform;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Transform> {
        Library::new(Transform { args: self, store })
            // Between two requests there is nothing to know.
            .kept(|_| (), |_, ()| ())
            .action("adapt", adapt)
            .action("locate", locate)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
    }
}

fn parts(action: &Act) -> (TransformArgs, DomStore) {
    action.with_state(|state| (state.args.clone(), state.store.clone()))
}

/// Where the board is, by its markers.
async fn adapt(action: Act) -> Acted {
    let (_, store) = parts(&action);
    let marks: [[f64; 2]; 2] = wire::fetch(action.cx(), &store, wire::MARKS).await?;
    let pose = wire::Pose::of_markers(marks);
    wire::keep(action.cx(), &store, wire::BOARD, &pose).await
}

/// Where the ends of the errand are on the table.
async fn locate(action: Act) -> Acted {
    let (_, store) = parts(&action);
    let cx = action.cx();
    let errand: wire::Errand = wire::fetch(cx, &store, wire::ERRAND).await?;
    let pose: wire::Pose = wire::fetch(cx, &store, wire::BOARD).await?;
    let points = [errand.from.on_table(&pose), errand.to.on_table(&pose)];
    wire::keep(cx, &store, wire::POINTS, &points).await
}
