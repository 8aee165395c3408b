//! The Vision Coordinator of the checkers player: the functions of `nets/checkers/vision.net`, which find the board and read it.

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::wire::{self, Picture, Pose, Reading, See, Situation, apart};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisionArgs {
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
pub struct Vision {
    args: VisionArgs,
    store: DomStore,
}

type Act = Action<Vision>;

impl NetArgs for VisionArgs {
    const HANDLER: &'static str = "checkers.vision";
    type State = Vision;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Vision> {
        Library::new(Vision { args: self, store })
            // Between two requests there is nothing to know.
            .kept(|_| (), |_, ()| ())
            .action("find", find)
            .action("look", look)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
    }
}

fn parts(action: &Act) -> (VisionArgs, DomStore) {
    action.with_state(|state| (state.args.clone(), state.store.clone()))
}

/// A disc so near to the middle of a square stands well, m.
const WELL_M: f64 = 0.008;
/// A disc that is farther from it stands on no square, m.
const OFF_M: f64 = 0.021;
/// Markers that are so far from where they were have been moved, m.
const MOVED_M: f64 = 0.004;

/// Where the markers are (`findBrdMarker` of the report).
async fn find(action: Act) -> Acted {
    let (args, store) = parts(&action);
    let cx = action.cx();
    let picture = wire::ask(cx, &args.room, See { pose: 0 }).await?;
    wire::keep(cx, &store, wire::MARKS, &picture.markers).await
}

/// The situation on the board (`getBrdSit` of the report).
async fn look(action: Act) -> Acted {
    let (args, store) = parts(&action);
    let cx = action.cx();
    let pose: u8 = wire::fetch(cx, &store, wire::GAZE).await?;
    let board: Pose = wire::fetch(cx, &store, wire::BOARD).await?;
    let picture = wire::ask(cx, &args.room, See { pose }).await?;
    wire::keep(cx, &store, wire::SITUATION, &read(&picture, &board)).await
}

/// What a picture says of a board.
#[must_use]
pub fn read(picture: &Picture, board: &Pose) -> Situation {
    let pairs = wire::MARKERS.iter().zip(picture.markers);
    let moved = pairs.map(|(mark, seen)| apart(board.on_table(*mark), seen));
    let moved = moved.fold(0.0, f64::max) > MOVED_M;
    let glare = picture.glare.map(|at| board.on_board(at));
    let dims = |at: [f64; 2]| match glare {
        Some(glare) if apart(glare, at) < wire::FIELD_M / 2.0 => 0.5,
        _ => 1.0,
    };
    let empty = |square: u8| Reading {
        disc: None,
        confidence: dims(wire::centre(square)),
        at: wire::centre(square),
    };
    let mut squares: Vec<Reading> = (0..32).map(empty).collect();
    let mut strays = Vec::new();
    for (hue, at) in &picture.discs {
        if at[1].abs() > wire::ASIDE_M {
            continue;
        }
        let at = board.on_board(*at);
        let near = (0_u8..).zip(&mut squares);
        let near = near.map(|(square, reading)| (apart(wire::centre(square), at), reading));
        match near.min_by(|one, other| one.0.total_cmp(&other.0)) {
            Some((off, reading)) if off < OFF_M && reading.disc.is_none() => {
                let well = 1.0 - ((off - WELL_M) / (OFF_M - WELL_M)).max(0.0);
                reading.disc = Some(*hue);
                reading.confidence *= well;
                reading.at = at;
            }
            _ => strays.push((*hue, at)),
        }
    }
    Situation {
        squares,
        strays,
        hand: picture.hand,
        moved,
    }
}
