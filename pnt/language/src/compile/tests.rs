use std::{num::NonZeroU32, time::Duration};

use super::*;
use crate::net::Timing;

fn compiled(text: &str) -> Net {
    net(&Source::new("n.net", text)).unwrap_or_else(|findings| panic!("{findings}"))
}

#[test]
fn capacities_resets_times_and_servers_arrive_in_the_compiled_net() {
    let net = compiled(
        "net n\nplace a = 1 capacity 3, b\ntransition t\n  in a\n  reset b\n  do f\n  idempotent\n  time exponential 2 s\n  weight 3\ntransition u\n  in b\n  servers 2\ntransition v\n  in b\n",
    );
    assert_eq!(net.places()[0].capacity, Some(3));
    let t = &net.transitions()[0];
    assert_eq!(t.resets, [net.place("b").unwrap()]);
    let mean = Duration::from_secs(2);
    assert_eq!(t.timing, Timing::Exponential { mean });
    assert!((t.weight - 3.0).abs() < f64::EPSILON);
    assert!(matches!(
        t.action,
        Some(Action::Local {
            idempotent: true,
            ..
        })
    ));
    let servers: Vec<Servers> = net.transitions().iter().map(|t| t.servers).collect();
    let two = NonZeroU32::new(2).map_or(Servers::ONE, Servers::Limit);
    assert_eq!(servers, [Servers::ONE, two, Servers::Many]);
}

#[test]
fn a_timed_transition_may_take_nothing_and_an_immediate_one_may_not() {
    compiled("net n\nplace a\ntransition t\n  out a\n  time 1 s\n");
    let immediate = "net n\nplace a\ntransition t\n  out a\n";
    assert!(net(&Source::new("n.net", immediate)).is_err());
}

#[test]
fn a_declared_safe_marking_asks_for_its_tokens_and_an_undeclared_one_is_rest() {
    let declared =
        compiled("net n\nplace a = 1, b, c\nsafe a, b*2\nsafe c\ntransition t\n  in a\n");
    assert!(declared.is_safe(&[1, 2, 0]) && declared.is_safe(&[0, 0, 4]));
    assert!(!declared.is_safe(&[1, 1, 0]) && !declared.is_safe(&[]));
    let undeclared = compiled("net n\nplace a = 1, b, c\ntransition t\n  in a\n");
    assert!(undeclared.is_safe(&[1, 0, 0]));
    assert!(!undeclared.is_safe(&[1, 1, 0]) && !undeclared.is_safe(&[1, 0]));
}
