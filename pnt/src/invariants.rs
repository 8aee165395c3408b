//! Place invariants: weighted sums of tokens that no firing changes (Murata 1989, section VII).
//! All minimal non-negative ones, by Farkas' algorithm, within a limit of work.

use crate::net::Net;

/// Weight per place, in order of place number.
pub type PlaceInvariant = Vec<u64>;

/// A candidate: the place weights and what they leave of each transition's effect.
struct Row {
    weights: Vec<u64>,
    effects: Vec<i64>,
}

/// The minimal non-negative place invariants of a net, or `None` when more than `most` candidates
/// arise on the way. Firings to other nets count with what they do to this net's places only.
#[must_use]
pub fn place_invariants(net: &Net, most: usize) -> Option<Vec<PlaceInvariant>> {
    let columns = effects(net);
    let places = net.places().len();
    let mut rows: Vec<Row> = (0..places)
        .map(|place| Row {
            weights: (0..places).map(|other| u64::from(other == place)).collect(),
            effects: columns.iter().map(|column| column[place]).collect(),
        })
        .collect();
    for column in 0..columns.len() {
        rows = eliminate(rows, column, most)?;
    }
    Some(rows.into_iter().map(|row| row.weights).collect())
}

/// Per way that a firing can end, what it does to each place.
fn effects(net: &Net) -> Vec<Vec<i64>> {
    let mut columns = Vec::new();
    for transition in net.transitions() {
        for outputs in std::iter::once(&transition.outputs).chain(&transition.fail) {
            let mut column = vec![0; net.places().len()];
            for arc in &transition.inputs {
                column[arc.place.index()] -= i64::from(arc.weight);
            }
            for arc in &outputs.local {
                column[arc.place.index()] += i64::from(arc.weight);
            }
            columns.push(column);
        }
    }
    columns
}

/// Combines rows until none has an effect in a column; drops those that are not minimal.
fn eliminate(rows: Vec<Row>, column: usize, most: usize) -> Option<Vec<Row>> {
    let (mut kept, active): (Vec<Row>, Vec<Row>) =
        rows.into_iter().partition(|row| row.effects[column] == 0);
    let (gains, losses): (Vec<Row>, Vec<Row>) =
        active.into_iter().partition(|row| row.effects[column] > 0);
    for gain in &gains {
        for loss in &losses {
            kept.push(combine(gain, loss, column)?);
            if kept.len() > most {
                return None;
            }
        }
    }
    Some(minimal(kept))
}

/// The smallest positive combination of two rows that has no effect in a column; `None` when its
/// numbers are too large.
fn combine(gain: &Row, loss: &Row, column: usize) -> Option<Row> {
    let (up, down) = (
        gain.effects[column].unsigned_abs(),
        loss.effects[column].unsigned_abs(),
    );
    let (times_gain, times_loss) = (down / gcd(up, down), up / gcd(up, down));
    let mut row = Row {
        weights: Vec::with_capacity(gain.weights.len()),
        effects: Vec::with_capacity(gain.effects.len()),
    };
    let mut divisor = 0;
    for (a, b) in gain.weights.iter().zip(&loss.weights) {
        let weight = a
            .checked_mul(times_gain)?
            .checked_add(b.checked_mul(times_loss)?)?;
        divisor = gcd(weight, divisor);
        row.weights.push(weight);
    }
    let (signed_gain, signed_loss) = (
        i64::try_from(times_gain).ok()?,
        i64::try_from(times_loss).ok()?,
    );
    for (a, b) in gain.effects.iter().zip(&loss.effects) {
        let effect = a
            .checked_mul(signed_gain)?
            .checked_add(b.checked_mul(signed_loss)?)?;
        row.effects.push(effect);
    }
    // Effects are linear in the weights, so what divides all weights divides all effects.
    let divisor = divisor.max(1);
    let signed = i64::try_from(divisor).ok()?;
    row.weights.iter_mut().for_each(|weight| *weight /= divisor);
    row.effects.iter_mut().for_each(|effect| *effect /= signed);
    Some(row)
}

/// Rows whose set of places contains that of no other row.
fn minimal(rows: Vec<Row>) -> Vec<Row> {
    let support =
        |row: &Row| -> Vec<bool> { row.weights.iter().map(|weight| *weight > 0).collect() };
    let supports: Vec<Vec<bool>> = rows.iter().map(support).collect();
    let contains = |big: &[bool], small: &[bool]| big.iter().zip(small).all(|(b, s)| *b || !*s);
    let is_minimal = |index: usize, big: &[bool]| {
        !supports.iter().enumerate().any(|(other, small)| {
            let inside = other != index && contains(big, small);
            inside && (small != big || other < index)
        })
    };
    let keep = supports
        .iter()
        .enumerate()
        .map(|(index, big)| is_minimal(index, big));
    rows.into_iter()
        .zip(keep)
        .filter_map(|(row, keep)| keep.then_some(row))
        .collect()
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;

    use super::*;
    use crate::compile;

    fn invariants(text: &str) -> Vec<PlaceInvariant> {
        let net = compile::net(&Source::new("t", text)).unwrap_or_else(|f| panic!("{f}"));
        let mut found = place_invariants(&net, 1000).unwrap();
        found.sort_unstable();
        found
    }

    #[test]
    fn producer_consumer_and_buffer_are_three_invariants() {
        let found = invariants(
            "net pc
place ready = 1, made, idle = 1, got, items, room = 3
transition make\n  in ready\n  out made
transition put\n  in made, room\n  out ready, items
transition get\n  in idle, items\n  out got, room
transition use\n  in got\n  out idle\n",
        );
        let expected = [
            vec![0, 0, 0, 0, 1, 1],
            vec![0, 0, 1, 1, 0, 0],
            vec![1, 1, 0, 0, 0, 0],
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn weights_and_failure_branches_count() {
        let pairs = "net n\nplace a = 4, b\ntransition t\n  in a*2\n  do f\n  out b\n";
        assert_eq!(invariants(pairs), [vec![1, 2]]);
        let lossy = format!("{pairs}  fail a\n");
        assert!(invariants(&lossy).is_empty());
    }
}
