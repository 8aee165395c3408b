//! The textual service object request (SOR) and its reply, in both directions.
//!
//! ```text
//! name EXEC|CTRL|DBX [TMSG] text [FMSG n f1..fn] [IMSG m i1..im] [TDBX message]
//! name RET code      [TMSG] text [FMSG n f1..fn] [IMSG m i1..im] [TDBX message]
//! ```
//!
//! (SORMA technical report, section 1.4.1.) The text is taken as it stands, up to the next keyword
//! outside quotes, without the space around it. A text that is one quoted word as a whole stands for
//! the content of the quotes. Printing quotes where it must, so that reading gives the very same
//! structure back; floats come back to the bit.

use crate::name::{NameError, ObjectName};
use crate::report::Report;
use crate::transport::Transport;
use crate::words::{self, Word, WordError, is_space};
use serde::{Deserialize, Serialize};
use std::fmt::{self, Write as _};
use std::str::FromStr;
use thiserror::Error;

/// The most floats, and the most ints, of a line of text.
pub const MOST_NUMBERS: usize = words::MOST_WORDS / 4;

/// Which part of a service object is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Method {
    /// Do your job.
    Exec,
    /// Take these options.
    Ctrl,
    /// Tell about yourself.
    Dbx,
}

impl Method {
    const ALL: [Self; 3] = [Self::Exec, Self::Ctrl, Self::Dbx];

    fn word(self) -> &'static str {
        match self {
            Self::Exec => "EXEC",
            Self::Ctrl => "CTRL",
            Self::Dbx => "DBX",
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// A request to one object.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Who is asked.
    pub name: ObjectName,
    /// What part of it.
    pub method: Method,
    /// The data. The code of a request has no textual form.
    pub body: Transport,
}

/// An object's answer; its return code is in the body.
#[derive(Debug, Clone, PartialEq)]
pub struct Reply {
    /// Who answers.
    pub name: ObjectName,
    /// The data.
    pub body: Transport,
}

/// Why a text is not a request or reply, or why a body has no textual form.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum RequestError {
    /// Quotes are wrong.
    #[error(transparent)]
    Words(#[from] WordError),
    /// The name is wrong.
    #[error(transparent)]
    Name(#[from] NameError),
    /// There is no name.
    #[error("the request is empty; write: name EXEC|CTRL|DBX text")]
    Empty,
    /// The word after the name is not a method.
    #[error("after the name stands EXEC, CTRL or DBX, not `{0}`")]
    Method(String),
    /// The word after the name is not RET.
    #[error("after the name of a reply stands RET and a code, not `{0}`")]
    Ret(String),
    /// A word that should be a number is none.
    #[error("`{word}` at byte {at} is not {expected}")]
    Number {
        /// The word.
        word: String,
        /// Its byte offset.
        at: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// A count that does not match.
    #[error("{keyword} announces {announced} values, but {found} follow")]
    Count {
        /// FMSG or IMSG.
        keyword: &'static str,
        /// The count as written.
        announced: u64,
        /// How many values there are.
        found: usize,
    },
    /// A keyword for the second time, or TMSG after something else.
    #[error(
        "`{0}` at byte {1} is out of place: the order is [TMSG] text, FMSG, IMSG, TDBX, each at most once; quote a text that contains it"
    )]
    OutOfPlace(String, usize),
    /// Something that no keyword announces.
    #[error(
        "nothing announces `{0}` at byte {1}; after the last number comes IMSG, TDBX or the end"
    )]
    Stray(String, usize),
    /// Bytes cannot be written as text.
    #[error("{0} opaque bytes have no textual form; call the object by reference instead")]
    Opaque(usize),
}

const KEYWORDS: [&str; 4] = ["TMSG", "FMSG", "IMSG", "TDBX"];

impl FromStr for Request {
    type Err = RequestError;

