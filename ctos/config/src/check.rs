//! Holds the merged tree of an app against the list of keys. It reports all that is not as [`keys`] says, takes
//! wrong values out, and fills in the defaults.
//!
//! Knows what may stand where. What a value is for, and whether a name leads anywhere, is for [`build`](super::build)
//! to say.

use super::keys::{self, Key, Kind, PROCESSOR, TOP};
use super::node::{Entry, Node, Value};
use crate::diagnostic::{Finding, Findings, Source};
use crate::settings::is_name;
use std::net::SocketAddr;

/// The processor of a chassis that declares none.
const MAIN: &str = "main";

/// The tree as it counts: what is left of it is right by itself, and defaults stand in it without a place. The
/// tables `extra` belong to others.
pub(super) fn checked(mut root: Node, extra: &[&str], findings: &mut Findings) -> Node {
    Checker { extra, findings }.table(&mut root, TOP, "", "");
    root
}

/// The tree of an app that says nothing.
pub(super) fn defaults() -> Node {
    checked(Node::table(), &[], &mut Findings::new())
}

struct Checker<'a> {
    extra: &'a [&'a str],
    findings: &'a mut Findings,
}

impl Checker<'_> {
    /// Checks a table, called `what` in messages; `name` is that of a table that has one of its own.
    fn table(&mut self, node: &mut Node, path: &str, what: &str, name: &str) {
        let needs = node.is_table() && (!name.is_empty() || !node.entries().is_empty());
        if !node.is_table() {
            self.wrong(what, "expected a table of keys", node);
            node.value = Value::Table(Vec::new());
        }
        for key in keys::table(path) {
            if node.entry(key.name).is_some() {
                continue;
            }
            if let (true, Some(help)) = (needs, key.needed) {
                let text = format!("{what} has no `{}`", key.name);
                let finding = Finding::error("ctos::config::missing_key", text).help(help);
                self.findings.push(finding.at(node.place.clone()));
            }
            if let Some(default) = default(key, path) {
                node.set(key.name, default);
            }
        }
        if let Value::Table(entries) = &mut node.value {
            entries.retain_mut(|entry| self.entry(entry, path, what, name));
        }
    }

    /// Checks one key of a table, and says whether its value may stay.
    fn entry(&mut self, entry: &mut Entry, path: &str, what: &str, name: &str) -> bool {
        let extra = if path == TOP { self.extra } else { &[][..] };
        let mut known = keys::table(path).iter();
        let Some(key) = known.find(|key| key.name == entry.key) else {
            if !extra.contains(&entry.key.as_str()) {
                let place = match path {
                    TOP => "at the top level".to_owned(),
                    _ => format!("in {what}"),
                };
                let text = format!("unknown key `{}` {place}", entry.key);
                let finding = Finding::error("ctos::config::unknown_key", text)
                    .label("nobody reads this key")
                    .suggest(&entry.key, keys::names(path).chain(extra.iter().copied()));
                self.findings.push(finding.at(entry.key_place.clone()));
            }
            return true;
        };
        match (&key.kind, entry.value.as_str()) {
            (Kind::One(path), _) => self.table(&mut entry.value, path, &format!("[{path}]"), ""),
            (Kind::Named(path), _) => self.named(entry, path, what, name),
            (Kind::Choice(words), Some(text)) if !text.is_empty() && !words.contains(&text) => {
                let said = format!("{what}: unknown choice `{text}` for `{}`", key.name);
                let finding = Finding::error("ctos::config::unknown_choice", said);
                let finding = finding.suggest(text, words.iter().copied());
                self.findings.push(finding.at(entry.value.place.clone()));
                return false;
            }
            (kind, _) => {
                if let Some(expected) = misfit(kind, &entry.value) {
                    let expected = format!("`{}` must be {expected}", key.name);
                    self.wrong(what, &expected, &entry.value);
                    return false;
                }
            }
        }
        true
    }

    /// Checks the tables of `entry`; `owner` is what its own table is called.
    fn named(&mut self, entry: &mut Entry, path: &str, what: &str, owner: &str) {
        let is_processor = path == PROCESSOR;
        let kind = match path {
            PROCESSOR => "processor",
            _ => &entry.key,
        };
        if is_processor && !entry.value.is_table() {
            self.wrong(what, "`processors` must be a table", &entry.value);
        } else if is_processor && entry.value.entries().is_empty() {
            entry.value.set(MAIN, Node::table());
        } else if !entry.value.is_table() {
            let text = format!("`{kind}` holds named tables, found {}", entry.value.kind());
            let finding = Finding::error("ctos::config::value", text);
            let finding = finding.help(format!("write [{kind}.NAME]"));
            self.findings.push(finding.at(entry.key_place.clone()));
        }
        let Value::Table(entries) = &mut entry.value.value else {
            return;
        };
        for one in entries {
            let name = match owner {
                "" => one.key.clone(),
                _ => format!("{owner}/{}", one.key),
            };
            check_name(kind, one, self.findings);
            self.table(&mut one.value, path, &format!("{kind} `{name}`"), &name);
        }
    }

    fn wrong(&mut self, what: &str, expected: &str, node: &Node) {
        let text = format!("{what}: {expected}, found {}", shown(node));
        let finding = Finding::error("ctos::config::value", text);
        self.findings.push(finding.at(node.place.clone()));
    }
}

