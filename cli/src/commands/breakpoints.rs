//! `--break`: where nets shall stop, given with the command that starts an app. It becomes `--set` texts, which reach
//! every chassis, so that a net has its breakpoints before its first firing.

use std::collections::BTreeMap;

use clap::Args;
use ctos::{
    config::Selection,
    diagnostic::{Finding, Findings, Source},
    registry::Registry,
};
use pnt::task::{check_breakpoint, net_tasks, nets, settings};

use crate::program;

/// Where nets shall stop.
#[derive(Debug, Clone, Default, Args)]
pub struct Breakpoints {
    /// Stop a net before a transition fires, or when PLACE>=N, PLACE<=N or PLACE=N becomes true (can be repeated)
    ///
    /// Set before the first firing. The app ends there, with exit code 7; a booted net that people may control
    /// (`allow_control`) pauses instead, for `ctos net resume` and the like.
    #[arg(long = "break", value_name = "NET.WHERE")]
    pub breaks: Vec<String>,
}

/// Whether somebody could release a net that pauses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Released {
    /// A person who may control the net.
    ByHand,
    /// Nobody: time goes by as fast as it can.
    Never,
}

impl Breakpoints {
    /// The `--set` texts for an app. What else is wrong with the app is not told here.
    ///
    /// # Errors
    /// A breakpoint names no net of the app, or nothing in it.
    pub fn sets(
        &self,
        selection: &Selection,
        registry: &Registry,
        released: Released,
    ) -> Result<Vec<String>, Findings> {
        if self.breaks.is_empty() {
            return Ok(Vec::new());
        }
        let Ok(app) = program::app(selection) else {
            return Ok(Vec::new());
        };
        let tasks = net_tasks(&app, registry);
        let known = nets(&app, registry).unwrap_or_default();
        let mut findings = Findings::new();
        let mut by_net: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for text in &self.breaks {
            let at = |finding: Finding| {
                finding.at(Source::new("--break", text.as_str()).at(0..text.len()))
            };
            let Some((net, place)) = split(text, &tasks) else {
                findings.push(at(no_net(text, &tasks)));
                continue;
            };
            // The check of the app reports a net that cannot be read.
            let checked = known.iter().find(|known| known.name() == net);
            if let Some(Err(finding)) = checked.map(|known| check_breakpoint(place, known)) {
                findings.push(at(finding));
                continue;
            }
            by_net.entry(net).or_default().push(place.to_owned());
        }
        if findings.has_errors() {
            return Err(findings);
        }
        let mut sets = Vec::new();
        for (net, places) in by_net {
            let Some(Ok(settings)) = app.task(net).map(settings) else {
                continue;
            };
            let all: Vec<String> = settings.breakpoints.into_iter().chain(places).collect();
            // A list of texts is the same in JSON as in TOML.
            let all = serde_json::json!(all);
            sets.push(format!("task.{net}.args.breakpoints={all}"));
            if released == Released::Never || !settings.allow_control {
                sets.push(format!("task.{net}.args.break_ends=true"));
            }
        }
        Ok(sets)
    }
}

/// The net that a text begins with, and the rest: the longest, for names of tasks and of transitions may have points.
fn split<'a>(text: &'a str, tasks: &'a [String]) -> Option<(&'a str, &'a str)> {
    let rest = |task: &'a String| {
        let rest = text.strip_prefix(task.as_str())?.strip_prefix('.')?;
        Some((task.as_str(), rest))
    };
    tasks
        .iter()
        .filter_map(rest)
        .max_by_key(|(task, _)| task.len())
}

fn no_net(text: &str, tasks: &[String]) -> Finding {
    const CODE: &str = "pnt::task::breakpoint";
    let Some((net, _)) = text.split_once('.') else {
        let message = format!("`{text}` does not say where in which net");
        return Finding::error(CODE, message).help("write NET.TRANSITION or NET.PLACE>=N");
    };
    Finding::error(CODE, format!("no task called `{net}` runs a net"))
        .suggest(net, tasks.iter().map(String::as_str))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_breakpoint_is_of_the_net_with_the_longest_name_that_fits() {
        let tasks = ["a".to_owned(), "a.b".to_owned()];
        assert_eq!(split("a.b.c", &tasks), Some(("a.b", "c")));
        assert_eq!(split("a.left.close", &tasks), Some(("a", "left.close")));
        assert_eq!(split("a", &tasks), None);
        assert_eq!(split("b.c", &tasks), None);
    }
}
