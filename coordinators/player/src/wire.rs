//! What the parts of the player exchange: requests to the room, and data objects by name and type. Lengths are in m, angles in rad.
//!
//! The board's frame has its origin in the middle, x along White's row, and y from White to Black; the table's frame is the arm's.

use std::{collections::BTreeMap, time::Duration};

use checkers::Colour;
use coordinators::{
    dom::DomStore,
    outcome::{Failure, Outcome},
};
use ctos::{
    config::TaskConfig,
    diagnostic::{Finding, Findings},
    task::{Context, HandlerError},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Side of a field, m.
pub const FIELD_M: f64 = 0.06;

/// How high the table is, and the board on it, m.
pub const TABLE_M: f64 = 0.4;
pub const BOARD_M: f64 = 0.02;

/// How high a disc is when nothing else is said, and at most: two of them, a king, are held below a palm, m.
pub const fn disc_m() -> f64 {
    0.01
}
const HIGHEST_M: f64 = 0.02;

/// A finding when a disc of `task`'s arguments is not as high as one may be.
pub fn check_disc_m(task: &TaskConfig, key: &str, disc_m: f64, findings: &mut Findings) {
    if !(0.002..=HIGHEST_M).contains(&disc_m) {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        let text = format!("`{key}` is {disc_m}");
        let finding = Finding::error("checkers::player::args", text).at(place);
        findings.push(finding.help("give from 0.002 to 0.02 m, as the cell has it"));
    }
}

/// The colour of a disc.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Hue {
    /// White's.
    Light,
    /// Black's.
    Dark,
}

impl Hue {
    /// The discs of a side.
    #[must_use]
    pub const fn of(colour: Colour) -> Self {
        match colour {
            Colour::White => Self::Light,
            Colour::Black => Self::Dark,
        }
    }

    /// Whose discs these are.
    #[must_use]
    pub const fn colour(self) -> Colour {
        match self {
            Self::Light => Colour::White,
            Self::Dark => Colour::Black,
        }
    }
}

/// The middle of a square in the board's frame.
#[must_use]
pub fn centre(square: u8) -> [f64; 2] {
    let (row, column) = (square / 4, square % 4);
    let file = 2 * column + u8::from(row.is_multiple_of(2));
    let along = |number: u8| (f64::from(number) - 3.5) * FIELD_M;
    [along(file), along(7 - row)]
}

/// How far apart two places are, m.
#[must_use]
pub fn apart(one: [f64; 2], other: [f64; 2]) -> f64 {
    (one[0] - other[0]).hypot(one[1] - other[1])
}

/// The markers of the board of a dry game in its own frame: the middles of its left and right border.
pub const MARKERS: [[f64; 2]; 2] = [[-0.26, 0.0], [0.26, 0.0]];

/// Those of a board that cameras see: on the corners of its border, beside a1, h1, h8 and a8.
pub const CORNERS: [[f64; 2]; 4] = [[-0.27, -0.27], [0.27, -0.27], [0.27, 0.27], [-0.27, 0.27]];

/// A disc that is seen less surely is unknown.
pub const SURE: f64 = 0.8;

/// Where the board lies on the table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Its middle.
    pub at: [f64; 2],
    /// How it is turned.
    pub yaw: f64,
    /// Whether its dark corner is at White's right: its frame is then a mirrored one, x from right to left.
    pub mirrored: bool,
}

impl Pose {
    /// The pose by which marks, whose places on the board are known, are where they are seen on the table (least squares).
    #[must_use]
    pub fn of_marks(marks: &[([f64; 2], [f64; 2])], mirrored: bool) -> Self {
        let flipped = |[x, y]: [f64; 2]| [if mirrored { -x } else { x }, y];
        let marks: Vec<_> = marks
            .iter()
            .map(|(from, to)| (flipped(*from), *to))
            .collect();
        let count = marks.len().max(1) as f64;
        let (mut on_board, mut on_table) = ([0.0; 2], [0.0; 2]);
        for (from, to) in &marks {
            for axis in 0..2 {
                on_board[axis] += from[axis] / count;
                on_table[axis] += to[axis] / count;
            }
        }
        let (mut cosine, mut sine) = (0.0, 0.0);
        for (from, to) in &marks {
            let [a, b] = [from[0] - on_board[0], from[1] - on_board[1]];
            let [x, y] = [to[0] - on_table[0], to[1] - on_table[1]];
            cosine += a * x + b * y;
            sine += a * y - b * x;
        }
        let turned = Self {
            at: [0.0; 2],
            yaw: sine.atan2(cosine),
            mirrored: false,
        };
        let [x, y] = turned.on_table(on_board);
        Self {
            at: [on_table[0] - x, on_table[1] - y],
            mirrored,
            ..turned
        }
    }

