//! A short text in place: written in the servo's tick, which must not allocate.

use std::fmt;

use serde::{Deserialize, Serialize};
use tinyvec::ArrayVec;

/// At most 128 bytes of text; what is longer is cut off at the last whole character. Made by [`words!`](crate::words).
#[derive(Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct Words(ArrayVec<[u8; 128]>);

/// Formats a [`Words`](crate::guard::Words) as `format!` does a `String`, without allocating.
#[macro_export]
macro_rules! words {
    ($($argument:tt)*) => {
        $crate::guard::Words::from(::std::format_args!($($argument)*))
    };
}

impl Words {
    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        // Only whole characters are written.
        std::str::from_utf8(&self.0).unwrap_or_default()
    }
}

impl fmt::Write for Words {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.0.capacity() - self.0.len();
        let cut = text.floor_char_boundary(room);
        self.0.extend_from_slice(&text.as_bytes()[..cut]);
        match cut == text.len() {
            true => Ok(()),
            // Nothing may follow what was cut off.
            false => Err(fmt::Error),
        }
    }
}

impl From<fmt::Arguments<'_>> for Words {
    fn from(arguments: fmt::Arguments<'_>) -> Self {
        let mut words = Self::default();
        // The only error is that it did not all fit.
        let _ = fmt::write(&mut words, arguments);
        words
    }
}

impl From<&str> for Words {
    fn from(text: &str) -> Self {
        Self::from(format_args!("{text}"))
    }
}

impl From<String> for Words {
    fn from(text: String) -> Self {
        Self::from(text.as_str())
    }
}

impl From<Words> for String {
    fn from(words: Words) -> Self {
        words.as_str().to_owned()
    }
}

impl fmt::Display for Words {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for Words {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_that_is_too_long_ends_with_a_whole_character() {
        let text = "é".repeat(100);
        let words = words!("a{text}{}", 1);
        assert_eq!(words.as_str(), format!("a{}", "é".repeat(63)));
        let bytes = postcard::to_stdvec(&words).unwrap();
        assert_eq!(postcard::from_bytes::<Words>(&bytes).unwrap(), words);
        let long = postcard::to_stdvec(&text).unwrap();
        assert_eq!(
            postcard::from_bytes::<Words>(&long).unwrap().as_str(),
            "é".repeat(64)
        );
    }
}
