//! The keys that say what happens when a chassis or a task fails.

use super::app::{ChassisSupervision, OnTaskFailure};
use super::node::Node;
use crate::diagnostic::{Finding, Findings};
use crate::settings::{Policy, When};

/// The keys of restarts, which have an effect only where there are restarts.
const RESTARTS: [&str; 3] = ["max_restarts", "restart_window_s", "restart_backoff_s"];

/// The keys of a chassis that say what happens when it fails.
pub(super) fn supervision(chassis: &Node, findings: &mut Findings) -> ChassisSupervision {
    let usual = ChassisSupervision::default().restart;
    let place = "on a chassis that is never restarted";
    let restart = restart(chassis, usual, place, findings);
    let on_task_failure = chassis.read("on_task_failure").unwrap_or_default();
    if restart.when == When::Never && on_task_failure == OnTaskFailure::RestartChassis {
        idle(chassis, &["on_task_failure"], place, findings);
    }
    ChassisSupervision {
        restart,
        on_task_failure,
    }
}

/// `restart` and the keys that go with it; `place` says in words where they would have no effect.
pub(super) fn restart(node: &Node, usual: Policy, place: &str, findings: &mut Findings) -> Policy {
    let when = node.read("restart").unwrap_or_default();
    if when == When::Never {
        idle(node, &RESTARTS, place, findings);
    }
    Policy {
        when,
        max: node.read("max_restarts").unwrap_or(usual.max),
        window: node.seconds("restart_window_s").unwrap_or(usual.window),
        backoff: node.seconds("restart_backoff_s").unwrap_or(usual.backoff),
    }
}

/// Warns of keys that are there for nothing.
fn idle(node: &Node, keys: &[&str], place: &str, findings: &mut Findings) {
    for key in keys {
        if let Some(at) = node.place_of(key) {
            let text = format!("`{key}` has no effect {place}");
            let finding = Finding::warning("ctos::config::no_effect", text);
            let help = "add restart = \"on-failure\" or restart = \"always\"";
            findings.push(finding.help(help).at(at));
        }
    }
}
