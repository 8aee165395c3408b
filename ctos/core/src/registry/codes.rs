//! Whether the commands of an event handler can be told apart.

use std::collections::BTreeMap;

use crate::registry::HandlerKind;
use ctos_config::{
    TaskConfig,
    diagnostic::{Finding, Findings},
};
use ctos_message::{CommandInfo, SYSTEM_COMMANDS};

/// Checks the codes of `kind`, which `task` runs. A handler that several tasks run is reported where
/// the first of them names it.
pub(super) fn check(
    kind: &HandlerKind,
    commands: &[CommandInfo],
    task: &TaskConfig,
    findings: &mut Findings,
) {
    let mut seen: BTreeMap<u16, &str> = BTreeMap::new();
    for command in commands {
        let code = command.code;
        if let Some(other) = seen.insert(code, command.name) {
            let message = format!(
                "the event handler `{}` takes two commands with the code {code:#06x}, `{other}` and `{}`",
                kind.name(),
                command.name
            );
            let help = "give each command of a handler a code of its own";
            report("ctos::handler::same_code", message, help, task, findings);
        }
        if code >= SYSTEM_COMMANDS {
            let message = format!(
                "the command `{}` of the event handler `{}` has the code {code:#06x}, which belongs to the runtime",
                command.name,
                kind.name()
            );
            let help = "choose a code below 0xff00";
            report(
                "ctos::handler::reserved_code",
                message,
                help,
                task,
                findings,
            );
        }
    }
}

fn report(
    code: &'static str,
    message: String,
    help: &str,
    task: &TaskConfig,
    findings: &mut Findings,
) {
    if findings.iter().any(|there| there.message == message) {
        return;
    }
    let finding = Finding::error(code, message).help(help);
    findings.push(finding.at(task.handler_place.clone()));
}
