//! One line of net text as symbols with byte ranges. Knows no keyword.

use std::ops::Range;

use ctos::diagnostic::{Place as At, Source};

/// A piece of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Symbol {
    /// A name or keyword: a letter or `_`, then letters, digits and `_`.
    Name(String),
    /// Digits, possibly with one decimal point.
    Number(String),
    /// Text between double quotes.
    Quoted(String),
    /// One of `, = * @ : ; . ( ) { } ->`.
    Mark(&'static str),
    /// An expression, up to the end of the line or its comment.
    Expression(String),
}

impl Symbol {
    /// How a finding names it.
    pub(super) fn shown(&self) -> String {
        match self {
            Self::Name(text) | Self::Number(text) | Self::Expression(text) => format!("`{text}`"),
            Self::Quoted(text) => format!("`\"{text}\"`"),
            Self::Mark(mark) => format!("`{mark}`"),
        }
    }
}

/// A symbol and the bytes of the whole text that it takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Token {
    pub(super) symbol: Symbol,
    pub(super) range: Range<usize>,
    /// The text: arguments of subnets come from elsewhere than the line they stand in.
    pub(super) source: Source,
}

impl Token {
    pub(super) fn at(&self) -> At {
        self.source.at(self.range.clone())
    }
}

/// What cannot be read, with its bytes of the whole text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct BadSymbol {
    pub(super) message: String,
    pub(super) range: Range<usize>,
}

const MARKS: [&str; 12] = ["->", ",", "=", "*", "@", ":", ";", ".", "(", ")", "{", "}"];

/// The byte at which a line's comment begins; `None` if it has none.
pub(super) fn comment(line: &str) -> Option<usize> {
    let (mut quoted, mut escaped) = (false, false);
    line.char_indices()
        .find(|(_, character)| {
            let begins = *character == '#' && !quoted;
            if *character == '"' && !escaped {
                quoted = !quoted;
            }
            escaped = quoted && *character == '\\' && !escaped;
            begins
        })
        .map(|(at, _)| at)
}

/// Cuts a line (without its end) that starts at byte `start` of the source into tokens.
pub(super) fn cut(source: &Source, line: &str, start: usize) -> Result<Vec<Token>, BadSymbol> {
    let mut tokens: Vec<Token> = Vec::new();
    let mut rest = line;
    loop {
        rest = rest.trim_start();
        if begins_expression(&tokens) && !is_one_word(rest, &tokens) {
            let text = rest.get(..comment(rest).unwrap_or(rest.len()));
            let text = text.unwrap_or_default().trim_end();
            let at = start + (line.len() - rest.len());
            let range = at..at + text.len();
            if text.contains(|c: char| c.is_control() || ['\u{fffe}', '\u{ffff}'].contains(&c)) {
                let message = "an expression has no control characters".to_owned();
                return Err(BadSymbol { message, range });
            }
            if !text.is_empty() {
                tokens.push(Token {
                    symbol: Symbol::Expression(text.to_owned()),
                    range,
                    source: source.clone(),
                });
            }
            return Ok(tokens);
        }
        let at = start + (line.len() - rest.len());
        let Some(first) = rest.chars().next() else {
            return Ok(tokens);
        };
        if first == '#' {
            return Ok(tokens);
        }
        let (symbol, length) = symbol(rest, first).map_err(|(message, length)| BadSymbol {
            message,
            range: at..at + length,
        })?;
        tokens.push(Token {
            symbol,
            range: at..at + length,
            source: source.clone(),
        });
        rest = rest.get(length..).unwrap_or_default();
    }
}

/// Whether what comes after these symbols is an expression: behind `when`, `when not`, and the `=` of `set` and `data`.
fn begins_expression(tokens: &[Token]) -> bool {
    let is =
        |token: &Token, word: &str| matches!(&token.symbol, Symbol::Name(name) if name == word);
    match tokens {
        [first] => is(first, "when"),
        [first, not] if is(first, "when") => is(not, "not"),
        [first, .., last] => {
            (is(first, "set") || is(first, "data")) && matches!(last.symbol, Symbol::Mark("="))
        }
        [] => false,
    }
}

