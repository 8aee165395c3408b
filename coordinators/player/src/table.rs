//! A table without physics: discs, board, arm and hand of a dry game, and what goes wrong with them. Knows no task.

use checkers::{Colour, Position};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;

use crate::wire::{
    ASIDE_M, FIELD_M, Hue, MARKERS, Picture, Pose, SPARE_STACKS, Spot, TrueTable, Why, apart,
    centre,
};
use crate::{referee::DISCS, state::SPARE};

/// The hand takes what is so near beneath it, m.
const REACH_M: f64 = 0.024;

/// The arm of a dry game gets so far from where it stands, and a board that is too far away is so far away, m.
const ARM_M: f64 = 0.95;
const FAR_M: f64 = 0.9;

/// How many times as light a lamp makes it that is dimmed, or turned up; and for how long, s.
const DIM: std::ops::Range<f64> = 0.05..0.7;
const STRONG: std::ops::Range<f64> = 1.2..2.0;
const LIT_S: std::ops::Range<f64> = 4.0..15.0;

/// Where the arm gets to every square.
pub const MIDDLE: Pose = Pose {
    at: [0.57, 0.0],
    yaw: 0.0,
    mirrored: false,
};

/// How often things go wrong, 0 to 1.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Chances {
    /// The person's errors, of moves.
    pub errors: f64,
    /// A disc slips out of the hand, of what is carried.
    pub slips: f64,
    /// The board is pushed aside, of looks.
    pub bumps: f64,
    /// A square is not seen well, of looks.
    pub glare: f64,
    /// The board is pushed out of the arm's reach, of those times that it is pushed aside.
    pub far: f64,
    /// The arm has no power any more, of its ways.
    pub power: f64,
    /// A person reaches over the board, of the ways of a real arm.
    pub reaches: f64,
    /// Somebody dims the lamp or turns it up for a while, of half seconds.
    pub lamps: f64,
}

/// Discs that stand on one another.
#[derive(Debug, Clone, PartialEq)]
pub struct Stack {
    /// Whether they move with the board.
    pub on_board: bool,
    /// In the frame of the board, or of the table.
    pub at: [f64; 2],
    /// The lowest first.
    pub discs: Vec<Hue>,
}

/// Everything that is in the room.
pub struct Table {
    pub board: Pose,
    pub stacks: Vec<Stack>,
    /// What the person has captured, and what fell from the table.
    pub away: Vec<Hue>,
    /// Where the arm is; `None` where it waits.
    pub arm: Option<[f64; 2]>,
    /// The number of the arm's latest motion, and whether it moves.
    pub motion: u32,
    pub moving: bool,
    /// When a real arm set out for an errand, s, and whether it has gone on to the errand's second end.
    set_out: Option<(f64, bool)>,
    /// In the arm's hand.
    pub held: Vec<Hue>,
    slips: bool,
    /// Whether the arm has power.
    pub powered: bool,
    closed: (u32, u8),
    opened: (u32, u8),
    /// Whether the person's hand is over the board.
    pub hand: bool,
    /// How light people want it, 0 to 1.
    pub light: f64,
    /// How many times as light somebody has it for a while, and until when, s.
    lamp: (f64, f64),
    /// Whether something stops the arm before a hand is over the board with it.
    pub curtain: bool,
    pub truth: TrueTable,
    pub chances: Chances,
    pub rng: ChaCha8Rng,
}

impl Table {
    /// The discs stand in the first position, the board lies anywhere.
    #[must_use]
    pub fn new(chances: Chances, first: Position, mut rng: ChaCha8Rng) -> Self {
        let board = Pose {
            at: [rng.random_range(0.45..0.55), rng.random_range(-0.05..0.05)],
            yaw: rng.random_range(-0.3..0.3),
            mirrored: false,
        };
        let mut table = Self {
            board,
            stacks: Vec::new(),
            away: Vec::new(),
            arm: None,
            motion: 0,
            moving: false,
            set_out: None,
            held: Vec::new(),
            slips: false,
            powered: true,
            closed: (0, 0),
            opened: (0, 0),
            hand: false,
            light: 1.0,
            lamp: (1.0, 0.0),
            curtain: false,
            truth: TrueTable::default(),
            chances,
            rng,
        };
        table.begin_anew(&first);
        table
    }

