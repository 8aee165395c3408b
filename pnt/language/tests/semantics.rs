//! `docs/net-semantics.md`: every sentence names the tests that hold it, and those that stand nowhere else
//! stand here.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may end when its page is wrong"
)]

use std::{fs, path::Path, sync::Arc};

use ctos::diagnostic::Source;
use pnt_language::{
    compile,
    exec::{Execution, FireError, Race},
    net::TransitionId,
};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

const PAGE: &str = include_str!("../../../docs/net-semantics.md");

fn execution(text: &str) -> Execution {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    Execution::new(Arc::new(net))
}

fn id(execution: &Execution, name: &str) -> TransitionId {
    execution.net().transition(name).unwrap()
}

/// All Rust of a folder, in one text.
fn code(folder: &Path, into: &mut String) {
    let mut entries: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            code(&path, into);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            into.push_str(&fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn every_sentence_of_the_page_names_tests_that_there_are() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut tests = String::new();
    for folder in [
        root.join("src"),
        root.join("tests"),
        root.join("../analysis/src"),
        root.join("../task/src"),
        root.join("../../tests/system"),
    ] {
        code(&folder, &mut tests);
    }
    let mut number = 0;
    for line in PAGE.lines() {
        let Some((first, sentence)) = line
            .split_once(". ")
            .filter(|(first, _)| first.parse::<u32>().is_ok())
        else {
            continue;
        };
        number += 1;
        assert_eq!(
            first,
            number.to_string(),
            "sentences are numbered one after the other: {line}"
        );
        let (_, named) = sentence
            .rsplit_once('(')
            .unwrap_or_else(|| panic!("no test behind: {line}"));
        let names: Vec<&str> = named.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "no test behind: {line}");
        for name in names {
            let there = tests.contains(&format!("fn {name}("));
            assert!(there, "sentence {number}: there is no test `{name}`");
        }
    }
    assert!(number >= 40, "only {number} sentences were found");
}

#[test]
fn a_transition_without_action_fires_in_one_step() {
    let mut execution = execution("net n\nplace a = 1, b\ntransition t\n  in a\n  out b\n");
    let t = id(&execution, "t");
    execution.fire(t).unwrap();
    assert_eq!(execution.marking(), [0, 1]);
    assert_eq!(execution.running().count(), 0);
    assert!(matches!(execution.fire(t), Err(FireError::NotEnabled(_))));
}

#[test]
fn a_transition_with_many_servers_starts_as_often_as_its_tokens_allow() {
    let mut execution = execution("net n\nplace a = 3, b\ntransition t\n  in a\n  do f\n  out b\n");
    let t = id(&execution, "t");
    let firings: Vec<_> = (0..3).map(|_| execution.start(t).unwrap()).collect();
    assert!(execution.start(t).is_err());
    // They end in any order, each once.
    for firing in firings.into_iter().rev() {
        execution.complete(firing).unwrap();
    }
    assert_eq!(execution.marking(), [0, 3]);
}

#[test]
fn a_reset_place_is_emptied_at_the_start_for_good() {
    let mut execution =
        execution("net n\nplace a = 2, b = 5\ntransition t\n  in a\n  reset b\n  do f\n");
    let t = id(&execution, "t");
    let firing = execution.start(t).unwrap();
    assert_eq!(execution.marking(), [1, 0]);
    execution.fail(firing).unwrap();
    assert_eq!(execution.marking(), [2, 0]);
}

#[test]
fn tokens_from_another_net_are_put_all_or_none() {
    let mut execution = execution("net n\nplace a, b\ntransition t\n  in a, b\n");
    let tokens = |names: &[&str]| -> Vec<(String, u32)> {
        names.iter().map(|name| ((*name).to_owned(), 1)).collect()
    };
    assert!(execution.put_all(&tokens(&["a", "nowhere"])).is_err());
    assert_eq!(execution.marking(), [0, 0]);
    execution.put_all(&tokens(&["a", "b", "a"])).unwrap();
    assert_eq!(execution.marking(), [2, 1]);
}

#[test]
fn a_clock_runs_while_its_transition_is_enabled_and_is_forgotten_when_it_is_not() {
    const S: u64 = 1_000_000_000;
    let mut execution = execution(
        "net n\nplace a = 1, b = 1, c\ntransition slow\n  in a\n  out c\n  time 5 s\ntransition quick\n  in b\n  out a\n  time 2 s\n",
    );
    let mut race = Race::new(&execution, ChaCha8Rng::seed_from_u64(1));
    let mut due = |execution: &mut Execution| {
        race.refresh(execution, |_| true);
        let mut due: Vec<u64> = race
            .clocks(execution)
            .iter()
            .map(|clock| clock.due_ns)
            .collect();
        due.sort_unstable();
        due
    };
    assert_eq!(due(&mut execution), [2 * S, 5 * S]);
    // One more token for `slow` at two seconds: its clock goes on.
    execution.advance_to(2 * S);
    let quick = id(&execution, "quick");
    execution.fire(quick).unwrap();
    assert_eq!(due(&mut execution), [5 * S]);
    // Both tokens are away from three seconds to four: the clock begins anew.
    execution.advance_to(3 * S);
    execution.take_tokens("a", 2).unwrap();
    assert_eq!(due(&mut execution), [0; 0]);
    execution.advance_to(4 * S);
    execution.put_tokens("a", 1).unwrap();
    assert_eq!(due(&mut execution), [9 * S]);
}
