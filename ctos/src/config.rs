//! Configuration of an app: TOML files, includes and `--set`, read into checked types.
//!
//! All that is wrong is reported at once, each finding with file, line and column. Precedence:
//! default < include < file < `--set`. The page `docs/configuration.md` lists every key;
//! [`DEFAULTS`] is the same list as a file.
//!
//! Knows nothing of handlers: their arguments stay a [`Node`], which they read themselves.

#![allow(
    clippy::result_large_err,
    reason = "findings are made when an app is read, never on a path that repeats"
)]

mod app;
mod build;
mod de;
mod fields;
mod load;
mod node;
#[cfg(test)]
mod tests;

pub use app::{App, ChassisConfig, ProcessorConfig, TaskConfig, TimeMode};
pub use node::{Entry, Node, Value};

use crate::diagnostic::{Findings, Place, Source};
use std::path::Path;

/// Every key with its default and what it means, as a TOML text.
pub const DEFAULTS: &str = include_str!("config/defaults.toml");

/// Makes tasks out of a top-level table of its own, for example the vision tasks out of the list
/// of services in `[vss]`.
pub trait Expander {
    /// Checks the table and returns its tasks; whatever is wrong goes to `findings`.
    fn expand(&self, table: &Node, findings: &mut Findings) -> Vec<GeneratedTask>;
}

/// A task made by an [`Expander`].
#[derive(Debug, Clone, PartialEq)]
pub struct GeneratedTask {
    /// Its symbolic name.
    pub name: String,
    /// The handler's registered name.
    pub handler: String,
    /// `CHASSIS` or `CHASSIS/PROCESSOR`.
    pub on: String,
    /// What the handler gets as its arguments.
    pub args: Node,
    /// The part of the file that it was made from; findings about the task point there.
    pub place: Place,
}

/// Reads an app from its file, everything that file includes, and `--set` texts.
///
/// The same `file` and `sets` make the same app in any process, so a child process of an app is
/// given these two and reads them again. `expanders` are the top-level tables other than the
/// runtime's own, each with what turns it into tasks.
///
/// # Errors
/// Everything wrong, errors and warnings together. When there are only warnings, the app is
/// returned and holds them.
pub fn load(
    file: &Path,
    sets: &[String],
    expanders: &[(&'static str, &dyn Expander)],
) -> Result<App, Findings> {
    load_from(&load::Disk, file, sets, expanders)
}

/// As [`load`], from texts in memory given as `(path, text)`; the first is the app's file, and
/// includes find the others by their paths.
///
/// # Errors
/// As [`load`].
pub fn load_texts(
    texts: &[(&str, &str)],
    sets: &[String],
    expanders: &[(&'static str, &dyn Expander)],
) -> Result<App, Findings> {
    let file = texts.first().map_or("", |(name, _)| *name);
    load_from(&load::Texts(texts), Path::new(file), sets, expanders)
}

fn load_from(
    files: &dyn load::Files,
    file: &Path,
    sets: &[String],
    expanders: &[(&'static str, &dyn Expander)],
) -> Result<App, Findings> {
    let mut findings = Findings::new();
    let Some(root) = load::merged(files, file, sets, &mut findings) else {
        return Err(findings);
    };
    // What does not parse would only bring findings that are not the person's mistakes.
    if findings.has_errors() {
        return Err(findings);
    }
    let place = root.place().cloned();
    let place = place.unwrap_or_else(|| Source::new(file.display().to_string(), "").at(0..0));
    let origin = build::Origin {
        file: file.to_owned(),
        sets: sets.to_vec(),
        place,
    };
    let mut app = build::build(root, origin, expanders, &mut findings);
    if findings.has_errors() {
        return Err(findings);
    }
    app.warnings = findings;
    Ok(app)
}
