//! What the cameras saw of board and things, and what follows from that: data objects and pure functions.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use vss_board::{discs::SeenDisc, pose::BoardPose};

use super::{
    board::{Board, Field},
    errand::Errand,
    thing::Thing,
};

/// What was seen before anything moved: written by the Vision Coordinator.
pub const SIGHT: &str = "sight";
/// Where the thing is after the errand: written by the Vision Coordinator.
pub const FOUND: &str = "found";

/// A thing belongs to a field when its middle is nearer to the field's than this part of a side.
const NEAR: f64 = 0.45;

/// A thing that has not been touched is seen again within so much of its place, m.
const SAME_M: f64 = 5e-3;

/// Two things whose rims are nearer to one another are stuck together, m: no jaw goes between them.
const STUCK_M: f64 = 4e-3;

/// A field is bare when at least this part of what the thing would cover looks so.
const BARE: f64 = 0.6;

/// A board that nobody touched is seen again within so much, m and rad.
const STILL: (f64, f64) = (2e-3, 0.01);

/// What a look over the table tells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Overview {
    /// Where the board is.
    pub board: BoardPose,
    /// The things on it and beside it, in the board's frame.
    pub discs: Vec<SeenDisc>,
    /// Which part of each place that was asked for looks like the bare board, 0 to 1; `None` where no camera sees it.
    pub bare: Vec<Option<f64>>,
    /// What some of the cameras could not do.
    pub doubts: Vec<String>,
}

/// [`SIGHT`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sight {
    /// The errand's command.
    pub command: u32,
    /// Where the board is.
    pub board: Board,
    /// What was seen; `None` when the configuration is believed.
    pub seen: Option<Overview>,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// [`FOUND`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The errand's command.
    pub command: u32,
    /// Whether anybody has looked.
    pub looked: bool,
    /// Whether the thing stands on TO, as far as anybody has looked.
    pub arrived: Option<bool>,
    /// Where it is, from the middle of the field along columns and rows, m; when it stands there.
    pub off_m: Option<[f64; 2]>,
    /// The board by then.
    pub board: Board,
    /// Where the thing was taken, in the base frame of the arm, m.
    pub taken: Point3<f64>,
    /// The middles of what may be it where it does not stand on TO, in the board's frame, m.
    pub lies: Vec<Point3<f64>>,
    /// Where it is, in words.
    pub notes: Vec<String>,
}

/// What keeps an errand from being begun.
#[derive(Debug, Clone, PartialEq)]
pub enum Hindrance {
    /// No thing lies on FROM at that height.
    NothingAtFrom(String),
    /// Something stands on TO.
    Occupied(String),
    /// Another thing touches that on FROM.
    Stuck(String),
    /// Something else.
    Other(String),
}

impl Overview {
    /// The board of `known` where it was seen.
    #[must_use]
    pub fn board(&self, known: &Board) -> Board {
        let pose = &self.board.base_t_board;
        let (_, _, yaw) = pose.rotation.euler_angles();
        Board {
            at: pose.translation.vector.into(),
            yaw_deg: yaw.to_degrees(),
            ..*known
        }
    }

    /// The things about a field, from the lowest: nearer to its middle than to that of the next.
    fn on_field(&self, board: &Board, field: &Field) -> Vec<&SeenDisc> {
        let middle = board.on_board(field, 1.0);
        let near = |disc: &&SeenDisc| {
            (disc.at.xy() - middle.xy()).norm() < NEAR * board.field_m && disc.at.z > -1e-3
        };
        let mut all: Vec<&SeenDisc> = self.discs.iter().filter(near).collect();
        all.sort_by(|one, other| one.at.z.total_cmp(&other.at.z));
        all
    }

    /// How far the middles of what stands beside a place are from it, m: all but the thing itself, and what lies deeper.
    fn beside<'a>(
        &'a self,
        place: &'a Point3<f64>,
        thing: &'a Thing,
        itself: &'a SeenDisc,
    ) -> impl Iterator<Item = f64> + 'a {
        let others = self.discs.iter().filter(move |disc| *disc != itself);
        let beside = others.filter(move |disc| disc.at.z > place.z - 0.5 * thing.height_m);
        beside.map(move |disc| (disc.at.xy() - place.xy()).norm())
    }

    /// The thing at a place of the board, unless another one lies upon it. Only the uppermost of a stack is seen.
    fn at(&self, board: &Board, field: &Field, thing: &Thing) -> Option<&SeenDisc> {
        let top = self.on_field(board, field).pop()?;
        let above = top.at.z / thing.height_m - field.height;
        (above.abs() < 0.5).then_some(top)
    }
}

