//! The words of a PDN file, with their places. What is only for people is left out.

use crate::notation::TextError;

/// What a word is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum What {
    /// `[Name "value"]`.
    Tag(String, String),
    /// A move, perhaps.
    Move,
    /// The end of a game.
    Result,
    /// Something that cannot be read.
    Wrong(String),
}

/// A word and its place.
#[derive(Debug, Clone)]
pub(super) struct Token<'a> {
    pub what: What,
    pub text: &'a str,
    pub line: usize,
    pub column: usize,
}

impl Token<'_> {
    pub(super) fn wrong(&self, reason: String) -> TextError {
        TextError {
            line: self.line,
            column: self.column,
            reason,
        }
    }

    /// An error that was found within the word.
    pub(super) fn inside(&self, error: &TextError) -> TextError {
        TextError {
            line: self.line,
            column: self.column + error.column - 1,
            reason: error.reason.clone(),
        }
    }
}

const RESULTS: [&str; 8] = ["1-0", "0-1", "1/2-1/2", "2-0", "0-2", "1-1", "0-0", "*"];

pub(super) fn tokens(text: &str) -> Vec<Token<'_>> {
    let mut scanner = Scanner {
        text,
        at: 0,
        line: 1,
        column: 1,
        tokens: Vec::new(),
    };
    scanner.run();
    scanner.tokens
}

struct Scanner<'a> {
    text: &'a str,
    at: usize,
    line: usize,
    column: usize,
    tokens: Vec<Token<'a>>,
}

/// A place in the text.
#[derive(Clone, Copy)]
struct Place {
    at: usize,
    line: usize,
    column: usize,
}

impl<'a> Scanner<'a> {
    fn place(&self) -> Place {
        Place {
            at: self.at,
            line: self.line,
            column: self.column,
        }
    }

    fn peek(&self) -> Option<char> {
        self.text
            .get(self.at..)
            .and_then(|rest| rest.chars().next())
    }

    fn next(&mut self) -> Option<char> {
        let next = self.peek()?;
        self.at += next.len_utf8();
        if next == '\n' {
            self.line += 1;
            self.column = 1;
        } else {
            self.column += 1;
        }
        Some(next)
    }

    /// Passes over everything up to a sign, and the sign; says whether it was there.
    fn through(&mut self, sign: char) -> bool {
        while let Some(next) = self.next() {
            if next == sign {
                return true;
            }
        }
        false
    }

    fn while_is(&mut self, is: impl Fn(char) -> bool) -> &'a str {
        let begin = self.at;
        while self.peek().is_some_and(&is) {
            self.next();
        }
        self.text.get(begin..self.at).unwrap_or_default()
    }

    fn push(&mut self, place: Place, what: What) {
        let text = self.text.get(place.at..self.at).unwrap_or_default();
        self.tokens.push(Token {
            what,
            text,
            line: place.line,
            column: place.column,
        });
    }

    fn run(&mut self) {
        // How deep in variations, and where the outer one begins.
        let mut depth = 0_usize;
        let mut outer = self.place();
        while let Some(sign) = self.peek() {
            let place = self.place();
            match sign {
                _ if sign.is_whitespace() || sign == '\u{FEFF}' => {
                    self.next();
                }
                '%' if self.column == 1 => {
                    self.through('\n');
                }
                ';' => {
                    self.through('\n');
                }
                '{' => {
                    if !self.through('}') {
                        self.push(
                            place,
                            What::Wrong("a comment has no end: `}` is missing".to_owned()),
                        );
                    }
                }
                '(' => {
                    if depth == 0 {
                        outer = place;
                    }
                    depth += 1;
                    self.next();
                }
                ')' => {
                    self.next();
                    if depth == 0 {
                        self.push(
                            place,
                            What::Wrong("`)` ends a variation that has not begun".to_owned()),
                        );
                    }
                    depth = depth.saturating_sub(1);
                }
                // A tag within a variation: its end was forgotten.
                '[' => {
                    if depth > 0 {
                        self.push(
                            outer,
                            What::Wrong("a variation has no end: `)` is missing".to_owned()),
                        );
                        depth = 0;
                    }
                    self.tag(place);
                }
                _ => self.word(place, depth),
            }
        }
        if depth > 0 {
            self.push(
                outer,
                What::Wrong("a variation has no end: `)` is missing".to_owned()),
            );
        }
    }

    fn tag(&mut self, place: Place) {
        self.next();
        self.while_is(char::is_whitespace);
        let name = self
            .while_is(|sign| sign.is_alphanumeric() || sign == '_')
            .to_owned();
        self.while_is(char::is_whitespace);
        let what = if name.is_empty() {
            Err("a tag has a name: [Name \"value\"]")
        } else if self.peek() == Some('"') {
            self.next();
            self.value()
                .ok_or("the value of a tag has no end: `\"` is missing")
        } else {
            Err("the value of a tag stands in quotes: [Name \"value\"]")
        };
        let what = what.and_then(|value| {
            self.while_is(char::is_whitespace);
            if self.peek() == Some(']') {
                self.next();
                Ok(What::Tag(name, value))
            } else {
                Err("a tag has no end: `]` is missing")
            }
        });
        match what {
            Ok(tag) => self.push(place, tag),
            Err(reason) => {
                self.while_is(|sign| sign != '\n');
                self.push(place, What::Wrong(reason.to_owned()));
            }
        }
    }

    /// The value of a tag, up to its quote in the same line.
    fn value(&mut self) -> Option<String> {
        let mut value = String::new();
        loop {
            if self.peek() == Some('\n') {
                return None;
            }
            match self.next()? {
                '"' => return Some(value),
                '\\' if matches!(self.peek(), Some('"' | '\\')) => value.extend(self.next()),
                sign => value.push(sign),
            }
        }
    }

    fn word(&mut self, place: Place, depth: usize) {
        let word = self.while_is(|sign| !sign.is_whitespace() && !"{}()[];".contains(sign));
        if word.is_empty() {
            let sign = self.next().unwrap_or_default().escape_debug();
            self.push(place, What::Wrong(format!("`{sign}` stands alone")));
            return;
        }
        if depth > 0 || word.starts_with('$') {
            return;
        }
        // `12.` and `12...` may stand before a move without a space.
        let digits = word.bytes().take_while(u8::is_ascii_digit).count();
        let dots = word
            .bytes()
            .skip(digits)
            .take_while(|sign| *sign == b'.')
            .count();
        let skipped = if dots > 0 { digits + dots } else { 0 };
        let rest = word.get(skipped..).unwrap_or_default();
        let is_result = RESULTS.contains(&rest);
        // A judgement may follow a move: `11-15!?`, `11-15*`.
        let rest = if is_result {
            rest
        } else {
            rest.trim_end_matches(['!', '?', '*'])
        };
        if rest.is_empty() {
            return;
        }
        let what = if is_result { What::Result } else { What::Move };
        self.tokens.push(Token {
            what,
            text: rest,
            line: place.line,
            column: place.column + skipped,
        });
    }
}
