//! The table as people see it on a display: board, discs, hand and arm of the room, and the words that were heard last.

use std::{cell::RefCell, rc::Rc};

use nalgebra::Isometry3;
use scene::{Part, Pose, Said, Seen, Solid, Source, View};

use crate::{
    room::Inner,
    shown::FLOOR_M,
    wire::{BOARD_M, FIELD_M, TABLE_M, centre},
};

/// The table: its middle, and half its edges, m.
const TABLE: [[f64; 3]; 2] = [[0.55, 0.0, 0.5 * TABLE_M], [0.45, 0.8, 0.5 * TABLE_M]];
/// Half the edges of the board and of the hand, and the radius of a disc, m.
const BOARD: [f64; 3] = [0.3, 0.3, 0.5 * BOARD_M];
const HAND: [f64; 3] = [0.055, 0.095, 0.02];
const DISC: f64 = 0.0195;
/// How high above the table the hand of a dry game's arm ends, and how long it is drawn, m.
const FINGERS_M: f64 = 0.06;
const ARM_M: f64 = 0.3;

/// So many squares at a time are shown by the laser. Its beam is so long that a table hides it while it is off, m.
const BEAMS: usize = 4;
const BEAM_M: f64 = 0.17;

const RED: [u8; 3] = [235, 40, 40];
const WOOD: [u8; 3] = [150, 140, 120];
const FIELDS: [u8; 3] = [70, 90, 75];
const SKIN: [u8; 3] = [215, 165, 135];
const STEEL: [u8; 3] = [90, 105, 130];
const LIGHT: [u8; 3] = [235, 205, 70];
const DARK: [u8; 3] = [140, 25, 20];
const GREY: [u8; 3] = [120, 120, 120];

/// The room, as it is looked at.
pub struct Drawn {
    inner: Rc<RefCell<Inner>>,
    view: Option<View>,
}

impl Drawn {
    /// Its parts are told once.
    pub fn new(inner: Rc<RefCell<Inner>>) -> Self {
        let view = Some(view(&inner.borrow()));
        Self { inner, view }
    }
}

impl Source for Drawn {
    fn view(&mut self) -> Option<View> {
        self.view.take()
    }

    fn look(&mut self) -> Seen {
        let inner = &mut *self.inner.borrow_mut();
        inner.drawn.take(&inner.table, 0.0);
        let table = Isometry3::translation(TABLE[0][0], TABLE[0][1], TABLE[0][2]);
        let mut all = vec![table];
        for (name, pose) in inner.drawn.all() {
            // What is away is in the table.
            let shown = if pose.translation.z > FLOOR_M {
                *pose
            } else {
                table
            };
            match name {
                "speck" => {}
                "board" => all.extend([shown, shown]),
                _ => all.push(shown),
            }
        }
        // It waits where it stands.
        let home = Isometry3::translation(0.0, 0.0, TABLE_M);
        let arm = inner.table.arm.map_or(home, |[x, y]| {
            Isometry3::translation(x, y, TABLE_M + FINGERS_M)
        });
        if !inner.is_real() {
            all.push(arm);
        }
        let board = inner.table.board;
        let beams = (0..BEAMS).map(|nth| match inner.laser.get(nth) {
            Some(square) => {
                let [x, y] = board.on_table(centre(*square));
                Isometry3::translation(x, y, TABLE_M + BOARD_M)
            }
            // It is off.
            None => table,
        });
        all.extend(beams);
        let last = inner.table.truth.heard.last();
        Seen {
            states: all.iter().map(|at| (pose(at), Vec::new())).collect(),
            said: Said {
                words: last.cloned().unwrap_or_default(),
                ..Said::default()
            },
            pictures: Vec::new(),
        }
    }
}

/// Table, board, hand and discs, and the arm of a dry game.
fn view(inner: &Inner) -> View {
    let part = |name: &str, kind: &str, solids: Vec<Solid>, colour: [u8; 3]| Part {
        name: name.to_owned(),
        kind: kind.to_owned(),
        solids,
        colour,
        ..Part::default()
    };
    let block = |half: [f64; 3]| Solid::Block {
        pose: Pose::default(),
        half,
    };
    let disc = Solid::Cylinder {
        pose: Pose::default(),
        half: 0.5 * inner.disc_m(),
        radius: DISC,
    };
    let mut parts = vec![part("table", "furniture", vec![block(TABLE[1])], GREY)];
    for (name, _) in inner.drawn.all() {
        if name == "board" {
            parts.push(part(name, "object", vec![block(BOARD)], WOOD));
        }
        parts.push(match name {
            "board" => {
                let fields = fields(inner.table.board.mirrored);
                part("fields", "object", fields, FIELDS)
            }
            "hand" => part(name, "hand", vec![block(HAND)], SKIN),
            "speck" => continue,
            _ if name.starts_with("light") => part(name, "disc", vec![disc.clone()], LIGHT),
            _ => part(name, "disc", vec![disc.clone()], DARK),
        });
    }
    if !inner.is_real() {
        let arm = Solid::Capsule {
            a: [0.0; 3],
            b: [0.0, 0.0, ARM_M],
            radius: 0.015,
        };
        parts.push(part("arm", "arm", vec![arm], STEEL));
    }
    for nth in 1..=BEAMS {
        let beam = Solid::Capsule {
            a: [0.0; 3],
            b: [0.0, 0.0, BEAM_M],
            radius: 0.004,
        };
        let spot = Solid::Cylinder {
            pose: Pose::default(),
            half: 0.5 * inner.disc_m() + 0.008,
            radius: 0.024,
        };
        parts.push(part(
            &format!("laser {nth}"),
            "laser",
            vec![beam, spot],
            RED,
        ));
    }
    View {
        parts,
        ..View::default()
    }
}

/// The dark fields of a board, as it lies.
fn fields(mirrored: bool) -> Vec<Solid> {
    let field = |square: u8| {
        let [x, y] = centre(square);
        let x = if mirrored { -x } else { x };
        Solid::Block {
            pose: Pose {
                at: [x, y, 0.5 * BOARD_M],
                ..Pose::default()
            },
            half: [0.5 * FIELD_M, 0.5 * FIELD_M, 5e-4],
        }
    };
    (0..32).map(field).collect()
}

fn pose(at: &Isometry3<f64>) -> Pose {
    Pose {
        at: at.translation.vector.into(),
        turn: at.rotation.coords.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_dark_corner_is_at_the_left_of_white_and_on_a_mirrored_board_at_the_right() {
        for (mirrored, file) in [(false, -3.5), (true, 3.5)] {
            let fields = fields(mirrored);
            let is_corner = |solid: &Solid| match solid {
                Solid::Block { pose, .. } => {
                    let [x, y, _] = pose.at;
                    (x / FIELD_M - file).abs() < 1e-9 && (y / FIELD_M + 3.5).abs() < 1e-9
                }
                _ => false,
            };
            assert_eq!(fields.len(), 32);
            assert!(fields.iter().any(is_corner));
        }
    }
}