/// What was seen of an errand: the errand with its ends where they are, or what is in its way. `errand` has the board of the
/// configuration.
///
/// # Errors
/// What keeps it from being begun.
pub fn aimed(errand: &Errand, sight: &Sight) -> Result<Errand, Hindrance> {
    let (board, thing) = (sight.board, &errand.thing);
    let mut points = [errand.from, errand.to].map(|field| board.point(&field, thing.height_m));
    let mut open_m = errand.open_m;
    if let Some(seen) = &sight.seen {
        let (from, to) = (&errand.from, &errand.to);
        let Some(disc) = seen.at(&board, from, thing) else {
            return Err(nothing(seen, &board, errand));
        };
        points[0] = board.pose() * disc.at;
        is_free(seen, &board, to, thing, disc)?;
        is_alone(seen, &board, thing, disc)?;
        let ends = [disc.at, board.on_board(to, thing.height_m)];
        open_m = thing.opening(ends.iter().flat_map(|end| seen.beside(end, thing, disc)));
    }
    Ok(Errand {
        points,
        yaw: board.yaw(),
        board,
        open_m,
        ..errand.clone()
    })
}

/// Why nothing can be taken from FROM.
fn nothing(seen: &Overview, board: &Board, errand: &Errand) -> Hindrance {
    let (from, thing) = (&errand.from, &errand.thing);
    match seen.on_field(board, from).pop() {
        Some(top) => {
            let there = top.at.z / thing.height_m;
            let text = format!(
                "the uppermost {} on {},{} is at height {there:.0}, not at {:.0}",
                thing.name, from.column, from.row, from.height
            );
            if there > from.height {
                Hindrance::Other(text)
            } else {
                Hindrance::NothingAtFrom(text)
            }
        }
        None => Hindrance::NothingAtFrom(format!(
            "no {} is seen on {from}; {}",
            thing.name,
            all_in_words(seen, board, thing)
        )),
    }
}

/// Whether a jaw goes between the thing `taken` and what lies beside it.
fn is_alone(
    seen: &Overview,
    board: &Board,
    thing: &Thing,
    taken: &SeenDisc,
) -> Result<(), Hindrance> {
    match touching(seen, thing, taken) {
        Some(other) => Err(Hindrance::Stuck(format!(
            "a {} {} is stuck to it: push them apart",
            colour_name(thing, other),
            place_in_words(board, other, thing)
        ))),
        None => Ok(()),
    }
}

/// What lies so near beside a thing that no jaw goes between them.
fn touching<'n>(seen: &'n Overview, thing: &Thing, taken: &SeenDisc) -> Option<&'n SeenDisc> {
    let mut others = seen.discs.iter().filter(|disc| *disc != taken);
    others.find(|disc| {
        let apart = (disc.at.xy() - taken.at.xy()).norm() - thing.width_m;
        // What lies beneath is no neighbour.
        let beside = (disc.at.z - taken.at.z).abs() < 0.5 * thing.height_m;
        beside && apart < STUCK_M
    })
}

/// A thing that cannot be grasped for one beside it.
#[derive(Debug, Clone, PartialEq)]
pub struct Crowd {
    /// The middle of the thing to be taken, in the board's frame, m.
    pub thing: Point3<f64>,
    /// That of the other one.
    pub other: Point3<f64>,
    /// Those of all others that are seen.
    pub rest: Vec<Point3<f64>>,
}

/// The thing on FROM and what is stuck to it, if something is.
#[must_use]
pub fn crowd(errand: &Errand, sight: &Sight) -> Option<Crowd> {
    let seen = sight.seen.as_ref()?;
    let thing = &errand.thing;
    let taken = seen.at(&sight.board, &errand.from, thing)?;
    let other = touching(seen, thing, taken)?;
    let rest = seen
        .discs
        .iter()
        .filter(|disc| *disc != taken && *disc != other);
    Some(Crowd {
        thing: taken.at,
        other: other.at,
        rest: rest.map(|disc| disc.at).collect(),
    })
}

