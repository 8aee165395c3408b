//! A whole app, its defaults, expanders, and arbitrary text.

mod bundle;
mod keys;
mod load;
mod node;
mod processors;
mod profiles;
mod refused;
mod variables;
mod zenoh;

use super::*;
use crate::diagnostic::{Finding, Findings, Source};
use crate::settings::{Policy, When};
use proptest::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

const CELL: &str = r#"[app]
until = "operator"

[chassis.ws1]

[chassis.cage_motion]
stop_first = true
processors.servo = { realtime = true, priority = 80, cpu = 1 }
processors.main = {}

[task.operator]
handler = "cell.operator"
on = "ws1"

[task.mcs]
handler = "mcs.client"
on = "cage_motion/main"
queue = 16
restart = "always"
call_deadline_s = 2.5

[task.mcs.args]
speed = 0.5
"#;

fn load_one(text: &str) -> Result<App, Findings> {
    load_texts(&[("app.toml", text)], &[], &[])
}

fn load_set(text: &str, sets: &[&str]) -> Result<App, Findings> {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    load_texts(&[("app.toml", text)], &sets, &[])
}

/// The findings of an app that must be refused, each in its one-line form, sorted by place.
fn refused(result: Result<App, Findings>) -> Vec<String> {
    let findings = result.expect_err("this app must be refused");
    findings
        .into_sorted()
        .iter()
        .map(ToString::to_string)
        .collect()
}

/// The minimal app with one line of a table replaced, and the finding expected for it.
fn refused_line(table: &str, line: &str, expected: &str) {
    let text = format!("[chassis.ws1]\n[task.a]\nhandler = \"h\"\non = \"ws1\"\n{table}\n{line}\n");
    let lines = refused(load_one(&text));
    assert_eq!(lines, [expected.to_owned()], "for {table} {line}");
}

#[test]
fn a_whole_app_is_read_in_declared_order_with_its_places() {
    let app = load_one(CELL).unwrap();
    assert!(app.warnings.is_empty(), "{}", app.warnings);
    assert_eq!(app.name, "app");
    assert_eq!(app.until.as_deref(), Some("operator"));
    let names: Vec<_> = app.chassis.iter().map(|one| one.name.as_str()).collect();
    assert_eq!(names, ["ws1", "cage_motion"]);
    let motion = &app.chassis[1];
    assert!(motion.stop_first);
    let servo = &motion.processors[0];
    assert_eq!(
        (
            servo.name.as_str(),
            servo.realtime,
            servo.priority,
            servo.cpu
        ),
        ("servo", true, Some(80), Some(1))
    );
    assert_eq!(motion.processors[1].name, "main");
    let mcs = app.task("mcs").unwrap();
    assert_eq!(
        (mcs.chassis.as_str(), mcs.processor.as_str()),
        ("cage_motion", "main")
    );
    let always = Policy {
        when: When::Always,
        ..Policy::default()
    };
    assert_eq!(mcs.restart, always);
    assert_eq!(mcs.call_deadline, Some(Duration::from_millis(2500)));
    assert_eq!(mcs.queue, 16);
    assert_eq!(mcs.args.get("speed").and_then(Node::as_f64), Some(0.5));
    assert_eq!(mcs.place.to_string(), "app.toml:15:7");
    assert_eq!(mcs.handler_place.to_string(), "app.toml:16:11");
    assert_eq!(mcs.on_place.to_string(), "app.toml:17:6");
    let speed = app.locate("task.mcs.args.speed").unwrap();
    assert_eq!(speed.to_string(), "app.toml:23:1");
    assert_eq!(app.locate("task.mcs.args.speeed"), None);
}

#[test]
fn a_chassis_without_processors_has_one_called_main_and_a_task_without_one_takes_the_first() {
    let app = load_one(CELL).unwrap();
    assert_eq!(app.chassis[0].processors[0].name, "main");
    assert_eq!(app.task("operator").unwrap().processor, "main");
    let first = load_set(CELL, &["task.mcs.on=cage_motion"]).unwrap();
    assert_eq!(first.task("mcs").unwrap().processor, "servo");
}

#[test]
fn the_defaults_file_says_what_an_app_gets_that_says_nothing() {
    let written = load_texts(
        &[("minimal.toml", DEFAULTS)],
        &["app.name=x".to_owned()],
        &[],
    )
    .unwrap();
    let minimal = "[chassis.NAME]\n[task.NAME]\nhandler = \"HANDLER\"\non = \"NAME\"\n";
    let implied = load_texts(
        &[("minimal.toml", minimal)],
        &["app.name=x".to_owned()],
        &[],
    )
    .unwrap();
    // The host that stands there as an example has no chassis; all else is meant.
    let found = written.warnings.clone().into_sorted();
    let meant = |finding: &crate::diagnostic::Finding| finding.code == "ctos::config::idle_host";
    assert!(found.iter().all(meant) && implied.warnings.is_empty());
    assert_eq!(summary(&written), summary(&implied));
}

/// Everything typed in an app but its places.
fn summary(app: &App) -> String {
    let chassis = app.chassis.iter().map(|one| {
        let processors = one.processors.iter().map(|processor| {
            let ProcessorConfig {
                name,
                realtime,
                required,
                priority,
                cpu,
                period,
                overrun,
                spin,
                place: _,
            } = processor;
            format!(
                "{name} {realtime} {required} {priority:?} {cpu:?} {period:?} {overrun:?} {spin:?}"
            )
        });
        let processors: Vec<_> = processors.collect();
        format!(
            "{} {:?} {} {processors:?}",
            one.name, one.listen, one.stop_first
        )
    });
    let tasks = app.tasks.iter().map(|task| {
        format!(
            "{} {} {}/{} {} {:?} {:?} {}",
            task.name,
            task.handler,
            task.chassis,
            task.processor,
            task.queue,
            task.restart,
            task.call_deadline,
            task.args.entries().len()
        )
    });
    let lines: Vec<_> = chassis.chain(tasks).collect();
    format!(
        "{} {} {:?} {:?} {:?} {:?} {lines:#?}",
        app.name, app.seed, app.until, app.phase_timeout, app.stop_timeout, app.time
    )
}

