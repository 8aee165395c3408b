//! Subnets: lines between `subnet NAME(a, b)` and `end`, in the file itself or in one that it includes,
//! and their instances, `use NAME(x, y) as I`. An instance is the subnet's lines read again. Its
//! arguments stand for the parameters, and `I.` stands before the names of its places and transitions.
//! Knows no more of the lines than that they are tokens.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use ctos::diagnostic::{Finding, Findings, Source};

use super::line::{self, Symbol, Token};
use crate::{
    draft::{Draft, DraftArc, DraftTransition, Word},
    enough::enough,
};

/// The most lines that all instances of a net have together.
const MOST_LINES: usize = 100_000;

/// The deepest that subnets may use each other, and files include each other.
const DEEPEST: usize = 32;

/// Gives the text of an included file.
pub type Include<'a> = &'a mut dyn FnMut(&str) -> Result<Source, Finding>;

/// A line as tokens, and where it ends.
#[derive(Debug, Clone)]
pub(super) struct Line {
    pub(super) tokens: Vec<Token>,
    pub(super) source: Source,
    pub(super) end: usize,
}

/// What stands between `subnet` and `end`.
#[derive(Debug)]
pub(super) struct Subnet {
    name: Word,
    parameters: Vec<Word>,
    lines: Vec<Line>,
}

/// All subnets that a net can use.
#[derive(Debug, Default)]
pub(super) struct Subnets {
    known: BTreeMap<String, Arc<Subnet>>,
}

/// The lines of a text as tokens; what cannot be cut becomes a finding.
pub(super) fn cut(source: &Source, text: &str, start: usize, findings: &mut Findings) -> Vec<Line> {
    let mut lines = Vec::new();
    let mut start = start;
    for with_end in text.split_inclusive('\n') {
        if enough(findings) {
            break;
        }
        let text = with_end.trim_end_matches(['\n', '\r']);
        match line::cut(source, text, start) {
            Ok(tokens) if tokens.is_empty() => {}
            Ok(tokens) => lines.push(Line {
                tokens,
                source: source.clone(),
                end: start + text.len(),
            }),
            Err(bad) => {
                let finding = Finding::error("pnt::text::symbol", bad.message);
                findings.push(finding.at(source.at(bad.range)));
            }
        }
        start += with_end.len();
    }
    lines
}

impl Line {
    pub(super) fn begins(&self, keyword: &str) -> bool {
        matches!(self.tokens.first(), Some(Token { symbol: Symbol::Name(name), .. }) if name == keyword)
    }

    fn keyword(&self) -> Word {
        let whole = self
            .tokens
            .first()
            .map_or(self.end..self.end, |token| token.range.clone());
        Word::new("", self.source.at(whole))
    }
}

impl Subnets {
    /// Takes all subnets out of the lines of a file, and those of the files that it includes.
    pub(super) fn take(
        &mut self,
        lines: Vec<Line>,
        include: Include<'_>,
        findings: &mut Findings,
    ) -> Vec<Line> {
        let path = lines.first().map(|line| line.source.name().to_owned());
        let mut path: Vec<String> = path.into_iter().collect();
        self.take_from(lines, include, &mut path, findings)
    }

    fn take_from(
        &mut self,
        lines: Vec<Line>,
        include: Include<'_>,
        path: &mut Vec<String>,
        findings: &mut Findings,
    ) -> Vec<Line> {
        let mut rest = Vec::new();
        let mut open: Option<Subnet> = None;
        for line in lines {
            if line.begins("subnet") {
                if let Some(other) = &open {
                    findings.push(
                        error(format!("subnet `{}` is not ended yet", other.name))
                            .at(line.keyword().at)
                            .help("write `end` below its last line"),
                    );
                }
                self.close(open.take(), findings);
                open = findings.keep(head(&line));
            } else if line.begins("end") {
                if open.is_none() {
                    findings.push(
                        error("there is no subnet to end here".to_owned())
                            .at(line.keyword().at)
                            .help("remove the line, or begin with `subnet NAME(PARAMETER, ...)`"),
                    );
                }
                self.close(open.take(), findings);
            } else if let Some(subnet) = &mut open {
                subnet.lines.push(line);
            } else if line.begins("include") {
                let included = self.include(&line, include, path, findings);
                findings.keep(included);
            } else {
                rest.push(line);
            }
        }
        if let Some(subnet) = open {
            findings.push(
                error(format!("subnet `{}` has no end", subnet.name))
                    .at(subnet.name.at.clone())
                    .help("write `end` below its last line"),
            );
            self.close(Some(subnet), findings);
        }
        rest
    }

