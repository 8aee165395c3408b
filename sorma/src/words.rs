//! Splitting a line into words, with quotes, and quoting a word so that it splits back to itself.
//!
//! One grammar for requests, CTRL options and dictionary recipes. Words are separated by ASCII white
//! space. A word that begins with `'` runs to the next `'` and is literal. A word that begins with
//! `"` runs to the next `"` and knows `\"`, `\\`, `\n`, `\r`, `\t` and `\u{HEX}`. A quote inside a
//! word is an ordinary character.

use std::ops::Range;
use thiserror::Error;

/// One word of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Word {
    /// The word without its quotes.
    pub text: String,
    /// The bytes of the line that it takes, quotes included.
    pub span: Range<usize>,
    /// Whether it was quoted; a quoted word is never a keyword.
    pub quoted: bool,
}

/// Why a line does not split into words. Offsets are bytes of the line.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum WordError {
    /// A quote without its partner.
    #[error("the quote at byte {0} is not closed")]
    Open(usize),
    /// Something directly after a closing quote.
    #[error("after the quoted word that ends at byte {0} there must be a space")]
    Glued(usize),
    /// A backslash with something unknown after it.
    #[error(
        "unknown escape at byte {0}: after a backslash stands one of \\ \" n r t u{{HEX}} \
         (single quotes take everything literally)"
    )]
    Escape(usize),
    /// Longer than anybody writes; what is that long goes by reference.
    #[error(
        "{0} bytes are too long for a text, which has at most {LONGEST}; send numbers and bytes by reference"
    )]
    Long(usize),
    /// More words than anybody writes.
    #[error("more than {MOST_WORDS} words; send numbers and bytes by reference")]
    Many,
}

/// The longest line that is split, bytes.
pub const LONGEST: usize = 16 << 20;

/// The most words of a line: what is made of them takes far more memory than the line.
pub const MOST_WORDS: usize = 1_000_000;

/// Splits a line.
///
/// # Errors
/// An open quote, text glued to a closing quote, or an unknown escape, with its byte offset.
pub fn split(line: &str) -> Result<Vec<Word>, WordError> {
    Ok(split_until(line, None)?.0)
}

/// The texts of the words of a line.
///
/// # Errors
/// As [`split`].
pub(crate) fn texts(line: &str) -> Result<Vec<String>, WordError> {
    Ok(split(line)?.into_iter().map(|word| word.text).collect())
}

/// Splits a line of a file, in which a word that begins with `#` begins a comment. Also returns the
/// bytes before the comment.
///
/// # Errors
/// As [`split`].
pub fn split_commented(line: &str) -> Result<(Vec<Word>, usize), WordError> {
    split_until(line, Some('#'))
}

fn split_until(line: &str, comment: Option<char>) -> Result<(Vec<Word>, usize), WordError> {
    let mut words = Vec::new();
    let mut at = 0;
    if line.len() > LONGEST {
        return Err(WordError::Long(line.len()));
    }
    while let Some(start) = next_word(line, at) {
        if words.len() >= MOST_WORDS {
            return Err(WordError::Many);
        }
        if comment.is_some_and(|mark| line[start..].starts_with(mark)) {
            return Ok((words, start));
        }
        let word = match line.as_bytes().get(start) {
            Some(b'\'') => single(line, start)?,
            Some(b'"') => double(line, start)?,
            _ => {
                let end = line[start..]
                    .find(is_space)
                    .map_or(line.len(), |length| start + length);
                Word {
                    text: line[start..end].to_owned(),
                    span: start..end,
                    quoted: false,
                }
            }
        };
        at = word.span.end;
        if word.quoted
            && line[at..]
                .chars()
                .next()
                .is_some_and(|next| !is_space(next))
        {
            return Err(WordError::Glued(at));
        }
        words.push(word);
    }
    Ok((words, line.len()))
}

/// What separates words.
pub(crate) fn is_space(letter: char) -> bool {
    letter.is_ascii_whitespace()
}

fn next_word(line: &str, from: usize) -> Option<usize> {
    line[from..]
        .find(|letter| !is_space(letter))
        .map(|offset| from + offset)
}

