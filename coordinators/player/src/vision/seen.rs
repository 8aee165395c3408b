//! The board as cameras see it: its markers by `findBrdMarker`, its squares with a confidence for each by `board`, both objects of the
//! vision's daemon (SORMA technical report, section 2.1.3). What is unsure is looked for as one disc.

use coordinators::served::{self, Served};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::{Context, HandlerError},
};
use pnt::library::Acted;
use serde::Deserialize;
use sorma::{Method, Transport};

use crate::{
    player::is_mirrored,
    vision::{MOVED_M, OFF_M, Vision, well},
    wire::{
        self, FIELD_M, Gaze, Hue, Looked, Marked, Marks, Reading, SURE, Situation, apart, centre,
    },
};

/// A hand covers at least this part of the light squares.
const HAND: f64 = 0.02;

/// Squares on which a single disc is looked for, in one look.
const MOST_DISCS: usize = 12;

/// Cameras, and who reads their pictures.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeenArgs {
    /// The cameras in the order in which they are asked: the first one, and the others when it does not see something well.
    cameras: Vec<String>,
    /// An object of the class `board`.
    #[serde(default = "board")]
    board: String,
    /// An object of the class `findBrdMarker`.
    #[serde(default = "markers")]
    markers: String,
    /// Labelled pixels, with the classes `white`, `black`, `dark`, `light` and `marker`, relative to the configuration's folder.
    colours: String,
    /// Looks that are shown, with what was read in them; none without it.
    show: Option<ShowArgs>,
}

/// Which looks are shown.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShowArgs {
    /// Every so many looks.
    every: u64,
}

fn board() -> String {
    "board.checkers@vision_daemon".to_owned()
}

fn markers() -> String {
    "findBrdMarker.checkers@vision_daemon".to_owned()
}

impl SeenArgs {
    /// Findings where the arguments make no sense.
    pub fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        let mut wrong = |key: &str, text: String, help: &str| {
            let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
            let finding = Finding::error("checkers::player::args", text);
            findings.push(finding.at(place).help(help));
        };
        if self.cameras.is_empty() {
            let help = "name cameras of [vss.cameras]";
            wrong("seen.cameras", "no camera is named".to_owned(), help);
        }
        if let Err(error) = app.read(&self.colours) {
            let help = "name a table of labelled pixels, class,r,g,b";
            wrong("seen.colours", error.to_string(), help);
        }
        if self.show.is_some_and(|show| show.every == 0) {
            let text = "`seen.show.every` is 0".to_owned();
            wrong("seen.show", text, "give 1 or more");
        }
        for (key, name, default) in [
            ("seen.board", &self.board, board()),
            ("seen.markers", &self.markers, markers()),
        ] {
            served::check((key, name), &default, task, app, findings);
        }
    }
}

/// How a board lies before White. One with its dark corner at White's right is a plain one by a quarter turn. It is read as if White
/// sat at the right of the picture. Its files are then the ranks that the rules mean, and its ranks their files.
#[derive(Clone, Copy)]
struct Lies {
    turned: bool,
}

impl Lies {
    fn of(cx: &Context, state: &Vision) -> Self {
        let turned = is_mirrored(cx, &state.args.player);
        Self { turned }
    }

    /// Where White sits in the pictures.
    fn white(self) -> &'static str {
        if self.turned { "right" } else { "bottom" }
    }

    /// File and rank as the rules mean them from those that are read, and the other way round.
    fn places(self, [file, rank]: [f64; 2]) -> [f64; 2] {
        if self.turned {
            [rank, file]
        } else {
            [file, rank]
        }
    }

    /// The corners a1, h1, h8 and a8 in the same manner.
    fn corners(self, [a1, h1, h8, a8]: [[f64; 2]; 4]) -> [[f64; 2]; 4] {
        if self.turned {
            [a1, a8, h8, h1]
        } else {
            [a1, h1, h8, a8]
        }
    }

    /// Which of the squares that are read is this one.
    fn read_as(self, square: u8) -> usize {
        let square = usize::from(square);
        if !self.turned {
            return square;
        }
        let (row, column) = (square / 4, square % 4);
        let (rank, file) = (2 * column + usize::from(row % 2 == 0), 7 - row);
        4 * (7 - rank) + file / 2
    }
}

/// Asks an object of the daemon.
async fn ask(
    cx: &Context,
    object: &str,
    method: Method,
    text: &str,
    floats: &[f64],
) -> Result<Transport, HandlerError> {
    let object = Served::named(object).map_err(HandlerError::new)?;
    let mut body = Transport::text(text);
    body.floats = floats.to_vec();
    object.ask(cx, method, body).await
}

/// Has the objects learn the colours, once.
async fn train(cx: &Context, state: &Vision, seen: &SeenArgs) -> Acted {
    if state.trained.get() {
        return Ok(());
    }
    let white = Lies::of(cx, state).white();
    let text = format!("-train {} -white {white}", cx.path(&seen.colours).display());
    for object in [&seen.board, &seen.markers] {
        ask(cx, object, Method::Ctrl, &text, &[]).await?;
    }
    state.trained.set(true);
    Ok(())
}

