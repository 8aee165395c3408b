//! Reads an app: its files merged, its tables built, and the profiles that were not chosen looked through.

use std::{collections::BTreeMap, path::Path};

use crate::{
    app::App,
    build::build,
    diagnostic::Findings,
    expander::Expander,
    load::{Files, merged},
    node::{Entry, Node},
    profiles::{holds, lay_over},
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
        load_from(Files::Disk, self, expanders)
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
        load_from(Files::Texts(texts, variables), self, expanders)
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

fn load_from(
    files: Files<'_>,
    selection: &Selection,
    expanders: &[(&'static str, &dyn Expander)],
) -> Result<App, Findings> {
    let mut findings = Findings::new();
    let Some(merged) = merged(files, selection, &mut findings) else {
        return Err(findings);
    };
    // What does not parse would only bring findings that are not the person's mistakes.
    if findings.has_errors() {
        return Err(findings);
    }
    let (root, trail) = (merged.root, merged.trail);
    let mut app = build(root, selection, trail, expanders, &mut findings);
    for profile in &merged.profiles {
        if !app.selection.profiles.contains(&profile.key) {
            let root = merged.bare.clone();
            check_idle(profile, root, files, expanders, &mut findings);
        }
    }
    if findings.has_errors() {
        return Err(findings);
    }
    app.warnings = findings;
    Ok(app)
}

/// What is wrong with the keys and values of a profile by themselves. Whether its names lead anywhere may
/// depend on another profile.
const ASKED: [&str; 5] = [
    "ctos::config::unknown_key",
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
        let known = unset.is_empty() || finding.code == "ctos::config::unknown_key";
        let asked = known && ASKED.contains(&finding.code);
        if asked && here.is_some_and(|place| holds(&profile.value, place)) {
            findings.push(finding);
        }
    }
}
