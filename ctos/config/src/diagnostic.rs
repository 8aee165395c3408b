//! What is wrong in a file a person wrote, and where: findings with file, line and column.
//!
//! Every parser and checker of the workspace (configuration, nets, position files) reports through
//! [`Findings`]. So one run of `ctos check` shows all of them, in order of place, in one form.

use std::{
    fmt,
    ops::Range,
    path::Path,
    sync::{Arc, OnceLock},
};

/// A text that findings point into, with the name a person knows it by (its path as given).
#[derive(Clone)]
pub struct Source(Arc<Written>);

/// What all places in one text share.
struct Written {
    name: Arc<str>,
    text: Arc<str>,
    /// Where each line begins; found when the first place is shown, so that the others need not be counted up to.
    lines: OnceLock<Vec<usize>>,
}

impl PartialEq for Source {
    fn eq(&self, other: &Self) -> bool {
        let same = || self.0.name == other.0.name && self.0.text == other.0.text;
        Arc::ptr_eq(&self.0, &other.0) || same()
    }
}

impl Eq for Source {}

impl fmt::Debug for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Source")
            .field("name", &self.0.name)
            .field("text", &self.0.text)
            .finish()
    }
}

impl Source {
    /// A source called `name` that holds `text`.
    #[must_use]
    pub fn new(name: impl Into<Arc<str>>, text: impl Into<Arc<str>>) -> Self {
        Self(Arc::new(Written {
            name: name.into(),
            text: text.into(),
            lines: OnceLock::new(),
        }))
    }

    /// Reads a file.
    ///
    /// # Errors
    /// A finding that names the file when it cannot be read or is not UTF-8.
    pub fn read(path: &Path) -> Result<Self, Finding> {
        let bytes = std::fs::read(path).map_err(|error| Finding::unreadable(path, &error))?;
        let name = path.display().to_string();
        match String::from_utf8(bytes) {
            Ok(text) => Ok(Self::new(name, text)),
            Err(error) => {
                let at = error.utf8_error().valid_up_to();
                let text = format!("`{name}` is not UTF-8 text (byte {at})");
                Err(Finding::error("ctos::file::not_text", text))
            }
        }
    }

    /// The name given at creation, usually a path.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// The whole text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.0.text
    }

    /// Line and column of a byte offset, both counted from 1, columns in characters.
    #[must_use]
    pub fn line_column(&self, offset: usize) -> (usize, usize) {
        let text = self.text();
        let mut end = offset.min(text.len());
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let lines = self.lines();
        let line = lines.partition_point(|start| *start <= end);
        let start = line.checked_sub(1).and_then(|line| lines.get(line));
        let before = &text[start.copied().unwrap_or(0)..end];
        (line, before.chars().count() + 1)
    }

    /// Where each line begins.
    fn lines(&self) -> &[usize] {
        self.0.lines.get_or_init(|| {
            let ends = self.text().match_indices('\n');
            std::iter::once(0)
                .chain(ends.map(|(at, _)| at + 1))
                .collect()
        })
    }

    /// A place in this source.
    #[must_use]
    pub fn at(&self, range: Range<usize>) -> Place {
        Place {
            source: self.clone(),
            range,
        }
    }

    /// The place of a whole line, counted from 1.
    #[must_use]
    pub fn at_line(&self, line: usize) -> Place {
        let start = self.lines().get(line.wrapping_sub(1)).copied();
        let start = start.unwrap_or(self.text().len());
        let text = self.text()[start..].split('\n').next().unwrap_or_default();
        self.at(start..start + text.trim_end().len())
    }
}

/// A byte range of a [`Source`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The text pointed into.
    pub source: Source,
    /// Byte offsets, end excluded.
    pub range: Range<usize>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (line, column) = self.source.line_column(self.range.start);
        write!(f, "{}:{line}:{column}", self.source.name())
    }
}

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Worth knowing; nothing stops.
    Warning,
    /// The app must not start.
    Error,
}

/// One thing wrong: what, where, and what to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Stable code, for example `ctos::config::unknown_handler`.
    pub code: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What is wrong: a lowercase fragment that reads well after "error: ".
    pub message: String,
    /// Where, when it is in a file.
    pub place: Option<Place>,
    /// What to say at the place itself; empty for "here".
    pub label: String,
    /// What to do about it.
    pub help: Option<String>,
}

