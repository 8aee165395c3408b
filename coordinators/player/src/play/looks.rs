//! What is made of a look at the board.

use checkers::{Colour, Look, Sight, Status, Verdict};

use crate::{
    play::{ALL_STRAIGHT, CROWN, Play, SAID_AGAIN, STRAIGHT},
    state::{End, Phase, Task},
    wire::{Gaze, Hue, SURE, Situation, apart, centre},
};

/// After so many looks from elsewhere people are asked.
const LOOKS_AGAIN: u32 = 4;
/// What was lost is looked for so often before people are asked for it.
const SEARCHES: u32 = 3;
/// Of more squares people are not told one by one.
const MANY: usize = 8;
/// What lies so near to where a disc was is that disc, m.
const SAME_M: f64 = 0.01;
/// A disc that is farther from the middle of its square stands aside, m.
const STANDS_ASIDE_M: f64 = 0.003;

impl Play {
    /// What a look at the board means.
    pub fn judge(&mut self, seen: &Situation) {
        self.state.last.1 = self.state.last.1.saturating_add(1);
        (self.state.ready, self.state.moved) = (false, seen.moved);
        // Whether a disc still stands crooked is seen anew.
        self.state.tasks.retain(|task| !task.is_push());
        if seen.moved {
            self.beyond.clear();
            self.watch.again();
            self.tell("the board was moved: I look where it is".to_owned());
            return;
        }
        self.state.places = seen.squares.iter().map(|reading| reading.at).collect();
        let look = look(seen);
        match self.state.phase {
            Phase::Person => self.see_move(&look, seen),
            Phase::Setting | Phase::Robot => self.verify(&look, seen),
        }
    }

    /// From where vision is to look, and at what.
    #[must_use]
    pub fn gaze(&self) -> Gaze {
        let square = self.state.tasks.first().and_then(|task| match task.from {
            End::Square(square, _) => Some(square),
            _ => None,
        });
        Gaze {
            pose: self.state.gaze,
            square,
        }
    }

    /// Looks again from elsewhere; after a while people are asked.
    fn look_again(&mut self, squares: &[u8], seen: &Situation) {
        self.state.again += 1;
        self.state.gaze = (self.state.gaze + 1) % 3;
        if self.state.again <= LOOKS_AGAIN {
            return;
        }
        self.state.again = 0;
        let is_crooked = |square: &u8| {
            let reading = seen.squares.get(usize::from(*square));
            reading.is_some_and(|reading| reading.disc.is_some())
        };
        let crooked = squares.iter().copied().filter(is_crooked);
        let crooked: Vec<u8> = crooked.collect();
        // Where most of them are discs that stand aside, nothing is dark: the board was moved under them.
        let is_aside = |square: &&u8| {
            let reading = seen.squares.get(usize::from(**square));
            reading.is_some_and(|reading| apart(reading.at, centre(**square)) > STANDS_ASIDE_M)
        };
        let are_many = squares.len() > MANY;
        let are_aside = 2 * crooked.iter().filter(is_aside).count() > squares.len();
        let is_dark = are_many && !are_aside;
        if !are_many
            && !self.dry
            && self.state.pushed < self.pushes
            && let Some(square) = crooked.first()
            && let Some(hue) = seen
                .squares
                .get(usize::from(*square))
                .and_then(|at| at.disc)
        {
            self.state.pushed += 1;
            self.state.tasks.insert(0, Task::push(*square, hue));
            self.state.ready = true;
            self.tell(format!(
                "I push the disc on {} to the middle",
                self.number(*square)
            ));
            return;
        }
        self.state.shown.clone_from(&crooked);
        let words = if is_dark {
            "it is too dark: I cannot see the board well".to_owned()
        } else if crooked.is_empty() {
            format!(
                "I cannot see {} well",
                self.numbers(squares.iter().copied())
            )
        } else if are_many {
            format!("the discs stand crooked: {ALL_STRAIGHT}")
        } else {
            let numbers = self.numbers(crooked);
            format!("a disc stands crooked: {STRAIGHT}{numbers}")
        };
        self.say(words);
    }

