//! The keys that say what happens when a chassis or a task fails.

use super::app::{ChassisSupervision, OnTaskFailure};
use super::node::Node;
use crate::diagnostic::{Finding, Findings};
use crate::settings::{Policy, When};

/// The keys of restarts, which have an effect only where there are restarts.
const RESTARTS: [&str; 3] = ["max_restarts", "restart_window_s", "restart_backoff_s"];

/// The keys of a chassis that say what happens when it fails.
pub(super) fn supervision(chassis: &Node, findings: &mut Findings) -> ChassisSupervision {
    let restart = policy(chassis, ChassisSupervision::default().restart);
    let on_task_failure = chassis.read("on_task_failure").unwrap_or_default();
    if restart.when == When::Never {
        let restarts = on_task_failure == OnTaskFailure::RestartChassis;
        let keys = RESTARTS
            .into_iter()
            .chain(restarts.then_some("on_task_failure"));
        idle(
            chassis,
            keys,
            "on a chassis that is never restarted",
            findings,
        );
    }
    ChassisSupervision {
        restart,
        on_task_failure,
    }
}

/// `restart` of a task and the keys that go with it.
pub(super) fn restart(task: &Node, findings: &mut Findings) -> Policy {
    let policy = policy(task, Policy::default());
    if policy.when == When::Never {
        idle(
            task,
            RESTARTS.into_iter(),
            "where nothing is restarted",
            findings,
        );
    }
    policy
}

fn policy(node: &Node, usual: Policy) -> Policy {
    Policy {
        when: node.read("restart").unwrap_or_default(),
        max: node.read("max_restarts").unwrap_or(usual.max),
        window: node.seconds("restart_window_s").unwrap_or(usual.window),
        backoff: node.seconds("restart_backoff_s").unwrap_or(usual.backoff),
    }
}

/// Warns of keys that are there for nothing.
fn idle(
    node: &Node,
    keys: impl Iterator<Item = &'static str>,
    place: &str,
    findings: &mut Findings,
) {
    for key in keys {
        if let Some(at) = node.place_of(key) {
            let text = format!("`{key}` has no effect {place}");
            let finding = Finding::warning("ctos::config::no_effect", text);
            let help = "add restart = \"on-failure\" or restart = \"always\"";
            findings.push(finding.help(help).at(at));
        }
    }
}
