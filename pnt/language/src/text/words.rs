//! Reading one line's tokens from left to right: names, lists, numbers, arcs.

use std::{num::NonZeroU32, time::Duration};

use ctos::diagnostic::{Finding, Place as At, Source};

use super::line::{Symbol, Token};
use crate::{
    draft::{DraftArc, Word},
    timing::{Servers, Timing},
};

/// The most that a weight, a capacity or an initial marking can say. A few of them still add up to
/// something that can be counted.
pub(crate) const MOST_TOKENS: u32 = 1_000_000_000;

/// The longest deadline of an action, microseconds: a day.
const DAY_US: f64 = 86_400.0e6;

/// The longest time of a transition, microseconds: 100,000 hours, as breakdowns may take.
const LONGEST_US: f64 = 100_000.0 * 3600.0e6;

/// What is left of a line.
pub(super) struct Words<'a> {
    source: &'a Source,
    rest: &'a [Token],
    end: usize,
}

impl<'a> Words<'a> {
    /// All tokens of a line that ends at byte `end` of the text.
    pub(super) fn new(source: &'a Source, tokens: &'a [Token], end: usize) -> Self {
        Self {
            source,
            rest: tokens,
            end,
        }
    }

    fn next(&mut self) -> Option<&'a Token> {
        let (first, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(first)
    }

    fn expected(&self, what: &str) -> Finding {
        let (found, at) = match self.rest.first() {
            Some(token) => (token.symbol.shown(), token.at()),
            None => (
                "the end of the line".to_owned(),
                self.source.at(self.end..self.end),
            ),
        };
        Finding::error(
            "pnt::text::expected",
            format!("expected {what}, found {found}"),
        )
        .at(at)
    }

    /// A name, called `what` when it is missing: an identifier, or anything in quotes.
    pub(super) fn name(&mut self, what: &str) -> Result<Word, Finding> {
        match self.rest.first() {
            Some(
                token @ Token {
                    symbol: Symbol::Name(text) | Symbol::Quoted(text),
                    ..
                },
            ) => {
                if text.is_empty() {
                    return Err(Finding::error("pnt::text::expected", "a name is not empty")
                        .at(token.at())
                        .help("write at least one character between the quotes"));
                }
                let word = Word::new(text.clone(), token.at());
                self.next();
                Ok(word)
            }
            _ => Err(self.expected(what)),
        }
    }

    /// The word that begins a statement; a name in quotes is none.
    pub(super) fn first(&mut self) -> Result<Word, Finding> {
        match self.rest.first() {
            Some(Token {
                symbol: Symbol::Name(_),
                ..
            }) => self.name("a keyword"),
            _ => Err(self.expected("a keyword")),
        }
    }

    /// A place, which in an instance of a subnet has the instance's name and a point before it.
    pub(super) fn place(&mut self, what: &str) -> Result<Word, Finding> {
        let mut place = self.name(what)?;
        while self.take(".") {
            let part = self.name("a place of the instance")?;
            let whole = format!("{place}.{part}");
            place.text = whole;
            place.at.range.end = part.at.range.end.max(place.at.range.start);
        }
        Ok(place)
    }

    /// One or more places with commas between them.
    pub(super) fn places(&mut self) -> Result<Vec<Word>, Finding> {
        let mut places = vec![self.place("a place")?];
        while self.take(",") {
            places.push(self.place("a place")?);
        }
        Ok(places)
    }

    /// An argument of a subnet: everything up to a comma or the closing parenthesis.
    pub(super) fn argument(&mut self) -> Result<Vec<Token>, Finding> {
        let ends = |token: &Token| matches!(token.symbol, Symbol::Mark("," | ")" | "("));
        let length = self.rest.iter().position(ends).unwrap_or(self.rest.len());
        let (argument, rest) = self.rest.split_at(length);
        if argument.is_empty() {
            return Err(self.expected("an argument"));
        }
        self.rest = rest;
        Ok(argument.to_vec())
    }

