//! `[profile.NAME]`: tables that lie on top of an app's own when they are chosen.
//!
//! Knows what a profile may hold and how it is laid on; what its keys mean is for
//! [`build`](super::build) to say.

use super::check::check_name;
use super::node::{Entry, Node};
use crate::diagnostic::{Finding, Findings, Place, Source};

/// The name of a profile that is asked for, and where that is.
pub(super) type Chosen = (String, Place);

/// One that `--profile` asks for.
pub(super) fn on_command_line(name: &str) -> Chosen {
    let source = Source::new("--profile", name);
    (name.to_owned(), source.at(0..name.len()))
}

/// The profile meant.
pub(super) fn chosen<'a>(
    (name, place): &Chosen,
    profiles: &'a [Entry],
) -> Result<&'a Entry, Finding> {
    let found = profiles.iter().find(|profile| profile.key == *name);
    found.ok_or_else(|| {
        let text = format!("there is no profile `{name}`");
        Finding::error("ctos::config::unknown_profile", text)
            .help(format!("declare it: [profile.{name}.app]"))
            .suggest(name, profiles.iter().map(|profile| profile.key.as_str()))
            .at(place.clone())
    })
}

/// Reads the table `profile` that was taken out of an app's merged files: its profiles in declared order.
pub(super) fn declared(entry: Option<Entry>, findings: &mut Findings) -> Vec<Entry> {
    let Some(Entry { value, .. }) = entry else {
        return Vec::new();
    };
    if !value.is_table() {
        let help = "write [profile.NAME]; app.profile chooses one";
        findings.push(value.is_no("ctos::config::value", "`profile` holds named tables", help));
    }
    let profiles = value.entries().iter().filter(|profile| {
        let Entry { key, value, .. } = profile;
        check_name("profile", profile, findings);
        check_contents(profile, findings);
        if !value.is_table() {
            let what = format!("profile `{key}` holds tables of the app");
            let help = format!("write for example [profile.{key}.time]");
            findings.push(value.is_no("ctos::config::value", &what, &help));
        }
        value.is_table()
    });
    profiles.cloned().collect()
}

pub(super) fn lay_over(profile: &Entry, root: &mut Node, findings: &mut Findings) {
    // A task that the app has not, and that is not whole either, is a typing error.
    let there = root.tables("task");
    for task in profile.value.tables("task") {
        let known = there.iter().any(|entry| entry.key == task.key);
        if known || task.value.entry("handler").is_some() || !task.value.is_table() {
            continue;
        }
        let (own, name) = (&profile.key, &task.key);
        let text = format!("profile `{own}` changes a task `{name}`, which does not exist");
        let finding = Finding::error("ctos::config::unknown_name", text)
            .suggest(name, there.iter().map(|entry| entry.key.as_str()));
        findings.push(finding.at(task.key_place.clone()));
    }
    root.merge(profile.value.clone());
}

/// What no profile may hold, because it is read before profiles are.
fn check_contents(profile: &Entry, findings: &mut Findings) {
    let app = profile.value.entry("app");
    let choice = app.and_then(|app| app.value.entry("profile"));
    let several = "choose several with --profile A --profile B; the later ones lie on top";
    for (entry, what, help) in [
        (
            profile.value.entry("include"),
            "a profile cannot include files",
            "write `include` at the top of the file; files may hold profiles too",
        ),
        (
            profile.value.entry("profile"),
            "a profile cannot hold profiles",
            several,
        ),
        (choice, "a profile cannot choose a profile", several),
    ] {
        if let Some(entry) = entry {
            let finding = Finding::error("ctos::config::profile", what).help(help);
            findings.push(finding.at(entry.key_place.clone()));
        }
    }
}
