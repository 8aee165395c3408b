//! Watching in one process; over links it is tested with the daemon.

use super::*;
use crate::{Alone, Dictionary, Sorm, demo};
use futures_util::FutureExt as _;
use proptest::prelude::*;

fn sorm() -> Sorm {
    let mut dictionary = Dictionary::new();
    let source = ctos::diagnostic::Source::new("demo", demo::DICTIONARY);
    dictionary.load(&source).unwrap();
    let sorm = Sorm::new(dictionary);
    demo::register(&sorm);
    sorm
}

fn ask(sorm: &Sorm, line: &str) -> Transport {
    let reply = sorm.tell(&Alone, line, "").now_or_never().unwrap();
    let reply: Reply = reply.parse().unwrap();
    assert!(reply.body.is_ok(), "{reply:?}");
    reply.body
}

fn seen(sorm: &Sorm, watch: &str) -> Vec<Seen> {
    let body = ask(sorm, &format!("{watch} EXEC next"));
    let lines = body.text.lines();
    lines
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn a_watcher_sees_what_it_wants_and_nothing_else() {
    let sorm = sorm();
    ask(&sorm, "foo.a EXEC");
    ask(&sorm, "watch.all CTRL -dump");
    ask(&sorm, "watch.foo CTRL -objects foo.* -method CTRL");
    ask(&sorm, "foo.a EXEC");
    ask(&sorm, "foo.b CTRL -dump");
    ask(&sorm, "dict CTRL -list");
    let all: Vec<String> = seen(&sorm, "watch.all")
        .into_iter()
        .map(|seen| format!("{} {}", seen.object, seen.method))
        .collect();
    assert_eq!(all, ["foo.a EXEC", "foo.b CTRL", "dict CTRL"]);
    let own = seen(&sorm, "watch.foo");
    assert_eq!(own.len(), 1);
    assert_eq!(own[0].request, "foo.b CTRL TMSG -dump");
    let reply: Reply = own[0].reply.parse().unwrap();
    assert!(reply.body.text.starts_with("-"), "{reply:?}");
    assert_eq!(seen(&sorm, "watch.all"), []);
    ask(&sorm, "sorm CTRL -free watch.all -free watch.foo");
    ask(&sorm, "foo.a EXEC");
    assert_eq!(sorm.watchers().count.load(Ordering::Relaxed), 0);
}

#[test]
fn a_watcher_that_was_built_sees_nothing_before_it_is_told_what() {
    let sorm = sorm();
    sorm.get("watch.late").unwrap();
    ask(&sorm, "dict CTRL -list");
    ask(&sorm, "watch.late CTRL -objects foo.*");
    ask(&sorm, "foo.a EXEC");
    assert_eq!(seen(&sorm, "watch.late").len(), 1);
}

#[test]
fn nested_calls_have_the_number_of_the_request_that_they_belong_to() {
    let sorm = sorm();
    ask(&sorm, "foo.a CTRL -drink bar");
    ask(&sorm, "watch.t CTRL -trace 7");
    let mut request: Request = "foo.a EXEC".parse().unwrap();
    request.body.trace = Trace { id: 7, depth: 0 };
    let _ = sorm.ask(&Alone, request).now_or_never().unwrap();
    ask(&sorm, "foo.a EXEC");
    let seen = seen(&sorm, "watch.t");
    let nested: Vec<(u32, &str)> = seen
        .iter()
        .map(|seen| (seen.depth, seen.object.as_str()))
        .collect();
    assert_eq!(nested, [(1, "bar"), (0, "foo.a")]);
    assert!(seen.iter().all(|seen| seen.trace == 7));
}

#[test]
fn a_watcher_that_does_not_fetch_loses_the_oldest_and_is_told_how_many() {
    let sorm = sorm();
    ask(&sorm, "watch.few CTRL -capacity 3 -objects foo*");
    for _ in 0..10 {
        ask(&sorm, "foo.a EXEC");
    }
    let body = ask(&sorm, "watch.few EXEC next");
    assert_eq!(body.ints, [3, 7]);
    assert_eq!(ask(&sorm, "watch.few EXEC next").ints, [0, 0]);
}

#[test]
fn an_error_and_a_panic_are_seen_with_their_reports() {
    let sorm = sorm();
    ask(&sorm, "watch.bad CTRL -failed");
    ask(&sorm, "foo.a EXEC");
    let wrong = sorm.dispatch("foo.a CTRL -nonsense");
    let seen = seen(&sorm, "watch.bad");
    assert_eq!(seen.len(), 1);
    assert_eq!(seen[0].reply, wrong);
    assert_ne!(seen[0].code, 0);
}

#[test]
fn what_is_long_is_cut_and_says_so() {
    let long = Transport {
        text: "é".repeat(10_000),
        floats: vec![0.5; 1000],
        opaque: vec![0; 5].into(),
        ..Transport::default()
    };
    let text = request_text("foo.a", Method::Exec, &long);
    let request: Request = text.parse().unwrap();
    assert_eq!(request.body.floats.len(), MOST_NUMBERS);
    assert!(request.body.text.len() <= MOST_TEXT + 3);
    let told = &request.body.reports[0].text;
    assert_eq!(told, "936 floats not shown, 5 opaque bytes not shown");
}

proptest! {
    #[test]
    fn a_pattern_fits_what_it_was_made_of(parts in prop::collection::vec("[a-c.]{0,3}", 1..5), fill in "[a-c.]{0,4}") {
        let pattern = parts.join("*");
        let name = parts.join(&fill);
        prop_assert!(matches(&pattern, &name), "{} {}", pattern, name);
        let more = format!("{}x", name);
        prop_assert_eq!(matches(&pattern, &more), pattern.ends_with('*'));
    }

    #[test]
    fn a_pattern_without_stars_is_the_name(pattern in "[a-c]{0,4}", name in "[a-c]{0,4}") {
        prop_assert_eq!(matches(&pattern, &name), pattern == name);
    }
}
