//! The parser of net text (`docs/net-text.md`): goes on after a mistake and gives all findings at
//! once, each with its place and what to do. Knows how text looks, not what a net means.

mod format;
pub mod grammar;
mod keywords;
mod line;
pub mod outline;
mod subnet;
mod words;

#[cfg(test)]
pub(crate) mod tests;

use ctos::diagnostic::{Finding, Findings, Source};

use crate::{
    draft::{
        Draft, DraftAction, DraftArc, DraftCommand, DraftCoordinator, DraftData, DraftField,
        DraftPlace, DraftServes, DraftSet, DraftShape, DraftTransition, DraftWhen, InText, Spot,
        Word,
    },
    enough::enough,
};
pub use format::formatted;
pub(crate) use keywords::is_keyword;
use keywords::{CLAUSES, DECLARATIONS};
pub use subnet::Include;
use subnet::{Expansion, Line, Subnets};
pub(crate) use words::MOST_TOKENS;
use words::Words;

/// A name as net text has it: as it is, or in quotes where it is not an identifier.
#[must_use]
pub fn name_in_text(name: &str) -> String {
    InText(name).to_string()
}

/// Parses one net that includes no files.
///
/// # Errors
/// All findings, when at least one of them is an error.
pub fn parse(source: &Source) -> Result<Draft, Findings> {
    parse_with(source, &mut no_include)
}

/// Refuses to include a file.
///
/// # Errors
/// Always.
pub(crate) fn no_include(file: &str) -> Result<Source, Finding> {
    let text = format!("`{file}` cannot be included here");
    Err(Finding::error("pnt::text::subnet", text)
        .help("only a net that is read from a file can include others"))
}

/// Parses one net; `include` gives the texts of the files that it includes, by the names it has for
/// them.
///
/// # Errors
/// All findings, when at least one of them is an error.
pub fn parse_with(source: &Source, include: Include<'_>) -> Result<Draft, Findings> {
    let (draft, findings) = parse_all(source, include);
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(draft)
    }
}

/// What can be read of a net, without the lines that cannot, and all findings about those.
pub(crate) fn parse_all(source: &Source, include: Include<'_>) -> (Draft, Findings) {
    let mut findings = Findings::new();
    let lines = subnet::cut(source, source.text(), 0, &mut findings);
    let mut subnets = Subnets::default();
    let lines = subnets.take(lines, include, &mut findings);
    let expansion = Expansion::of(&subnets);
    let mut parser = Parser::new(Draft::new(Word::new("", source.at(0..0))), expansion);
    parser.findings = findings;
    parser.lines(lines);
    parser.unused();
    if !parser.named {
        parser.findings.push(
            Finding::error("pnt::text::no_net", "this text names no net")
                .at(source.at_line(1))
                .help("begin with a line such as `net dispatcher \"what it does\"`"),
        );
    }
    (parser.draft, parser.findings)
}

/// Reads lines of a transition that stand at byte `start` of another file.
pub(crate) fn clauses(
    source: &Source,
    text: &str,
    start: usize,
    transition: &mut DraftTransition,
    findings: &mut Findings,
) {
    let none = Subnets::default();
    let draft = Draft::new(transition.name.clone());
    let mut parser = Parser::new(draft, Expansion::of(&none));
    parser.draft.transitions.push(transition.clone());
    parser.named = true;
    parser.in_transition = true;
    let lines = subnet::cut(source, text, start, &mut parser.findings);
    parser.lines(lines);
    findings.extend(parser.findings);
    if let Some(read) = parser.draft.transitions.into_iter().next() {
        *transition = read;
    }
}

/// Reads lines of a net that stand at byte `start` of another file.
pub(crate) fn declarations(
    source: &Source,
    text: &str,
    start: usize,
    draft: &mut Draft,
    findings: &mut Findings,
) {
    let none = Subnets::default();
    let mut parser = Parser::new(draft.clone(), Expansion::of(&none));
    parser.named = true;
    let lines = subnet::cut(source, text, start, &mut parser.findings);
    parser.lines(lines);
    findings.extend(parser.findings);
    *draft = parser.draft;
}

/// Reads what follows a place's name, from byte `start` of another file.
pub(crate) fn place_rest(
    source: &Source,
    text: &str,
    start: usize,
    place: &mut DraftPlace,
    findings: &mut Findings,
) {
    let trimmed = text.trim_start();
    let start = start + (text.len() - trimmed.len());
    let trimmed = trimmed.trim_end();
    let read = line::cut(source, trimmed, start)
        .map_err(|bad| Finding::error("pnt::text::symbol", bad.message).at(source.at(bad.range)))
        .and_then(|tokens| {
            let mut words = Words::new(source, &tokens, start + trimmed.len());
            rest_of_place(&mut words, place)?;
            words.end()
        });
    findings.keep(read);
}

