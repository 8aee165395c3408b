use ctos::diagnostic::Source;
use proptest::{collection::vec, prelude::*};
use rand::SeedableRng as _;

use super::*;
use crate::{compile, invariants};

fn execution(text: &str) -> Execution {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    Execution::new(Arc::new(net))
}

fn id(execution: &Execution, name: &str) -> TransitionId {
    execution.net().transition(name).unwrap()
}

fn tokens(execution: &Execution, place: &str) -> u32 {
    execution.marking()[execution.net().place(place).unwrap().index()]
}

fn enabled(execution: &Execution) -> Vec<String> {
    let net = execution.net();
    execution.enabled().map(|t| net[t].name.clone()).collect()
}

const ACTION: &str = "net n
place a = 2, b, c
transition work
  in a*2
  do something
  out b
  fail c
";

#[test]
fn tokens_are_taken_at_the_start_and_put_at_completion() {
    let mut execution = execution(ACTION);
    let work = id(&execution, "work");
    assert!(matches!(execution.fire(work), Err(FireError::HasAction(_))));
    let firing = execution.start(work).unwrap();
    assert_eq!(execution.marking(), [0, 0, 0]);
    assert!(enabled(&execution).is_empty());
    execution.complete(firing).unwrap();
    assert_eq!(execution.marking(), [0, 1, 0]);
    assert_eq!(execution.complete(firing), Err(FireError::NotRunning(0)));
}

#[test]
fn a_failed_action_takes_the_failure_branch_or_gives_everything_back() {
    let mut with_branch = execution(ACTION);
    let work = id(&with_branch, "work");
    let firing = with_branch.start(work).unwrap();
    with_branch.fail(firing).unwrap();
    assert_eq!(with_branch.marking(), [0, 0, 1]);

    let mut without = execution(&ACTION.replace("  fail c\n", ""));
    let firing = without.start(work).unwrap();
    without.fail(firing).unwrap();
    assert_eq!(without.marking(), [2, 0, 0]);
    assert_eq!(enabled(&without), ["work"]);
}

#[test]
fn weights_read_arcs_and_inhibitors_decide_what_is_enabled() {
    let mut execution = execution(
        "net n\nplace a = 1, r, h = 2\ntransition t\n  in a*2\n  read r\n  inhibit h*2\n  out a*2\ntransition u\n  in h\n",
    );
    assert_eq!(enabled(&execution), ["u"]);
    execution.put_tokens("a", 1).unwrap();
    execution.put_tokens("r", 1).unwrap();
    assert_eq!(enabled(&execution), ["u"]);
    execution.fire(id(&execution, "u")).unwrap();
    assert_eq!(enabled(&execution), ["t", "u"]);
    execution.fire(id(&execution, "t")).unwrap();
    assert_eq!((tokens(&execution, "a"), tokens(&execution, "r")), (2, 1));
}

#[test]
fn conflicts_go_to_priority_then_to_declared_order_or_to_chance() {
    let text = "net n\nplace a = 1, b\ntransition low\n  in a\ntransition first\n  in a\n  priority 1\ntransition second\n  in a\n  priority 1\n";
    let execution = execution(text);
    let name = |id: Option<TransitionId>| execution.net()[id.unwrap()].name.clone();
    assert_eq!(
        name(execution.choose(&mut Conflicts::Declared, |_| true)),
        "first"
    );
    let mut random = Conflicts::Random(Box::new(ChaCha8Rng::seed_from_u64(7)));
    let mut seen: Vec<String> = (0..64)
        .map(|_| name(execution.choose(&mut random, |_| true)))
        .collect();
    seen.sort();
    seen.dedup();
    assert_eq!(seen, ["first", "second"]);
}

#[test]
fn an_enabling_function_and_its_negation_let_exactly_one_through() {
    let execution = execution(
        "net n\nplace a = 1\ntransition again\n  in a\n  when more\ntransition done\n  in a\n  when not more\n",
    );
    for (more, expected) in [(true, "again"), (false, "done")] {
        let chosen = execution.choose(&mut Conflicts::Declared, |when| {
            assert_eq!(when.function, "more");
            more
        });
        assert_eq!(execution.net()[chosen.unwrap()].name, expected);
    }
}

const TAPE: &str = "net n
place free = 1, busy
command go -> gone, lost
command stop -> stopped
transition begin
  in free
  tape go
  do begin
  out busy
transition end
  in busy
  out free
  write gone
transition halt
  in free
  tape stop
  out free
  write stopped
";

#[test]
fn one_command_is_in_progress_at_a_time_and_gets_its_answer() {
    let mut execution = execution(TAPE);
    assert!(enabled(&execution).is_empty());
    let go = execution.put_symbol("go", vec!["x".into()]).unwrap();
    let stop = execution.put_symbol("stop", Vec::new()).unwrap();
    assert_eq!(enabled(&execution), ["begin"]);
    let firing = execution.start(id(&execution, "begin")).unwrap();
    assert_eq!(execution.tape().current().unwrap().arguments, ["x"]);
    execution.complete(firing).unwrap();
    assert_eq!(enabled(&execution), ["end"]);
    let end = id(&execution, "end");
    let effects = execution.fire(end).unwrap();
    let symbol = "gone".to_owned();
    assert_eq!(
        effects.written,
        Some(Written::Answer {
            command: go,
            symbol
        })
    );
    assert_eq!(enabled(&execution), ["halt"]);
    let halt = id(&execution, "halt");
    let effects = execution.fire(halt).unwrap();
    let symbol = "stopped".to_owned();
    assert_eq!(
        effects.written,
        Some(Written::Answer {
            command: stop,
            symbol
        })
    );
}