    fn from_str(line: &str) -> Result<Self, RequestError> {
        let words = words::split(line)?;
        let (name, words) = name_of(&words)?;
        let Some((word, rest)) = words.split_first() else {
            return Err(RequestError::Method(String::new()));
        };
        let method = Method::ALL
            .into_iter()
            .find(|method| !word.quoted && method.word() == word.text)
            .ok_or_else(|| RequestError::Method(word.text.clone()))?;
        Ok(Self {
            name,
            method,
            body: Body::new(line, word, rest).read()?,
        })
    }
}

impl FromStr for Reply {
    type Err = RequestError;

    fn from_str(line: &str) -> Result<Self, RequestError> {
        let words = words::split(line)?;
        let (name, words) = name_of(&words)?;
        match words {
            [ret, code, rest @ ..] if !ret.quoted && ret.text == "RET" => {
                let number = code
                    .text
                    .parse()
                    .map_err(|_| wrong_number(code, "a return code"))?;
                let mut body = Body::new(line, code, rest).read()?;
                body.code = number;
                Ok(Self { name, body })
            }
            _ => {
                let word = words.first().map(|word| word.text.clone());
                Err(RequestError::Ret(word.unwrap_or_default()))
            }
        }
    }
}

fn name_of(words: &[Word]) -> Result<(ObjectName, &[Word]), RequestError> {
    let (name, rest) = words.split_first().ok_or(RequestError::Empty)?;
    Ok((name.text.parse()?, rest))
}

fn wrong_number(word: &Word, expected: &'static str) -> RequestError {
    RequestError::Number {
        word: word.text.clone(),
        at: word.span.start,
        expected,
    }
}

/// What is left of a line after its method or code.
struct Body<'a> {
    line: &'a str,
    /// Where the text may begin.
    start: usize,
    words: &'a [Word],
}

impl<'a> Body<'a> {
    fn new(line: &'a str, last: &Word, words: &'a [Word]) -> Self {
        Self {
            line,
            start: last.span.end,
            words,
        }
    }

    fn read(mut self) -> Result<Transport, RequestError> {
        let mut body = Transport::default();
        self.keyword("TMSG");
        body.text = self.take_text();
        if self.keyword("FMSG") {
            body.floats = self.numbers("FMSG", "a float", read_float)?;
        }
        if self.keyword("IMSG") {
            body.ints = self.numbers("IMSG", "a whole number", |word| word.parse().ok())?;
        }
        if self.keyword("TDBX") {
            let message = self.take_text();
            if !message.is_empty() {
                body.reports = message.split('\n').map(Report::from_line).collect();
            }
        }
        match self.words.first() {
            None => Ok(body),
            Some(word) if keyword(word).is_some() => {
                Err(RequestError::OutOfPlace(word.text.clone(), word.span.start))
            }
            Some(word) => Err(RequestError::Stray(word.text.clone(), word.span.start)),
        }
    }

    /// Takes one keyword if it is next.
    fn keyword(&mut self, expected: &str) -> bool {
        match self.words.split_first() {
            Some((word, rest)) if keyword(word) == Some(expected) => {
                self.start = word.span.end;
                self.words = rest;
                true
            }
            _ => false,
        }
    }

    /// The text up to the next keyword.
    fn take_text(&mut self) -> String {
        let count = self
            .words
            .iter()
            .take_while(|word| keyword(word).is_none())
            .count();
        let (own, rest) = self.words.split_at(count);
        self.words = rest;
        match own {
            [word] if word.quoted => word.text.clone(),
            _ => {
                let end = rest.first().map_or(self.line.len(), |word| word.span.start);
                let text = self.line.get(self.start..end).unwrap_or_default();
                text.trim_matches(is_space).to_owned()
            }
        }
    }