    /// One or more names with commas between them.
    pub(super) fn names(&mut self, what: &str) -> Result<Vec<Word>, Finding> {
        let mut names = vec![self.name(what)?];
        while self.take(",") {
            names.push(self.name(what)?);
        }
        Ok(names)
    }

    /// Takes a mark if it is next.
    pub(super) fn take(&mut self, mark: &str) -> bool {
        let found = matches!(self.rest.first(), Some(Token { symbol: Symbol::Mark(next), .. }) if *next == mark);
        if found {
            self.next();
        }
        found
    }

    /// A mark that must be next.
    pub(super) fn mark(&mut self, mark: &str) -> Result<(), Finding> {
        if self.take(mark) {
            Ok(())
        } else {
            Err(self.expected(&format!("`{mark}`")))
        }
    }

    /// Takes a word if it is next.
    pub(super) fn keyword(&mut self, keyword: &str) -> bool {
        let found = matches!(self.rest.first(), Some(Token { symbol: Symbol::Name(next), .. }) if next == keyword);
        if found {
            self.next();
        }
        found
    }

    /// A word that must be next.
    pub(super) fn expect_keyword(&mut self, keyword: &str) -> Result<(), Finding> {
        if self.keyword(keyword) {
            Ok(())
        } else {
            Err(self.expected(&format!("`{keyword}`")))
        }
    }

    /// Quoted text, if it is next.
    pub(super) fn quoted(&mut self) -> Option<String> {
        match self.rest.first() {
            Some(Token {
                symbol: Symbol::Quoted(text),
                ..
            }) => {
                self.next();
                Some(text.clone())
            }
            _ => None,
        }
    }

    fn number(&mut self, what: &str) -> Result<(&'a str, At), Finding> {
        match self.rest.first() {
            Some(
                token @ Token {
                    symbol: Symbol::Number(text),
                    ..
                },
            ) => {
                self.next();
                Ok((text, token.at()))
            }
            _ => Err(self.expected(what)),
        }
    }

    /// A whole number of at least `least`.
    pub(super) fn whole(&mut self, what: &str, least: u32) -> Result<u32, Finding> {
        let (text, at) = self.number(what)?;
        match text.parse::<u32>() {
            Ok(value) if (least..=MOST_TOKENS).contains(&value) => Ok(value),
            _ => Err(
                Finding::error("pnt::text::number", format!("{what} cannot be {text}"))
                    .at(at)
                    .help(format!(
                        "write a whole number from {least} to {MOST_TOKENS}"
                    )),
            ),
        }
    }

    /// One or more arcs: `p`, `p*2`, `p@net`, `p@net*2`.
    pub(super) fn arcs(&mut self) -> Result<Vec<DraftArc>, Finding> {
        let mut arcs = vec![self.arc()?];
        while self.take(",") {
            arcs.push(self.arc()?);
        }
        Ok(arcs)
    }

    /// One arc.
    pub(super) fn arc(&mut self) -> Result<DraftArc, Finding> {
        let place = self.place("a place")?;
        let net = if self.take("@") {
            Some(self.name("the net of the remote place")?)
        } else {
            None
        };
        let weight = if self.take("*") {
            self.whole("the arc's weight", 1)?
        } else {
            1
        };
        Ok(DraftArc { place, net, weight })
    }

    /// Whether an expression is next.
    pub(super) fn is_expression(&self) -> bool {
        matches!(
            self.rest.first(),
            Some(Token {
                symbol: Symbol::Expression(_),
                ..
            })
        )
    }

    /// An expression, as it stands.
    pub(super) fn expression(&mut self, what: &str) -> Result<Word, Finding> {
        match self.rest.first() {
            Some(
                token @ Token {
                    symbol: Symbol::Expression(text),
                    ..
                },
            ) => {
                self.next();
                Ok(Word::new(text.clone(), token.at()))
            }
            _ => Err(self.expected(what)),
        }
    }

