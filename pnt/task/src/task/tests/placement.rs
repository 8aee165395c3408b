//! The same nets on one processor, on two, and on two chassis, over many seeds: tokens move alike everywhere.

use ctos::{
    record::{Filter, Record},
    simulation::Faults,
    system::Statistics,
};

use futures_util::future::join;

use super::{
    survival::{insist, register_script, simulate},
    *,
};

/// Tokens go to `b` in twos and come back one by one; a command goes through a tape of the other net.
const A: &str = "net a
place src = 40, back
transition send
  in src
  out mid@b*2, one@b
transition take
  in back
  out kept
place kept
command start -> started
transition answer
  in kept*80
  tape start
  write started
";
const B: &str = "net b
place mid, one
transition pass
  in mid
  out back@a
transition note
  in one
  out noted
place noted
";

fn registry() -> Registry {
    let mut registry = Registry::new();
    register_net(&mut registry, A, || Library::new(()));
    register_net(&mut registry, B, || Library::new(()));
    register_script(&mut registry, |cx| async move {
        let to = cx.task("a").await?;
        let put = symbol("start");
        cx.call(&to, put).deadline(Duration::from_secs(60)).await?;
        let mut lines = Vec::new();
        for net in ["a", "b"] {
            let now = insist(&cx, net, Marking {}).await?;
            let places = now.places.iter();
            let places = places.map(|(name, tokens)| format!("{name} {tokens}"));
            lines.push(places.collect::<Vec<_>>().join(" "));
            lines.push(format!("{:?} {}", now.sending, now.firings));
        }
        let b = cx.task("b").await?;
        let handled = cx.call(&b, Statistics {}).await?.handled;
        lines.push(handled.to_string());
        Ok(lines.join("\n"))
    });
    registry
}

fn symbol(symbol: &str) -> PutTape {
    PutTape {
        symbol: symbol.to_owned(),
        arguments: Vec::new(),
    }
}

fn app(b_on: &str, seed: u64, sets: &[String]) -> App {
    let text = format!(
        "[app]\nname = \"t\"\nuntil = \"operator\"\nseed = {seed}\n[time]\nmode = \"virtual\"\n[chassis.one]\nprocessors.main = {{}}\nprocessors.other = {{}}\n[chassis.two]\nprocessors.main = {{}}\n[task.operator]\nhandler = \"operator\"\non = \"two/main\"\n[task.a]\nhandler = \"a\"\non = \"one/main\"\n[task.b]\nhandler = \"b\"\non = \"{b_on}\"\n"
    );
    config::load_texts(&[("app.toml", &text)], sets, &[]).unwrap_or_else(|f| panic!("{f}"))
}

/// What the nets hold in the end, and how many messages came to `b`.
fn ran(b_on: &str, seed: u64, sets: &[String]) -> (String, u64) {
    let ran = simulate(app(b_on, seed, sets), registry(), Faults::none()).0;
    let text = ran.unwrap_or_else(|error| panic!("{b_on}, seed {seed}: {error}"));
    let (held, handled) = text.rsplit_once('\n').unwrap();
    (held.to_owned(), handled.parse().unwrap())
}

const THERE: &str = "src 0 back 0 kept 0\n[] 121\nmid 0 one 0 noted 40\n[] 120";

#[test]
fn tokens_are_the_same_wherever_the_other_net_is() {
    for seed in 0..20 {
        for b_on in ["one/main", "one/other", "two/main"] {
            let (held, _) = ran(b_on, seed, &[]);
            assert_eq!(held, THERE, "{b_on}, seed {seed}");
        }
    }
}

#[test]
fn a_recorder_changes_nothing_and_the_record_holds_the_tokens() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.mcap");
    let set = format!("record.file={:?}", file.display().to_string());
    let recorded = ran("one/main", 1, &[set]);
    assert_eq!(recorded, ran("one/main", 1, &[]));
    let filter = Filter {
        topics: vec!["/message/b".to_owned()],
        ..Filter::default()
    };
    let record = Record::read(&[file], &filter).unwrap();
    let mut lines = record
        .entries
        .iter()
        .map(|entry| String::from_utf8_lossy(&entry.json));
    assert!(
        lines.any(|line| line.contains("\"tokens\"")),
        "the record lacks what `a` sent to `b`"
    );
}

#[test]
fn a_net_that_dies_of_a_token_fails_itself_and_not_the_net_that_sent_it() {
    const BAD: &str = "net b_bad
place mid, one
transition pass
  in mid
  out back@a
transition note
  in one
  when sane
  out noted
place noted
";
    let mut registry = registry();
    register_net(&mut registry, BAD, || {
        Library::new(()).enabling("sane", |()| panic!("not so"))
    });
    let app = app("one/main", 1, &["task.b.handler=\"b_bad\"".to_owned()]);
    let ended = simulate(app, registry, Faults::none()).0;
    let error = ended.unwrap_err();
    assert!(error.contains('b') && error.contains("not so"), "{error}");
    assert!(!error.contains("task `a`"), "{error}");
}

/// A command that is answered when a ball has gone to the other net and back 20,000 times.
const PING: &str = "net a
place ready = 1, going, rounds, ball
command start -> started
transition begin
  in ready
  tape start
  out going, rounds*20000
transition serve
  in going, rounds
  out ball@b
transition again
  in ball
  out going
transition end
  in going
  inhibit rounds
  write started
  out ready
";
const PONG: &str = "net b
place ball
transition back
  in ball
  out ball@a
";

#[test]
fn tokens_that_go_to_and_fro_all_the_time_leave_others_on_their_processor_their_polls() {
    let mut registry = Registry::new();
    register_net(&mut registry, PING, || Library::new(()));
    register_net(&mut registry, PONG, || Library::new(()));
    register_script(&mut registry, |cx| async move {
        let (a, b) = (cx.task("a").await?, cx.task("b").await?);
        let command = cx.call(&a, symbol("start"));
        let meanwhile = async {
            let there = cx.call(&b, Marking {}).await?.firings;
            let here = cx.call(&a, Marking {}).await?.firings;
            Ok::<_, HandlerError>([there, here])
        };
        let (answer, seen) = join(command.into_future(), meanwhile).await;
        answer?;
        let [there, here] = seen?;
        let soon = 0 < here && here < 1_000 && there < 1_000;
        let mut lines = vec![format!("seen soon: {soon}")];
        for net in [&a, &b] {
            let now = cx.call(net, Marking {}).await?;
            lines.push(format!("{} {:?}", now.firings, now.sending));
        }
        Ok(lines.join(", "))
    });
    let local_operator = ["task.operator.on=\"one/main\"".to_owned()];
    let app = app("one/main", 1, &local_operator);
    let text = simulate(app, registry, Faults::none()).0.unwrap();
    assert_eq!(text, "seen soon: true, 40002 [], 20000 []");
}
