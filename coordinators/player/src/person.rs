//! The person of a dry game: a program that moves discs on the table with a hand, makes a person's errors, and puts them right when it
//! is told so.

use checkers::{Colour, Limits, Move, Numbering, Position, Variant, each, pdn, search};
use rand::RngExt;

use crate::{
    play::{ALL_STRAIGHT, STRAIGHT},
    player::recorded,
    table::Table,
    wire::{Hue, centre},
};

/// So many positions are looked at for a move.
const NODES: u64 = 300;

/// Errors in one turn.
const MOST_ERRORS: u32 = 2;

/// What a person does wrong.
const ERRORS: [&str; 7] = [
    "crooked",
    "pushed",
    "two moves",
    "took back",
    "took away",
    "illegal",
    "hand over",
];

/// What the person is at, and until when, s.
#[derive(Debug, Clone, PartialEq)]
enum At {
    /// Waits for words.
    Rest,
    /// Thinks about a move.
    Thinks(f64),
    /// Has a hand over the board, and does this at the end.
    Moves(f64, Deed),
    /// Holds the hand over the board for nothing.
    Hovers(f64),
    /// Takes the accepted move back, if nobody moves.
    Repents(f64),
}

#[derive(Debug, Clone, PartialEq)]
enum Deed {
    /// The board becomes so.
    Arrange(Position),
    /// The move, with an error.
    Move(Move, Option<&'static str>),
    /// A disc that was asked for.
    Put(Hue, u8),
    /// What stands crooked on these squares.
    Straighten(Vec<u8>),
}

/// A person.
pub struct Person {
    side: Colour,
    variant: Variant,
    record: Option<pdn::Record>,
    at: At,
    /// The board at the beginning of the turn, and the move that was chosen.
    base: Option<(Position, Move)>,
    errors: u32,
    /// Since when nothing was heard, s.
    heard: f64,
}

impl Person {
    /// A person who plays a side.
    #[must_use]
    pub fn new(side: Colour, variant: Variant, record: Option<pdn::Record>) -> Self {
        Self {
            side,
            variant,
            record,
            at: At::Rest,
            base: None,
            errors: 0,
            heard: 0.0,
        }
    }

    /// Hears something.
    pub fn hear(&mut self, table: &mut Table, words: &str, now: f64) {
        self.heard = now;
        for words in words.split("; ") {
            self.hear_one(table, words, now);
        }
    }

    fn hear_one(&mut self, table: &mut Table, words: &str, now: f64) {
        if words.contains("a new game") {
            (self.at, self.base) = (At::Rest, None);
            table.hand = false;
        }
        let busy = matches!(self.at, At::Moves(..) | At::Thinks(_));
        if words == "your turn" && !busy {
            if let Some((before, step)) = self.base
                && self.stands(table, &before)
            {
                // It was not seen; the same move again.
                self.reach(table, now, Deed::Move(step, None));
                return;
            }
            (self.base, self.errors) = (None, 0);
            let time = table.rng.random_range(1.5..5.0);
            self.at = At::Thinks(now + time);
        } else if words.contains("take your hand away") {
            if let At::Hovers(_) = self.at {
                self.at = At::Rest;
                table.hand = false;
                table.note();
            }
        } else if let Some(rest) = words.split("please put a disc of ").nth(1) {
            let mut parts = rest.split(" on ");
            let hue = match parts.next() {
                Some("White") => Hue::Light,
                _ => Hue::Dark,
            };
            let number = parts.next().and_then(|number| number.parse().ok());
            let numbering = Numbering::of(self.variant);
            if let Some(square) = number.and_then(|number| numbering.square(number)) {
                self.reach(table, now, Deed::Put(hue, square));
            }
        } else if let Some((_, list)) = words.split_once(STRAIGHT) {
            let numbering = Numbering::of(self.variant);
            let numbers = list.split(", ").filter_map(|number| number.parse().ok());
            let squares = numbers.filter_map(|number| numbering.square(number));
            if !matches!(self.at, At::Moves(..)) {
                self.reach(table, now, Deed::Straighten(squares.collect()));
            }
        } else if words.contains(ALL_STRAIGHT) && !matches!(self.at, At::Moves(..)) {
            self.reach(table, now, Deed::Straighten((0..32).collect()));
        } else if words.contains("not accepted") || words.contains("not as it should be") {
            self.repair(table, words, now);
        }
    }

