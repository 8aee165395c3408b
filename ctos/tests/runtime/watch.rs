//! Lints on apps: in virtual time, and one whose handler never returns in real time.

use std::{path::Path, sync::Arc, time::Duration};

use ctos::{
    boot::{End, Observer, simulate},
    config::load_texts,
    message::{Command, Message},
    record::{Filter, Record},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};

ctos::command! {
    /// Takes its time.
    struct Work { ms: u64 } => (), 1, "work"
}

struct Worker;

impl EventHandler for Worker {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Work::CODE => {
                let (Work { ms }, reply) = message.open::<Work>()?;
                cx.sleep(Duration::from_millis(ms)).await;
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

/// Gives the worker what its arguments say.
struct Giver;

#[derive(serde::Deserialize, Clone)]
#[serde(deny_unknown_fields)]
struct GiverArgs {
    /// Messages, one each so many ms, and how long each takes, ms.
    count: u64,
    every_ms: u64,
    ms: u64,
}

impl EventHandler for Giver {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let args: GiverArgs = cx.args()?;
            cx.spawn(give(cx.clone(), args));
        }
        Ok(())
    }
}

async fn give(cx: Context, args: GiverArgs) {
    let worker = cx.task("worker").await.unwrap();
    for _ in 0..args.count {
        let work = Work { ms: args.ms };
        cx.send(&worker, work)
            .deadline(Duration::from_secs(1000))
            .await
            .unwrap();
        cx.sleep(Duration::from_millis(args.every_ms)).await;
    }
    // The last that is asked is answered last.
    let work = Work { ms: 0 };
    cx.call(&worker, work)
        .deadline(Duration::from_secs(1000))
        .await
        .unwrap();
    cx.sleep(Duration::from_secs(2)).await;
    cx.finish(AppResult {
        ok: true,
        text: String::new(),
        json: "{}".to_owned(),
    });
}

/// Runs the app; returns the lints in its record: when, whether it began, code, task.
fn lints(folder: &Path, giver: &str, worker: &str) -> Vec<(f64, bool, String, String)> {
    let text = format!(
        "[time]\nmode = \"virtual\"\n[record]\nfile = \"run.mcap\"\n[chassis.a]\n[chassis.b]\n\
         [task.worker]\nhandler = \"worker\"\non = \"a\"\nqueue = 20\n{worker}\n\
         [task.giver]\nhandler = \"giver\"\non = \"b\"\nargs = {giver}\n"
    );
    let file = folder.join("app.toml");
    let app = load_texts(&[(file.to_str().unwrap(), &text)], &[], &[])
        .unwrap_or_else(|findings| panic!("{:?}", findings.into_sorted()));
    let mut registry = Registry::new();
    registry.handler("worker", &[Work::INFO], |_| Ok(Worker));
    registry.handler("giver", &[], |_| Ok(Giver));
    let observer: Observer = Arc::new(|_| ());
    let outcome = simulate(app, registry, &[], &observer).unwrap();
    assert!(matches!(outcome.end, End::Finished(_)), "{:?}", outcome.end);
    let filter = Filter {
        topics: vec!["/lint".to_owned()],
        ..Filter::default()
    };
    let record = Record::read(&[folder.join("run.mcap")], &filter).unwrap();
    let lints = record.entries.iter().map(|entry| {
        let json: serde_json::Value = serde_json::from_slice(&entry.json).unwrap();
        let text = |key: &str| json[key].as_str().unwrap().to_owned();
        let at = entry.at.since_start().as_secs_f64();
        (
            at,
            json["present"].as_bool().unwrap(),
            text("code"),
            text("task"),
        )
    });
    lints.collect()
}

#[test]
fn a_handler_that_waits_for_too_long_is_told_once_and_once_when_it_is_over() {
    let folder = tempfile::tempdir().unwrap();
    let told = lints(
        folder.path(),
        "{ count = 2, every_ms = 10_000, ms = 4_000 }",
        "handler_limit_s = 1.5",
    );
    let words: Vec<_> = told
        .iter()
        .map(|(_, began, code, task)| (*began, code.as_str(), task.as_str()))
        .collect();
    let (begins, ends) = (
        (true, "handler-waits", "worker"),
        (false, "handler-waits", "worker"),
    );
    assert_eq!(words, [begins, ends, begins, ends]);
    assert!((1.4..2.6).contains(&told[0].0), "{told:?}");
    assert!((3.9..5.1).contains(&told[1].0), "{told:?}");
}

