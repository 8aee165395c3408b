//! Questions that the author of a net asks: can this ever be, and does that always stay possible. A
//! question is about tokens of places: `gripper & door_open`, `parts >= 3 | !(idle)`.

use std::fmt;

use ctos::diagnostic::{Finding, Source};

use super::{
    explicit::Explored,
    model::{Model, PlaceNumber, TransitionNumber},
    returns,
    structure::semiflows,
};

/// Candidates for invariants that are looked at most.
const INVARIANTS: usize = 2_000;

/// The deepest nesting of a question.
const DEEPEST: usize = 100;

/// A comparison with a number of tokens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compare {
    AtLeast,
    AtMost,
    Exactly,
    Not,
}

/// What is asked about a marking.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Formula {
    Tokens(PlaceNumber, Compare, u32),
    Not(Box<Formula>),
    And(Vec<Formula>),
    Or(Vec<Formula>),
}

impl Formula {
    fn holds(&self, marking: &[u32]) -> bool {
        match self {
            Self::Tokens(place, compare, number) => {
                let tokens = marking.get(*place as usize).copied().unwrap_or(0);
                match compare {
                    Compare::AtLeast => tokens >= *number,
                    Compare::AtMost => tokens <= *number,
                    Compare::Exactly => tokens == *number,
                    Compare::Not => tokens != *number,
                }
            }
            Self::Not(inner) => !inner.holds(marking),
            Self::And(parts) => parts.iter().all(|part| part.holds(marking)),
            Self::Or(parts) => parts.iter().any(|part| part.holds(marking)),
        }
    }

    /// The least tokens that it asks for, if it is a list of such wishes.
    fn at_least(&self) -> Option<Vec<(PlaceNumber, u32)>> {
        match self {
            Self::Tokens(place, Compare::AtLeast | Compare::Exactly, number) => {
                Some(vec![(*place, *number)])
            }
            Self::And(parts) => {
                let lists: Option<Vec<_>> = parts.iter().map(Self::at_least).collect();
                Some(lists?.concat())
            }
            _ => None,
        }
    }
}

/// A question about the markings of a model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Question {
    text: String,
    formula: Formula,
}

impl fmt::Display for Question {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Why something never is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Because {
    /// No firing changes this weighted sum of tokens, and the question asks for a larger one.
    Invariant(Vec<(PlaceNumber, u64)>),
    /// So many markings are all there are, and each was looked at.
    Exhausted(usize),
}

/// A witness: a firing sequence from the initial marking, and the marking that it ends in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Witness {
    /// The firings; a shortest sequence to the marking.
    pub sequence: Vec<TransitionNumber>,
    /// The marking.
    pub marking: Vec<u32>,
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// It can be: so. Or it does not stay possible: from here it is not.
    Witness(Witness),
    /// No marking is like that. Or from every one a way leads there.
    Proved(Because),
    /// A limit came first.
    Unknown,
}

impl Question {
    /// Reads a question about the places of a model. A place may be written without its net where that
    /// leaves no doubt, and in quotes when its name is not a word.
    ///
    /// # Errors
    /// A finding that points into the text.
    pub fn parse(text: &str, model: &Model) -> Result<Self, Finding> {
        let mut parser = Parser {
            source: Source::new("question", text),
            text,
            at: 0,
            depth: 0,
            model,
        };
        let formula = parser.any()?;
        parser.space();
        if parser.at < text.len() {
            return Err(parser.wrong(
                "the question could end here",
                "write `&` or `|` between its parts",
            ));
        }
        Ok(Self {
            text: text.to_owned(),
            formula,
        })
    }

    /// Whether a marking is as asked.
    #[must_use]
    pub fn holds(&self, marking: &[u32]) -> bool {
        self.formula.holds(marking)
    }

    /// Whether a reachable marking is as asked.
    #[must_use]
    pub fn can_be(&self, explored: &Explored<'_>) -> Answer {
        if let Some(reached) = explored.nearest(|marking| self.holds(marking)) {
            return witness(explored, reached.marking);
        }
        if let Some(invariant) = self.excluded(explored.model()) {
            return Answer::Proved(Because::Invariant(invariant));
        }
        if explored.complete() {
            Answer::Proved(Because::Exhausted(explored.markings))
        } else {
            Answer::Unknown
        }
    }

    /// Whether from every reachable marking one as asked can be reached.
    #[must_use]
    pub fn stays_possible(&self, explored: &Explored<'_>, bytes: usize) -> Answer {
        match returns::always_reachable(explored, &|marking| self.holds(marking), bytes) {
            None => Answer::Unknown,
            Some(None) => Answer::Proved(Because::Exhausted(explored.markings)),
            Some(Some(marking)) => witness(explored, marking),
        }
    }

