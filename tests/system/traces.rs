//! A trace leads from a message to the handler that took it and to the firings of a net that it caused.
//! From there it leads to the messages that these sent. Followed through the record of a calibration in
//! virtual time.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::harness::{Scratch, VIRTUAL};

const NETS: [&str; 3] = ["dispatcher", "motion", "vision"];

/// Commands from here on are the runtime's own.
const SYSTEM_COMMANDS: u64 = 0xff00;

struct Line {
    at_s: f64,
    topic: String,
    line: Value,
}

impl Line {
    fn text(&self, key: &str) -> &str {
        self.line[key].as_str().unwrap_or("")
    }
}

fn recorded() -> Vec<Line> {
    let scratch = Scratch::short();
    let file = scratch.path("run.mcap");
    let record = ["--record", file.to_str().unwrap()];
    scratch.boot(&[&VIRTUAL[..], &record].concat()).must_exit(0);
    let cat = ["log", "cat", "--json", file.to_str().unwrap()];
    let topics = [
        "--topic",
        "/message/*",
        "--topic",
        "/began/*",
        "--topic",
        "/firing/*",
    ];
    let ended = scratch.ctos(&[&cat[..], &topics].concat());
    let lines = ended.must_exit(0).json_lines().into_iter();
    lines
        .map(|line| Line {
            at_s: line["at_s"].as_f64().unwrap(),
            topic: line["topic"].as_str().unwrap().to_owned(),
            line: line["line"].clone(),
        })
        .collect()
}

#[test]
fn a_trace_leads_from_a_message_to_its_handler_to_the_firing_and_to_what_that_sends() {
    let lines = recorded();
    every_firing_has_the_trace_of_a_message_and_gives_it_to_what_it_sends(&lines);
    one_trace_leads_from_the_operator_to_the_arm_and_the_cameras(&lines);
}

fn every_firing_has_the_trace_of_a_message_and_gives_it_to_what_it_sends(lines: &[Line]) {
    for net in NETS {
        let (message, began) = (format!("/message/{net}"), format!("/began/{net}"));
        // When each trace first came to the net, and when its handler took it up.
        let first = |topic: &str| {
            let mut first = BTreeMap::new();
            for line in lines.iter().filter(|line| line.topic == topic) {
                first.entry(line.text("trace")).or_insert(line.at_s);
            }
            first
        };
        let (came, taken) = (first(&message), first(&began));
        let mut fired: BTreeSet<&str> = BTreeSet::new();
        let topic = format!("/firing/{net}");
        // No message causes the end of the app.
        let led_to = |line: &&Line| line.topic == topic && line.text("phase") != "stopped";
        for firing in lines.iter().filter(led_to) {
            let trace = firing.text("trace");
            let what = format!("{net}: {}", firing.line);
            assert!(!trace.is_empty(), "no trace: {what}");
            assert!(
                came.get(trace).is_some_and(|at| *at <= firing.at_s),
                "{what}"
            );
            assert!(
                taken.get(trace).is_some_and(|at| *at <= firing.at_s),
                "{what}"
            );
            fired.insert(trace);
        }
        assert!(!fired.is_empty(), "{net} fired nothing");
        let mut sent = 0;
        for line in lines
            .iter()
            .filter(|line| line.topic.starts_with("/message/"))
        {
            let own = line.line["code"].as_u64().unwrap() < SYSTEM_COMMANDS;
            if own && line.text("from") == net {
                let trace = line.text("trace");
                assert!(
                    fired.contains(trace),
                    "{net} sent this outside any firing: {}",
                    line.line
                );
                sent += 1;
            }
        }
        assert!(sent > 10, "{net} sent {sent} messages");
    }
}

fn one_trace_leads_from_the_operator_to_the_arm_and_the_cameras(lines: &[Line]) {
    let mut commands = lines
        .iter()
        .filter(|line| line.topic == "/message/dispatcher" && line.text("from") == "operator");
    let command = commands.next_back().unwrap();
    assert_eq!(command.text("command"), "put_once", "{}", command.line);
    let of_trace: Vec<&Line> = lines
        .iter()
        .filter(|line| line.text("trace") == command.text("trace"))
        .collect();
    for net in NETS {
        let topic = format!("/firing/{net}");
        let fired = of_trace.iter().any(|line| line.topic == topic);
        assert!(fired, "{net} fired nothing of the operator's command");
    }
    for (from, to) in [
        ("dispatcher", "motion"),
        ("dispatcher", "vision"),
        ("motion", "mcs"),
    ] {
        let topic = format!("/message/{to}");
        let sent = |line: &&&Line| line.topic == topic && line.text("from") == from;
        let sent = of_trace.iter().filter(sent).count();
        assert!(sent > 0, "{from} sent nothing to {to}");
    }
}