impl Finding {
    /// An error.
    #[must_use]
    pub fn error(code: &'static str, message: impl Into<String>) -> Self {
        Self {
            code,
            severity: Severity::Error,
            message: message.into(),
            place: None,
            label: String::new(),
            help: None,
        }
    }

    /// A warning.
    #[must_use]
    pub fn warning(code: &'static str, message: impl Into<String>) -> Self {
        Self {
            severity: Severity::Warning,
            ..Self::error(code, message)
        }
    }

    /// A file that cannot be read.
    pub(crate) fn unreadable(path: &Path, error: &dyn fmt::Display) -> Self {
        let text = format!("cannot read `{}`: {error}", path.display());
        Self::error("ctos::file::unreadable", text)
            .help("check the path; it is taken relative to the file that names it")
    }

    /// Adds where it is, where that is known.
    #[must_use]
    pub fn at(mut self, place: impl Into<Option<Place>>) -> Self {
        self.place = place.into().or(self.place);
        self
    }

    /// Adds the words shown at the place.
    #[must_use]
    pub fn label(mut self, label: impl Into<String>) -> Self {
        self.label = label.into();
        self
    }

    /// Adds what to do.
    #[must_use]
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Adds "did you mean `x`?" when one of `known` is close to `given`, else lists what is known. Of a long
    /// list it names only the nearest.
    #[must_use]
    pub fn suggest<'a>(self, given: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        self.suggest_of(given, known.into_iter().collect())
    }

    fn suggest_of(self, given: &str, mut names: Vec<&str>) -> Self {
        /// More than these nobody reads.
        const LISTED: usize = 24;
        /// So many of a longer list.
        const NEAREST: usize = 6;
        names.sort_by_cached_key(|name| (distance(given, name), *name));
        let Some(best) = names.first() else {
            return self;
        };
        if is_near(given, best) {
            return self.help(format!("did you mean `{best}`?"));
        }
        if names.len() > LISTED {
            let nearest = names[..NEAREST].join(", ");
            return self.help(format!("nearest of {} known here: {nearest}", names.len()));
        }
        names.sort_unstable();
        self.help(format!("known here: {}", names.join(", ")))
    }
}

/// The one of `known` that was probably meant by `given`.
#[must_use]
pub fn nearest<'a>(given: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let known = known.into_iter();
    let best = known.min_by_key(|name| (distance(given, name), *name))?;
    is_near(given, best).then_some(best)
}

/// How many letters are wrong. Whoever wrote the beginning of a name meant that name.
fn distance(given: &str, name: &str) -> usize {
    /// A shorter one begins too many names.
    const BEGINNING: usize = 3;
    match given.len() >= BEGINNING && name.starts_with(given) && name != given {
        true => 1,
        false => strsim::damerau_levenshtein(given, name),
    }
}

fn is_near(given: &str, name: &str) -> bool {
    distance(given, name) <= 1 + given.chars().count() / 3
}

impl fmt::Display for Finding {
    /// One line, `file:line:column: error: message (help)`, for logs and for replies.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(place) = &self.place {
            write!(f, "{place}: ")?;
        }
        let kind = match self.severity {
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        write!(f, "{kind}: {}", self.message)?;
        if let Some(help) = &self.help {
            write!(f, " ({help})")?;
        }
        Ok(())
    }
}

impl std::error::Error for Finding {}

/// All findings of one look at an app.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Findings {
    list: Vec<Finding>,
}

impl Findings {
    /// None yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one. A finding that is here already is not added again: several tasks may read the same file.
    pub fn push(&mut self, finding: Finding) {
        if !self.list.contains(&finding) {
            self.list.push(finding);
        }
    }

    /// Adds all of another list.
    pub fn extend(&mut self, other: Self) {
        for finding in other.list {
            self.push(finding);
        }
    }

    /// Keeps the value of a result and adds its finding.
    pub fn keep<T>(&mut self, result: Result<T, Finding>) -> Option<T> {
        result.map_err(|finding| self.push(finding)).ok()
    }

