//! The written form of what comes on tapes:
//!
//! ```text
//! tapes    = tape { tape }           the first may be without its net
//! tape     = [ net ":" ] choice
//! choice   = sequence { "|" sequence }
//! sequence = repeat { repeat }
//! repeat   = one { "*" | "+" | "?" | "{" number [ "," [ number ] ] "}" }
//! one      = symbol | "." | "(" [ choice ] ")"
//! ```
//!
//! A symbol or net is letters, digits and `_`, or anything in double quotes; `#` begins a comment.

use std::ops::Range;

use ctos::diagnostic::{Finding, Source};

use super::{Expression, Word};

/// The deepest nesting, of brackets and of repetitions.
const DEEPEST: usize = 100;

/// The most often that something can be repeated by number.
const MOST_TIMES: u32 = 1000;

/// What comes on one tape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The net, where it is named.
    pub net: Option<Word>,
    /// What comes.
    pub expression: Expression<Word>,
    /// Bytes of the expression.
    pub range: Range<usize>,
}

/// Reads a text.
///
/// # Errors
/// A finding that points to where it cannot be read.
pub fn parse(source: &Source) -> Result<Vec<Written>, Finding> {
    let mut parser = Parser {
        source,
        text: source.text(),
        at: 0,
        depth: 0,
    };
    let mut tapes = Vec::new();
    loop {
        let net = parser.heading()?;
        if net.is_none() && !tapes.is_empty() {
            return Err(parser.wrong(
                "a `)` here closes nothing, or a sign stands alone",
                "take it out, or put what it belongs to before it",
            ));
        }
        let start = parser.at;
        let expression = parser.choice()?;
        tapes.push(Written {
            net,
            expression,
            range: start..start + parser.text[start..parser.at].trim_end().len(),
        });
        parser.space();
        if parser.rest().is_empty() {
            return Ok(tapes);
        }
    }
}

struct Parser<'a> {
    source: &'a Source,
    text: &'a str,
    at: usize,
    depth: usize,
}