    fn see_move(&mut self, look: &Look, seen: &Situation) {
        let before = *self.game.position();
        match self.watch.see(look, &before, self.game.variant()) {
            Verdict::NotFinal if look.hand => self.hand_is_seen(),
            Verdict::NotFinal => {}
            Verdict::Waiting => {
                (self.state.again, self.state.gaze, self.state.pushed) = (0, 0, 0);
                if self.state.last.1 >= SAID_AGAIN {
                    self.say("your turn".to_owned());
                }
            }
            Verdict::Unsure(squares) => self.look_again(&squares, seen),
            Verdict::Rejected(reason, squares) => {
                self.state.shown = squares;
                self.say(format!("not accepted: {reason}"));
            }
            Verdict::Accepted(step) => {
                self.watch.again();
                (self.state.again, self.state.gaze, self.state.pushed) = (0, 0, 0);
                let tasks = self.play(step);
                // The person has carried the piece and what it captured; a crown is stacked for the person.
                let crowns = |task: &Task| matches!(task.to, End::Square(_, 1));
                self.state.tasks = tasks.into_iter().filter(crowns).collect();
                if self.dry && !self.state.tasks.is_empty() {
                    self.state.tasks.clear();
                    self.state.asked = Some(CROWN.to_owned());
                    self.say(CROWN.to_owned());
                }
                let position = self.game.position();
                self.state.expected = [position.white, position.black];
                self.state.phase = Phase::Robot;
            }
        }
    }

    /// By square: how surely it was seen to be as it is believed.
    #[must_use]
    pub fn agreement(&self, seen: &Situation) -> Vec<f64> {
        let [white, black] = self.state.expected;
        let agrees = |(square, reading): (u8, &crate::wire::Reading)| {
            let bit = 1 << square;
            let expected = match (white & bit != 0, black & bit != 0) {
                (true, _) => Some(Hue::Light),
                (_, true) => Some(Hue::Dark),
                _ => None,
            };
            if reading.disc == expected {
                reading.confidence
            } else {
                1.0 - reading.confidence
            }
        };
        (0..32_u8).zip(&seen.squares).map(agrees).collect()
    }

    fn hand_is_seen(&mut self) {
        self.state.again += 1;
        if self.state.again > 3 * LOOKS_AGAIN {
            self.state.again = 0;
            self.say("please take your hand away".to_owned());
        }
    }

    /// Whether the board is as it should be before the next thing is done.
    fn verify(&mut self, look: &Look, seen: &Situation) {
        if look.hand {
            return self.hand_is_seen();
        }
        if let Some(task) = self.state.tasks.first().copied()
            && task.from == End::Lost
        {
            return self.search(task, look, seen);
        }
        let [white, black] = self.state.expected;
        let (mut wrong, mut unsure) = (Vec::new(), Vec::new());
        for (square, sight) in (0_u8..).zip(&look.squares) {
            let bit = 1 << square;
            let expected = match (white & bit != 0, black & bit != 0) {
                (true, _) => Some(Colour::White),
                (_, true) => Some(Colour::Black),
                _ => None,
            };
            if sight.confidence < SURE {
                unsure.push(square);
            } else if sight.piece != expected {
                wrong.push((square, expected));
            }
        }
        if !wrong.is_empty() {
            // A look while somebody is at it is not the last word.
            self.state.again += 1;
            if let Some(asked) = self.state.asked.clone().filter(|_| self.dry) {
                self.say(asked);
            } else if self.state.again > 1 {
                self.state.shown = wrong.iter().map(|(square, _)| *square).collect();
                let words = self.wrong(&wrong, look);
                self.say(words);
            }
            return;
        }
        if !unsure.is_empty() {
            return self.look_again(&unsure, seen);
        }
        (self.state.again, self.state.gaze, self.state.pushed) = (0, 0, 0);
        self.state.asked = None;
        self.watch.again();
        let begins = self.state.phase == Phase::Setting;
        if begins {
            let name = self.game.variant().name();
            let who = match self.ours {
                Some(ours) => format!("you play {}", ours.other().name()),
                None => "I play both sides".to_owned(),
            };
            self.say(format!("a new game by {name} rules: {who}"));
        }
        let playing = self.game.status() == Status::Playing;
        if !self.state.tasks.is_empty() || self.is_ours() || !playing {
            self.state.phase = Phase::Robot;
            self.state.ready = true;
        } else {
            self.state.phase = Phase::Person;
            self.say("your turn".to_owned());
        }
    }

    /// What is wrong with the board, in words.
    fn wrong(&self, wrong: &[(u8, Option<Colour>)], look: &Look) -> String {
        if self.state.phase == Phase::Setting {
            return "please set up the board".to_owned();
        }
        let before = self.before();
        let before = Look::at(&before);
        let mut as_before = look.squares.iter().zip(&before.squares);
        let last = self.state.moves.last();
        if let Some((from, to, ..)) = last
            && self
                .state
                .tasks
                .iter()
                .all(|task| matches!(task.to, End::Square(_, 1)))
            && !self.is_own_move_under_way()
            && as_before.all(|(one, other)| one.piece == other.piece)
        {
            let (from, to) = (self.number(*from), self.number(*to));
            return format!("not accepted: the move from {from} to {to} was made and stands");
        }
        let parts = wrong.iter().map(|(square, expected)| match expected {
            Some(colour) => format!(
                "a disc of {} belongs on {}",
                colour.name(),
                self.number(*square)
            ),
            None => format!("{} should be empty", self.number(*square)),
        });
        let parts: Vec<String> = parts.collect();
        format!("the board is not as it should be: {}", parts.join(", "))
    }