    /// The discs on the board stand as a position says; each in the middle of its field.
    pub fn set_up(&mut self, position: &Position) {
        self.stacks.retain(|stack| !stack.on_board);
        for square in 0..32 {
            if let Some(piece) = position.piece(square) {
                let discs = 1 + usize::from(piece.king);
                self.stacks.push(Stack {
                    on_board: true,
                    at: centre(square),
                    discs: vec![Hue::of(piece.colour); discs],
                });
            }
        }
    }

    /// All discs are gathered, and the first position is set up; what it has no use for is put away.
    pub fn begin_anew(&mut self, first: &Position) {
        self.stacks.clear();
        self.away.clear();
        for hue in [Hue::Light, Hue::Dark] {
            for stack in 0..SPARE_STACKS {
                let at = Spot::Spare(hue).of_disc(&self.board, stack);
                let discs = (stack..SPARE).step_by(usize::from(SPARE_STACKS)).count();
                self.stacks.push(Stack {
                    on_board: false,
                    at,
                    discs: vec![hue; discs],
                });
            }
        }
        self.set_up(first);
        let [light, dark] = self.truth().discs;
        for (hue, there) in [(Hue::Light, light), (Hue::Dark, dark)] {
            let left = DISCS.saturating_sub(there);
            self.away.extend((0..left).map(|_| hue));
        }
        self.note();
    }

    /// The stack on a square.
    #[must_use]
    pub fn on(&self, square: u8) -> Option<usize> {
        let near =
            |stack: &Stack| stack.on_board && apart(stack.at, centre(square)) < FIELD_M / 2.0;
        self.stacks.iter().position(near)
    }

    /// Takes away a disc that is not in the game: one that lies elsewhere, or else on no square of the board.
    pub fn take_stray(&mut self, hue: Hue) -> bool {
        if let Some(found) = self.away.iter().position(|other| *other == hue) {
            self.away.remove(found);
            return true;
        }
        let is_off =
            |at: [f64; 2]| (0..32).all(|square| apart(at, centre(square)) >= FIELD_M / 2.0);
        let stray = self
            .stacks
            .iter()
            .position(|stack| stack.on_board && stack.discs == [hue] && is_off(stack.at));
        let found = stray.map(|stray| self.stacks.remove(stray));
        found.is_some()
    }

    /// The squares of White, Black, and kings.
    #[must_use]
    pub fn squares(&self) -> [u32; 3] {
        let mut all = [0; 3];
        for square in 0..32 {
            let Some(stack) = self.on(square).and_then(|at| self.stacks.get(at)) else {
                continue;
            };
            let [white, black, kings] = &mut all;
            match stack.discs.first() {
                Some(Hue::Light) => *white |= 1 << square,
                Some(Hue::Dark) => *black |= 1 << square,
                None => {}
            }
            *kings |= u32::from(stack.discs.len() > 1) << square;
        }
        all
    }

    /// The position, if it is the turn of a side.
    #[must_use]
    pub fn position(&self, turn: Colour) -> Position {
        let [white, black, kings] = self.squares();
        Position {
            white,
            black,
            kings,
            turn,
        }
    }

    /// A real arm sets out for an errand, goes on to the second end of an errand, or (neither) is back at its place of rest.
    pub fn sets_out(&mut self, end: Option<u8>, now: f64) {
        self.set_out = match (end, self.set_out.take()) {
            (Some(0), _) => Some((now, false)),
            (Some(_), Some((begun, _))) => Some((begun, true)),
            (None, Some((begun, true))) => {
                self.truth.carried_ms.push(((now - begun) * 1e3) as u32);
                None
            }
            _ => None,
        };
    }

    /// Notes what stands on the board when nobody is at it.
    pub fn note(&mut self) {
        if self.hand || self.arm.is_some() || self.moving || !self.held.is_empty() {
            return;
        }
        let now = self.squares();
        if self.truth.history.last() != Some(&now) {
            self.truth.history.push(now);
        }
    }