struct Parser<'s> {
    findings: Findings,
    draft: Draft,
    expansion: Expansion<'s>,
    named: bool,
    in_transition: bool,
    /// Whether the lines are those of an instance of a subnet.
    in_subnet: bool,
}

impl<'s> Parser<'s> {
    fn new(draft: Draft, expansion: Expansion<'s>) -> Self {
        Self {
            findings: Findings::new(),
            draft,
            expansion,
            named: false,
            in_transition: false,
            in_subnet: false,
        }
    }

    fn lines(&mut self, lines: Vec<Line>) {
        for line in lines {
            if enough(&self.findings) {
                return;
            }
            self.line(&line);
        }
    }

    /// Reads one line; what is wrong with it becomes one finding.
    fn line(&mut self, line: &Line) {
        if line.begins("use") {
            self.in_transition = false;
            let instance = self.instance(line);
            self.findings.keep(instance);
            return;
        }
        let mut words = Words::new(&line.source, &line.tokens, line.end);
        let result = words
            .first()
            .and_then(|keyword| self.statement(&keyword, &mut words))
            .and_then(|()| words.end());
        self.findings.keep(result);
    }

    /// Reads the subnets that the net does not use, for their mistakes. Of a line with a parameter, whose
    /// meaning is open, only the keyword is judged.
    fn unused(&mut self) {
        for lines in self.expansion.unused() {
            let mut parser =
                Parser::new(Draft::new(self.draft.name.clone()), self.expansion.lend());
            parser.named = true;
            parser.in_subnet = true;
            for (line, open) in lines {
                let before = std::mem::take(&mut parser.findings);
                if !(open && line.begins("use")) {
                    parser.line(&line);
                }
                let found = std::mem::replace(&mut parser.findings, before);
                for finding in found.into_sorted() {
                    if !open || finding.code == "pnt::text::keyword" {
                        parser.findings.push(finding);
                    }
                }
            }
            self.expansion.take_back(parser.expansion);
            self.findings.extend(parser.findings);
        }
    }

