//! Recording and replaying apps, in virtual time.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use ctos::{
    boot::{End, Observer, simulate},
    config::{App, load_texts},
    message::{Command, Message, Replier},
    record::{ChannelSchema, Filter, Record, replay},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use rand::RngExt;
use serde::{Deserialize, Serialize};

ctos::command! {
    /// Adds to the sum, and tells it.
    struct Add { number: u32, name: String } => u64, 1, "add"
}
ctos::command! {
    /// Is answered a while later.
    struct Later { wait_ms: u64 } => u64, 2, "later"
}
ctos::command! {
    /// Needs no answer.
    struct Note { text: String } => (), 3, "note"
}

/// Adds up what it is told; refuses what is 13; answers `later` from a child.
struct Adder {
    sum: u64,
    factor: u64,
    kept: Vec<Replier<Note>>,
}

impl EventHandler for Adder {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Add::CODE => {
                let (Add { number, .. }, reply) = message.open::<Add>()?;
                if number == 13 {
                    return reply.fail("13 brings bad luck");
                }
                if number == 666 {
                    panic!("this number is the beast's");
                }
                self.sum += u64::from(number) * self.factor;
                reply.ok(self.sum)
            }
            Later::CODE => {
                let (Later { wait_ms }, reply) = message.open::<Later>()?;
                let child = cx.clone();
                let sum = self.sum;
                cx.spawn(async move {
                    child.sleep(Duration::from_millis(wait_ms)).await;
                    let _ = reply.ok(sum);
                });
                Ok(())
            }
            Note::CODE => {
                let (_, reply) = message.open::<Note>()?;
                self.kept.push(reply);
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

#[derive(Deserialize, Clone)]
#[serde(deny_unknown_fields)]
struct AskerArgs {
    rounds: u32,
    ends: bool,
    /// What a changed handler does otherwise.
    #[serde(default)]
    changed: bool,
}

/// A schema of the task's own.
fn raw() -> Arc<ChannelSchema> {
    Arc::new(ChannelSchema {
        name: "test.Raw".into(),
        language: "text".into(),
        text: b"four bytes, the least first".as_slice().into(),
        encoding: "raw".into(),
    })
}

#[derive(Serialize)]
struct Drawn {
    number: u32,
}

/// Asks the adder for sums of random numbers, at random moments.
struct Asker(AskerArgs);

impl EventHandler for Asker {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            cx.spawn(ask(cx.clone(), self.0.clone()));
        }
        Ok(())
    }
}

