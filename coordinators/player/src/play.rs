//! The game that the player plays, and how it is watched: pure. `looks` has what is made of a look at the board, `carries` what is to
//! be carried.

mod carries;
mod looks;

use checkers::{Colour, Game, Numbering, Position, Status, Variant, Watch};

use crate::{
    state::{Phase, SPARE, State, replayed},
    wire::{Errand, Hue, SURE, Spot, centre},
};

/// How much is said unless somebody wants it otherwise.
pub const VERBOSITY: u32 = 2;

/// After so many looks the same is said once more.
const SAID_AGAIN: u32 = 25;

/// What people are asked for when the arm cannot go on, and in a dry run.
pub(crate) const MIDDLE: &str = "please push the board to the middle of the table";
pub(crate) const POWER: &str = "please switch it on";
pub(crate) const MOVE_FOR_ME: &str = "please make my move";
pub(crate) const CROWN: &str = "please stack the crown";
pub(crate) const STRAIGHT: &str = "put it in the middle of ";
pub(crate) const ALL_STRAIGHT: &str = "put each in the middle of its square";

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
    /// How much is said: 1 what people must know, 2 what the robot does too, 3 its moves too.
    pub verbosity: u32,
    /// Whether people carry for the robot.
    pub dry: bool,
    /// Where the disc that is looked for lies beyond the arm's reach, in the board's frame.
    beyond: Vec<[f64; 2]>,
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
            shown: Vec::new(),
            asked: None,
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
            verbosity: VERBOSITY,
            dry: false,
            beyond: Vec::new(),
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

    /// Says what the robot does of its own accord, unless people want to hear no more than they must.
    fn tell(&mut self, words: String) {
        if self.verbosity > 1 {
            self.say(words);
        }
    }

    /// A new game, by whoever the board is set up; what counts on goes on.
    pub fn again(&mut self) {
        let new = Self::new(self.game.variant(), self.start, self.ours);
        let before = std::mem::replace(&mut self.state, new.state);
        (self.game, self.watch, self.beyond) = (new.game, new.watch, new.beyond);
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