#[test]
fn a_symbol_goes_back_to_the_tape_when_its_action_fails() {
    let mut execution = execution(TAPE);
    execution.put_symbol("go", Vec::new()).unwrap();
    let firing = execution.start(id(&execution, "begin")).unwrap();
    assert!(enabled(&execution).is_empty());
    execution.fail(firing).unwrap();
    assert_eq!(enabled(&execution), ["begin"]);
    assert_eq!(execution.tape().waiting().count(), 1);
}

#[test]
fn a_symbol_outside_the_alphabet_is_refused_with_the_alphabet() {
    let error = execution(TAPE).put_symbol("gp", Vec::new()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "net `n` takes no command `gp`; it takes: go, stop"
    );
}

#[test]
fn a_symbol_written_without_a_command_is_reported() {
    let mut execution = execution(TAPE);
    execution.put_tokens("busy", 1).unwrap();
    let end = id(&execution, "end");
    let symbol = "gone".to_owned();
    assert_eq!(
        execution.fire(end).unwrap().written,
        Some(Written::Unasked { symbol })
    );
}

#[test]
fn remote_outputs_are_handed_to_the_caller() {
    let mut execution =
        execution("net n\nplace a = 1, p3\ntransition t1\n  in a\n  out p1@other*2, p3\n");
    let t1 = id(&execution, "t1");
    let effects = execution.fire(t1).unwrap();
    let [arc] = effects.remote else {
        panic!("{effects:?}")
    };
    assert_eq!(
        (arc.net.as_str(), arc.place.as_str(), arc.weight),
        ("other", "p1", 2)
    );
    assert_eq!(tokens(&execution, "p3"), 1);
}

#[test]
fn a_place_that_is_full_stops_the_firing_and_nothing_changes() {
    let mut execution = execution("net n\nplace a = 1, b = 1\ntransition t\n  in a\n  out b\n");
    execution.put_tokens("b", u32::MAX - 1).unwrap();
    let t = id(&execution, "t");
    assert_eq!(execution.fire(t), Err(FireError::TooManyTokens("b".into())));
    assert_eq!(tokens(&execution, "a"), 1);
    assert!(execution.put_tokens("b", 1).is_err());
    assert!(matches!(
        execution.put_tokens("x", 1),
        Err(FireError::UnknownPlace { .. })
    ));
}

/// A random net as text: `arcs` says which of five places each transition takes from and puts to.
fn random_net(transitions: &[(Vec<u8>, Vec<u8>, u8)]) -> String {
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

fn weights() -> impl Strategy<Value = Vec<u8>> {
    vec(
        prop_oneof![3 => Just(0_u8), 2 => Just(1_u8), 1 => Just(2_u8)],
        5,
    )
}

fn random_transitions() -> impl Strategy<Value = Vec<(Vec<u8>, Vec<u8>, u8)>> {
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

proptest! {
    #[test]
    fn firing_conserves_every_place_invariant(transitions in random_transitions(), picks in vec(any::<prop::sample::Index>(), 0..60)) {
        let mut execution = execution(&random_net(&transitions));
        let Some(found) = invariants::place_invariants(execution.net(), 1000) else { return Ok(()) };
        let sum = |weights: &[u64], execution: &Execution| -> u64 {
            weights.iter().zip(execution.marking()).map(|(w, t)| w * u64::from(*t)).sum()
        };
        let before: Vec<u64> = found.iter().map(|weights| sum(weights, &execution)).collect();
        for pick in picks {
            let choices: Vec<TransitionId> = execution.enabled().collect();
            if choices.is_empty() { break; }
            execution.fire(*pick.get(&choices)).unwrap();
            for (weights, sum_before) in found.iter().zip(&before) {
                prop_assert_eq!(sum(weights, &execution), *sum_before);
            }
        }
    }

    #[test]
    fn the_incremental_enabled_set_is_the_one_that_the_marking_gives(transitions in random_transitions(), picks in vec(any::<prop::sample::Index>(), 0..60)) {
        let mut execution = execution(&random_net(&transitions));
        for pick in picks {
            let by_definition: Vec<usize> = transitions
                .iter()
                .enumerate()
                .filter(|(_, (from, _, inhibit))| {
                    from.iter().zip(execution.marking()).all(|(w, t)| u32::from(*w) <= *t)
                        && execution.marking().get(usize::from(*inhibit)).is_none_or(|t| *t < 4)
                })
                .map(|(index, _)| index)
                .collect();
            let choices: Vec<TransitionId> = execution.enabled().collect();
            prop_assert_eq!(choices.iter().map(|t| t.index()).collect::<Vec<_>>(), by_definition);
            if choices.is_empty() { break; }
            execution.fire(*pick.get(&choices)).unwrap();
        }
    }
}
