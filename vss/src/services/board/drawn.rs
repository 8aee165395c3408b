//! What was read on a board, as it is drawn over its picture for people: the outline of the board, its markers, and a mark on each
//! square. It knows no screen.

use std::f64::consts::TAU;

use scene::{Drawing, Outline};
use vss_image::board::Board;

/// What is read less surely is unsure.
const SURE: f64 = 0.8;

/// Corners of a ring.
const CORNERS: u32 = 16;

/// Radii of the rings around discs, in the middle of kings and of empty squares, around markers, and half a square's outline, squares.
const DISC: f64 = 0.36;
const KING: f64 = 0.2;
const EMPTY: f64 = 0.07;
const MARKER: f64 = 0.24;
const HALF: f64 = 0.45;

/// How wide lines are, parts of a square's side, and how strong the weakest is.
const THIN: f64 = 0.085;
const THICK: f64 = 0.12;
const WEAKEST: f64 = 0.35;

const BOARD: [u8; 3] = [70, 200, 255];
const VIOLET: [u8; 3] = [205, 140, 255];
const LIGHT: [u8; 3] = [255, 222, 80];
const DARK: [u8; 3] = [255, 84, 70];
const NOTHING: [u8; 3] = [170, 210, 225];
const UNSURE: [u8; 3] = [255, 150, 0];
const HAND: [u8; 3] = [255, 190, 160];

/// Numbers that say what was read: whether a hand is seen, piece and confidence of each square, and four markers.
pub(super) const NUMBERS: usize = 1 + 2 * 32 + 2 * 4;

/// What was read on a board.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Reading {
    /// Whether a hand is seen.
    hand: bool,
    /// Piece (as `board` answers it) and confidence of the squares in the order of PDN; below 0 nothing is said of that square.
    squares: Vec<(i64, f64)>,
    /// The markers, px.
    markers: Vec<[f64; 2]>,
    /// Discs that stand on no square: piece, file and rank.
    strays: Vec<(i64, [f64; 2])>,
}

impl Reading {
    /// What the board itself has read.
    pub(super) fn of(squares: Vec<(i64, f64)>, strays: Vec<(i64, [f64; 2])>) -> Self {
        Self {
            squares,
            strays,
            ..Self::default()
        }
    }

    /// What somebody else has made of it, in [`NUMBERS`] numbers; nothing of any other count.
    pub(super) fn told(numbers: &[f64], strays: Vec<(i64, [f64; 2])>) -> Option<Self> {
        let (hand, rest) = numbers.split_first().filter(|_| numbers.len() == NUMBERS)?;
        let (squares, markers) = rest.split_at_checked(64)?;
        let (squares, _) = squares.as_chunks();
        let (markers, _) = markers.as_chunks();
        let squares = squares.iter().map(|[piece, sure]| (*piece as i64, *sure));
        Some(Self {
            hand: *hand > 0.0,
            squares: squares.collect(),
            markers: markers.to_vec(),
            strays,
        })
    }

    /// Squares that are read unsurely.
    pub(super) fn unsure(&self) -> usize {
        self.squares.iter().filter(|one| is_unsure(one)).count()
    }

    /// What is drawn over the picture of the board.
    pub(super) fn drawn(&self, board: &Board) -> Drawing {
        let pen = Pen::of(board);
        let mut outlines = vec![pen.around([4.0; 2], 4.0, BOARD, THIN)];
        outlines.extend(self.markers.iter().map(|at| pen.marker(*at)));
        for (square, (piece, sure)) in (0..32_u8).zip(&self.squares) {
            if *sure < 0.0 {
                continue;
            }
            let at = middle(square);
            let strength = WEAKEST + (1.0 - WEAKEST) * sure.min(1.0);
            let marks = pen.piece(*piece, at).into_iter();
            outlines.extend(marks.map(|outline| Outline {
                strength,
                ..outline
            }));
            if is_unsure(&(*piece, *sure)) {
                let colour = if self.hand { HAND } else { UNSURE };
                outlines.push(Outline {
                    text: format!("{:.0}", 100.0 * sure),
                    ..pen.around(at, HALF, colour, THICK)
                });
            }
        }
        for (piece, at) in &self.strays {
            outlines.extend(pen.piece(*piece, *at));
            outlines.push(Outline {
                text: "?".to_owned(),
                ..pen.ring(*at, 1.3 * DISC, UNSURE)
            });
        }
        Drawing {
            outlines,
            said: self.said(),
        }
    }