/// The errand with the thing where it was found, when it was lost and may be only one thing.
#[must_use]
pub fn at_found(errand: &Errand, found: &Found) -> Option<Errand> {
    let (thing, board) = (&errand.thing, found.board);
    let [at] = found.lies.as_slice() else {
        return None;
    };
    let there = board.pose() * at;
    // The errand may be that of fetching it by now.
    let is_lost = (there - found.taken).norm() > NEAR * board.field_m;
    is_lost.then(|| Errand {
        from: board.field(at, thing.height_m),
        board,
        points: [there, board.point(&errand.to, thing.height_m)],
        yaw: board.yaw(),
        ..errand.clone()
    })
}

/// Whether the thing `carried` can be set down on a field.
fn is_free(
    seen: &Overview,
    board: &Board,
    to: &Field,
    thing: &Thing,
    carried: &SeenDisc,
) -> Result<(), Hindrance> {
    let middle = board.on_board(to, thing.height_m);
    let own = (carried.at.xy() - middle.xy()).norm() < thing.width_m;
    let mut others = seen.discs.iter().filter(|disc| *disc != carried);
    let beside = others.find(|disc| {
        let near = (disc.at.xy() - middle.xy()).norm() < thing.width_m;
        // What lies so deep that the thing stands on it is not in its way.
        near && disc.at.z > middle.z - 0.5 * thing.height_m
    });
    if let Some(other) = beside {
        let place = place_in_words(board, other, thing);
        return Err(Hindrance::Occupied(format!(
            "a {} stands {place}, where {to} is",
            colour_name(thing, other)
        )));
    }
    if to.height > 0.5 {
        let under = seen.on_field(board, to).pop();
        let lacks = under.is_none_or(|disc| {
            disc == carried || (disc.at.z / thing.height_m + 1.0 - to.height).abs() > 0.5
        });
        if lacks {
            return Err(Hindrance::Other(format!(
                "fewer than {:.0} lie on {},{} to set it down upon",
                to.height, to.column, to.row
            )));
        }
        return Ok(());
    }
    // What is no disc is something else than a field, too.
    match seen.bare.first() {
        Some(Some(share)) if *share < BARE && !own => Err(Hindrance::Occupied(format!(
            "something stands on {to}, or before it: {:.0} % of the place looks like the board",
            share * 100.0
        ))),
        _ => Ok(()),
    }
}

/// What became of the thing that was carried: `before` was seen at the begin, `now` after it.
#[must_use]
pub fn arrival(errand: &Errand, before: Option<&Overview>, now: &Overview) -> Found {
    let (board, thing) = (now.board(&errand.board), &errand.thing);
    let mut notes = moved(&errand.board, &board);
    let top = now.at(&board, &errand.to, thing);
    let arrived = top.map(|disc| {
        let middle = board.on_board(&errand.to, thing.height_m);
        let off = disc.at - middle;
        [off.x, off.y]
    });
    let strays = strays(errand, before, now);
    match arrived {
        Some([x, y]) => notes.push(format!(
            "seen on {}: {:.1} mm along columns and {:.1} mm along rows from the middle of the field",
            errand.to,
            tenths(x),
            tenths(y)
        )),
        None => {
            let words = in_words(errand, &board, &strays);
            notes.push(format!("no {} is seen on {}; {words}", thing.name, errand.to));
        }
    }
    Found {
        command: errand.command,
        looked: true,
        arrived: Some(arrived.is_some()),
        off_m: arrived,
        board,
        taken: errand.points[0],
        lies: match arrived {
            Some(_) => Vec::new(),
            None => strays.iter().map(|disc| disc.at).collect(),
        },
        notes,
    }
}

/// Whole tenths of a millimetre, and no negative zero.
fn tenths(length_m: f64) -> f64 {
    (length_m * 1e4).round() / 10.0 + 0.0
}

