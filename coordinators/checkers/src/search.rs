//! The search for the best move: alpha-beta with principal variations, a transposition table and iterative deepening.
//!
//! Captures are compulsory, so a position is valued only when the side that moves has none: nothing is cut off in the middle of an
//! exchange. A position that occurred before on the way, or moves of kings without end, are draws.

use crate::{
    board::Position,
    evaluate,
    moves::{Move, MoveList},
    rules::{DrawRules, Rules, Variant},
    tables::{Outcome, Tables},
};

/// What a won position is worth, hundredths of a man, less one for each half-move to the end.
pub const WON: i32 = 30_000;

/// Values beyond this are proven: the end was seen.
pub const PROVEN: i32 = WON - 1_000;

/// No line is longer, half-moves.
const LONGEST_LINE: usize = 120;

/// Whether to stop is asked after so many positions.
const ASKED_EVERY: u64 = 256;

const MOST_ENTRIES: usize = 1 << 20;

/// When a search ends.
pub struct Limits<'a> {
    /// After so many positions; exactly the same each time.
    pub nodes: Option<u64>,
    /// After so many half-moves of depth.
    pub depth: u32,
    /// When this says so; it is asked often.
    pub stop: &'a mut dyn FnMut() -> bool,
}

/// What a search found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// The best line; its first move is the one to play. Empty when there is no move.
    pub line: Vec<Move>,
    /// What the position is worth to the side that moves, hundredths of a man.
    pub value: i32,
    /// How deep the last search was that came to its end, half-moves.
    pub depth: u32,
    /// How many positions were looked at.
    pub nodes: u64,
}

/// Searches for the best move. `before` are the keys of positions since the last capture or move of a man, without this one.
#[must_use]
pub fn search<'a>(
    position: &Position,
    variant: Variant,
    before: &[u64],
    tables: Option<&'a Tables>,
    limits: Limits<'a>,
) -> Found {
    let tables = tables.filter(|tables| tables.variant() == variant);
    if let Some(found) = tables.and_then(|tables| tables.found(position)) {
        return found;
    }
    let entries = limits.nodes.map_or(MOST_ENTRIES, |nodes| {
        usize::try_from(nodes).unwrap_or(MOST_ENTRIES)
    });
    let entries = entries.clamp(1 << 12, MOST_ENTRIES).next_power_of_two();
    let mut search = Search {
        variant,
        rules: variant.rules(),
        draws: variant.draws(),
        tables,
        limits,
        nodes: 0,
        stopped: false,
        entries: vec![Entry::default(); entries],
        path: before.to_vec(),
        lines: vec![Vec::new(); LONGEST_LINE + 2],
        history: vec![0; 32 * 32],
    };
    search.deepen(position)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Bound {
    #[default]
    None,
    Exact,
    AtLeast,
    AtMost,
}

/// What is known of a position that was searched.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    key: u64,
    best: Option<Move>,
    value: i32,
    depth: i32,
    bound: Bound,
}

struct Search<'a> {
    variant: Variant,
    rules: Rules,
    draws: DrawRules,
    tables: Option<&'a Tables>,
    limits: Limits<'a>,
    nodes: u64,
    stopped: bool,
    entries: Vec<Entry>,
    /// The keys of the positions since the last lasting move, up to the one that is searched.
    path: Vec<u64>,
    /// The best line from each ply.
    lines: Vec<Vec<Move>>,
    /// How often a move from a square to another was best.
    history: Vec<u32>,
}