    fn close(&mut self, subnet: Option<Subnet>, findings: &mut Findings) {
        let Some(subnet) = subnet else { return };
        if let Some(first) = self.known.get(&subnet.name.text) {
            findings.push(
                error(format!(
                    "subnet `{}` is there twice; the first is at {}",
                    subnet.name, first.name.at
                ))
                .at(subnet.name.at)
                .help("rename one of the two or remove it"),
            );
            return;
        }
        self.known
            .insert(subnet.name.text.clone(), Arc::new(subnet));
    }

    fn include(
        &mut self,
        line: &Line,
        include: Include<'_>,
        path: &mut Vec<String>,
        findings: &mut Findings,
    ) -> Result<(), Finding> {
        let [
            _,
            Token {
                symbol: Symbol::Quoted(file),
                range,
                source,
            },
        ] = line.tokens.as_slice()
        else {
            return Err(error("`include` wants one file name in quotes".to_owned())
                .at(line.keyword().at)
                .help("write `include \"FILE.net\"`"));
        };
        let at = || source.at(range.clone());
        let text = include(file).map_err(|finding| {
            let finding = Finding {
                place: None,
                ..finding
            };
            finding.at(at())
        })?;
        if path.iter().any(|open| open == text.name()) {
            return Err(error(format!(
                "`{file}` includes itself: {} includes it",
                path.join(" includes ")
            ))
            .at(at())
            .help("move what both need into a third file"));
        }
        if path.len() >= DEEPEST {
            return Err(
                error(format!("files include each other more than {DEEPEST} deep"))
                    .at(at())
                    .help("include the files directly"),
            );
        }
        path.push(text.name().to_owned());
        let lines = cut(&text, text.text(), 0, findings);
        let rest = self.take_from(lines, include, path, findings);
        path.pop();
        if let Some(line) = rest.first() {
            findings.push(
                error("an included file holds subnets only".to_owned())
                    .at(line.keyword().at)
                    .help("put the line into a subnet, or into the net that includes the file"),
            );
        }
        Ok(())
    }

    /// The subnet that an instance names.
    fn find(&self, name: &Word) -> Result<Arc<Subnet>, Finding> {
        self.known.get(&name.text).cloned().ok_or_else(|| {
            error(format!("there is no subnet `{name}`"))
                .at(name.at.clone())
                .help("declare it: `subnet NAME(PARAMETER, ...)`, its lines, `end`")
                .suggest(&name.text, self.known.keys().map(String::as_str))
        })
    }
}

fn error(message: String) -> Finding {
    Finding::error("pnt::text::subnet", message)
}

/// `subnet NAME` or `subnet NAME(a, b)`.
fn head(line: &Line) -> Result<Subnet, Finding> {
    let mut words = super::Words::new(&line.source, &line.tokens, line.end);
    words.first()?;
    let name = words.name("the subnet's name")?;
    let mut parameters: Vec<Word> = Vec::new();
    if words.take("(") && !words.take(")") {
        parameters = words.names("a parameter")?;
        words.mark(")")?;
    }
    words.end()?;
    for (index, parameter) in parameters.iter().enumerate() {
        if parameters
            .iter()
            .take(index)
            .any(|before| before == parameter)
        {
            return Err(error(format!("parameter `{parameter}` is there twice"))
                .at(parameter.at.clone())
                .help("rename one of the two"));
        }
    }
    Ok(Subnet {
        name,
        parameters,
        lines: Vec::new(),
    })
}

/// An instance as written: `use NAME(x, y) as I`.
struct Use {
    subnet: Word,
    arguments: Vec<Vec<Token>>,
    instance: Word,
}

impl Use {
    fn of(line: &Line) -> Result<Self, Finding> {
        let mut words = super::Words::new(&line.source, &line.tokens, line.end);
        words.first()?;
        let subnet = words.name("a subnet")?;
        let mut arguments = Vec::new();
        if words.take("(") && !words.take(")") {
            loop {
                arguments.push(words.argument()?);
                if !words.take(",") {
                    break;
                }
            }
            words.mark(")")?;
        }
        words.expect_keyword("as")?;
        let instance = words.name("the instance's name")?;
        words.end()?;
        Ok(Self {
            subnet,
            arguments,
            instance,
        })
    }
}

