use std::{num::NonZeroU32, time::Duration};

use proptest::{collection::vec, option, prelude::*};

use super::*;
use crate::{
    draft::DraftArc,
    timing::{Servers, Timing},
};

/// The findings about a text, one line each.
fn findings(text: &str) -> Vec<String> {
    match parse(&Source::new("a.net", text)) {
        Ok(draft) => panic!("parsed: {draft}"),
        Err(findings) => findings
            .into_sorted()
            .iter()
            .map(ToString::to_string)
            .collect(),
    }
}

#[test]
fn every_line_of_the_grammar_is_read() {
    let text = r#"
net dispatcher "Translates commands" # and a comment
place a = 2 capacity 5, b, c data path
safe a*2, b
safe c
command go -> gone, not_gone
coordinator vision : find_spot, find_blob
serves planner : plan ; done plan_done ; failed plan_failed
transition t
  in a*2, b
  read c
  inhibit c*3
  reset b, c
  tape go
  when not more
  send operator.report(path, speed -> receipt, stamp)
  idempotent
  out p1@other, p2@other*2, b
  fail a
  write gone
  priority 7
  within 1.5 s
  weight 0.5
  time normal 2 s spread 300 ms
  servers 2
transition u
  in a
  when more
  ask vision find_spot
  out b
transition "3 \"x\""
  in a
  time exponential 2 min
  servers many
transition w
  in a
  time 1 h
"#;
    let draft = parse(&Source::new("a.net", text)).unwrap();
    assert_eq!(draft.title.as_deref(), Some("Translates commands"));
    assert_eq!(draft.places[0].tokens, 2);
    assert_eq!(draft.places[0].capacity, Some(5));
    assert_eq!(draft.safe[0][0].weight, 2);
    assert_eq!(draft.safe[1][0].place.text, "c");
    assert_eq!(draft.places[2].data.as_ref().unwrap().text, "path");
    assert_eq!(draft.serves[0].failed.as_ref().unwrap().text, "plan_failed");
    let t = &draft.transitions[0];
    assert_eq!(t.inputs[0].weight, 2);
    assert_eq!(t.outputs[1].net.as_ref().unwrap().text, "other");
    assert!(t.when.as_ref().unwrap().negated);
    assert_eq!(t.within, Some(Duration::from_millis(1500)));
    assert_eq!(t.priority, 7);
    assert_eq!(t.resets.len(), 2);
    assert!(t.idempotent && t.weight < 0.6);
    let timing = Timing::Normal {
        mean: Duration::from_secs(2),
        spread: Duration::from_millis(300),
    };
    assert_eq!(t.timing, timing);
    assert_eq!(t.servers, NonZeroU32::new(2).map(Servers::Limit));
    let quoted = &draft.transitions[2];
    assert_eq!(quoted.name.text, "3 \"x\"");
    let mean = Duration::from_secs(120);
    assert_eq!(quoted.timing, Timing::Exponential { mean });
    assert_eq!(quoted.servers, Some(Servers::Many));
    let hour = Timing::Deterministic(Duration::from_secs(3600));
    assert_eq!(draft.transitions[3].timing, hour);
    assert_eq!(
        parse(&Source::new("b.net", draft.to_string())).unwrap(),
        draft
    );
}

#[test]
fn a_number_below_zero_is_said_to_be_one_where_it_stands() {
    let found = findings("net n\nplace a = -12, b\ntransition t\n  in a*-3\n  out b-\n");
    let starts = [
        "a.net:2:11: error: `-12`: numbers in a net count something, from 0 up",
        "a.net:4:8: error: `-3`: numbers in a net count something, from 0 up",
    ];
    for start in starts {
        assert!(
            found.iter().any(|line| line.starts_with(start)),
            "{found:#?}"
        );
    }
}