    /// From the board's frame to the table's.
    #[must_use]
    pub fn on_table(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        let x = if self.mirrored { -x } else { x };
        [
            self.at[0] + cos * x - sin * y,
            self.at[1] + sin * x + cos * y,
        ]
    }

    /// From the table's frame to the board's.
    #[must_use]
    pub fn on_board(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        let (x, y) = (x - self.at[0], y - self.at[1]);
        let along = cos * x + sin * y;
        [
            if self.mirrored { -along } else { along },
            cos * y - sin * x,
        ]
    }
}

/// A place where a disc is taken or set down.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Spot {
    /// In the board's frame.
    Board([f64; 2]),
    /// The tray of captured discs of a colour, by its place from 0.
    Tray(Hue, u8),
    /// The discs of a colour that are no part of the game.
    Spare(Hue),
}

impl Spot {
    /// In the table's frame.
    #[must_use]
    pub fn on_table(&self, board: &Pose) -> [f64; 2] {
        let side = |hue: Hue| match hue {
            Hue::Light => -1.0,
            Hue::Dark => 1.0,
        };
        match self {
            Self::Board(at) => board.on_table(*at),
            // Three rows of four, with room for fingers between them, where the arm gets to.
            Self::Tray(hue, place) => [
                0.24 + 0.065 * f64::from(*place % 4),
                (0.51 + 0.065 * f64::from(*place / 4)) * side(*hue),
            ],
            Self::Spare(hue) => {
                let (x, y) = SPARES[0];
                [x, y * side(*hue)]
            }
        }
    }

    /// The same for the disc on so many others there. Spare discs stand in several stacks, which are no obstacle.
    #[must_use]
    pub fn of_disc(&self, board: &Pose, below: u8) -> [f64; 2] {
        let [x, y] = self.on_table(board);
        match self {
            Self::Spare(_) => {
                let (there, away) = SPARES[usize::from(below % SPARE_STACKS)];
                [there, away.copysign(y)]
            }
            _ => [x, y],
        }
    }
}

/// Where the stacks of spare discs stand at Black's side of the table, m. They are used evenly: the elbow of a finger around the last disc
/// of one would meet another that is much higher.
const SPARES: [(f64, f64); SPARE_STACKS as usize] = [(0.53, 0.51), (0.53, 0.575), (0.595, 0.51)];
pub const SPARE_STACKS: u8 = 3;

/// What lies beyond this to both sides of the table is no part of the game.
pub const ASIDE_M: f64 = 0.46;

ctos::command! {
    /// A picture of the table, from one of several poses of the camera.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct See { pub pose: u8 } => Picture, 0x0701, "see"
}
ctos::command! {
    /// Moves the arm above a place on the table; where it waits, without one. `then` is where it goes next, if that is known. Says
    /// what keeps it from that, or from being there.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Go { pub to: Option<[f64; 2]>, pub then: Option<[f64; 2]> } => Option<Why>, 0x0702, "go"
}
ctos::command! {
    /// Closes the hand for an errand, about so many discs of the top of what stands beneath. Says how many it holds.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Close { pub errand: u32, pub discs: u8 } => u8, 0x0703, "close"
}
ctos::command! {
    /// Opens the hand for an errand. Says how many discs it has set down.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Open { pub errand: u32 } => u8, 0x0704, "open"
}
ctos::command! {
    /// Pushes what stands at a place to another one, both in the table's frame. Says what keeps the arm from that.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Shove { pub from: [f64; 2], pub to: [f64; 2] } => Option<Why>, 0x070a, "shove"
}
ctos::command! {
    /// People in the room hear something; the same number is the same words.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Hear {
        /// From 1
        pub number: u32,
        /// and in words.
        pub words: String,
        /// The squares that the laser shows meanwhile.
        pub shown: Vec<u8>,
        /// How the board shall be, when people are asked to move for the robot: White, Black, and kings.
        pub board: Option<[u32; 3]>,
    } => (), 0x0705, "hear"
}
ctos::command! {
    /// What is true, for the referee only.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Truth => TrueTable, 0x0706, "truth"
}
ctos::command! {
    /// What was read of a picture, for the referee only. Its stamp is the app's time, ns.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Looked { pub stamp_ns: i64, pub situation: Situation } => (), 0x0707, "looked"
}