/// Pairs of numbers from a place on.
fn pairs<const N: usize>(floats: &[f64], from: usize, step: usize) -> Option<[[f64; 2]; N]> {
    let mut all = [[0.0; 2]; N];
    for (nth, pair) in all.iter_mut().enumerate() {
        let at = from + step * nth;
        *pair = floats.get(at..at + 2)?.try_into().ok()?;
    }
    Some(all)
}

fn short(object: &str) -> HandlerError {
    HandlerError::new(format!("`{object}` answers too few numbers"))
}

/// The board's corners in the picture that was read last, or in one that a camera takes.
async fn corners(
    cx: &Context,
    (seen, lies): (&SeenArgs, Lies),
    picture: &str,
) -> Result<[[f64; 2]; 4], HandlerError> {
    let text = format!("marker {picture}");
    let answer = ask(cx, &seen.board, Method::Exec, &text, &[]).await?;
    let corners = pairs(&answer.floats, 9, 2).ok_or_else(|| short(&seen.board))?;
    Ok(lies.corners(corners))
}

/// The markers in the pictures of the cameras that see them.
pub async fn find(
    cx: &Context,
    state: &Vision,
    seen: &SeenArgs,
) -> Result<Vec<Marked>, HandlerError> {
    train(cx, state, seen).await?;
    let lies = Lies::of(cx, state);
    let (mut pictures, mut failed) = (Vec::new(), None);
    for camera in &seen.cameras {
        let text = format!("camera {camera}");
        let answer = ask(cx, &seen.markers, Method::Exec, &text, &[]).await;
        let found = match answer {
            Ok(answer) => corners(cx, (seen, lies), &text)
                .await
                .map(|corners| (answer, corners)),
            Err(error) => Err(error),
        };
        match found {
            Ok((answer, corners)) => {
                let markers = pairs(&answer.floats, 18, 3);
                let found = Marked {
                    camera: camera.clone(),
                    markers: lies.corners(markers.ok_or_else(|| short(&seen.markers))?),
                    corners,
                };
                if seen.show.is_some() {
                    show(cx, seen, &found, None).await;
                }
                pictures.push(found);
            }
            Err(error) => failed = Some(error),
        }
    }
    match failed {
        Some(error) if pictures.is_empty() => Err(error),
        _ => Ok(pictures),
    }
}

/// What the camera of the gaze's pose sees on the board.
pub async fn look(
    cx: &Context,
    state: &Vision,
    seen: &SeenArgs,
    gaze: Gaze,
) -> Result<Situation, HandlerError> {
    train(cx, state, seen).await?;
    let marks: Marks = wire::fetch(cx, &state.store, wire::MARKS).await?;
    let Marks::Pictures(pictures) = marks else {
        return Err(HandlerError::new("no camera has seen the board yet"));
    };
    let known = pictures.get(usize::from(gaze.pose) % pictures.len().max(1));
    let known = known.ok_or_else(|| HandlerError::new("no camera has seen the board yet"))?;
    let text = format!("camera {}", known.camera);
    let read = ask(cx, &seen.board, Method::Exec, &text, &[]).await?;
    let lies = Lies::of(cx, state);
    let now = corners(cx, (seen, lies), "last").await?;
    let rest = ask(cx, &seen.board, Method::Exec, "rest last", &[]).await?;
    let (covered, places) = rest
        .floats
        .split_first()
        .ok_or_else(|| short(&seen.board))?;
    let places = places.chunks_exact(2).zip(&rest.ints);
    let mut strays: Vec<(Hue, [f64; 2])> = places
        .filter_map(|(place, piece)| Some((hue(*piece)?, on_board(place, lies)?)))
        .collect();
    let hand = *covered > HAND;
    let mut squares = Vec::new();
    let mut left = if hand { 0 } else { MOST_DISCS };
    for square in 0..32_u8 {
        let nth = lies.read_as(square);
        let reading = read.ints.get(nth).zip(read.floats.get(nth));
        let (piece, confidence) = reading.ok_or_else(|| short(&seen.board))?;
        let mut reading = Reading {
            disc: hue(*piece),
            confidence: *confidence,
            at: centre(square),
        };
        // The disc that is grasped next is measured, too (`getDisk` of the report).
        let closely = gaze.square == Some(square) && reading.disc.is_some();
        if (reading.confidence < SURE || closely) && left > 0 {
            left -= 1;
            one(cx, (seen, lies), square, &mut reading, &mut strays).await?;
        }
        squares.push(reading);
    }
    // What stands on a square is none, whatever of it is seen beside it.
    strays.retain(|(_, at)| (0..32).all(|square| apart(centre(square), *at) >= OFF_M));
    let situation = Situation {
        squares,
        strays,
        hand,
        moved: !hand && is_moved(&known.corners, &now),
    };
    let stamp_ns = read.ints.last().copied().unwrap_or_default();
    let looked = Looked {
        stamp_ns,
        situation: situation.clone(),
    };
    wire::ask(cx, &state.args.room, looked).await?;
    if let Some(shown) = seen.show {
        let looks = state.looks.get();
        state.looks.set(looks + 1);
        if looks.is_multiple_of(shown.every) {
            show(cx, seen, known, Some((&situation, lies, &read.ints))).await;
        }
    }
    Ok(situation)
}

