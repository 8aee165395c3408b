//! What the player knows of a game, and what it makes of a look at the board: pure, and stored as it is.

use checkers::{
    Carry, Colour, Game, Heaps, Look, Move, Numbering, Place, Position, Refusal, Sight, Status,
    Variant, Verdict, Watch,
};
use serde::{Deserialize, Serialize};

use crate::{
    referee::{A_DISC, LOST, TWO_DISCS},
    wire::{Errand, Gaze, Hindrance, Hue, SURE, Situation, Spot, Why, centre},
};

/// After so many looks from elsewhere people are asked.
const LOOKS_AGAIN: u32 = 4;
/// After so many looks the same is said once more.
const SAID_AGAIN: u32 = 25;
/// Discs of each colour that are no part of the game at its beginning.
pub const SPARE: u8 = 12;
/// What was lost is looked for so often before people are asked for it.
const SEARCHES: u32 = 3;

/// What people are asked for when the arm cannot go on.
pub(crate) const MIDDLE: &str = "please push the board to the middle of the table";
pub(crate) const POWER: &str = "please switch it on";

/// What is expected next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// People set up the discs.
    Setting,
    /// The person moves.
    Person,
    /// The robot moves, or stacks a crown.
    Robot,
}

/// What is still to be carried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Task {
    /// What to do with the disc.
    pub from: End,
    /// Where it comes to stand.
    pub to: End,
    /// One disc or two.
    pub discs: u8,
    /// Whose disc it is.
    pub hue: Hue,
}

impl Task {
    /// A disc that is pushed to the middle of its square.
    const fn push(square: u8, hue: Hue) -> Self {
        Self {
            from: End::Square(square, 0),
            to: End::Square(square, 0),
            discs: 1,
            hue,
        }
    }

    /// Whether it is one.
    fn is_push(&self) -> bool {
        self.from == self.to
    }
}

/// An end of a carry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// A square, and how many discs stand beneath.
    Square(u8, u8),
    /// The tray of captured discs, or the spare ones when it is empty.
    Tray,
    /// Nobody knows: it slipped out of the hand.
    Lost,
}

/// A move as it is stored: from, to, whether crowned, and what was captured.
pub type Step = (u8, u8, bool, u32);

/// A stored move.
pub fn step_of((from, to, crowned, captured): Step) -> Move {
    Move {
        from,
        to,
        crowned,
        captured,
    }
}

/// A game after moves that were stored; `game` is as it begins.
///
/// # Errors
/// One of them is not legal.
pub fn replayed(mut game: Game, moves: &[Step]) -> Result<Game, Refusal> {
    for step in moves {
        game.make(step_of(*step))?;
    }
    Ok(game)
}

/// A game as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The first position, FEN.
    pub start: String,
    pub moves: Vec<Step>,
    /// How it ended otherwise than by the rules: who gave up; `None` inside when both agreed.
    pub ended: Option<Option<Hue>>,
    /// What is expected next.
    pub phase: Phase,
    /// The present carry first.
    pub tasks: Vec<Task>,
    /// The squares where White's and Black's discs should stand now.
    pub expected: [u32; 2],
    /// Discs in each place of the trays of White's and Black's discs, and those that are no part of the game.
    pub trays: [Vec<u8>; 2],
    pub spare: [u8; 2],
    /// The errand in work.
    pub errand: Errand,
    /// What is to be said, and the number of it.
    pub words: Vec<String>,
    pub said: u32,
    /// What was said last, and how many looks ago.
    pub last: (String, u32),
    /// The wish that was taken up last.
    pub wish: u32,
    /// From which pose it looks, and how often it has looked again.
    pub gaze: u8,
    /// What vision was told of it last.
    pub told: Option<Gaze>,
    pub again: u32,
    /// How often crooked discs were pushed since all stood well.
    pub pushed: u32,
    /// How often what was lost has been looked for, and where it lies.
    pub searched: u32,
    pub found: Option<[f64; 2]>,
    /// How often the hand found nothing.
    pub missed: u32,
    /// Whether it holds something, and what kept the arm from its way last.
    pub holds: bool,
    pub why: Option<Why>,
    /// What the look was good for.
    pub moved: bool,
    pub ready: bool,
    /// Where discs stand, in the board's frame.
    pub places: Vec<[f64; 2]>,
}