    /// What is true.
    #[must_use]
    pub fn truth(&self) -> TrueTable {
        let stacks = self.stacks.iter().flat_map(|stack| &stack.discs);
        let all = stacks.chain(&self.away).chain(&self.held);
        let mut truth = self.truth.clone();
        for hue in all {
            let [light, dark] = &mut truth.discs;
            *(if *hue == Hue::Light { light } else { dark }) += 1;
        }
        truth
    }

    /// The board may be pushed aside when nobody is at it.
    pub fn may_bump(&mut self) {
        let nobody = !self.hand && self.arm.is_none() && !self.moving;
        if nobody && self.rng.random_bool(self.chances.bumps) {
            self.board.at = [
                (self.board.at[0] + self.rng.random_range(-0.03..0.03)).clamp(0.44, 0.56),
                (self.board.at[1] + self.rng.random_range(-0.03..0.03)).clamp(-0.06, 0.06),
            ];
            self.board.yaw = (self.board.yaw + self.rng.random_range(-0.1..0.1)).clamp(-0.4, 0.4);
            if self.rng.random_bool(self.chances.far) {
                self.board.at[0] = FAR_M;
            }
            self.truth.moved += 1;
        }
    }

    /// A picture from a pose; the board may be pushed before.
    pub fn see(&mut self, pose: u8) -> Picture {
        let chances = self.chances;
        self.may_bump();
        let noise = |rng: &mut ChaCha8Rng, [x, y]: [f64; 2]| {
            let off = |rng: &mut ChaCha8Rng| rng.random_range(-5e-4..5e-4);
            [x + off(rng), y + off(rng)]
        };
        let mut discs = Vec::new();
        for stack in &self.stacks {
            if let Some(top) = stack.discs.last() {
                discs.push((*top, noise(&mut self.rng, table_at(stack, &self.board))));
            }
        }
        let markers = MARKERS.map(|mark| noise(&mut self.rng, self.board.on_table(mark)));
        // From elsewhere it does not glare.
        let glares = pose == 0 && self.rng.random_bool(chances.glare);
        let glare = glares.then(|| {
            let square = self.rng.random_range(0..32);
            self.board.on_table(centre(square))
        });
        Picture {
            markers,
            discs,
            glare,
            hand: self.hand,
            light: self.lit(),
        }
    }

    /// How light it is: 1 is as it was at the beginning.
    #[must_use]
    pub fn lit(&self) -> f64 {
        self.light * self.lamp.0
    }

    /// Somebody may dim the lamp, or turn it up, for a while.
    pub fn may_light(&mut self, now: f64) {
        let (share, until) = self.lamp;
        if share != 1.0 && now >= until {
            self.lamp = (1.0, now);
        } else if share == 1.0
            && self.chances.lamps > 0.0
            && self.rng.random_bool(self.chances.lamps)
        {
            let is_up = self.rng.random_bool(0.5);
            let range = if is_up { STRONG } else { DIM };
            let share = self.rng.random_range(range);
            self.lamp = (share, now + self.rng.random_range(LIT_S));
            let [dim, strong] = &mut self.truth.lit;
            *(if is_up { strong } else { dim }) += 1;
        }
    }

    /// Somebody puts what stands crooked on these squares into their middle.
    pub fn straighten(&mut self, squares: &[u8]) {
        for square in squares {
            if let Some(stack) = self.on(*square).and_then(|at| self.stacks.get_mut(at)) {
                stack.at = centre(*square);
            }
        }
    }

    /// Somebody pushes the board with all that stands on it to where the arm gets everywhere.
    pub fn push_to_middle(&mut self) {
        self.board = Pose {
            mirrored: self.board.mirrored,
            ..MIDDLE
        };
        self.truth.moved += 1;
    }

    /// The arm begins to move, and is to go on to another place then; says for how long it moves, s.
    ///
    /// # Errors
    /// What keeps it from that.
    pub fn go(&mut self, to: Option<[f64; 2]>, then: Option<[f64; 2]>) -> Result<f64, Why> {
        if self.rng.random_bool(self.chances.power) {
            self.powered = false;
        }
        if !self.powered {
            return Err(Why::NoPower);
        }
        if self.hand {
            return Err(Why::HandInTheWay);
        }
        let far = |at: Option<[f64; 2]>| at.is_some_and(|at| apart(at, [0.0; 2]) > ARM_M);
        if far(to) {
            // Without a next place it is the errand's second end.
            return Err(Why::OutOfReach(u8::from(then.is_none())));
        }
        if far(then) {
            return Err(Why::OutOfReach(1));
        }
        self.motion += 1;
        self.moving = true;
        let home = [0.3, 0.0];
        let way = apart(self.arm.unwrap_or(home), to.unwrap_or(home));
        Ok(0.8 + way / 0.5)
    }