    /// Adds the places and transitions of an instance of a subnet.
    fn instance(&mut self, line: &Line) -> Result<(), Finding> {
        let name = self.draft.name.clone();
        let read = |expansion: &mut Expansion<'s>, lines: Vec<Line>, findings: &mut Findings| {
            let mut parser = Parser::new(Draft::new(name), expansion.lend());
            parser.named = true;
            parser.in_subnet = true;
            parser.lines(lines);
            expansion.take_back(parser.expansion);
            findings.extend(parser.findings);
            parser.draft
        };
        let instance = self.expansion.instance(line, &mut self.findings, read)?;
        self.draft.places.extend(instance.places);
        self.draft.transitions.extend(instance.transitions);
        Ok(())
    }

    fn statement(&mut self, keyword: &Word, words: &mut Words<'_>) -> Result<(), Finding> {
        if DECLARATIONS.contains(&keyword.text.as_str()) {
            self.in_transition = keyword.text == "transition";
            if self.in_subnet && !["place", "transition"].contains(&keyword.text.as_str()) {
                return Err(Finding::error(
                    "pnt::text::subnet",
                    format!("a subnet has no `{keyword}` lines"),
                )
                .at(keyword.at.clone())
                .help(
                    "put it into the net itself; a subnet has places, transitions and instances",
                ));
            }
            return self.declaration(keyword, words);
        }
        if !CLAUSES.contains(&keyword.text.as_str()) {
            let known = DECLARATIONS.iter().chain(&CLAUSES).copied();
            return Err(Finding::error(
                "pnt::text::keyword",
                format!("no line of net text begins with `{keyword}`"),
            )
            .at(keyword.at.clone())
            .suggest(&keyword.text, known));
        }
        match self.draft.transitions.last_mut() {
            Some(transition) if self.in_transition => clause(transition, keyword, words),
            _ => Err(Finding::error(
                "pnt::text::clause_outside",
                format!("`{keyword}` belongs to a transition, and none is open here"),
            )
            .at(keyword.at.clone())
            .help("put it below the `transition` line it belongs to")),
        }
    }

    fn declaration(&mut self, keyword: &Word, words: &mut Words<'_>) -> Result<(), Finding> {
        match keyword.text.as_str() {
            "net" => self.net(keyword, words),
            "place" => self.places(words),
            "data" => {
                let data = data(words)?;
                self.draft.data.push(data);
                Ok(())
            }
            "command" => {
                let symbol = words.name("the command's symbol")?;
                let mut parameters = Vec::new();
                if words.take("(") {
                    parameters = fields(words, ")")?;
                }
                words.mark("->")?;
                let answers = words.names("an output symbol")?;
                self.draft.commands.push(DraftCommand {
                    symbol,
                    parameters,
                    answers,
                });
                Ok(())
            }
            "coordinator" => {
                let net = words.name("the coordinator's net")?;
                words.mark(":")?;
                let requests = words.names("a request")?;
                self.draft
                    .coordinators
                    .push(DraftCoordinator { net, requests });
                Ok(())
            }
            "serves" => self.serves(words),
            "safe" => {
                let safe = words.arcs()?;
                self.draft.safe.push(safe);
                Ok(())
            }
            "subnet" | "use" | "end" | "include" => Err(Finding::error(
                "pnt::text::subnet",
                format!("`{keyword}` cannot stand here"),
            )
            .at(keyword.at.clone())
            .help("subnets are declared in files of net text, outside of each other")),
            _ => {
                // The transition is opened even if its line is bad, so that its clauses are read.
                let name = words.name("the transition's name");
                let shown = name.clone().unwrap_or_else(|_| keyword.clone());
                self.draft.transitions.push(DraftTransition::new(shown));
                name.map(|_| ())
            }
        }
    }

    fn net(&mut self, keyword: &Word, words: &mut Words<'_>) -> Result<(), Finding> {
        if self.named {
            return Err(Finding::error(
                "pnt::text::second_net",
                "a file holds one net, and this is the second `net` line",
            )
            .at(keyword.at.clone())
            .help("move the second net into a file of its own"));
        }
        // Also after a bad name: one mistake, one finding.
        self.named = true;
        self.draft.name = words.name("the net's name")?;
        self.draft.title = words.quoted();
        Ok(())
    }

    fn places(&mut self, words: &mut Words<'_>) -> Result<(), Finding> {
        loop {
            let mut place = DraftPlace::new(words.name("a place")?);
            rest_of_place(words, &mut place)?;
            self.draft.places.push(place);
            if !words.take(",") {
                return Ok(());
            }
        }
    }

    fn serves(&mut self, words: &mut Words<'_>) -> Result<(), Finding> {
        let net = words.name("the requester's net")?;
        words.mark(":")?;
        let requests = words.names("a request")?;
        words.mark(";")?;
        words.expect_keyword("done")?;
        let done = words.place("the place of finished requests")?;
        let failed = if words.take(";") {
            words.expect_keyword("failed")?;
            Some(words.place("the place of failed requests")?)
        } else {
            None
        };
        self.draft.serves.push(DraftServes {
            net,
            requests,
            done,
            failed,
        });
        Ok(())
    }
}

/// What follows a place's name.
fn rest_of_place(words: &mut Words<'_>, place: &mut DraftPlace) -> Result<(), Finding> {
    if words.take("=") {
        place.tokens = words.whole("the initial tokens", 0)?;
    }
    if words.keyword("capacity") {
        place.capacity = Some(words.whole("the capacity", 1)?);
    }
    if words.keyword("data") {
        place.data = Some(words.name("the data object")?);
    }
    Ok(())
}

/// What follows `data`: `D : TYPE`, `D : TYPE = EXPRESSION` or `D { a : TYPE, b : TYPE }`.
fn data(words: &mut Words<'_>) -> Result<DraftData, Finding> {
    let name = words.name("the data's name")?;
    if words.take("{") {
        let fields = fields(words, "}")?;
        let shape = DraftShape::Fields(fields);
        return Ok(DraftData { name, shape });
    }
    words.mark(":")?;
    let kind = words.name("a type")?;
    let initial = match words.take("=") {
        true => Some(words.expression("what it is at first")?),
        false => None,
    };
    let shape = DraftShape::One { kind, initial };
    Ok(DraftData { name, shape })
}

/// Names with their types, up to a mark.
fn fields(words: &mut Words<'_>, end: &str) -> Result<Vec<DraftField>, Finding> {
    let mut fields = Vec::new();
    loop {
        let name = words.name("a name")?;
        words.mark(":")?;
        let kind = words.name("a type")?;
        fields.push(DraftField { name, kind });
        if !words.take(",") {
            break;
        }
    }
    words.mark(end)?;
    Ok(fields)
}

/// The places of an `out` line; `P data D = reply` also stores what a request was answered.
fn outputs(transition: &mut DraftTransition, words: &mut Words<'_>) -> Result<(), Finding> {
    loop {
        let arc: DraftArc = words.arc()?;
        transition.outputs.push(arc);
        if words.keyword("data") {
            let target = words.place("the data")?;
            words.mark("=")?;
            let value = words.name("`reply`")?;
            if value.text != DraftSet::REPLY {
                let text =
                    format!("a place stores what a request was answered: `reply`, not `{value}`");
                return Err(Finding::error("pnt::text::expected", text)
                    .at(value.at)
                    .help("write `= reply`, or another value in a `set` line"));
            }
            transition.sets.push(DraftSet { target, value });
        }
        if !words.take(",") {
            return Ok(());
        }
    }
}