#[test]
fn an_app_that_does_what_it_should_is_told_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let told = lints(
        folder.path(),
        "{ count = 20, every_ms = 1_000, ms = 900 }",
        "",
    );
    assert_eq!(told, []);
}

#[test]
fn a_queue_that_grows_is_told_until_it_is_half_empty_again() {
    let folder = tempfile::tempdir().unwrap();
    let told = lints(
        folder.path(),
        "{ count = 30, every_ms = 250, ms = 1_000 }",
        "",
    );
    let words: Vec<_> = told
        .iter()
        .map(|(_, began, code, task)| (*began, code.as_str(), task.as_str()))
        .collect();
    assert_eq!(
        words,
        [
            (true, "queue-grows", "worker"),
            (false, "queue-grows", "worker")
        ]
    );
}

/// Takes the only permit when its time has come, and keeps it for a while.
struct Holds;

#[derive(serde::Deserialize, Clone)]
#[serde(deny_unknown_fields)]
struct HoldsArgs {
    after_ms: u64,
    keeps_ms: u64,
    ends: bool,
}

impl EventHandler for Holds {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let args: HoldsArgs = cx.args()?;
            let child = cx.clone();
            cx.spawn(async move {
                child.sleep(Duration::from_millis(args.after_ms)).await;
                let gate = child.semaphore("gate", 1).unwrap();
                let permit = gate.acquire().deadline(Duration::from_secs(100)).await;
                child.sleep(Duration::from_millis(args.keeps_ms)).await;
                drop(permit);
                if args.ends {
                    child.sleep(Duration::from_secs(2)).await;
                    child.finish(AppResult {
                        ok: true,
                        text: String::new(),
                        json: "{}".to_owned(),
                    });
                }
            });
        }
        Ok(())
    }
}

#[test]
fn a_permit_that_is_held_for_long_is_told_while_somebody_waits_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[time]\nmode = \"virtual\"\n[record]\nfile = \"run.mcap\"\n[chassis.a]\n[chassis.b]\n\
        [task.hog]\nhandler = \"holds\"\non = \"a\"\nargs = { after_ms = 0, keeps_ms = 20_000, ends = false }\n\
        [task.late]\nhandler = \"holds\"\non = \"a\"\nargs = { after_ms = 14_000, keeps_ms = 11_000, ends = true }\n";
    let file = folder.path().join("app.toml");
    let app = load_texts(&[(file.to_str().unwrap(), text)], &[], &[])
        .unwrap_or_else(|findings| panic!("{:?}", findings.into_sorted()));
    let mut registry = Registry::new();
    registry.handler("holds", &[], |_| Ok(Holds));
    let observer: Observer = Arc::new(|_| ());
    let outcome = simulate(app, registry, &[], &observer).unwrap();
    assert!(matches!(outcome.end, End::Finished(_)), "{:?}", outcome.end);
    let filter = Filter {
        topics: vec!["/lint".to_owned()],
        ..Filter::default()
    };
    let record = Record::read(&[folder.path().join("run.mcap")], &filter).unwrap();
    let told: Vec<String> = record
        .entries
        .iter()
        .map(|entry| String::from_utf8(entry.json.clone()).unwrap())
        .collect();
    // Nobody waits before 14 s, and nobody waits while `late` holds it.
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(
        told[0].contains("\"present\":true") && told[0].contains("`hog` has held semaphore `gate`"),
        "{told:?}"
    );
    assert!(told[0].contains("`late` waits"), "{told:?}");
    let at = record.entries[0].at.since_start().as_secs_f64();
    assert!((13.9..15.0).contains(&at), "{at}");
    assert!(told[1].contains("\"present\":false"), "{told:?}");
}
