//! Steady state of a Markov chain given by rates. The embedded chain of its jumps is solved, and each
//! state weighed by how long it lasts. Knows numbers only.

use super::levels::Chain;

/// States up to which elimination is quick enough: it is exact to rounding and cannot fail.
const MOST_ELIMINATED: usize = 400;

/// States to which the iteration makes a chain smaller before it eliminates.
const COARSEST: usize = 100;

/// Relative change of a cycle, or of a sweep, at which the iteration ends.
const CONVERGED: f64 = 1e-12;

/// Cycles over chains of all sizes after which it goes on with single sweeps.
const MOST_CYCLES: usize = 300;

/// Sweeps and cycles after which it gives up.
const MOST_SWEEPS: usize = 50_000;

/// Rates from each state to others.
pub(super) type Rows = [Vec<(u32, f64)>];

/// The sets of states that are never left, each in ascending order.
pub(super) fn final_classes(rows: &Rows) -> Vec<Vec<usize>> {
    let classes = strong_components(rows);
    let mut class_of = vec![0; rows.len()];
    for (number, class) in classes.iter().enumerate() {
        for state in class {
            class_of[*state] = number;
        }
    }
    let stays = |class: &Vec<usize>| {
        class.iter().all(|state| {
            let mut nexts = rows[*state].iter();
            nexts.all(|(next, _)| class_of[*next as usize] == class_of[*state])
        })
    };
    let mut finals: Vec<Vec<usize>> = classes
        .iter()
        .filter(|class| stays(class))
        .cloned()
        .collect();
    for class in &mut finals {
        class.sort_unstable();
    }
    finals.sort();
    finals
}

/// Tarjan's algorithm without recursion.
fn strong_components(rows: &Rows) -> Vec<Vec<usize>> {
    const NEW: usize = usize::MAX;
    let mut number = vec![NEW; rows.len()];
    let mut low = vec![0; rows.len()];
    let mut on_stack = vec![false; rows.len()];
    let (mut stack, mut classes, mut count) = (Vec::new(), Vec::new(), 0);
    for root in 0..rows.len() {
        if number[root] != NEW {
            continue;
        }
        let mut path = vec![(root, 0)];
        while let Some((state, edge)) = path.last_mut() {
            let state = *state;
            if *edge == 0 {
                number[state] = count;
                low[state] = count;
                count += 1;
                stack.push(state);
                on_stack[state] = true;
            }
            if let Some((next, _)) = rows[state].get(*edge) {
                let next = *next as usize;
                *edge += 1;
                if number[next] == NEW {
                    path.push((next, 0));
                } else if on_stack[next] {
                    low[state] = low[state].min(number[next]);
                }
                continue;
            }
            path.pop();
            if let Some((parent, _)) = path.last() {
                low[*parent] = low[*parent].min(low[state]);
            }
            if low[state] == number[state] {
                let mut class = Vec::new();
                while let Some(member) = stack.pop() {
                    on_stack[member] = false;
                    class.push(member);
                    if member == state {
                        break;
                    }
                }
                classes.push(class);
            }
        }
    }
    classes
}

/// Why there is no solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NoConvergence {
    pub(super) sweeps: usize,
    pub(super) change: f64,
}

/// The part of the time spent in each state of a set; zero elsewhere. The set is never left, and in
/// it each state leads to each. Also how many sweeps it took; none by elimination.
pub(super) fn steady_state(
    rows: &Rows,
    class: &[usize],
) -> Result<(Vec<f64>, usize), NoConvergence> {
    let mut local = vec![usize::MAX; rows.len()];
    for (index, state) in class.iter().enumerate() {
        local[*state] = index;
    }
    // Jumps to itself are none.
    let jumps: Vec<Vec<(usize, f64)>> = class
        .iter()
        .map(|state| {
            let nexts = rows[*state]
                .iter()
                .map(|(next, rate)| (*next as usize, *rate));
            nexts
                .filter(|(next, _)| next != state)
                .map(|(next, rate)| (local[next], rate))
                .collect()
        })
        .collect();
    let leaving: Vec<f64> = jumps
        .iter()
        .map(|row| row.iter().map(|(_, rate)| rate).sum())
        .collect();
    let (visits, sweeps) = if class.len() <= MOST_ELIMINATED {
        (eliminate(&jumps, &leaving), 0)
    } else {
        iterate(&jumps, &leaving, COARSEST)?
    };
    let lasting: Vec<f64> = visits
        .iter()
        .zip(&leaving)
        .map(|(visits, leaving)| {
            if *leaving > 0.0 {
                visits / leaving
            } else {
                1.0
            }
        })
        .collect();
    let total: f64 = lasting.iter().sum();
    let mut parts = vec![0.0; rows.len()];
    for (state, time) in class.iter().zip(lasting) {
        parts[*state] = time / total;
    }
    Ok((parts, sweeps))
}

