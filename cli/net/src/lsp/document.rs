//! One open net text, and what an editor asks about it. Positions are those of the protocol: lines from
//! 0, columns in UTF-16 units.

use std::{
    collections::BTreeMap,
    ops,
    path::{Path, PathBuf},
    sync::Arc,
};

use ctos::diagnostic::{Finding, Findings, Severity, Source};
use lsp_types::{
    CompletionItem, CompletionItemKind as Item, Diagnostic, DiagnosticSeverity, DocumentSymbol,
    Hover, HoverContents, MarkupContent, MarkupKind, NumberOrString, Position, Range, SymbolKind,
    TextEdit, Uri,
};
use pnt::{
    analysis::stop::Stop,
    check::{self, FunctionNames, Limits, Rule},
    compile,
    net::Net,
    text::{
        self, grammar,
        outline::{Kind, Occurrence, Outline},
    },
};

use super::{
    offered::Offered,
    workspace::{Spot, name_of, plain},
};

/// An open text.
pub struct Document {
    source: Source,
    outline: Outline,
    /// The file it is; of one that is none, its address.
    path: PathBuf,
}

/// The limits of the search for an editor's net, so that the server answers while its author types.
const LIMITS: Limits = Limits {
    markings: 20_000,
    bytes: 64 << 20,
    threads: 1,
    stop: Stop::NEVER,
};

