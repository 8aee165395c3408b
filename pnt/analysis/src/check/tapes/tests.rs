use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

use proptest::prelude::*;

#[path = "../../../../tests/shared/expressions.rs"]
mod expressions;

use super::*;
use crate::{
    analysis::{explicit::explore, model::Model, returns::returns, samples::net},
    check::{Limits, Options, Proof, Rule, prove},
    compose::{Phase, Stands, System},
};
use expressions::{ends, expression, words, written};
use pnt_language::exec::Execution;

/// Every `a` takes the token over or back; `b` is only answered where it began.
const TOGGLE: &str = "net toggle
place p = 1, q
command a -> done
command b -> done
transition over
  in p
  tape a
  out q
  write done
transition back
  in q
  tape a
  out p
  write done
transition stay
  in p
  tape b
  out p
  write done
";

fn read(text: &str, nets: &[Arc<Net>]) -> Result<Vec<Tape>, Findings> {
    tapes(&Source::new("tape", text), nets)
}

fn proved(nets: &[Arc<Net>], tape: &str) -> Proof {
    let options = Options {
        tapes: read(tape, nets).unwrap_or_else(|findings| panic!("{findings}")),
        workflows: true,
        ..Options::new(Rule::Rest, Limits::default())
    };
    prove(nets, &options, &mut |_| {}).unwrap_or_else(|findings| panic!("{findings}"))
}

fn codes(proof: &Proof) -> Vec<&'static str> {
    proof.findings.iter().map(|finding| finding.code).collect()
}

#[test]
fn a_net_is_sound_under_one_language_and_not_under_another() {
    let nets = [net(TOGGLE)];
    for (tape, codes_found, markings) in [
        // At rest, `a` on the tape, answered; and back.
        ("(a a)*", vec!["pnt::check::never_fires"], 4),
        ("(a a | b)*", vec![], 5),
        ("a a", vec!["pnt::check::never_fires"], 5),
        // The end of a word need not be rest, nor need there be anything on the tape.
        ("a", vec!["pnt::check::never_fires"; 2], 3),
        ("()", vec!["pnt::check::never_fires"; 3], 1),
        (
            "a b",
            vec![
                "pnt::check::deadlock",
                "pnt::check::never_fires",
                "pnt::check::never_fires",
            ],
            4,
        ),
        // Idle and `b`; `a`, and over; either, and back; `a`, and over.
        ("b* a . a", vec!["pnt::check::deadlock"], 9),
    ] {
        let proof = proved(&nets, tape);
        assert_eq!(codes(&proof), codes_found, "{tape}: {}", proof.findings);
        assert_eq!(proof.verdict.markings, markings, "{tape}");
        assert!(proof.verdict.complete);
        let dead = codes_found.contains(&"pnt::check::deadlock");
        assert_eq!(proof.verdict.deadlocks, u128::from(dead), "{tape}");
        assert_eq!(proof.workflows.iter().all(|w| w.sound == Some(true)), !dead);
    }
}

#[test]
fn a_deadlock_under_a_language_is_one_that_the_executor_comes_to() {
    let toggle = net(TOGGLE);
    let proof = proved(std::slice::from_ref(&toggle), "a b");
    let finding = proof.findings.iter().next().unwrap();
    let way = "after command a to toggle, toggle.over, command b to toggle, the marking is toggle.q, b on the tape of toggle";
    assert!(finding.message.contains(way), "{finding}");
    let mut execution = Execution::new(Arc::clone(&toggle));
    execution.put_symbol("a", Vec::new()).unwrap();
    execution.fire(toggle.transition("over").unwrap()).unwrap();
    execution.put_symbol("b", Vec::new()).unwrap();
    assert_eq!(execution.enabled().count(), 0);
    assert_eq!(execution.tape().len(), 1);
    // Of the two commands one is always answered.
    let sound: Vec<(&str, Option<bool>)> = proof
        .workflows
        .iter()
        .map(|workflow| (workflow.command.as_str(), workflow.sound))
        .collect();
    assert_eq!(sound, [("a", Some(true)), ("b", Some(false))]);
}

