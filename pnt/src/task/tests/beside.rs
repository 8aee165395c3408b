//! Tokens between nets of one processor, which are put there at once, beside the same nets on two processors, between
//! which they are messages. In virtual time, over many seeds: the nets are told to do so there too.

use ctos::{
    bench::take_turns_to_be_brief,
    record::{Filter, Record},
    simulation::Faults,
    system::Statistics,
};

use futures_util::{FutureExt as _, future::join};

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

/// Whether a net that got tokens has its turn within that of the net that sent them.
#[derive(Debug, Clone, Copy, PartialEq)]
enum GoesOn {
    Later,
    AtOnce,
}

const WAYS: [GoesOn; 2] = [GoesOn::Later, GoesOn::AtOnce];

/// Registers a net that puts tokens into nets on its processor.
fn register(registry: &mut Registry, text: &str, goes_on: GoesOn, library: fn() -> Library<()>) {
    let net = compile::net(&Source::new("test.net", text)).unwrap_or_else(|f| panic!("{f}"));
    let name = net.name().to_owned();
    registry.handler(&name, &COMMANDS, move |cx| {
        let task = NetTask::new(cx, net.clone(), library(), Conflicts::Declared, None);
        task.engine.puts_beside.set(true);
        if goes_on == GoesOn::AtOnce {
            take_turns_to_be_brief(cx);
        }
        Ok(task)
    });
}

fn registry(goes_on: GoesOn) -> Registry {
    let mut registry = Registry::new();
    register(&mut registry, A, goes_on, || Library::new(()));
    register(&mut registry, B, goes_on, || Library::new(()));
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
    ran_so(GoesOn::Later, b_on, seed, sets)
}

fn ran_so(goes_on: GoesOn, b_on: &str, seed: u64, sets: &[String]) -> (String, u64) {
    let ran = simulate(app(b_on, seed, sets), registry(goes_on), Faults::none()).0;
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
        let at_once = ran_so(GoesOn::AtOnce, "one/main", seed, &[]);
        assert_eq!(at_once, (held, beside), "seed {seed}");
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
    let (held, handled) = ran_so(GoesOn::AtOnce, "one/main", 1, &[set]);
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
    for goes_on in WAYS {
        let mut registry = registry(goes_on);
        let text = B
            .replace("  in one\n", "  in one\n  when sane\n")
            .replace("net b", "net b_bad");
        register(&mut registry, &text, goes_on, || {
            Library::new(()).enabling("sane", |()| panic!("not so"))
        });
        let app = app("one/main", 1, &["task.b.handler=\"b_bad\"".to_owned()]);
        let ended = simulate(app, registry, Faults::none()).0;
        let error = ended.unwrap_err();
        assert!(error.contains('b') && error.contains("not so"), "{error}");
        assert!(!error.contains("task `a`"), "{error}");
    }
}

/// Whoever runs a seed again to record it must see the same run.
#[test]
fn in_virtual_time_tokens_are_messages_unless_a_net_is_told_otherwise() {
    let mut plain = registry(GoesOn::Later);
    register_net(&mut plain, A, || Library::new(()));
    register_net(&mut plain, B, || Library::new(()));
    let app = app("one/main", 1, &[]);
    let text = simulate(app, plain, Faults::none()).0.unwrap();
    let handled: u64 = text.rsplit_once('\n').unwrap().1.parse().unwrap();
    assert!(handled > ran("one/main", 1, &[]).1);
}

/// A command that is answered when a ball has gone to the other net and back so many times.
const PING: &str = "net a
place ready = 1, going, rounds, ball
command start -> started
transition begin
  in ready
  tape start
  out going, rounds*MANY
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

fn ping_pong(rounds: u32, goes_on: GoesOn) -> Registry {
    let mut registry = Registry::new();
    let ping = PING.replace("MANY", &rounds.to_string());
    register(&mut registry, &ping, goes_on, || Library::new(()));
    register(&mut registry, PONG, goes_on, || Library::new(()));
    registry
}

/// The operator is on the processor of the nets.
fn beside_the_operator() -> [String; 1] {
    ["task.operator.on=\"one/main\"".to_owned()]
}

#[test]
fn a_command_whose_tokens_go_there_and_back_is_answered_within_the_turn_of_its_caller() {
    for goes_on in WAYS {
        let mut registry = ping_pong(8, goes_on);
        register_script(&mut registry, |cx| async move {
            let to = cx.task("a").await?;
            let mut at_once = Vec::new();
            // Those of the first command find no children yet.
            for _ in 0..2 {
                let mut call = cx.call(&to, symbol("start")).into_future();
                let answer = (&mut call).now_or_never();
                at_once.push(answer.is_some());
                if answer.is_none() {
                    call.await?;
                }
            }
            Ok(format!("{at_once:?}"))
        });
        let app = app("one/main", 1, &beside_the_operator());
        let text = simulate(app, registry, Faults::none()).0;
        let expected = match goes_on {
            GoesOn::Later => "[false, false]",
            GoesOn::AtOnce => "[false, true]",
        };
        assert_eq!(text.unwrap(), expected);
    }
}

#[test]
fn tokens_that_go_to_and_fro_all_the_time_leave_others_on_their_processor_their_turns() {
    const MANY: u32 = 20_000;
    for goes_on in WAYS {
        let mut registry = ping_pong(MANY, goes_on);
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
        let app = app("one/main", 1, &beside_the_operator());
        let text = simulate(app, registry, Faults::none()).0.unwrap();
        assert_eq!(text, "seen soon: true, 40002 [], 20000 []", "{goes_on:?}");
    }
}
