//! Whether the functions that a net names are in its library, with fitting data objects.

use std::collections::{BTreeMap, BTreeSet};

use ctos::{
    diagnostic::{Finding, Findings, Place as At},
    message::DataType,
    registry::Vocabulary,
};
use pnt_language::net::{Action, Does, Net};

use super::objects;

/// The functions that a library offers to a net.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FunctionNames {
    /// Local functions, for `do` lines.
    pub actions: BTreeSet<String>,
    /// Enabling functions, for `when` lines.
    pub enabling: BTreeSet<String>,
    /// The local functions that take and give data objects, each with its argument and its result.
    pub typed: BTreeMap<String, (DataType, DataType)>,
    /// Whether it makes requests of service objects, for `request` lines.
    pub requests: bool,
}

impl FunctionNames {
    /// What local functions are called in a [`Vocabulary`].
    pub const LOCAL: &'static str = "local function";
    /// What enabling functions are called in a [`Vocabulary`].
    pub const ENABLING: &'static str = "enabling function";

    /// The names for editors.
    #[must_use]
    pub fn vocabulary(self) -> Vocabulary {
        Vocabulary::from([(Self::LOCAL, self.actions), (Self::ENABLING, self.enabling)])
    }
}

/// Reports functions that a net names and a library does not offer.
pub fn functions(net: &Net, names: &FunctionNames, findings: &mut Findings) {
    let requests = net
        .transitions()
        .iter()
        .filter_map(|one| match &one.action {
            Some(Action::Written {
                does: Some(Does::Request(line)),
                ..
            }) => Some(line),
            _ => None,
        });
    for line in requests.filter(|_| !names.requests) {
        let text = format!("the handler of net `{}` makes no requests", net.name());
        findings.push(
            Finding::error("pnt::net::unknown_function", text)
                .at(line.at.clone())
                .help("run the net with the handler `pnt.net`"),
        );
    }
    for data in &net.declared().data {
        if names.enabling.contains(&data.name) {
            let text = format!(
                "data `{0}` hides the enabling function `{0}` of the library of net `{1}`",
                data.name,
                net.name()
            );
            findings.push(
                Finding::error("pnt::net::data", text)
                    .at(data.at.clone())
                    .help("rename the data: in a `when` line, a name means one thing"),
            );
        }
    }
    let mut unknown = |what: &str, name: &str, at: &At, known: &BTreeSet<String>| {
        if !known.contains(name) {
            let finding = Finding::error(
                "pnt::net::unknown_function",
                format!("the library of net `{}` has no {what} `{name}`", net.name()),
            );
            findings.push(
                finding
                    .at(at.clone())
                    .help("this library offers no such functions at all")
                    .suggest(name, known.iter().map(String::as_str)),
            );
        }
    };
    for transition in net.transitions() {
        let named = transition.when.as_ref();
        if let Some(when) = named.filter(|when| when.expression.is_none()) {
            unknown(
                FunctionNames::ENABLING,
                &when.function,
                &when.at,
                &names.enabling,
            );
        }
        if let Some(Action::Local { function, at, .. }) = &transition.action {
            unknown(FunctionNames::LOCAL, function, at, &names.actions);
        }
    }
    for transition in net.transitions() {
        if let Some(Action::Local {
            function,
            inputs,
            outputs,
            at,
            ..
        }) = &transition.action
        {
            let objects = (inputs.as_slice(), outputs.as_slice());
            let found = match names.typed.get(function) {
                Some(types) => {
                    objects::check(&format!("local function `{function}`"), objects, *types)
                }
                None if names.actions.contains(function) => objects::none(
                    &format!("local function `{function}`"),
                    "it reads and stores data objects itself",
                    objects,
                ),
                None => Vec::new(),
            };
            for finding in found {
                findings.push(finding.at(at.clone()));
            }
        }
    }
}