/// Where the thing is that could not be carried.
#[must_use]
pub fn whereabouts(errand: &Errand, before: Option<&Overview>, now: &Overview) -> Found {
    let board = now.board(&errand.board);
    let mut notes = moved(&errand.board, &board);
    let strays = strays(errand, before, now);
    notes.push(in_words(errand, &board, &strays));
    Found {
        command: errand.command,
        looked: true,
        arrived: None,
        off_m: None,
        board,
        taken: errand.points[0],
        lies: strays.iter().map(|disc| disc.at).collect(),
        notes,
    }
}

/// What may be the errand's thing now: what lies on FROM, or is of its colour and was not there before.
fn strays<'n>(errand: &Errand, before: Option<&Overview>, now: &'n Overview) -> Vec<&'n SeenDisc> {
    let thing = &errand.thing;
    let first = before.and_then(|seen| seen.at(&errand.board, &errand.from, thing));
    let alike = |disc: &&SeenDisc| first.is_none_or(|first| first.colour == disc.colour);
    let was_there = |disc: &&SeenDisc| {
        let mut known = before.iter().flat_map(|seen| &seen.discs);
        known.any(|known| Some(known) != first && (known.at - disc.at).norm() < SAME_M)
    };
    let others = now.discs.iter().filter(alike);
    others.filter(|disc| !was_there(disc)).collect()
}

fn in_words(errand: &Errand, board: &Board, strays: &[&SeenDisc]) -> String {
    let thing = &errand.thing;
    match strays {
        [] => format!("the {} is seen nowhere", thing.name),
        all => {
            let all: Vec<String> = all
                .iter()
                .map(|disc| {
                    let place = place_in_words(board, disc, thing);
                    format!("a {} lies {place}", colour_name(thing, disc))
                })
                .collect();
            all.join(", ")
        }
    }
}

/// `red disc`.
fn colour_name(thing: &Thing, disc: &SeenDisc) -> String {
    match thing.colour.get(disc.colour) {
        Some(colour) => format!("{} {}", colour.name, thing.name),
        None => thing.name.clone(),
    }
}

/// Where a thing is, in board coordinates, or on the table in the arm's base frame. One picture does not tell how high it lies, and so not
/// for sure where.
fn place_in_words(board: &Board, disc: &SeenDisc, thing: &Thing) -> String {
    let at = &disc.at;
    let doubt = match disc.cameras {
        0 | 1 => " (in one picture alone)",
        _ => "",
    };
    let field = board.field(at, thing.height_m);
    if board.has(&Field {
        height: 0.0,
        ..field
    }) && at.z > -1e-3
    {
        return format!(
            "on {:.2},{:.2},{:.0}{doubt}",
            field.column,
            field.row,
            field.height.max(0.0).round() + 0.0
        );
    }
    let base = board.pose() * at;
    format!(
        "beside the board at x {:.3} m, y {:.3} m{doubt}",
        base.x, base.y
    )
}

/// All things that are seen.
fn all_in_words(seen: &Overview, board: &Board, thing: &Thing) -> String {
    if seen.discs.is_empty() {
        return "none is seen anywhere".to_owned();
    }
    let all: Vec<String> = seen
        .discs
        .iter()
        .map(|disc| {
            let place = place_in_words(board, disc, thing);
            format!("a {} {place}", colour_name(thing, disc))
        })
        .collect();
    format!("seen are {}", all.join(", "))
}

/// Says that somebody has moved the board.
#[must_use]
pub fn moved(before: &Board, now: &Board) -> Vec<String> {
    let by: Isometry3<f64> = before.pose().inverse() * now.pose();
    let (shift, turn) = (by.translation.vector.xy().norm(), by.rotation.angle());
    if shift < STILL.0 && turn < STILL.1 {
        return Vec::new();
    }
    vec![format!(
        "the board was moved by {:.0} mm and turned by {:.1} degrees",
        shift * 1e3,
        turn.to_degrees()
    )]
}

/// Where a stack's uppermost thing may lie, in the board's frame, m: on the board, beside it, and on things that lie there.
#[must_use]
pub fn floors(board: &Board, thing: &Thing) -> Vec<f64> {
    let mut floors = vec![0.0, -board.thick_m];
    floors.extend((1..=HIGHEST).map(|count| f64::from(count) * thing.height_m));
    floors
}

/// No stack is higher, in things beneath the uppermost.
const HIGHEST: u32 = 4;