#[test]
fn a_word_that_goes_round_for_ever_without_an_answer_is_found() {
    let text = "net n
place p = 1, q, r
command a -> done
transition begin
  in p
  tape a
  out q
transition on
  in q
  out r
transition again
  in r
  out q
transition end
  in q
  out p
  write done
";
    // With `end` it can always come to its end.
    assert_eq!(codes(&proved(&[net(text)], "a{3}")), [""; 0]);
    let never = text.replace("transition end\n  in q\n", "transition end\n  in q, p\n");
    let proof = proved(&[net(&never)], "a{3}");
    assert_eq!(
        codes(&proof),
        ["pnt::check::no_end", "pnt::check::never_fires"]
    );
    assert_eq!(proof.workflows[0].sound, Some(false));
}

#[test]
fn tapes_of_two_nets_are_independent_and_the_end_is_that_of_both() {
    let other = TOGGLE.replace("toggle", "other");
    let nets = [net(TOGGLE), net(&other)];
    let both = proved(&nets, "toggle: (a a)* other: b");
    // Four of the one, and before `b`, with it, after it.
    assert_eq!(both.verdict.markings, 4 * 3);
    assert_eq!(both.verdict.deadlocks, 0);
    let ended = proved(&nets, "toggle: a a other: b");
    assert_eq!(
        (ended.verdict.markings, ended.verdict.deadlocks),
        (5 * 3, 0)
    );
    // The one stands still when the other has ended: that is not an end.
    let stuck = proved(&nets, "toggle: a b other: b");
    assert_eq!(
        (stuck.verdict.markings, stuck.verdict.deadlocks),
        (4 * 3, 1)
    );
    // What is said of one leaves the other open.
    let open = proved(&nets, "toggle: a a");
    assert_eq!(codes(&open)[0], "pnt::check::deadlock");
}

#[test]
fn what_does_not_fit_the_nets_is_pointed_at() {
    let silent = net("net silent\nplace p = 1\ntransition t\n  in p\n  out p\n");
    let other = net(&TOGGLE.replace("toggle", "other"));
    let one = [net(TOGGLE), Arc::clone(&silent)];
    let two = [net(TOGGLE), other, Arc::clone(&silent)];
    for (nets, text, code, place) in [
        (&one[..], "a (b | A)*", "unknown_symbol", "tape:1:8"),
        (&one, "toggle: a c", "unknown_symbol", "tape:1:11"),
        (&two, "a b", "which_net", "tape:1:1"),
        (&two, "other: a togle: b", "unknown_net", "tape:1:10"),
        (&one, "silent: a", "no_tape", "tape:1:1"),
        (&one[1..], "a", "no_tape", "tape:1:1"),
        (&one, "a{1000}{1000}", "too_large", "tape:1:1"),
        (&one, "a )", "syntax", "tape:1:3"),
    ] {
        let findings = read(text, nets).unwrap_err().into_sorted();
        let [finding] = findings.as_slice() else {
            panic!("{text}: {findings:?}")
        };
        assert_eq!(finding.code, format!("pnt::tape::{code}"), "{text}");
        assert_eq!(finding.place.as_ref().unwrap().to_string(), place, "{text}");
        assert!(finding.help.is_some(), "{text}");
    }
    // All at once, each with what is known.
    let findings = read("aa b bb", &one).unwrap_err();
    assert_eq!(findings.iter().count(), 2);
    assert!(
        findings.to_string().contains("did you mean `a`?"),
        "{findings}"
    );
    let twice = read("toggle: a toggle: b", &one).unwrap();
    assert!(given_twice(&twice).has_errors());
}

