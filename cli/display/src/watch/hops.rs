//! The neighbourhood of a node, in boxes of letters. Its predecessors stand to its left, its successors to
//! its right, and lines go between neighbouring columns. It knows no terminal.

use std::collections::{BTreeMap, BTreeSet};

use pnt::{
    layout::{Drawing, DrawnNode, Kind, Way},
    stream::{NetView, Standing, State},
};

/// The most nodes that are drawn.
const MOST: usize = 20;
/// Lines of a box.
const BOX: usize = 3;
/// Columns between boxes, for lines.
const GAP: usize = 5;
/// A box is no wider, and no narrower.
const WIDEST: usize = 26;
const NARROWEST: usize = 12;
/// In a box smaller than this nothing can be read.
const SMALLEST: usize = 6;

/// What a letter of the picture belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Look {
    Line,
    Place,
    Waiting,
    Enabled,
    Running,
}

/// Text in one look; and whether it is the chosen node's.
pub(super) type Piece = (String, Look, bool);

/// A node with its column and row.
struct Spot {
    node: usize,
    column: usize,
    row: usize,
}

/// The lines around `chosen`, a node of the drawing, on so many columns and lines.
pub(super) fn around(
    (view, drawing, state): (&NetView, &Drawing, &State),
    standings: &BTreeMap<&str, Standing>,
    chosen: usize,
    (width, height): (usize, usize),
) -> Vec<Vec<Piece>> {
    let rows = height / BOX;
    if rows == 0 || width < NARROWEST {
        return Vec::new();
    }
    // Two steps to each side where there is room.
    let reach = if (width + GAP) / (NARROWEST + 4 + GAP) >= 5 {
        2
    } else {
        1
    };
    let spots = arrange(drawing, chosen, reach, rows);
    let columns = 2 * reach + 1;
    let wide = ((width + GAP) / columns).saturating_sub(GAP);
    let wide = wide.clamp(NARROWEST.min(wide), WIDEST);
    if wide < SMALLEST {
        return Vec::new();
    }
    let mut grid = Grid::new(columns * wide + (columns - 1) * GAP, rows * BOX);
    for arc in &drawing.arcs {
        let find = |node: usize| spots.iter().find(|spot| spot.node == node);
        if let (Some(from), Some(to)) = (find(arc.from), find(arc.to)) {
            grid.join(from, to, arc.way, wide);
        }
    }
    for spot in &spots {
        let Some(node) = drawing.nodes.get(spot.node) else {
            continue;
        };
        let (text, look) = label(view, state, standings, node);
        let at = (spot.column * (wide + GAP), spot.row * BOX);
        grid.boxed(at, wide, &text, (look, spot.node == chosen));
    }
    grid.lines()
}

/// Columns and rows of the nodes that are nearest to `chosen`.
fn arrange(drawing: &Drawing, chosen: usize, reach: usize, rows: usize) -> Vec<Spot> {
    let mut spots = vec![Spot {
        node: chosen,
        column: reach,
        row: rows.saturating_sub(1) / 2,
    }];
    let mut known = BTreeSet::from([chosen]);
    // What is nearer comes first; on both sides in turn.
    for distance in 1..=reach {
        for (column, before) in [(reach - distance, true), (reach + distance, false)] {
            let inner = if before { column + 1 } else { column - 1 };
            let mut found = Vec::new();
            for spot in spots.iter().filter(|spot| spot.column == inner) {
                for arc in &drawing.arcs {
                    let (near, far) = if before {
                        (arc.to, arc.from)
                    } else {
                        (arc.from, arc.to)
                    };
                    if near == spot.node && known.len() < MOST && known.insert(far) {
                        found.push(far);
                    }
                }
            }
            for left_out in found.iter().skip(rows) {
                known.remove(left_out);
            }
            found.truncate(rows);
            let first = (rows - found.len()) / 2;
            let placed = found.into_iter().enumerate();
            spots.extend(placed.map(|(index, node)| Spot {
                node,
                column,
                row: first + index,
            }));
        }
    }
    spots
}