    fn numbers<T>(
        &mut self,
        keyword_now: &'static str,
        expected: &'static str,
        read: impl Fn(&str) -> Option<T>,
    ) -> Result<Vec<T>, RequestError> {
        let Some((count, rest)) = self.words.split_first() else {
            return Err(RequestError::Count {
                keyword: keyword_now,
                announced: 0,
                found: 0,
            });
        };
        let announced: u64 = count
            .text
            .parse()
            .map_err(|_| wrong_number(count, "a count"))?;
        let present = rest
            .iter()
            .take_while(|word| keyword(word).is_none())
            .count();
        let wanted = usize::try_from(announced).unwrap_or(usize::MAX);
        if wanted > present {
            return Err(RequestError::Count {
                keyword: keyword_now,
                announced,
                found: present,
            });
        }
        let (own, rest) = rest.split_at(wanted);
        self.words = rest;
        own.iter()
            .map(|word| read(&word.text).ok_or_else(|| wrong_number(word, expected)))
            .collect()
    }
}

fn keyword(word: &Word) -> Option<&'static str> {
    KEYWORDS
        .into_iter()
        .find(|keyword| !word.quoted && *keyword == word.text)
}

const QUIET_NAN: u64 = 0x7ff8_0000_0000_0000;

fn read_float(word: &str) -> Option<f64> {
    match word {
        "nan" => Some(f64::from_bits(QUIET_NAN)),
        _ => match word.strip_prefix("nan:") {
            Some(bits) => u64::from_str_radix(bits, 16)
                .ok()
                .map(f64::from_bits)
                .filter(|float| float.is_nan()),
            None => word.parse().ok(),
        },
    }
}

/// The shortest digits that read back to the same float; a NaN other than the usual one with its bits.
fn write_float(out: &mut String, float: f64) -> fmt::Result {
    if !float.is_nan() {
        write!(out, " {float:?}")
    } else if float.to_bits() == QUIET_NAN {
        out.write_str(" nan")
    } else {
        write!(out, " nan:{:016x}", float.to_bits())
    }
}

impl Request {
    /// The request as one line.
    ///
    /// # Errors
    /// When the body holds opaque bytes, or the line could not be read back for its length.
    pub fn to_text(&self) -> Result<String, RequestError> {
        written(format!("{} {}", self.name, self.method), &self.body)
    }
}

impl Reply {
    /// The reply as one line.
    ///
    /// # Errors
    /// As [`Request::to_text`].
    pub fn to_text(&self) -> Result<String, RequestError> {
        written(format!("{} RET {}", self.name, self.body.code), &self.body)
    }
}

fn written(mut out: String, body: &Transport) -> Result<String, RequestError> {
    if !body.opaque.is_empty() {
        return Err(RequestError::Opaque(body.opaque.len()));
    }
    if body.floats.len().max(body.ints.len()) > MOST_NUMBERS {
        return Err(WordError::Many.into());
    }
    // Writing to a `String` cannot fail.
    let _ = write_parts(&mut out, body);
    if out.len() > words::LONGEST {
        return Err(WordError::Long(out.len()).into());
    }
    Ok(out)
}

fn write_parts(out: &mut String, body: &Transport) -> fmt::Result {
    if !body.text.is_empty() {
        write!(out, " TMSG {}", as_text(&body.text))?;
    }
    if !body.floats.is_empty() {
        write!(out, " FMSG {}", body.floats.len())?;
        for float in &body.floats {
            write_float(out, *float)?;
        }
    }
    if !body.ints.is_empty() {
        write!(out, " IMSG {}", body.ints.len())?;
        for int in &body.ints {
            write!(out, " {int}")?;
        }
    }
    if !body.reports.is_empty() {
        let lines: Vec<String> = body.reports.iter().map(Report::to_line).collect();
        write!(out, " TDBX {}", as_text(&lines.join("\n")))?;
    }
    Ok(())
}

/// The text as it stands if it reads back as such, else quoted.
fn as_text(text: &str) -> String {
    let plain = !text.is_empty()
        && text.trim_matches(is_space) == text
        && !text.chars().any(char::is_control)
        && match words::split(text).as_deref() {
            Ok([only]) => !only.quoted && keyword(only).is_none(),
            Ok(words) => words.iter().all(|word| keyword(word).is_none()),
            Err(_) => false,
        };
    if plain {
        text.to_owned()
    } else {
        words::quoted(text)
    }
}

#[cfg(test)]
mod tests;