impl Search<'_> {
    fn deepen(&mut self, position: &Position) -> Found {
        let mut found = Found {
            line: position
                .moves(self.variant)
                .first()
                .copied()
                .into_iter()
                .collect(),
            value: evaluate::value(position, &self.rules),
            depth: 0,
            nodes: 0,
        };
        if found.line.is_empty() {
            found.value = -WON;
            return found;
        }
        for depth in 1..=self.limits.depth.min(99) {
            let value = self.visit(position, depth.cast_signed(), -WON, WON, 0);
            if self.stopped {
                break;
            }
            let line = self.lines.first().cloned().unwrap_or_default();
            found = Found {
                line: if line.is_empty() { found.line } else { line },
                value,
                depth,
                nodes: 0,
            };
            // The end is seen, and no shorter way to it is hidden beyond this depth.
            if value.abs() > PROVEN && WON - value.abs() <= depth.cast_signed() {
                break;
            }
        }
        found.nodes = self.nodes;
        found
    }

    fn out_of_time(&mut self) -> bool {
        if self.limits.nodes.is_some_and(|most| self.nodes >= most) {
            self.stopped = true;
        }
        // However late it is, one half-move is looked ahead.
        if self.nodes > 0 && self.nodes.is_multiple_of(ASKED_EVERY) && (self.limits.stop)() {
            self.stopped = true;
        }
        self.stopped
    }

    /// The value of a position for the side that moves, `ply` half-moves from the root.
    fn visit(&mut self, position: &Position, depth: i32, alpha: i32, beta: i32, ply: usize) -> i32 {
        if self.out_of_time() {
            return 0;
        }
        self.nodes += 1;
        if let Some(line) = self.lines.get_mut(ply) {
            line.clear();
        }
        let distance = i32::try_from(ply).unwrap_or(i32::MAX);
        let key = position.key();
        if ply > 0 {
            if self.path.contains(&key) || self.path.len() >= self.draws.quiet as usize {
                return 0;
            }
            if let Some(outcome) = self.tables.and_then(|tables| tables.outcome(position)) {
                return outcome.value(distance);
            }
        }
        let mut moves = MoveList::new();
        position.moves_into(self.variant, &mut moves);
        let Some(one) = moves.first().copied() else {
            return -WON + distance;
        };
        let captures = one.captured != 0;
        if ply >= LONGEST_LINE || (depth <= 0 && !captures) {
            return evaluate::value(position, &self.rules);
        }
        let slot = key as usize & (self.entries.len() - 1);
        let known = self
            .entries
            .get(slot)
            .copied()
            .filter(|entry| entry.key == key);
        let known = known.unwrap_or_default();
        // A deeper value would be another one, but for the end that was seen.
        let seen = known.value.abs() > PROVEN && known.depth > depth;
        if ply > 0 && (known.depth == depth || seen) {
            let value = from_here(known.value, -distance);
            let enough = match known.bound {
                Bound::None => false,
                Bound::Exact => true,
                Bound::AtLeast => value >= beta,
                Bound::AtMost => value <= alpha,
            };
            if enough {
                return value;
            }
        }
        self.sort(&mut moves, known.best);
        // A forced capture is no choice: what follows is searched as deeply.
        let deeper = if captures && moves.len() == 1 {
            depth
        } else {
            depth - 1
        };
        let mut best = -WON;
        let mut best_move = None;
        let mut low = alpha;
        for (index, step) in moves.iter().enumerate() {
            let value = self.follow(position, *step, deeper, (low, beta), ply, index > 0);
            if self.stopped {
                return 0;
            }
            if value > best {
                best = value;
                best_move = Some(*step);
            }
            if value > low {
                low = value;
                self.keep_line(ply, *step);
            }
            if low >= beta {
                if !captures && let Some(count) = self.history.get_mut(pair(*step)) {
                    *count = count.saturating_add(
                        depth.cast_unsigned().saturating_mul(depth.cast_unsigned()),
                    );
                }
                break;
            }
        }
        let bound = if best >= beta {
            Bound::AtLeast
        } else if best > alpha {
            Bound::Exact
        } else {
            Bound::AtMost
        };
        if let Some(entry) = self.entries.get_mut(slot) {
            *entry = Entry {
                key,
                best: best_move,
                value: from_here(best, distance),
                depth,
                bound,
            };
        }
        best
    }

    /// The value of a move: with a window of nothing first when it is not expected to be the best.
    fn follow(
        &mut self,
        position: &Position,
        step: Move,
        depth: i32,
        (low, beta): (i32, i32),
        ply: usize,
        doubted: bool,
    ) -> i32 {
        let next = position.after(step);
        let before = position
            .lasting(step)
            .then(|| std::mem::take(&mut self.path));
        if before.is_none() {
            self.path.push(position.key());
        }
        let mut value = low + 1;
        if doubted {
            value = -self.visit(&next, depth, -low - 1, -low, ply + 1);
        }
        if !doubted || (value > low && value < beta) {
            value = -self.visit(&next, depth, -beta, -low, ply + 1);
        }
        match before {
            Some(before) => self.path = before,
            None => {
                self.path.pop();
            }
        }
        value
    }

    fn keep_line(&mut self, ply: usize, step: Move) {
        let rest = self
            .lines
            .get_mut(ply + 1)
            .map(std::mem::take)
            .unwrap_or_default();
        if let Some(line) = self.lines.get_mut(ply) {
            line.clear();
            line.push(step);
            line.extend_from_slice(&rest);
        }
    }

    /// The move that was best before first, then captures of many, then moves that were good elsewhere.
    fn sort(&self, moves: &mut MoveList, best: Option<Move>) {
        moves.sort_by_key(|step| {
            let history = self.history.get(pair(*step)).copied().unwrap_or_default();
            (
                std::cmp::Reverse(Some(*step) == best),
                std::cmp::Reverse(step.captured.count_ones()),
                std::cmp::Reverse(step.crowned),
                std::cmp::Reverse(history),
            )
        });
    }
}

fn pair(step: Move) -> usize {
    usize::from(step.from) * 32 + usize::from(step.to)
}

/// A proven value counts half-moves from the root in a search, and from the position itself where it is kept.
fn from_here(value: i32, distance: i32) -> i32 {
    if value > PROVEN {
        value + distance
    } else if value < -PROVEN {
        value - distance
    } else {
        value
    }
}

impl Outcome {
    /// The value for a search, `distance` half-moves from its root.
    #[must_use]
    pub const fn value(self, distance: i32) -> i32 {
        match self {
            Self::Draw => 0,
            Self::Won(plies) => WON - distance - plies as i32,
            Self::Lost(plies) => -WON + distance + plies as i32,
        }
    }
}

#[cfg(test)]
mod tests;