fn label(
    view: &NetView,
    state: &State,
    standings: &BTreeMap<&str, Standing>,
    node: &DrawnNode,
) -> (String, Look) {
    match &node.kind {
        Kind::Place(place) => {
            let tokens = state.places.get(*place as usize).copied().unwrap_or(0);
            let dots = match tokens {
                0 => "( )".to_owned(),
                1 => "(●)".to_owned(),
                many => format!("({many})"),
            };
            (format!("{dots} {}", node.name), Look::Place)
        }
        Kind::Remote(net, place) => (format!("→ {place}@{net}"), Look::Place),
        Kind::Transition(parts, _) => {
            let one = parts
                .first()
                .and_then(|one| view.transitions.get(*one as usize));
            let standing = one.and_then(|one| standings.get(&*one.shown));
            let (mark, look) = match standing {
                Some(Standing::Running) => ("▶", Look::Running),
                Some(Standing::Enabled) => ("●", Look::Enabled),
                _ => ("▮", Look::Waiting),
            };
            (format!("{mark} {}", node.name), look)
        }
    }
}

/// Letters, and for each what it belongs to.
struct Grid {
    cells: Vec<Vec<(char, Look, bool)>>,
    /// Sides to which a line leaves a cell: up, right, down, left.
    lines: Vec<Vec<u8>>,
    heads: BTreeMap<(usize, usize), char>,
}

const UP: u8 = 1;
const RIGHT: u8 = 2;
const DOWN: u8 = 4;
const LEFT: u8 = 8;

impl Grid {
    fn new(width: usize, height: usize) -> Self {
        Self {
            cells: vec![vec![(' ', Look::Line, false); width]; height],
            lines: vec![vec![0; width]; height],
            heads: BTreeMap::new(),
        }
    }

    fn set(&mut self, (x, y): (usize, usize), letter: char, look: Look, chosen: bool) {
        if let Some(cell) = self.cells.get_mut(y).and_then(|row| row.get_mut(x)) {
            *cell = (letter, look, chosen);
        }
    }

    fn line(&mut self, (x, y): (usize, usize), sides: u8) {
        if let Some(cell) = self.lines.get_mut(y).and_then(|row| row.get_mut(x)) {
            *cell |= sides;
        }
    }

    /// An arc between nodes of neighbouring columns; others are not drawn.
    fn join(&mut self, from: &Spot, to: &Spot, way: Way, wide: usize) {
        let forth = from.column < to.column;
        let (left, right) = if forth { (from, to) } else { (to, from) };
        if right.column - left.column != 1 {
            return;
        }
        let first = left.column * (wide + GAP) + wide;
        let last = first + GAP - 1;
        // Lines of different rows turn at different places, so that they can be told apart.
        let turn = first + 1 + left.row % (GAP - 2);
        let (above, below) = (left.row * BOX + 1, right.row * BOX + 1);
        for x in first..=last {
            let y = if x <= turn { above } else { below };
            let both = LEFT | RIGHT;
            self.line(
                (x, y),
                if x == turn && above != below {
                    LEFT
                } else {
                    both
                },
            );
        }
        if above != below {
            let (top, bottom) = (above.min(below), above.max(below));
            for y in top..=bottom {
                let up = if y > top { UP } else { 0 };
                let down = if y < bottom { DOWN } else { 0 };
                self.line((turn, y), up | down);
            }
            self.line((turn, below), RIGHT);
        }
        let head = match way {
            Way::Read => '◆',
            Way::Inhibit => '○',
            _ if forth => '▶',
            _ => '◀',
        };
        let at = if forth { (last, below) } else { (first, above) };
        self.heads.insert(at, head);
    }

    fn boxed(&mut self, (x, y): (usize, usize), wide: usize, text: &str, look: (Look, bool)) {
        let (look, chosen) = look;
        let [across, down, corners] = if chosen {
            ['━', '┃', '0']
        } else {
            ['─', '│', '1']
        };
        let [a, b, c, d] = if corners == '0' {
            ['┏', '┓', '┗', '┛']
        } else {
            ['╭', '╮', '╰', '╯']
        };
        let last = x + wide - 1;
        for at in x + 1..last {
            self.set((at, y), across, look, chosen);
            self.set((at, y + 2), across, look, chosen);
        }
        let corners = [(x, y, a), (last, y, b), (x, y + 2, c), (last, y + 2, d)];
        for (x, y, letter) in corners {
            self.set((x, y), letter, look, chosen);
        }
        self.set((x, y + 1), down, look, chosen);
        self.set((last, y + 1), down, look, chosen);
        let room = wide.saturating_sub(3);
        let long = text.chars().count() > room;
        let shown = text
            .chars()
            .take(if long { room.saturating_sub(1) } else { room });
        let shown = shown.chain(long.then_some('…'));
        for (index, letter) in shown.enumerate() {
            self.set((x + 2 + index, y + 1), letter, look, chosen);
        }
    }