/// What is common to all instances of a net.
pub(super) struct Expansion<'s> {
    subnets: &'s Subnets,
    /// Subnets being expanded, outermost first.
    open: Vec<String>,
    /// Subnets that were expanded.
    used: BTreeSet<String>,
    /// Lines of all instances so far.
    lines: usize,
}

impl<'s> Expansion<'s> {
    /// No instance yet.
    pub(super) fn of(subnets: &'s Subnets) -> Self {
        Self {
            subnets,
            open: Vec::new(),
            used: BTreeSet::new(),
            lines: 0,
        }
    }

    /// The same for the lines of an instance; [`Self::take_back`] goes on with it.
    pub(super) fn lend(&mut self) -> Self {
        Self {
            subnets: self.subnets,
            open: std::mem::take(&mut self.open),
            used: std::mem::take(&mut self.used),
            lines: self.lines,
        }
    }

    /// The lines of the subnets that were not expanded, each with whether it holds a parameter.
    pub(super) fn unused(&self) -> Vec<Vec<(Line, bool)>> {
        let known = self.subnets.known.values();
        let unused = known.filter(|subnet| !self.used.contains(&subnet.name.text));
        unused
            .map(|subnet| {
                let open = |line: &Line| {
                    let has = |token: &Token, parameter: &Word| match &token.symbol {
                        Symbol::Name(name) => *name == parameter.text,
                        Symbol::Expression(text) | Symbol::Quoted(text) => {
                            text.contains(&parameter.text)
                        }
                        _ => false,
                    };
                    let mut tokens = line.tokens.iter().skip(1);
                    tokens.any(|token| subnet.parameters.iter().any(|word| has(token, word)))
                };
                let lines = subnet.lines.iter();
                lines.map(|line| (line.clone(), open(line))).collect()
            })
            .collect()
    }

    pub(super) fn take_back(&mut self, lent: Self) {
        *self = lent;
    }

    /// The places and transitions of the instance that a line asks for. `read` reads the lines of the
    /// instance, which may hold instances themselves.
    pub(super) fn instance(
        &mut self,
        line: &Line,
        findings: &mut Findings,
        read: impl FnOnce(&mut Self, Vec<Line>, &mut Findings) -> Draft,
    ) -> Result<Draft, Finding> {
        let wanted = Use::of(line)?;
        let subnet = self.subnets.find(&wanted.subnet)?;
        if wanted.arguments.len() != subnet.parameters.len() {
            return Err(error(format!(
                "subnet `{}` takes {} arguments, not {}",
                subnet.name,
                subnet.parameters.len(),
                wanted.arguments.len()
            ))
            .at(wanted.subnet.at)
            .help(format!(
                "its parameters are ({})",
                shown(&subnet.parameters)
            )));
        }
        if self.open.contains(&subnet.name.text) || self.open.len() >= DEEPEST {
            return Err(error(format!(
                "subnet `{}` uses itself: {}",
                subnet.name,
                [
                    self.open.as_slice(),
                    std::slice::from_ref(&subnet.name.text)
                ]
                .concat()
                .join(" uses ")
            ))
            .at(wanted.subnet.at)
            .help("a subnet is a part, and cannot be a part of itself"));
        }
        self.lines += subnet.lines.len();
        if self.lines > MOST_LINES {
            return Err(
                error(format!("the instances have more than {MOST_LINES} lines"))
                    .at(wanted.subnet.at)
                    .help("subnets that use others several times multiply; use fewer"),
            );
        }
        let lines = subnet
            .lines
            .iter()
            .map(|line| substituted(line, &subnet.parameters, &wanted.arguments));
        let lines = lines.collect();
        self.open.push(subnet.name.text.clone());
        self.used.insert(subnet.name.text.clone());
        let mut draft = read(self, lines, findings);
        self.open.pop();
        if let Some(finding) = captured(&draft, &wanted.arguments) {
            return Err(finding);
        }
        prefix(&mut draft, &wanted.instance);
        Ok(draft)
    }
}

fn shown(words: &[Word]) -> String {
    let names: Vec<&str> = words.iter().map(|word| word.text.as_str()).collect();
    names.join(", ")
}