/// What a key holds that is left out.
fn default(key: &Key, path: &str) -> Option<Node> {
    match key.kind {
        Kind::One(_) | Kind::Named(PROCESSOR) => Some(Node::table()),
        // Nothing is left to include once everything is merged.
        _ if path == TOP => None,
        _ => key.default.and_then(parsed),
    }
}

/// A default, which is written as TOML, as a node without a place.
pub(super) fn parsed(default: &str) -> Option<Node> {
    let source = Source::new("default", default);
    let node = Node::from_toml_value(&source, 0..default.len()).ok()?;
    Some(node.value.into())
}

/// What must stand in place of a value, unless it fits.
fn misfit(kind: &Kind, node: &Node) -> Option<String> {
    let (text, flag) = (node.as_str(), node.as_bool());
    let number = node.as_f64().unwrap_or(f64::NAN);
    let whole = node
        .as_integer()
        .and_then(|number| u64::try_from(number).ok());
    let expected = match kind {
        Kind::Text | Kind::Choice(_) | Kind::Address(_) if text.is_none() => "a string".to_owned(),
        Kind::Text | Kind::Choice(_) | Kind::Address(_) if text == Some("") => {
            "a text that is not empty".to_owned()
        }
        Kind::Address(one) if text.is_some_and(|text| text.parse::<SocketAddr>().is_err()) => {
            format!("an address such as {one:?}")
        }
        Kind::Flag if flag.is_none() => "true or false".to_owned(),
        Kind::FlagOr(word) if flag.is_none() && text != Some(word) => {
            format!("true, false or {word:?}")
        }
        Kind::Integer(least, most) if whole.is_none_or(|whole| whole < *least || whole > *most) => {
            format!("a whole number from {least} to {most}")
        }
        Kind::Number(least, most) if !(*least..=*most).contains(&number) => {
            format!("a number from {least} to {most}")
        }
        Kind::Seconds(most) if !(number > 0.0 && number <= *most) => {
            format!("a number of seconds above 0 and at most {most}")
        }
        Kind::Texts(one) if !matches!(node.value, Value::Array(_)) => {
            format!("a list such as {one}")
        }
        Kind::One(_) | Kind::Named(_) | Kind::Profiles | Kind::Free if !node.is_table() => {
            "a table".to_owned()
        }
        _ => return None,
    };
    Some(expected)
}

/// A value as it stands in a message.
fn shown(node: &Node) -> String {
    match node.value() {
        Value::String(text) => format!("{text:?}"),
        Value::Integer(number) => number.to_string(),
        Value::Float(number) => format!("{number:?}"),
        Value::Bool(value) => value.to_string(),
        Value::Datetime(_) | Value::Array(_) | Value::Table(_) => node.kind().to_owned(),
    }
}

/// Names of chassis, processors and tasks stand in paths (`chassis/processor`), commands and file
/// names, so they are kept plain.
pub(super) fn check_name(kind: &str, entry: &Entry, findings: &mut Findings) {
    let name = &entry.key;
    if !is_name(name) {
        let text = format!("`{}` cannot be the name of a {kind}", name.escape_debug());
        let finding = Finding::error("ctos::config::name", text)
            .help("names are 1 to 64 letters, digits, `_`, `-` or `.`");
        findings.push(finding.at(entry.key_place.clone()));
    }
}
