//! What a picture of a dry game says of a board.

use crate::{
    vision::{MOVED_M, OFF_M, well},
    wire::{self, Picture, Pose, Reading, Situation, apart},
};

/// Where it is less light than this, nothing is seen surely.
const LIGHT: f64 = 0.4;

/// What a picture says of a board.
#[must_use]
pub fn read(picture: &Picture, board: &Pose) -> Situation {
    let pairs = wire::MARKERS.iter().zip(picture.markers);
    let moved = pairs.map(|(mark, seen)| apart(board.on_table(*mark), seen));
    let moved = moved.fold(0.0, f64::max) > MOVED_M;
    let glare = picture.glare.map(|at| board.on_board(at));
    let light = (picture.light / LIGHT).clamp(0.0, 1.0);
    let dims = |at: [f64; 2]| match glare {
        Some(glare) if apart(glare, at) < wire::FIELD_M / 2.0 => 0.5 * light,
        _ => light,
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
                reading.disc = Some(*hue);
                reading.confidence *= well(off);
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
