//! Reads an app: its files merged, its tables built, and the profiles that were not chosen looked through.

use std::{collections::BTreeMap, path::Path};

use crate::{
    app::App,
    build::build,
    diagnostic::{Finding, Findings},
    expander::Expander,
    load::{Files, merged},
    node::{Entry, Node},
    profiles::lay_over,
    selection::Selection,
    trail::Trail,
    variables::Variables,
};

impl Selection {
    /// Reads the app: its file, everything that file includes, profiles and `--set` texts.
    /// `expanders` are the top-level tables other than the runtime's own, each with what turns it
    /// into tasks.
    ///
    /// # Errors
    /// Everything wrong, errors and warnings together. When there are only warnings, the app is
    /// returned and holds them.
    pub fn load(&self, expanders: &[(&'static str, &dyn Expander)]) -> Result<App, Findings> {
        loaded(self.read(expanders))
    }

    /// As [`load`](Self::load), for those who look further at an app that is wrong: as much of it as could be read.
    /// None where the files themselves are no configuration.
    pub fn read(&self, expanders: &[(&'static str, &dyn Expander)]) -> (Option<App>, Findings) {
        read_from(Files::Disk, self, expanders)
    }

    /// As [`load`](Self::load), from texts in memory given as `(path, text)`, and with these
    /// environment variables in place of the process's.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_texts(
        &self,
        texts: &[(&str, &str)],
        variables: &BTreeMap<String, String>,
        expanders: &[(&'static str, &dyn Expander)],
    ) -> Result<App, Findings> {
        loaded(read_from(Files::Texts(texts, variables), self, expanders))
    }
}

/// Reads an app from its file, everything that file includes, and `--set` texts:
/// [`Selection::load`] without a profile on the command line.
///
/// # Errors
/// As [`Selection::load`].
pub fn load(
    file: &Path,
    sets: &[String],
    expanders: &[(&'static str, &dyn Expander)],
) -> Result<App, Findings> {
    let mut selection = Selection::new(file);
    selection.sets = sets.to_vec();
    selection.load(expanders)
}

/// As [`load`], from texts in memory given as `(path, text)`; the first is the app's file, and
/// includes find the others by their paths. No environment variable is set.
///
/// # Errors
/// As [`load`].
pub fn load_texts(
    texts: &[(&str, &str)],
    sets: &[String],
    expanders: &[(&'static str, &dyn Expander)],
) -> Result<App, Findings> {
    let mut selection = Selection::new(texts.first().map_or("", |(name, _)| *name));
    selection.sets = sets.to_vec();
    selection.load_texts(texts, &BTreeMap::new(), expanders)
}

/// An app without errors, which holds the warnings.
fn loaded((app, findings): (Option<App>, Findings)) -> Result<App, Findings> {
    match app {
        Some(mut app) if !findings.has_errors() => {
            app.warnings = findings;
            Ok(app)
        }
        _ => Err(findings),
    }
}

fn read_from(
    files: Files<'_>,
    selection: &Selection,
    expanders: &[(&'static str, &dyn Expander)],
) -> (Option<App>, Findings) {
    let mut findings = Findings::new();
    let merged = merged(files, selection, &mut findings);
    // What does not parse would only bring findings that are not the person's mistakes.
    let parses = !findings.iter().any(|one| UNPARSED.contains(&one.code));
    let Some(merged) = merged.filter(|_| parses) else {
        return (None, findings);
    };
    // Where something was not read, only what is wrong by itself is a mistake of the person, and of a value only where
    // variables stand for what they should.
    let is_whole = !findings.has_errors();
    let has_values = !findings.iter().any(|one| VARIABLES.contains(&one.code));
    let (root, trail) = (merged.root, merged.trail);
    let mut found = findings.clone();
    let app = build(root, selection, trail, expanders, &mut found);
    if is_whole {
        findings = found;
    } else {
        let known =
            |one: &Finding| ASKED.contains(&one.code) && (has_values || one.code == UNKNOWN_KEY);
        found
            .iter()
            .filter(|one| known(one))
            .for_each(|one| findings.push(one.clone()));
        if !has_values {
            return (None, findings);
        }
    }
    for profile in &merged.profiles {
        if !app.selection.profiles.contains(&profile.key) {
            let root = merged.bare.clone();
            check_idle(profile, root, files, expanders, &mut findings);
        }
    }
    (Some(app), findings)
}

const UNKNOWN_KEY: &str = "ctos::config::unknown_key";

/// What is no TOML, and numbers that are none.
const UNPARSED: [&str; 2] = ["ctos::config::syntax", "ctos::config::number"];

/// What is wrong with references to variables.
const VARIABLES: [&str; 2] = ["ctos::config::unset_variable", "ctos::config::variable"];

/// What is wrong with the keys and values of a profile by themselves. Whether its names lead anywhere may
/// depend on another profile.
const ASKED: [&str; 5] = [
    UNKNOWN_KEY,
    "ctos::config::unknown_choice",
    "ctos::config::value",
    "ctos::config::name",
    "ctos::config::number",
];

/// Looks through a profile that is not chosen, so that a typing error in it is found before the profile is needed.
/// `root` is the app without any profile.
fn check_idle(
    profile: &Entry,
    mut root: Node,
    files: Files<'_>,
    expanders: &[(&'static str, &dyn Expander)],
    findings: &mut Findings,
) {
    let mut found = Findings::new();
    lay_over(profile, &mut root, &mut found);
    let mut unset = Findings::new();
    Variables::of(files).expand(&mut root, &mut unset, &|_| true);
    let (selection, trail) = (Selection::default(), Trail::default());
    build(root, &selection, trail, expanders, &mut found);
    for finding in found.into_sorted() {
        let here = finding.place.as_ref();
        // A variable need not be set for a profile that is not chosen; its value is unknown then.
        let known = unset.is_empty() || finding.code == UNKNOWN_KEY;
        let asked = known && ASKED.contains(&finding.code);
        if asked && here.is_some_and(|place| profile.value.holds(place)) {
            findings.push(finding);
        }
    }
}
