//! What the numbers of an answer are: names, units and shapes, as a class writes them in its table.
//!
//! ```text
//! q1 q2 q3: rad; took: s          four floats with their names and units
//! base_T_tool 4x4: m              a matrix, row by row
//! * u v area: px                  as many rows of these three as there are
//! ints n; ints exposed: ns        the same for whole numbers
//! ```

use std::str::FromStr;

/// Some of the numbers of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// What they are.
    pub shape: Shape,
    /// Their unit; empty for pure numbers.
    pub unit: String,
}

/// How the numbers of a part stand.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Shape {
    /// One after the other, each with its name.
    Named(Vec<String>),
    /// A matrix, row by row.
    Matrix {
        /// Its name.
        name: String,
        /// How many rows.
        rows: usize,
        /// How many columns.
        columns: usize,
    },
    /// As many rows as there are numbers left, each with these columns.
    Rows(Vec<String>),
}

impl Shape {
    /// How many numbers it takes when so many are left; `None` when they do not fit.
    fn count(&self, left: usize) -> Option<usize> {
        match self {
            Self::Named(names) => Some(names.len()),
            Self::Matrix { rows, columns, .. } => rows.checked_mul(*columns),
            Self::Rows(names) => left.is_multiple_of(names.len()).then_some(left),
        }
    }
}

/// What all the numbers of an answer are.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Layout {
    floats: Vec<Part>,
    ints: Vec<Part>,
}

impl Layout {
    /// The floats of an answer, each part with its numbers; `None` when there are other floats than it says.
    #[must_use]
    pub fn floats<'a>(&'a self, floats: &'a [f64]) -> Option<Vec<(&'a Part, &'a [f64])>> {
        split(&self.floats, floats)
    }

    /// The whole numbers of an answer, as [`Self::floats`].
    #[must_use]
    pub fn ints<'a>(&'a self, ints: &'a [i64]) -> Option<Vec<(&'a Part, &'a [i64])>> {
        split(&self.ints, ints)
    }
}

fn split<'a, N>(parts: &'a [Part], mut numbers: &'a [N]) -> Option<Vec<(&'a Part, &'a [N])>> {
    let mut found = Vec::new();
    for part in parts {
        let count = part.shape.count(numbers.len())?;
        let (own, rest) = numbers.split_at_checked(count)?;
        found.push((part, own));
        numbers = rest;
    }
    numbers.is_empty().then_some(found)
}

impl FromStr for Layout {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut layout = Self::default();
        for text in text.split(';').map(str::trim) {
            if text.is_empty() {
                continue;
            }
            let (names, unit) = text.split_once(':').unwrap_or((text, ""));
            let mut words: Vec<&str> = names.split_whitespace().collect();
            let parts = match words.first() {
                Some(&"ints") => {
                    words.remove(0);
                    &mut layout.ints
                }
                _ => &mut layout.floats,
            };
            if matches!(
                parts.last(),
                Some(Part {
                    shape: Shape::Rows(_),
                    ..
                })
            ) {
                return Err(format!("`{text}` comes after rows that take all numbers"));
            }
            let shape = shape(&words).ok_or_else(|| format!("`{text}` names no numbers"))?;
            let unit = unit.trim().to_owned();
            parts.push(Part { shape, unit });
        }
        Ok(layout)
    }
}

fn shape(words: &[&str]) -> Option<Shape> {
    let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
    match words {
        [] | ["*"] => None,
        ["*", names @ ..] => Some(Shape::Rows(owned(names))),
        [name, size] if size.starts_with(|first: char| first.is_ascii_digit()) => {
            let (rows, columns) = size.split_once('x')?;
            Some(Shape::Matrix {
                name: (*name).to_owned(),
                rows: rows.parse().ok()?,
                columns: columns.parse().ok()?,
            })
        }
        names => Some(Shape::Named(owned(names))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_told_apart_by_names_matrices_and_rows() {
        let layout: Layout = "q1 q2: rad; T 2x2: m; ints n; * u v: px; ints * a"
            .parse()
            .unwrap();
        let floats: Vec<f64> = (0..10_u8).map(f64::from).collect();
        let parts = layout.floats(&floats).unwrap();
        let counts: Vec<usize> = parts.iter().map(|(_, own)| own.len()).collect();
        assert_eq!(counts, [2, 4, 4]);
        assert_eq!(parts[0].0.unit, "rad");
        assert_eq!(layout.ints(&[1, 2]).unwrap().len(), 2);
        // One more does not fill a row, and too few are no such answer.
        assert_eq!(layout.floats(&floats[..9]), None);
        assert_eq!(layout.floats(&floats[..3]), None);
        assert_eq!(layout.ints(&[]), None);
    }

    #[test]
    fn a_layout_that_names_nothing_is_refused() {
        for wrong in ["*", ": m", "* u v; q", "T 4x: m", "ints"] {
            assert!(wrong.parse::<Layout>().is_err(), "{wrong}");
        }
        assert_eq!("".parse(), Ok(Layout::default()));
    }
}
