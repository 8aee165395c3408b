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
        .filter(|daemon| daemon.host == *host && daemon.number == number);
    match fitting.collect::<Vec<_>>().as_slice() {
        [one] => Ok(one.task.clone()),
        [] => {
            let known = daemons.iter().map(Numbered::to_string);
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
            let tasks = several.iter().map(|daemon| format!("`{}`", daemon.task));
            let tasks = tasks.collect::<Vec<_>>().join(" and ");
            Err(raise!(
                code::DAEMON,
                "`{object}@{host}:{number}`: {tasks} have that number on that host; give each its own `args.number`"
            ))
        }
    }
}

/// A daemon that is found by a number.
struct Numbered {
    host: String,
    number: u32,
    task: String,
}

impl Display for Numbered {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { host, number, task } = self;
        write!(f, "{host}:{number} (`{task}`)")
    }
}

fn numbered(app: &App) -> Vec<Numbered> {
    let daemons = app.tasks.iter().filter(|task| task.handler == HANDLER);
    let numbered = daemons.filter_map(|task| {
        // Arguments that are wrong are reported where the task is built.
        let arguments: Arguments = task.args.parse().ok()?;
        let chassis = app
            .chassis
            .iter()
            .find(|chassis| chassis.name == task.chassis)?;
        Some(Numbered {
            host: chassis.host.clone().unwrap_or_else(|| BOOT_HOST.to_owned()),
            number: arguments.number?,
            task: task.name.clone(),
        })
    });
    numbered.collect()
}