    /// Whether nothing at all was found.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Whether one of them is an error.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        let mut severities = self.list.iter().map(|finding| finding.severity);
        severities.any(|severity| severity == Severity::Error)
    }

    /// The findings, sorted by file and place.
    #[must_use]
    pub fn into_sorted(mut self) -> Vec<Finding> {
        self.list.sort_by_key(|finding| {
            let place = finding.place.as_ref()?;
            Some((place.source.0.name.clone(), place.range.start))
        });
        self.list
    }

    /// The findings, in the order in which they were made.
    pub fn iter(&self) -> impl Iterator<Item = &Finding> {
        self.list.iter()
    }
}

impl From<Finding> for Findings {
    fn from(finding: Finding) -> Self {
        Self {
            list: vec![finding],
        }
    }
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.list.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for Findings {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_shown_as_file_line_and_column_counted_in_characters() {
        let source = Source::new("a.toml", "x = 1\nä = 2\n");
        let offset = source.text().find("= 2").unwrap();
        assert_eq!(source.at(offset..offset + 1).to_string(), "a.toml:2:3");
    }

    #[test]
    fn the_lines_of_a_text_are_looked_for_once_for_all_places_in_it() {
        let source = Source::new("a.toml", "a = 1\n".repeat(1000));
        let (first, last) = (source.at(0..1), source.clone().at(5994..5995));
        assert_eq!(source.0.lines.get(), None);
        assert_eq!(last.to_string(), "a.toml:1000:1");
        assert_eq!(source.0.lines.get().map(Vec::len), Some(1001));
        assert!(Arc::ptr_eq(&first.source.0, &last.source.0));
    }

    proptest::proptest! {
        #[test]
        fn line_and_column_are_those_of_a_walk_through_the_text(text in "[aä\n]{0,40}", offset in 0..99_usize) {
            let mut walked = (1, 1);
            let before = text.char_indices().take_while(|(at, one)| at + one.len_utf8() <= offset);
            for (_, one) in before {
                walked = if one == '\n' { (walked.0 + 1, 1) } else { (walked.0, walked.1 + 1) };
            }
            let source = Source::new("a", text.as_str());
            proptest::prop_assert_eq!(source.line_column(offset), walked);
            let starts = text.split('\n').next_back().map(|last| text.len() - last.len());
            let last = text.split('\n').count();
            proptest::prop_assert_eq!(Some(source.at_line(last).range.start), starts);
        }
    }

    #[test]
    fn a_close_name_is_suggested_and_a_far_one_lists_what_is_known() {
        let close = Finding::error("t", "unknown").suggest("camrea", ["camera", "arm"]);
        assert_eq!(close.help.as_deref(), Some("did you mean `camera`?"));
        let begun = Finding::error("a::b", "m").suggest("-lim", ["-arm", "-limits", "-turns"]);
        assert_eq!(begun.help.as_deref(), Some("did you mean `-limits`?"));
        let far = Finding::error("t", "unknown").suggest("zzz", ["camera", "arm"]);
        assert_eq!(far.help.as_deref(), Some("known here: arm, camera"));
    }

    #[test]
    fn of_a_long_list_only_what_is_nearest_is_told() {
        let known: Vec<String> = (10..99).map(|number| format!("camera{number}")).collect();
        let far = Finding::error("t", "unknown").suggest("zzz", known.iter().map(String::as_str));
        let help = far.help.unwrap();
        assert!(
            help.starts_with("nearest of 89 known here: camera"),
            "{help}"
        );
        assert!(help.len() < 120, "{help}");
    }

    #[test]
    fn the_same_finding_made_twice_is_kept_once() {
        let read = || Source::new("a", "one two");
        let mut findings = Findings::new();
        findings.push(Finding::error("t", "wrong").at(read().at(0..3)));
        findings.extend(Finding::error("t", "wrong").at(read().at(0..3)).into());
        findings.push(Finding::error("t", "wrong").at(read().at(4..7)));
        assert_eq!(findings.iter().count(), 2);
    }

    #[test]
    fn findings_come_sorted_by_place() {
        let source = Source::new("a", "one two");
        let mut findings = Findings::new();
        findings.push(Finding::error("t", "second").at(source.at(4..7)));
        findings.push(Finding::warning("t", "first").at(source.at(0..3)));
        let sorted = findings.into_sorted();
        assert_eq!(sorted[0].message, "first");
    }
}