/// Whether a `when` line goes on with `not` or with nothing but a name, which may be that of a function.
fn is_one_word(rest: &str, tokens: &[Token]) -> bool {
    if matches!(
        tokens.last(),
        Some(Token {
            symbol: Symbol::Mark(_),
            ..
        })
    ) {
        return false;
    }
    let code = rest.get(..comment(rest).unwrap_or(rest.len()));
    let code = code.unwrap_or_default().trim_end();
    let Some(first) = code.chars().next() else {
        return true;
    };
    match symbol(code, first) {
        Ok((Symbol::Name(name), length)) => {
            length == code.len()
                || (name == "not"
                    && tokens.len() == 1
                    && code.get(length..).is_some_and(|after| {
                        after.starts_with(|c: char| c.is_whitespace() || c == '(')
                    }))
        }
        Ok((Symbol::Quoted(_), length)) => length == code.len(),
        _ => false,
    }
}

/// The first symbol of `rest` and its length in bytes.
fn symbol(rest: &str, first: char) -> Result<(Symbol, usize), (String, usize)> {
    let run = |accept: fn(char) -> bool| rest.find(|c| !accept(c)).unwrap_or(rest.len());
    let head = |length: usize| rest.get(..length).unwrap_or_default().to_owned();
    if first.is_ascii_alphabetic() || first == '_' {
        let length = run(|c| c.is_ascii_alphanumeric() || c == '_');
        return Ok((Symbol::Name(head(length)), length));
    }
    if first.is_ascii_digit() {
        let length = run(|c| c.is_ascii_digit() || c == '.');
        let text = head(length);
        if text.parse::<f64>().is_err() {
            return Err((format!("`{text}` is not a number"), length));
        }
        return Ok((Symbol::Number(text), length));
    }
    if first == '"' {
        return quoted(rest);
    }
    for mark in MARKS {
        if rest.starts_with(mark) {
            return Ok((Symbol::Mark(mark), mark.len()));
        }
    }
    let mut digits = rest.chars().skip(1).take_while(char::is_ascii_digit);
    if first == '-' && digits.next().is_some() {
        let length = 2 + digits.count();
        let number = rest.get(..length).unwrap_or(rest);
        let text = format!("`{number}`: numbers in a net count something, from 0 up");
        return Err((text, length));
    }
    Err((
        format!("`{first}` has no meaning in net text"),
        first.len_utf8(),
    ))
}

/// Text between quotes, from the first of them; `\"`, `\\`, `\n`, `\r`, `\t` and `\u{...}` stand for
/// what they usually do.
fn quoted(rest: &str) -> Result<(Symbol, usize), (String, usize)> {
    let mut text = String::new();
    let mut characters = rest.char_indices().skip(1);
    while let Some((at, character)) = characters.next() {
        match character {
            '"' => return Ok((Symbol::Quoted(text), at + 1)),
            '\\' => {
                let after = rest.get(at + 1..).unwrap_or_default();
                let Some((meant, taken)) = escape(after) else {
                    let bad = "a backslash in quotes is followed by one of `\" \\ n r t u{...}`";
                    return Err((bad.to_owned(), rest.len()));
                };
                text.push(meant);
                for _ in 0..taken {
                    characters.next();
                }
            }
            other => text.push(other),
        }
    }
    Err(("this quotation has no end on its line".into(), rest.len()))
}

/// What an escape means, without its backslash, and how many characters it has.
fn escape(text: &str) -> Option<(char, usize)> {
    match text.chars().next()? {
        plain @ ('"' | '\\') => Some((plain, 1)),
        'n' => Some(('\n', 1)),
        'r' => Some(('\r', 1)),
        't' => Some(('\t', 1)),
        'u' => {
            let (digits, _) = text.strip_prefix("u{")?.split_once('}')?;
            let number = u32::from_str_radix(digits, 16).ok()?;
            // `u`, the two braces and the digits, all of which are ASCII.
            Some((char::from_u32(number)?, digits.len() + 3))
        }
        _ => None,
    }
}