/// A net of three places and the commands `a`, `b` and `c`, with some transitions that read one, and some
/// that write the answer.
fn random_net() -> impl Strategy<Value = String> {
    let places = || prop::collection::btree_map(0_u8..3, 1_u8..3, 0..3);
    let transition = (places(), places(), 0_u8..5, any::<bool>(), 0_u8..6);
    let transitions = prop::collection::vec(transition, 2..6);
    (prop::collection::vec(0_u8..3, 3), transitions).prop_map(|(tokens, transitions)| {
        let mut text = String::from("net n\n");
        for (number, tokens) in tokens.iter().enumerate() {
            let _ = writeln!(text, "place p{number} = {tokens} capacity 3");
        }
        for command in ["a", "b", "c"] {
            let _ = writeln!(text, "command {command} -> done");
        }
        for (number, (takes, puts, tape, writes, action)) in transitions.iter().enumerate() {
            let _ = writeln!(text, "transition t{number}");
            for (keyword, arcs) in [("in", takes), ("out", puts)] {
                let arcs: Vec<String> = arcs.iter().map(|(p, w)| format!("p{p}*{w}")).collect();
                // Without any arc it would fire for ever.
                let none = keyword == "in" && *tape > 2 && arcs.is_empty();
                let arcs = if none {
                    "p0".to_owned()
                } else {
                    arcs.join(", ")
                };
                if !arcs.is_empty() {
                    let _ = writeln!(text, "  {keyword} {arcs}");
                }
            }
            if let Some(command) = ["a", "b", "c"].get(usize::from(*tape)) {
                let _ = writeln!(text, "  tape {command}");
            }
            if *writes {
                text.push_str("  write done\n");
            }
            match action {
                0 => text.push_str("  do something\n"),
                1 => text.push_str("  do something\n  fail p1\n"),
                _ => {}
            }
        }
        text
    })
}

/// What has come on the tape, and the marking.
type Point = (Vec<usize>, Vec<u32>);

/// All runs of a net under words up to a length, from the definition. A command comes when the one
/// before is answered, if a word goes on with it.
struct Runs {
    /// Where each point leads; those from which nothing leads are dead.
    next: BTreeMap<Point, Vec<Point>>,
    /// Points at which a word has ended and is answered.
    ended: BTreeSet<Point>,
}

fn runs(system: &System, language: &[Vec<usize>], most: usize) -> Option<Runs> {
    let model = Model::of_system(system);
    let at = |wanted: Stands| system.places().iter().position(|p| p.stands == wanted);
    let idle = at(Stands::Idle)?;
    let prefixes: BTreeSet<&[usize]> = language
        .iter()
        .flat_map(|word| (0..=word.len()).map(|end| &word[..end]))
        .collect();
    let mut runs = Runs {
        next: BTreeMap::new(),
        ended: BTreeSet::new(),
    };
    let mut open = vec![(Vec::new(), model.initial())];
    while let Some((word, marking)) = open.pop() {
        let point = (word.clone(), marking.clone());
        if runs.next.contains_key(&point) {
            continue;
        }
        let mut next = Vec::new();
        for (number, step) in (0..).zip(system.steps()) {
            if !matches!(step.phase, Phase::Put(_)) {
                next.extend(model.fire(number, &marking).map(|to| (word.clone(), to)));
            }
        }
        if marking[idle] > 0 {
            for symbol in 0..3 {
                let longer = [word.as_slice(), &[symbol]].concat();
                if prefixes.contains(longer.as_slice()) {
                    let mut to = marking.clone();
                    to[idle] -= 1;
                    let command = pnt_language::net::CommandId(u32::try_from(symbol).unwrap());
                    to[at(Stands::OnTape(command))?] += 1;
                    next.push((longer, to));
                }
            }
            if language.contains(&word) {
                runs.ended.insert(point.clone());
            }
        }
        open.extend(next.iter().cloned());
        runs.next.insert(point, next);
        if runs.next.len() > most {
            return None;
        }
    }
    Some(runs)
}

impl Runs {
    fn has_deadlock(&self) -> bool {
        let dead = self.next.iter().filter(|(_, next)| next.is_empty());
        dead.into_iter()
            .any(|(point, _)| !self.ended.contains(point))
    }

    /// Points from which an end can be reached.
    fn can_end(&self) -> BTreeSet<&Point> {
        let mut can: BTreeSet<&Point> = self.ended.iter().collect();
        loop {
            let before = can.len();
            for (point, next) in &self.next {
                if next.iter().any(|to| can.contains(to)) {
                    can.insert(point);
                }
            }
            if can.len() == before {
                return can;
            }
        }
    }
}

/// What the places of the nets themselves hold, and their tapes; not where the language is.
fn projected(markings: impl Iterator<Item = Vec<u32>>, places: usize) -> BTreeSet<Vec<u32>> {
    markings
        .map(|mut marking| {
            marking.truncate(places);
            marking
        })
        .collect()
}