    /// A line in quotes.
    pub(super) fn line(&mut self, what: &str) -> Result<Word, Finding> {
        match self.rest.first() {
            Some(
                token @ Token {
                    symbol: Symbol::Quoted(text),
                    ..
                },
            ) => {
                self.next();
                Ok(Word::new(text.clone(), token.at()))
            }
            _ => Err(self.expected(what)),
        }
    }

    /// How long a transition waits, up to a day.
    pub(super) fn wait(&mut self) -> Result<Duration, Finding> {
        self.time("a wait", DAY_US)
    }

    /// The deadline of an action, up to a day.
    pub(super) fn duration(&mut self) -> Result<Duration, Finding> {
        self.time("a limit", DAY_US)
    }

    /// A transition's time: `2 s`, `exponential 2 s` or `normal 2 s spread 0.3 s`.
    pub(super) fn timing(&mut self) -> Result<Timing, Finding> {
        if self.keyword("exponential") {
            let mean = self.time("a mean", LONGEST_US)?;
            return Ok(Timing::Exponential { mean });
        }
        if self.keyword("normal") {
            let mean = self.time("a mean", LONGEST_US)?;
            self.expect_keyword("spread")?;
            let spread = self.time("a spread", LONGEST_US)?;
            return Ok(Timing::Normal { mean, spread });
        }
        if let Some(
            token @ Token {
                symbol: Symbol::Name(other),
                ..
            },
        ) = self.rest.first()
        {
            return Err(Finding::error(
                "pnt::text::expected",
                format!("`{other}` is no kind of time"),
            )
            .at(token.at())
            .help("write `time 2 s`, `time exponential 2 s` or `time normal 2 s spread 0.3 s`"));
        }
        Ok(Timing::Deterministic(self.time("a time", LONGEST_US)?))
    }

    /// How many firings may go on at once: a number or `many`.
    pub(super) fn servers(&mut self) -> Result<Servers, Finding> {
        if self.keyword("many") {
            return Ok(Servers::Many);
        }
        let most = self.whole("the number of servers", 1)?;
        Ok(NonZeroU32::new(most).map_or(Servers::ONE, Servers::Limit))
    }

    /// A share in conflicts.
    pub(super) fn weight(&mut self) -> Result<f64, Finding> {
        let (text, at) = self.number("the weight")?;
        match text.parse::<f64>() {
            Ok(weight) if (1.0e-9..=1.0e9).contains(&weight) => Ok(weight),
            _ => Err(
                Finding::error("pnt::text::number", format!("the weight cannot be {text}"))
                    .at(at)
                    .help("write a number from 0.000000001 to 1000000000"),
            ),
        }
    }

    /// A time of at most `most_us` microseconds: a number and its unit, kept to the microsecond.
    fn time(&mut self, what: &str, most_us: f64) -> Result<Duration, Finding> {
        let (text, at) = self.number("a time")?;
        let unit = self.name("the unit `ms`, `s`, `min` or `h`")?;
        let unit_us = match unit.text.as_str() {
            "ms" => 1.0e3,
            "s" => 1.0e6,
            "min" => 60.0e6,
            "h" => 3600.0e6,
            _ => {
                return Err(Finding::error(
                    "pnt::text::unit",
                    format!("`{unit}` is no unit of time here"),
                )
                .at(unit.at)
                .help("write `ms`, `s`, `min` or `h`"));
            }
        };
        let micros = (text.parse::<f64>().unwrap_or(f64::NAN) * unit_us).round();
        if !(1.0..=most_us).contains(&micros) {
            return Err(Finding::error(
                "pnt::text::number",
                format!("{what} of {text} {unit} cannot be kept"),
            )
            .at(at)
            .help(format!(
                "write a time from 0.001 ms to {} h",
                most_us / 3600.0e6
            )));
        }
        // In range by the test above, so the conversion is exact.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        Ok(Duration::from_micros(micros as u64))
    }

    /// Nothing may be left.
    pub(super) fn end(&self) -> Result<(), Finding> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(self
                .expected("the end of the line")
                .help("one statement stands on a line; names in a list have commas between them"))
        }
    }
}
