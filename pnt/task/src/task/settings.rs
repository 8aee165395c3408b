//! What a net task reads from its arguments.

use std::{collections::BTreeMap, sync::Arc};

use ctos::{
    config::{App, Node, TaskConfig},
    diagnostic::{Finding, Findings},
    task::{Context, HandlerError},
};
use serde::de::DeserializeOwned;

use super::manual::check_breakpoint;
use pnt_language::net::Net;

/// The keys of [`Settings`] in a task's arguments.
pub const KEYS: [&str; 10] = [
    "net",
    "conflicts",
    "durable",
    "store",
    "allow_control",
    "breakpoints",
    "break_ends",
    "tape",
    "forward",
    "stand_in",
];

/// How the actions of a net are stood in for: each takes its stated time, and succeeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandIn {
    /// The chance that an action fails instead, from 0 to 1.
    pub fail: f64,
}

impl Eq for StandIn {}

/// Commands that wait on an input tape, and answers on an output tape, unless `tape` says otherwise.
const TAPE: usize = 1024;

/// What every net task reads from its arguments; a library may want more keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// `net`: the net's file, relative to the configuration's folder.
    pub net: String,
    /// `conflicts = "random"`: whether conflicts of equal priority are decided by chance.
    pub random: bool,
    /// `durable`: whether marking, tapes and running actions survive the process.
    pub durable: bool,
    /// `store`: the folder in which a durable net keeps them, relative to the configuration's folder.
    pub store: String,
    /// `allow_control`: whether people may intervene by hand.
    pub allow_control: bool,
    /// `breakpoints`: where the net pauses, armed before the first firing.
    pub breakpoints: Vec<String>,
    /// `break_ends`: whether the app ends at a breakpoint, instead of pausing there.
    pub break_ends: bool,
    /// `tape`: how many commands the input tape holds, and how many answers the output tape.
    pub tape: usize,
    /// `forward`: output symbols that go on to the input tapes of other nets, by symbol.
    pub forward: BTreeMap<String, String>,
    /// `stand_in`: whether nothing is asked of anybody, and every action is stood in for.
    pub stand_in: Option<StandIn>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            net: String::new(),
            random: false,
            durable: false,
            store: "state".to_owned(),
            allow_control: false,
            breakpoints: Vec::new(),
            break_ends: false,
            tape: TAPE,
            forward: BTreeMap::new(),
            stand_in: None,
        }
    }
}

/// The arguments of a task without those that every net task has, for a library that wants more.
///
/// # Errors
/// A finding at the key that is wrong or unknown.
pub fn args<T: DeserializeOwned>(task: &TaskConfig) -> Result<T, Finding> {
    task.args.without(&KEYS).parse()
}

/// [`args`] of the task that is being built.
///
/// # Errors
/// As [`args`].
pub fn args_of<T: DeserializeOwned>(cx: &Context) -> Result<T, HandlerError> {
    let config = cx.config();
    let config = config.ok_or_else(|| HandlerError::new("a net task needs arguments"))?;
    Ok(args(config)?)
}

/// Reads the keys of a task's arguments that every net task has ([`KEYS`]).
///
/// # Errors
/// A finding at the key that is missing or wrong.
pub fn settings(task: &TaskConfig) -> Result<Settings, Finding> {
    let reader = Reader { task };
    let net = task.args.get("net").and_then(Node::as_str);
    let net = net.ok_or_else(|| {
        let text = format!("task `{}` runs a net and does not say which", task.name);
        reader
            .at(Finding::error("pnt::task::no_net", text), "net")
            .help("add `net = \"FILE.net\"` to its arguments")
    })?;
    let random = match task.args.get("conflicts").map(Node::as_str) {
        None | Some(Some("declared")) => false,
        Some(Some("random")) => true,
        Some(_) => {
            let text = format!("task `{}` has an unknown rule for conflicts", task.name);
            let finding = Finding::error("pnt::task::conflicts", text);
            return Err(reader
                .at(finding, "conflicts")
                .help("write \"declared\" or \"random\""));
        }
    };
    let usual = Settings::default();
    Ok(Settings {
        net: net.to_owned(),
        random,
        durable: reader
            .word("durable", "true or false", Node::as_bool)?
            .unwrap_or(false),
        store: reader
            .word("store", "a folder", |node| node.as_str().map(str::to_owned))?
            .unwrap_or(usual.store),
        allow_control: reader
            .word("allow_control", "true or false", Node::as_bool)?
            .unwrap_or(false),
        breakpoints: reader
            .word(
                "breakpoints",
                "a list of transitions and conditions on places",
                texts,
            )?
            .unwrap_or_default(),
        break_ends: reader
            .word("break_ends", "true or false", Node::as_bool)?
            .unwrap_or(false),
        tape: reader
            .word("tape", "a number from 1 to 1000000", |node| {
                let number = usize::try_from(node.as_integer()?).ok()?;
                (1..=1_000_000).contains(&number).then_some(number)
            })?
            .unwrap_or(usual.tape),
        forward: reader
            .word("forward", "a table: output symbol = \"net\"", table)?
            .unwrap_or_default(),
        stand_in: reader
            .word(
                "stand_in",
                "true, false or { fail = CHANCE } with a chance from 0 to 1",
                stood_in,
            )?
            .flatten(),
    })
}