/// What a net that stands by itself does not prove. A net that works with others has no such finding, nor
/// has one with too many markings: `ctos net check` checks those.
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
    pub fn new(uri: &Uri, text: &str) -> Self {
        let uri = uri.as_str();
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
    pub fn offset(&self, position: Position) -> usize {
        let number = |number: u32| usize::try_from(number).unwrap_or(usize::MAX);
        let (wanted, column) = (number(position.line), number(position.character));
        let mut start = 0;
        for (line, text) in self.text().split_inclusive('\n').enumerate() {
            if line == wanted {
                let mut units = 0;
                for (at, character) in text.trim_end_matches(['\n', '\r']).char_indices() {
                    if units >= column {
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

    fn position(&self, offset: usize) -> Position {
        let before = self.text().get(..offset).unwrap_or(self.text());
        let line = before.matches('\n').count();
        let start = before.rfind('\n').map_or(0, |at| at + 1);
        let column = before
            .get(start..)
            .unwrap_or_default()
            .encode_utf16()
            .count();
        let number = |number: usize| u32::try_from(number).unwrap_or(u32::MAX);
        Position::new(number(line), number(column))
    }

    pub fn range(&self, range: &ops::Range<usize>) -> Range {
        Range::new(self.position(range.start), self.position(range.end))
    }

    // -- findings ---------------------------------------------------------------------------

    /// What is wrong with the text, as the protocol has it. What it includes is read as it is in `open`, or else
    /// from disk.
    pub fn findings(&self, open: &BTreeMap<PathBuf, Source>) -> Vec<Diagnostic> {
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
        // A file of subnets only is included by others and is not a net.
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

    fn finding(&self, finding: &Finding) -> Diagnostic {
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
        Diagnostic {
            range: self.range(&range),
            severity: Some(match finding.severity {
                Severity::Error => DiagnosticSeverity::ERROR,
                Severity::Warning => DiagnosticSeverity::WARNING,
            }),
            code: Some(NumberOrString::String(finding.code.to_string())),
            source: Some("ctos".to_owned()),
            message,
            ..Diagnostic::default()
        }
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
    ) -> Vec<CompletionItem> {
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
            let shown = keywords.map(|keyword| item(keyword.word, Item::KEYWORD, keyword.form));
            return shown.collect();
        };
        let names = |kind: Kind, code: Item, detail: &str| -> Vec<CompletionItem> {
            let names = whole.names(kind, &scope);
            names
                .iter()
                .map(|name| item(&in_text(name), code, detail))
                .collect()
        };
        let functions = |kind: Kind, what: &str| -> Vec<CompletionItem> {
            let of_app = offered.functions(net, what);
            let mut items: Vec<CompletionItem> = of_app
                .iter()
                .map(|name| item(&in_text(name), Item::FUNCTION, what))
                .collect();
            items.extend(names(kind, Item::FUNCTION, what));
            items
        };
        let words = before.split_whitespace().count();
        let items = match keyword {
            "in" | "read" | "inhibit" | "reset" | "out" | "fail" | "safe" => {
                if before.ends_with('@') {
                    names(Kind::Net, Item::MODULE, "net")
                } else {
                    names(Kind::Place, Item::VARIABLE, "place")
                }
            }
            "tape" => names(Kind::Symbol, Item::ENUM_MEMBER, "symbol of the input tape"),
            "write" => names(Kind::Answer, Item::ENUM_MEMBER, "symbol of the output tape"),
            "do" if before.contains('(') => names(Kind::Data, Item::FIELD, "data object"),
            "do" => functions(Kind::Function, FunctionNames::LOCAL),
            "when" => {
                let mut items = functions(Kind::Enabling, FunctionNames::ENABLING);
                items.extend((words == 1).then(|| item("not", Item::KEYWORD, "negation")));
                items
            }
            "ask" if words == 1 => names(Kind::Net, Item::MODULE, "coordinator"),
            "ask" => names(Kind::Request, Item::EVENT, "request"),
            "send" => match before.trim_start_matches("send").trim().strip_suffix('.') {
                Some(task) => {
                    let of_app = offered
                        .tasks
                        .get(task.trim_matches('"'))
                        .into_iter()
                        .flatten();
                    let mut items: Vec<CompletionItem> = of_app
                        .map(|(name, help)| item(name, Item::METHOD, help))
                        .collect();
                    items.extend(names(Kind::Command, Item::METHOD, "command"));
                    items
                }
                None if before.contains('(') => names(Kind::Data, Item::FIELD, "data object"),
                None => {
                    let mut items: Vec<CompletionItem> = offered
                        .tasks
                        .keys()
                        .map(|task| item(&in_text(task), Item::MODULE, "task"))
                        .collect();
                    items.extend(names(Kind::Task, Item::MODULE, "task"));
                    items
                }
            },
            "use" if words == 1 => names(Kind::Subnet, Item::CLASS, "subnet"),
            "use" => names(Kind::Place, Item::VARIABLE, "place"),
            "time" => vec![
                item("exponential", Item::KEYWORD, "by its mean"),
                item("normal", Item::KEYWORD, "by mean and spread"),
            ],
            "servers" => vec![item("many", Item::KEYWORD, "as many as its tokens allow")],
            _ => Vec::new(),
        };
        let mut seen = std::collections::BTreeSet::new();
        let once = |item: &CompletionItem| seen.insert(item.label.clone());
        items.into_iter().filter(once).collect()
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
    pub fn hover(&self, at: usize, elsewhere: Option<(&Path, &str)>) -> Option<Hover> {
        let word = self.word(at)?;
        let value = match word.kind {
            Kind::Keyword => {
                let keyword = grammar::keyword_called(&word.name)?;
                format!("`{}`\n\n{}", keyword.form, keyword.meaning)
            }
            kind => self.told(word, kind, elsewhere),
        };
        Some(Hover {
            contents: HoverContents::Markup(MarkupContent {
                kind: MarkupKind::Markdown,
                value,
            }),
            range: Some(self.range(&word.range)),
        })
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
    #[allow(deprecated, reason = "the type has a field that is not set any more")]
    pub fn symbols(&self) -> Vec<DocumentSymbol> {
        let shown = |word: &Occurrence| {
            let kind = match word.kind {
                Kind::Place => SymbolKind::FIELD,
                Kind::Transition => SymbolKind::FUNCTION,
                Kind::Subnet => SymbolKind::CLASS,
                Kind::Symbol => SymbolKind::EVENT,
                _ => return None,
            };
            let range = self.range(&word.range);
            word.declared.then(|| DocumentSymbol {
                name: word.name.clone(),
                detail: None,
                kind,
                tags: None,
                deprecated: None,
                range,
                selection_range: range,
                children: None,
            })
        };
        self.outline.words().iter().filter_map(shown).collect()
    }

    /// The whole text laid out; `None` when it cannot be read.
    pub fn formatted(&self) -> Option<Vec<TextEdit>> {
        let text = text::formatted(&self.source).ok()?;
        if text == self.text() {
            return Some(Vec::new());
        }
        let whole = self.range(&(0..self.text().len()));
        Some(vec![TextEdit::new(whole, text)])
    }

    /// What would be renamed here.
    pub fn renamed_range(&self, at: usize) -> Option<Range> {
        let word = self.word(at).filter(|word| word.kind != Kind::Keyword);
        word.map(|word| self.range(&word.range))
    }
}

/// The line of a text in which a byte is.
pub(super) fn line_at(text: &str, offset: usize) -> &str {
    let before = text.get(..offset).unwrap_or_default();
    let start = before.rfind('\n').map_or(0, |at| at + 1);
    let rest = text.get(start..).and_then(|rest| rest.lines().next());
    rest.unwrap_or_default()
}

fn item(label: &str, kind: Item, detail: &str) -> CompletionItem {
    CompletionItem {
        kind: Some(kind),
        ..CompletionItem::new_simple(label.to_owned(), detail.to_owned())
    }
}

/// A name as net text has it.
fn in_text(name: &str) -> String {
    text::name_in_text(name)
}

/// The `file:` address of a path.
pub fn uri_of(path: &Path) -> Option<Uri> {
    let mut uri = "file://".to_owned();
    for byte in path.display().to_string().bytes() {
        match byte {
            b'/' | b'-' | b'_' | b'.' | b'~' => uri.push(char::from(byte)),
            byte if byte.is_ascii_alphanumeric() => uri.push(char::from(byte)),
            byte => uri += &format!("%{byte:02X}"),
        }
    }
    uri.parse().ok()
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
