//! What stands on the 32 playing squares, from what each looks like inside the circle that a disc covers.

use super::{Board, Disc, PATCH, SQUARES};
use crate::{Picture, colour::Classes};

/// Playing squares.
const FIELDS: usize = 32;

/// Discs cover at least this radius about the middle of a square, squares.
const RADIUS: f64 = 0.3;

/// Within this radius kings have their mark, squares; beyond [`RIM`] it is over.
const MARK: f64 = 0.1;
const RIM: f64 = 0.17;

/// Differences of light below this part of that of light and dark squares are none.
const SAME: f64 = 0.1;

/// The mark of a king differs from its disc by this part.
const MARKED: f64 = 0.35;

/// A disc whose colour differs from its square by this part, light left out, has another colour.
const TINTED: f64 = 0.4;

/// Discs of another colour that are darker than this part are black: red ones.
const PALE: f64 = 0.5;

/// Places in a square that are not alike by this part are no disc and no empty square.
const ALIKE: f64 = 0.7;

/// A reading with a smaller margin is none.
const MARGIN_LEAST: f64 = 0.15;

/// Places a side of a square that are looked at.
const GRID: i32 = 9;

/// What stands on a playing square.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Piece {
    /// Something covers it, or it is no piece.
    Unknown,
    /// Nothing.
    Empty,
    /// A white man.
    WhiteMan,
    /// A black man.
    BlackMan,
    /// A white king: its middle is marked.
    WhiteKing,
    /// A black king.
    BlackKing,
}

impl Piece {
    /// -1 unknown, 0 empty, 1 and 2 white and black man, 3 and 4 kings.
    #[must_use]
    pub fn code(self) -> i64 {
        match self {
            Self::Unknown => -1,
            Self::Empty => 0,
            Self::WhiteMan => 1,
            Self::BlackMan => 2,
            Self::WhiteKing => 3,
            Self::BlackKing => 4,
        }
    }
}

/// A playing square.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// What stands on it.
    pub piece: Piece,
    /// Margin to the second best reading, 0 to 1.
    pub confidence: f64,
}

const UNKNOWN: Field = Field {
    piece: Piece::Unknown,
    confidence: 0.0,
};

/// What trained colour classes are on a board.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Roles {
    /// The class of white discs, of black ones, and of dark squares, by number.
    white: usize,
    black: usize,
    dark: usize,
    /// Of light squares, if there is one.
    light: Option<usize>,
}

/// What is on the light squares.
#[derive(Debug, Clone, PartialEq)]
pub struct Rest {
    /// Discs that stand there, or partly there.
    pub discs: Vec<Disc>,
    /// Which part of them something covers that is neither disc nor square, 0 to 1.
    pub covered: f64,
}

/// Discs on the light squares are no more.
const REST_MOST: usize = 16;

/// Two discs are not so near to one another, squares.
const DISC: f64 = 0.5;

/// Within this part of its radius a disc shows its colour, and this part of the places does.
const WITHIN: f64 = 0.7;

impl Roles {
    /// The classes `white`, `black` and `dark` (squares), and `light` (squares) if it is there. All others are neither: hands, background.
    ///
    /// # Errors
    /// The name of the one that is missing.
    pub fn of(classes: &Classes) -> Result<Self, &'static str> {
        let named = |name: &'static str| {
            let place = classes.names().iter().position(|class| class == name);
            place.ok_or(name)
        };
        Ok(Self {
            white: named("white")?,
            black: named("black")?,
            dark: named("dark")?,
            light: named("light").ok(),
        })
    }

    fn disc(&self, class: Option<usize>) -> Option<bool> {
        let white = class == Some(self.white);
        (white || class == Some(self.black)).then_some(white)
    }
}

/// The playing squares in the order of PDN: 1 is b8, 4 is h8, 29 is a1, 32 is g1. File and rank from 0.
fn playing() -> impl Iterator<Item = (i32, i32)> {
    (0..SQUARES).rev().flat_map(|rank| {
        let files = (0..SQUARES).filter(move |file| (file + rank) % 2 == 0);
        files.map(move |file| (file, rank))
    })
}