    /// An invariant whose sum is smaller than what the question asks for.
    fn excluded(&self, model: &Model) -> Option<Vec<(PlaceNumber, u64)>> {
        let wanted = self.formula.at_least()?;
        let initial = model.initial();
        let invariants = semiflows::place_invariants(model, INVARIANTS)?;
        let too_much = |weights: &Vec<u64>| {
            let sum = |tokens: &mut dyn Iterator<Item = (PlaceNumber, u32)>| -> u128 {
                tokens
                    .map(|(p, n)| u128::from(weights[p as usize]) * u128::from(n))
                    .sum()
            };
            let mut least: Vec<(PlaceNumber, u32)> = Vec::new();
            for (place, number) in &wanted {
                match least.iter_mut().find(|(other, _)| other == place) {
                    Some((_, most)) => *most = (*most).max(*number),
                    None => least.push((*place, *number)),
                }
            }
            sum(&mut least.into_iter()) > sum(&mut (0..).zip(initial.iter().copied()))
        };
        let weights = invariants.into_iter().find(too_much)?;
        Some(
            (0..)
                .zip(weights)
                .filter(|(_, weight)| *weight > 0)
                .collect(),
        )
    }
}

fn witness(explored: &Explored<'_>, marking: Vec<u32>) -> Answer {
    match explored.path(&marking) {
        Some(sequence) => Answer::Witness(Witness { sequence, marking }),
        None => Answer::Unknown,
    }
}

struct Parser<'a> {
    source: Source,
    text: &'a str,
    at: usize,
    depth: usize,
    model: &'a Model,
}

