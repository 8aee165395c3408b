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

/// The findings about a text, each on a line.
fn found(text: &str) -> Vec<String> {
    let findings = net(&Source::new("n.net", text)).unwrap_err();
    let findings = findings.into_sorted();
    findings.iter().map(ToString::to_string).collect()
}

#[test]
fn mistakes_of_lines_and_of_names_are_found_in_one_pass() {
    let text = "net n
place idle = 1, busy
place part =
place idle
command go -> gone
transition begin
  in idel
  tape goo
  out busy, part
transition end
  in busy *
  when not
  out idle
  write gon
";
    let found = found(text);
    let at: Vec<&str> = found
        .iter()
        .filter_map(|line| line.split(": ").next())
        .collect();
    assert_eq!(
        at,
        [
            "n.net:3:13",
            "n.net:4:7",
            "n.net:7:6",
            "n.net:8:8",
            "n.net:11:12",
            "n.net:12:11",
            "n.net:14:9"
        ],
        "{found:#?}"
    );
    // `part` stands on a line that cannot be read: nothing is said of it.
    assert!(
        !found.iter().any(|line| line.contains("no place `part`")),
        "{found:#?}"
    );
}

#[test]
fn what_a_transition_lacks_is_not_said_while_one_of_its_lines_cannot_be_read() {
    let found = found("net n\nplace a = 1\ntransition t\n  inn a\n  fail a\n  doo f\n");
    assert_eq!(found.len(), 2, "{found:#?}");
}

#[test]
fn a_negation_without_its_function_is_refused_and_a_function_called_not_stands_in_quotes() {
    let text =
        |when: &str| format!("net n\nplace a = 1\ntransition t\n  in a\n  when {when}\n  out a\n");
    let found = found(&text("not"));
    assert!(
        found[0].starts_with("n.net:5:11: error: expected an enabling function after `not`"),
        "{found:#?}"
    );
    for (when, negated) in [("\"not\"", false), ("not not", true), ("not \"not\"", true)] {
        let source = Source::new("n.net", text(when));
        let draft = crate::text::parse(&source).unwrap();
        let read = compiled(&text(when));
        let given = read.transitions()[0].when.as_ref().unwrap();
        assert_eq!((given.function.as_str(), given.negated), ("not", negated));
        let again = crate::text::parse(&Source::new("again.net", draft.to_string())).unwrap();
        assert_eq!(again, draft);
    }
}
