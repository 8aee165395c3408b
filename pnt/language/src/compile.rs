//! From a draft to a compiled net: resolves every name inside the net and reports all that do not.
//! Names of other nets are left to the analyses, which compose all nets of an app.

mod structures;
mod written;

#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::OnceLock,
};

use ctos::diagnostic::{Finding, Findings, Place as At, Source};

use crate::{
    draft::{Draft, DraftAction, DraftArc, DraftCoordinator, DraftTransition, Word},
    enough::enough,
    net::{
        Action, Arc, Command, CommandId, Net, Outputs, Part, Partner, Place, PlaceId, RemoteArc,
        Role, Servers, Transition, When,
    },
    text,
};
use structures::Expanded;

/// Parses and compiles one net that includes no files.
///
/// # Errors
/// All findings of the parser and the compiler.
pub fn net(source: &Source) -> Result<Net, Findings> {
    match text::parse(source) {
        Ok(draft) => runnable(&draft),
        // Only to give all findings.
        Err(_) => net_with(source, &mut text::no_include),
    }
}

/// The same for a net that may include files, whose texts `include` gives.
///
/// # Errors
/// All findings of the parser and the compiler.
pub fn net_with(source: &Source, include: text::Include<'_>) -> Result<Net, Findings> {
    let read = read(source, include);
    if read.findings.has_errors() {
        return Err(read.findings);
    }
    runnable(&read.draft)
}

/// What there is of a net text, right or wrong.
#[derive(Debug)]
pub struct Read {
    /// The net, without the lines that cannot be read.
    pub draft: Draft,
    /// Everything that is wrong with lines, and with names where the lines with errors leave no doubt.
    pub findings: Findings,
}

/// Reads a text. Where some lines cannot be read it checks names too, but for those that may stand on these lines.
pub(crate) fn read(source: &Source, include: text::Include<'_>) -> Read {
    let (draft, mut findings) = text::parse_all(source, include);
    if findings.has_errors() && !enough(&findings) {
        let doubtful = words_of(&findings);
        let (_, of_names) = compiled(&draft);
        for finding in of_names.into_sorted() {
            let sure = match finding.code {
                "pnt::net::unknown_place"
                | "pnt::net::unknown_symbol"
                | "pnt::net::unknown_coordinator"
                | "pnt::net::unknown_request" => {
                    let name = finding.place.as_ref().map(text_at).unwrap_or_default();
                    !name.split('.').any(|part| doubtful.contains(part))
                }
                "pnt::net::duplicate"
                | "pnt::net::over_capacity"
                | "pnt::net::remote_input"
                | "pnt::net::second_requester"
                | "pnt::net::itself" => true,
                // What a transition has or lacks is not known while some of its lines are not.
                _ => false,
            };
            if sure {
                findings.push(finding);
            }
        }
    }
    Read { draft, findings }
}

/// The text that a place points to, without quotes.
fn text_at(place: &At) -> &str {
    let text = place.source.text().get(place.range.clone());
    text.unwrap_or_default().trim_matches('"')
}

/// Every word on the lines that findings are about.
fn words_of(findings: &Findings) -> BTreeSet<String> {
    let mut words = BTreeSet::new();
    for place in findings.iter().filter_map(|finding| finding.place.as_ref()) {
        let text = place.source.text();
        let at = place.range.start.min(text.len());
        let Some((before, after)) = text.split_at_checked(at) else {
            continue;
        };
        let start = before.rfind('\n').map_or(0, |end| end + 1);
        let end = at + after.find('\n').unwrap_or(after.len());
        let line = text.get(start..end).unwrap_or_default();
        let plain = line.split(|c: char| !(c.is_alphanumeric() || c == '_'));
        words.extend(plain.chain(line.split('"')).map(str::to_owned));
    }
    words
}

/// The net of a draft without what is wrong with it, to look at how it fits to others.
#[must_use]
pub fn as_far_as_known(draft: &Draft) -> Net {
    compiled(draft).0
}

/// Compiles a net that is to be run, which must not fire for ever.
pub(crate) fn runnable(draft: &Draft) -> Result<Net, Findings> {
    let net = compile(draft)?;
    let mut findings = endless(&net);
    findings.extend(without_transitions(&net));
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(net)
    }
}

/// A finding when the net has no transitions: it does nothing, and was hardly meant so.
#[must_use]
pub fn without_transitions(net: &Net) -> Findings {
    let mut findings = Findings::new();
    if net.transitions().is_empty() {
        let text = format!("net `{}` has no transition", net.name());
        findings.push(
            Finding::error("pnt::net::no_transitions", text)
                .at(net.at().clone())
                .help("a net without transitions does nothing; was the file cut off?"),
        );
    }
    findings
}