ctos::command! {
    /// A person at a display puts a disc, by its name there, so much further on the table, m.
    #[derive(Debug, Clone, PartialEq)]
    pub struct DragDisc {
        /// Such as `dark3`.
        pub disc: String,
        /// Along x
        pub x: f64,
        /// and y.
        pub y: f64,
    } => (), 0x0708, "drag_disc"
}

ctos::command! {
    /// Makes it so light in the room, 0 to 1.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Shine { pub share: f64 } => (), 0x070b, "shine"
}
ctos::command! {
    /// What the player believes, for those who look at a display.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Believe {
        /// White, Black, and kings.
        pub board: [u32; 3],
        /// Whether the board is a mirrored one.
        pub mirrored: bool,
        /// By square: how surely it was seen as it is believed.
        pub seen: Vec<f64>,
        /// The squares of the last move.
        pub last: Option<[u8; 2]>,
        /// Whose turn it is, and what else there is to say.
        pub words: String,
        /// What is wanted of the player, as it is in force.
        pub settings: InForce,
    } => (), 0x070c, "believe"
}

/// What keeps an arm from doing what it is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Why {
    /// Somebody's hand is over the board.
    HandInTheWay,
    /// The errand's end, 0 or 1, is where the arm does not get.
    OutOfReach(u8),
    /// What it held has slipped out of its fingers.
    DiscLost,
    /// Drives have no power.
    NoPower,
    /// It met something that is no hand.
    Blocked,
    /// It would come too near to something on its way, which it did not begin.
    WouldTouch,
    /// A protective stop holds.
    Stopped,
    /// Hardware, control or another task failed.
    Fault,
}

/// Why the arm did not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hindrance {
    pub why: Why,
    /// In words, for those who look after the robot.
    pub text: String,
}

impl Hindrance {
    /// What a room has told.
    #[must_use]
    pub fn told(why: Why) -> Self {
        let text = match why {
            Why::HandInTheWay => "a hand is over the board",
            Why::OutOfReach(0) => "the disc is out of reach",
            Why::OutOfReach(_) => "where the disc is to go is out of reach",
            Why::DiscLost => "the disc was lost on the way",
            Why::NoPower => "the drives have no power",
            Why::Blocked | Why::WouldTouch => "something is in the way",
            Why::Stopped => "a protective stop holds",
            Why::Fault => "a fault",
        };
        let text = text.to_owned();
        Self { why, text }
    }

    /// What kept an arm from an end of its errand.
    #[must_use]
    pub fn of(failure: &Failure, end: u8) -> Self {
        let why = match failure.outcome {
            Outcome::Unreachable => Why::OutOfReach(end),
            Outcome::Absent => Why::DiscLost,
            Outcome::Estopped => Why::NoPower,
            Outcome::Guard | Outcome::Occupied | Outcome::Stuck => Why::Blocked,
            Outcome::Blocked => Why::WouldTouch,
            Outcome::Stopped => Why::Stopped,
            Outcome::Unseen | Outcome::Fault | Outcome::Lost | Outcome::Refused => Why::Fault,
        };
        let text = failure.reason.clone();
        Self { why, text }
    }
}

impl From<HandlerError> for Hindrance {
    fn from(error: HandlerError) -> Self {
        let text = error.to_string();
        Self {
            why: Why::Fault,
            text,
        }
    }
}

