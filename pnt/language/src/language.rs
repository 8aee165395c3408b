//! What may come on an input tape: a regular language over its symbols, such as
//! `calibrate (carry | resect)* park`, as a small automaton. [`parse`] reads it, with places for findings;
//! [`automaton`] makes the smallest machine that knows which symbols may come next.
//!
//! Knows symbols by name and number, and no net.

pub mod automaton;
pub mod parse;

#[cfg(test)]
mod tests;

pub use automaton::{Language, State};

use std::ops::Range;

/// Number of a symbol in its alphabet.
pub type SymbolNumber = usize;

/// A symbol as it was written, and the bytes of its text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Word {
    /// The symbol.
    pub text: String,
    /// Bytes of the source.
    pub range: Range<usize>,
}

/// A regular expression. `S` is a symbol: as it was written, or its number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Expression<S> {
    /// One symbol.
    Symbol(S),
    /// Any one symbol: `.`.
    Any,
    /// One after the other. None at all is the empty word: `()`.
    Sequence(Vec<Self>),
    /// One of them: `|`.
    Choice(Vec<Self>),
    /// So many times: `*`, `+`, `?`, `{2}`, `{2,}`, `{2,3}`.
    Repeat(Box<Self>, u32, Option<u32>),
}

impl<S> Expression<S> {
    /// The same with other names for the symbols.
    pub fn map<T>(&self, name: &mut impl FnMut(&S) -> T) -> Expression<T> {
        match self {
            Self::Symbol(symbol) => Expression::Symbol(name(symbol)),
            Self::Any => Expression::Any,
            Self::Sequence(parts) => {
                Expression::Sequence(parts.iter().map(|part| part.map(name)).collect())
            }
            Self::Choice(parts) => {
                Expression::Choice(parts.iter().map(|part| part.map(name)).collect())
            }
            Self::Repeat(inner, least, most) => {
                Expression::Repeat(Box::new(inner.map(name)), *least, *most)
            }
        }
    }
}