#[test]
fn all_mistakes_of_a_text_are_found_at_once_with_their_places() {
    let text = "net n\nplase a\nplace b = x\nplace c ! d\ntransition t\n  in a b\n  wen x\n  do f\n  do g\n  in a*0\n  within 3 years\nout\n";
    let found = findings(text);
    let starts = [
        "a.net:2:1: error: no line of net text begins with `plase` (did you mean `place`?)",
        "a.net:3:11: error: expected the initial tokens, found `x`",
        "a.net:4:9: error: `!` has no meaning in net text",
        "a.net:6:8: error: expected the end of the line, found `b`",
        "a.net:7:3: error: no line of net text begins with `wen` (did you mean `when`?)",
        "a.net:9:3: error: `do`: this transition already has an action",
        "a.net:10:8: error: the arc's weight cannot be 0",
        "a.net:11:12: error: `years` is no unit of time here",
        "a.net:12:4: error: expected a place, found the end of the line",
    ];
    assert_eq!(found.len(), starts.len(), "{found:#?}");
    for (line, start) in found.iter().zip(starts) {
        assert!(
            line.starts_with(start),
            "{line}\nshould start with\n{start}"
        );
    }
}

#[test]
fn a_text_without_a_net_line_says_how_to_begin() {
    let found = findings("place a\n");
    assert!(found[0].contains("names no net") && found[0].contains("begin with"));
}

#[test]
fn a_clause_outside_a_transition_is_refused() {
    let found = findings("net n\ntransition t\n  in a\nplace a\n  out a\n");
    assert!(found[0].starts_with("a.net:5:3: error: `out` belongs to a transition"));
}

#[test]
fn numbers_that_cannot_be_meant_are_refused() {
    for bad in [
        "-2",
        "18446744073709551616",
        "1.5",
        "1000000001",
        "1e3",
        "0x10",
    ] {
        let text = format!("net n\nplace a = {bad}\n");
        assert!(!findings(&text).is_empty(), "{bad}");
    }
}

#[test]
fn windows_line_ends_and_a_missing_last_one_do_not_matter() {
    let draft = parse(&Source::new(
        "a",
        "net n\r\nplace a\r\ntransition t\r\n  in a",
    ))
    .unwrap();
    assert_eq!(draft.transitions[0].inputs[0].place.text, "a");
}

const GRIPPER: &str = "subnet gripper(free, task, tries, limit)
place open = tries, closed
transition close
  in open, free
  send task.close
  out closed
  within limit
transition give_back   # the place of the net around it
  in closed
  out free, open
end
";

fn parsed(text: &str) -> String {
    let draft = parse(&Source::new("a.net", text)).unwrap_or_else(|f| panic!("{f}"));
    draft.to_string()
}

#[test]
fn an_instance_is_the_subnet_with_its_arguments_and_its_name() {
    let text = format!(
        "net n\nplace hand = 1\nuse gripper(hand, left_hand, 2, 3 s) as left\n{GRIPPER}transition t\n  in left.closed*2, hand\n  reset left.open\n  out left.open\n"
    );
    assert_eq!(
        parsed(&text),
        "net n
place hand = 1
place \"left.open\" = 2
place \"left.closed\"
transition \"left.close\"
  in \"left.open\", hand
  send left_hand.close
  out \"left.closed\"
  within 3 s
transition \"left.give_back\"
  in \"left.closed\"
  out hand, \"left.open\"
transition t
  in \"left.closed\"*2, hand
  reset \"left.open\"
  out \"left.open\"
"
    );
}

#[test]
fn subnets_use_each_other_and_stand_in_included_files() {
    let pair = "subnet pair(free)\nuse gripper(free, a, 1, 1 s) as one\nuse gripper(free, b, 1, 1 s) as two\nend\ninclude \"gripper.net\"\n";
    let net = Source::new(
        "n.net",
        "net n\ninclude \"pair.net\"\nplace hand\nuse pair(hand) as p\n",
    );
    let draft = parse_with(&net, &mut |file| match file {
        "pair.net" => Ok(Source::new(file, pair)),
        _ => Ok(Source::new(file, GRIPPER)),
    });
    let names: Vec<String> = draft
        .unwrap()
        .places
        .into_iter()
        .map(|p| p.name.text)
        .collect();
    assert_eq!(
        names,
        [
            "hand",
            "p.one.open",
            "p.one.closed",
            "p.two.open",
            "p.two.closed"
        ]
    );
}