    fn is_own_move_under_way(&self) -> bool {
        let turn = self.game.position().turn;
        self.ours.is_none_or(|ours| ours != turn)
    }

    /// The position before the last move.
    fn before(&self) -> checkers::Position {
        let mut game = self.game.clone();
        game.take_back();
        *game.position()
    }

    /// Looks for a disc that slipped out of the hand.
    fn search(&mut self, task: Task, look: &Look, seen: &Situation) {
        let is_beyond = |at: [f64; 2]| self.beyond.iter().any(|far| apart(*far, at) < SAME_M);
        let strays = seen.strays.iter().filter(|(hue, _)| *hue == task.hue);
        let mut strays = strays.map(|(_, at)| *at).filter(|at| !is_beyond(*at));
        // The nearest first: what lies in the way would be set on otherwise.
        let mut found = match task.to {
            End::Square(to, _) => {
                let off = |at: &[f64; 2]| apart(*at, centre(to));
                strays.min_by(|one, other| off(one).total_cmp(&off(other)))
            }
            _ => strays.next(),
        };
        let [white, black] = self.state.expected;
        let own = if task.hue == Hue::Light { white } else { black };
        for (square, reading) in (0_u8..).zip(&seen.squares) {
            if reading.disc != Some(task.hue) || own & (1 << square) != 0 {
                continue;
            }
            if task.to != End::Square(square, 0) {
                found = found.or(Some(reading.at).filter(|at| !is_beyond(*at)));
                continue;
            }
            let sure = look.squares.get(usize::from(square));
            if sure.is_some_and(|sight| sight.confidence >= SURE) {
                // It has fallen where it belongs, or people have put it there.
                self.done(task);
                return;
            }
            // It stands where another one would be set on it.
            found = Some(reading.at);
            break;
        }
        self.state.found = found;
        if found.is_some() {
            self.state.searched = 0;
            self.state.ready = true;
            return;
        }
        self.state.searched += 1;
        self.state.gaze = (self.state.gaze + 1) % 3;
        if self.state.searched <= SEARCHES {
            return;
        }
        let why = match self.beyond.is_empty() {
            true => "I do not see it",
            false => "it is out of my reach",
        };
        match task.to {
            End::Square(square, 0) => {
                let (side, number) = (task.hue.colour().name(), self.number(square));
                self.say(format!("{why}: please put a disc of {side} on {number}"));
            }
            // Whatever does not stand on the board itself need not be that disc.
            End::Square(..) => {
                self.tell(format!("{why}: I take a spare disc"));
                if let Some(first) = self.state.tasks.first_mut() {
                    first.from = End::Tray;
                }
                self.beyond.clear();
            }
            _ => {
                self.tell(format!("{why}: it belongs to the captured discs"));
                self.state.tasks.remove(0);
                self.state.searched = 0;
                self.beyond.clear();
            }
        }
    }
}

/// A situation as the game watches it.
fn look(seen: &Situation) -> Look {
    let sight = |square: usize| {
        let reading = seen.squares.get(square);
        Sight {
            piece: reading.and_then(|reading| reading.disc.map(Hue::colour)),
            confidence: reading.map_or(0.0, |reading| reading.confidence),
        }
    };
    Look {
        squares: std::array::from_fn(sight),
        hand: seen.hand,
    }
}

#[cfg(test)]
mod tests {
    use checkers::{Numbering, Position, Variant};

    use super::*;
    use crate::{
        play::MIDDLE,
        wire::{Hindrance, Reading, Why},
    };

    /// A game from a position, of which nothing is to be set up.
    fn play(fen: &str) -> Play {
        let start = Position::read(fen, Variant::Brazilian, Numbering::Plain).unwrap();
        let mut play = Play::new(Variant::Brazilian, start, None);
        play.state.phase = Phase::Robot;
        play
    }