fn single(line: &str, start: usize) -> Result<Word, WordError> {
    let inside = start + 1;
    let length = line[inside..].find('\'').ok_or(WordError::Open(start))?;
    Ok(Word {
        text: line[inside..inside + length].to_owned(),
        span: start..inside + length + 1,
        quoted: true,
    })
}

fn double(line: &str, start: usize) -> Result<Word, WordError> {
    let mut text = String::new();
    let mut letters = line[start + 1..].char_indices();
    while let Some((offset, letter)) = letters.next() {
        let at = start + 1 + offset;
        match letter {
            '"' => {
                return Ok(Word {
                    text,
                    span: start..at + 1,
                    quoted: true,
                });
            }
            '\\' => text.push(escape(&mut letters).ok_or(WordError::Escape(at))?),
            other => text.push(other),
        }
    }
    Err(WordError::Open(start))
}

fn escape(letters: &mut std::str::CharIndices<'_>) -> Option<char> {
    match letters.next()?.1 {
        '\\' => Some('\\'),
        '"' => Some('"'),
        'n' => Some('\n'),
        'r' => Some('\r'),
        't' => Some('\t'),
        'u' => {
            let rest = letters.as_str().strip_prefix('{')?;
            let (hex, _) = rest.split_once('}')?;
            // `from_str_radix` alone would take a sign.
            if hex.is_empty() || !hex.bytes().all(|digit| digit.is_ascii_hexdigit()) {
                return None;
            }
            let letter = char::from_u32(u32::from_str_radix(hex, 16).ok()?)?;
            letters.nth(hex.len() + 1)?;
            Some(letter)
        }
        _ => None,
    }
}

/// The text in double quotes, so that [`split`] gives exactly it back as one word on one line.
#[must_use]
pub fn quoted(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 2);
    out.push('"');
    for letter in text.chars() {
        match letter {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            other if other.is_control() => {
                out.push_str(&format!("\\u{{{:x}}}", u32::from(other)));
            }
            other => out.push(other),
        }
    }
    out.push('"');
    out
}

/// The text as one word: plain where it can be, quoted where it must be.
#[must_use]
pub fn word(text: &str) -> String {
    let plain = !text.is_empty()
        && !text.starts_with(['"', '\''])
        && !text
            .chars()
            .any(|letter| is_space(letter) || letter.is_control());
    if plain { text.to_owned() } else { quoted(text) }
}

/// Words as one line that splits back into them.
#[must_use]
pub fn join<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    let words: Vec<String> = words.into_iter().map(word).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn quotes_hold_words_together() {
        let line = r#"-add carry.slow '-SUBST carry -transferSpeed 0.2' "a\tb\u{e9}" it's"#;
        let expected = [
            "-add",
            "carry.slow",
            "-SUBST carry -transferSpeed 0.2",
            "a\tbé",
            "it's",
        ];
        assert_eq!(texts(line).unwrap(), expected);
        assert_eq!(texts(" \t\n").unwrap(), [""; 0]);
    }

    #[test]
    fn what_is_wrong_in_a_line_is_said_with_its_byte() {
        assert_eq!(texts("ab 'c"), Err(WordError::Open(3)));
        assert_eq!(texts("\"c\\\""), Err(WordError::Open(0)));
        assert_eq!(texts("'a'b"), Err(WordError::Glued(3)));
        assert_eq!(texts("\"a\\x\""), Err(WordError::Escape(2)));
        for escape in [
            "\\u{d800}",
            "\\u{}",
            "\\u{+41}",
            "\\u{110000}",
            "\\u41",
            "\\u{4",
        ] {
            assert_eq!(
                texts(&format!("\"{escape}\"")),
                Err(WordError::Escape(1)),
                "{escape}"
            );
        }
    }

    proptest! {
        #[test]
        fn joined_words_split_back_into_themselves(words in prop::collection::vec(any::<String>(), 0..6)) {
            let line = join(words.iter().map(String::as_str));
            prop_assert!(!line.contains('\n'));
            prop_assert_eq!(texts(&line).unwrap(), words);
        }

        #[test]
        fn any_line_is_split_or_refused(line in any::<String>()) {
            if let Ok(words) = split(&line) {
                for word in words {
                    prop_assert!(line.get(word.span).is_some());
                }
            }
        }
    }
}