    /// The arm has come to where it was to go; says what has gone wrong on the way.
    pub fn arrived(&mut self, motion: u32, to: Option<[f64; 2]>) -> Option<Why> {
        if self.motion != motion {
            return None;
        }
        (self.arm, self.moving) = (to, false);
        let slipped = std::mem::take(&mut self.slips);
        if slipped {
            for hue in std::mem::take(&mut self.held) {
                self.drop(hue);
            }
        }
        self.note();
        slipped.then_some(Why::DiscLost)
    }

    /// A disc falls: somewhere on the board, or from the table.
    fn drop(&mut self, hue: Hue) {
        self.truth.slipped += 1;
        for _ in 0..20 {
            let at = [
                self.rng.random_range(-0.23..0.23),
                self.rng.random_range(-0.23..0.23),
            ];
            let on_board = |stack: &&Stack| stack.on_board;
            let mut others = self.stacks.iter().filter(on_board);
            if others.all(|other| apart(other.at, at) > 0.04) && self.rng.random_bool(0.8) {
                self.stacks.push(Stack {
                    on_board: true,
                    at,
                    discs: vec![hue],
                });
                return;
            }
        }
        self.away.push(hue);
    }

    /// The arm pushes what stands at one place to another.
    pub fn shove(&mut self, from: [f64; 2], to: [f64; 2]) {
        let board = self.board;
        let mut stacks = self.stacks.iter_mut().filter(|stack| stack.on_board);
        if let Some(stack) = stacks.find(|stack| apart(table_at(stack, &board), from) < REACH_M) {
            stack.at = board.on_board(to);
        }
        self.arm = Some(to);
    }

    /// The hand closes.
    pub fn close(&mut self, errand: u32, discs: u8) -> u8 {
        if self.closed.0 == errand {
            return self.closed.1;
        }
        let arm = self.arm.filter(|_| self.held.is_empty());
        let board = self.board;
        let near = arm.and_then(|arm| {
            let far = |stack: &Stack| apart(table_at(stack, &board), arm);
            let stacks = self.stacks.iter().enumerate();
            let nearest = stacks.min_by(|one, other| far(one.1).total_cmp(&far(other.1)));
            nearest
                .filter(|(_, stack)| far(stack) < REACH_M)
                .map(|(at, _)| at)
        });
        if let Some(stack) = near.and_then(|at| self.stacks.get_mut(at)) {
            let below = stack.discs.len().saturating_sub(usize::from(discs));
            self.held = stack.discs.split_off(below);
            self.slips = self.rng.random_bool(self.chances.slips);
        }
        self.stacks.retain(|stack| !stack.discs.is_empty());
        self.closed = (errand, u8::try_from(self.held.len()).unwrap_or(u8::MAX));
        self.closed.1
    }

    /// The hand opens.
    pub fn open(&mut self, errand: u32) -> u8 {
        if self.opened.0 == errand {
            return self.opened.1;
        }
        let held = std::mem::take(&mut self.held);
        self.opened = (errand, u8::try_from(held.len()).unwrap_or(u8::MAX));
        if let Some(arm) = self.arm
            && !held.is_empty()
        {
            let board = self.board;
            let mut stacks = self.stacks.iter_mut();
            match stacks.find(|stack| apart(table_at(stack, &board), arm) < REACH_M) {
                Some(stack) => stack.discs.extend(held),
                None => {
                    let on_board = arm[1].abs() < ASIDE_M;
                    let at = if on_board { board.on_board(arm) } else { arm };
                    self.stacks.push(Stack {
                        on_board,
                        at,
                        discs: held,
                    });
                }
            }
        }
        self.opened.1
    }
}

/// Where a stack is in the table's frame.
pub fn table_at(stack: &Stack, board: &Pose) -> [f64; 2] {
    if stack.on_board {
        board.on_table(stack.at)
    } else {
        stack.at
    }
}
