//! The table before cameras: where the bodies of a world are to be, and whether what was read of pictures is so. In a dry game nothing
//! moves there by itself; where arm and hand are real, the table is read from the world. Knows no task.

use std::f64::consts::FRAC_PI_2;

use mcs_hand::command::Body;
use nalgebra::{Isometry3, Matrix4, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::{
    table::{Stack, Table, table_at},
    wire::{BOARD_M, Hue, Looked, Looks, Pose, SURE, TABLE_M, apart, centre, disc_m},
};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShownArgs {
    /// The task that owns the bodies `board`, `hand`, `speck`, `light1` to `light24` and `dark1` to `dark24`.
    pub world: String,
    /// Where the first camera is, m: what it does not see well is something small before it.
    eye: [f64; 3],
    /// Whether arm and hand are real, and move what is there.
    #[serde(default)]
    pub real: bool,
    /// How high a disc is, m.
    #[serde(default = "disc_m")]
    pub disc_m: f64,
    /// Which links of a real hand hold discs, by the beginnings of their names: what presses on others makes a game untrue.
    #[serde(default = "holding")]
    pub holding: Vec<String>,
    /// The client interface of a real arm: somebody may stop it, and switch it on.
    #[serde(default = "mcs")]
    pub mcs: String,
}

fn holding() -> Vec<String> {
    vec!["jaw".to_owned()]
}

fn mcs() -> String {
    "mcs".to_owned()
}

/// Whether a body is a disc, by its name.
#[must_use]
pub fn is_disc(name: &str) -> bool {
    ["light", "dark"].iter().any(|word| name.starts_with(word))
}

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

/// A body so near to where a disc should be is that disc, m; and discs so near to one another are a stack.
const SAME_M: f64 = 0.012;

/// What is lower lies on the floor, m.
pub const FLOOR_M: f64 = 0.38;

/// A body, and where it is.
#[derive(Debug, Clone)]
struct Placed {
    name: String,
    pose: Isometry3<f64>,
}

/// What cameras see of a table.
pub struct Shown {
    pub args: ShownArgs,
    /// The board, the hand, the speck, and the discs.
    bodies: Vec<Placed>,
    /// When something was changed last, s, and how many changes are still on their way.
    changed: f64,
    changing: u32,
    /// Where stacks stood in the table's frame when the table was taken or read last.
    stood: Vec<[f64; 2]>,
    /// Until when a speck hides a square, s.
    speck: Option<(f64, u8)>,
    pub looks: Looks,
    /// How light it was made in the world.
    pub lit: f64,
}

fn at([x, y]: [f64; 2], z: f64, yaw: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}

/// On the floor, out of sight.
fn hidden(nth: usize) -> Isometry3<f64> {
    at([-2.0, 0.1 * nth as f64], 0.05, 0.0)
}

/// How the body is turned whose dark corner is then at White's right, rad.
fn quarter(board: &Pose) -> f64 {
    if board.mirrored { FRAC_PI_2 } else { 0.0 }
}

/// The bodies before the discs.
const BOARD: usize = 0;
const HAND: usize = 1;
const SPECK: usize = 2;
const FIRST: usize = 3;

impl Shown {
    /// A table that people look at, and no camera, with discs so high, m.
    #[must_use]
    pub fn for_people(disc_m: f64) -> Self {
        Self::new(ShownArgs {
            world: String::new(),
            eye: [0.0; 3],
            real: false,
            disc_m,
            holding: holding(),
            mcs: mcs(),
        })
    }

    /// Nothing is shown yet.
    #[must_use]
    pub fn new(args: ShownArgs) -> Self {
        let discs = ["light", "dark"].into_iter();
        let discs = discs.flat_map(|word| (1..=DISCS).map(move |nth| format!("{word}{nth}")));
        let names = ["board", "hand", "speck"].map(str::to_owned);
        let bodies = names.into_iter().chain(discs).enumerate();
        let bodies = bodies.map(|(nth, name)| Placed {
            name,
            pose: hidden(nth),
        });
        Self {
            args,
            bodies: bodies.collect(),
            changed: f64::INFINITY,
            changing: 0,
            stood: Vec::new(),
            speck: None,
            looks: Looks::default(),
            lit: 1.0,
        }
    }

    /// A speck comes before the first camera, and hides a square for a while.
    pub fn hide(&mut self, square: u8, now: f64) {
        self.speck.get_or_insert((now + SPECK_S, square));
    }

    /// Takes the table as it is now; the bodies that are to be put elsewhere.
    pub fn take(&mut self, table: &Table, now: f64) -> Vec<usize> {
        self.speck = self.speck.filter(|(until, _)| *until > now);
        let mut moved = Vec::new();
        let lies = table.board.yaw + quarter(&table.board);
        let board = at(table.board.at, TABLE_M + 0.5 * BOARD_M, lies);
        self.put(BOARD, board, &mut moved);
        for hue in [Hue::Light, Hue::Dark] {
            self.take_discs(table, hue, &mut moved);
        }
        self.stood = stood(table);
        self.put(HAND, hand(table), &mut moved);
        self.put(SPECK, self.speck_at(&table.board), &mut moved);
        if !moved.is_empty() {
            self.changed = f64::INFINITY;
            self.changing += 1;
        }
        moved
    }

    /// A body is to be there, if it is not there already.
    fn put(&mut self, nth: usize, pose: Isometry3<f64>, moved: &mut Vec<usize>) {
        let Some(body) = self.bodies.get_mut(nth) else {
            return;
        };
        // What stands on a table in truth is never quite level.
        let least = if self.args.real { 2e-3 } else { 1e-6 };
        let off = body.pose.inverse() * pose;
        if off.translation.vector.norm() > least || off.rotation.angle() > 2.0 * least {
            body.pose = pose;
            moved.push(nth);
        }
    }

    /// Which of these bodies is the nearest to a pose, by its place among them, and how far it is, m.
    fn nearest(&self, free: &[usize], pose: &Isometry3<f64>) -> Option<(usize, f64)> {
        let far = |nth: &usize| {
            let body = self.bodies.get(*nth);
            body.map_or(f64::INFINITY, |body| {
                (body.pose.translation.vector - pose.translation.vector).norm()
            })
        };
        let all = free.iter().map(far).enumerate();
        all.min_by(|one, other| one.1.total_cmp(&other.1))
    }

    /// What nobody touched stays as it stands.
    fn take_discs(&mut self, table: &Table, hue: Hue, moved: &mut Vec<usize>) {
        let first = FIRST + DISCS * usize::from(hue == Hue::Dark);
        let mut free: Vec<usize> = (first..first + DISCS).collect();
        let mut missing = Vec::new();
        for pose in places(table, hue, self.args.disc_m) {
            let at = [pose.translation.x, pose.translation.y];
            let untouched = self.stood.iter().any(|stood| apart(*stood, at) < 1e-6);
            let near = match self.args.real && untouched {
                true => SAME_M,
                false => 1e-6,
            };
            // The nearest: in a stack others are about as near.
            match self.nearest(&free, &pose) {
                // It stands as it stands.
                Some((place, off)) if off < near => drop(free.swap_remove(place)),
                _ => missing.push(pose),
            }
        }
        for pose in missing {
            if let Some((place, _)) = self.nearest(&free, &pose) {
                let nth = free.swap_remove(place);
                self.put(nth, pose, moved);
            }
        }
        for nth in free {
            let body = self.bodies.get(nth);
            if body.is_some_and(|body| body.pose.translation.z > FLOOR_M) {
                self.put(nth, hidden(nth), moved);
            }
        }
    }

    fn speck_at(&self, board: &Pose) -> Isometry3<f64> {
        let Some((_, square)) = self.speck else {
            return hidden(SPECK);
        };
        let eye = Vector3::from(self.args.eye);
        let [x, y] = board.on_table(centre(square));
        let way = (Vector3::new(x, y, TABLE_M + BOARD_M) - eye).normalize();
        Isometry3::from_parts((eye + way * SPECK_M).into(), UnitQuaternion::identity())
    }

    /// The names of all bodies, and where they are to be.
    pub fn all(&self) -> impl Iterator<Item = (&str, &Isometry3<f64>)> {
        let bodies = self.bodies.iter();
        bodies.map(|body| (body.name.as_str(), &body.pose))
    }

    /// Where a body is to be.
    #[must_use]
    pub fn body(&self, nth: usize) -> Option<(String, Isometry3<f64>)> {
        let body = self.bodies.get(nth)?;
        Some((body.name.clone(), body.pose))
    }

    /// The bodies that were to be put elsewhere are there.
    pub fn is_shown(&mut self, now: f64) {
        self.changing -= 1;
        if self.changing == 0 {
            self.changed = now;
        }
    }

    /// The table becomes what arm and hand have made of it.
    pub fn read(&mut self, table: &mut Table, bodies: &[Body], now: f64) {
        for known in &mut self.bodies {
            let body = bodies.iter().find(|body| body.name == known.name);
            let pose = body.map(|body| Matrix4::from_row_slice(&body.world_t_body));
            if let Some(pose) = pose.and_then(nalgebra::try_convert::<_, Isometry3<f64>>) {
                known.pose = pose;
            }
        }
        if let Some(board) = self.bodies.get(BOARD) {
            let pose = board.pose;
            table.board = Pose {
                at: [pose.translation.x, pose.translation.y],
                yaw: pose.rotation.euler_angles().2 - quarter(&table.board),
                mirrored: table.board.mirrored,
            };
        }
        let hues = |nth: usize| if nth < DISCS { Hue::Light } else { Hue::Dark };
        let discs = self.bodies.iter().skip(FIRST).enumerate();
        let mut discs: Vec<(Hue, Vector3<f64>)> = discs
            .map(|(nth, body)| (hues(nth), body.pose.translation.vector))
            .collect();
        discs.sort_by(|one, other| one.1.z.total_cmp(&other.1.z));
        table.stacks.clear();
        table.away.clear();
        for (hue, place) in discs {
            if place.z < FLOOR_M {
                table.away.push(hue);
                continue;
            }
            let on_board = place.z > TABLE_M + 0.75 * BOARD_M;
            let xy = [place.x, place.y];
            let board = table.board;
            let mut stacks = table.stacks.iter_mut();
            // A stack beside the board may be higher than the board.
            match stacks.find(|stack| apart(table_at(stack, &board), xy) < SAME_M) {
                Some(stack) => stack.discs.push(hue),
                None => table.stacks.push(Stack {
                    on_board,
                    at: if on_board { board.on_board(xy) } else { xy },
                    discs: vec![hue],
                }),
            }
        }
        self.stood = stood(table);
        self.changed = now;
    }

    /// Holds what was read of a picture against the table, if nothing was changed since.
    pub fn judge(&mut self, table: &Table, looked: &Looked) {
        if (looked.stamp_ns as f64) < self.changed * 1e9 {
            return;
        }
        let seen = &looked.situation;
        let (mut wrong, mut unsure) = (false, seen.hand);
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
        // A hand that is not known as one makes unsure what is under its middle. Else it was overlooked.
        let [x, y, _] = HAND_AT;
        let far = |square: u8| apart(centre(square), [x, y]);
        let under = (0..32).min_by(|one, other| far(*one).total_cmp(&far(*other)));
        let under = under.and_then(|square| seen.squares.get(usize::from(square)));
        let is_sure = under.is_some_and(|reading| reading.confidence >= SURE);
        wrong |= table.hand && !seen.hand && is_sure;
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

/// Where a hand comes over the board, in the table's frame.
#[must_use]
pub fn hand_at(table: &Table) -> [f64; 2] {
    let [x, y, _] = HAND_AT;
    table.board.on_table([x, y])
}

/// Where a hand is over the board, if there is one.
fn hand(table: &Table) -> Isometry3<f64> {
    let [.., z] = HAND_AT;
    match table.hand {
        true => at(hand_at(table), TABLE_M + BOARD_M + z, table.board.yaw),
        false => hidden(HAND),
    }
}

/// Where stacks stand in the table's frame, m.
fn stood(table: &Table) -> Vec<[f64; 2]> {
    let stacks = table.stacks.iter();
    stacks.map(|stack| table_at(stack, &table.board)).collect()
}

/// Where the discs of a colour are to be.
fn places(table: &Table, hue: Hue, disc_m: f64) -> Vec<Isometry3<f64>> {
    let mut all = Vec::new();
    for stack in &table.stacks {
        let floor = TABLE_M + if stack.on_board { BOARD_M } else { 0.0 };
        let heights = stack.discs.iter().enumerate();
        let own = heights.filter(|(_, other)| **other == hue);
        all.extend(own.map(|(height, _)| {
            let z = floor + disc_m * (height as f64 + 0.5);
            at(table_at(stack, &table.board), z, 0.0)
        }));
    }
    all
}

#[cfg(test)]
mod tests {
    use checkers::{Colour, Position};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::{
        table::Chances,
        wire::{Reading, Situation},
    };

    fn table() -> Table {
        Table::new(
            Chances::default(),
            Position::start(Colour::White),
            ChaCha8Rng::seed_from_u64(1),
        )
    }

    fn shown(real: bool) -> Shown {
        Shown::new(ShownArgs {
            world: "world".to_owned(),
            eye: [0.5, -0.25, 2.1],
            real,
            disc_m: disc_m(),
            holding: holding(),
            mcs: mcs(),
        })
    }

    /// What a world tells whose bodies are where they were put.
    fn told(shown: &Shown) -> Vec<Body> {
        let bodies = shown.bodies.iter().map(|body| {
            let matrix = body.pose.to_homogeneous().transpose();
            Body {
                name: body.name.clone(),
                world_t_body: matrix.as_slice().try_into().unwrap(),
            }
        });
        bodies.collect()
    }

    #[test]
    fn only_what_has_moved_is_put_elsewhere() {
        for real in [false, true] {
            let (mut table, mut shown) = (table(), shown(real));
            // The board and 24 discs of each colour; nothing else is in sight.
            assert_eq!(shown.take(&table, 0.0).len(), 49);
            shown.is_shown(0.1);
            assert!(shown.take(&table, 1.0).is_empty());
            let at = table.on(20).unwrap();
            table.stacks[at].at = centre(16);
            let moved = shown.take(&table, 2.0);
            assert_eq!(moved.len(), 1);
            let (name, pose) = shown.body(moved[0]).unwrap();
            assert!(name.starts_with("light"), "{name}");
            let [x, y] = table.board.on_table(centre(16));
            assert!((pose.translation.vector - Vector3::new(x, y, 0.425)).norm() < 1e-9);
        }
    }

    #[test]
    fn a_table_that_was_shown_is_read_again_as_it_was_with_kings_and_what_fell_down() {
        let (mut table, mut shown) = (table(), shown(true));
        let at = table.on(20).unwrap();
        table.stacks[at].discs.push(Hue::Light);
        let spare = table
            .stacks
            .iter()
            .position(|stack| !stack.on_board && stack.discs[0] == Hue::Light);
        table.stacks[spare.unwrap()].discs.pop();
        shown.take(&table, 0.0);
        let (before, mut bodies) = (table.squares(), told(&shown));
        table.stacks.clear();
        shown.read(&mut table, &bodies, 1.0);
        assert_eq!(table.squares(), before);
        assert_eq!(before[2], 1 << 20, "a king");
        assert_eq!(table.truth().discs, [24, 24]);
        assert!(table.away.is_empty());
        let dark = bodies.iter_mut().find(|body| body.name == "dark3").unwrap();
        dark.world_t_body[11] = 0.005;
        shown.read(&mut table, &bodies, 2.0);
        assert_eq!(
            (table.away.as_slice(), table.truth().discs),
            (&[Hue::Dark][..], [24, 24])
        );
    }

    #[test]
    fn what_a_person_puts_straight_by_a_few_mm_is_moved_and_what_nobody_touched_is_not() {
        let (mut table, mut shown) = (table(), shown(true));
        let at = table.on(20).unwrap();
        table.stacks[at].discs.push(Hue::Light);
        shown.take(&table, 0.0);
        let mut bodies = told(&shown);
        // A man stands 9 mm aside, and the upper disc of the king on 20 so on the lower one.
        let mut aside = |square: u8, above: bool| {
            let [x, y] = table.board.on_table(centre(square));
            let body = bodies.iter_mut().find(|body| {
                let [at_x, at_y, at_z] = [3, 7, 11].map(|at| body.world_t_body[at]);
                is_disc(&body.name) && apart([at_x, at_y], [x, y]) < 1e-6 && (at_z > 0.43) == above
            });
            body.unwrap().world_t_body[3] += 0.009;
        };
        aside(21, false);
        aside(20, true);
        shown.read(&mut table, &bodies, 1.0);
        assert!(shown.take(&table, 2.0).is_empty());
        table.straighten(&[21]);
        let moved = shown.take(&table, 3.0);
        assert_eq!(moved.len(), 1);
        let [x, y] = table.board.on_table(centre(21));
        let (_, pose) = shown.body(moved[0]).unwrap();
        assert!((pose.translation.vector - Vector3::new(x, y, 0.425)).norm() < 1e-9);
    }

    /// A table as it is, read surely; no hand is seen.
    fn read_of(table: &Table) -> Situation {
        let reading = |square: u8| {
            let stack = table.on(square).and_then(|at| table.stacks.get(at));
            Reading {
                disc: stack.and_then(|stack| stack.discs.last().copied()),
                confidence: 1.0,
                at: centre(square),
            }
        };
        Situation {
            squares: (0..32).map(reading).collect(),
            strays: Vec::new(),
            hand: false,
            moved: false,
        }
    }

    #[test]
    fn a_look_is_right_unsure_or_wrong_and_none_that_is_older_than_the_table() {
        let (table, mut shown) = (table(), shown(false));
        shown.take(&table, 0.0);
        let right = Looked {
            stamp_ns: 2_000_000_000,
            situation: read_of(&table),
        };
        shown.judge(&table, &right);
        shown.is_shown(1.0);
        let mut old = right.clone();
        old.stamp_ns = 900_000_000;
        shown.judge(&table, &old);
        assert_eq!(shown.looks, Looks::default());
        let (mut unsure, mut wrong) = (right.clone(), right.clone());
        unsure.situation.squares[3].disc = None;
        unsure.situation.squares[3].confidence = 0.5;
        wrong.situation.squares[3].disc = None;
        for look in [&right, &right, &unsure, &wrong] {
            shown.judge(&table, look);
        }
        let Looks {
            right,
            unsure,
            wrong,
        } = shown.looks;
        assert_eq!((right, unsure, wrong), (2, 1, 1));
    }

    #[test]
    fn a_hand_that_is_not_known_as_one_is_an_error_unless_the_square_under_it_is_unsure() {
        let (mut table, mut shown) = (table(), shown(false));
        table.hand = true;
        shown.take(&table, 0.0);
        shown.is_shown(1.0);
        let mut looked = Looked {
            stamp_ns: 2_000_000_000,
            situation: read_of(&table),
        };
        shown.judge(&table, &looked);
        // That another one is unsure is no excuse.
        looked.situation.squares[1].confidence = 0.0;
        shown.judge(&table, &looked);
        assert_eq!((shown.looks.wrong, shown.looks.unsure), (2, 0));
        looked.situation.squares[22].confidence = 0.0;
        shown.judge(&table, &looked);
        assert_eq!((shown.looks.wrong, shown.looks.unsure), (2, 1));
    }
}