async fn ask(cx: Context, args: AskerArgs) {
    let adder = cx.task("adder").await.unwrap();
    let mut rng = cx.rng("numbers");
    let mut text = String::new();
    for round in 0..args.rounds {
        let number = rng.random_range(0..20_u32);
        cx.record("drawn", &Drawn { number });
        cx.record_encoded("raw", &raw(), &number.to_le_bytes());
        let add = Add {
            number,
            name: cx.name().to_owned(),
        };
        let sum = cx.call(&adder, add).await;
        text = format!("{sum:?}");
        cx.sleep(Duration::from_micros(rng.random_range(0..5000)))
            .await;
        if round % 3 == 0 {
            let later = Later { wait_ms: 2 };
            // Too short for the answer, now and then.
            let deadline = Duration::from_millis(rng.random_range(1..4));
            text = format!("{:?}", cx.call(&adder, later).deadline(deadline).await);
        }
        if round % 4 == 1 {
            let text = if args.changed && round > 4 {
                "bye"
            } else {
                "hello"
            };
            let note = Note {
                text: text.to_owned(),
            };
            cx.send(&adder, note).high_priority().await.unwrap();
        }
        tracing::info!(task = cx.name(), round, "asked");
    }
    if args.ends {
        cx.finish(AppResult {
            ok: true,
            text,
            json: "{}".to_owned(),
        });
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AdderArgs {
    factor: u64,
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    let commands = [Add::INFO, Later::INFO, Note::INFO];
    registry.handler("adder", &commands, |cx| {
        let AdderArgs { factor } = cx.args()?;
        Ok(Adder {
            sum: 0,
            factor,
            kept: Vec::new(),
        })
    });
    registry.handler("asker", &[], |cx| Ok(Asker(cx.args()?)));
    registry
}

const APP: &str = r#"
[time]
mode = "virtual"
[app]
until = "one"
[chassis.a.processors.p1]
[chassis.a.processors.p2]
[chassis.b]
[task.adder]
handler = "adder"
on = "a/p1"
restart = "always"
args.factor = 1
[task.one]
handler = "asker"
on = "b"
args = { rounds = 12, ends = true }
[task.two]
handler = "asker"
on = "a/p2"
args = { rounds = 7, ends = false }
[task.three]
handler = "asker"
on = "a/p1"
args = { rounds = 9, ends = false }
"#;

fn app(folder: &Path, sets: &[&str]) -> App {
    let file = folder.join("app.toml");
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    load_texts(&[(file.to_str().unwrap(), APP)], &sets, &[])
        .unwrap_or_else(|findings| panic!("{:?}", findings.into_sorted()))
}

/// Runs the app and returns its record.
fn recorded(folder: &Path, name: &str, seed: u64) -> PathBuf {
    let (file, seed) = (format!("record.file={name:?}"), format!("seed={seed}"));
    let observer: Observer = Arc::new(|_| ());
    let outcome = simulate(app(folder, &[&file, &seed]), registry(), &[], &observer).unwrap();
    assert!(matches!(outcome.end, End::Finished(_)), "{:?}", outcome.end);
    folder.join(name)
}

fn read(path: &Path) -> Record {
    Record::read(&[path.to_owned()], &Filter::default()).unwrap()
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let folder = tempfile::tempdir().unwrap();
    let record = |name: &str, seed| std::fs::read(recorded(folder.path(), name, seed)).unwrap();
    let first = record("1.mcap", 5);
    assert!(first == record("2.mcap", 5), "one seed, two records");
    assert!(first != record("3.mcap", 6), "two seeds, one record");
}

#[test]
fn everything_that_happens_is_in_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let record = read(&recorded(folder.path(), "run.mcap", 1));
    let run = &record.runs[0];
    assert_eq!((run.torn.as_deref(), run.lost), (None, 0));
    assert_eq!(run.noted.get("seed").map(String::as_str), Some("1"));
    let lines = |topic: &str| run.channels.get(topic).map_or(0, |(lines, _)| *lines);
    assert_eq!(lines("/drawn"), 12 + 7 + 9);
    // What is begun is ended; what is sent over a link is noted on both its sides.
    assert_eq!(lines("/began/adder"), lines("/ended/adder"));
    assert!(lines("/message/adder") > lines("/began/adder"));
    assert_eq!(
        lines("/phase"),
        4 * 4 + 6,
        "four tasks and six of the runtime are built"
    );
    let message = record
        .entries
        .iter()
        .find(|entry| {
            entry.channel.topic == "/message/adder"
                && entry.json.windows(5).any(|w| w == b"\"add\"")
        })
        .unwrap();
    let json: serde_json::Value = serde_json::from_slice(&message.json).unwrap();
    assert_eq!(json["command"], "add");
    assert_eq!(json["waits"], "reply");
    assert!(json["data"]["number"].as_u64().unwrap() < 20, "{json}");
    assert_eq!(message.channel.schema(), "ctos.Message");
}

#[test]
fn what_a_task_encodes_itself_comes_out_as_it_went_in_under_its_schema_also_from_a_copy() {
    let folder = tempfile::tempdir().unwrap();
    let record = read(&recorded(folder.path(), "run.mcap", 1));
    let copy = folder.path().join("copy.mcap");
    record.write(&copy).unwrap();
    for record in [record, read(&copy)] {
        let on = |topic: &'static str| {
            let entries = record.entries.iter();
            entries.filter(move |entry| entry.channel.topic == topic)
        };
        let numbers = on("/raw").map(|entry| {
            let channel = &entry.channel;
            assert_eq!((channel.schema(), channel.encoding()), ("test.Raw", "raw"));
            u64::from(u32::from_le_bytes(entry.json[..].try_into().unwrap()))
        });
        let drawn = on("/drawn").map(|entry| {
            let line: serde_json::Value = serde_json::from_slice(&entry.json).unwrap();
            line["number"].as_u64().unwrap()
        });
        assert!(numbers.eq(drawn));
        assert_eq!(on("/raw").count(), 12 + 7 + 9);
    }
}

