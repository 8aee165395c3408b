//! The examples by which a blob is a place: 27 of them, as a table that people can read (SORMA technical report, section 2.2.4).
//!
//! A place is where the hand should be, seen from where it is: m along the axes of the tool.

use std::fmt::Write as _;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use vss::target_map::{EXAMPLES, Seen, TargetMap};

/// The first line of the table.
const HEADER: &str = "x,y,z,u,v,radius,spread";

/// The standard deviations of what is seen, px. They are wide enough for what lies between the examples.
const SD: Seen = Seen {
    u: 0.3,
    v: 0.3,
    radius: 0.2,
    spread: 0.2,
};

/// The largest E of a ball.
pub const LARGEST: f64 = 12.0;

/// An example: a place, and the blob of the ball there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Example {
    /// x, y and z, m.
    pub place: [f64; 3],
    /// u, v, radius and spread, px.
    pub seen: [f64; 4],
}

/// Why a table makes no map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// It is no such table.
    #[error(
        "line {line}: {reason}; the first line is `{HEADER}`, and each of the {EXAMPLES} others has as many numbers"
    )]
    Line {
        /// Which, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// It has another number of examples.
    #[error(
        "there are {0} examples, and a map has {EXAMPLES}: 3 x 3 x 3, the last coordinate changes first"
    )]
    Count(usize),
    /// They make no map.
    #[error("the examples make no map: {0}")]
    Untrained(String),
}

/// The table of examples.
#[must_use]
pub fn table(examples: &[Example]) -> String {
    let mut text = format!("{HEADER}\n");
    for Example { place, seen } in examples {
        let numbers: Vec<String> = place
            .iter()
            .map(|number| format!("{number:.6}"))
            .chain(seen.iter().map(|number| format!("{number:.4}")))
            .collect();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}", numbers.join(","));
    }
    text
}

/// The examples of a table.
///
/// # Errors
/// [`MapError`], with the line.
pub fn read(text: &str) -> Result<Vec<Example>, MapError> {
    let mut examples = Vec::new();
    for (line, row) in (1..).zip(text.lines()) {
        let wrong = |reason: String| MapError::Line { line, reason };
        if line == 1 {
            if row.trim() != HEADER {
                return Err(wrong(format!("it is `{row}`")));
            }
            continue;
        }
        if row.trim().is_empty() {
            continue;
        }
        let numbers = row.split(',').map(|word| word.trim().parse::<f64>());
        let numbers: Vec<f64> = numbers
            .collect::<Result<_, _>>()
            .map_err(|error| wrong(error.to_string()))?;
        let [x, y, z, u, v, radius, spread] = numbers[..] else {
            return Err(wrong(format!("it has {} numbers", numbers.len())));
        };
        examples.push(Example {
            place: [x, y, z],
            seen: [u, v, radius, spread],
        });
    }
    Ok(examples)
}

/// The map through examples.
///
/// # Errors
/// [`MapError`].
pub fn trained(examples: &[Example]) -> Result<TargetMap, MapError> {
    let pairs: Vec<(Point3<f64>, Seen)> = examples
        .iter()
        .map(|Example { place, seen }| {
            let [u, v, radius, spread] = *seen;
            let seen = Seen {
                u,
                v,
                radius,
                spread,
            };
            (Point3::from(*place), seen)
        })
        .collect();
    let pairs = pairs
        .first_chunk::<EXAMPLES>()
        .filter(|_| pairs.len() == EXAMPLES);
    let pairs = pairs.ok_or(MapError::Count(examples.len()))?;
    TargetMap::train(pairs, &SD, LARGEST).map_err(|error| MapError::Untrained(error.to_string()))
}

/// The places of a grid around the hand, in the order of a map, m.
#[must_use]
pub fn grid(half: [f64; 3]) -> Vec<[f64; 3]> {
    let steps = [-1.0, 0.0, 1.0];
    let places = steps.into_iter().flat_map(|x| {
        let rows = steps.into_iter().map(move |y| [x, y]);
        rows.flat_map(|[x, y]| steps.into_iter().map(move |z| [x, y, z]))
    });
    let places = places.map(|steps| {
        let mut place = half;
        for (to, step) in place.iter_mut().zip(steps) {
            *to *= step;
        }
        place
    });
    places.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn examples() -> Vec<Example> {
        let example = |place: [f64; 3]| {
            let [x, y, z] = place;
            let depth = 0.4 + z;
            let radius = 410.0 * 0.02 / depth;
            Example {
                place,
                seen: [
                    250.0 + 410.0 * x / depth,
                    250.0 + 410.0 * y / depth,
                    radius,
                    radius,
                ],
            }
        };
        grid([0.08, 0.08, 0.06]).into_iter().map(example).collect()
    }

    #[test]
    fn a_table_that_was_written_reads_as_what_it_was() {
        let examples = examples();
        let read = read(&table(&examples)).unwrap();
        for (read, wrote) in read.iter().zip(&examples) {
            let off = read.seen.iter().zip(wrote.seen).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 1e-4);
        }
        let mut map = trained(&read).unwrap();
        let seen = Seen {
            u: 250.0,
            v: 250.0,
            radius: 20.5,
            spread: 20.5,
        };
        let found = map.locate(&seen).unwrap();
        assert!(found.good && found.place.coords.norm() < 1e-3, "{found:?}");
    }

    #[test]
    fn what_is_no_table_is_told_with_its_line() {
        assert!(matches!(read("x,y\n"), Err(MapError::Line { line: 1, .. })));
        let text = format!("{HEADER}\n1,2,3,4,5,6,7\n1,2,x,4,5,6,7\n");
        assert!(matches!(read(&text), Err(MapError::Line { line: 3, .. })));
        let text = format!("{HEADER}\n1,2,3\n");
        assert!(matches!(read(&text), Err(MapError::Line { line: 2, .. })));
        assert_eq!(trained(&examples()[1..]).unwrap_err(), MapError::Count(26));
        let mut none = examples();
        none[5].seen[0] = f64::NAN;
        assert!(matches!(trained(&none), Err(MapError::Untrained(_))));
    }
}
