//! What stands in the net's text itself: declared data, guards that are expressions, and actions that are lines of
//! text. Every name and type in them is checked here.

use ctos::diagnostic::{Finding, Findings};

use super::duplicates;
use crate::{
    data::{Declared, Kind, Parameter, parameters},
    draft::{Draft, DraftAction, DraftSet, DraftShape, DraftTransition, DraftWhen, Word},
    expression::{Expression, Scope, Values, part},
    net::{Action, Does, Line, LinePart, Set, SetTo},
};

/// A name in a line, and its values with their types.
type Named = (String, Vec<(String, Kind)>);

/// What expressions and lines of a net may name.
pub(super) struct Data {
    pub(super) declared: Declared,
    /// Those of each command, in order.
    pub(super) parameters: Vec<Vec<Parameter>>,
    /// Those of all commands, each once.
    all: Vec<Parameter>,
}

impl Data {
    pub(super) fn of(draft: &Draft, findings: &mut Findings) -> Self {
        let mut declared = Declared::of(draft, findings);
        for one in &draft.data {
            match &one.shape {
                DraftShape::One { initial, .. } => {
                    if let Some(initial) = initial {
                        begin_with(&mut declared, &one.name, initial, findings);
                    }
                }
                DraftShape::Fields(fields) => {
                    duplicates("field", fields.iter().map(|field| &field.name), findings);
                }
            }
        }
        let mut all: Vec<Parameter> = Vec::new();
        let mut of_commands = Vec::new();
        for command in &draft.commands {
            let own = parameters(&command.parameters, findings);
            duplicates(
                "argument",
                command.parameters.iter().map(|p| &p.name),
                findings,
            );
            for one in &own {
                let before = all.iter().find(|other| other.name == one.name);
                let what = match before {
                    Some(other) if other.kind != one.kind => {
                        "is of another type in another command"
                    }
                    _ if declared.named(&one.name).is_some() => "is the name of data, too",
                    Some(_) => continue,
                    None => {
                        all.push(one.clone());
                        continue;
                    }
                };
                let text = format!(
                    "argument `{}` of command `{}` {what}",
                    one.name, command.symbol
                );
                findings.push(
                    Finding::error("pnt::net::data", text)
                        .at(one.at.clone())
                        .help("rename one of the two: a name means one thing in a net"),
                );
            }
            of_commands.push(own);
        }
        Self {
            declared,
            parameters: of_commands,
            all,
        }
    }

