//! The execution of a net without the runtime: state and event in, state and effects out, and nothing else.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may end when its net is wrong"
)]

use std::{fs, path::Path, sync::Arc};

use ctos::diagnostic::Source;
use pnt_language::{
    compile,
    exec::{Execution, Written},
    net::Net,
};

const CELL: &str = "net cell
place free = 1, asked, there
command fetch -> fetched, lost
transition begin
  in free
  tape fetch
  out asked
transition go
  in asked
  do walk
  within 2 s
  out there, tray@press
  fail there
transition end
  in there
  out free
  write fetched
";

/// What comes from outside.
enum Comes {
    Command,
    /// Whatever is enabled is fired or started, in order.
    Turn,
    /// The oldest action ends, well or not.
    Ends(bool),
    /// It is so late now, ns.
    Time(u64),
}

/// What a net wants to be done, in words.
fn step(cell: &mut Execution, comes: &Comes) -> Vec<String> {
    let mut effects = Vec::new();
    match comes {
        Comes::Command => {
            cell.put_symbol("fetch", vec!["bolt".to_owned()]).unwrap();
        }
        Comes::Turn => loop {
            let first = cell.enabled().next();
            let Some(id) = first else { break };
            let transition = &cell.net()[id];
            let name = transition.name.clone();
            if transition.action.is_some() {
                let firing = cell.start(id).unwrap();
                effects.push(format!("begin {name} {}", firing.number()));
            } else if let Some(Written::Answer { command, symbol }) = cell.fire(id).unwrap().written
            {
                effects.push(format!("answer {command} {symbol}"));
            }
        },
        Comes::Ends(well) => {
            let (firing, _) = cell.running().next().unwrap();
            let ended = if *well {
                cell.complete(firing)
            } else {
                cell.fail(firing)
            };
            let sent = ended.unwrap().remote.iter();
            effects.extend(sent.map(|arc| format!("send {} to {}", arc.place, arc.net)));
        }
        Comes::Time(now) => {
            cell.advance_to(*now);
            if let Some((firing, _, _)) = cell.expire().unwrap() {
                effects.push(format!("end {}", firing.number()));
            }
        }
    }
    effects
}

#[test]
fn a_net_runs_without_the_runtime_from_states_and_events_alone() {
    let net: Net = compile::net(&Source::new("cell.net", CELL)).unwrap_or_else(|f| panic!("{f}"));
    let net = Arc::new(net);
    let events: [(Comes, &[&str]); 12] = [
        (Comes::Command, &[]),
        (Comes::Turn, &["begin go 0"]),
        (Comes::Ends(true), &["send tray to press"]),
        (Comes::Command, &[]),
        (Comes::Turn, &["answer 0 fetched", "begin go 1"]),
        (Comes::Ends(false), &[]),
        (Comes::Turn, &["answer 1 fetched"]),
        (Comes::Command, &[]),
        (Comes::Turn, &["begin go 2"]),
        // Begun when it was 0: two seconds are its deadline.
        (Comes::Time(1_999_999_999), &[]),
        (Comes::Time(2_000_000_000), &["end 2"]),
        (Comes::Turn, &["answer 2 fetched"]),
    ];
    let mut cell = Execution::new(Arc::clone(&net));
    for (at, (comes, wanted)) in events.iter().enumerate() {
        assert_eq!(step(&mut cell, comes), *wanted, "event {at}");
        // The state is all there is to it: it goes through bytes between any two events.
        let now = cell.now_ns();
        let bytes = postcard::to_stdvec(&cell.state()).unwrap();
        let state = postcard::from_bytes(&bytes).unwrap();
        let restored = Execution::restore(Arc::clone(&net), state).unwrap();
        assert_eq!(restored.marking(), cell.marking());
        assert_eq!(restored.tape(), cell.tape());
        assert!(restored.running().eq(cell.running()));
        assert_eq!(cell.now_ns(), now);
    }
    assert_eq!(cell.marking(), [1, 0, 0]);
}

/// All code of a folder that is not of tests.
fn code(folder: &Path, into: &mut Vec<(String, String)>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.display().to_string();
        if name.contains("tests") {
            continue;
        }
        if path.is_dir() {
            code(&path, into);
        } else {
            into.push((name, fs::read_to_string(&path).unwrap()));
        }
    }
}

#[test]
fn the_execution_names_no_task_no_clock_no_file_and_no_socket() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    code(&source.join("exec"), &mut files);
    let root = source.join("exec.rs");
    files.push((
        root.display().to_string(),
        fs::read_to_string(&root).unwrap(),
    ));
    assert!(files.len() > 10, "{files:?}");
    let outside = [
        "ctos::",
        "tokio",
        "tracing",
        "std::fs",
        "std::io",
        "std::net",
        "std::thread",
        "std::process",
        "Instant",
        "SystemTime",
        "crate::task",
        "crate::store",
        "crate::library",
        "crate::stream",
    ];
    for (name, text) in files {
        let code = text
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"));
        for line in code {
            for word in outside {
                assert!(!line.contains(word), "{name} knows `{word}`: {line}");
            }
        }
    }
}
