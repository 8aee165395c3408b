//! The keys that say what happens when a chassis or a task fails.

use super::app::{ChassisRestart, ChassisSupervision, OnTaskFailure};
use super::fields::Fields;
use crate::diagnostic::Finding;
use crate::settings::{Policy, When};

/// The keys of a chassis that say what happens when it fails.
pub(super) fn supervision(fields: &mut Fields<'_, '_>) -> ChassisSupervision {
    let defaults = ChassisSupervision::default();
    let restart = match fields.choice("restart", &["never", "on-failure", "always"]) {
        Some("on-failure") => ChassisRestart::OnFailure,
        Some("always") => ChassisRestart::Always,
        _ => ChassisRestart::Never,
    };
    let max_restarts = fields.integer("max_restarts", 1..=1_000_000_u32);
    let window = fields.seconds("restart_window_s", 86_400.0);
    let backoff = fields.seconds("restart_backoff_s", 3600.0);
    let on_task_failure = match fields.choice("on_task_failure", &["app", "restart-chassis"]) {
        Some("restart-chassis") => OnTaskFailure::RestartChassis,
        _ => OnTaskFailure::App,
    };
    if restart == ChassisRestart::Never {
        let mut idle = vec!["max_restarts", "restart_window_s", "restart_backoff_s"];
        if on_task_failure == OnTaskFailure::RestartChassis {
            idle.push("on_task_failure");
        }
        for key in idle {
            if let Some(place) = fields.place(key) {
                fields.push(
                    Finding::warning(
                        "ctos::config::no_effect",
                        format!("`{key}` has no effect on a chassis that is never restarted"),
                    )
                    .help("add restart = \"on-failure\" or restart = \"always\"")
                    .at(place),
                );
            }
        }
    }
    ChassisSupervision {
        restart,
        max_restarts: max_restarts.unwrap_or(defaults.max_restarts),
        window: window.unwrap_or(defaults.window),
        backoff: backoff.unwrap_or(defaults.backoff),
        on_task_failure,
    }
}

/// `restart` and the keys that go with it.
pub(super) fn restart(fields: &mut Fields<'_, '_>) -> Policy {
    let when = match fields.choice("restart", &["never", "on-failure", "always"]) {
        Some("on-failure") => When::OnFailure,
        Some("always") => When::Always,
        _ => When::Never,
    };
    let usual = Policy::default();
    let max = fields.integer("max_restarts", 1..=1_000_000_u32);
    let window = fields.seconds("restart_window_s", 86_400.0);
    let backoff = fields.seconds("restart_backoff_s", 3_600.0);
    if when == When::Never {
        for (key, given) in [
            ("max_restarts", max.is_some()),
            ("restart_window_s", window.is_some()),
            ("restart_backoff_s", backoff.is_some()),
        ] {
            if let (true, Some(place)) = (given, fields.place(key)) {
                fields.push(
                    Finding::warning(
                        "ctos::config::no_effect",
                        format!("`{key}` has no effect where nothing is restarted"),
                    )
                    .help("add restart = \"on-failure\" or restart = \"always\"")
                    .at(place),
                );
            }
        }
    }
    Policy {
        when,
        max: max.unwrap_or(usual.max),
        window: window.unwrap_or(usual.window),
        backoff: backoff.unwrap_or(usual.backoff),
    }
}