    /// Names that a guard may have: an argument is there only while its command is in progress.
    fn of_guard(&self) -> Scope<'_> {
        Scope {
            declared: &self.declared,
            parameters: &[],
        }
    }

    fn of_action(&self) -> Scope<'_> {
        Scope {
            declared: &self.declared,
            parameters: &self.all,
        }
    }

    /// The expression of a `when` line, if it is one.
    pub(super) fn guard(&self, when: &DraftWhen, findings: &mut Findings) -> Option<Expression> {
        if !when.expression && self.declared.named(&when.function.text).is_none() {
            return None;
        }
        let checked = Expression::checked(&when.function, self.of_guard(), Some(Kind::Bool));
        let told = checked.map_err(|finding| {
            let argument = self.all.iter().any(|one| finding.message.contains(&format!("`{}`", one.name)));
            match argument && finding.code == "pnt::net::unknown_data" {
                true => finding.help("an argument of a command is no data: `set` data to it when the command is read"),
                false => finding,
            }
        });
        findings.keep(told)
    }

    /// The action that a transition's lines of text are.
    pub(super) fn action(
        &self,
        draft: &DraftTransition,
        findings: &mut Findings,
    ) -> Option<Action> {
        let (does, at) = match &draft.action {
            None => (None, draft.sets.first()?.target.at.clone()),
            Some(DraftAction::Request { line }) => (
                Some(Does::Request(self.line(line, findings))),
                line.at.clone(),
            ),
            Some(DraftAction::Log { line }) => {
                (Some(Does::Log(self.line(line, findings))), line.at.clone())
            }
            Some(DraftAction::Wait { time, at }) => (Some(Does::Wait(*time)), at.0.clone()),
            Some(DraftAction::Do { .. } | DraftAction::Ask { .. } | DraftAction::Send { .. }) => {
                return None;
            }
        };
        let asks = matches!(does, Some(Does::Request(_)));
        let sets = draft.sets.iter().filter_map(|set| {
            let read = self.set(set, asks);
            findings.keep(read)
        });
        Some(Action::Written {
            does,
            sets: sets.collect(),
            idempotent: draft.idempotent,
            at,
        })
    }

    fn set(&self, set: &DraftSet, asks: bool) -> Result<Set, Finding> {
        let (name, declared) = (set.target.text.as_str(), &self.declared);
        let slots = declared.slot(name).map(|slot| slot..slot + 1);
        let fields = || declared.named(name).map(|data| data.slots.clone());
        let slots = slots.or_else(fields).ok_or_else(|| {
            let known = declared.slots.iter().map(|slot| slot.name.as_str());
            let known = known.chain(declared.data.iter().map(|data| data.name.as_str()));
            Finding::error(
                "pnt::net::unknown_data",
                format!("nothing declares data `{name}`"),
            )
            .at(set.target.at.clone())
            .help("declare it: `data NAME : TYPE`")
            .suggest(name, known)
        })?;
        let to = if set.value.text == DraftSet::REPLY {
            if !asks {
                let text =
                    format!("`{name}` shall be a reply, and this transition makes no request");
                return Err(Finding::error("pnt::net::data", text)
                    .at(set.value.at.clone())
                    .help("add a `request` line to the transition"));
            }
            SetTo::Reply
        } else {
            let slot = declared.slots.get(slots.start);
            let only = slot.filter(|_| slots.len() == 1).ok_or_else(|| {
                let text = format!("`{name}` has fields, and an expression is one value");
                Finding::error("pnt::net::data", text)
                    .at(set.target.at.clone())
                    .help(format!("set each field: `set {name}.FIELD = EXPRESSION`"))
            })?;
            SetTo::Value(Expression::checked(
                &set.value,
                self.of_action(),
                Some(only.kind),
            )?)
        };
        Ok(Set {
            name: name.to_owned(),
            slots,
            to,
            at: set.target.at.clone(),
        })
    }

    /// A line with its values: `$name` or `$name.field`; `$$` is a `$`.
    fn line(&self, word: &Word, findings: &mut Findings) -> Line {
        let mut parts = Vec::new();
        let mut rest = word.text.as_str();
        let mut text = String::new();
        while let Some((before, after)) = rest.split_once('$') {
            text.push_str(before);
            if let Some(after) = after.strip_prefix('$') {
                text.push('$');
                rest = after;
                continue;
            }
            let begins = word.text.len() - after.len() - 1;
            let name = head(after);
            let (name, values) = match self.values(name, after) {
                Ok(found) => found,
                Err((message, help)) => {
                    let known = self.declared.data.iter().map(|data| data.name.as_str());
                    let known = known.chain(self.all.iter().map(|one| one.name.as_str()));
                    let range = begins..begins + 1 + name.len();
                    findings.push(
                        Finding::error("pnt::net::unknown_data", message)
                            .at(part(word, range))
                            .help(help)
                            .suggest(name, known),
                    );
                    (name.to_owned(), Vec::new())
                }
            };
            rest = after.get(name.len()..).unwrap_or_default();
            if !text.is_empty() {
                parts.push(LinePart::Text(std::mem::take(&mut text)));
            }
            let at = part(word, begins..begins + 1 + name.len());
            parts.push(LinePart::Values { name, values, at });
        }
        text.push_str(rest);
        if !text.is_empty() {
            parts.push(LinePart::Text(text));
        }
        Line {
            text: word.text.clone(),
            parts,
            at: word.at.clone(),
        }
    }

    /// The values of the name behind a `$`, and all of that name.
    fn values(&self, name: &str, text: &str) -> Result<Named, (String, &'static str)> {
        if name.is_empty() {
            return Err((
                "a `$` stands before a name of data".to_owned(),
                "write `$$` for the character itself",
            ));
        }
        if let Some(one) = self.all.iter().find(|one| one.name == name) {
            return Ok((name.to_owned(), vec![(name.to_owned(), one.kind)]));
        }
        let Some(data) = self.declared.named(name) else {
            return Err((
                format!("nothing declares `{name}`"),
                "declare it: `data NAME : TYPE`, or as an argument of a command; `$$` is a `$`",
            ));
        };
        let slots = self
            .declared
            .slots
            .get(data.slots.clone())
            .unwrap_or_default();
        let behind = text
            .get(name.len()..)
            .and_then(|text| text.strip_prefix('.'));
        if let Some(field) = behind.map(head).filter(|field| !field.is_empty()) {
            let whole = format!("{name}.{field}");
            if let Some(slot) = slots.iter().find(|slot| slot.name == whole) {
                return Ok((whole.clone(), vec![(whole, slot.kind)]));
            }
            if slots.len() != 1 || slots.iter().any(|slot| slot.name != name) {
                return Err((
                    format!("`{name}` has no field `{field}`"),
                    "write one of its fields, or the name alone for all of them",
                ));
            }
        }
        let values = slots.iter().map(|slot| (slot.name.clone(), slot.kind));
        Ok((name.to_owned(), values.collect()))
    }
}