#[test]
fn what_is_wrong_with_subnets_is_told_at_its_place() {
    let one = |rest: &str, start: &str| {
        let found = findings(&format!("net n\nplace p\n{rest}{GRIPPER}"));
        assert!(
            found.len() == 1 && found[0].starts_with(start),
            "{found:#?}\nshould be {start}"
        );
    };
    one(
        "use griper(p, a, 1, 1 s) as g\n",
        "a.net:3:5: error: there is no subnet `griper` (did you mean `gripper`?)",
    );
    one(
        "use gripper(p, a) as g\n",
        "a.net:3:5: error: subnet `gripper` takes 4 arguments, not 2",
    );
    one(
        "use gripper(p, a, 1, 1 s)\n",
        "a.net:3:26: error: expected `as`",
    );
    // An argument that fits nowhere is told where it was given.
    one(
        "use gripper(p, a, x, 1 s) as g\n",
        "a.net:3:19: error: expected the initial tokens, found `x`",
    );
    one(
        "place open\nuse gripper(open, a, 1, 1 s) as g\n",
        "a.net:4:13: error: the subnet has a place `open` of its own",
    );
    one(
        "subnet s\nuse s as t\nend\nuse s as u\n",
        "a.net:4:5: error: subnet `s` uses itself: s uses s",
    );
    one(
        "subnet s\ncommand a -> b\nend\nuse s as u\n",
        "a.net:4:1: error: a subnet has no `command` lines",
    );
    one(
        "subnet s\n",
        "a.net:4:1: error: subnet `s` is not ended yet",
    );
    one("end\n", "a.net:3:1: error: there is no subnet to end here");
    one(
        "subnet gripper\nend\n",
        "a.net:5:8: error: subnet `gripper` is there twice; the first is at a.net:3:8",
    );
    one(
        "subnet s(a, a)\n",
        "a.net:3:13: error: parameter `a` is there twice",
    );
    one(
        "include \"x.net\"\n",
        "a.net:3:9: error: `x.net` cannot be included here",
    );
    assert!(
        findings("net n\nsubnet s\nplace p\n")[0]
            .starts_with("a.net:2:8: error: subnet `s` has no end")
    );
}

#[test]
fn a_subnet_that_no_net_uses_is_read_for_its_mistakes_too() {
    let unused = format!("net n\nplace p\n{GRIPPER}");
    assert!(parse(&Source::new("a.net", unused)).is_ok());
    let text = "net n\nplace p\nsubnet s(a, size, file)
place q = size capacity size
transition t\n  inn a\n  in q, q r\n  out a*size\n  within 3 parsecs\n  do file
coordinator c : x\nuse other(a) as o\nuse another(q) as o
end\nsubnet free\nplace a\nplase b\nend\n";
    let found = findings(text);
    let starts = [
        "a.net:6:3: error: no line of net text begins with `inn` (did you mean `in`?)",
        "a.net:7:",
        "a.net:9:",
        "a.net:11:1: error: a subnet has no `coordinator` lines",
        "a.net:13:5: error: there is no subnet `another`",
        "a.net:17:1: error: no line of net text begins with `plase` (did you mean `place`?)",
    ];
    assert_eq!(found.len(), starts.len(), "{found:#?}");
    for (found, start) in found.iter().zip(starts) {
        assert!(found.starts_with(start), "{found} should be {start}");
    }
}

#[test]
fn files_that_include_each_other_and_subnets_that_multiply_are_refused() {
    let source = Source::new("a.net", "net n\ninclude \"b.net\"\n");
    let found = parse_with(&source, &mut |file| {
        let other = if file == "b.net" { "c.net" } else { "b.net" };
        Ok(Source::new(file, format!("include \"{other}\"\n")))
    })
    .unwrap_err();
    assert!(
        found.to_string().contains("`b.net` includes itself"),
        "{found}"
    );

    let mut text = "net n\nuse s0 as a\n".to_owned();
    for level in 0..30 {
        let next = level + 1;
        text.push_str(&format!(
            "subnet s{level}\nuse s{next} as a\nuse s{next} as b\nend\n"
        ));
    }
    text.push_str("subnet s30\nplace p\nend\n");
    assert!(
        findings(&text)[0].contains("the instances have more than"),
        "not bounded"
    );
}

