//! What is to be carried, and what became of it.

use checkers::{Carry, Heaps, Move, Numbering, Place};

use crate::{
    play::{MIDDLE, MOVE_FOR_ME, POWER, Play, SAID_AGAIN},
    referee::{A_DISC, LOST, TWO_DISCS},
    state::{End, Task},
    wire::{Errand, Hindrance, Hue, Spot, Why, centre},
};

impl Play {
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

    /// The move that was thought of: what is to be carried, by people in a dry run.
    pub fn think(&mut self, step: Move) {
        let word = Numbering::of(self.game.variant()).short(step, 'x');
        let tasks = self.play(step);
        if self.dry {
            let position = *self.game.position();
            self.state.expected = [position.white, position.black];
            let words = format!("{MOVE_FOR_ME}: {word}");
            self.state.shown = vec![step.from, step.to];
            self.state.asked = Some(words.clone());
            self.say(words);
            return;
        }
        self.state.tasks = tasks;
        if self.verbosity > 2 {
            self.say(format!("I move {word}"));
        }
    }

    /// How the board shall be when people are asked to move for the robot.
    #[must_use]
    pub fn asked_board(&self) -> Option<[u32; 3]> {
        self.state.asked.as_ref()?;
        let position = self.game.position();
        Some([position.white, position.black, position.kings])
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

    pub(super) fn done(&mut self, task: Task) {
        if let End::Square(square, 0) = task.to {
            self.expect(square, task.hue, true);
        }
        self.state.tasks.remove(0);
        (self.state.searched, self.state.found) = (0, None);
        self.beyond.clear();
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
            self.tell("I cannot grasp the disc, and try again".to_owned());
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
            Why::WouldTouch => format!("something is in the way of my arm: {}", hindrance.text),
            Why::Stopped => "the robot was stopped: please let it go on".to_owned(),
            Why::Fault => format!("the robot cannot go on: {}", hindrance.text),
        };
        let is_lost = self.state.tasks.first().map(|task| task.from) == Some(End::Lost);
        let again = self.state.last.0 == words && self.state.last.1 >= SAID_AGAIN;
        if is_lost && again && hindrance.why == Why::OutOfReach(0) {
            // Nobody has brought it nearer.
            self.beyond.extend(self.state.found.take());
            return;
        }
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
}
