//! `[profile.NAME]`: tables that lie on top of an app's own when they are chosen.
//!
//! Knows what a profile may hold and how it is laid on; what its keys mean is for
//! [`build`](super::build) to say.

use super::check::check_name;
use super::node::{Entry, Node};
use crate::diagnostic::{Finding, Findings, Place, Source};

/// The profiles of an app, in declared order.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Profiles(Vec<Profile>);

/// One profile: its name and what it changes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Profile {
    pub(super) name: String,
    pub(super) tables: Node,
}

/// A profile that is asked for, and where.
pub(super) struct Chosen {
    pub(super) name: String,
    place: Place,
}

impl Chosen {
    /// By `--profile`.
    pub(super) fn on_command_line(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            place: Source::new("--profile", name).at(0..name.len()),
        }
    }

    /// By `app.profile`.
    pub(super) fn in_file(name: String, place: Place) -> Self {
        Self { name, place }
    }
}

impl Profiles {
    /// Reads the table `profile` that was taken out of an app's merged files.
    pub(super) fn read(entry: Option<Entry>, findings: &mut Findings) -> Self {
        let Some(entry) = entry else {
            return Self::default();
        };
        if !entry.value.is_table() {
            let text = format!("`profile` holds named tables, found {}", entry.value.kind());
            let finding = Finding::error("ctos::config::value", text)
                .help("write [profile.NAME]; app.profile chooses one");
            findings.push(finding.at(entry.value.place().cloned()));
        }
        let mut profiles = Vec::new();
        for named in entry.value.entries() {
            if let Some(place) = &named.key_place {
                check_name("profile", &named.key, place, findings);
            }
            if named.value.is_table() {
                check_contents(named, findings);
                profiles.push(Profile {
                    name: named.key.clone(),
                    tables: named.value.clone(),
                });
            } else {
                let (name, kind) = (&named.key, named.value.kind());
                let text = format!("profile `{name}` holds tables of the app, found {kind}");
                let finding = Finding::error("ctos::config::value", text)
                    .help(format!("write for example [profile.{name}.time]"));
                findings.push(finding.at(named.value.place().cloned()));
            }
        }
        Self(profiles)
    }

    /// All of them.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Profile> {
        self.0.iter()
    }

    /// The one that is asked for.
    pub(super) fn find(&self, chosen: &Chosen) -> Result<&Profile, Finding> {
        let found = self.0.iter().find(|profile| profile.name == chosen.name);
        found.ok_or_else(|| {
            let finding = Finding::error(
                "ctos::config::unknown_profile",
                format!("there is no profile `{}`", chosen.name),
            )
            .at(chosen.place.clone());
            if self.0.is_empty() {
                finding.help(format!("declare it: [profile.{}.app]", chosen.name))
            } else {
                finding.suggest(
                    &chosen.name,
                    self.0.iter().map(|profile| profile.name.as_str()),
                )
            }
        })
    }
}

impl Profile {
    /// Lays this profile over an app.
    pub(super) fn lay_over(&self, root: &mut Node, findings: &mut Findings) {
        self.half_tasks(root, findings);
        root.merge(self.tables.clone());
    }

    /// Whether a key or a value of this profile stands at `place`.
    pub(super) fn holds(&self, place: &Place) -> bool {
        holds(&self.tables, place)
    }

    /// A task that the app has not, and that is not whole either, is a typing error.
    fn half_tasks(&self, root: &Node, findings: &mut Findings) {
        let there = root.tables("task");
        for task in self.tables.tables("task") {
            let known = there.iter().any(|entry| entry.key == task.key);
            if known || task.value.entry("handler").is_some() || !task.value.is_table() {
                continue;
            }
            let (own, task_name) = (&self.name, &task.key);
            let text =
                format!("profile `{own}` changes a task `{task_name}`, which does not exist");
            let finding = Finding::error("ctos::config::unknown_name", text)
                .suggest(&task.key, there.iter().map(|entry| entry.key.as_str()));
            findings.push(finding.at(task.key_place.clone()));
        }
    }
}

/// What no profile may hold, because it is read before profiles are.
fn check_contents(profile: &Entry, findings: &mut Findings) {
    let app = profile.value.entry("app");
    let choice = app.and_then(|app| app.value.entry("profile"));
    let refused = [
        (
            profile.value.entry("include"),
            "a profile cannot include files",
            "write `include` at the top of the file; files may hold profiles too",
        ),
        (
            profile.value.entry("profile"),
            "a profile cannot hold profiles",
            "choose several with --profile A --profile B; the later ones lie on top",
        ),
        (
            choice,
            "a profile cannot choose a profile",
            "choose several with --profile A --profile B; the later ones lie on top",
        ),
    ];
    for (entry, what, help) in refused {
        if let Some(entry) = entry {
            let finding = Finding::error("ctos::config::profile", what).help(help);
            findings.push(finding.at(entry.key_place.clone()));
        }
    }
}

/// Whether `place` is that of a key or a value of `node`.
fn holds(node: &Node, place: &Place) -> bool {
    node.place() == Some(place)
        || node.elements().iter().any(|element| holds(element, place))
        || node
            .entries()
            .iter()
            .any(|entry| entry.key_place.as_ref() == Some(place) || holds(&entry.value, place))
}
