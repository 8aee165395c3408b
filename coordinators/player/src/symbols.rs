//! The symbolic board: what the player believes of its game, as people see it on a display beside the table. It lies on a level of its
//! own, with captured discs beside it; its numbers tell how surely each square was seen, and how people want the player to be.

use std::{cell::RefCell, rc::Rc};

use checkers::Numbering;
use ctos::{
    message::{Command, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled},
};
use scene::{FollowScene, Number, Part, Pose, Said, Seen, Solid, Source, Stage, View};

use crate::wire::{Believe, FIELD_M, InForce, centre};

/// The handler's name.
pub const HANDLER: &str = "checkers.symbols";

/// Where the middle of it is: no table is there, m.
const AT: [f64; 3] = [-1.5, 0.0, 0.0];
/// Half the edge of the board, and what a disc is like, m.
const HALF_M: f64 = 4.0 * FIELD_M;
const DISC_M: f64 = 0.023;
/// Discs of a colour, and where those that are off the board stand: the first column, and how far they are apart, m.
const DISCS: u8 = 12;
const COLUMN_M: f64 = 0.05;
const BESIDE_M: f64 = HALF_M + 0.04;
const ROW_M: f64 = 0.038;

const WOOD: [u8; 3] = [226, 214, 188];
const FIELD: [u8; 3] = [110, 128, 112];
const WHITE: [u8; 3] = [244, 226, 150];
const BLACK: [u8; 3] = [120, 32, 28];
const MOVE: [u8; 3] = [40, 110, 200];

struct Symbols {
    believed: Rc<RefCell<Option<Believe>>>,
    stage: Stage,
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let commands = [Believe::INFO, FollowScene::INFO];
    registry.handler(HANDLER, &commands, |_| {
        let believed = Rc::default();
        let stage = Stage::new(Drawn {
            believed: Rc::clone(&believed),
            mirrored: None,
        });
        Ok(Symbols { believed, stage })
    });
}

impl EventHandler for Symbols {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Believe::CODE => {
                let (believed, reply) = message.open::<Believe>()?;
                *self.believed.borrow_mut() = Some(believed);
                reply.ok(())
            }
            FollowScene::CODE => self.stage.follow(cx, message),
            _ => cx.default_processing(message),
        }
    }
}

/// As it is looked at.
struct Drawn {
    believed: Rc<RefCell<Option<Believe>>>,
    /// Whether the squares that were told are those of a mirrored board.
    mirrored: Option<bool>,
}

impl Source for Drawn {
    fn view(&mut self) -> Option<View> {
        let mirrored = self.believed.borrow().as_ref().map(|one| one.mirrored)?;
        if self.mirrored.replace(mirrored) == Some(mirrored) {
            return None;
        }
        Some(view(mirrored))
    }

    fn look(&mut self) -> Seen {
        let believed = self.believed.borrow();
        // Nothing is shown before the player has told something.
        let Some(believed) = believed.as_ref() else {
            return Seen::default();
        };
        Seen {
            states: states(believed),
            said: Said {
                words: believed.words.clone(),
                ..Said::default()
            },
            pictures: Vec::new(),
        }
    }
}

/// The middle of a square, as White sees the board.
fn middle(square: u8, mirrored: bool) -> [f64; 2] {
    let [x, y] = centre(square);
    [if mirrored { -x } else { x }, y]
}

fn number(name: &str, unit: &str) -> Number {
    Number {
        name: name.to_owned(),
        unit: unit.to_owned(),
        resolution: 1e-3,
    }
}

fn block(half: [f64; 3]) -> Solid {
    Solid::Block {
        pose: Pose::default(),
        half,
    }
}

/// The board, its squares by their numbers, discs, the last move, and the settings.
fn view(mirrored: bool) -> View {
    let part = |name: String, kind: &str, solids: Vec<Solid>, colour, numbers| Part {
        name,
        kind: kind.to_owned(),
        solids,
        colour,
        numbers,
        ..Part::default()
    };
    let numbering = if mirrored {
        Numbering::Mirrored
    } else {
        Numbering::Plain
    };
    let board = vec![block([HALF_M, HALF_M, 0.002])];
    let mut parts = vec![part("board".to_owned(), "board", board, WOOD, vec![])];
    for square in 0..32 {
        let name = numbering.number(square).to_string();
        let solids = vec![block([0.5 * FIELD_M, 0.5 * FIELD_M, 0.003])];
        parts.push(part(
            name,
            "square",
            solids,
            FIELD,
            vec![number("confidence", "")],
        ));
    }
    for (side, colour) in [("white", WHITE), ("black", BLACK)] {
        for nth in 1..=DISCS {
            let disc = Solid::Cylinder {
                pose: Pose::default(),
                half: 0.005,
                radius: DISC_M,
            };
            let name = format!("{side} {nth}");
            parts.push(part(
                name,
                "piece",
                vec![disc],
                colour,
                vec![number("king", "")],
            ));
        }
    }
    let arrow = Solid::Vector {
        first: 0,
        scale: 1.0,
        turns: false,
    };
    let along = ["x", "y", "z"].map(|axis| number(axis, "m")).to_vec();
    parts.push(part(
        "last move".to_owned(),
        "move",
        vec![arrow],
        MOVE,
        along,
    ));
    let settings = [
        ("depth", ""),
        ("seconds", "s"),
        ("verbosity", ""),
        ("dry", ""),
        ("light", ""),
    ];
    let settings = settings.map(|(name, unit)| number(name, unit)).to_vec();
    parts.push(part(
        "settings".to_owned(),
        "settings",
        vec![],
        MOVE,
        settings,
    ));
    View {
        parts,
        ..View::default()
    }
}

