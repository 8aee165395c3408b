//! Minimal non-negative integer solutions of homogeneous equations: invariants. Farkas' algorithm,
//! within a limit of work.

use super::Arcs;
use crate::analysis::model::Model;

/// A candidate: the weights and what they leave of each equation.
struct Row {
    weights: Vec<u64>,
    effects: Vec<i64>,
}

/// The minimal non-negative solutions of "weighted sum of the rows is zero". `None` when more than
/// `most` candidates arise on the way, or numbers outgrow 64 bits.
#[must_use]
pub fn semiflows(rows: &[Vec<i64>], most: usize) -> Option<Vec<Vec<u64>>> {
    let count = rows.len();
    let columns = rows.first().map_or(0, Vec::len);
    let unit = |row: usize| (0..count).map(|other| u64::from(other == row)).collect();
    let mut found: Vec<Row> = rows
        .iter()
        .enumerate()
        .map(|(number, effects)| Row {
            weights: unit(number),
            effects: effects.clone(),
        })
        .collect();
    let mut left: Vec<usize> = (0..columns).collect();
    // The equation that gives the fewest combinations comes first.
    while let Some(at) = (0..left.len()).min_by_key(|at| combinations(&found, left[*at])) {
        let column = left.swap_remove(at);
        found = eliminate(found, column, most)?;
    }
    Some(found.into_iter().map(|row| row.weights).collect())
}

fn combinations(rows: &[Row], column: usize) -> usize {
    let count = |sign: i64| {
        rows.iter()
            .filter(|row| row.effects[column].signum() == sign)
            .count()
    };
    count(1) * count(-1)
}

/// Weights of places whose weighted sum of tokens no firing changes: the minimal place invariants. None
/// at all when a reset arc makes the effects of a firing depend on the marking.
#[must_use]
pub fn place_invariants(model: &Model, most: usize) -> Option<Vec<Vec<u64>>> {
    let found = semiflows(&Arcs::of(model).effects, most)?;
    // What a reset arc empties, no invariant counts.
    let emptied = |place: u32| model.transitions.iter().any(|t| t.resets.contains(&place));
    let steady = |weights: &Vec<u64>| {
        (0..)
            .zip(weights)
            .all(|(place, weight)| *weight == 0 || !emptied(place))
    };
    Some(found.into_iter().filter(steady).collect())
}

/// Numbers of firings that together change nothing: the minimal transition invariants.
#[must_use]
pub fn transition_invariants(model: &Model, most: usize) -> Option<Vec<Vec<u64>>> {
    let arcs = Arcs::of(model);
    let rows: Vec<Vec<i64>> = (0..model.transitions.len())
        .map(|transition| arcs.effects.iter().map(|row| row[transition]).collect())
        .collect();
    semiflows(&rows, most)
}

/// The most tokens that each place can hold by the invariants: nothing where none covers it.
#[must_use]
pub fn bounds(model: &Model, invariants: &[Vec<u64>]) -> Vec<Option<u64>> {
    let initial = model.initial();
    let bound = |place: usize, weights: &Vec<u64>| {
        let weight = *weights.get(place).filter(|weight| **weight > 0)?;
        let products = weights.iter().zip(&initial);
        let sum = products
            .map(|(w, tokens)| u128::from(*w) * u128::from(*tokens))
            .sum::<u128>();
        u64::try_from(sum / u128::from(weight)).ok()
    };
    (0..model.places.len())
        .map(|place| {
            invariants
                .iter()
                .filter_map(|weights| bound(place, weights))
                .min()
        })
        .collect()
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
        row.effects.push(
            a.checked_mul(signed_gain)?
                .checked_add(b.checked_mul(signed_loss)?)?,
        );
    }
    // Effects are linear in the weights, so what divides all weights divides all effects.
    let divisor = divisor.max(1);
    let signed = i64::try_from(divisor).ok()?;
    row.weights.iter_mut().for_each(|weight| *weight /= divisor);
    row.effects.iter_mut().for_each(|effect| *effect /= signed);
    Some(row)
}

/// Rows whose set of weights above zero contains that of no other row.
fn minimal(rows: Vec<Row>) -> Vec<Row> {
    let support = |row: &Row| -> Vec<bool> { row.weights.iter().map(|w| *w > 0).collect() };
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
    use proptest::prelude::*;

    use super::*;
    use crate::analysis::{
        explicit::{Limits, explore},
        samples::{buffer, kanban, model, random_model},
    };

    #[test]
    fn producer_consumer_and_buffer_are_three_place_invariants_and_one_round() {
        let net = buffer(3);
        let mut found = place_invariants(&net, 1000).unwrap();
        found.sort_unstable();
        let expected = [
            vec![0, 0, 0, 0, 1, 1],
            vec![0, 0, 1, 1, 0, 0],
            vec![1, 1, 0, 0, 0, 0],
        ];
        assert_eq!(found, expected);
        assert_eq!(bounds(&net, &found)[4], Some(3));
        assert_eq!(
            transition_invariants(&net, 1000).unwrap(),
            [vec![1, 1, 1, 1]]
        );
    }

    #[test]
    fn weights_and_failure_branches_count() {
        let pairs = "net n\nplace a = 4, b\ntransition t\n  in a*2\n  do f\n  out b\n";
        // The firing that goes on counts as what it took.
        assert_eq!(
            place_invariants(&model(pairs), 1000).unwrap(),
            [vec![1, 2, 2]]
        );
        assert!(
            place_invariants(&model(&format!("{pairs}  fail a\n")), 1000)
                .unwrap()
                .is_empty()
        );
    }

    #[test]
    fn each_cell_of_a_kanban_system_is_an_invariant() {
        let found = place_invariants(&kanban(2), 1000).unwrap();
        // Cells 2 and 3 begin and end together, so the free cards of one count for the other as well.
        assert_eq!(found.len(), 6);
        assert!(found.iter().all(|weights| weights.iter().sum::<u64>() == 4));
    }

    #[test]
    fn too_much_work_ends_without_an_answer() {
        assert_eq!(place_invariants(&kanban(2), 1), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn no_firing_changes_an_invariant_and_every_bound_holds(net in random_model()) {
            let limits = Limits { markings: 500, ..Limits::default() };
            let listed = explore(&net, &limits);
            let found = place_invariants(&net, 1000).unwrap();
            for (bound, most) in bounds(&net, &found).iter().zip(&listed.bounds) {
                prop_assert!(bound.is_none_or(|bound| bound >= u64::from(*most)));
            }
            for (weights, row) in found.iter().map(|weights| (weights, net.initial())) {
                let sum = |marking: &[u32]| -> u64 {
                    weights.iter().zip(marking).map(|(w, t)| w * u64::from(*t)).sum()
                };
                let start = sum(&row);
                prop_assert_eq!(listed.nearest(|marking| sum(marking) != start), None);
            }
        }
    }
}