impl Parser<'_> {
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    /// Skips blanks and comments.
    fn space(&mut self) {
        loop {
            self.at = self.text.len() - self.rest().trim_start().len();
            if !self.rest().starts_with('#') {
                return;
            }
            self.at += self.rest().find('\n').unwrap_or(self.rest().len());
        }
    }

    fn eat(&mut self, sign: char) -> bool {
        self.space();
        let there = self.rest().starts_with(sign);
        if there {
            self.at += sign.len_utf8();
        }
        there
    }

    fn wrong(&self, message: &str, help: &str) -> Finding {
        let first = self.rest().chars().next().map_or(0, char::len_utf8);
        Finding::error("pnt::tape::syntax", message)
            .at(self.source.at(self.at..self.at + first))
            .help(help)
    }

    /// A name or quotation; the place is left alone when there is none.
    fn word(&mut self) -> Result<Option<Word>, Finding> {
        self.space();
        let start = self.at;
        let text = if self.rest().starts_with('"') {
            self.quoted()?
        } else {
            let part = |c: char| c.is_alphanumeric() || c == '_';
            let end = self.rest().find(|c| !part(c)).unwrap_or(self.rest().len());
            let name = self.rest()[..end].to_owned();
            self.at += end;
            name
        };
        let range = start..self.at;
        Ok((!range.is_empty()).then_some(Word { text, range }))
    }

    fn quoted(&mut self) -> Result<String, Finding> {
        let (mut text, mut escaped) = (String::new(), false);
        for (at, character) in self.rest().char_indices().skip(1) {
            match character {
                '"' if !escaped => {
                    self.at += at + 1;
                    return Ok(text);
                }
                '\\' if !escaped => escaped = true,
                other => {
                    escaped = false;
                    text.push(other);
                }
            }
        }
        Err(self.wrong("a quotation does not end", "write `\"` after it"))
    }

    /// The net that a tape belongs to, with its colon.
    fn heading(&mut self) -> Result<Option<Word>, Finding> {
        let before = self.at;
        let net = self.word()?;
        if net.is_some() && self.eat(':') {
            self.space();
            return Ok(net);
        }
        self.at = before;
        self.space();
        Ok(None)
    }

    fn choice(&mut self) -> Result<Expression<Word>, Finding> {
        let mut parts = vec![self.sequence()?];
        while self.eat('|') {
            // Two of a sign mean the same as one.
            self.eat('|');
            parts.push(self.sequence()?);
        }
        Ok(one_or(parts, Expression::Choice))
    }

    fn sequence(&mut self) -> Result<Expression<Word>, Finding> {
        let mut parts = Vec::new();
        while let Some(one) = self.one()? {
            parts.push(self.repeated(one)?);
        }
        if parts.is_empty() {
            return Err(self.wrong(
                "an input symbol is expected here",
                "write for example `calibrate (carry | resect)* park`, and `()` for nothing at all",
            ));
        }
        Ok(one_or(parts, Expression::Sequence))
    }

    fn one(&mut self) -> Result<Option<Expression<Word>>, Finding> {
        if self.eat('.') {
            return Ok(Some(Expression::Any));
        }
        if self.eat('(') {
            if self.eat(')') {
                return Ok(Some(Expression::Sequence(Vec::new())));
            }
            self.deeper()?;
            let inner = self.choice()?;
            if !self.eat(')') {
                return Err(self.wrong("a bracket is not closed", "write `)` here"));
            }
            self.depth -= 1;
            return Ok(Some(inner));
        }
        // The name of the next tape's net belongs to that.
        let before = self.at;
        if self.heading()?.is_some() {
            self.at = before;
            return Ok(None);
        }
        Ok(self.word()?.map(Expression::Symbol))
    }

    fn deeper(&mut self) -> Result<(), Finding> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self.wrong("this is nested too deeply", "write it with fewer brackets"));
        }
        Ok(())
    }

    fn repeated(&mut self, mut one: Expression<Word>) -> Result<Expression<Word>, Finding> {
        let before = self.depth;
        loop {
            let (least, most) = if self.eat('*') {
                (0, None)
            } else if self.eat('+') {
                (1, None)
            } else if self.eat('?') {
                (0, Some(1))
            } else if self.eat('{') {
                self.times()?
            } else {
                self.depth = before;
                return Ok(one);
            };
            self.deeper()?;
            one = Expression::Repeat(Box::new(one), least, most);
        }
    }

    /// Numbers of times, up to the closing brace.
    fn times(&mut self) -> Result<(u32, Option<u32>), Finding> {
        let least = self.number()?;
        let most = if !self.eat(',') {
            Some(least)
        } else if self.rest().trim_start().starts_with('}') {
            None
        } else {
            Some(self.number()?)
        };
        if most.is_some_and(|most| most < least) {
            return Err(self.wrong(
                "at most is fewer than at least",
                "write the smaller number first",
            ));
        }
        if !self.eat('}') {
            return Err(self.wrong("a brace is not closed", "write `}` here"));
        }
        Ok((least, most))
    }

    fn number(&mut self) -> Result<u32, Finding> {
        self.space();
        let digits = self.rest().find(|c: char| !c.is_ascii_digit());
        let digits = digits.unwrap_or(self.rest().len());
        match self.rest()[..digits].parse() {
            Ok(number) if number <= MOST_TIMES => {
                self.at += digits;
                Ok(number)
            }
            _ => Err(self.wrong(
                &format!("a number of times is expected here, {MOST_TIMES} at most"),
                "write for example `{2}`, `{2,}` or `{2,3}`; `*` is as often as it likes",
            )),
        }
    }
}

fn one_or(
    mut parts: Vec<Expression<Word>>,
    join: impl Fn(Vec<Expression<Word>>) -> Expression<Word>,
) -> Expression<Word> {
    match parts.pop() {
        Some(only) if parts.is_empty() => only,
        last => {
            parts.extend(last);
            join(parts)
        }
    }
}