    /// The same in words.
    fn said(&self) -> String {
        let told = self.squares.iter().filter(|(_, sure)| *sure >= 0.0);
        let count = |pieces: [i64; 2]| {
            let told = told.clone();
            told.filter(|(piece, _)| pieces.contains(piece)).count()
        };
        let mut parts = Vec::new();
        if told.clone().next().is_some() {
            let (light, dark, kings) = (count([1, 3]), count([2, 4]), count([3, 4]));
            let kings = match kings {
                0 => String::new(),
                some => format!(" ({some} kings)"),
            };
            parts.push(format!("{light} light, {dark} dark{kings}"));
        } else {
            parts.push("a board".to_owned());
        }
        match self.unsure() {
            0 => {}
            some => parts.push(format!("{some} unsure")),
        }
        if !self.strays.is_empty() {
            parts.push(format!("{} on no square", self.strays.len()));
        }
        if self.hand {
            parts.push("a hand".to_owned());
        }
        parts.join(", ")
    }
}

fn is_unsure((piece, sure): &(i64, f64)) -> bool {
    *sure >= 0.0 && (*sure < SURE || *piece < 0)
}

/// The middle of a square by its number of PDN, counted from 0: file and rank.
fn middle(square: u8) -> [f64; 2] {
    let (row, column) = (square / 4, square % 4);
    let file = 2 * column + u8::from(row.is_multiple_of(2));
    [f64::from(file) + 0.5, 7.5 - f64::from(row)]
}

/// Draws on one board.
struct Pen<'a> {
    board: &'a Board,
    /// A square's side in the middle of the board, px.
    side: f64,
}

impl<'a> Pen<'a> {
    fn of(board: &'a Board) -> Self {
        let ([u, v], [x, y]) = (board.pixel(4.0, 4.0), board.pixel(5.0, 4.0));
        let side = (x - u).hypot(y - v);
        Self { board, side }
    }

    /// Places of the board as an outline.
    fn outline(&self, places: impl Iterator<Item = [f64; 2]>, colour: [u8; 3]) -> Outline {
        let corners = places.map(|[file, rank]| rounded(self.board.pixel(file, rank)));
        Outline {
            corners: corners.collect(),
            colour,
            strength: 1.0,
            width: tenth(THIN * self.side),
            text: String::new(),
        }
    }

    /// A square around a place, with half its side.
    fn around(&self, [file, rank]: [f64; 2], half: f64, colour: [u8; 3], width: f64) -> Outline {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let places = corners.map(|[x, y]| [file + half * x, rank + half * y]);
        Outline {
            width: tenth(width * self.side),
            ..self.outline(places.into_iter(), colour)
        }
    }

    /// A ring on the board.
    fn ring(&self, [file, rank]: [f64; 2], radius: f64, colour: [u8; 3]) -> Outline {
        let places = turns().map(|[x, y]| [file + radius * x, rank + radius * y]);
        self.outline(places, colour)
    }

    /// A ring around a place of the picture.
    fn marker(&self, [u, v]: [f64; 2]) -> Outline {
        let radius = MARKER * self.side;
        let corners = turns().map(|[x, y]| rounded([u + radius * x, v + radius * y]));
        Outline {
            corners: corners.collect(),
            ..self.ring([0.0; 2], 0.0, VIOLET)
        }
    }

    /// The mark of what stands at a place; an unknown piece has none.
    fn piece(&self, piece: i64, at: [f64; 2]) -> Vec<Outline> {
        let rings = |colour, king| {
            let radii = [DISC, KING].into_iter().take(1 + usize::from(king));
            radii.map(|radius| self.ring(at, radius, colour)).collect()
        };
        match piece {
            0 => vec![self.ring(at, EMPTY, NOTHING)],
            1 | 3 => rings(LIGHT, piece == 3),
            2 | 4 => rings(DARK, piece == 4),
            _ => Vec::new(),
        }
    }
}

/// Places on a circle of radius 1.
fn turns() -> impl Iterator<Item = [f64; 2]> {
    let angles = (0..CORNERS).map(|nth| TAU * f64::from(nth) / f64::from(CORNERS));
    angles.map(|angle| [angle.cos(), angle.sin()])
}

/// Nobody sees less.
fn tenth(pixels: f64) -> f64 {
    (pixels * 10.0).round() / 10.0
}

fn rounded(at: [f64; 2]) -> [f64; 2] {
    at.map(tenth)
}
