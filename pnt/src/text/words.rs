//! Reading one line's tokens from left to right: names, lists, numbers, arcs.

use std::time::Duration;

use ctos::diagnostic::{Finding, Place as At, Source};

use super::line::{Symbol, Token};
use crate::draft::{DraftArc, Word};

/// Weights and initial tokens above this are taken for slips of the keyboard.
const MOST_TOKENS: u32 = 1_000_000;

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

    pub(super) fn at_end(&self) -> bool {
        self.rest.is_empty()
    }

    fn next(&mut self) -> Option<&'a Token> {
        let (first, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(first)
    }

    fn expected(&self, what: &str) -> Finding {
        let (found, at) = match self.rest.first() {
            Some(token) => (token.symbol.shown(), self.source.at(token.range.clone())),
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

    /// A name, called `what` when it is missing.
    pub(super) fn name(&mut self, what: &str) -> Result<Word, Finding> {
        match self.rest.first() {
            Some(Token {
                symbol: Symbol::Name(text),
                range,
            }) => {
                let word = Word::new(text.clone(), self.source.at(range.clone()));
                self.next();
                Ok(word)
            }
            _ => Err(self.expected(what)),
        }
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
            Some(Token {
                symbol: Symbol::Number(text),
                range,
            }) => {
                self.next();
                Ok((text, self.source.at(range.clone())))
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
        let mut arcs = Vec::new();
        loop {
            let place = self.name("a place")?;
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
            arcs.push(DraftArc { place, net, weight });
            if !self.take(",") {
                return Ok(arcs);
            }
        }
    }

    /// A time: a number and `ms`, `s` or `min`, kept to the microsecond.
    pub(super) fn duration(&mut self) -> Result<Duration, Finding> {
        const DAY_US: f64 = 86_400.0e6;
        let (text, at) = self.number("a time")?;
        let unit = self.name("the unit `ms`, `s` or `min`")?;
        let unit_us = match unit.text.as_str() {
            "ms" => 1.0e3,
            "s" => 1.0e6,
            "min" => 60.0e6,
            _ => {
                return Err(Finding::error(
                    "pnt::text::unit",
                    format!("`{unit}` is no unit of time here"),
                )
                .at(unit.at)
                .help("write `ms`, `s` or `min`"));
            }
        };
        let micros = (text.parse::<f64>().unwrap_or(f64::NAN) * unit_us).round();
        if !(1.0..=DAY_US).contains(&micros) {
            return Err(Finding::error(
                "pnt::text::number",
                format!("a limit of {text} {unit} cannot be kept"),
            )
            .at(at)
            .help("write a time from 0.001 ms to 1440 min"));
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