/// Visits of the embedded chain by the elimination of Grassmann, Taksar and Heyman, which never
/// subtracts and so keeps all digits.
fn eliminate(jumps: &[Vec<(usize, f64)>], leaving: &[f64]) -> Vec<f64> {
    let count = jumps.len();
    let mut p = vec![vec![0.0; count]; count];
    for (from, row) in jumps.iter().enumerate() {
        for (to, rate) in row {
            p[from][*to] += rate / leaving[from];
        }
    }
    for last in (1..count).rev() {
        let out: f64 = p[last][..last].iter().sum();
        let (above, rest) = p.split_at_mut(last);
        let row = &rest[0];
        for from in above {
            let through = from[last] / out;
            from[last] = through;
            if through > 0.0 {
                for (to, part) in from[..last].iter_mut().zip(&row[..last]) {
                    *to += through * part;
                }
            }
        }
    }
    let mut visits = vec![0.0; count];
    if let Some(first) = visits.first_mut() {
        *first = 1.0;
    }
    for state in 1..count {
        visits[state] = (0..state).map(|from| visits[from] * p[from][state]).sum();
    }
    visits
}

/// Visits of the embedded chain by iteration, over chains of sizes down to `coarsest`. A cycle that
/// swings for ever is not excluded; sweeps alone do not swing, so they have the last word.
fn iterate(
    jumps: &[Vec<(usize, f64)>],
    leaving: &[f64],
    coarsest: usize,
) -> Result<(Vec<f64>, usize), NoConvergence> {
    let count = jumps.len();
    let parts: Vec<Vec<(usize, f64)>> = jumps
        .iter()
        .zip(leaving)
        .map(|(row, leaving)| row.iter().map(|(to, rate)| (*to, rate / leaving)).collect())
        .collect();
    let chain = Chain::new(&parts);
    #[allow(clippy::cast_precision_loss, reason = "counts are far below 2^52")]
    let mut visits = vec![1.0 / count as f64; count];
    let mut before = visits.clone();
    let mut change = 0.0;
    for sweep in 1..=MOST_SWEEPS {
        if sweep <= MOST_CYCLES {
            chain.cycle(&mut visits, coarsest, eliminate);
        } else {
            chain.sweep(&mut visits);
        }
        let total: f64 = visits.iter().sum();
        change = 0.0_f64;
        for (visit, before) in visits.iter_mut().zip(&mut before) {
            *visit /= total;
            if *visit > 0.0 {
                change = change.max((*visit - *before).abs() / *visit);
            }
            *before = *visit;
        }
        if change < CONVERGED {
            return Ok((visits, sweep));
        }
    }
    Err(NoConvergence {
        sweeps: MOST_SWEEPS,
        change,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_ring_that_returns_only_after_all_its_states_converges_too() {
        // Forwards and backwards: one of them is against the order of the sweeps.
        let count = 500_u32;
        for step in [1, count - 1] {
            let rows: Vec<Vec<(u32, f64)>> = (0..count)
                .map(|state| vec![((state + step) % count, f64::from(state % 7 + 1))])
                .collect();
            let classes = final_classes(&rows);
            assert_eq!(classes.len(), 1);
            let (parts, sweeps) = steady_state(&rows, &classes[0]).unwrap();
            assert!(sweeps > 0);
            let total: f64 = (0..count).map(|state| 1.0 / f64::from(state % 7 + 1)).sum();
            for (state, part) in parts.iter().enumerate() {
                let expected = 1.0 / (f64::from(u32::try_from(state).unwrap() % 7 + 1) * total);
                assert!((part - expected).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn states_that_are_left_for_ever_are_in_no_final_class() {
        let rows = vec![
            vec![(1, 1.0), (3, 1.0)],
            vec![(2, 1.0)],
            vec![(1, 2.0)],
            vec![],
        ];
        assert_eq!(final_classes(&rows), [vec![1, 2], vec![3]]);
    }

    fn random_rows() -> impl Strategy<Value = Vec<Vec<(u32, f64)>>> {
        (2_u32..40).prop_flat_map(|count| {
            let row = prop::collection::vec((0..count, 0.01_f64..100.0), 0..4);
            prop::collection::vec(row, count as usize).prop_map(move |mut rows| {
                // A ring under it makes it one class.
                for (state, row) in (0..).zip(&mut rows) {
                    row.push(((state + 1) % count, 1.0));
                }
                rows
            })
        })
    }

    proptest! {
        #[test]
        fn elimination_and_iteration_agree_and_balance(rows in random_rows()) {
            let all: Vec<usize> = (0..rows.len()).collect();
            prop_assert_eq!(final_classes(&rows), [all.clone()]);
            let (parts, _) = steady_state(&rows, &all).unwrap();
            prop_assert!((parts.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let mut flow = vec![0.0; rows.len()];
            for (from, row) in rows.iter().enumerate() {
                for (to, rate) in row {
                    flow[from] -= parts[from] * rate;
                    flow[*to as usize] += parts[from] * rate;
                }
            }
            prop_assert!(flow.iter().all(|net| net.abs() < 1e-9), "{:?}", flow);
            let jumps: Vec<Vec<(usize, f64)>> = rows
                .iter()
                .enumerate()
                .map(|(from, row)| {
                    let others = row.iter().map(|(to, rate)| (*to as usize, *rate));
                    others.filter(|(to, _)| *to != from).collect()
                })
                .collect();
            let leaving: Vec<f64> = jumps.iter().map(|r| r.iter().map(|(_, rate)| rate).sum()).collect();
            let (visits, _) = iterate(&jumps, &leaving, 4).unwrap();
            let times: Vec<f64> = visits.iter().zip(&leaving).map(|(v, l)| v / l).collect();
            let total: f64 = times.iter().sum();
            for (time, part) in times.iter().zip(&parts) {
                prop_assert!((time / total - part).abs() < 1e-8);
            }
        }
    }
}
