//! Finds fewer faults that still make a run fail.
//!
//! Delta debugging: leave out ever smaller parts of the list while the run still fails (Zeller and
//! Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE Transactions on Software
//! Engineering 28(2), 2002). The result is 1-minimal: without any one of its faults the run does not
//! fail.

use crate::fault::Fault;

/// Leaves faults out as long as `fails` says that the run with the rest still fails, and returns what
/// is left. `fails` is asked at most `limit` times; when that is not enough, what is left may hold
/// faults that do not matter.
pub fn shrink(
    faults: &[Fault],
    limit: usize,
    mut fails: impl FnMut(&[Fault]) -> bool,
) -> Vec<Fault> {
    let mut left = faults.to_vec();
    let mut parts = 2;
    let mut asked = 0;
    // First the guess that most often is right: faults do not matter at all.
    if limit > 0 && fails(&[]) {
        return Vec::new();
    }
    while left.len() > 1 && parts <= left.len() {
        let size = left.len().div_ceil(parts);
        let mut smaller = None;
        for start in (0..left.len()).step_by(size) {
            if asked >= limit {
                return left;
            }
            asked += 1;
            let rest: Vec<Fault> = left
                .iter()
                .enumerate()
                .filter(|(index, _)| !(start..start + size).contains(index))
                .map(|(_, fault)| fault.clone())
                .collect();
            if fails(&rest) {
                smaller = Some(rest);
                break;
            }
        }
        match smaller {
            Some(rest) => {
                left = rest;
                parts = (parts - 1).max(2);
            }
            None if parts >= left.len() => break,
            None => parts = (parts * 2).min(left.len()),
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;
    use crate::fault::FaultKind;
    use ctos_time::Instant;

    fn kill(number: usize) -> Fault {
        Fault::on(number.to_string(), FaultKind::Kill, Instant::START)
    }

    proptest! {
        #[test]
        fn what_is_left_is_exactly_what_the_failure_needs(
            count in 1_usize..60,
            needed in proptest::collection::btree_set(0_usize..60, 0..5),
        ) {
            let all: Vec<Fault> = (0..count).map(kill).collect();
            let needed: BTreeSet<usize> = needed.into_iter().map(|one| one % count).collect();
            let expected: Vec<Fault> = needed.iter().map(|one| kill(*one)).collect();
            let fails = |some: &[Fault]| expected.iter().all(|one| some.contains(one));
            prop_assert_eq!(shrink(&all, 100_000, fails), expected);
        }

        #[test]
        fn it_stops_asking_at_its_limit_and_what_is_left_still_fails(limit in 0_usize..20) {
            let all: Vec<Fault> = (0..50).map(kill).collect();
            let mut asked = 0;
            let fails = |some: &[Fault]| some.contains(&kill(3)) && some.contains(&kill(40));
            let left = shrink(&all, limit, |some| {
                asked += 1;
                fails(some)
            });
            prop_assert!(fails(&left));
            prop_assert!(asked <= limit + 1);
        }
    }
}