/// The letters, digits and `_` at the beginning of a text.
fn head(text: &str) -> &str {
    let length = text.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
    text.get(..length.unwrap_or(text.len())).unwrap_or_default()
}

/// What data is at first.
fn begin_with(declared: &mut Declared, name: &Word, initial: &Word, findings: &mut Findings) {
    let Some(index) = declared
        .slots
        .iter()
        .position(|slot| slot.name == name.text)
    else {
        return;
    };
    let nothing = Declared::default();
    let scope = Scope {
        declared: &nothing,
        parameters: &[],
    };
    let kind = declared.slots.get(index).map(|slot| slot.kind);
    let values = Values {
        declared: &nothing,
        values: &[],
        arguments: &[],
    };
    let read = Expression::checked(initial, scope, kind).and_then(|expression| {
        expression.evaluate(&values).map_err(|error| {
            Finding::error("pnt::net::data", error.why)
                .at(initial.at.clone())
                .help("give another value")
        })
    });
    if let (Some(value), Some(slot)) = (findings.keep(read), declared.slots.get_mut(index)) {
        slot.initial = value;
    }
}

/// Data of the net does not go into functions of a library, and is not set beside functions and messages.
pub(super) fn refuse_data(
    draft: &DraftTransition,
    action: &Action,
    declared: &Declared,
    findings: &mut Findings,
) {
    let (Action::Local {
        inputs,
        outputs,
        at,
        ..
    }
    | Action::Message {
        inputs,
        outputs,
        at,
        ..
    }) = action
    else {
        return;
    };
    let functions = matches!(action, Action::Local { .. });
    let objects = inputs.iter().chain(outputs).filter(|_| functions);
    if let Some(own) = objects
        .into_iter()
        .find(|name| declared.named(name).is_some())
    {
        let text = format!(
            "`{own}` is data of the net, and here stand objects of the data object manager"
        );
        findings.push(Finding::error("pnt::net::data", text).at(at.clone()).help(
            "data of the net goes with `request`, `send`, `log` and `set` lines and `when` expressions",
        ));
    }
    if let Some(set) = draft.sets.first() {
        let text = format!(
            "transition `{}` sets data beside a `do` or `send` line",
            draft.name
        );
        findings.push(
            Finding::error("pnt::net::data", text)
                .at(set.target.at.clone())
                .help("put the `set` line into a transition of its own, or beside a `request`, `wait` or `log` line"),
        );
    }
}