struct Reader<'t> {
    task: &'t TaskConfig,
}

impl Reader<'_> {
    fn at(&self, finding: Finding, key: &str) -> Finding {
        let node = self.task.args.get(key);
        let place = node.and_then(|node| node.place().cloned());
        finding.at(place.unwrap_or_else(|| self.task.place.clone()))
    }

    /// The value of a key, if it is there.
    fn word<T>(
        &self,
        key: &str,
        wanted: &str,
        read: impl Fn(&Node) -> Option<T>,
    ) -> Result<Option<T>, Finding> {
        let Some(node) = self.task.args.get(key) else {
            return Ok(None);
        };
        let wrong = || {
            let text = format!(
                "`{key}` of net task `{}` is {}",
                self.task.name,
                node.kind()
            );
            let finding = Finding::error("pnt::task::setting", text);
            self.at(finding, key).help(format!("give {wanted}"))
        };
        read(node).map(Some).ok_or_else(wrong)
    }
}

fn stood_in(node: &Node) -> Option<Option<StandIn>> {
    if let Some(whether) = node.as_bool() {
        return Some(whether.then_some(StandIn { fail: 0.0 }));
    }
    let fail = node.get("fail")?.as_f64()?;
    let only = node.entries().len() == 1 && (0.0..=1.0).contains(&fail);
    only.then_some(Some(StandIn { fail }))
}

fn texts(node: &Node) -> Option<Vec<String>> {
    let elements = node.elements();
    if elements.is_empty() && node.kind() != "an array" {
        return None;
    }
    let texts = elements.iter().map(|one| one.as_str().map(str::to_owned));
    texts.collect()
}

fn table(node: &Node) -> Option<BTreeMap<String, String>> {
    if node.kind() != "a table" {
        return None;
    }
    let entries = node.entries().iter();
    entries
        .map(|entry| Some((entry.key.clone(), entry.value.as_str()?.to_owned())))
        .collect()
}

/// Checks what the settings of a task name in its net and in the nets that it forwards to.
pub(super) fn check(
    task: &TaskConfig,
    (net, settings): (&Net, &Settings),
    net_of: impl Fn(&str) -> Option<Arc<Net>>,
    app: &App,
    findings: &mut Findings,
) {
    let reader = Reader { task };
    for text in &settings.breakpoints {
        if let Err(finding) = check_breakpoint(text, net) {
            findings.push(reader.at(finding, "breakpoints"));
        }
    }
    for (symbol, to) in &settings.forward {
        let at = |finding| reader.at(finding, "forward");
        let answers = || net.commands().iter().flat_map(|command| &command.answers);
        if !answers().any(|answer| answer == symbol) {
            let text = format!("net `{}` never writes `{symbol}`", net.name());
            let finding = Finding::error("pnt::task::forward", text);
            let known = answers().map(String::as_str);
            findings.push(at(finding.suggest(symbol, known)));
        }
        if app.task(to).is_none() {
            let text = format!("`{symbol}` shall go to net `{to}`, and no task is called so");
            let finding = Finding::error("pnt::task::forward", text);
            let known = app.tasks.iter().map(|task| task.name.as_str());
            findings.push(at(finding.suggest(to, known)));
        } else if let Some(other) = net_of(to)
            && other.command(symbol).is_none()
        {
            let text = format!(
                "net `{to}` takes no command `{symbol}`, which net `{}` forwards to it",
                net.name()
            );
            let finding = Finding::error("pnt::task::forward", text);
            let known = other
                .commands()
                .iter()
                .map(|command| command.symbol.as_str());
            findings.push(at(finding.suggest(symbol, known)));
        }
    }
}