    /// Whether the person thinks, and has no hand over the board.
    #[must_use]
    pub fn thinks(&self) -> bool {
        matches!(self.at, At::Thinks(_))
    }

    /// Whether the table is as it was.
    fn stands(&self, table: &Table, before: &Position) -> bool {
        table.squares() == [before.white, before.black, before.kings]
    }

    /// Puts right what was wrong.
    fn repair(&mut self, table: &mut Table, words: &str, now: f64) {
        if matches!(self.at, At::Moves(..)) {
            return;
        }
        if words.contains("not as it should be") {
            let (numbering, now_there) = (Numbering::of(self.variant), table.position(self.side));
            // A man on the last row is crowned by the robot.
            let known = self.base.map(|(before, step)| placed(&before, step));
            let asked = asked(words, &now_there, &known.unwrap_or(now_there), numbering);
            self.reach(table, now, Deed::Arrange(asked));
            return;
        }
        let Some((before, step)) = self.base else {
            return;
        };
        if !words.contains("stands") {
            self.reach(table, now, Deed::Move(step, None));
            return;
        }
        // What was accepted; a crown that the robot has stacked already stays.
        let mut after = before.after(step);
        let [.., kings] = table.squares();
        if step.crowned && kings & (1 << step.to) == 0 {
            after.kings &= !(1 << step.to);
        }
        self.reach(table, now, Deed::Arrange(after));
    }

    /// The hand goes over the board, unless the arm is there.
    fn reach(&mut self, table: &mut Table, now: f64, deed: Deed) {
        let time = table.rng.random_range(0.8..2.0);
        self.at = At::Moves(now + time, deed);
        self.show(table);
    }

    fn show(&self, table: &mut Table) {
        let over = matches!(self.at, At::Moves(..) | At::Hovers(_));
        table.hand = over && table.arm.is_none() && !table.moving;
    }

    /// Time passes.
    pub fn tick(&mut self, table: &mut Table, now: f64) {
        let free = table.arm.is_none() && !table.moving;
        match self.at.clone() {
            At::Thinks(until) if now >= until => self.think(table, now),
            At::Moves(until, deed) if now >= until => {
                // Nobody reaches under a moving arm.
                if !free || !table.hand {
                    self.at = At::Moves(now + 1.0, deed);
                    self.show(table);
                    return;
                }
                self.act(table, now, deed);
                self.show(table);
                table.note();
            }
            At::Hovers(until) if now >= until => {
                self.at = At::Rest;
                self.show(table);
                table.note();
            }
            At::Repents(until) if now >= until => {
                self.at = At::Rest;
                if let Some((before, step)) = self.base
                    && free
                    && self.stands(table, &placed(&before, step))
                {
                    table.set_up(&before);
                    table.truth.errors.push("took back".to_owned());
                    table.note();
                }
            }
            _ => {}
        }
    }

    fn think(&mut self, table: &mut Table, now: f64) {
        let position = table.position(self.side);
        let moves = position.moves(self.variant);
        let played = self.recorded(&position);
        let mut never = || false;
        let limits = Limits {
            nodes: Some(NODES),
            depth: 99,
            stop: &mut never,
        };
        let found = || {
            search(&position, self.variant, &[], None, limits)
                .line
                .first()
                .copied()
        };
        // Now and then not the best move, so that no two games are the same.
        let any = table.rng.random_bool(0.2);
        let drawn = table.rng.random_range(0..moves.len().max(1));
        let drawn = moves.get(drawn).copied().filter(|_| any);
        let Some(step) = played.or(drawn).or_else(found) else {
            self.at = At::Rest;
            return;
        };
        self.base = Some((position, step));
        let wrong = table.rng.random_bool(table.chances.errors) && self.errors < MOST_ERRORS;
        let kind = table.rng.random_range(0..ERRORS.len());
        let error = ERRORS.get(kind).copied().filter(|_| wrong);
        self.reach(table, now, Deed::Move(step, error));
    }