fn all_markings(model: &Model) -> Option<Vec<Vec<u32>>> {
    let explored = explore(model, &Limits::default());
    let seen = std::cell::RefCell::new(Vec::new());
    explored.complete().then(|| {
        let _ = explored.nearest(|marking| {
            seen.borrow_mut().push(marking.to_vec());
            false
        });
        seen.into_inner()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn a_check_under_a_language_is_one_of_all_its_words(text in random_net(), expression in expression()) {
        const LONGEST: u32 = 5;
        let Ok(compiled) = pnt_language::compile::net(&Source::new("n.net", text.as_str())) else { return Ok(()) };
        let nets = [Arc::new(compiled)];
        let (system, findings) = System::compose(&nets);
        if findings.has_errors() { return Ok(()) }
        let language: Vec<Vec<usize>> = words(LONGEST)
            .into_iter()
            .filter(|word| ends(&expression, word, 0).contains(&word.len()))
            .collect();
        let Ok(tapes) = read(&written(&expression), &nets) else { return Ok(()) };
        if language.is_empty() { return Ok(()) }
        let Some(runs) = runs(&system, &language, 3000) else { return Ok(()) };
        let options = Options { tapes: tapes.clone(), ..Options::new(Rule::Rest, Limits::default()) };
        let proof = prove(&nets, &options, &mut |_| {}).unwrap();
        if !proof.verdict.complete { return Ok(()) }
        let found = all_markings(&proof.model).unwrap();
        let found = projected(found.into_iter(), system.places().len());
        let seen = projected(runs.next.keys().map(|(_, marking)| marking.clone()), system.places().len());
        let codes = codes(&proof);
        let dead = codes.contains(&"pnt::check::deadlock");
        let no_end = codes.contains(&"pnt::check::no_end");
        if longest(&expression).is_some_and(|longest| longest <= LONGEST) {
            prop_assert_eq!(&found, &seen);
            prop_assert_eq!(dead, runs.has_deadlock());
            let stuck = runs.can_end().len() < runs.next.len();
            prop_assert_eq!(dead || no_end, stuck, "{:?}", codes);
        } else {
            prop_assert!(seen.is_subset(&found));
            // What is dead after a short word is dead whatever longer words there are.
            prop_assert!(dead || !runs.has_deadlock());
        }
    }

    #[test]
    fn any_word_at_all_is_the_open_tape(text in random_net()) {
        let Ok(compiled) = pnt_language::compile::net(&Source::new("n.net", text.as_str())) else { return Ok(()) };
        let nets = [Arc::new(compiled)];
        let (open, findings) = System::compose(&nets);
        if findings.has_errors() { return Ok(()) }
        for tape in ["(a | b | c)*", ".*", "(. .)* .?"] {
            let mut given = open.clone();
            let ends = given.with_tapes(&read(tape, &nets).unwrap());
            let (one, two) = (Model::of_system(&open), Model::of_system(&given));
            let (one, two) = (explore(&one, &Limits::default()), explore(&two, &Limits::default()));
            if !one.complete() { return Ok(()) }
            prop_assert_eq!(one.markings, two.markings);
            prop_assert_eq!((one.edges, one.dead_count), (two.edges, two.dead_count));
            prop_assert_eq!(&one.bounds, &two.bounds);
            let (one, two) = (returns(&one, usize::MAX).unwrap(), returns(&two, usize::MAX).unwrap());
            prop_assert_eq!((one.reversible, one.live), (two.reversible, two.live));
            prop_assert!(ends.holds(&Model::of_system(&given).initial()));
        }
    }
}

/// Symbols of the longest word; `None` when there is none.
fn longest(expression: &Expression<usize>) -> Option<u32> {
    match expression {
        Expression::Symbol(_) | Expression::Any => Some(1),
        Expression::Sequence(parts) => parts.iter().map(longest).sum(),
        Expression::Choice(parts) => {
            let lengths: Option<Vec<u32>> = parts.iter().map(longest).collect();
            lengths?.into_iter().max()
        }
        Expression::Repeat(inner, _, most) => match (longest(inner)?, most) {
            (0, _) => Some(0),
            (inner, Some(most)) => Some(inner * most),
            (_, None) => None,
        },
    }
}
