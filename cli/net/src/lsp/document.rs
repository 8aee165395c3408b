//! One open net text, and what an editor asks about it. Positions are those of the protocol: lines from
//! 0, columns in UTF-16 units.

use std::{
    collections::BTreeMap,
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use ctos::diagnostic::{Finding, Findings, Severity, Source};
use pnt::{
    check::{self, FunctionNames, Limits, Rule},
    compile,
    net::Net,
    text::{
        self, grammar,
        outline::{Kind, Occurrence, Outline},
    },
};
use serde_json::{Value, json};

use super::{
    Offered,
    workspace::{Spot, plain},
};

/// An open text.
pub struct Document {
    source: Source,
    outline: Outline,
    /// The file it is; of one that is none, its address.
    path: PathBuf,
}

/// How far an editor's net is looked at, so that it answers while its author types.
const LIMITS: Limits = Limits {
    markings: 20_000,
    bytes: 64 << 20,
    threads: 1,
};

/// What a net that stands by itself does not prove. Of one that works with others nothing is told, nor of
/// one with too many markings: `ctos net check` looks at those.
fn soundness(net: Net) -> Findings {
    let alone =
        net.remote_nets().is_empty() && net.coordinators().is_empty() && net.serves().is_empty();
    if !alone || net.transitions().is_empty() {
        return Findings::new();
    }
    let nets = [Arc::new(net)];
    let options = check::Options::new(Rule::of(&nets), LIMITS);
    let found = match check::prove(&nets, &options, &mut |_| {}) {
        Ok(proof) => proof.findings,
        Err(found) => found,
    };
    let mut told = Findings::new();
    for finding in found.into_sorted() {
        if finding.code != "pnt::check::not_proved" {
            told.push(finding);
        }
    }
    told
}

impl Document {
    /// A text as the editor has it.
    pub fn new(uri: &str, text: &str) -> Self {
        let path = path_of(uri).map_or_else(|| PathBuf::from(uri), |path| plain(&path));
        let source = Source::new(path.display().to_string(), text);
        Self {
            outline: Outline::of(&source),
            source,
            path,
        }
    }

    fn text(&self) -> &str {
        self.source.text()
    }

    /// Its text, under the name of its file.
    pub fn source(&self) -> &Source {
        &self.source
    }

    /// The file it is; of one that is none, its address.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The place of the name at a byte.
    pub fn spot(&self, at: usize) -> Option<Spot> {
        let word = self.word(at).filter(|word| word.kind != Kind::Keyword)?;
        Some(Spot {
            file: self.path.clone(),
            bytes: (word.range.start, word.range.end),
        })
    }

    // -- positions --------------------------------------------------------------------------

    /// The byte of a position; the end of its line or text when it lies behind that.
    pub fn offset(&self, position: &Value) -> usize {
        let number = |key: &str| {
            let number = position[key].as_u64().unwrap_or_default();
            usize::try_from(number).unwrap_or(usize::MAX)
        };
        let mut start = 0;
        for (line, text) in self.text().split_inclusive('\n').enumerate() {
            if line == number("line") {
                let mut units = 0;
                for (at, character) in text.trim_end_matches(['\n', '\r']).char_indices() {
                    if units >= number("character") {
                        return start + at;
                    }
                    units += character.len_utf16();
                }
                return start + text.trim_end_matches(['\n', '\r']).len();
            }
            start += text.len();
        }
        self.text().len()
    }

    fn position(&self, offset: usize) -> Value {
        let before = self.text().get(..offset).unwrap_or(self.text());
        let line = before.matches('\n').count();
        let start = before.rfind('\n').map_or(0, |at| at + 1);
        let column = before
            .get(start..)
            .unwrap_or_default()
            .encode_utf16()
            .count();
        json!({ "line": line, "character": column })
    }

    pub fn range(&self, range: &Range<usize>) -> Value {
        json!({ "start": self.position(range.start), "end": self.position(range.end) })
    }

    // -- findings ---------------------------------------------------------------------------

    /// What is wrong with the text, as the protocol has it. What it includes is read as it is in `open`, or else
    /// from disk.
    pub fn findings(&self, open: &BTreeMap<PathBuf, Source>) -> Vec<Value> {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let mut include = |file: &str| {
            let path = folder.join(file);
            match open.get(&plain(&path)) {
                Some(source) => Ok(source.clone()),
                None => Source::read(&path),
            }
        };
        let found = match compile::net_with(&self.source, &mut include) {
            Ok(net) => soundness(net),
            Err(found) => found,
        };
        // A file of subnets only is included by others and is no net.
        let library = self
            .outline
            .words()
            .iter()
            .any(|word| word.kind == Kind::Subnet && word.declared);
        let found = found.into_sorted().into_iter();
        found
            .filter(|finding| !(library && finding.code == "pnt::text::no_net"))
            .map(|finding| self.finding(&finding))
            .collect()
    }

    fn finding(&self, finding: &Finding) -> Value {
        let here = finding
            .place
            .as_ref()
            .filter(|place| place.source == self.source);
        let range = here.map_or(0..0, |place| place.range.clone());
        let mut message = finding.message.clone();
        if let (None, Some(place)) = (here, &finding.place) {
            message = format!("{place}: {message}");
        }
        if let Some(help) = &finding.help {
            message = format!("{message}\n{help}");
        }
        let severity = match finding.severity {
            Severity::Error => 1,
            Severity::Warning => 2,
        };
        json!({
            "range": self.range(&range),
            "severity": severity,
            "code": finding.code,
            "source": "ctos",
            "message": message,
        })
    }

    // -- words ------------------------------------------------------------------------------

    fn word(&self, at: usize) -> Option<&Occurrence> {
        self.outline.at(at)
    }

    /// What may stand at a place, of the words of this text and of what it includes.
    pub fn completions(
        &self,
        at: usize,
        offered: &Offered,
        (net, whole): (Option<&str>, &Outline),
    ) -> Value {
        let start = self
            .text()
            .get(..at)
            .and_then(|text| text.rfind('\n'))
            .map_or(0, |line| line + 1);
        let line = self.text().get(start..at).unwrap_or_default().trim_start();
        // The word that is being typed counts for nothing yet.
        let typed = line
            .rfind(|c: char| !(c.is_alphanumeric() || c == '_'))
            .map_or(0, |last| {
                last + line
                    .get(last..)
                    .and_then(|rest| rest.chars().next())
                    .map_or(0, char::len_utf8)
            });
        let before = line.get(..typed).unwrap_or_default();
        let open = self.outline.transition_at(start.saturating_sub(1));
        let scope = self.scope(at);
        let Some(keyword) = before
            .split([' ', '\t'])
            .next()
            .filter(|word| !word.is_empty())
        else {
            let keywords = grammar::keywords(open.is_some());
            let shown = keywords.map(|keyword| item(keyword.word, 14, keyword.form));
            return Value::Array(shown.collect());
        };
        let names = |kind: Kind, code: u8, detail: &str| -> Vec<Value> {
            let names = whole.names(kind, &scope);
            names
                .iter()
                .map(|name| item(&in_text(name), code, detail))
                .collect()
        };
        let functions = |kind: Kind, what: &str| -> Vec<Value> {
            let of_app = offered.functions(net, what);
            let mut items: Vec<Value> = of_app
                .iter()
                .map(|name| item(&in_text(name), 3, what))
                .collect();
            items.extend(names(kind, 3, what));
            items
        };
        let words = before.split_whitespace().count();
        let items = match keyword {
            "in" | "read" | "inhibit" | "reset" | "out" | "fail" | "safe" => {
                if before.ends_with('@') {
                    names(Kind::Net, 9, "net")
                } else {
                    names(Kind::Place, 6, "place")
                }
            }
            "tape" => names(Kind::Symbol, 20, "symbol of the input tape"),
            "write" => names(Kind::Answer, 20, "symbol of the output tape"),
            "do" if before.contains('(') => names(Kind::Data, 5, "data object"),
            "do" => functions(Kind::Function, FunctionNames::LOCAL),
            "when" => {
                let mut items = functions(Kind::Enabling, FunctionNames::ENABLING);
                items.extend((words == 1).then(|| item("not", 14, "negation")));
                items
            }
            "ask" if words == 1 => names(Kind::Net, 9, "coordinator"),
            "ask" => names(Kind::Request, 23, "request"),
            "send" => match before.trim_start_matches("send").trim().strip_suffix('.') {
                Some(task) => {
                    let of_app = offered
                        .tasks
                        .get(task.trim_matches('"'))
                        .into_iter()
                        .flatten();
                    let mut items: Vec<Value> =
                        of_app.map(|(name, help)| item(name, 2, help)).collect();
                    items.extend(names(Kind::Command, 2, "command"));
                    items
                }
                None if before.contains('(') => names(Kind::Data, 5, "data object"),
                None => {
                    let mut items: Vec<Value> = offered
                        .tasks
                        .keys()
                        .map(|task| item(&in_text(task), 9, "task"))
                        .collect();
                    items.extend(names(Kind::Task, 9, "task"));
                    items
                }
            },
            "use" if words == 1 => names(Kind::Subnet, 7, "subnet"),
            "use" => names(Kind::Place, 6, "place"),
            "time" => vec![
                item("exponential", 14, "by its mean"),
                item("normal", 14, "by mean and spread"),
            ],
            "servers" => vec![item("many", 14, "as many as its tokens allow")],
            _ => Vec::new(),
        };
        let mut seen = std::collections::BTreeSet::new();
        let once = |item: &Value| seen.insert(item["label"].to_string());
        Value::Array(items.into_iter().filter(once).collect())
    }

    /// The subnet whose lines hold a byte.
    fn scope(&self, at: usize) -> String {
        let mut scope = String::new();
        for word in self
            .outline
            .words()
            .iter()
            .take_while(|word| word.range.start < at)
        {
            match (word.kind, word.name.as_str()) {
                (Kind::Subnet, name) if word.declared => name.clone_into(&mut scope),
                (Kind::Keyword, "end") => scope.clear(),
                _ => {}
            }
        }
        scope
    }

    /// The file that is included here, if the byte is within its name.
    pub fn included(&self, at: usize) -> Option<PathBuf> {
        let before = self.text().get(..at)?;
        let column = at - before.rfind('\n').map_or(0, |end| end + 1);
        let line = line_at(self.text(), at);
        let name = line
            .trim()
            .strip_prefix("include")?
            .trim()
            .trim_matches('"');
        let start = line.find(name)?;
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let known = self.outline.includes().iter().any(|file| file == name);
        (known && (start..=start + name.len()).contains(&column)).then(|| plain(&folder.join(name)))
    }

    /// What is known about a word; where it is declared in another file, that file and the line there.
    pub fn hover(&self, at: usize, elsewhere: Option<(&Path, &str)>) -> Value {
        let Some(word) = self.word(at) else {
            return Value::Null;
        };
        let text = match word.kind {
            Kind::Keyword => match grammar::keyword_called(&word.name) {
                Some(keyword) => format!("`{}`\n\n{}", keyword.form, keyword.meaning),
                None => return Value::Null,
            },
            kind => self.told(word, kind, elsewhere),
        };
        json!({ "contents": { "kind": "markdown", "value": text }, "range": self.range(&word.range) })
    }

    /// The word, the line that declares it, and the transitions that use it.
    fn told(&self, word: &Occurrence, kind: Kind, elsewhere: Option<(&Path, &str)>) -> String {
        let mut told = format!("{} `{}`", name_of(kind), word.name);
        if let Some(declared) = self.outline.declaration(word) {
            let line = line_at(self.text(), declared.range.start);
            told += &format!("\n\n```\n{}\n```", line.trim());
        } else if let Some((file, line)) = elsewhere {
            let file = file.file_name().unwrap_or_default().to_string_lossy();
            told += &format!("\n\nin {file}:\n\n```\n{}\n```", line.trim());
        }
        let used = self
            .outline
            .same(word)
            .into_iter()
            .filter(|word| !word.declared);
        let mut users: Vec<&str> = used
            .filter_map(|word| self.outline.transition_at(word.range.start))
            .map(|transition| transition.name.as_str())
            .collect();
        users.dedup();
        if !users.is_empty() && kind != Kind::Transition {
            told += &format!("\n\nused by {}", users.join(", "));
        }
        told
    }

    /// Places, transitions and subnets, for an overview.
    pub fn symbols(&self) -> Value {
        let shown = |word: &Occurrence| {
            let kind = match word.kind {
                Kind::Place => 8,
                Kind::Transition => 12,
                Kind::Subnet => 5,
                Kind::Symbol => 24,
                _ => return None,
            };
            let range = self.range(&word.range);
            word.declared.then(|| json!({ "name": word.name, "kind": kind, "range": range, "selectionRange": range }))
        };
        Value::Array(self.outline.words().iter().filter_map(shown).collect())
    }

    /// The whole text laid out; nothing when it cannot be read.
    pub fn formatted(&self) -> Value {
        match text::formatted(&self.source) {
            Ok(text) if text != self.text() => {
                let whole = self.range(&(0..self.text().len()));
                json!([{ "range": whole, "newText": text }])
            }
            Ok(_) => json!([]),
            Err(_) => Value::Null,
        }
    }

    /// What would be renamed here.
    pub fn renamed_range(&self, at: usize) -> Value {
        let word = self.word(at).filter(|word| word.kind != Kind::Keyword);
        word.map_or(Value::Null, |word| self.range(&word.range))
    }
}

/// The line of a text in which a byte is.
pub(super) fn line_at(text: &str, offset: usize) -> &str {
    let before = text.get(..offset).unwrap_or_default();
    let start = before.rfind('\n').map_or(0, |at| at + 1);
    let rest = text.get(start..).and_then(|rest| rest.lines().next());
    rest.unwrap_or_default()
}

fn item(label: &str, kind: u8, detail: &str) -> Value {
    json!({ "label": label, "kind": kind, "detail": detail })
}

/// A name as net text has it.
fn in_text(name: &str) -> String {
    text::name_in_text(name)
}

/// What a kind of name is called.
pub(super) fn name_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Keyword => "keyword",
        Kind::Net => "net",
        Kind::Place | Kind::Argument => "place",
        Kind::Transition => "transition",
        Kind::Symbol => "symbol of the input tape",
        Kind::Answer => "symbol of the output tape",
        Kind::Request => "request",
        Kind::Function => "local function",
        Kind::Enabling => "enabling function",
        Kind::Task => "task",
        Kind::Command => "command",
        Kind::Data => "data object",
        Kind::Subnet => "subnet",
        Kind::Instance => "instance",
        Kind::Parameter => "parameter",
    }
}

/// The `file:` address of a path.
pub fn uri_of(path: &Path) -> String {
    let mut uri = "file://".to_owned();
    for byte in path.display().to_string().bytes() {
        match byte {
            b'/' | b'-' | b'_' | b'.' | b'~' => uri.push(char::from(byte)),
            byte if byte.is_ascii_alphanumeric() => uri.push(char::from(byte)),
            byte => uri += &format!("%{byte:02X}"),
        }
    }
    uri
}

/// The path of a `file:` address.
pub fn path_of(uri: &str) -> Option<PathBuf> {
    let encoded = uri.strip_prefix("file://")?;
    let mut bytes = Vec::with_capacity(encoded.len());
    let mut rest = encoded.bytes();
    while let Some(byte) = rest.next() {
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let digits = [rest.next()?, rest.next()?];
        let digits = std::str::from_utf8(&digits).ok()?;
        bytes.push(u8::from_str_radix(digits, 16).ok()?);
    }
    String::from_utf8(bytes).ok().map(PathBuf::from)
}
