//! From files, profiles and `--set` texts to one merged tree: default < include < file < profile <
//! `--set`.
//!
//! Knows `include`, `app.profile` and `--set`; every other key is left to
//! [`build`](super::build).

use super::keys;
use super::node::{Node, Value};
use super::profiles::{Chosen, Profiles};
use super::variables::{self, Used};
use crate::diagnostic::{Finding, Findings, Place, Source};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};

/// The name of the source of a `--set` text.
pub(super) const SET: &str = "--set";

/// Where files and environment variables come from: the system, or texts held in memory.
pub(super) trait Files {
    /// The value of an environment variable.
    fn variable(&self, name: &str) -> Option<OsString>;
    /// Reads a file.
    fn read(&self, path: &Path) -> Result<Source, Finding>;
    /// What makes two paths the same file.
    fn identity(&self, path: &Path) -> PathBuf;
}

/// The file system.
pub(super) struct Disk;

impl Files for Disk {
    fn variable(&self, name: &str) -> Option<OsString> {
        std::env::var_os(name)
    }

    fn read(&self, path: &Path) -> Result<Source, Finding> {
        Source::read(path)
    }

    fn identity(&self, path: &Path) -> PathBuf {
        path.canonicalize().unwrap_or_else(|_| lexical(path))
    }
}

/// Texts in memory, by path, and the environment variables there are.
pub(super) struct Texts<'a>(
    pub(super) &'a [(&'a str, &'a str)],
    pub(super) &'a BTreeMap<String, String>,
);

impl Files for Texts<'_> {
    fn variable(&self, name: &str) -> Option<OsString> {
        self.1.get(name).map(OsString::from)
    }

    fn read(&self, path: &Path) -> Result<Source, Finding> {
        let wanted = lexical(path);
        let mut texts = self.0.iter();
        match texts.find(|(name, _)| lexical(Path::new(name)) == wanted) {
            Some((name, text)) => Ok(Source::new(*name, *text)),
            None => Err(Finding::unreadable(path, &"no such text")),
        }
    }

    fn identity(&self, path: &Path) -> PathBuf {
        lexical(path)
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
    pub(super) profiles: Profiles,
    /// The names of those chosen, the later ones on top.
    pub(super) applied: Vec<String>,
    /// Every file that was read.
    pub(super) sources: Vec<Read>,
    /// The environment variables that were asked for.
    pub(super) used: Used,
}

/// A file that was read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Read {
    /// Its path as it was put together.
    pub(super) path: PathBuf,
    /// Its text.
    pub(super) text: String,
    /// Whether another file names it by an absolute path.
    pub(super) absolute: bool,
}

/// Reads `file` with everything it includes and lays the profiles and the `--set` texts on top.
/// Without `profiles`, `app.profile` chooses one.
pub(super) fn merged(
    files: &dyn Files,
    file: &Path,
    profiles: &[String],
    sets: &[String],
    findings: &mut Findings,
) -> Option<Merged> {
    let mut loader = Loader {
        files,
        findings,
        chain: Vec::new(),
        done: Vec::new(),
        sources: Vec::new(),
        used: Used::new(),
    };
    let mut root = loader.file(file, None)?;
    let (sources, mut used) = (loader.sources, loader.used);
    let declared = Profiles::read(root.take("profile"), findings);
    let in_file = profile_of_file(&mut root, files, &mut used, findings);
    let chosen: Vec<Chosen> = if profiles.is_empty() {
        in_file.into_iter().collect()
    } else {
        let named = profiles.iter().map(String::as_str);
        named.map(Chosen::on_command_line).collect()
    };
    let bare = root.clone();
    for choice in &chosen {
        if let Some(profile) = findings.keep(declared.find(choice)) {
            profile.lay_over(&mut root, findings);
        }
    }
    for set in sets {
        apply_set(&mut root, set, findings);
    }
    // Only now, so that a variable counts only where its value does; what a shell hands over in
    // `--set` has been expanded there.
    let from_file = |place: &Place| place.source.name() != SET;
    variables::expand(&mut root, files, &mut used, findings, &from_file);
    Some(Merged {
        root,
        bare,
        profiles: declared,
        applied: chosen.into_iter().map(|choice| choice.name).collect(),
        sources,
        used,
    })
}

/// Takes `app.profile` out of the tree.
fn profile_of_file(
    root: &mut Node,
    files: &dyn Files,
    used: &mut Used,
    findings: &mut Findings,
) -> Option<Chosen> {
    let entry = root.inner("app")?.take("profile")?;
    let (name, place) = (entry.value.as_str(), entry.value.place());
    match (name, place) {
        (Some(name), Some(place)) if !name.is_empty() => {
            let name = variables::whole(name, place, files, used, findings)?;
            Some(Chosen::in_file(name, place.clone()))
        }
        _ => {
            let text = "[app]: `profile` must be the name of a profile";
            let finding = Finding::error("ctos::config::value", text);
            findings.push(finding.at(place.cloned()));
            None
        }
    }
}

