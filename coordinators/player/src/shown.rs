//! The table of a dry game before cameras: where the bodies of a world in which nothing moves by itself are to be, and whether what was
//! read of pictures is so. Knows no task.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::{
    table::{Table, table_at},
    wire::{Hue, Looked, Looks, SURE, apart, centre},
};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShownArgs {
    /// The task that owns the bodies `board`, `hand`, `speck`, `light1` to `light24` and `dark1` to `dark24`.
    pub world: String,
    /// Where the first camera is, m: what it does not see well is something small before it.
    eye: [f64; 3],
}

/// How high the table is, the board on it, and a disc, m.
const TABLE_M: f64 = 0.4;
const BOARD_M: f64 = 0.02;
const DISC_M: f64 = 0.01;

/// Discs of each colour.
const DISCS: usize = 24;

/// Where the middle of a hand is over the board, in its frame, m.
const HAND_AT: [f64; 3] = [0.03, -0.08, 0.1];

/// How far a speck is before the camera, m, and how long it is there, s.
const SPECK_M: f64 = 0.15;
const SPECK_S: f64 = 3.0;

/// A disc nearer than this to the middle of a square stands on it; one farther than that does not touch it, m.
const ON_M: f64 = 0.015;
const BESIDE_M: f64 = 0.052;

/// What cameras see of a table.
pub struct Shown {
    pub args: ShownArgs,
    /// Where each body is.
    bodies: Vec<(String, Isometry3<f64>)>,
    /// When something was changed last, s, and how many changes are still on their way.
    changed: f64,
    changing: u32,
    /// Until when a speck hides a square, s.
    speck: Option<(f64, u8)>,
    pub looks: Looks,
}

fn at([x, y]: [f64; 2], z: f64, yaw: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}

/// On the floor, out of sight.
fn hidden(nth: usize) -> Isometry3<f64> {
    at([-2.0, 0.1 * nth as f64], 0.05, 0.0)
}

impl Shown {
    /// Nothing is shown yet.
    #[must_use]
    pub fn new(args: ShownArgs) -> Self {
        Self {
            args,
            bodies: Vec::new(),
            changed: f64::INFINITY,
            changing: 0,
            speck: None,
            looks: Looks::default(),
        }
    }

    /// A speck comes before the first camera, and hides a square for a while.
    pub fn hide(&mut self, square: u8, now: f64) {
        self.speck.get_or_insert((now + SPECK_S, square));
    }

    /// Takes the table as it is now; the bodies that are to be put elsewhere.
    pub fn take(&mut self, table: &Table, now: f64) -> Vec<usize> {
        self.speck = self.speck.filter(|(until, _)| *until > now);
        let bodies = self.wanted(table);
        let moved = |nth: &usize| self.bodies.get(*nth) != bodies.get(*nth);
        let moved: Vec<usize> = (0..bodies.len()).filter(moved).collect();
        if !moved.is_empty() {
            self.changed = f64::INFINITY;
            self.changing += 1;
        }
        self.bodies = bodies;
        moved
    }

    /// Where a body is to be.
    #[must_use]
    pub fn body(&self, nth: usize) -> Option<(String, Isometry3<f64>)> {
        self.bodies.get(nth).cloned()
    }

    /// The bodies that were to be put elsewhere are there.
    pub fn is_shown(&mut self, now: f64) {
        self.changing -= 1;
        if self.changing == 0 {
            self.changed = now;
        }
    }

    fn wanted(&self, table: &Table) -> Vec<(String, Isometry3<f64>)> {
        let board = table.board;
        let surface = TABLE_M + BOARD_M;
        let hand = board.on_table([HAND_AT[0], HAND_AT[1]]);
        let hand = match table.hand {
            true => at(hand, surface + HAND_AT[2], board.yaw),
            false => hidden(0),
        };
        let speck = match self.speck {
            Some((_, square)) => {
                let eye = Vector3::from(self.args.eye);
                let [x, y] = board.on_table(centre(square));
                let way = (Vector3::new(x, y, surface) - eye).normalize();
                Isometry3::from_parts((eye + way * SPECK_M).into(), UnitQuaternion::identity())
            }
            None => hidden(1),
        };
        let mut all = vec![
            (
                "board".to_owned(),
                at(board.at, TABLE_M + 0.5 * BOARD_M, board.yaw),
            ),
            ("hand".to_owned(), hand),
            ("speck".to_owned(), speck),
        ];
        let mut counts = [0; 2];
        for stack in &table.stacks {
            let floor = if stack.on_board { surface } else { TABLE_M };
            for (height, hue) in stack.discs.iter().enumerate() {
                let z = floor + DISC_M * (height as f64 + 0.5);
                let pose = at(table_at(stack, &board), z, 0.0);
                all.push((name(*hue, &mut counts), pose));
            }
        }
        for hue in [Hue::Light, Hue::Dark] {
            // In the hand, or nowhere to be seen.
            while counts[place(hue)] < DISCS {
                let nth = 2 + all.len();
                all.push((name(hue, &mut counts), hidden(nth)));
            }
        }
        // By name, so that what has not moved is found again.
        all.sort_by(|one, other| one.0.cmp(&other.0));
        all
    }

    /// Holds what was read of a picture against the table, if nothing was changed since.
    pub fn judge(&mut self, table: &Table, looked: &Looked) {
        if (looked.stamp_ns as f64) < self.changed * 1e9 {
            return;
        }
        let seen = &looked.situation;
        let (mut wrong, mut unsure) = (table.hand && !seen.hand, seen.hand);
        for (square, reading) in (0_u8..).zip(&seen.squares) {
            let sure = reading.confidence >= SURE;
            unsure |= !sure;
            let stacks = table.stacks.iter().filter(|stack| stack.on_board);
            let far = |at: [f64; 2]| apart(at, centre(square));
            let nearest = stacks.min_by(|one, other| far(one.at).total_cmp(&far(other.at)));
            let truth = match nearest {
                Some(stack) if far(stack.at) <= ON_M => stack.discs.last().copied(),
                // Across squares: either is right.
                Some(stack) if far(stack.at) < BESIDE_M => continue,
                _ => None,
            };
            wrong |= sure && !seen.hand && reading.disc != truth;
        }
        let count = match (wrong, unsure) {
            (true, _) => &mut self.looks.wrong,
            (_, true) => &mut self.looks.unsure,
            _ => &mut self.looks.right,
        };
        *count += 1;
        if wrong {
            tracing::warn!(?seen, truth = ?table.squares(), "a board was read wrongly");
        }
    }
}

fn place(hue: Hue) -> usize {
    usize::from(hue == Hue::Dark)
}

/// The next body of a colour.
fn name(hue: Hue, counts: &mut [usize; 2]) -> String {
    let count = &mut counts[place(hue)];
    *count += 1;
    let word = if hue == Hue::Light { "light" } else { "dark" };
    format!("{word}{count}")
}