fn replayed(
    folder: &Path,
    record: &Record,
    task: &str,
    sets: &[&str],
) -> ctos::record::ReplayReport {
    replay(app(folder, sets), registry(), task, record).unwrap()
}

#[test]
fn every_task_does_the_same_again_whatever_the_seed() {
    let folder = tempfile::tempdir().unwrap();
    for seed in 0..64 {
        let path = recorded(folder.path(), &format!("{seed}.mcap"), seed);
        let record = read(&path);
        for task in ["adder", "one", "two", "three"] {
            let report = replayed(folder.path(), &record, task, &[]);
            assert!(report.is_same(), "seed {seed}: {report}");
            assert!(
                report.messages >= 4 && report.same > 12,
                "seed {seed}: {report}"
            );
        }
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn a_changed_handler_is_caught() {
    let folder = tempfile::tempdir().unwrap();
    let record = read(&recorded(folder.path(), "run.mcap", 3));
    let report = replayed(
        folder.path(),
        &record,
        "adder",
        &["task.adder.args.factor=2"],
    );
    let first = report.first.as_ref().unwrap();
    assert!(first.expected.contains("answer to `add`"), "{report}");
    let report = replayed(
        folder.path(),
        &record,
        "one",
        &["task.one.args.changed=true"],
    );
    let first = report.first.as_ref().unwrap();
    assert!(
        first
            .expected
            .contains(r#"send `note` to `adder` (urgent) {"text":"hello"}"#),
        "{report}"
    );
    assert!(first.got.contains(r#"{"text":"bye"}"#), "{report}");
    assert_eq!(
        report.different, 2,
        "two of its notes are others, all else is the same: {report}"
    );
}

/// Answers, counts and reads in an order that timers and the seed draw, and keeps what it read.
struct Reader {
    lines: std::rc::Rc<std::cell::RefCell<Vec<String>>>,
}

thread_local! {
    /// What the host has, which no message tells; a simulated app has one thread.
    static HOST: std::cell::Cell<u64> = const { std::cell::Cell::new(0) };
}

fn host() -> u64 {
    HOST.replace(HOST.get() + 1)
}

impl EventHandler for Reader {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let adder = cx.task("adder").await?;
        for child in 0..6_u32 {
            let (own, lines, adder) = (cx.clone(), self.lines.clone(), adder.clone());
            cx.spawn(async move {
                for round in 0..5 {
                    own.sleep(Duration::from_millis(1)).await;
                    let read = own.outside("the host", host);
                    let waited = own.outside_wait("a device", async { host() }).await;
                    let now = own.now().as_nanos();
                    lines
                        .borrow_mut()
                        .push(format!("{child} {round} {read} {waited} {now}"));
                    // What all children did so far: another order is another message.
                    let text = lines.borrow().join(", ");
                    let _ = own.try_send(&adder, Note { text: text.clone() });
                    let _ = own.send(&adder, Note { text }).await;
                }
            });
        }
        Ok(())
    }
}

/// Shares memory with `other`, if it has one.
struct Sharing(Vec<String>);

impl EventHandler for Sharing {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, _: Phase) -> Handled {
        for key in &self.0 {
            if cx.shared::<u32>(key).is_none() {
                cx.share(key, Arc::new(7_u32));
            }
        }
        Ok(())
    }
}

const READERS: &str = r#"
[time]
mode = "virtual"
[app]
until = "one"
[chassis.a.processors.p1]
[chassis.a.processors.p2]
[chassis.b]
[task.adder]
handler = "adder"
on = "a/p1"
args.factor = 1
[task.one]
handler = "asker"
on = "b"
args = { rounds = 12, ends = true }
[task.reader]
handler = "reader"
on = "b"
[task.alone]
handler = "sharing"
on = "b"
args.keys = ["own"]
[task.left]
handler = "sharing"
on = "a/p1"
args.keys = ["left's", "between"]
[task.right]
handler = "sharing"
on = "a/p2"
args.keys = ["between"]
"#;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SharingArgs {
    keys: Vec<String>,
}

fn readers(folder: &Path, sets: &[String]) -> (App, Registry) {
    let mut registry = registry();
    registry.handler("reader", &[], |_| {
        let lines = std::rc::Rc::default();
        Ok(Reader { lines })
    });
    registry.handler("sharing", &[], |cx| {
        Ok(Sharing(cx.args::<SharingArgs>()?.keys))
    });
    let file = folder.join("app.toml");
    let app = load_texts(&[(file.to_str().unwrap(), READERS)], sets, &[]);
    let app = app.unwrap_or_else(|findings| panic!("{:?}", findings.into_sorted()));
    (app, registry)
}

fn record_of_readers(folder: &Path, seed: u64, faults: &str) -> Record {
    use ctos::simulation::{Faults, Setup, run};
    let sets = [
        format!("seed={seed}"),
        "record.file=\"run.mcap\"".to_owned(),
    ];
    let (app, registry) = readers(folder, &sets);
    let faults = Faults::built_in(faults).unwrap();
    let setup = Setup {
        faults,
        ..Setup::default()
    };
    let observer: Observer = Arc::new(|_| ());
    run(app, registry, setup, &observer).unwrap();
    let path = folder.join("run.mcap");
    let record = read(&path);
    std::fs::remove_file(path).unwrap();
    record
}

#[test]
fn children_have_their_turns_as_they_had_them_and_read_what_they_had_read() {
    let folder = tempfile::tempdir().unwrap();
    for seed in 0..16 {
        let record = record_of_readers(folder.path(), seed, "none");
        let before = host();
        let (app, registry) = readers(folder.path(), &[]);
        let report = replay(app, registry, "reader", &record).unwrap();
        assert!(
            report.is_same() && report.same > 60,
            "seed {seed}: {report}"
        );
        assert_eq!(host(), before + 1, "a replay reads nothing of the host");
    }
}

#[test]
fn a_record_made_while_clocks_were_wrong_and_links_bad_is_replayed() {
    let folder = tempfile::tempdir().unwrap();
    for faults in ["light", "rough"] {
        for seed in 0..8 {
            let record = record_of_readers(folder.path(), seed, faults);
            for task in ["reader", "one", "adder"] {
                let (app, registry) = readers(folder.path(), &[]);
                match replay(app, registry, task, &record) {
                    Ok(report) => assert!(report.is_same(), "{faults} {seed}: {report}"),
                    Err(error) => assert!(
                        error.to_string().contains("its chassis restarted"),
                        "{faults} {seed}: {error}"
                    ),
                }
            }
        }
    }
}

#[test]
fn who_shares_memory_with_another_task_is_refused_at_once_and_who_has_it_alone_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let record = record_of_readers(folder.path(), 1, "none");
    let again = |task: &str| {
        let (app, registry) = readers(folder.path(), &[]);
        replay(app, registry, task, &record)
    };
    assert!(again("alone").unwrap().is_same());
    for task in ["left", "right"] {
        let why = again(task).unwrap_err().to_string();
        assert!(
            why.contains(&format!(
                "`{task}` cannot be replayed: it uses shared memory `between`"
            )),
            "{why}"
        );
    }
}
