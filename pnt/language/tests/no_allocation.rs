//! The token game allocates nothing once it runs. That holds in one step and in two phases, with
//! chance, weights, time limits and the event log.

#![allow(clippy::unwrap_used, reason = "a test may end when its input is wrong")]

use std::{fmt::Write as _, sync::Arc};

use ctos::diagnostic::Source;
use pnt_language::{
    compile,
    exec::{Conflicts, Execution},
};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// A ring with tokens, side ways, read and inhibitor arcs, capacities and weights.
fn execution(more: &str) -> Execution {
    let mut text = String::from("net ring\nplace gate = 1, off\n");
    for index in 0..100 {
        let next = (index + 1) % 100;
        let _ = writeln!(
            text,
            "place p{index} = 2 capacity 9
transition t{index}\n  in p{index}\n  out p{next}\n  read gate\n  inhibit off\n  weight 2\n{more}
transition u{index}\n  in p{index}*2\n  out p{next}*2\n{more}"
        );
    }
    let net = compile::net(&Source::new("ring.net", text)).unwrap();
    Execution::new(Arc::new(net))
}

/// How many firings `fire` does; it must be all of them.
fn play(execution: &mut Execution, conflicts: &mut Conflicts, two_phases: bool) -> usize {
    let mut count = 0;
    while count < 20_000 {
        let Some(id) = execution.choose(conflicts, |_| true) else {
            break;
        };
        if two_phases {
            let now_ns = execution.now_ns();
            execution.advance_to(now_ns + 1000);
            let firing = execution.start(id).unwrap();
            if count % 3 == 0 {
                execution.fail(firing).unwrap();
            } else {
                execution.complete(firing).unwrap();
            }
            assert!(execution.expire().unwrap().is_none());
        } else {
            execution.fire(id).unwrap();
        }
        count += 1;
    }
    count
}

#[test]
fn a_firing_allocates_nothing() {
    let random = || Conflicts::Random(Box::new(ChaCha8Rng::seed_from_u64(3)));
    for (name, more, two_phases, log, mut conflicts) in [
        ("declared order", "", false, false, Conflicts::Declared),
        ("chance", "", false, false, random()),
        ("with the event log", "", false, true, random()),
        (
            "two phases",
            "  do it\n  within 1 ms\n",
            true,
            false,
            random(),
        ),
        (
            "two phases with the event log",
            "  do it\n  within 1 ms\n",
            true,
            true,
            random(),
        ),
    ] {
        let mut execution = execution(more);
        if log {
            execution.record_events(256);
        }
        // What grows to its size does so in the beginning.
        play(&mut execution, &mut conflicts, two_phases);
        let mut count = 0;
        let allocated = allocation_counter::measure(|| {
            count = play(&mut execution, &mut conflicts, two_phases);
        });
        assert_eq!((allocated.count_total, count), (0, 20_000), "{name}");
    }
}
