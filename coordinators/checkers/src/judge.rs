//! Which legal move somebody means, or which rule says that there is none.

use crate::{
    board::{Position, Way, bit},
    capture,
    moves::{Move, Route},
    notation::{Numbering, Refusal, Written, travelled},
    rules::{Priority, Variant},
};

/// So many candidates are told.
const MOST_TOLD: usize = 12;

impl Position {
    /// The legal move that is written.
    ///
    /// # Errors
    /// The rule that it breaks, or the moves that it may mean.
    pub fn find(
        &self,
        written: &Written,
        variant: Variant,
        numbering: Numbering,
    ) -> Result<Move, Refusal> {
        let routes = self.routes(variant);
        let fits = |route: &&Route| fits(route, written, false);
        let mut meant: Vec<Move> = Vec::new();
        // Exactly these landings first; then a way over these squares.
        for route in routes.iter().filter(fits) {
            if !meant.contains(&route.step) {
                meant.push(route.step);
            }
        }
        if meant.is_empty() {
            for route in routes
                .iter()
                .filter(|route| self::fits(route, written, true))
            {
                if !meant.contains(&route.step) {
                    meant.push(route.step);
                }
            }
        }
        match meant.as_slice() {
            [one] => {
                let captures = one.captured != 0;
                if written.captures.is_some_and(|said| said != captures) {
                    let word = numbering.short(*one, 'x');
                    let reason = if captures {
                        format!("this is a capture: write {word}")
                    } else {
                        format!("this captures nothing: write {word}")
                    };
                    return Err(Refusal(reason));
                }
                Ok(*one)
            }
            [] => Err(Refusal(
                self.broken_rule(&routes, written, variant, numbering),
            )),
            several => {
                let words = self.words(variant, numbering);
                let words = words.iter().filter(|(_, step)| several.contains(step));
                let words: Vec<&str> = words
                    .map(|(word, _)| word.as_str())
                    .take(MOST_TOLD)
                    .collect();
                let words = words.join(", ");
                Err(Refusal(format!(
                    "this can be any of {words}: write more of its squares"
                )))
            }
        }
    }

    /// Why a move is not legal, in words for a player.
    fn broken_rule(
        &self,
        legal: &[Route],
        written: &Written,
        variant: Variant,
        numbering: Numbering,
    ) -> String {
        let (Some(from), Some(to)) = (written.squares.first(), written.squares.last()) else {
            return "a move has two squares".to_owned();
        };
        let number = |square: u8| numbering.number(square);
        let turn = self.turn.name();
        let piece = match self.piece(*from) {
            None => return format!("nothing stands on {}", number(*from)),
            Some(piece) if piece.colour != self.turn => {
                return format!("it is {turn}'s turn, and {} is not {turn}'s", number(*from));
            }
            Some(piece) => piece,
        };
        if let Some(square) = (written.squares.iter().skip(1))
            .find(|square| *square != from && self.empty() & bit(**square) == 0)
        {
            return format!("{} is not empty", number(*square));
        }
        let Some(example) = self.words(variant, numbering).into_iter().next() else {
            return format!("{turn} has no move: the game is over");
        };
        let must_capture = example.1.captured != 0;
        // The same without priorities.
        let mut free = variant.rules();
        free.priority = Priority::Free;
        let mut all: Vec<Route> = Vec::new();
        capture::collect(self, &free, &mut all);
        if let Some(lesser) = all.iter().find(|route| fits(route, written, true)) {
            return self.lesser(lesser, legal, variant, &example.0);
        }
        let stops_early = |route: &&Route| {
            let mut begun = written.clone();
            begun.captures = None;
            let over = travelled(route);
            route.step.from == *from
                && written.captures != Some(false)
                && subsequence(&begun.squares, &over)
        };
        if let Some(longer) = all.iter().find(stops_early) {
            let word = numbering.route(longer, 'x');
            return format!("a capture goes on as long as it can: {word}");
        }
        if must_capture && written.captures != Some(true) {
            return format!("captures are compulsory: {}", example.0);
        }
        let kind = if piece.king { "king" } else { "man" };
        if written.captures == Some(true) {
            let (from, to) = (number(*from), number(*to));
            return format!("the {kind} on {from} captures nothing on the way to {to}");
        }
        let line = Way::ALL.into_iter().any(|way| {
            let mut at = way.step(bit(*from));
            while at != 0 && at != bit(*to) {
                at = way.step(at);
            }
            at != 0
        });
        let (from, to) = (number(*from), number(*to));
        if !line {
            return format!("{from} and {to} are not on one diagonal");
        }
        if !piece.king {
            return format!("a man moves to the next square forwards, not from {from} to {to}");
        }
        if variant.rules().flying {
            return format!("something stands between {from} and {to}");
        }
        format!("a king moves to the next square, not from {from} to {to}")
    }

    /// Why a capture that is one is not allowed.
    fn lesser(&self, route: &Route, legal: &[Route], variant: Variant, example: &str) -> String {
        let count = route.step.captured.count_ones();
        let most = legal.iter().map(|other| other.step.captured.count_ones());
        let most = most.max().unwrap_or_default();
        let king = self.kings & bit(route.step.from) != 0;
        if most > count && variant.rules().priority != Priority::WithKing {
            return format!(
                "the largest number must be captured, {most} and not {count}: {example}"
            );
        }
        let with_king = legal
            .iter()
            .any(|other| self.kings & bit(other.step.from) != 0);
        if with_king && !king {
            return format!("where a king can capture, it must: {example}");
        }
        let kings = |route: &Route| (route.step.captured & self.kings).count_ones();
        let more = legal.iter().map(kings).max().unwrap_or_default();
        if more > kings(route) {
            return format!("most kings must be captured, {more}: {example}");
        }
        format!("kings must be captured as early as can be: {example}")
    }
}

/// Whether a route is what is written: its first and last square, and the squares between, all or as a part of the way.
fn fits(route: &Route, written: &Written, over: bool) -> bool {
    let squares = &written.squares;
    if squares.first() != Some(&route.step.from) || squares.last() != Some(&route.step.to) {
        return false;
    }
    let between = squares.get(1..squares.len() - 1).unwrap_or_default();
    if between.is_empty() {
        return true;
    }
    if over {
        return subsequence(squares, &travelled(route));
    }
    squares.get(1..) == Some(&route.landings)
}

/// Whether all of `few` stand in `many`, in the same order.
fn subsequence(few: &[u8], many: &[u8]) -> bool {
    let mut many = many.iter();
    few.iter().all(|square| many.any(|other| other == square))
}