/// Transitions that would fire for ever. A net to be analysed may have them; it is then unbounded.
#[must_use]
pub fn endless(net: &Net) -> Findings {
    let mut findings = Findings::new();
    for transition in net.transitions() {
        let source = transition.inputs.is_empty() && transition.tape.is_none();
        if source && transition.timing.is_immediate() {
            findings.push(
                Finding::error(
                    "pnt::net::no_input",
                    format!(
                        "transition `{}` takes nothing and would fire for ever",
                        transition.name
                    ),
                )
                .at(transition.at.clone())
                .help("give it an `in` place, a `tape` symbol or a `time`"),
            );
        }
    }
    findings
}

/// Compiles a draft.
///
/// # Errors
/// All findings about names used twice or not known in this net.
pub fn compile(draft: &Draft) -> Result<Net, Findings> {
    let (net, findings) = compiled(draft);
    if findings.has_errors() {
        Err(findings)
    } else {
        Ok(net)
    }
}

/// The net without what is wrong with it, and all findings.
fn compiled(draft: &Draft) -> (Net, Findings) {
    let mut findings = Findings::new();
    check_declarations(draft, &mut findings);
    let data = written::Data::of(draft, &mut findings);
    let expanded = structures::expand(draft, &mut findings);
    let names = Names::new(&expanded, draft, &mut findings);
    let mut compiler = Compiler {
        draft,
        names,
        data,
        findings,
    };
    let transitions = expanded
        .transitions
        .iter()
        .map_while(|part| (!enough(&compiler.findings)).then(|| compiler.transition(part)))
        .collect();
    let safe = draft.safe.iter().map(|arcs| compiler.arcs(arcs)).collect();
    let (findings, data) = (compiler.findings, compiler.data);
    let mut parameters = data.parameters.into_iter();
    let net = Net {
        digest: OnceLock::new(),
        declared: data.declared,
        name: draft.name.text.clone(),
        at: draft.name.at.clone(),
        title: draft.title.clone(),
        places: expanded
            .places
            .into_iter()
            .map(|(place, role)| Place {
                name: place.name.text,
                tokens: place.tokens,
                capacity: place.capacity,
                data: place.data.map(|word| word.text),
                role,
                at: place.name.at,
            })
            .collect(),
        transitions,
        commands: draft
            .commands
            .iter()
            .map(|command| Command {
                symbol: command.symbol.text.clone(),
                parameters: parameters.next().unwrap_or_default(),
                answers: texts(&command.answers),
                at: command.symbol.at.clone(),
            })
            .collect(),
        coordinators: draft
            .coordinators
            .iter()
            .map(|side| partner(&side.net, &side.requests))
            .collect(),
        serves: draft
            .serves
            .iter()
            .map(|side| partner(&side.net, &side.requests))
            .collect(),
        safe,
    };
    (net, findings)
}

fn texts(words: &[Word]) -> Vec<String> {
    words.iter().map(|word| word.text.clone()).collect()
}

fn partner(net: &Word, requests: &[Word]) -> Partner {
    Partner {
        net: net.text.clone(),
        at: net.at.clone(),
        requests: requests
            .iter()
            .map(|word| (word.text.clone(), word.at.clone()))
            .collect(),
    }
}

/// Reports names of one kind that occur twice.
fn duplicates<'a>(what: &str, words: impl IntoIterator<Item = &'a Word>, findings: &mut Findings) {
    let mut seen: BTreeMap<&str, &At> = BTreeMap::new();
    for word in words {
        if let Some(first) = seen.insert(&word.text, &word.at)
            && !enough(findings)
        {
            findings.push(
                Finding::error(
                    "pnt::net::duplicate",
                    format!("{what} `{word}` is there twice; the first is at {first}"),
                )
                .at(word.at.clone())
                .help("rename one of the two or remove it"),
            );
        }
    }
}

