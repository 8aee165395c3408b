//! Displays without a browser: of running nets, of records, of records that break off, and of files that
//! are about another net.

use std::fs;

use crate::{
    harness::{Ended, MISBEHAVING, Run, Scratch},
    nets::{app, ctos},
};

fn start<'s>(scratch: &'s Scratch, more: &[&str]) -> Run<'s> {
    scratch.start(MISBEHAVING, &[&["boot", "app.toml"], more].concat(), &[])
}

/// What `ctos display --json` says of a net.
fn shown(ended: &Ended, net: &str) -> serde_json::Value {
    ended.must_exit_leaving(0);
    let mut lines = ended.json_lines().into_iter();
    let found = lines.find(|line| line["net"] == net);
    found.unwrap_or_else(|| panic!("{}", ended.told))
}

/// Tokens that a net has or has taken for an action.
fn tokens(shown: &serde_json::Value) -> u64 {
    let places = shown["places"].as_object().unwrap().values();
    places.map(|tokens| tokens.as_u64().unwrap()).sum()
}

#[test]
fn a_record_is_shown_also_when_it_breaks_off_and_one_that_is_none_is_refused() {
    let scratch = Scratch::empty();
    app(&scratch, "allow_control = true");
    let mut run = start(&scratch, &["--record", "run.mcap"]);
    run.wait_for("phase 3");
    ctos(&scratch, &["net", "pause", "b"]).must_exit_leaving(0);
    ctos(&scratch, &["net", "put", "b", "mid", "3"]).must_exit_leaving(0);
    let live = ctos(&scratch, &["display", "--json", "--net", "b"]);
    let live = shown(&live, "b");
    // With the name of the user of the command.
    let paused = live["paused"].as_str().unwrap_or_default();
    assert!(
        paused.starts_with("by hand (") && paused.ends_with(')'),
        "{live}"
    );
    assert!(tokens(&live) >= 3, "{live}");
    ctos(&scratch, &["display", "--once", "--net", "nobody"]).must_exit_leaving(4);
    ctos(&scratch, &["net", "take", "b", "mid", "3"]).must_exit_leaving(0);
    ctos(&scratch, &["net", "resume", "b"]).must_exit_leaving(0);
    scratch.write("enough", "");
    run.end().must_exit(0);

    let whole = ctos(&scratch, &["display", "run.on_b.mcap", "--json"]);
    let whole = shown(&whole, "b");
    let export = ["display", "run.on_b.mcap", "--export", "run.html"];
    ctos(&scratch, &export).must_exit(0);
    let page = scratch.read("run.html");
    assert!(page.contains("\"kind\":\"net\"") && !page.contains("src=\""));
    let drawn = ctos(&scratch, &["net", "draw", "run.on_b.mcap"]);
    assert!(
        drawn.must_exit(0).stdout.starts_with("<svg"),
        "{}",
        drawn.told
    );

    // Cut off anywhere, it is shown as far as it goes, or nothing is shown; it is always said.
    let bytes = fs::read(scratch.path("run.on_b.mcap")).unwrap();
    for part in [9, 6, 3] {
        scratch.write("cut.mcap", &bytes[..bytes.len() * part / 10]);
        let cut = ctos(&scratch, &["display", "cut.mcap", "--json"]);
        cut.must_say("cut.mcap breaks off");
        assert!(matches!(cut.code, Some(0 | 1)), "{}", cut.told);
        if cut.code == Some(0) {
            let cut = shown(&cut, "b");
            assert!(
                cut["seq"].as_u64() <= whole["seq"].as_u64(),
                "{cut} {whole}"
            );
        }
    }
    scratch.write("none.mcap", "this is no record");
    ctos(&scratch, &["display", "none.mcap", "--once"])
        .must_exit(3)
        .must_say("none.mcap");

    // Displays that name what no net has are told; what there is is shown.
    scratch.write(
        "displays.toml",
        "[display.some]\nshow = [\"b/pass\", \"b/typo\", \"nobody/*\"]\n",
    );
    let export = [&export[..], &["--displays", "displays.toml"]].concat();
    ctos(&scratch, &export)
        .must_exit(0)
        .must_say("some: b/typo")
        .must_say("some: nobody/*");
    assert!(scratch.read("run.html").contains("\"name\":\"some\""));
}

#[test]
fn a_layout_of_another_net_and_breakpoints_of_another_net_are_told_and_stop_nothing() {
    let scratch = Scratch::empty();
    app(&scratch, "allow_control = true");
    scratch.write("b.layout.toml", "[node]\nfar = { x = 1, y = 1 }\n");
    scratch.write("b.breaks.toml", "breakpoints = [\"gone\", \"mid>=100\"]\n");
    ctos(&scratch, &["check", "app.toml"])
        .must_exit(0)
        .must_say("net `b` has no node `far` to draw there")
        .must_say("b.breaks.toml:1:")
        .must_say("has no transition `gone`");
    let mut run = start(&scratch, &[]);
    run.wait_for("phase 3");
    let marking = ctos(&scratch, &["net", "marking", "b", "--json"]).json();
    assert_eq!(marking["breakpoints"], serde_json::json!(["mid>=100"]));
    scratch.write("enough", "");
    run.end().must_exit(0);
}

#[test]
fn a_breakpoint_that_was_set_by_hand_is_armed_before_the_first_firing_of_the_next_run() {
    let scratch = Scratch::empty();
    app(&scratch, "allow_control = true");
    let mut run = start(&scratch, &[]);
    run.wait_for("phase 3");
    ctos(&scratch, &["net", "break", "b", "pass"]).must_exit_leaving(0);
    scratch.write("enough", "");
    run.end().must_exit(0);
    assert!(scratch.read("b.breaks.toml").contains("\"pass\""));

    fs::remove_file(scratch.path("enough")).unwrap();
    let mut run = start(&scratch, &[]);
    run.wait_for("breakpoint `pass`");
    let marking = ctos(&scratch, &["net", "marking", "b", "--json"]).json();
    assert_eq!(marking["paused"], "breakpoint `pass`");
    assert_eq!(marking["firings"], 0, "{marking}");
    ctos(&scratch, &["net", "break", "b", "--clear"]).must_exit_leaving(0);
    ctos(&scratch, &["net", "resume", "b"]).must_exit_leaving(0);
    assert!(!scratch.path("b.breaks.toml").exists());
    scratch.write("enough", "");
    run.end().must_exit(0);
}
