//! The Vision Coordinator of the checkers player: the functions of `nets/checkers/vision.net`, which find the board and read it.

use pnt::library::{Acted, Action, Library};

use crate::{
    coordinator::{Functions, InRoom},
    wire::{self, Picture, Pose, Reading, See, Situation, apart},
};

/// The functions.
#[derive(Debug, Clone)]
pub struct Vision;

impl Functions for Vision {
    const HANDLER: &'static str = "checkers.vision";

    fn add(library: Library<InRoom>) -> Library<InRoom> {
        library.action("find", find).action("look", look)
    }
}

/// A disc so near to the middle of a square stands well, m.
const WELL_M: f64 = 0.008;
/// A disc that is farther from it stands on no square, m.
const OFF_M: f64 = 0.021;
/// Markers that are so far from where they were have been moved, m.
const MOVED_M: f64 = 0.004;

/// Where the markers are (`findBrdMarker` of the report).
async fn find(action: Action<InRoom>) -> Acted {
    let InRoom { store, room } = InRoom::of(&action);
    let cx = action.cx();
    let picture = wire::ask(cx, &room, See { pose: 0 }).await?;
    wire::keep(cx, &store, wire::MARKS, &picture.markers).await
}

/// The situation on the board (`getBrdSit` of the report).
async fn look(action: Action<InRoom>) -> Acted {
    let InRoom { store, room } = InRoom::of(&action);
    let cx = action.cx();
    let pose: u8 = wire::fetch(cx, &store, wire::GAZE).await?;
    let board: Pose = wire::fetch(cx, &store, wire::BOARD).await?;
    let picture = wire::ask(cx, &room, See { pose }).await?;
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