fn check_declarations(draft: &Draft, findings: &mut Findings) {
    duplicates(
        "command",
        draft.commands.iter().map(|c| &c.symbol),
        findings,
    );
    duplicates(
        "coordinator",
        draft.coordinators.iter().map(|c| &c.net),
        findings,
    );
    for place in &draft.places {
        if let Some(capacity) = place.capacity.filter(|most| place.tokens > *most) {
            findings.push(
                Finding::error(
                    "pnt::net::over_capacity",
                    format!(
                        "place `{}` begins with {} tokens and may hold {capacity}",
                        place.name, place.tokens
                    ),
                )
                .at(place.name.at.clone())
                .help("raise the capacity or lower the initial tokens"),
            );
        }
    }
    duplicates("data", draft.data.iter().map(|data| &data.name), findings);
    for command in &draft.commands {
        duplicates("output symbol", &command.answers, findings);
    }
    for coordinator in &draft.coordinators {
        duplicates("request", &coordinator.requests, findings);
    }
    if let Some(second) = draft.serves.get(1) {
        findings.push(
            Finding::error(
                "pnt::net::second_requester",
                "a net serves one requester, and this is its second `serves` line",
            )
            .at(second.net.at.clone())
            .help("one request at a time can only be kept for one requester; give the second its own coordinator net"),
        );
    }
    for (net, what) in draft
        .coordinators
        .iter()
        .map(|c| (&c.net, "asks"))
        .chain(draft.serves.iter().map(|s| (&s.net, "serves")))
    {
        if net == &draft.name {
            findings.push(
                Finding::error("pnt::net::itself", format!("net `{net}` {what} itself"))
                    .at(net.at.clone())
                    .help("name the other net here"),
            );
        }
    }
}

/// What names mean in this net.
struct Names<'a> {
    places: BTreeMap<&'a str, PlaceId>,
    commands: BTreeMap<&'a str, CommandId>,
    answers: BTreeSet<&'a str>,
}

impl<'a> Names<'a> {
    fn new(expanded: &'a Expanded, draft: &'a Draft, findings: &mut Findings) -> Self {
        duplicates(
            "place",
            expanded.places.iter().map(|(p, _)| &p.name),
            findings,
        );
        duplicates(
            "transition",
            expanded.transitions.iter().map(|part| &part.draft.name),
            findings,
        );
        Self {
            places: (0..)
                .zip(&expanded.places)
                .map(|(index, (place, _))| (place.name.text.as_str(), PlaceId(index)))
                .collect(),
            commands: (0..)
                .zip(&draft.commands)
                .map(|(index, command)| (command.symbol.text.as_str(), CommandId(index)))
                .collect(),
            answers: draft
                .commands
                .iter()
                .flat_map(|command| &command.answers)
                .map(|word| word.text.as_str())
                .collect(),
        }
    }
}

struct Compiler<'a> {
    draft: &'a Draft,
    names: Names<'a>,
    data: written::Data,
    findings: Findings,
}