struct Loader<'a> {
    files: &'a dyn Files,
    findings: &'a mut Findings,
    /// The files being read now, outermost first: identity and the name shown.
    chain: Vec<(PathBuf, String)>,
    /// Files already merged. One that is reached twice counts where it was reached first, so that
    /// a common file does not undo what another included file says on top of it.
    done: Vec<PathBuf>,
    /// Every file that was read.
    sources: Vec<Read>,
    /// The variables in paths of `include`.
    used: Used,
}

impl Loader<'_> {
    fn file(&mut self, path: &Path, named_at: Option<&Place>) -> Option<Node> {
        let identity = self.files.identity(path);
        if let Some(start) = self.chain.iter().position(|(open, _)| *open == identity) {
            self.cyclic(start, path, named_at);
            return None;
        }
        if self.done.contains(&identity) {
            return None;
        }
        let read = self.files.read(path);
        let read = read.map_err(|finding| finding.at(named_at.cloned()));
        let source = self.findings.keep(read)?;
        self.sources.push(Read {
            path: path.to_owned(),
            text: source.text().to_owned(),
            absolute: false,
        });
        let mut own = Node::from_toml(&source, self.findings);
        self.chain
            .push((identity.clone(), source.name().to_owned()));
        let mut root = Node::table();
        for (include, place) in self.includes(&mut own) {
            let folder = path.parent().unwrap_or(Path::new(""));
            let absolute = Path::new(&include).is_absolute();
            let next = self.sources.len();
            if let Some(included) = self.file(&folder.join(include), Some(&place)) {
                root.merge(included);
            }
            if let Some(read) = self.sources.get_mut(next) {
                read.absolute = absolute;
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
        let wrong = |node: &Node| {
            let text = format!("`include` is a list of paths, found {}", node.kind());
            let finding = Finding::error("ctos::config::include", text)
                .help("write include = [\"common.toml\"]");
            finding.at(node.place().cloned())
        };
        if !matches!(list.value(), Value::Array(_)) {
            self.findings.push(wrong(&list));
        }
        for element in list.elements() {
            match (element.as_str(), element.place()) {
                (Some(path), Some(place)) => {
                    let (files, used) = (self.files, &mut self.used);
                    let path = variables::whole(path, place, files, used, self.findings);
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
        let (left, right) = text.split_at(at);
        Some((set_path(left)?, left, right.strip_prefix('=')?))
    });
    let (mut keys, left, right) = split.ok_or_else(|| usage("the part before `=` is not a key"))?;
    if let [(key, _)] = keys.as_slice()
        && keys::names("app").any(|known| known == key)
    {
        // One word names a key of `[app]`: `--set seed=7`.
        keys.insert(0, ("app".to_owned(), 0..left.len()));
    }
    if matches!(keys.first(), Some((key, _)) if key == "include") {
        return Err(usage("`include` cannot be set from outside the files"));
    }
    let names: Vec<&str> = keys.iter().map(|(key, _)| key.as_str()).collect();
    if matches!(names.as_slice(), ["profile", ..] | ["app", "profile"]) {
        let finding = usage("profiles are chosen before `--set` is read");
        return Err(
            finding.help("write --profile NAME to choose one; --set overrides what it says")
        );
    }
    let trimmed = right.trim();
    if trimmed.is_empty() {
        return Err(usage("the value is missing (an empty text is \"\")"));
    }
    let start = text.len() - right.trim_start().len();
    let value = set_value(source, start..start + trimmed.len())?;
    let keys = keys.into_iter().map(|(key, range)| (key, source.at(range)));
    Ok(Node::nested(keys.collect(), value))
}

/// A dotted TOML key with the byte range of each part, or `None` when it is not one.
fn set_path(left: &str) -> Option<Vec<(String, std::ops::Range<usize>)>> {
    if left.chars().any(char::is_control) {
        return None;
    }
    let document = format!("{left} = 0");
    let table = toml::de::DeTable::parse(&document).ok()?;
    let mut keys = Vec::new();
    let mut at = table.get_ref();
    loop {
        let (key, value) = at.iter().next()?;
        keys.push((key.get_ref().to_string(), key.span()));
        match value.get_ref() {
            toml::de::DeValue::Table(inner) => at = inner,
            _ => return Some(keys),
        }
    }
}

/// A TOML value; text that is none and does not begin like one is taken as a string.
fn set_value(source: &Source, range: std::ops::Range<usize>) -> Result<Node, Finding> {
    let text = &source.text()[range.clone()];
    match Node::from_toml_value(source, range.clone()) {
        Ok(node) => Ok(node),
        Err(finding)
            if finding.code != "ctos::config::syntax"
                || text.starts_with(['[', '{', '"', '\'']) =>
        {
            Err(finding)
        }
        Err(_) => {
            let mut node = Node::from(text);
            node.place = Some(source.at(range));
            Ok(node)
        }
    }
}