/// A game, its state, and how it is watched.
pub struct Play {
    pub game: Game,
    pub state: State,
    pub watch: Watch,
    /// The first position.
    pub start: Position,
    /// Whose discs the robot moves; `None` for both.
    pub ours: Option<Colour>,
    /// So often in a row a crooked disc is pushed before people are asked.
    pub pushes: u32,
}

impl Play {
    /// A new game.
    #[must_use]
    pub fn new(variant: Variant, start: Position, ours: Option<Colour>) -> Self {
        let game = Game::from(variant, start);
        let spot = Spot::Spare(Hue::Light);
        let errand = Errand {
            number: 0,
            from: spot,
            to: spot,
            discs: 1,
            below: [0; 2],
            push: false,
        };
        let position = game.position();
        let state = State {
            start: start.fen(Numbering::of(variant)),
            moves: Vec::new(),
            ended: None,
            phase: Phase::Setting,
            tasks: Vec::new(),
            expected: [position.white, position.black],
            trays: [vec![0; 12], vec![0; 12]],
            spare: [SPARE; 2],
            errand,
            words: Vec::new(),
            said: 0,
            last: (String::new(), 0),
            wish: 0,
            gaze: 0,
            told: None,
            again: 0,
            pushed: 0,
            searched: 0,
            found: None,
            missed: 0,
            holds: false,
            why: None,
            moved: false,
            ready: false,
            places: (0..32).map(centre).collect(),
        };
        let mut watch = Watch::default();
        watch.sure = SURE;
        Self {
            game,
            state,
            watch,
            start,
            ours,
            pushes: 0,
        }
    }

    /// Goes on with a game that was stored.
    pub fn restore(&mut self, state: State) {
        let variant = self.game.variant();
        let start = Position::read(&state.start, variant, Numbering::of(variant));
        match start {
            Ok(start) => self.start = start,
            Err(error) => tracing::error!(%error, "a stored position is none"),
        }
        match replayed(Game::from(variant, self.start), &state.moves) {
            Ok(game) => self.game = game,
            Err(refusal) => tracing::error!(%refusal, "a stored move is not legal"),
        }
        match state.ended {
            Some(Some(hue)) => self.game.resign(hue.colour()),
            Some(None) => self.game.agree(),
            None => {}
        }
        self.state = state;
        self.watch.again();
    }

    fn number(&self, square: u8) -> u8 {
        Numbering::of(self.game.variant()).number(square)
    }

    fn numbers(&self, squares: impl IntoIterator<Item = u8>) -> String {
        let numbers = squares.into_iter();
        let numbers: Vec<String> = numbers.map(|at| self.number(at).to_string()).collect();
        numbers.join(", ")
    }

    /// Says something; the same again only after a while.
    fn say(&mut self, words: String) {
        if self.state.last.0 == words && self.state.last.1 < SAID_AGAIN {
            return;
        }
        self.state.last = (words.clone(), 0);
        self.state.words.push(words);
    }

    /// A new game, by whoever the board is set up; what counts on goes on.
    pub fn again(&mut self) {
        let (before, pushes) = (self.state.clone(), self.pushes);
        *self = Self::new(self.game.variant(), self.start, self.ours);
        self.pushes = pushes;
        self.state.errand.number = before.errand.number;
        (self.state.said, self.state.wish) = (before.said, before.wish);
    }

    /// Whether a wish can be taken up: nothing is carried.
    #[must_use]
    pub fn listens(&self) -> bool {
        self.state.tasks.is_empty()
            && self.state.phase != Phase::Setting
            && self.game.status() == Status::Playing
    }

    /// A side gives up, or both agree that nobody wins.
    pub fn end(&mut self, given_up: Option<Hue>) {
        self.state.ended = Some(given_up);
        match given_up {
            Some(hue) => self.game.resign(hue.colour()),
            None => self.game.agree(),
        }
        self.state.ready = true;
    }

    /// Whether the robot moves for the side whose turn it is.
    #[must_use]
    pub fn is_ours(&self) -> bool {
        self.ours
            .is_none_or(|ours| ours == self.game.position().turn)
    }