    /// The move of the record in a position.
    fn recorded(&self, position: &Position) -> Option<Move> {
        let record = self.record.as_ref()?;
        let mut at = record.start;
        for (ply, step) in record.moves.iter().enumerate() {
            if at == *position {
                return recorded(record.moves.get(..ply)?, Some(record));
            }
            at = at.after(*step);
        }
        None
    }

    fn act(&mut self, table: &mut Table, now: f64, deed: Deed) {
        self.at = At::Rest;
        match deed {
            Deed::Arrange(position) => {
                table.set_up(&position);
                count(table);
            }
            Deed::Put(hue, square) => {
                if table.on(square).is_none() && table.take_stray(hue) {
                    let stack = crate::table::Stack {
                        on_board: true,
                        at: centre(square),
                        discs: vec![hue],
                    };
                    table.stacks.push(stack);
                }
            }
            Deed::Straighten(squares) => table.straighten(&squares),
            Deed::Move(step, error) => {
                let Some((before, _)) = self.base else {
                    return;
                };
                self.play(table, &before, step, error, now);
                count(table);
            }
        }
    }

    /// Makes a move, with an error.
    fn play(
        &mut self,
        table: &mut Table,
        before: &Position,
        step: Move,
        error: Option<&'static str>,
        now: f64,
    ) {
        let after = placed(before, step);
        table.set_up(&after);
        let Some(error) = error else { return };
        self.errors += 1;
        let foe = after.side(self.side.other());
        let empty: Vec<u8> = each(after.empty()).collect();
        let near = |from: u8| {
            let near = |square: &&u8| crate::wire::apart(centre(**square), centre(from)) < 0.09;
            empty.iter().find(near).copied()
        };
        let shift = |position: &Position, from: u8, to: u8| {
            let moved = |set: u32| match set & (1 << from) {
                0 => set,
                _ => (set & !(1 << from)) | (1 << to),
            };
            Position {
                white: moved(position.white),
                black: moved(position.black),
                kings: moved(position.kings),
                turn: position.turn,
            }
        };
        let mut told = true;
        match error {
            "crooked" => {
                if let Some(at) = table.on(step.to).and_then(|at| table.stacks.get_mut(at)) {
                    at.at[0] += 0.015;
                    at.at[1] -= 0.008;
                }
            }
            "pushed" => {
                let pushed = each(foe).find_map(|from| Some((from, near(from)?)));
                match pushed {
                    Some((from, to)) => table.set_up(&shift(&after, from, to)),
                    None => told = false,
                }
            }
            "two moves" => {
                let again = Position {
                    turn: self.side,
                    ..after
                };
                let moves = again.moves(self.variant);
                match moves.iter().find(|second| second.from != step.to) {
                    Some(second) => table.set_up(&placed(&again, *second)),
                    None => told = false,
                }
            }
            "took back" => {
                let time = table.rng.random_range(1.5..4.0);
                self.at = At::Repents(now + time);
                told = false;
            }
            "took away" => match each(foe).next() {
                Some(from) => {
                    let left = !(1 << from);
                    let position = Position {
                        white: after.white & left,
                        black: after.black & left,
                        kings: after.kings & left,
                        turn: after.turn,
                    };
                    table.set_up(&position);
                }
                None => told = false,
            },
            "illegal" => {
                let from = each(before.side(self.side)).next();
                let moves = before.moves(self.variant);
                let legal = |to: u8| {
                    moves
                        .iter()
                        .any(|step| Some(step.from) == from && step.to == to)
                };
                let to = each(before.empty()).find(|to| !legal(*to));
                match (from, to) {
                    (Some(from), Some(to)) => table.set_up(&shift(before, from, to)),
                    _ => told = false,
                }
            }
            _ => {
                let time = table.rng.random_range(8.0..20.0);
                self.at = At::Hovers(now + time);
            }
        }
        if told {
            table.truth.errors.push(error.to_owned());
        }
    }
}

/// The board when a person has made a move: a man that arrives is crowned by the robot.
fn placed(before: &Position, step: Move) -> Position {
    let mut after = before.after(step);
    if step.crowned {
        after.kings &= !(1 << step.to);
    }
    after
}

/// The board when a person has done what was asked, and no more: others may have moved meanwhile. A piece that was moved, or that
/// the person knows, stays a king.
fn asked(words: &str, now: &Position, known: &Position, numbering: Numbering) -> Position {
    let mut after = *now;
    let mut crowned = [false; 2];
    let number = |text: &str| text.trim().parse().ok();
    let square = |text: &str| number(text).and_then(|number| numbering.square(number));
    let (_, list) = words.split_once("be: ").unwrap_or_default();
    for at in list
        .split(", ")
        .filter_map(|part| square(part.strip_suffix(" should be empty")?))
    {
        let bit = 1 << at;
        let [white, black] = &mut crowned;
        *white |= now.white & now.kings & bit != 0;
        *black |= now.black & now.kings & bit != 0;
        after.white &= !bit;
        after.black &= !bit;
        after.kings &= !bit;
    }
    for (side, at) in list.split(", ").filter_map(|part| {
        let (colour, at) = part
            .strip_prefix("a disc of ")?
            .split_once(" belongs on ")?;
        let side = if colour == "White" {
            Colour::White
        } else {
            Colour::Black
        };
        Some((side, square(at)?))
    }) {
        let bit = 1 << at;
        let is_light = side == Colour::White;
        let [white, black] = crowned;
        let was_king = if is_light { white } else { black };
        let king = match known.side(side) & bit != 0 {
            true => known.kings & bit != 0,
            false => was_king,
        };
        after.white = (after.white & !bit) | (u32::from(is_light) << at);
        after.black = (after.black & !bit) | (u32::from(!is_light) << at);
        after.kings = (after.kings & !bit) | (u32::from(king) << at);
    }
    after
}

/// What the person has taken from the board is kept aside: no disc comes or goes.
pub fn count(table: &mut Table) {
    let truth = table.truth();
    for (hue, total) in [(Hue::Light, truth.discs[0]), (Hue::Dark, truth.discs[1])] {
        let missing = 24_u32.saturating_sub(total);
        table.away.extend((0..missing).map(|_| hue));
        for _ in 24..total {
            if let Some(found) = table.away.iter().position(|other| *other == hue) {
                table.away.remove(found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::table::{Chances, Stack};

    fn position(fen: &str) -> Position {
        Position::read(fen, Variant::Brazilian, Numbering::Plain).unwrap()
    }

    #[test]
    fn a_person_who_took_a_move_back_puts_it_right_and_leaves_what_the_robot_has_moved_meanwhile() {
        let words =
            "the board is not as it should be: a disc of White belongs on 17, 21 should be empty";
        // Since White moved from 21 to 17 and took it back, the robot has moved from 2 to 6.
        let now = position("W:W21,K32:B6,K9");
        let known = position("B:W17,K32:B2,K9");
        let after = asked(words, &now, &known, Numbering::Plain);
        assert_eq!(after, position("W:W17,K32:B6,K9"));
        let moved =
            "the board is not as it should be: a disc of Black belongs on 13, 9 should be empty";
        let after = asked(moved, &after, &known, Numbering::Plain);
        assert_eq!(after, position("W:W17,K32:B6,K13"));
    }

    #[test]
    fn a_king_that_a_person_took_away_is_put_back_as_a_king() {
        let words = "the board is not as it should be: a disc of Black belongs on 9";
        let after = asked(
            words,
            &position("W:W17:B6"),
            &position("B:W17:B6,K9"),
            Numbering::Plain,
        );
        assert_eq!(after, position("W:W17:B6,K9"));
    }

    #[test]
    fn a_disc_that_people_are_asked_for_lies_elsewhere_or_else_on_no_square() {
        let rng = ChaCha8Rng::seed_from_u64(1);
        let mut table = Table::new(Chances::default(), Position::start(Colour::White), rng);
        table.away = vec![Hue::Light];
        assert!(table.take_stray(Hue::Light));
        assert!(table.away.is_empty());
        assert!(!table.take_stray(Hue::Light), "all stand on squares");
        table.stacks.push(Stack {
            on_board: true,
            at: [0.0; 2],
            discs: vec![Hue::Light],
        });
        assert!(!table.take_stray(Hue::Dark));
        assert!(table.take_stray(Hue::Light) && !table.take_stray(Hue::Light));
    }
}
