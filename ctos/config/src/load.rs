//! From files, profiles and `--set` texts to one merged tree: default < include < file < profile <
//! `--set`.
//!
//! Knows `include`, `app.profile` and `--set`; every other key is left to
//! [`build`](super::build).

use super::keys;
use super::node::{Entry, Node, Value};
use super::profiles::{Chosen, chosen, declared, lay_over, on_command_line};
use super::selection::Selection;
use super::trail::{Read, Trail};
use super::variables::Variables;
use crate::diagnostic::{Finding, Findings, Place, Source};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::iter::successors;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex};

/// The name of the source of a `--set` text.
pub(super) const SET: &str = "--set";

/// Where files and environment variables come from.
#[derive(Clone, Copy)]
pub(super) enum Files<'a> {
    /// The system.
    Disk,
    /// Texts in memory, by path, and the environment variables there are.
    Texts(&'a [(&'a str, &'a str)], &'a BTreeMap<String, String>),
}

impl Files<'_> {
    /// The value of an environment variable.
    pub(super) fn variable(self, name: &str) -> Option<OsString> {
        match self {
            Self::Disk => std::env::var_os(name),
            Self::Texts(_, variables) => variables.get(name).map(OsString::from),
        }
    }

    /// Reads a file.
    fn read(self, path: &Path) -> Result<Source, Finding> {
        let Self::Texts(texts, _) = self else {
            return Source::read(path);
        };
        let mut texts = texts.iter();
        let found = texts.find(|(name, _)| lexical(Path::new(name)) == lexical(path));
        let found = found.map(|(name, text)| Source::new(*name, *text));
        found.ok_or_else(|| Finding::unreadable(path, &"no such text"))
    }

    /// What makes two paths the same file.
    fn identity(self, path: &Path) -> PathBuf {
        match self {
            Self::Disk => path.canonicalize().unwrap_or_else(|_| lexical(path)),
            Self::Texts(..) => lexical(path),
        }
    }
}