impl Board {
    /// What stands on the playing squares, by how light discs are against the dark square around them: white ones lighter,
    /// black ones darker, or of another colour and not pale. With trained colours it is told by these.
    #[must_use]
    pub fn situation(
        &self,
        picture: &Picture,
        colours: Option<(&Classes, &Roles)>,
    ) -> [Field; FIELDS] {
        let mut fields = [UNKNOWN; FIELDS];
        for (field, (file, rank)) in fields.iter_mut().zip(playing()) {
            let read = match colours {
                None => self.by_light(picture, file, rank),
                Some((classes, roles)) => self.by_colour(picture, classes, roles, file, rank),
            };
            let sure = read.filter(|read| read.confidence >= MARGIN_LEAST);
            *field = sure.unwrap_or(UNKNOWN);
        }
        fields
    }

    /// The light of the dark square at its corners, and how much lighter light squares are there. Nothing where the pattern is
    /// not seen at most of them: something lies over the square.
    pub(super) fn surroundings(&self, file: i32, rank: i32) -> Option<(f64, f64)> {
        let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| (file + x, rank + y));
        let (mut looked_at, mut seen) = (0, Vec::new());
        for (x, y) in corners {
            // Only one square meets the board's own corners.
            if x % SQUARES == 0 && y % SQUARES == 0 {
                continue;
            }
            looked_at += 1;
            let vertex = self.vertex(x, y);
            seen.extend(vertex.filter(|(contrast, _)| *contrast > 0.35 * self.contrast));
        }
        let mean =
            |of: fn(&(f64, f64)) -> f64| seen.iter().map(of).sum::<f64>() / seen.len() as f64;
        (seen.len() * 4 >= looked_at * 3 - 1 && seen.len() >= 2)
            .then(|| (mean(|one| one.1), mean(|one| one.0)))
    }

    /// Places in a square, from its middle.
    fn places(file: i32, rank: i32) -> impl Iterator<Item = ([f64; 2], f64)> {
        let offset = |step: i32| RADIUS * f64::from(2 * step) / f64::from(GRID - 1) - RADIUS;
        let steps = (0..GRID).flat_map(|x| (0..GRID).map(move |y| (x, y)));
        let places = steps.map(move |(x, y)| {
            let (dx, dy) = (offset(x), offset(y));
            let at = [f64::from(file) + 0.5 + dx, f64::from(rank) + 0.5 + dy];
            (at, dx.hypot(dy))
        });
        places.filter(|(_, far)| *far <= RADIUS + 1e-9)
    }

    /// The colour at a place.
    fn colour(&self, picture: &Picture, x: f64, y: f64) -> Option<[f64; 3]> {
        let [u, v] = self.pixel(x, y).map(f64::round);
        let inside = u >= 0.0 && v >= 0.0;
        let rgb = inside.then(|| picture.rgb(u as usize, v as usize))??;
        Some(rgb.map(f64::from))
    }

    /// The mean colour of a square near its corners.
    fn square(&self, picture: &Picture, file: i32, rank: i32) -> Option<[f64; 3]> {
        let mut mean = [0.0; 3];
        for (x, y) in [
            (PATCH, PATCH),
            (1.0 - PATCH, PATCH),
            (PATCH, 1.0 - PATCH),
            (1.0 - PATCH, 1.0 - PATCH),
        ] {
            let colour = self.colour(picture, f64::from(file) + x, f64::from(rank) + y)?;
            for (mean, one) in mean.iter_mut().zip(colour) {
                *mean += one / 4.0;
            }
        }
        Some(mean)
    }

    /// What a disc is by the colour that most of it has; nothing where that is no disc's.
    #[must_use]
    pub fn coloured(
        &self,
        picture: &Picture,
        (classes, roles): (&Classes, &Roles),
        disc: &Disc,
    ) -> Option<Piece> {
        let (mut white, mut black, mut all) = (0, 0, 0);
        for (x, y) in (-4..=4).flat_map(|x| (-4..=4).map(move |y| (x, y))) {
            let [dx, dy] = [x, y].map(|step| f64::from(step) / 4.0);
            if dx.hypot(dy) > 1.0 {
                continue;
            }
            let step = WITHIN * disc.radius;
            let [u, v] = [disc.u + step * dx, disc.v + step * dy].map(f64::round);
            if u < 0.0 || v < 0.0 {
                continue;
            }
            all += 1;
            let class = classes.of(picture.rgb(u as usize, v as usize)?).class;
            match roles.disc(class) {
                Some(true) => white += 1,
                Some(false) => black += 1,
                None => {}
            }
        }
        let most = f64::from(white.max(black)) >= ALIKE * f64::from(all);
        most.then(|| piece(white > black, false))
    }

    /// What is on the light squares, where nothing should be. Nothing is told without a class `light`.
    #[must_use]
    pub fn rest(&self, picture: &Picture, (classes, roles): (&Classes, &Roles)) -> Option<Rest> {
        let light = roles.light?;
        let (mut all, mut strange, mut places) = (0, 0, Vec::new());
        let squares = (0..SQUARES).flat_map(|x| (0..SQUARES).map(move |y| (x, y)));
        for (file, rank) in squares.filter(|(x, y)| (x + y) % 2 != 0) {
            for ([x, y], _) in Self::places(file, rank) {
                let at = self.pixel(x, y).map(f64::round);
                if at[0] < 0.0 || at[1] < 0.0 {
                    continue;
                }
                let Some(rgb) = picture.rgb(at[0] as usize, at[1] as usize) else {
                    continue;
                };
                let class = classes.of(rgb).class;
                all += 1;
                if roles.disc(class).is_some() {
                    places.push([x, y]);
                } else if class != Some(light) && class != Some(roles.dark) {
                    strange += 1;
                }
            }
        }
        Some(Rest {
            discs: self.discs(picture, (classes, roles), places),
            covered: f64::from(strange) / f64::from(all.max(1)),
        })
    }

    /// The discs that cover places.
    fn discs(
        &self,
        picture: &Picture,
        colours: (&Classes, &Roles),
        mut places: Vec<[f64; 2]>,
    ) -> Vec<Disc> {
        let mut discs: Vec<Disc> = Vec::new();
        for _ in 0..REST_MOST {
            let Some([x, y]) = places.first().copied() else {
                break;
            };
            let apart = |one: &[f64; 2], [x, y]: [f64; 2]| (one[0] - x).hypot(one[1] - y);
            let found = self.disc(x, y).ok();
            let found = found.and_then(|disc| {
                let piece = self.coloured(picture, colours, &disc)?;
                Some(Disc { piece, ..disc })
            });
            let (middle, reach) = match &found {
                Some(disc) => ([disc.file, disc.rank], DISC),
                None => ([x, y], 0.5 * DISC),
            };
            places.retain(|place| apart(place, middle) > reach && *place != [x, y]);
            let known = |disc: &Disc| {
                let mut others = discs.iter();
                others.any(|other| apart(&[other.file, other.rank], [disc.file, disc.rank]) < DISC)
            };
            if let Some(disc) = found.filter(|disc| !known(disc)) {
                discs.push(disc);
            }
        }
        discs
    }

    fn by_light(&self, picture: &Picture, file: i32, rank: i32) -> Option<Field> {
        let (dark, contrast) = self.surroundings(file, rank)?;
        let square = self.square(picture, file, rank)?;
        let (mut rim, mut mark, mut tints) = (Vec::new(), Vec::new(), Vec::new());
        for ([x, y], far) in Self::places(file, rank) {
            let difference = (self.at(x, y)? - dark) / contrast;
            if far >= RIM {
                rim.push(difference);
                tints.push(tint(self.colour(picture, x, y)?, square) / contrast);
            } else if far <= MARK {
                mark.push(difference);
            }
        }
        let middle = median(&mut rim)?;
        let share = |of: &dyn Fn(f64) -> bool| {
            rim.iter().filter(|one| of(**one)).count() as f64 / rim.len() as f64
        };
        // Of places that have another colour most are clearly so.
        let tinted =
            tints.iter().filter(|tint| **tint > 0.5 * TINTED).count() as f64 / tints.len() as f64;
        let colour = median(&mut tints)?;
        if colour > TINTED && (-SAME..PALE).contains(&middle) {
            let marked = (median(&mut mark)? - middle).abs() > MARKED;
            return (tinted >= ALIKE).then(|| Field {
                piece: piece(false, marked),
                confidence: ((colour - TINTED) / TINTED).min(1.0) * tinted,
            });
        }
        if middle.abs() <= SAME {
            let alike = share(&|one| one.abs() < 2.0 * SAME);
            let margin = 1.0 - middle.abs() / SAME;
            return (alike >= ALIKE).then_some(Field {
                piece: Piece::Empty,
                confidence: margin * alike,
            });
        }
        let alike = share(&|one| one * middle > 0.0 && one.abs() > SAME);
        let margin = ((middle.abs() - SAME) / SAME).min(1.0);
        let marked = (median(&mut mark)? - middle).abs() > MARKED;
        (alike >= ALIKE).then_some(Field {
            piece: piece(middle > 0.0, marked),
            confidence: margin * alike,
        })
    }

    fn by_colour(
        &self,
        picture: &Picture,
        classes: &Classes,
        roles: &Roles,
        file: i32,
        rank: i32,
    ) -> Option<Field> {
        self.surroundings(file, rank)?;
        let (mut all, mut rim) = (0.0, [0.0; 3]);
        let (mut marks, mut mark) = (0.0, [0.0; 3]);
        for ([x, y], far) in Self::places(file, rank) {
            let at = self.pixel(x, y).map(f64::round);
            if at[0] < 0.0 || at[1] < 0.0 {
                return None;
            }
            let found = classes.of(picture.rgb(at[0] as usize, at[1] as usize)?);
            let role = [roles.dark, roles.white, roles.black]
                .iter()
                .position(|role| found.class == Some(*role));
            let (count, shares) = match far {
                far if far >= RIM => (&mut all, &mut rim),
                far if far <= MARK => (&mut marks, &mut mark),
                _ => continue,
            };
            *count += 1.0;
            if let Some(role) = role {
                shares[role] += 1.0;
            }
        }
        let rim = rim.map(|count| count / f64::max(all, 1.0));
        let best = (0..3).max_by(|a, b| rim[*a].total_cmp(&rim[*b]))?;
        let second = (0..3)
            .filter(|other| *other != best)
            .map(|other| rim[other])
            .fold(0.0, f64::max);
        // The middle of a king is of another colour than its rim.
        let marked = mark[best] < 0.5 * marks;
        (rim[best] >= ALIKE).then(|| Field {
            piece: match best {
                0 => Piece::Empty,
                _ => piece(best == 1, marked),
            },
            confidence: rim[best] - second,
        })
    }
}

/// How far two colours are from one another, their light left out, grey values.
fn tint(one: [f64; 3], other: [f64; 3]) -> f64 {
    let apart: [f64; 3] = std::array::from_fn(|nth| one[nth] - other[nth]);
    let light = 0.2126 * apart[0] + 0.7152 * apart[1] + 0.0722 * apart[2];
    let rest = apart.iter().map(|one| (one - light).powi(2));
    rest.sum::<f64>().sqrt()
}

fn piece(white: bool, marked: bool) -> Piece {
    match (white, marked) {
        (true, false) => Piece::WhiteMan,
        (false, false) => Piece::BlackMan,
        (true, true) => Piece::WhiteKing,
        (false, true) => Piece::BlackKing,
    }
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
