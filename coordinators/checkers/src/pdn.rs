//! Whole games in files: PDN 3.0 (wiegerw.github.io/pdn).
//!
//! Comments, variations and annotations are passed over; results are kept as they are written, since in English collections `1-0` can
//! mean that Black won. A wrong game does not hide the others of its file.

#[cfg(test)]
mod tests;
mod tokens;

use crate::{
    board::{Colour, Position},
    moves::Move,
    notation::{Numbering, TextError, Written},
    rules::Variant,
};
use tokens::{Token, What, tokens};

/// A longer file of games is not read, bytes.
pub const LONGEST_FILE: usize = 16 << 20;

/// A game.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// Names and values, in their order.
    pub tags: Vec<(String, String)>,
    /// The rules.
    pub variant: Variant,
    /// Where it began.
    pub start: Position,
    /// What was played.
    pub moves: Vec<Move>,
    /// The result as it is written, `*` when none is.
    pub result: String,
}

impl Record {
    /// The position at the end.
    #[must_use]
    pub fn end(&self) -> Position {
        let steps = self.moves.iter();
        steps.fold(self.start, |position, step| position.after(*step))
    }

    /// The game as PDN. A capture has all its landings where its ends are not enough.
    #[must_use]
    pub fn write(&self) -> String {
        let numbering = Numbering::of(self.variant);
        let sign = if self.variant == Variant::Russian {
            ':'
        } else {
            'x'
        };
        let mut text = String::new();
        let known = |name: &str| self.tags.iter().any(|(other, _)| other == name);
        let mut tag = |name: &str, value: &str| {
            let value = value.replace('\\', "\\\\").replace('"', "\\\"");
            text.push_str(&format!("[{name} \"{value}\"]\n"));
        };
        for (name, value) in &self.tags {
            // These three follow from the game.
            if !["GameType", "FEN", "Result"].contains(&name.as_str()) {
                tag(name, value);
            }
        }
        tag("GameType", &self.variant.game_type().to_string());
        if self.start != Position::start(self.variant.starts()) {
            if !known("SetUp") {
                tag("SetUp", "1");
            }
            tag("FEN", &self.start.fen(numbering));
        }
        tag("Result", &self.result);
        text.push('\n');
        let mut words = Vec::new();
        let mut position = self.start;
        let mut number = 1;
        for (index, step) in self.moves.iter().enumerate() {
            let first = index == 0 && position.turn != self.variant.starts();
            if position.turn == self.variant.starts() {
                words.push(format!("{number}."));
            } else if first {
                words.push(format!("{number}..."));
            }
            if position.turn != self.variant.starts() {
                number += 1;
            }
            words.push(word(&position, *step, self.variant, numbering, sign));
            position = position.after(*step);
        }
        words.push(self.result.clone());
        let mut column = 0;
        for (index, word) in words.iter().enumerate() {
            let space = index > 0;
            if space && column + 1 + word.len() > 79 {
                text.push('\n');
                column = 0;
            } else if space {
                text.push(' ');
                column += 1;
            }
            text.push_str(word);
            column += word.len();
        }
        text.push('\n');
        text
    }
}

/// A move as PDN writes it: its ends, or all its landings where others have the same ends.
fn word(
    position: &Position,
    step: Move,
    variant: Variant,
    numbering: Numbering,
    sign: char,
) -> String {
    let moves = position.moves(variant);
    let same = |other: &&Move| other.from == step.from && other.to == step.to;
    if moves.iter().filter(same).count() <= 1 {
        return numbering.short(step, sign);
    }
    let routes = position.routes(variant);
    let route = routes.iter().filter(|route| route.step == step);
    let words = route.map(|route| numbering.route(route, sign));
    // One that is read back as this move.
    let clear = |word: &String| {
        let written = Written::read(word, numbering).ok();
        written.and_then(|written| position.find(&written, variant, numbering).ok()) == Some(step)
    };
    let mut words: Vec<String> = words.collect();
    words.sort();
    let found = words
        .iter()
        .find(|word| clear(word))
        .or(words.first())
        .cloned();
    found.unwrap_or_else(|| numbering.short(step, sign))
}