    /// What is seen where discs are as the player expects them.
    fn situation(play: &Play) -> Situation {
        let [white, black] = play.state.expected;
        let disc = |square: u8| match (white & (1 << square) != 0, black & (1 << square) != 0) {
            (true, _) => Some(Hue::Light),
            (_, true) => Some(Hue::Dark),
            _ => None,
        };
        let reading = |square: u8| Reading {
            disc: disc(square),
            confidence: 1.0,
            at: centre(square),
        };
        Situation {
            squares: (0..32).map(reading).collect(),
            strays: Vec::new(),
            hand: false,
            moved: false,
        }
    }

    /// A king goes from 32 to 18, square 17, and slips out of the hand on the way.
    fn lost() -> Play {
        let mut play = play("W:WK32:B1");
        play.state.tasks = vec![Task {
            from: End::Square(31, 0),
            to: End::Square(17, 0),
            discs: 2,
            hue: Hue::Light,
        }];
        play.aim().unwrap();
        play.held();
        play.lost();
        assert_eq!(play.state.tasks.len(), 2);
        play
    }

    #[test]
    fn of_a_king_that_fell_apart_the_disc_that_lies_where_it_was_to_go_is_no_place_for_a_third_one()
    {
        for (off, left) in [(0.0, 1), (0.02, 2)] {
            let mut play = lost();
            let mut seen = situation(&play);
            let [x, y] = centre(17);
            seen.squares[17] = Reading {
                disc: Some(Hue::Light),
                confidence: if off > 0.0 { 0.5 } else { 1.0 },
                at: [x + off, y],
            };
            seen.strays = vec![(Hue::Light, [0.0, 0.05])];
            play.judge(&seen);
            assert_eq!(play.state.tasks.len(), left);
            if left == 2 {
                assert_eq!(play.state.found, Some([x + off, y]));
            } else {
                // The other one is fetched next, and set on it.
                play.judge(&seen);
                assert_eq!(play.state.found, Some([0.0, 0.05]));
                assert_eq!(play.state.tasks[0].to, End::Square(17, 1));
            }
        }
    }

    #[test]
    fn a_lost_disc_beyond_the_arms_reach_is_left_when_nobody_brings_it_nearer_and_another_one_is_asked_for()
     {
        let mut play = lost();
        let mut seen = situation(&play);
        let lies = [0.0, 0.05];
        seen.strays = vec![(Hue::Light, lies)];
        let far = Hindrance::told(Why::OutOfReach(0));
        // Somebody has time to push the board.
        for tried in 0..SAID_AGAIN / 2 {
            play.judge(&seen);
            assert_eq!(play.state.found, Some(lies), "{tried}");
            play.hindered(&far);
            assert!(play.state.last.0.contains(MIDDLE), "{:?}", play.state.last);
        }
        for _ in 0..2 {
            play.judge(&seen);
            play.hindered(&far);
        }
        for _ in 0..=SEARCHES {
            play.judge(&seen);
            assert_eq!(play.state.found, None);
        }
        let said = &play.state.last.0;
        assert!(
            said.contains("out of my reach: please put a disc of White on 18"),
            "{said}"
        );
        // One that lies elsewhere is fetched, and all of them when the board has been moved.
        seen.strays.push((Hue::Light, [0.06, 0.0]));
        play.judge(&seen);
        assert_eq!(play.state.found, Some([0.06, 0.0]));
        seen.strays.pop();
        seen.moved = true;
        play.judge(&seen);
        seen.moved = false;
        play.judge(&seen);
        assert_eq!(play.state.found, Some(lies));
    }

    #[test]
    fn where_all_discs_stand_aside_people_are_asked_to_put_them_right_and_where_none_does_it_is_too_dark()
     {
        for (off, words) in [(0.01, ALL_STRAIGHT), (0.0, "too dark")] {
            let mut play = play("W:W21-32:B1-12");
            let mut seen = situation(&play);
            for (square, reading) in (0..).zip(&mut seen.squares) {
                let [x, y] = centre(square);
                reading.at = [x + off, y];
                if reading.disc.is_some() {
                    reading.confidence = 0.5;
                }
            }
            for _ in 0..=LOOKS_AGAIN {
                play.judge(&seen);
            }
            let said = &play.state.last.0;
            assert!(said.contains(words), "{off}: {said}");
        }
    }

    #[test]
    fn of_discs_that_were_lost_the_one_in_the_way_of_the_others_is_fetched_first() {
        let mut play = lost();
        let mut seen = situation(&play);
        let [x, y] = centre(17);
        seen.strays = vec![(Hue::Light, [0.0, 0.2]), (Hue::Light, [x + 0.023, y])];
        play.judge(&seen);
        assert_eq!(play.state.found, Some([x + 0.023, y]));
    }
}