/// What a picture shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// The markers of the board, in the table's frame.
    pub markers: [[f64; 2]; 2],
    /// Discs from above, in the table's frame: of a stack the top one.
    pub discs: Vec<(Hue, [f64; 2])>,
    /// Where something glares, in the table's frame.
    pub glare: Option<[f64; 2]>,
    /// Whether a hand is seen.
    pub hand: bool,
    /// How light it is, 0 to 1.
    pub light: f64,
}

/// What is true in the room.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrueTable {
    /// The squares of White, Black and the kings, each time that the table was at rest and not as before.
    pub history: Vec<[u32; 3]>,
    /// All discs of each colour wherever they are.
    pub discs: [u32; 2],
    /// What people have heard.
    pub heard: Vec<String>,
    /// Discs that slipped out of the hand.
    pub slipped: u32,
    /// How often the board was moved.
    pub moved: u32,
    /// The person's errors, by their kind.
    pub errors: Vec<String>,
    /// How often arm and person's hand were over the table at the same time.
    pub met: u32,
    /// How often it was seen that something pressed on a link of a real arm that holds no discs.
    pub pressed: BTreeMap<String, u32>,
    /// Looks of cameras at the board.
    pub looks: Looks,
    /// How often somebody dimmed the lamp, and turned it up.
    pub lit: [u32; 2],
    /// How long each carry of a real arm took from its place of rest until it was back, ms.
    pub carried_ms: Vec<u32>,
}

/// How well the board was read, by looks at a board that nobody touched meanwhile.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Looks {
    /// All squares surely, and as they are.
    pub right: u32,
    /// What was not read right was unsure, or a hand was seen.
    pub unsure: u32,
    /// Something was read surely that is not so.
    pub wrong: u32,
}

/// Where the markers of the board were seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Marks {
    /// On the table: [`MARKERS`].
    Table([[f64; 2]; 2]),
    /// In pictures.
    Pictures(Vec<Marked>),
}

/// A board in the picture of a camera, px.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Marked {
    /// The camera.
    pub camera: String,
    /// [`CORNERS`].
    pub markers: [[f64; 2]; 4],
    /// The corners of the squares a1, h1, h8 and a8.
    pub corners: [[f64; 2]; 4],
}

/// [`Marks`], written by vision.
pub const MARKS: &str = "marks";
/// Where the board lies: a [`Pose`], written by the transform.
pub const BOARD: &str = "board";
/// [`Gaze`], written by the player.
pub const GAZE: &str = "gaze";
/// [`Situation`], written by vision.
pub const SITUATION: &str = "situation";
/// [`Errand`], written by the player.
pub const ERRAND: &str = "errand";
/// FROM and TO of the errand in the table's frame, written by the transform.
pub const POINTS: &str = "points";
/// [`Hindrance`], written by the robot.
pub const HINDRANCE: &str = "hindrance";
/// [`Words`], written by the player.
pub const WORDS: &str = "words";
/// [`Wish`], written by the People Coordinator.
pub const WISH: &str = "wish";
/// [`Settings`], written by the People Coordinator.
pub const SETTINGS: &str = "settings";
/// [`Played`], written by the player at the end.
pub const PLAYED: &str = "played";

/// From where vision looks, and at what.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gaze {
    /// From which of several poses.
    pub pose: u8,
    /// The square whose disc is grasped next: where it is must be known best.
    pub square: Option<u8>,
}

/// What is seen on a square.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// The disc.
    pub disc: Option<Hue>,
    /// How surely, 0 to 1.
    pub confidence: f64,
    /// Where its middle is, in the board's frame.
    pub at: [f64; 2],
}

/// The situation on the board.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Situation {
    /// By square, 0 to 31.
    pub squares: Vec<Reading>,
    /// Discs on the table that are on no square, in the board's frame.
    pub strays: Vec<(Hue, [f64; 2])>,
    /// Whether a hand is seen.
    pub hand: bool,
    /// Whether the board is not where it was found.
    pub moved: bool,
}

