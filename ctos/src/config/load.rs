//! From files and `--set` texts to one merged tree: default < include < file < `--set`.
//!
//! Knows `include` and `--set`; every other key is left to [`build`](super::build).

use super::node::Node;
use crate::diagnostic::{Finding, Findings, Place, Source};
use std::path::{Component, Path, PathBuf};

/// Where files come from: the file system, or texts held in memory.
pub(super) trait Files {
    /// Reads a file.
    fn read(&self, path: &Path) -> Result<Source, Finding>;
    /// What makes two paths the same file.
    fn identity(&self, path: &Path) -> PathBuf;
}

/// The file system.
pub(super) struct Disk;

impl Files for Disk {
    fn read(&self, path: &Path) -> Result<Source, Finding> {
        Source::read(path)
    }

    fn identity(&self, path: &Path) -> PathBuf {
        path.canonicalize().unwrap_or_else(|_| lexical(path))
    }
}

/// Texts in memory, by path.
pub(super) struct Texts<'a>(pub(super) &'a [(&'a str, &'a str)]);

impl Files for Texts<'_> {
    fn read(&self, path: &Path) -> Result<Source, Finding> {
        let wanted = lexical(path);
        match self
            .0
            .iter()
            .find(|(name, _)| lexical(Path::new(name)) == wanted)
        {
            Some((name, text)) => Ok(Source::new(*name, *text)),
            None => Err(Finding::error(
                "ctos::file::unreadable",
                format!("cannot read `{}`: no such text", path.display()),
            )
            .help("check the path; it is taken relative to the file that names it")),
        }
    }

    fn identity(&self, path: &Path) -> PathBuf {
        lexical(path)
    }
}

/// Removes `.` and resolves `..` without asking the file system.
fn lexical(path: &Path) -> PathBuf {
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

/// Reads `file` with everything it includes and lays the `--set` texts on top.
pub(super) fn merged(
    files: &dyn Files,
    file: &Path,
    sets: &[String],
    findings: &mut Findings,
) -> Option<Node> {
    let mut loader = Loader {
        files,
        findings,
        chain: Vec::new(),
        done: Vec::new(),
    };
    let mut root = loader.file(file, None)?;
    for set in sets {
        apply_set(&mut root, set, findings);
    }
    Some(root)
}

struct Loader<'a> {
    files: &'a dyn Files,
    findings: &'a mut Findings,
    /// The files being read now, outermost first: identity and the name shown.
    chain: Vec<(PathBuf, String)>,
    /// Files already merged. One that is reached twice counts where it was reached first, so that
    /// a common file does not undo what another included file says on top of it.
    done: Vec<PathBuf>,
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
        let source = match self.files.read(path) {
            Ok(source) => source,
            Err(finding) => {
                let finding = match named_at {
                    Some(place) => finding.at(place.clone()),
                    None => finding,
                };
                self.findings.push(finding);
                return None;
            }
        };
        let mut own = Node::from_toml(&source, self.findings);
        self.chain
            .push((identity.clone(), source.name().to_owned()));
        let mut root = Node::table();
        for (include, place) in self.includes(&mut own) {
            let folder = path.parent().unwrap_or(Path::new(""));
            if let Some(included) = self.file(&folder.join(include), Some(&place)) {
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
        let wrong = |node: &Node| {
            let finding = Finding::error(
                "ctos::config::include",
                format!("`include` is a list of paths, found {}", node.kind()),
            )
            .help("write include = [\"common.toml\"]");
            match node.place() {
                Some(place) => finding.at(place.clone()),
                None => finding,
            }
        };
        if !matches!(list.value(), super::Value::Array(_)) {
            self.findings.push(wrong(&list));
        }
        for element in list.elements() {
            match (element.as_str(), element.place()) {
                (Some(path), Some(place)) => paths.push((path.to_owned(), place.clone())),
                _ => self.findings.push(wrong(element)),
            }
        }
        paths
    }

    fn cyclic(&mut self, start: usize, path: &Path, named_at: Option<&Place>) {
        let mut names: Vec<&str> = self
            .chain
            .iter()
            .skip(start)
            .map(|(_, name)| name.as_str())
            .collect();
        let again = path.display().to_string();
        names.push(names.first().copied().unwrap_or(&again));
        let finding = Finding::error(
            "ctos::config::include_cycle",
            format!(
                "files include each other in a circle: {}",
                names.join(" -> ")
            ),
        )
        .label("this closes the circle")
        .help("move what both need into a third file that includes neither");
        self.findings.push(match named_at {
            Some(place) => finding.at(place.clone()),
            None => finding,
        });
    }
}

/// Lays one `a.b.c=value` over the tree. Its places point into a source named `--set`.
fn apply_set(root: &mut Node, text: &str, findings: &mut Findings) {
    let source = Source::new("--set", text);
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
    let there = root
        .entry(&kind.key)
        .map_or(&[][..], |entry| entry.value.entries());
    if whole || there.iter().any(|entry| entry.key == name.key) {
        return None;
    }
    let finding = Finding::error(
        "ctos::config::unknown_name",
        format!("there is no {} called `{}`", kind.key, name.key),
    )
    .suggest(&name.key, there.iter().map(|entry| entry.key.as_str()));
    Some(match &name.key_place {
        Some(place) => finding.at(place.clone()),
        None => finding,
    })
}

fn parse_set(source: &Source) -> Result<Node, Finding> {
    let text = source.text();
    let usage = |what: &str| {
        Finding::error("ctos::config::set", format!("`--set {text}`: {what}"))
            .at(source.at(0..text.len()))
            .help("write --set path.to.key=value, for example --set time.mode=virtual")
    };
    let equals = unquoted_equals(text).ok_or_else(|| usage("there is no `=`"))?;
    let (left, right) = (&text[..equals], &text[equals + 1..]);
    let mut keys = set_path(left).ok_or_else(|| usage("the part before `=` is not a key"))?;
    if let [(key, _)] = keys.as_slice()
        && super::build::APP_KEYS.contains(&key.as_str())
    {
        // One word names a key of `[app]`: `--set seed=7`.
        keys.insert(0, ("app".to_owned(), 0..left.len()));
    }
    if matches!(keys.first(), Some((key, _)) if key == "include") {
        return Err(usage("`include` cannot be set from outside the files"));
    }
    let trimmed = right.trim();
    if trimmed.is_empty() {
        return Err(usage("the value is missing (an empty text is \"\")"));
    }
    let start = equals + 1 + (right.len() - right.trim_start().len());
    let value = set_value(source, start..start + trimmed.len())?;
    let keys = keys.into_iter().map(|(key, range)| (key, source.at(range)));
    Ok(Node::nested(keys.collect(), value))
}

/// The first `=` that does not stand in a quoted key.
fn unquoted_equals(text: &str) -> Option<usize> {
    let mut quote = None;
    for (at, letter) in text.char_indices() {
        match (quote, letter) {
            (None, '=') => return Some(at),
            (None, '"' | '\'') => quote = Some(letter),
            (Some(open), _) if open == letter => quote = None,
            _ => {}
        }
    }
    None
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
