//! The keys that say what happens when a chassis or a task fails.

use super::app::{ChassisSupervision, OnTaskFailure};
use super::fields::Fields;
use crate::diagnostic::Finding;
use crate::settings::{Policy, When};

/// The keys of restarts, which have an effect only where there are restarts.
const RESTARTS: [&str; 3] = ["max_restarts", "restart_window_s", "restart_backoff_s"];

/// The keys of a chassis that say what happens when it fails.
pub(super) fn supervision(fields: &mut Fields<'_, '_>) -> ChassisSupervision {
    let policy = policy(
        fields,
        Policy {
            backoff: ChassisSupervision::default().backoff,
            ..Policy::default()
        },
    );
    let contained = OnTaskFailure::RestartChassis;
    let choices = [("app", OnTaskFailure::App), ("restart-chassis", contained)];
    let on_task_failure = fields.choice("on_task_failure", &choices);
    if policy.when == When::Never {
        let last = (on_task_failure == contained).then_some("on_task_failure");
        let keys = RESTARTS.into_iter().chain(last);
        idle(fields, keys, "on a chassis that is never restarted");
    }
    ChassisSupervision {
        restart: policy.when,
        max_restarts: policy.max,
        window: policy.window,
        backoff: policy.backoff,
        on_task_failure,
    }
}

/// `restart` and the keys that go with it.
pub(super) fn restart(fields: &mut Fields<'_, '_>) -> Policy {
    let policy = policy(fields, Policy::default());
    if policy.when == When::Never {
        idle(fields, RESTARTS.into_iter(), "where nothing is restarted");
    }
    policy
}

fn policy(fields: &mut Fields<'_, '_>, usual: Policy) -> Policy {
    let choices = [
        ("never", When::Never),
        ("on-failure", When::OnFailure),
        ("always", When::Always),
    ];
    let when = fields.choice("restart", &choices);
    Policy {
        when,
        max: fields.integer("max_restarts").unwrap_or(usual.max),
        window: fields.seconds("restart_window_s").unwrap_or(usual.window),
        backoff: fields.seconds("restart_backoff_s").unwrap_or(usual.backoff),
    }
}

/// Warns of keys that are there for nothing.
fn idle(fields: &mut Fields<'_, '_>, keys: impl Iterator<Item = &'static str>, place: &str) {
    for key in keys {
        if let Some(at) = fields.place(key) {
            let text = format!("`{key}` has no effect {place}");
            let finding = Finding::warning("ctos::config::no_effect", text);
            let help = "add restart = \"on-failure\" or restart = \"always\"";
            fields.push(finding.help(help).at(at));
        }
    }
}