fn name() -> impl Strategy<Value = Word> {
    let any = prop_oneof![4 => "[a-z_][a-zA-Z0-9_]{0,8}", 1 => "(?s).{1,6}"];
    any.prop_map(|text| Word::from(text.as_str()))
}

fn arc() -> impl Strategy<Value = DraftArc> {
    (name(), option::of(name()), 1_u32..5).prop_map(|(place, net, weight)| DraftArc {
        place,
        net,
        weight,
    })
}

fn an_action() -> impl Strategy<Value = DraftAction> {
    prop_oneof![
        (name(), vec(name(), 0..3), vec(name(), 0..3)).prop_map(|(function, inputs, outputs)| {
            DraftAction::Do {
                function,
                inputs,
                outputs,
            }
        }),
        (name(), name()).prop_map(|(coordinator, request)| DraftAction::Ask {
            coordinator,
            request
        }),
        (name(), name(), vec(name(), 0..3), vec(name(), 0..3)).prop_map(
            |(task, command, inputs, outputs)| DraftAction::Send {
                task,
                command,
                inputs,
                outputs
            }
        ),
        name().prop_map(|line| DraftAction::Request { line }),
        name().prop_map(|line| DraftAction::Log { line }),
        (1_u64..86_400_000_000).prop_map(|micros| DraftAction::Wait {
            time: Duration::from_micros(micros),
            at: Spot(Word::from("wait").at),
        }),
    ]
}

/// Expressions are kept as they are; what is in them is not read here.
fn an_expression() -> impl Strategy<Value = Word> {
    "[a-z]{1,3}(\\.[a-z]{1,3})? [<>=!&|+*/%-]{1,2} ([0-9]{1,3}|\"[a-z# ]{0,3}\"|[a-z] \\? [(]x[)] : -1)"
        .prop_map(|text| Word::from(text.as_str()))
}

fn a_field() -> impl Strategy<Value = DraftField> {
    (name(), name()).prop_map(|(name, kind)| DraftField { name, kind })
}

fn some_data() -> impl Strategy<Value = DraftData> {
    let one = (name(), option::of(an_expression()));
    let shape = prop_oneof![
        one.prop_map(|(kind, initial)| DraftShape::One { kind, initial }),
        vec(a_field(), 1..3).prop_map(DraftShape::Fields),
    ];
    (name(), shape).prop_map(|(name, shape)| DraftData { name, shape })
}

fn a_set() -> impl Strategy<Value = DraftSet> {
    (name(), option::of(name()), an_expression()).prop_map(|(data, field, value)| {
        let target = field.map_or_else(|| data.text.clone(), |field| format!("{data}.{field}"));
        let target = Word::from(target.as_str());
        DraftSet { target, value }
    })
}

fn a_when() -> impl Strategy<Value = DraftWhen> {
    let function = prop_oneof![
        name().prop_map(|name| (name, false)),
        an_expression().prop_map(|text| (text, true)),
    ];
    (function, any::<bool>()).prop_map(|((function, expression), negated)| DraftWhen {
        function,
        negated,
        expression,
    })
}

fn a_time() -> impl Strategy<Value = Duration> {
    (1_u64..360_000_000_000_000).prop_map(Duration::from_micros)
}

fn a_timing() -> impl Strategy<Value = Timing> {
    prop_oneof![
        Just(Timing::Immediate),
        a_time().prop_map(Timing::Deterministic),
        a_time().prop_map(|mean| Timing::Exponential { mean }),
        (a_time(), a_time()).prop_map(|(mean, spread)| Timing::Normal { mean, spread }),
    ]
}