impl Compiler<'_> {
    fn transition(&mut self, part: &structures::PartOf) -> Transition {
        let draft = &part.draft;
        if part.part == Part::Whole && draft.action.is_none() && draft.sets.is_empty() {
            self.without_action(draft);
        }
        let mut outputs = self.outputs(&draft.outputs);
        outputs.remote.extend(
            part.handshake
                .iter()
                .filter_map(|arc| remote(arc, Role::Coordination)),
        );
        Transition {
            name: draft.name.text.clone(),
            inputs: self.arcs(&draft.inputs),
            reads: self.arcs(&draft.reads),
            inhibitors: self.arcs(&draft.inhibitors),
            resets: self.resets(&draft.resets),
            tape: draft.tape.as_ref().and_then(|symbol| self.command(symbol)),
            when: draft.when.as_ref().map(|when| When {
                function: when.function.text.clone(),
                expression: self.data.guard(when, &mut self.findings),
                negated: when.negated,
                at: when.function.at.clone(),
            }),
            action: self.action(draft),
            outputs,
            fail: (!draft.fail.is_empty()).then(|| self.outputs(&draft.fail)),
            write: draft.write.as_ref().and_then(|symbol| self.answer(symbol)),
            priority: draft.priority,
            within: draft.within,
            timing: draft.timing,
            weight: draft.weight,
            servers: draft.servers.unwrap_or(Servers::usual(draft.timing)),
            part: part.part,
            at: draft.name.at.clone(),
        }
    }

    fn action(&mut self, draft: &DraftTransition) -> Option<Action> {
        let idempotent = draft.idempotent;
        match draft.action.as_ref().and_then(|it| called(it, idempotent)) {
            Some(action) => {
                written::refuse_data(draft, &action, &self.data.declared, &mut self.findings);
                Some(action)
            }
            None => self.data.action(draft, &mut self.findings),
        }
    }

    /// What only an action can have.
    fn without_action(&mut self, draft: &DraftTransition) {
        let needless = draft
            .fail
            .first()
            .map(|arc| (&arc.place.at, "a failure branch"))
            .or_else(|| draft.within.map(|_| (&draft.name.at, "a time limit")))
            .or_else(|| {
                draft
                    .idempotent
                    .then_some((&draft.name.at, "an `idempotent` line"))
            });
        if let Some((at, what)) = needless {
            self.findings.push(
                Finding::error(
                    "pnt::net::cannot_fail",
                    format!(
                        "transition `{}` has {what} and no action that needs it",
                        draft.name
                    ),
                )
                .at(at.clone())
                .help("add a `do`, `ask`, `send`, `request`, `wait`, `log` or `set` line, or remove this"),
            );
        }
    }

    fn place(&mut self, word: &Word) -> Option<PlaceId> {
        let found = self.names.places.get(word.text.as_str()).copied();
        if found.is_none() {
            self.findings.push(
                Finding::error(
                    "pnt::net::unknown_place",
                    format!("net `{}` has no place `{word}`", self.draft.name),
                )
                .at(word.at.clone())
                .help("declare it with a `place` line")
                .suggest(&word.text, self.names.places.keys().copied()),
            );
        }
        found
    }

    /// Places to empty.
    fn resets(&mut self, words: &[Word]) -> Vec<PlaceId> {
        duplicates("place", words, &mut self.findings);
        words.iter().filter_map(|word| self.place(word)).collect()
    }

    /// Arcs within the net.
    fn arcs(&mut self, arcs: &[DraftArc]) -> Vec<Arc> {
        duplicates(
            "place",
            arcs.iter().map(|arc| &arc.place),
            &mut self.findings,
        );
        let mut resolved = Vec::new();
        for arc in arcs {
            if let Some(net) = &arc.net {
                self.findings.push(
                    Finding::error(
                        "pnt::net::remote_input",
                        format!("a token of another net cannot be an input: `{}@{net}`", arc.place),
                    )
                    .at(net.at.clone())
                    .help(format!(
                        "declare the place here and let net `{net}` put its token into it with `out place@{}`",
                        self.draft.name
                    )),
                );
            } else if let Some(place) = self.place(&arc.place) {
                resolved.push(Arc {
                    place,
                    weight: arc.weight,
                });
            }
        }
        resolved
    }

    fn outputs(&mut self, arcs: &[DraftArc]) -> Outputs {
        let (local, other): (Vec<_>, Vec<_>) = arcs
            .iter()
            .cloned()
            .map(|mut arc| {
                // A place addressed through this net's own name is a local one.
                arc.net = arc.net.filter(|net| net != &self.draft.name);
                arc
            })
            .partition(|arc| arc.net.is_none());
        Outputs {
            local: self.arcs(&local),
            remote: other
                .iter()
                .filter_map(|arc| remote(arc, Role::Declared))
                .collect(),
        }
    }

    fn command(&mut self, symbol: &Word) -> Option<CommandId> {
        let found = self.names.commands.get(symbol.text.as_str()).copied();
        if found.is_none() {
            self.findings.push(
                Finding::error(
                    "pnt::net::unknown_symbol",
                    format!("no `command` line declares the tape symbol `{symbol}`"),
                )
                .at(symbol.at.clone())
                .help("declare it: `command SYMBOL -> ANSWER, ...`")
                .suggest(&symbol.text, self.names.commands.keys().copied()),
            );
        }
        found
    }

    fn answer(&mut self, symbol: &Word) -> Option<String> {
        if !self.names.answers.contains(symbol.text.as_str()) {
            self.findings.push(
                Finding::error(
                    "pnt::net::unknown_symbol",
                    format!("no `command` line has the output symbol `{symbol}` as an answer"),
                )
                .at(symbol.at.clone())
                .help("add it to the answers of a `command` line")
                .suggest(&symbol.text, self.names.answers.iter().copied()),
            );
        }
        Some(symbol.text.clone())
    }
}

fn remote(arc: &DraftArc, role: Role) -> Option<RemoteArc> {
    arc.net.as_ref().map(|net| RemoteArc {
        net: net.text.clone(),
        place: arc.place.text.clone(),
        weight: arc.weight,
        role,
        at: arc.place.at.clone(),
    })
}

/// The action of an expanded transition that is called by its name; `ask` has become arcs by then.
fn called(draft: &DraftAction, idempotent: bool) -> Option<Action> {
    match draft {
        DraftAction::Do {
            function,
            inputs,
            outputs,
        } => Some(Action::Local {
            function: function.text.clone(),
            inputs: texts(inputs),
            outputs: texts(outputs),
            idempotent,
            at: function.at.clone(),
        }),
        DraftAction::Send {
            task,
            command,
            inputs,
            outputs,
        } => Some(Action::Message {
            task: task.text.clone(),
            command: command.text.clone(),
            inputs: texts(inputs),
            outputs: texts(outputs),
            idempotent,
            at: task.at.clone(),
        }),
        DraftAction::Ask { .. }
        | DraftAction::Request { .. }
        | DraftAction::Wait { .. }
        | DraftAction::Log { .. } => None,
    }
}

/// The coordinator of this net called `net`.
fn coordinator<'a>(draft: &'a Draft, net: &Word) -> Option<&'a DraftCoordinator> {
    draft.coordinators.iter().find(|side| &side.net == net)
}