/// Reads the games of a text, each as it is or with what is wrong with it first.
#[must_use]
pub fn read(text: &str, variant: Variant) -> Vec<Result<Record, TextError>> {
    if text.len() > LONGEST_FILE {
        let reason = format!("a file of games has at most {LONGEST_FILE} bytes");
        return vec![Err(TextError::at(text, 0, reason))];
    }
    let tokens = tokens(text);
    let mut games = Vec::new();
    let mut begin = 0;
    let mut moved = false;
    for (index, token) in tokens.iter().enumerate() {
        let end = match token.what {
            What::Tag(..) if moved => index,
            What::Result => index + 1,
            What::Tag(..) => continue,
            _ => {
                moved = true;
                continue;
            }
        };
        games.push(tokens.get(begin..end).unwrap_or_default());
        begin = end;
        moved = false;
    }
    let rest = tokens.get(begin..).unwrap_or_default();
    if !rest.is_empty() {
        games.push(rest);
    }
    games
        .into_iter()
        .map(|game| record(game, variant))
        .collect()
}

/// What a game's tags say about its kind.
struct Kind {
    variant: Variant,
    starts: Colour,
    numbering: Numbering,
}

fn record(game: &[Token<'_>], variant: Variant) -> Result<Record, TextError> {
    let mut kind = Kind {
        variant,
        starts: variant.starts(),
        numbering: Numbering::of(variant),
    };
    let mut tags = Vec::new();
    let mut fen = None;
    for token in game {
        let What::Tag(name, value) = &token.what else {
            continue;
        };
        if name == "GameType" {
            kind = game_type(value).map_err(|reason| token.wrong(reason))?;
        }
        if name == "FEN" {
            fen = Some((token, value));
        }
        tags.push((name.clone(), value.clone()));
    }
    let start = match fen {
        None => Position::start(kind.starts),
        Some((token, value)) => {
            Position::read(value, kind.variant, kind.numbering).map_err(|error| {
                let reason = format!("FEN, at its character {}: {}", error.column, error.reason);
                token.wrong(reason)
            })?
        }
    };
    let mut position = start;
    let mut moves = Vec::new();
    let mut result = None;
    for token in game {
        match &token.what {
            What::Tag(..) => {}
            What::Wrong(reason) => return Err(token.wrong(reason.clone())),
            What::Result => result = Some(token.text.to_owned()),
            What::Move => {
                let step = Written::read(token.text, kind.numbering)
                    .map_err(|error| token.inside(&error))
                    .and_then(|written| {
                        let found = position.find(&written, kind.variant, kind.numbering);
                        found.map_err(|refusal| token.wrong(format!("{}: {refusal}", token.text)))
                    })?;
                moves.push(step);
                position = position.after(step);
            }
        }
    }
    let tagged = tags.iter().find(|(name, _)| name == "Result");
    let result = result.or(tagged.map(|(_, value)| value.clone()));
    Ok(Record {
        tags,
        variant: kind.variant,
        start,
        moves,
        result: result.unwrap_or_else(|| "*".to_owned()),
    })
}

/// Reads the tag `GameType`: `25`, or `25,W,8,8,A0,0`.
fn game_type(value: &str) -> Result<Kind, String> {
    let mut parts = value.split(',').map(str::trim);
    let number = parts.next().unwrap_or_default();
    let variant = number.parse().ok().and_then(Variant::of_game_type);
    let Some(variant) = variant else {
        let shown: String = number.chars().take(12).collect();
        return Err(format!(
            "GameType {shown} is not played here: 21 English, 22 Italian, 23 pool, 24 Spanish, 25 Russian, 26 Brazilian, \
             28 Portuguese, 29 Czech"
        ));
    };
    let mut kind = Kind {
        variant,
        starts: variant.starts(),
        numbering: Numbering::of(variant),
    };
    let rest: Vec<&str> = parts.collect();
    let (starts, notation, inverted) = match rest.as_slice() {
        [] => return Ok(kind),
        [starts, "8", "8", notation] => (*starts, *notation, None),
        [starts, "8", "8", notation, inverted] => (*starts, *notation, Some(*inverted)),
        _ => return Err("GameType has the form 25,W,8,8,A0,0, with a board of 8,8".to_owned()),
    };
    kind.starts = match starts {
        "W" => Colour::White,
        "B" => Colour::Black,
        other => return Err(format!("GameType: W or B starts, not {other}")),
    };
    let mirrored = match inverted {
        None => kind.numbering != Numbering::Plain,
        Some("0") => false,
        Some("1") => true,
        Some(other) => return Err(format!("GameType: the invert flag is 0 or 1, not {other}")),
    };
    // Square 1 stands to the right of the side that starts, or to the left of the other one, which is the same corner.
    let turned = matches!((notation, kind.starts), ("N1", Colour::White));
    kind.numbering = match (mirrored, turned) {
        (false, false) => Numbering::Plain,
        (true, false) => Numbering::Mirrored,
        (true, true) => Numbering::Turned,
        (false, true) => {
            return Err("GameType: N1 with W needs the invert flag 1".to_owned());
        }
    };
    Ok(kind)
}