impl Parser<'_> {
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    fn space(&mut self) {
        self.at = self.text.len() - self.rest().trim_start().len();
    }

    fn eat(&mut self, sign: &str) -> bool {
        self.space();
        let there = self.rest().starts_with(sign);
        if there {
            self.at += sign.len();
        }
        there
    }

    fn wrong(&self, message: &str, help: &str) -> Finding {
        let end = self
            .rest()
            .char_indices()
            .nth(1)
            .map_or(self.text.len(), |(n, _)| self.at + n);
        Finding::error("pnt::question::syntax", message)
            .at(self.source.at(self.at..end))
            .help(help)
    }

    fn any(&mut self) -> Result<Formula, Finding> {
        self.list(Self::all, "|", Formula::Or)
    }

    fn all(&mut self) -> Result<Formula, Finding> {
        self.list(Self::one, "&", Formula::And)
    }

    fn list(
        &mut self,
        part: impl Fn(&mut Self) -> Result<Formula, Finding>,
        sign: &str,
        join: impl Fn(Vec<Formula>) -> Formula,
    ) -> Result<Formula, Finding> {
        let first = part(self)?;
        let mut parts = vec![first];
        while self.eat(sign) {
            // Two of a sign mean the same as one.
            self.eat(sign);
            parts.push(part(self)?);
        }
        match parts.pop() {
            Some(only) if parts.is_empty() => Ok(only),
            last => {
                parts.extend(last);
                Ok(join(parts))
            }
        }
    }

    fn one(&mut self) -> Result<Formula, Finding> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self.wrong(
                "the question is nested too deeply",
                "write it with fewer brackets",
            ));
        }
        let formula = if self.eat("!") {
            Formula::Not(Box::new(self.one()?))
        } else if self.eat("(") {
            let inner = self.any()?;
            if !self.eat(")") {
                return Err(self.wrong("a bracket is not closed", "write `)` here"));
            }
            inner
        } else {
            self.tokens()?
        };
        self.depth -= 1;
        Ok(formula)
    }

    fn tokens(&mut self) -> Result<Formula, Finding> {
        let place = self.place()?;
        let compares: [(&str, Compare, i64); 7] = [
            (">=", Compare::AtLeast, 0),
            ("<=", Compare::AtMost, 0),
            ("!=", Compare::Not, 0),
            ("==", Compare::Exactly, 0),
            ("=", Compare::Exactly, 0),
            (">", Compare::AtLeast, 1),
            ("<", Compare::AtMost, -1),
        ];
        for (sign, compare, more) in compares {
            if self.eat(sign) {
                let number = i64::from(self.number()?) + more;
                return Ok(match u32::try_from(number) {
                    Ok(number) => Formula::Tokens(place, compare, number),
                    // Fewer than none, or more than any place can hold.
                    Err(_) => Formula::Or(Vec::new()),
                });
            }
        }
        Ok(Formula::Tokens(place, Compare::AtLeast, 1))
    }

    fn number(&mut self) -> Result<u32, Finding> {
        self.space();
        let digits = self
            .rest()
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(self.rest().len());
        match self.rest()[..digits].parse() {
            Ok(number) => {
                self.at += digits;
                Ok(number)
            }
            Err(_) => Err(self.wrong(
                "a number of tokens is expected here",
                "write for example `>= 2`",
            )),
        }
    }

    fn place(&mut self) -> Result<PlaceNumber, Finding> {
        self.space();
        let start = self.at;
        let name = if self.eat("\"") {
            let Some(end) = self.rest().find('"') else {
                return Err(self.wrong("a quoted name does not end", "write `\"` after it"));
            };
            let name = self.rest()[..end].to_owned();
            self.at += end + 1;
            name
        } else {
            let part = |c: char| c.is_alphanumeric() || c == '_' || c == '.';
            let end = self.rest().find(|c| !part(c)).unwrap_or(self.rest().len());
            let name = self.rest()[..end].to_owned();
            self.at += end;
            name
        };
        if name.is_empty() {
            return Err(self.wrong(
                "a place is expected here",
                "write for example `idle & parts >= 2`",
            ));
        }
        self.find(&name)
            .map_err(|finding| finding.at(self.source.at(start..self.at)))
    }

    fn find(&self, name: &str) -> Result<PlaceNumber, Finding> {
        let short = |full: &str| {
            full.split_once('.')
                .map_or(full.to_owned(), |(_, name)| name.to_owned())
        };
        let all = || (0..).zip(self.model.places.iter().map(|place| place.name.as_str()));
        if let Some((number, _)) = all().find(|(_, full)| *full == name) {
            return Ok(number);
        }
        let found: Vec<_> = all().filter(|(_, full)| short(full) == name).collect();
        match found.as_slice() {
            [(number, _)] => Ok(*number),
            [] => {
                let names: Vec<String> = all().map(|(_, full)| short(full)).collect();
                let unknown = Finding::error(
                    "pnt::question::unknown_place",
                    format!("no net here has a place `{name}`"),
                );
                Err(unknown.suggest(name, names.iter().map(String::as_str)))
            }
            several => {
                let names: Vec<&str> = several.iter().map(|(_, full)| *full).collect();
                let ambiguous = Finding::error(
                    "pnt::question::ambiguous_place",
                    format!("several nets have a place `{name}`"),
                );
                Err(ambiguous.help(format!("write one of {}", names.join(", "))))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{
        explicit::{Limits, explore},
        samples::{buffer, model, philosophers},
    };

    fn ask(model: &Model, text: &str) -> (Answer, Answer) {
        let explored = explore(model, &Limits::default());
        let question = Question::parse(text, model).unwrap_or_else(|finding| panic!("{finding}"));
        (
            question.can_be(&explored),
            question.stays_possible(&explored, usize::MAX),
        )
    }

    #[test]
    fn what_can_be_has_a_sequence_that_leads_there() {
        let net = philosophers(5);
        let (can, stays) = ask(&net, "eat0 & eat2");
        let Answer::Witness(witness) = can else {
            panic!("{can:?}")
        };
        assert_eq!(witness.sequence.len(), 4);
        assert_eq!(net.replay(&witness.sequence), Some(witness.marking.clone()));
        assert!(
            Question::parse("eat0 & eat2", &net)
                .unwrap()
                .holds(&witness.marking)
        );
        // All may starve, so that they eat does not stay possible.
        let Answer::Witness(witness) = stays else {
            panic!("{stays:?}")
        };
        assert_eq!(
            (witness.sequence.len(), net.replay(&witness.sequence)),
            (5, Some(witness.marking))
        );
    }

    #[test]
    fn what_cannot_be_rests_on_an_invariant_or_on_all_markings() {
        let net = philosophers(5);
        let (Answer::Proved(Because::Invariant(sum)), _) = ask(&net, "eat0 & eat1") else {
            panic!()
        };
        // The fork between them.
        let fork = net.place("philosophers.fork1").unwrap();
        assert!(sum.contains(&(fork, 1)));
        let (can, _) = ask(&net, "eat0 & !think1 & left1 = 1 & right1 != 0");
        assert!(matches!(can, Answer::Proved(_)), "{can:?}");
        let (can, _) = ask(&net, "eat0 & (fork0 | fork1)");
        assert_eq!(can, Answer::Proved(Because::Exhausted(243)));
    }

    #[test]
    fn what_stays_possible_is_proved_on_all_markings() {
        let net = buffer(3);
        let (_, stays) = ask(&net, "items = 3 & got");
        assert_eq!(stays, Answer::Proved(Because::Exhausted(16)));
        let (can, stays) = ask(&net, "items > 3");
        assert!(matches!(can, Answer::Proved(Because::Invariant(_))));
        assert!(matches!(stays, Answer::Witness(_)));
        let once = model(
            "net n\nplace a = 1, b, c\ntransition t\n  in a\n  out b\ntransition u\n  in b\n  out c\ntransition v\n  in c\n  out b\n",
        );
        let (_, stays) = ask(&once, "a | n.b");
        assert!(matches!(stays, Answer::Proved(_)));
        let (_, stays) = ask(&once, "a");
        assert!(matches!(stays, Answer::Witness(_)));
    }

    #[test]
    fn a_wrong_question_is_pointed_at() {
        let net = buffer(1);
        let wrong = |text: &str| Question::parse(text, &net).unwrap_err().to_string();
        assert!(wrong("idel").contains(
            "question:1:1: error: no net here has a place `idel` (did you mean `idle`?)"
        ));
        assert!(wrong("idle &").contains("question:1:7: error: a place is expected here"));
        assert!(wrong("(idle").contains("1:6: error: a bracket is not closed"));
        assert!(wrong("idle idle").contains("1:6"));
        assert!(wrong("idle >= x").contains("1:9: error: a number"));
        assert!(wrong("\"idle").contains("does not end"));
        assert!(wrong(&"(".repeat(100_000)).contains("nested too deeply"));
        assert!(wrong(&"!".repeat(100_000)).contains("nested too deeply"));
    }
}