/// What is carried from where to where.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Errand {
    /// From 1.
    pub number: u32,
    /// From where.
    pub from: Spot,
    /// To where.
    pub to: Spot,
    /// One disc or two.
    pub discs: u8,
    /// How many discs stand beneath, at both ends.
    pub below: [u8; 2],
    /// Whether it is pushed there, and not carried.
    pub push: bool,
}

impl Errand {
    /// Its ends in the table's frame.
    #[must_use]
    pub fn ends(&self, board: &Pose) -> [[f64; 2]; 2] {
        let [from, to] = self.below;
        [self.from.of_disc(board, from), self.to.of_disc(board, to)]
    }

    /// How many discs of the same stack are beneath, at both ends.
    #[must_use]
    pub fn beneath(&self) -> [u8; 2] {
        let of = |spot: Spot, below: u8| match spot {
            Spot::Spare(_) => below / SPARE_STACKS,
            _ => below,
        };
        let [from, to] = self.below;
        [of(self.from, from), of(self.to, to)]
    }
}

/// What people are told.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Words {
    /// From 1.
    pub number: u32,
    /// In words.
    pub words: String,
    /// The squares that the laser shows meanwhile.
    pub shown: Vec<u8>,
    /// How the board shall be, when people are asked to move for the robot: White, Black, and kings.
    pub board: Option<[u32; 3]>,
}

/// How people want the player to be; what nobody has set is as configured.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// So many half-moves are looked ahead at most.
    pub depth: Option<u32>,
    /// How long a move is thought about, s.
    pub seconds: Option<f64>,
    /// How much is said, 1 to 3.
    pub verbosity: Option<u32>,
    /// Whether people carry for the robot.
    pub dry: Option<bool>,
    /// How light it is in the room, 0 to 1.
    pub light: Option<f64>,
}

/// [`Settings`] with what is configured. No time is told where a number of positions counts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct InForce {
    pub depth: u32,
    pub seconds: Option<f64>,
    pub verbosity: u32,
    pub dry: bool,
    pub light: f64,
}

/// What people want during a game.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wish {
    /// From 1.
    pub number: u32,
    /// `resign`, `draw` or `new_game`.
    pub what: String,
}

/// The game when it is over.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Played {
    /// As PDN.
    pub pdn: String,
    /// The result in words.
    pub result: String,
}

/// How long another process that is gone is waited for.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// A data object, also when the process that keeps them is just being started again.
pub(crate) async fn fetch<T: DeserializeOwned>(
    cx: &Context,
    store: &DomStore,
    name: &str,
) -> Result<T, HandlerError> {
    coordinators::patiently(cx, PATIENCE, |_| true, || store.fetch(cx, name)).await
}

/// Stores a data object in the same way.
pub(crate) async fn keep<T: Serialize>(
    cx: &Context,
    store: &DomStore,
    name: &str,
    value: &T,
) -> Result<(), HandlerError> {
    coordinators::patiently(cx, PATIENCE, |_| true, || store.store(cx, name, value)).await
}

/// Asks the room, or what stands in its place.
pub(crate) async fn ask<C: ctos::message::Command + Clone>(
    cx: &Context,
    room: &str,
    request: C,
) -> Result<C::Reply, HandlerError> {
    coordinators::patiently(
        cx,
        PATIENCE,
        |_| true,
        || async {
            let room = cx.task(room).await?;
            let answer = cx.call(&room, request.clone()).await;
            answer.map_err(|error| HandlerError::new(error.reason()))
        },
    )
    .await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pose_by_marks_is_the_one_that_put_them_there() {
        for (marks, mirrored) in [(&MARKERS[..], false), (&CORNERS, false), (&CORNERS, true)] {
            let pose = Pose {
                at: [0.52, -0.04],
                yaw: 0.31,
                mirrored,
            };
            let there = [0.13, 0.07];
            assert!(apart(pose.on_board(pose.on_table(there)), there) < 1e-12);
            let marks: Vec<_> = marks
                .iter()
                .map(|mark| (*mark, pose.on_table(*mark)))
                .collect();
            let found = Pose::of_marks(&marks, mirrored);
            assert!(apart(found.at, pose.at) < 1e-12, "{found:?}");
            assert!((found.yaw - pose.yaw).abs() < 1e-12, "{found:?}");
        }
    }
}
