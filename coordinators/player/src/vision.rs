//! The Vision Coordinator of the checkers player: the functions of `nets/checkers/vision.net`, which find the board and read it.
//!
//! In a dry game the room says what a picture shows ([`dry`]). Where cameras are named, VSS finds the board in their pictures and
//! reads it ([`seen`]).

mod dry;
mod seen;

use std::{cell::Cell, rc::Rc};

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::wire::{self, Gaze, Marks, Pose};
use seen::SeenArgs;

/// A disc so near to the middle of a square stands well, m.
const WELL_M: f64 = 0.008;
/// A disc that is farther from it stands on no square, m.
const OFF_M: f64 = 0.021;
/// Markers that are so far from where they were have been moved, m.
const MOVED_M: f64 = 0.004;

/// How surely a disc stands on a square, so far from its middle.
fn well(off: f64) -> f64 {
    1.0 - ((off - WELL_M) / (OFF_M - WELL_M)).max(0.0)
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisionArgs {
    /// The data object manager.
    #[serde(default = "crate::coordinator::dom")]
    dom: String,
    /// The task of the room.
    #[serde(default = "crate::coordinator::room")]
    room: String,
    /// The task whose arguments say what is played.
    #[serde(default = "crate::room::player")]
    player: String,
    /// The cameras, and who reads their pictures; the room itself says what there is to see without it.
    seen: Option<SeenArgs>,
}

/// What the functions share.
#[derive(Clone)]
pub struct Vision {
    args: Rc<VisionArgs>,
    store: DomStore,
    /// Whether colours are trained. Their daemon lives as long as this process.
    trained: Rc<Cell<bool>>,
    /// Looks so far.
    looks: Rc<Cell<u64>>,
}

impl NetArgs for VisionArgs {
    const HANDLER: &'static str = "checkers.vision";
    type State = Vision;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Vision> {
        let state = Vision {
            args: Rc::new(self),
            store,
            trained: Rc::default(),
            looks: Rc::default(),
        };
        // Between two requests there is nothing to know.
        let library = Library::new(state).kept(|_| (), |_, ()| ());
        library.action("find", find).action("look", look)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
        coordinators::need_task(task, app, "player", &self.player, findings);
        if let Some(seen) = &self.seen {
            seen.check(task, app, findings);
        }
    }
}

fn state(action: &Action<Vision>) -> Vision {
    action.with_state(|state| state.clone())
}

/// Where the markers are (`findBrdMarker` of the report).
async fn find(action: Action<Vision>) -> Acted {
    let state = state(&action);
    let cx = action.cx();
    let marks = match &state.args.seen {
        Some(seen) => Marks::Pictures(seen::find(cx, &state, seen).await?),
        None => {
            let picture = wire::ask(cx, &state.args.room, wire::See { pose: 0 }).await?;
            Marks::Table(picture.markers)
        }
    };
    wire::keep(cx, &state.store, wire::MARKS, &marks).await
}

/// The situation on the board (`getBrdSit` of the report).
async fn look(action: Action<Vision>) -> Acted {
    let state = state(&action);
    let cx = action.cx();
    let gaze: Gaze = wire::fetch(cx, &state.store, wire::GAZE).await?;
    let situation = match &state.args.seen {
        Some(seen) => seen::look(cx, &state, seen, gaze).await?,
        None => {
            let board: Pose = wire::fetch(cx, &state.store, wire::BOARD).await?;
            let pose = gaze.pose;
            let picture = wire::ask(cx, &state.args.room, wire::See { pose }).await?;
            dry::read(&picture, &board)
        }
    };
    wire::keep(cx, &state.store, wire::SITUATION, &situation).await
}