/// Each part, in the order of the view.
fn states(believed: &Believe) -> Vec<(Pose, Vec<f64>)> {
    let Believe {
        board: [white, black, kings],
        mirrored,
        ..
    } = believed;
    let at = |[x, y]: [f64; 2], z: f64| Pose {
        at: [AT[0] + x, AT[1] + y, AT[2] + z],
        ..Pose::default()
    };
    let mut all = vec![(at([0.0; 2], 0.0), vec![])];
    for square in 0..32_u8 {
        let seen = believed.seen.get(usize::from(square)).copied();
        let place = at(middle(square, *mirrored), 0.001);
        all.push((place, vec![seen.unwrap_or(f64::NAN)]));
    }
    for (own, column) in [(*white, 0.0), (*black, 1.0)] {
        let squares = (0..32_u8).filter(|square| own & (1 << square) != 0);
        let on_board = squares.map(|square| {
            let king = f64::from(u8::from(kings & (1 << square) != 0));
            (at(middle(square, *mirrored), 0.01), vec![king])
        });
        let beside = (0..DISCS).map(|nth| {
            let up = f64::from(nth) * ROW_M - 0.5 * f64::from(DISCS - 1) * ROW_M;
            (at([BESIDE_M + column * COLUMN_M, up], 0.01), vec![0.0])
        });
        // As many as there are: those that are not on the board stand beside it.
        let count = usize::try_from(own.count_ones()).unwrap_or_default();
        let beside = beside.skip(count.min(usize::from(DISCS)));
        all.extend(on_board.take(usize::from(DISCS)).chain(beside));
    }
    let (from, along) = match believed.last {
        Some([from, to]) => {
            let [from, to] = [from, to].map(|square| middle(square, *mirrored));
            (from, vec![to[0] - from[0], to[1] - from[1], 0.0])
        }
        None => ([0.0; 2], vec![0.0; 3]),
    };
    all.push((at(from, 0.02), along));
    let InForce {
        depth,
        seconds,
        verbosity,
        dry,
        light,
    } = believed.settings;
    let settings = vec![
        f64::from(depth),
        seconds.unwrap_or(f64::NAN),
        f64::from(verbosity),
        f64::from(u8::from(dry)),
        light,
    ];
    all.push((at([0.0; 2], 0.0), settings));
    all
}

#[cfg(test)]
mod tests {
    use checkers::{Colour, Position};

    use super::*;

    fn believed(mirrored: bool) -> Believe {
        let start = Position::start(Colour::White);
        Believe {
            board: [start.white & !(1 << 20), start.black, 1 << 31],
            mirrored,
            seen: vec![0.9; 32],
            last: Some([21, 17]),
            words: String::new(),
            settings: InForce {
                depth: 4,
                seconds: None,
                verbosity: 2,
                dry: false,
                light: 1.0,
            },
        }
    }

    #[test]
    fn each_part_has_a_place_and_numbers_and_what_is_captured_stands_beside_the_board() {
        let (view, states) = (view(false), states(&believed(false)));
        assert_eq!(view.parts.len(), states.len());
        let pairs = || view.parts.iter().zip(&states);
        assert!(pairs().all(|(part, (_, numbers))| part.numbers.len() == numbers.len()));
        let beside =
            pairs().filter(|(part, (pose, _))| part.kind == "piece" && pose.at[0] - AT[0] > HALF_M);
        assert_eq!(beside.count(), 1);
        let kings =
            pairs().filter(|(part, (_, numbers))| part.kind == "piece" && numbers[0] == 1.0);
        assert_eq!(kings.count(), 1);
    }

    #[test]
    fn a_mirrored_board_has_its_dark_corner_at_the_right_of_white_and_its_numbers_run_as_they_should()
     {
        for (mirrored, first, corner) in [(false, "1", -3.5), (true, "1", 3.5)] {
            let (view, states) = (view(mirrored), states(&believed(mirrored)));
            let lowest: Vec<f64> = view
                .parts
                .iter()
                .zip(&states)
                .filter(|(part, (pose, _))| part.kind == "square" && pose.at[1] < -3.0 * FIELD_M)
                .map(|(_, (pose, _))| (pose.at[0] - AT[0]) / FIELD_M)
                .collect();
            assert!(
                lowest.iter().any(|file| (file - corner).abs() < 1e-9),
                "{lowest:?}"
            );
            // Square 1 is the first of Black's row from the left.
            let one = view
                .parts
                .iter()
                .position(|part| part.name == first)
                .unwrap();
            let file = (states[one].0.at[0] - AT[0]) / FIELD_M;
            let expected = if mirrored { -3.5 } else { -2.5 };
            assert!((file - expected).abs() < 1e-9, "{file}");
        }
    }
}