/// Has the picture that was read last shown, with what was made of it. What is not shown costs no look.
async fn show(
    cx: &Context,
    seen: &SeenArgs,
    known: &Marked,
    made: Option<(&Situation, Lies, &[i64])>,
) {
    let hand = made.is_some_and(|(situation, ..)| situation.hand);
    // Where nothing was read yet, no square has a mark.
    let mut squares = [[0.0, -1.0]; 32];
    if let Some((situation, lies, pieces)) = made {
        for (square, reading) in (0..).zip(&situation.squares) {
            let nth = lies.read_as(square);
            let piece = pieces.get(nth).copied().unwrap_or(-1);
            if let Some(to) = squares.get_mut(nth) {
                *to = [f64::from(piece_of(reading, piece)), reading.confidence];
            }
        }
    }
    let mut numbers = vec![f64::from(u8::from(hand))];
    numbers.extend(squares.as_flattened());
    numbers.extend(known.markers.as_flattened());
    let shown = ask(cx, &seen.board, Method::Exec, "show last", &numbers).await;
    if let Err(error) = shown {
        tracing::debug!("picture not shown: {error}");
    }
}

/// The piece of what a square was read as at last: that which was read at first where both agree.
fn piece_of(reading: &Reading, piece: i64) -> i8 {
    let first = i8::try_from(piece).unwrap_or(-1);
    match reading.disc {
        disc if disc == hue(piece) => first,
        Some(Hue::Light) => 1,
        Some(Hue::Dark) => 2,
        None => 0,
    }
}

/// Looks for one disc on or beside a square that is unsure.
async fn one(
    cx: &Context,
    (seen, lies): (&SeenArgs, Lies),
    square: u8,
    reading: &mut Reading,
    strays: &mut Vec<(Hue, [f64; 2])>,
) -> Acted {
    let middle = lies.places(centre(square).map(|at| at / FIELD_M + 4.0));
    let Ok(disc) = ask(cx, &seen.board, Method::Exec, "disk last", &middle).await else {
        // There is none, or it is not seen: what was read stays.
        return Ok(());
    };
    let piece = disc.ints.first().copied().unwrap_or_default();
    let place = disc.floats.get(3..5).and_then(|at| on_board(at, lies));
    let (hue, at) = hue(piece).zip(place).ok_or_else(|| short(&seen.board))?;
    let off = apart(centre(square), at);
    if off < OFF_M {
        *reading = Reading {
            disc: Some(hue),
            confidence: well(off),
            at,
        };
        return Ok(());
    }
    // It lies across squares, and this one is empty but for that.
    if reading.disc.is_none() {
        reading.confidence = 1.0;
    }
    if strays
        .iter()
        .all(|(_, other)| apart(*other, at) > FIELD_M / 2.0)
    {
        strays.push((hue, at));
    }
    Ok(())
}

fn hue(piece: i64) -> Option<Hue> {
    match piece {
        1 | 3 => Some(Hue::Light),
        2 | 4 => Some(Hue::Dark),
        _ => None,
    }
}

/// A place in squares from the corner of a1, in the board's frame.
fn on_board(place: &[f64], lies: Lies) -> Option<[f64; 2]> {
    let place = lies.places(place.try_into().ok()?);
    Some(place.map(|at| (at - 4.0) * FIELD_M))
}

/// Whether the board's corners are not where they were.
fn is_moved(before: &[[f64; 2]; 4], now: &[[f64; 2]; 4]) -> bool {
    let side = apart(before[0], before[1]).min(apart(before[1], before[2]));
    let pixel_m = 8.0 * FIELD_M / side.max(1.0);
    let pairs = before.iter().zip(now);
    pairs
        .map(|(one, other)| apart(*one, *other) * pixel_m)
        .any(|off| off > MOVED_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_of_a_turned_board_is_the_one_that_is_read_at_the_same_place_of_the_picture() {
        let lies = Lies { turned: true };
        let mut all: Vec<usize> = (0..32).map(|square| lies.read_as(square)).collect();
        for square in 0..32_u8 {
            let read = u8::try_from(lies.read_as(square)).unwrap();
            assert_eq!(centre(read), lies.places(centre(square)), "{square}");
        }
        all.sort_unstable();
        assert_eq!(all, (0..32).collect::<Vec<usize>>());
    }
}