#[test]
fn every_key_of_the_reference_page_and_of_the_defaults_is_the_same_key() {
    let page = include_str!("../../../docs/configuration.md");
    for line in DEFAULTS.lines() {
        let line = line.trim_start_matches("# ");
        let Some((key, _)) = line.split_once(" = ") else {
            continue;
        };
        if key
            .chars()
            .all(|letter| letter.is_ascii_lowercase() || letter == '_')
        {
            assert!(
                page.contains(&format!("`{key}`")),
                "`{key}` is not on the page"
            );
        }
    }
}

/// An expander as `vss` has one: a task for each name in a list.
struct Services;

impl Expander for Services {
    fn expand(&self, table: &Node, findings: &mut Findings) -> Vec<GeneratedTask> {
        let mut tasks = Vec::new();
        for element in table.get("services").map_or(&[][..], Node::elements) {
            let (Some(name), Some(place)) = (element.as_str(), element.place()) else {
                continue;
            };
            if name == "bad" {
                findings.push(Finding::error("t", "no such service").at(place.clone()));
            }
            tasks.push(GeneratedTask {
                name: name.to_owned(),
                handler: format!("vss.{name}"),
                on: "ws1".to_owned(),
                args: Node::table().with("camera", "left").with("gain", 2_i64),
                place: place.clone(),
            });
        }
        tasks
    }
}

#[test]
fn an_expander_makes_tasks_that_point_at_what_they_were_made_from() {
    let load = |services: &str| {
        let text = format!("{CELL}[vss]\nservices = {services}\n");
        load_texts(&[("app.toml", text.as_str())], &[], &[("vss", &Services)])
    };
    let app = load("[\"spot\", \"blob\"]").unwrap();
    let names: Vec<_> = app.tasks.iter().map(|task| task.name.as_str()).collect();
    assert_eq!(names, ["operator", "mcs", "spot", "blob"]);
    let spot = app.task("spot").unwrap();
    assert_eq!(spot.place.to_string(), "app.toml:25:13");
    assert_eq!(spot.args.get("camera").and_then(Node::as_str), Some("left"));
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Args {
        #[serde(rename = "camera")]
        _camera: String,
    }
    let wrong = spot.args.parse::<Args>().unwrap_err();
    assert_eq!(
        wrong.to_string(),
        "app.toml:25:13: error: unknown key `gain` (known here: camera)"
    );
    assert_eq!(
        app.locate("task.blob").unwrap().to_string(),
        "app.toml:25:21"
    );
    assert_eq!(
        app.locate("task.blob.args.gain").unwrap().to_string(),
        "app.toml:25:21"
    );

    let same = refused(load("[\"mcs\"]"));
    assert_eq!(
        same,
        [
            "app.toml:25:13: error: a task called `mcs` is generated here, but `mcs` is declared at app.toml:15:7 already (rename one of them)"
        ]
    );
    assert_eq!(
        refused(load("[\"bad\"]")),
        ["app.toml:25:13: error: no such service"]
    );
    let without = refused(load_one(&format!("{CELL}[vss]\nservices = []\n")));
    assert!(without[0].starts_with("app.toml:24:2: error: unknown key `vss` at the top level"));
}

#[test]
fn the_example_of_the_reference_page_is_an_app() {
    let page = include_str!("../../../docs/configuration.md");
    let example = page
        .split("```toml")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .unwrap();
    let texts = [("app.toml", example), ("cell/common.toml", "")];
    let app = load_texts(&texts, &[], &[]).unwrap();
    assert!(app.warnings.is_empty(), "{}", app.warnings);
    assert_eq!(app.tasks.len(), 2);
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics_and_every_error_has_a_place(text in ".{0,200}", set in ".{0,40}") {
        let result = load_texts(&[("a.toml", text.as_str())], &[set], &[]);
        if let Err(findings) = result {
            prop_assert!(findings.has_errors());
            prop_assert!(findings.iter().all(|finding| finding.place.is_some()), "{}", findings);
        }
    }

    #[test]
    fn toml_like_text_never_panics(
        words in prop::collection::vec(
            prop::sample::select(vec![
                "[", "]", "{", "}", "=", ".", ",", "\n", "\"", "'", "\"\"\"", "#", " ", "task", "chassis", "app", "time",
                "include", "a", "on", "handler", "queue", "processors", "args", "seed", "1", "-", "0x", "1e400", "nan", "true",
                "1979-05-27", "é", "\u{0}",
            ]),
            0..40,
        ),
        sets in prop::collection::vec("[a-c.\"'=\\[{ ]{0,12}", 0..3),
    ) {
        let text = words.concat();
        let _ = load_texts(&[("a.toml", text.as_str())], &sets, &[("vss", &Services)]);
        let set = words.concat();
        let _ = load_texts(&[("a.toml", CELL)], &[set], &[]);
    }
}

#[test]
fn deep_nesting_is_refused_and_not_a_stack_overflow() {
    let deep = format!("a = {}1{}", "[".repeat(100_000), "]".repeat(100_000));
    assert!(!refused(load_one(&deep)).is_empty());
    let dotted = format!("{}a = 1", "a.".repeat(100_000));
    assert!(!refused(load_one(&dotted)).is_empty());
}
