//! Which task of an app a daemon is, by what stands after `@` (SORMA technical report, section 1.4.3).

use super::arguments::{Arguments, HANDLER};
use crate::name::Location;
use crate::raise;
use crate::report::{Report, code};
use ctos::config::App;
use std::fmt::Display;

/// The host of chassis whose configuration names none: that of the boot.
const BOOT_HOST: &str = "localhost";

/// The task that is the daemon at that place: the one of that name, or the daemon on that host whose
/// `args.number` is that number. `object` is who is asked, for the report.
pub(super) fn task_at(app: &App, at: &Location, object: &dyn Display) -> Result<String, Report> {
    let (host, number) = match at {
        Location::Alias(name) => return Ok(name.clone()),
        Location::Address { host, number } => (host, *number),
        Location::Local | Location::Here | Location::Default => {
            return Err(raise!(
                code::DAEMON,
                "`{object}`: no daemon is named; write `{object}@TASK` or `{object}@HOST:NUMBER`"
            ));
        }
    };
    let daemons = numbered(app);
    let fitting = daemons
        .iter()
        .filter(|(at, known, _)| at == host && *known == number)
        .map(|(.., task)| task);
    match fitting.collect::<Vec<_>>().as_slice() {
        [one] => Ok((*one).clone()),
        [] => {
            let known = daemons
                .iter()
                .map(|(host, number, task)| format!("{host}:{number} (`{task}`)"));
            let known = match known.collect::<Vec<_>>().join(", ") {
                known if known.is_empty() => "no daemon has a number".to_owned(),
                known => format!("there are {known}"),
            };
            Err(raise!(
                code::DAEMON,
                "`{object}@{host}:{number}`: no daemon on host `{host}` has `args.number = {number}`; {known}"
            ))
        }
        several => {
            let tasks = several.iter().map(|task| format!("`{task}`"));
            let tasks = tasks.collect::<Vec<_>>().join(" and ");
            Err(raise!(
                code::DAEMON,
                "`{object}@{host}:{number}`: {tasks} have that number on that host; give each its own `args.number`"
            ))
        }
    }
}

/// The daemons that are found by a number: host, number, task.
fn numbered(app: &App) -> Vec<(String, u32, String)> {
    let daemons = app.tasks.iter().filter(|task| task.handler == HANDLER);
    let numbered = daemons.filter_map(|task| {
        // Arguments that are wrong are reported where the task is built.
        let arguments: Arguments = task.args.parse().ok()?;
        let chassis = app
            .chassis
            .iter()
            .find(|chassis| chassis.name == task.chassis)?;
        let host = chassis.host.clone().unwrap_or_else(|| BOOT_HOST.to_owned());
        Some((host, arguments.number?, task.name.clone()))
    });
    numbered.collect()
}
