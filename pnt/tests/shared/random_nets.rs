//! Random nets as texts, for tests of several crates.

use proptest::{collection::vec, prelude::*};

/// A random net as text: `arcs` says which of five places each transition takes from and puts to.
pub(crate) fn random_net(transitions: &[(Vec<u8>, Vec<u8>, u8)]) -> String {
    use std::fmt::Write as _;
    let mut text = String::from("net r\nplace p0 = 3, p1 = 2, p2 = 1, p3, p4\n");
    for (index, (from, to, inhibit)) in transitions.iter().enumerate() {
        let list = |weights: &[u8]| -> String {
            let arcs: Vec<String> = weights
                .iter()
                .enumerate()
                .filter(|(_, weight)| **weight > 0)
                .map(|(place, weight)| format!("p{place}*{weight}"))
                .collect();
            arcs.join(", ")
        };
        let _ = writeln!(text, "transition t{index}");
        for (keyword, weights) in [("in", from), ("out", to)] {
            if weights.iter().any(|weight| *weight > 0) {
                let _ = writeln!(text, "  {keyword} {}", list(weights));
            }
        }
        if *inhibit < 5 {
            let _ = writeln!(text, "  inhibit p{inhibit}*4");
        }
    }
    text
}

pub(crate) fn weights() -> impl Strategy<Value = Vec<u8>> {
    vec(
        prop_oneof![3 => Just(0_u8), 2 => Just(1_u8), 1 => Just(2_u8)],
        5,
    )
}

pub(crate) fn random_transitions() -> impl Strategy<Value = Vec<(Vec<u8>, Vec<u8>, u8)>> {
    let sources = |weights: &Vec<u8>| weights.iter().any(|weight| *weight > 0);
    vec(
        (
            weights().prop_filter("an input", sources),
            weights(),
            0_u8..9,
        ),
        1..6,
    )
}
