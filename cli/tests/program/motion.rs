//! `ctos motion` at a running calibration whose arm stands: line by line, without colours, and on a terminal.

use std::{
    io::{BufRead, BufReader, Read, Write},
    process::Stdio,
};

use crate::running::{App, command};
use serde_json::Value;

const CTOS: &str = env!("CARGO_BIN_EXE_ctos");

fn boot() -> App {
    App::boot(
        "configs/calibrate.toml",
        &[
            "--break",
            "dispatcher.init_calib",
            "--set",
            "task.dispatcher.args.allow_control=true",
        ],
    )
}

/// What a command says that ends.
fn said(app: &App, arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = command(CTOS, app.folder.path()).args(arguments).output();
    let output = output.unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[test]
fn the_manipulators_of_an_app_are_shown_once_again_and_again_and_by_name() {
    let app = boot();
    let (code, out, _) = said(&app, &["motion", "--once"]);
    assert_eq!(code, Some(0));
    for part in [
        "calibrate · up",
        "mcs · cold · held by nobody",
        "joint1",
        "mrad",
        "N m",
    ] {
        assert!(out.contains(part), "{part}: {out}");
    }
    assert!(!out.contains('\u{1b}'), "{out}");
    let mut looks = command(CTOS, app.folder.path());
    let looks = looks.args(["motion", "mcs", "--json", "--interval", "0.1"]);
    let mut looks = looks.stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(looks.stdout.take().unwrap()).lines();
    let told: Vec<Value> = lines
        .take(3)
        .map(|line| serde_json::from_str(&line.unwrap()).unwrap())
        .collect();
    // Nobody reads what it says any more.
    assert!(looks.wait().unwrap().success());
    let ticks = |value: &Value| value["manipulators"][0]["ticks"].as_u64().unwrap();
    assert!(ticks(&told[0]) < ticks(&told[2]));
    let mcs = &told[2]["manipulators"][0];
    assert_eq!(
        (&mcs["state"], &mcs["owner"]),
        (&"cold".into(), &Value::Null)
    );
    assert_eq!(mcs["joints"].as_array().unwrap().len(), 6);
    let (code, _, err) = said(&app, &["motion", "mca"]);
    assert_eq!(code, Some(4));
    assert!(err.contains("did you mean `mcs`?"), "{err}");
}

#[test]
fn on_a_terminal_it_refreshes_and_leaves_that_in_order_on_ctrl_c() {
    let app = boot();
    // `script` of util-linux runs it on a terminal, types there what comes in, and shows what that shows.
    let line = format!("stty rows 30 cols 100; '{CTOS}' motion; stty -a");
    let mut terminal = command("script", app.folder.path());
    let terminal = terminal
        .args(["-qec", &line, "/dev/null"])
        .env("TERM", "xterm")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped());
    let mut terminal = terminal.spawn().expect("`script` of util-linux is there");
    let mut out = terminal.stdout.take().unwrap();
    let mut shown = String::new();
    let mut read = |shown: &mut String| {
        let mut some = [0; 4096];
        let count = out.read(&mut some).unwrap();
        shown.push_str(&String::from_utf8_lossy(&some[..count]));
        count
    };
    while !(shown.contains("nobody") && shown.contains("arrows scroll")) {
        assert!(read(&mut shown) > 0, "{shown}");
    }
    assert!(shown.contains("\u{1b}[?1049h"), "{shown}");
    // A later look has other numbers.
    let before = shown.len();
    while shown.len() == before {
        assert!(read(&mut shown) > 0, "{shown}");
    }
    let mut keys = terminal.stdin.take().unwrap();
    keys.write_all(b"\x03").unwrap();
    keys.flush().unwrap();
    while read(&mut shown) > 0 {}
    assert!(terminal.wait().unwrap().success(), "{shown}");
    let (_, after) = shown
        .rsplit_once("\u{1b}[?1049l")
        .expect("the screen is left");
    assert!(after.contains("\u{1b}[?25h") || shown.contains("\u{1b}[?25h"));
    let words: Vec<&str> = after.split_whitespace().collect();
    for word in ["icanon", "echo", "isig"] {
        assert!(words.contains(&word), "{word}: {after}");
    }
    // Nothing is coloured where colours are not wanted.
    assert!(!shown.contains("\u{1b}[31m") && !shown.contains("38;5;1m"));
}
