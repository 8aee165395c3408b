use std::collections::BTreeSet;

use ctos::diagnostic::Source;
use proptest::prelude::*;

#[path = "../../../tests/shared/expressions.rs"]
mod expressions;

use super::{parse::parse, *};
use expressions::{ends, expression, words, written};

/// The numbers of `a`, `b` and `c`.
fn number(word: &Word) -> SymbolNumber {
    ["a", "b", "c"]
        .iter()
        .position(|name| *name == word.text)
        .unwrap()
}

fn language(text: &str) -> Language {
    let tapes = parse(&Source::new("tape", text)).unwrap_or_else(|finding| panic!("{finding}"));
    let [tape] = tapes.as_slice() else {
        panic!("{tapes:?}")
    };
    Language::new(&tape.expression.map(&mut number), 3).unwrap()
}

fn after_word(language: &Language, word: &[SymbolNumber]) -> Option<usize> {
    word.iter().try_fold(0, |state, symbol| {
        let mut next = language.states()[state].next.iter();
        let (_, to) = next.find(|(other, _)| other == symbol)?;
        Some(*to)
    })
}

fn has(language: &Language, word: &[SymbolNumber]) -> bool {
    after_word(language, word).is_some_and(|state| language.states()[state].ends)
}

proptest! {
    #[test]
    fn an_automaton_has_the_words_of_its_expression(expression in expression()) {
        let language = Language::new(&expression, 3).unwrap();
        for word in words(5) {
            let is = ends(&expression, &word, 0).contains(&word.len());
            prop_assert_eq!(has(&language, &word), is, "{:?}", word);
        }
        // The same when it is written and read again.
        prop_assert_eq!(self::language(&written(&expression)), language);
    }

    #[test]
    fn every_state_is_told_from_the_others_and_can_come_to_an_end(expression in expression()) {
        let language = Language::new(&expression, 3).unwrap();
        let states = language.states();
        for state in 0..states.len() {
            prop_assert_eq!(after_word(&language, &language.way(state)), Some(state));
        }
        // What may come after a state, up to more symbols than there are states.
        let mut after: Vec<BTreeSet<Vec<SymbolNumber>>> = states
            .iter()
            .map(|state| state.ends.then(Vec::new).into_iter().collect())
            .collect();
        if states.len() > 4 {
            return Ok(());
        }
        for _ in 0..=states.len() {
            after = states
                .iter()
                .map(|state| {
                    let ends = state.ends.then(Vec::new).into_iter();
                    let longer = state.next.iter().flat_map(|(symbol, to)| {
                        after[*to].iter().map(|rest| [&[*symbol], rest.as_slice()].concat())
                    });
                    ends.chain(longer).collect()
                })
                .collect();
        }
        prop_assert!(after.iter().all(|words| !words.is_empty()));
        prop_assert_eq!(after.iter().collect::<BTreeSet<_>>().len(), states.len());
    }

    #[test]
    fn any_text_is_read_or_refused(text in "[abc(){}|*+?.:,\"# 0-9\n-]{0,40}") {
        let _ = parse(&Source::new("tape", text));
    }
}

#[test]
fn languages_have_as_many_states_as_there_are_situations() {
    for (text, states) in [
        ("(a|b|c)*", 1),
        (".*", 1),
        ("()", 1),
        ("a", 2),
        ("(a a)*", 2),
        ("a (b | c)* a", 3),
        ("a{3,5}", 6),
        ("(a b | a c)", 3),
    ] {
        assert_eq!(language(text).states().len(), states, "{text}");
    }
    assert_eq!(language("a (b | c)* a").last(), Some(2));
    assert_eq!(language("(a a)*").last(), None);
}

#[test]
fn tapes_of_several_nets_stand_in_one_text() {
    let text = "# two nets\narm: a b # first\n  | c\n\"my hand\" : (a)* b\n";
    let tapes = parse(&Source::new("tapes", text)).unwrap();
    let nets: Vec<&str> = tapes
        .iter()
        .map(|tape| tape.net.as_ref().unwrap().text.as_str())
        .collect();
    assert_eq!(nets, ["arm", "my hand"]);
    assert_eq!(&text[tapes[1].range.clone()], "(a)* b");
}

#[test]
fn what_cannot_be_read_is_pointed_at() {
    for (text, place, says) in [
        ("", "tape:1:1", "an input symbol is expected"),
        ("n:", "tape:1:3", "an input symbol is expected"),
        ("a |", "tape:1:4", "an input symbol is expected"),
        ("a\n(b | c", "tape:2:7", "a bracket is not closed"),
        ("a b) c", "tape:1:4", "closes nothing"),
        ("* a", "tape:1:1", "an input symbol is expected"),
        ("a{3,2}", "tape:1:6", "at most is fewer"),
        ("a{1000000}", "tape:1:3", "a number of times"),
        ("a{2", "tape:1:4", "a brace is not closed"),
        ("a{x}", "tape:1:3", "a number of times"),
        ("a \"b", "tape:1:3", "a quotation does not end"),
        ("a, b", "tape:1:2", "closes nothing, or a sign"),
    ] {
        let finding = parse(&Source::new("tape", text)).unwrap_err();
        assert_eq!(finding.place.as_ref().unwrap().to_string(), place, "{text}");
        assert!(finding.message.contains(says), "{text}: {finding}");
        assert!(finding.help.is_some());
    }
}

#[test]
fn what_is_too_large_is_refused_and_takes_no_time() {
    for text in [
        "((a{1000}){1000}){1000}".to_owned(),
        "(((){1000}){1000}){1000}".to_owned(),
        // The n-th symbol from the end: two to the power of n situations.
        "(a | b)* a (a | b){20}".to_owned(),
    ] {
        let tapes = parse(&Source::new("tape", text.as_str())).unwrap();
        let language = Language::new(&tapes[0].expression.map(&mut number), 3);
        assert_eq!(language, Err(automaton::TooLarge), "{text}");
    }
    for deep in [
        format!("{}a{}", "(".repeat(1_000_000), ")".repeat(1_000_000)),
        format!("a{}", "*".repeat(1_000_000)),
    ] {
        let finding = parse(&Source::new("tape", deep)).unwrap_err();
        assert!(finding.message.contains("nested too deeply"), "{finding}");
    }
}