    fn lines(mut self) -> Vec<Vec<Piece>> {
        for (y, row) in self.lines.iter().enumerate() {
            for (x, sides) in row.iter().enumerate().filter(|(_, sides)| **sides != 0) {
                let head = self.heads.get(&(x, y)).copied();
                let letter = head.unwrap_or_else(|| crossing(*sides));
                if let Some(cell) = self.cells.get_mut(y).and_then(|row| row.get_mut(x)) {
                    *cell = (letter, Look::Line, false);
                }
            }
        }
        let pieces = |row: Vec<(char, Look, bool)>| {
            let mut pieces: Vec<Piece> = Vec::new();
            for (letter, look, chosen) in row {
                match pieces.last_mut() {
                    Some((text, same, also)) if (*same, *also) == (look, chosen) => {
                        text.push(letter)
                    }
                    _ => pieces.push((letter.to_string(), look, chosen)),
                }
            }
            pieces
        };
        self.cells.into_iter().map(pieces).collect()
    }
}

/// The letter whose lines leave to these sides.
fn crossing(sides: u8) -> char {
    const LETTERS: [char; 16] = [
        ' ', '╵', '╶', '└', '╷', '│', '┌', '├', '╴', '┘', '─', '┴', '┐', '┤', '┬', '┼',
    ];
    LETTERS
        .get(usize::from(sides & (UP | RIGHT | DOWN | LEFT)))
        .copied()
        .unwrap_or(' ')
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;
    use pnt::{compile, layout::Detail};

    use super::*;

    fn drawn(text: &str, chosen: &str, size: (usize, usize)) -> Vec<String> {
        let net = compile::net(&Source::new("n.net", text)).unwrap_or_else(|f| panic!("{f}"));
        let view = NetView::new(&net);
        let drawing = Drawing::new(&view, Detail::Written);
        let state = State::initial(&view);
        let chosen = drawing.nodes.iter().position(|node| node.name == chosen);
        let standings = view.transitions.iter();
        let standings = standings.map(|one| (&*one.shown, Standing::of(&view, &state, one).0));
        let lines = around(
            (&view, &drawing, &state),
            &standings.collect(),
            chosen.unwrap(),
            size,
        );
        let text =
            |line: Vec<Piece>| -> String { line.into_iter().map(|(text, ..)| text).collect() };
        lines
            .into_iter()
            .map(|line| text(line).trim_end().to_owned())
            .collect()
    }

    #[test]
    fn what_leads_to_a_transition_stands_left_of_it_and_what_it_leads_to_right() {
        let text = "net n\nplace a = 1, b = 2, c\ntransition t\n  in a\n  read b\n  out c\n";
        let lines = drawn(text, "t", (60, 6));
        let order = |line: &str, names: &[&str]| {
            let at = names.iter().map(|name| line.find(name));
            let at: Option<Vec<usize>> = at.collect();
            assert!(at.is_some_and(|at| at.is_sorted()), "{lines:#?}");
        };
        order(&lines[1], &["│ (●) a", "┃ ● t", "▶│ ( ) c"]);
        order(&lines[4], &["│ (2) b"]);
        // The line of what is only read ends otherwise.
        assert!(lines.concat().contains("◆┃"), "{lines:#?}");
    }

    #[test]
    fn no_more_than_there_is_room_for_and_nothing_beyond_the_edge() {
        let places: Vec<String> = (0..40).map(|index| format!("p{index} = 1")).collect();
        let names: Vec<String> = (0..40).map(|index| format!("p{index}")).collect();
        let text = format!(
            "net n\nplace {}\ntransition t\n  in {}\n  out {}\n",
            places.join(", "),
            names.join(", "),
            names.join(", ")
        );
        for size in [
            (80, 12),
            (160, 30),
            (20, 3),
            (12, 3),
            (12, 2),
            (0, 0),
            (200, 100),
        ] {
            let lines = drawn(&text, "t", size);
            assert!(lines.len() <= size.1, "{size:?}");
            assert!(
                lines.iter().all(|line| line.chars().count() <= size.0),
                "{size:?}"
            );
            let boxes: usize = lines
                .iter()
                .map(|line| line.matches(['╭', '┏']).count())
                .sum();
            assert!(boxes <= MOST, "{size:?}");
        }
    }
}
