//! Tokens between nets of one processor, which are put there at once, beside the same nets on two processors, between
//! which they are messages. In virtual time, over many seeds: the nets are told to do so there too.

use ctos::{
    record::{Filter, Record},
    simulation::Faults,
    system::Statistics,
};

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

/// Registers a net that puts tokens into nets on its processor.
fn register(registry: &mut Registry, text: &str, library: fn() -> Library<()>) {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    let name = net.name().to_owned();
    registry.handler(&name, &COMMANDS, move |cx| {
        let task = NetTask::new(cx, net.clone(), library(), Conflicts::Declared, None);
        task.engine.puts_beside.set(true);
        Ok(task)
    });
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    register(&mut registry, A, || Library::new(()));
    register(&mut registry, B, || Library::new(()));
    register_script(&mut registry, |cx| async move {
        let to = cx.task("a").await?;
        let put = PutTape {
            symbol: "start".to_owned(),
            arguments: Vec::new(),
        };
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
fn tokens_are_the_same_wherever_the_other_net_is_and_no_messages_on_the_same_processor() {
    for seed in 0..20 {
        let (held, beside) = ran("one/main", seed, &[]);
        assert_eq!(held, THERE, "seed {seed}");
        for b_on in ["one/other", "two/main"] {
            let (held, handled) = ran(b_on, seed, &[]);
            assert_eq!(held, THERE, "{b_on}, seed {seed}");
            assert!(beside < handled, "{beside} and {handled} messages");
        }
    }
}

#[test]
fn while_a_run_is_recorded_tokens_on_one_processor_are_messages_and_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.mcap");
    let set = format!("record.file={:?}", file.display().to_string());
    let (held, handled) = ran("one/main", 1, &[set]);
    assert_eq!(held, THERE);
    assert!(handled > ran("one/main", 1, &[]).1);
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
    let mut registry = registry();
    let text = B
        .replace("  in one\n", "  in one\n  when sane\n")
        .replace("net b", "net b_bad");
    register(&mut registry, &text, || {
        Library::new(()).enabling("sane", |()| panic!("not so"))
    });
    let app = app("one/main", 1, &["task.b.handler=\"b_bad\"".to_owned()]);
    let ended = simulate(app, registry, Faults::none()).0;
    let error = ended.unwrap_err();
    assert!(error.contains('b') && error.contains("not so"), "{error}");
    assert!(!error.contains("task `a`"), "{error}");
}

/// Whoever runs a seed again to record it must see the same run.
#[test]
fn in_virtual_time_tokens_are_messages_unless_a_net_is_told_otherwise() {
    let mut plain = registry();
    register_net(&mut plain, A, || Library::new(()));
    register_net(&mut plain, B, || Library::new(()));
    let app = app("one/main", 1, &[]);
    let text = simulate(app, plain, Faults::none()).0.unwrap();
    let handled: u64 = text.rsplit_once('\n').unwrap().1.parse().unwrap();
    assert!(handled > ran("one/main", 1, &[]).1);
}