fn clause(
    transition: &mut DraftTransition,
    keyword: &Word,
    words: &mut Words<'_>,
) -> Result<(), Finding> {
    match keyword.text.as_str() {
        "in" => transition.inputs.extend(words.arcs()?),
        "read" => transition.reads.extend(words.arcs()?),
        "inhibit" => transition.inhibitors.extend(words.arcs()?),
        "out" => outputs(transition, words)?,
        "fail" => transition.fail.extend(words.arcs()?),
        "tape" => once(&mut transition.tape, keyword, words.name("a symbol")?)?,
        "write" => once(&mut transition.write, keyword, words.name("a symbol")?)?,
        "within" => once(&mut transition.within, keyword, words.duration()?)?,
        "reset" => transition.resets.extend(words.places()?),
        "idempotent" => transition.idempotent = true,
        "time" => {
            let timing = words.timing()?;
            let before = std::mem::replace(&mut transition.timing, timing);
            once(
                &mut (!before.is_immediate()).then_some(before),
                keyword,
                timing,
            )?;
        }
        "weight" => transition.weight = words.weight()?,
        "servers" => once(&mut transition.servers, keyword, words.servers()?)?,
        "priority" => transition.priority = words.whole("the priority", 0)?,
        "when" => {
            // A function called `not` stands in quotes.
            let negated = words.keyword("not");
            let expression = words.is_expression();
            let function = match (expression, negated) {
                (true, _) => words.expression("an expression")?,
                (_, true) => words.name("an enabling function after `not`")?,
                (_, false) => words.name("an enabling function")?,
            };
            let when = DraftWhen {
                function,
                negated,
                expression,
            };
            once(&mut transition.when, keyword, when)?;
        }
        "set" => {
            let target = words.place("data")?;
            words.mark("=")?;
            let value = words.expression("an expression")?;
            transition.sets.push(DraftSet { target, value });
        }
        _ => {
            let action = action(keyword, words)?;
            once(&mut transition.action, keyword, action)?;
        }
    }
    Ok(())
}

fn action(keyword: &Word, words: &mut Words<'_>) -> Result<DraftAction, Finding> {
    match keyword.text.as_str() {
        "do" => {
            let function = words.name("a local function")?;
            let (inputs, outputs) = objects(words)?;
            Ok(DraftAction::Do {
                function,
                inputs,
                outputs,
            })
        }
        "request" => Ok(DraftAction::Request {
            line: words.line("the line of a request in quotes")?,
        }),
        "log" => Ok(DraftAction::Log {
            line: words.line("the line of the log in quotes")?,
        }),
        "wait" => Ok(DraftAction::Wait {
            time: words.wait()?,
            at: Spot(keyword.at.clone()),
        }),
        "ask" => Ok(DraftAction::Ask {
            coordinator: words.name("a coordinator")?,
            request: words.name("a request")?,
        }),
        _ => {
            let task = words.name("a task")?;
            words.mark(".")?;
            let command = words.name("a command")?;
            let (inputs, outputs) = objects(words)?;
            Ok(DraftAction::Send {
                task,
                command,
                inputs,
                outputs,
            })
        }
    }
}

/// The data objects that go along with an action, and those that its result is stored as.
fn objects(words: &mut Words<'_>) -> Result<(Vec<Word>, Vec<Word>), Finding> {
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    if words.take("(") && !words.take(")") {
        if !words.take("->") {
            inputs = words.names("a data object")?;
            if words.take("->") {
                outputs = words.names("a data object")?;
            }
        } else {
            outputs = words.names("a data object")?;
        }
        words.mark(")")?;
    }
    Ok((inputs, outputs))
}

/// Sets what a transition can have once.
fn once<T>(slot: &mut Option<T>, keyword: &Word, value: T) -> Result<(), Finding> {
    if slot.is_some() {
        let (what, help) = match keyword.text.as_str() {
            "do" | "ask" | "send" | "request" | "wait" | "log" => (
                "this transition already has an action",
                "split it into two transitions with a place between them",
            ),
            _ => (
                "this transition already has such a line",
                "remove one of the two",
            ),
        };
        return Err(
            Finding::error("pnt::text::twice", format!("`{keyword}`: {what}"))
                .at(keyword.at.clone())
                .help(help),
        );
    }
    *slot = Some(value);
    Ok(())
}