/// A line with arguments in the place of parameters; its keyword stays.
fn substituted(line: &Line, parameters: &[Word], arguments: &[Vec<Token>]) -> Line {
    let mut tokens = Vec::with_capacity(line.tokens.len());
    for (index, token) in line.tokens.iter().enumerate() {
        let position = match &token.symbol {
            Symbol::Name(name) if index > 0 => {
                parameters.iter().position(|word| word.text == *name)
            }
            _ => None,
        };
        match position.and_then(|position| arguments.get(position)) {
            Some(argument) => tokens.extend(argument.iter().cloned()),
            None => tokens.push(with_arguments(token, line, parameters, arguments)),
        }
    }
    Line {
        tokens,
        ..line.clone()
    }
}

/// An expression, or the line of a `request` or `log`, with arguments in the place of the parameters in it. In such a
/// line a parameter stands behind `$`.
fn with_arguments(
    token: &Token,
    line: &Line,
    parameters: &[Word],
    arguments: &[Vec<Token>],
) -> Token {
    let (text, mark) = match &token.symbol {
        Symbol::Expression(text) => (text, None),
        Symbol::Quoted(text) if line.begins("request") || line.begins("log") => (text, Some('$')),
        _ => return token.clone(),
    };
    let put = |name: &str| {
        let position = parameters.iter().position(|word| word.text == name)?;
        match arguments.get(position)?.as_slice() {
            [
                Token {
                    symbol: Symbol::Name(text) | Symbol::Number(text),
                    ..
                },
            ] => Some(text.as_str()),
            _ => None,
        }
    };
    let (mut out, mut rest, mut before, mut quote) = (String::new(), text.as_str(), ' ', None);
    while let Some(first) = rest.chars().next() {
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let length = match rest.find(|c| !is_word(c)) {
            Some(0) => first.len_utf8(),
            Some(length) => length,
            None => rest.len(),
        };
        let (word, after) = rest.split_at(length);
        let fits = mark.map_or(before != '.' && quote.is_none(), |mark| before == mark);
        match put(word).filter(|_| fits) {
            Some(argument) => out.push_str(argument),
            None => out.push_str(word),
        }
        if mark.is_none() && ['"', '\''].contains(&first) {
            quote = match quote {
                None => Some(first),
                Some(open) if open == first && before != '\\' => None,
                open => open,
            };
        }
        before = word.chars().next_back().unwrap_or(' ');
        rest = after;
    }
    let symbol = match mark {
        None => Symbol::Expression(out),
        Some(_) => Symbol::Quoted(out),
    };
    Token {
        symbol,
        ..token.clone()
    }
}

/// An argument that the subnet would take for a place of its own.
fn captured(draft: &Draft, arguments: &[Vec<Token>]) -> Option<Finding> {
    let own = |name: &str| draft.places.iter().any(|place| place.name.text == name);
    let plain = arguments
        .iter()
        .filter_map(|argument| match argument.as_slice() {
            [
                Token {
                    symbol: Symbol::Name(name) | Symbol::Quoted(name),
                    range,
                    source,
                },
            ] => Some((name, source.at(range.clone()))),
            _ => None,
        });
    let (name, at) = plain.into_iter().find(|(name, _)| own(name))?;
    Some(
        error(format!(
            "the subnet has a place `{name}` of its own, which this argument would become"
        ))
        .at(at)
        .help("rename the place in the subnet, or the one that is meant"),
    )
}

/// Puts the instance's name before the names of its places and transitions.
fn prefix(draft: &mut Draft, instance: &Word) {
    let own: Vec<String> = draft
        .places
        .iter()
        .map(|place| place.name.text.clone())
        .collect();
    let own: BTreeSet<&str> = own.iter().map(String::as_str).collect();
    let full = |word: &mut Word| *word = word.derived(format!("{instance}.{word}"));
    let arc = |arc: &mut DraftArc| {
        if arc.net.is_none() && own.contains(arc.place.text.as_str()) {
            full(&mut arc.place);
        }
    };
    for place in &mut draft.places {
        full(&mut place.name);
    }
    for transition in &mut draft.transitions {
        full(&mut transition.name);
        let DraftTransition {
            inputs,
            reads,
            inhibitors,
            resets,
            outputs,
            fail,
            ..
        } = transition;
        let all = [inputs, reads, inhibitors, outputs, fail];
        all.into_iter().flatten().for_each(arc);
        let resets = resets
            .iter_mut()
            .filter(|word| own.contains(word.text.as_str()));
        resets.for_each(full);
    }
}