fn some_servers() -> impl Strategy<Value = Servers> {
    prop_oneof![
        Just(Servers::Many),
        (1_u32..9).prop_map(|most| NonZeroU32::new(most).map_or(Servers::ONE, Servers::Limit)),
    ]
}

prop_compose! {
    fn a_transition()(
        (name, tape, write) in (name(), option::of(name()), option::of(name())),
        (inputs, reads, inhibitors) in (vec(arc(), 0..4), vec(arc(), 0..2), vec(arc(), 0..2)),
        (outputs, fail) in (vec(arc(), 0..4), vec(arc(), 0..2)),
        when in option::of(a_when()),
        (action, sets) in (option::of(an_action()), vec(a_set(), 0..3)),
        priority in 0_u32..4,
        within in option::of(1_u64..86_400_000_000),
        (resets, idempotent) in (vec(name(), 0..3), any::<bool>()),
        (timing, servers) in (a_timing(), option::of(some_servers())),
        weight in prop_oneof![Just(1.0), 1.0e-9..1.0e9],
    ) -> DraftTransition {
        DraftTransition {
            name,
            inputs,
            reads,
            inhibitors,
            resets,
            tape,
            when,
            action,
            sets,
            outputs,
            fail,
            write,
            priority,
            within: within.map(Duration::from_micros),
            timing,
            weight,
            servers,
            idempotent,
        }
    }
}

prop_compose! {
    pub(crate) fn a_draft()(
        name in name(),
        title in option::of("(?s).{0,20}"),
        places in vec((name(), 0_u32..4, option::of(1_u32..9), option::of(name())), 0..5),
        safe in vec(vec(arc(), 1..3), 0..3),
        data in vec(some_data(), 0..3),
        commands in vec((name(), vec(a_field(), 0..3), vec(name(), 1..3)), 0..3),
        coordinators in vec((name(), vec(name(), 1..3)), 0..3),
        serves in vec((name(), vec(name(), 1..3), name(), option::of(name())), 0..2),
        transitions in vec(a_transition(), 0..5),
    ) -> Draft {
        Draft {
            name,
            title,
            places: places
                .into_iter()
                .map(|(name, tokens, capacity, data)| DraftPlace {
                    name,
                    tokens,
                    capacity,
                    data,
                })
                .collect(),
            commands: commands
                .into_iter()
                .map(|(symbol, parameters, answers)| DraftCommand {
                    symbol,
                    parameters,
                    answers,
                })
                .collect(),
            coordinators: coordinators
                .into_iter()
                .map(|(net, requests)| DraftCoordinator { net, requests })
                .collect(),
            serves: serves
                .into_iter()
                .map(|(net, requests, done, failed)| DraftServes {
                    net,
                    requests,
                    done,
                    failed,
                })
                .collect(),
            safe,
            data,
            transitions,
        }
    }
}

proptest! {
    #[test]
    fn what_is_printed_parses_to_the_same_net(draft in a_draft()) {
        let text = draft.to_string();
        prop_assert_eq!(parse(&Source::new("printed", text)).unwrap(), draft);
    }

    #[test]
    fn no_text_makes_the_parser_panic(text in "\\PC*") {
        let _ = parse(&Source::new("any", text));
    }

    #[test]
    fn no_mixture_of_keywords_makes_parser_or_compiler_panic(
        words in vec(prop::sample::select(vec![
            "net ", "place ", "command ", "coordinator ", "serves ", "transition ", "in ", "read ",
            "inhibit ", "tape ", "when ", "not ", "do ", "ask ", "send ", "out ", "fail ", "write ",
            "priority ", "within ", "a", "b", ", ", "*2", "@", ": ", "; ", "done ", "failed ", "-> ",
            "(", ")", ".", "= 1", "subnet ", "end ", "use ", "as ", "include ", "3 s",
            "data ", "set ", "request ", "log ", "wait ", "{", "}", " : int", "\"$a\"", "a + 1", "a < 2", "\n", "\n", "\n", "\"", "#", "ä",
        ]), 0..60),
    ) {
        let text = format!("net n\n{}", words.concat());
        let _ = crate::compile::net(&Source::new("any", text));
    }
}