    /// Whether the game is over, on the board too.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.game.status() != Status::Playing
            && self.state.tasks.is_empty()
            && self.state.phase != Phase::Setting
            && (self.state.ready || self.state.ended.is_some())
    }

    /// What a look at the board means.
    pub fn judge(&mut self, seen: &Situation) {
        self.state.last.1 = self.state.last.1.saturating_add(1);
        (self.state.ready, self.state.moved) = (false, seen.moved);
        // Whether a disc still stands crooked is seen anew.
        self.state.tasks.retain(|task| !task.is_push());
        if seen.moved {
            self.watch.again();
            self.say("the board was moved: I look where it is".to_owned());
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
        if self.state.pushed < self.pushes
            && let Some(square) = crooked.first()
            && let Some(hue) = seen
                .squares
                .get(usize::from(*square))
                .and_then(|at| at.disc)
        {
            self.state.pushed += 1;
            self.state.tasks.insert(0, Task::push(*square, hue));
            self.state.ready = true;
            self.say(format!(
                "I push the disc on {} to the middle",
                self.number(*square)
            ));
            return;
        }
        let words = if crooked.is_empty() {
            format!(
                "I cannot see {} well",
                self.numbers(squares.iter().copied())
            )
        } else {
            let numbers = self.numbers(crooked);
            format!("a disc stands crooked: put it in the middle of {numbers}")
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
            Verdict::Rejected(reason, _) => self.say(format!("not accepted: {reason}")),
            Verdict::Accepted(step) => {
                self.watch.again();
                (self.state.again, self.state.gaze, self.state.pushed) = (0, 0, 0);
                let tasks = self.play(step);
                // The person has carried the piece and what it captured; a crown is stacked for the person.
                let crowns = |task: &Task| matches!(task.to, End::Square(_, 1));
                self.state.tasks = tasks.into_iter().filter(crowns).collect();
                let position = self.game.position();
                self.state.expected = [position.white, position.black];
                self.state.phase = Phase::Robot;
            }
        }
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
            if self.state.again > 1 {
                let words = self.wrong(&wrong, look);
                self.say(words);
            }
            return;
        }
        if !unsure.is_empty() {
            return self.look_again(&unsure, seen);
        }
        (self.state.again, self.state.gaze, self.state.pushed) = (0, 0, 0);
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
        let strays = seen.strays.iter().filter(|(hue, _)| *hue == task.hue);
        let mut found = strays.map(|(_, at)| *at).next();
        let [white, black] = self.state.expected;
        let own = if task.hue == Hue::Light { white } else { black };
        let mut put_there = false;
        for (square, reading) in (0_u8..).zip(&seen.squares) {
            if reading.disc == Some(task.hue) && own & (1 << square) == 0 {
                found = found.or(Some(reading.at));
                let sure = look.squares.get(usize::from(square));
                let sure = sure.is_some_and(|sight| sight.confidence >= SURE);
                put_there |= task.to == End::Square(square, 0) && sure;
            }
        }
        if put_there && self.state.searched > SEARCHES {
            // People have put it where it belongs.
            self.done(task);
            return;
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
        match task.to {
            End::Square(square, 0) => {
                let (side, number) = (task.hue.colour().name(), self.number(square));
                self.say(format!(
                    "I do not see it: please put a disc of {side} on {number}"
                ));
            }
            // Whatever does not stand on the board itself need not be that disc.
            End::Square(..) => {
                self.say("I do not see it: I take a spare disc".to_owned());
                if let Some(first) = self.state.tasks.first_mut() {
                    first.from = End::Tray;
                }
            }
            _ => {
                self.say("I do not see it: it belongs to the captured discs".to_owned());
                self.state.tasks.remove(0);
                self.state.searched = 0;
            }
        }
    }

    /// Plays a legal move; what is to be carried for it.
    pub fn play(&mut self, step: Move) -> Vec<Task> {
        let before = *self.game.position();
        if let Err(refusal) = self.game.make(step) {
            self.say(refusal.to_string());
            return Vec::new();
        }
        self.state
            .moves
            .push((step.from, step.to, step.crowned, step.captured));
        let routes = before.routes(self.game.variant());
        let route = routes.iter().find(|route| route.step == step);
        let carries = route.map(|route| Heaps::default().carries(&before, route));
        let task = |carry: Carry| {
            let end = |place: Place| match place {
                Place::Square(square, height) => End::Square(square, height),
                Place::Heap(..) | Place::Spare(_) => End::Tray,
            };
            let own = match carry.to {
                Place::Heap(colour, _) => colour,
                _ => before.turn,
            };
            Task {
                from: end(carry.from),
                to: end(carry.to),
                discs: carry.discs,
                hue: Hue::of(own),
            }
        };
        let carries = carries.unwrap_or_default();
        carries.into_iter().map(task).collect()
    }

    /// The move that was thought of: what is to be carried.
    pub fn think(&mut self, step: Move) {
        self.state.tasks = self.play(step);
    }

    fn tray(&mut self, hue: Hue) -> &mut Vec<u8> {
        let [light, dark] = &mut self.state.trays;
        if hue == Hue::Light { light } else { dark }
    }

    /// The errand of the present carry.
    pub fn aim(&mut self) -> Option<Errand> {
        let task = *self.state.tasks.first()?;
        let place = |play: &Self, square: u8| {
            let at = play.state.places.get(usize::from(square));
            at.copied().unwrap_or_else(|| centre(square))
        };
        let from = match task.from {
            End::Square(square, _) => Spot::Board(place(self, square)),
            End::Tray => {
                let held = self.tray(task.hue).iter().rposition(|discs| *discs > 0);
                let held = held.and_then(|held| u8::try_from(held).ok());
                held.map_or(Spot::Spare(task.hue), |held| Spot::Tray(task.hue, held))
            }
            End::Lost => Spot::Board(self.state.found?),
        };
        let to = match task.to {
            End::Square(square, 0) => Spot::Board(centre(square)),
            End::Square(square, _) => Spot::Board(place(self, square)),
            _ => {
                let free = self.tray(task.hue).iter().position(|discs| *discs == 0);
                let free = free.and_then(|free| u8::try_from(free).ok());
                Spot::Tray(task.hue, free.unwrap_or(11))
            }
        };
        let all = |play: &Self| match from {
            Spot::Tray(hue, place) => {
                let [light, dark] = &play.state.trays;
                let tray = if hue == Hue::Light { light } else { dark };
                tray.get(usize::from(place)).copied().unwrap_or_default()
            }
            Spot::Spare(hue) => play.state.spare[usize::from(hue == Hue::Dark)],
            Spot::Board(_) => task.discs,
        };
        let beneath = |end: End, others: u8| match end {
            End::Square(_, below) => below,
            _ => others,
        };
        let others = all(self).saturating_sub(task.discs);
        self.state.errand = Errand {
            number: self.state.errand.number + 1,
            from,
            to,
            discs: task.discs,
            below: [beneath(task.from, others), beneath(task.to, 0)],
            push: task.is_push(),
        };
        Some(self.state.errand)
    }

    fn expect(&mut self, square: u8, hue: Hue, there: bool) {
        let [white, black] = &mut self.state.expected;
        let own = if hue == Hue::Light { white } else { black };
        *own = (*own & !(1 << square)) | (u32::from(there) << square);
    }

    /// The hand holds the present carry's discs.
    pub fn held(&mut self) {
        (self.state.missed, self.state.holds) = (0, true);
        let Some(task) = self.state.tasks.first().copied() else {
            return;
        };
        if let End::Square(square, 0) = task.from {
            self.expect(square, task.hue, false);
        }
        let discs = self.state.errand.discs;
        if let Spot::Spare(hue) = self.state.errand.from {
            let left = &mut self.state.spare[usize::from(hue == Hue::Dark)];
            *left = left.saturating_sub(discs);
        }
        if let Spot::Tray(hue, place) = self.state.errand.from
            && let Some(held) = self.tray(hue).get_mut(usize::from(place))
        {
            *held = held.saturating_sub(discs);
        }
    }

    /// The present carry is done.
    pub fn carried(&mut self) {
        self.state.holds = false;
        if let Some(task) = self.state.tasks.first().copied() {
            if let Spot::Tray(hue, place) = self.state.errand.to
                && let Some(held) = self.tray(hue).get_mut(usize::from(place))
            {
                *held = held.saturating_add(task.discs);
            }
            self.done(task);
        }
    }

    fn done(&mut self, task: Task) {
        if let End::Square(square, 0) = task.to {
            self.expect(square, task.hue, true);
        }
        self.state.tasks.remove(0);
        (self.state.searched, self.state.found) = (0, None);
    }

    /// The hand was empty when it should set down.
    pub fn lost(&mut self) {
        self.state.holds = false;
        let Some(task) = self.state.tasks.first().copied() else {
            return;
        };
        // Of a stack each disc is fetched by itself.
        let one = |height: u8| Task {
            from: End::Lost,
            to: match task.to {
                End::Square(square, below) => End::Square(square, below + height),
                other => other,
            },
            discs: 1,
            ..task
        };
        self.state.tasks.splice(0..1, (0..task.discs).map(one));
        (self.state.searched, self.state.found) = (0, None);
        let what = if task.discs > 1 { TWO_DISCS } else { A_DISC };
        let side = task.hue.colour().name();
        let to = match task.to {
            End::Square(square, _) => format!("on the way to {}", self.number(square)),
            _ => "on the way to the captured ones".to_owned(),
        };
        self.state.last.0.clear();
        self.say(format!("{LOST} {what} of {side} {to}"));
    }

    /// There was nothing between the fingers.
    pub fn missed(&mut self) {
        self.state.missed += 1;
        if self.state.missed > 1 {
            self.say("I cannot grasp the disc, and try again".to_owned());
        }
    }

    /// Something kept the arm from its way: people are told what they can do about it.
    pub fn hindered(&mut self, hindrance: &Hindrance) {
        // Time passes without looks.
        self.state.last.1 = self.state.last.1.saturating_add(1);
        self.state.why = Some(hindrance.why);
        let words = match hindrance.why {
            Why::HandInTheWay => "please take your hand away".to_owned(),
            Why::OutOfReach(end) => format!("{} is out of my reach: {MIDDLE}", self.place(end)),
            // That is told with where it was to go.
            Why::DiscLost => return,
            Why::NoPower => format!("the robot needs power: {POWER}"),
            Why::Blocked => "something is in the way of my arm".to_owned(),
            Why::Stopped => "the robot was stopped: please let it go on".to_owned(),
            Why::Fault => format!("the robot cannot go on: {}", hindrance.text),
        };
        self.say(words);
    }

    /// An end of the present carry in words.
    fn place(&self, end: u8) -> String {
        let task = self.state.tasks.first();
        let end = task.map(|task| if end == 0 { task.from } else { task.to });
        match end {
            Some(End::Square(square, _)) => self.number(square).to_string(),
            Some(End::Tray) => "the place of captured discs".to_owned(),
            _ => "the disc".to_owned(),
        }
    }

    /// Whether what was held has slipped out of the hand.
    #[must_use]
    pub fn has_slipped(&self) -> bool {
        self.state.holds && self.state.why == Some(Why::DiscLost)
    }

    /// The result in words.
    #[must_use]
    pub fn result(&self) -> String {
        use checkers::{Drawn, Ending, Won};
        match self.game.status() {
            Status::Playing => "the game is not over".to_owned(),
            Status::Won(side, Won::NoMove) => {
                let (side, other) = (side.name(), side.other().name());
                format!("{side} has won: {other} has no move")
            }
            Status::Won(side, Won::Resigned) => {
                format!("{} has won: {} gave up", side.name(), side.other().name())
            }
            Status::Drawn(Drawn::Repetition) => "drawn: a position three times".to_owned(),
            Status::Drawn(Drawn::QuietKings) => "drawn: kings only moved for too long".to_owned(),
            Status::Drawn(Drawn::Ending(ending)) => {
                let what = match ending {
                    Ending::ThreeKings => "three kings did not win against one",
                    Ending::MainRoad => "three pieces did not win against a king on the main road",
                    Ending::TwoAgainstOne => "two pieces did not win against a king",
                    Ending::Balance { .. } => {
                        "few pieces are left, and nothing was captured or crowned"
                    }
                };
                format!("drawn: {what} in time")
            }
            Status::Drawn(Drawn::Agreement) => "drawn: both agreed".to_owned(),
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