/// Removes `.` and resolves `..` without asking the file system.
pub(super) fn lexical(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir
                if matches!(out.components().next_back(), Some(Component::Normal(_))) =>
            {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}

/// The merged tree, and all that went into it.
pub(super) struct Merged {
    /// What is left: no `include`, no profiles, every reference to a variable replaced.
    pub(super) root: Node,
    /// The same without any profile.
    pub(super) bare: Node,
    /// All profiles, chosen or not.
    pub(super) profiles: Vec<Entry>,
    /// What it was made of.
    pub(super) trail: Trail,
}

/// Reads the file with everything it includes and lays the profiles and the `--set` texts on top.
/// Without profiles, `app.profile` chooses one.
pub(super) fn merged(
    files: Files<'_>,
    selection: &Selection,
    findings: &mut Findings,
) -> Option<Merged> {
    let mut loader = Loader {
        variables: Variables::of(files),
        findings,
        chain: Vec::new(),
        done: Vec::new(),
        sources: Vec::new(),
    };
    let mut root = loader.file(&selection.file, None, false)?;
    let (sources, mut variables) = (loader.sources, loader.variables);
    let folders = sources.iter().filter_map(|(path, _)| path.parent());
    let folders = folders.map(Path::to_owned).collect();
    let profiles = declared(root.take("profile"), findings);
    let in_file = profile_of_file(&mut root, &mut variables, findings);
    let asked = selection.profiles.iter().map(|name| on_command_line(name));
    let mut asked: Vec<Chosen> = asked.collect();
    if asked.is_empty() {
        asked.extend(in_file);
    }
    let bare = root.clone();
    let mut applied = Vec::new();
    for choice in &asked {
        if let Some(profile) = findings.keep(chosen(choice, &profiles)) {
            lay_over(profile, &mut root, findings);
            applied.push(profile.clone());
        }
    }
    for set in &selection.sets {
        apply_set(&mut root, set, findings);
    }
    // Only now, so that a variable counts only where its value does; what a shell hands over in
    // `--set` has been expanded there.
    variables.expand(&mut root, findings, &|place| place.source.name() != SET);
    Some(Merged {
        root,
        bare,
        profiles,
        trail: Trail {
            used: variables.used,
            folders,
            applied,
            read: Arc::new(Mutex::new(sources.into_iter().collect())),
        },
    })
}

/// Takes `app.profile` out of the tree.
fn profile_of_file(
    root: &mut Node,
    variables: &mut Variables<'_>,
    findings: &mut Findings,
) -> Option<Chosen> {
    let entry = root.inner("app")?.take("profile")?;
    match (entry.value.as_str(), entry.value.place.clone()) {
        (Some(name), Some(place)) if !name.is_empty() => {
            let name = variables.expanded(name, Some(&place), findings)?;
            Some((name, place))
        }
        (_, place) => {
            let text = "[app]: `profile` must be the name of a profile";
            findings.push(Finding::error("ctos::config::value", text).at(place));
            None
        }
    }
}

struct Loader<'v, 'f> {
    variables: Variables<'v>,
    findings: &'f mut Findings,
    /// The files being read now, outermost first: identity and the name shown.
    chain: Vec<(PathBuf, String)>,
    /// Files already merged. One that is reached twice counts where it was reached first. So a
    /// common file does not undo what another included file says on top of it.
    done: Vec<PathBuf>,
    /// Every file that was read.
    sources: Vec<(PathBuf, Read)>,
}

impl Loader<'_, '_> {
    /// Reads a file that stands at `named_at` in another one, there by an absolute path or not.
    fn file(&mut self, path: &Path, named_at: Option<&Place>, absolute: bool) -> Option<Node> {
        let identity = self.variables.files.identity(path);
        if let Some(start) = self.chain.iter().position(|(open, _)| *open == identity) {
            self.cyclic(start, path, named_at);
            return None;
        }
        if self.done.contains(&identity) {
            return None;
        }
        let read = self.variables.files.read(path);
        let read = read.map_err(|finding| finding.at(named_at.cloned()));
        let source = self.findings.keep(read)?;
        let read = Read {
            text: source.text().to_owned(),
            absolute,
        };
        self.sources.push((path.to_owned(), read));
        let mut own = Node::from_toml(&source, self.findings);
        self.chain
            .push((identity.clone(), source.name().to_owned()));
        let mut root = Node::table();
        for (include, place) in self.includes(&mut own) {
            let folder = path.parent().unwrap_or(Path::new(""));
            let absolute = Path::new(&include).is_absolute();
            if let Some(included) = self.file(&folder.join(include), Some(&place), absolute) {
                root.merge(included);
            }
        }
        self.chain.pop();
        self.done.push(identity);
        root.place.clone_from(&own.place);
        root.merge(own);
        Some(root)
    }

    /// Takes `include` out of a file and returns its paths.
    fn includes(&mut self, own: &mut Node) -> Vec<(String, Place)> {
        let Some(entry) = own.take("include") else {
            return Vec::new();
        };
        let mut paths = Vec::new();
        let list = entry.value;
        let what = "`include` is a list of paths";
        let help = "write include = [\"common.toml\"]";
        let wrong = |node: &Node| node.is_no("ctos::config::include", what, help);
        if !matches!(list.value(), Value::Array(_)) {
            self.findings.push(wrong(&list));
        }
        for element in list.elements() {
            match (element.as_str(), element.place()) {
                (Some(path), Some(place)) => {
                    let path = self.variables.expanded(path, Some(place), self.findings);
                    paths.extend(path.map(|path| (path, place.clone())));
                }
                _ => self.findings.push(wrong(element)),
            }
        }
        paths
    }

    fn cyclic(&mut self, start: usize, path: &Path, named_at: Option<&Place>) {
        let chain = self.chain.iter().skip(start);
        let mut names: Vec<&str> = chain.map(|(_, name)| name.as_str()).collect();
        let again = path.display().to_string();
        names.push(names.first().copied().unwrap_or(&again));
        let circle = names.join(" -> ");
        let text = format!("files include each other in a circle: {circle}");
        let finding = Finding::error("ctos::config::include_cycle", text)
            .label("this closes the circle")
            .help("move what both need into a third file that includes neither");
        self.findings.push(finding.at(named_at.cloned()));
    }
}

/// Lays one `a.b.c=value` over the tree. Its places point into a source named `--set`.
fn apply_set(root: &mut Node, text: &str, findings: &mut Findings) {
    let source = Source::new(SET, text);
    let Some(over) = findings.keep(parse_set(&source)) else {
        return;
    };
    match unknown_name(root, &over) {
        Some(finding) => findings.push(finding),
        None => root.merge(over),
    }
}

/// `--set task.NAME.key=...` changes a task that exists; a new name would be a typing error that
/// makes half a task. (A whole table, `--set task.NAME={...}`, does add one.)
fn unknown_name(root: &Node, over: &Node) -> Option<Finding> {
    let kind = over.entries().first()?;
    if kind.key != "task" && kind.key != "chassis" {
        return None;
    }
    let name = kind.value.entries().first()?;
    let whole = name.key_place != name.value.place;
    let there = root.tables(&kind.key);
    if whole || there.iter().any(|entry| entry.key == name.key) {
        return None;
    }
    let text = format!("there is no {} called `{}`", kind.key, name.key);
    let finding = Finding::error("ctos::config::unknown_name", text)
        .suggest(&name.key, there.iter().map(|entry| entry.key.as_str()));
    Some(finding.at(name.key_place.clone()))
}

fn parse_set(source: &Source) -> Result<Node, Finding> {
    let text = source.text();
    let usage = |what: &str| {
        Finding::error("ctos::config::set", format!("`--set {text}`: {what}"))
            .at(source.at(0..text.len()))
            .help("write --set path.to.key=value, for example --set time.mode=virtual")
    };
    if !text.contains('=') {
        return Err(usage("there is no `=`"));
    }
    // Not one in a quoted key: what stands before it would be none.
    let split = text.match_indices('=').find_map(|(at, _)| {
        let tables = Node::from_toml_key(source, at)?;
        Some((tables, at, text.get(at + 1..)?))
    });
    let (mut over, at, right) = split.ok_or_else(|| usage("the part before `=` is not a key"))?;
    let parts = successors(over.entries().first(), |entry| {
        entry.value.entries().first()
    });
    let names: Vec<&str> = parts.map(|entry| entry.key.as_str()).collect();
    match names.as_slice() {
        ["include", ..] => return Err(usage("`include` cannot be set from outside the files")),
        ["profile", ..] | ["app", "profile"] => {
            let finding = usage("profiles are chosen before `--set` is read");
            let help = "write --profile NAME to choose one; --set overrides what it says";
            return Err(finding.help(help));
        }
        // One word names a key of `[app]`: `--set seed=7`.
        [key] if keys::names("app").any(|known| known == *key) => {
            over = Node::table().with("app", over).placed(&source.at(0..at));
        }
        _ => {}
    }
    let trimmed = right.trim();
    if trimmed.is_empty() {
        return Err(usage("the value is missing (an empty text is \"\")"));
    }
    let start = text.len() - right.trim_start().len();
    over.fill(set_value(source, start..start + trimmed.len())?);
    Ok(over)
}

/// A TOML value; text that is none and does not begin like one is taken as a string.
fn set_value(source: &Source, range: Range<usize>) -> Result<Node, Finding> {
    let text = &source.text()[range.clone()];
    match Node::from_toml_value(source, range.clone()) {
        Err(finding)
            if finding.code == "ctos::config::syntax"
                && !text.starts_with(['[', '{', '"', '\'']) =>
        {
            Ok(Node::from(text).placed(&source.at(range)))
        }
        read => read,
    }
}

impl Node {
    /// Puts a value in place of the innermost one of nested tables.
    fn fill(&mut self, value: Self) {
        match &mut self.value {
            Value::Table(entries) => {
                for entry in entries {
                    entry.value.fill(value.clone());
                }
            }
            _ => *self = value,
        }
    }
}
