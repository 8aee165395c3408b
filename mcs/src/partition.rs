//! `[mcs]`: the partition of a testbed. The list of manipulators says who drives which slots, and makes their tasks.
//!
//! A manipulator `NAME` is four tasks: `servo_NAME`, `state_NAME`, `planner_NAME`, and `NAME`, its client interface.

use std::collections::BTreeSet;

use ctos::config::{Expander, GeneratedTask, Node};
use ctos::diagnostic::{Finding, Findings, Source};
use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::tasks::{CLIENT, PLANNER, SERVO, STATE};

/// The table `[mcs]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct McsTable {
    /// Where the tasks run that are not real-time: `CHASSIS` or `CHASSIS/PROCESSOR`.
    on: String,
    /// The manipulators.
    manipulator: Vec<Manipulator>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Manipulator {
    name: String,
    /// Where its servo runs.
    servo_on: String,
    /// Arguments of its servo, which the servo reads.
    #[serde(rename = "servo")]
    _servo: IgnoredAny,
}

/// Turns `[mcs]` into tasks.
#[derive(Debug, Clone, Copy, Default)]
pub struct McsExpander;

impl Expander for McsExpander {
    fn expand(&self, table: &Node, findings: &mut Findings) -> Vec<GeneratedTask> {
        let Some(parsed) = findings.keep(table.parse::<McsTable>()) else {
            return Vec::new();
        };
        // Nodes from a file always have a place.
        let at = |key: &str| {
            let place = table.locate(key).or_else(|| table.place().cloned());
            place.unwrap_or_else(|| Source::new("[mcs]", "").at(0..0))
        };
        if parsed.manipulator.is_empty() {
            let text = "the partition has no manipulator";
            let finding = Finding::error("mcs::partition::empty", text).at(at("manipulator"));
            findings
                .push(finding.help("add [[mcs.manipulator]] with `name`, `servo_on` and `servo`"));
        }
        let mut names = BTreeSet::new();
        let mut tasks = Vec::new();
        for (index, manipulator) in parsed.manipulator.iter().enumerate() {
            let name = &manipulator.name;
            let key = |key: &str| format!("manipulator.{index}.{key}");
            if !names.insert(name) {
                let text = format!("two manipulators are called `{name}`");
                let finding = Finding::error("mcs::partition::twice", text).at(at(&key("name")));
                findings.push(finding.help("give each a name of its own"));
                continue;
            }
            let [servo, state, planner] =
                ["servo", "state", "planner"].map(|part| format!("{part}_{name}"));
            let own = table.get(&key("servo")).cloned();
            let to_servo = Node::table().with("servo", servo.as_str());
            let to_all = to_servo.clone();
            let to_all = to_all
                .with("state", state.as_str())
                .with("planner", planner.as_str());
            let parts = [
                (servo, SERVO, own.unwrap_or_else(Node::table)),
                (state, STATE, to_servo.clone()),
                (planner, PLANNER, to_servo),
                (name.clone(), CLIENT, to_all),
            ];
            tasks.extend(parts.map(|(name, handler, args)| {
                let (on, place) = match handler {
                    SERVO => (&manipulator.servo_on, at(&key("servo_on"))),
                    _ => (&parsed.on, at(&key("name"))),
                };
                GeneratedTask {
                    name,
                    handler: handler.to_owned(),
                    on: on.clone(),
                    args,
                    place,
                }
            }));
        }
        tasks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expand(text: &str) -> (Vec<GeneratedTask>, Vec<String>) {
        let mut findings = Findings::new();
        let node = Node::from_toml(&Source::new("app.toml", text), &mut findings);
        let tasks = McsExpander.expand(&node, &mut findings);
        (tasks, findings.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn a_manipulator_is_a_servo_with_its_state_manager_planner_and_client_interface() {
        let (tasks, findings) = expand(
            r#"
on = "cage/main"
[[manipulator]]
name = "left"
servo_on = "cage/left"
servo = { driver = "sim.arm", model = "puma560" }
"#,
        );
        assert_eq!(findings, [""; 0]);
        let parts: Vec<_> = tasks
            .iter()
            .map(|task| (task.name.as_str(), task.handler.as_str(), task.on.as_str()))
            .collect();
        let expected = [
            ("servo_left", SERVO, "cage/left"),
            ("state_left", STATE, "cage/main"),
            ("planner_left", PLANNER, "cage/main"),
            ("left", CLIENT, "cage/main"),
        ];
        assert_eq!(parts, expected);
        assert_eq!(
            tasks[0].args.get("driver").and_then(Node::as_str),
            Some("sim.arm")
        );
        assert_eq!(
            tasks[3].args.get("servo").and_then(Node::as_str),
            Some("servo_left")
        );
    }

    #[test]
    fn what_is_wrong_with_a_partition_is_said_with_its_place() {
        let twice = r#"
on = "cage"
[[manipulator]]
name = "left"
servo_on = "cage"
servo = {}
[[manipulator]]
name = "left"
servo_on = "cage"
servo = {}
"#;
        for (text, expected) in [
            (
                "on = \"cage\"\nmanipulator = []",
                "app.toml:2:1: error: the partition has no manipulator",
            ),
            (
                twice,
                "app.toml:8:1: error: two manipulators are called `left`",
            ),
            ("on = \"cage\"", "the key `manipulator` is missing"),
        ] {
            let (_, findings) = expand(text);
            assert!(findings[0].contains(expected), "{findings:?}");
        }
    }
}
