//! What the configuration says of a program, and the commands that it takes.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use ctos::{
    config::{App, Node, TaskConfig, TimeMode},
    diagnostic::{Finding, Findings, Place},
    message::CommandInfo,
    registry::Registry,
};
use serde::Deserialize;

use crate::{
    hello::{self, BY_HELLO},
    types::{Declared, Shown},
};

/// The name of the event handler.
pub const HANDLER: &str = "ctos.program";

/// The arguments of a task.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Args {
    /// The program and its arguments. It runs in the folder of the configuration.
    pub(crate) command: Vec<String>,
    /// The file that declares its commands, or `hello`: its hello does. Without it, the file beside the program:
    /// `detector.toml` beside `detector.py`.
    pub(crate) declares: Option<String>,
    /// Event handlers whose commands it takes, with their types.
    #[serde(default)]
    pub(crate) stands_in_for: Vec<String>,
    /// The tasks that it may ask.
    #[serde(default)]
    pub(crate) asks: Vec<String>,
    /// What it is told at its start.
    #[serde(default)]
    pub(crate) args: serde_json::Value,
    /// Variables of its environment, besides those of the chassis.
    #[serde(default)]
    pub(crate) environment: BTreeMap<String, String>,
    /// How long it may take to say hello, s.
    #[serde(default = "ten")]
    pub(crate) start_s: f64,
    /// How long it may take to answer, s; without it as long as it likes.
    pub(crate) answer_s: Option<f64>,
    /// How long it may take to end, s; then it is killed.
    #[serde(default = "two")]
    pub(crate) grace_s: f64,
    /// The longest line that it may write, MiB.
    #[serde(default = "sixteen")]
    pub(crate) line_mib: u32,
}

fn ten() -> f64 {
    10.0
}

fn two() -> f64 {
    2.0
}

fn sixteen() -> u32 {
    16
}

/// The file beside the program.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Declarations {
    /// Whether it does the same again from the same lines.
    deterministic: Option<bool>,
    /// By their names, in this order.
    #[serde(default)]
    command: BTreeMap<String, CommandTable>,
}

/// A command in that file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CommandTable {
    /// One line of help.
    #[serde(default)]
    help: String,
    /// Its code; without it 1 for the first command of the file, 2 for the next.
    code: Option<u16>,
    /// The type of a request.
    #[serde(default = "Declared::empty")]
    request: Declared,
    /// The type of a reply.
    #[serde(default = "Declared::empty")]
    reply: Declared,
}

/// What the file of a task says.
#[derive(Default)]
struct Read {
    deterministic: Option<bool>,
    commands: Vec<CommandInfo>,
}

/// The file that declares what the program of a task takes, if there is one.
fn file_of(args: &Args, app: &App) -> Option<String> {
    if let Some(file) = &args.declares {
        return Some(file.clone());
    }
    let mut beside = args.command.iter().filter_map(|word| {
        let own = app.file_at(word).is_file();
        let file = Path::new(word).with_extension("toml");
        let there = own && file.extension().is_some() && app.file_at(&file).is_file();
        there.then(|| file.to_string_lossy().into_owned())
    });
    beside.next_back()
}

/// A command as it is known everywhere.
fn known(code: u16, name: &str, help: &str, request: &Declared, reply: &Declared) -> CommandInfo {
    let (request, reply) = (request.0.clone(), reply.0.clone());
    let types = format!("({} -> {})", Shown(&request), Shown(&reply));
    let help = format!("{help} {types}");
    CommandInfo::declared(code, name, help.trim_start(), request, reply)
}

/// What the program says of itself, if that can be heard here.
fn by_hello(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) -> Read {
    let heard = match is_here(task, app) {
        true => hello::heard(args, task, app),
        false => Err("it is on another host".to_owned()),
    };
    let hello = match heard {
        Ok(hello) => hello,
        Err(why) => {
            let text = format!(
                "the program of task `{}` does not tell what it takes: {why}",
                task.name
            );
            let finding =
                Finding::error("ctos::program::hello", text).at(place(task, app, "declares"));
            findings.push(finding.help(
                "declare its commands in a TOML file: `python3 PROGRAM.py --declare` writes one",
            ));
            return Read::default();
        }
    };
    let mut next = 1;
    let commands = hello.commands.iter().map(|offered| {
        let code = offered.code.unwrap_or(next);
        next = code.saturating_add(1);
        let type_of =
            |declared: &Option<Declared>| declared.clone().unwrap_or_else(Declared::empty);
        let (request, reply) = (type_of(&offered.request), type_of(&offered.reply));
        known(code, &offered.name, &offered.help, &request, &reply)
    });
    Read {
        commands: commands.collect(),
        deterministic: Some(hello.deterministic),
    }
}

/// Whether the task's program is one of this host. What another host has is not seen from here.
fn is_here(task: &TaskConfig, app: &App) -> bool {
    let mut chassis = app.chassis.iter();
    let home = chassis.find(|one| one.name == task.chassis);
    home.is_none_or(|chassis| chassis.host.is_none())
}

fn read(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) -> Read {
    if args.declares.as_deref() == Some(BY_HELLO) {
        return by_hello(args, task, app, findings);
    }
    let Some(file) = file_of(args, app) else {
        return Read::default();
    };
    let Some(source) = findings.keep(app.read(&file)) else {
        return Read::default();
    };
    let node = Node::from_toml(&source, findings);
    let Some(all) = node.parse_all::<Declarations>(findings) else {
        return Read::default();
    };
    let order = node.get("command").map_or(&[][..], Node::entries);
    let mut next = 1;
    let commands = order.iter().filter_map(|entry| {
        let table = all.command.get(&entry.key)?;
        let code = table.code.unwrap_or(next);
        next = code.saturating_add(1);
        let (request, reply) = (&table.request, &table.reply);
        Some(known(code, &entry.key, &table.help, request, reply))
    });
    Read {
        commands: commands.collect(),
        deterministic: all.deterministic,
    }
}

/// The commands that the program of a task takes.
pub(crate) fn declared(task: &TaskConfig, app: &App, registry: &Registry) -> Vec<CommandInfo> {
    let Ok(args) = task.args.parse::<Args>() else {
        return Vec::new();
    };
    let others = args.stands_in_for.iter();
    let others = others.filter_map(|other| registry.kind(other));
    let mut all: Vec<CommandInfo> = others.flat_map(|kind| kind.commands().to_vec()).collect();
    all.extend(read(&args, task, app, &mut Findings::new()).commands);
    all
}

/// What is wrong with the arguments of a task, as far as the rest of its app need not be known.
pub(crate) fn check(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let name = &task.name;
    let at = |key: &str| place(task, app, key);
    let mut push = |finding: Finding, key: &str| findings.push(finding.at(at(key)));
    let is_here = is_here(task, app);
    let program = args.command.first();
    let program = program.map(|program| match is_here {
        true => located(program, app),
        false => Ok(()),
    });
    let starts = matches!(program, Some(Ok(())));
    match program {
        None => {
            let finding = Finding::error(
                "ctos::program::no_command",
                format!("task `{name}` names no program"),
            );
            push(
                finding.help("command = [\"python3\", \"detector.py\"]"),
                "command",
            );
        }
        Some(Err(why)) => {
            let text = format!("the program of task `{name}` cannot be started here: {why}");
            let finding = Finding::error("ctos::program::not_there", text);
            push(
                finding.help("a name is looked for in PATH; a path starts from the folder of the configuration"),
                "command",
            );
        }
        Some(Ok(())) => {}
    }
    for (key, value) in [
        ("start_s", Some(args.start_s)),
        ("grace_s", Some(args.grace_s)),
        ("answer_s", args.answer_s),
    ] {
        if value.is_some_and(|value| !(value > 0.0 && value <= 86_400.0)) {
            let text = format!("`{key}` of task `{name}` is no time between 0 and a day");
            push(Finding::error("ctos::program::time", text), key);
        }
    }
    if !(1..=1024).contains(&args.line_mib) {
        let text = format!("`line_mib` of task `{name}` is not between 1 and 1024");
        push(Finding::error("ctos::program::line", text), "line_mib");
    }
    // One that cannot be started says nothing.
    let read = match starts || args.declares.as_deref() != Some(BY_HELLO) {
        true => read(args, task, app, findings),
        false => Read::default(),
    };
    if app.time == TimeMode::Virtual && read.deterministic == Some(false) {
        let text = format!(
            "the program of task `{name}` says that it is not deterministic, so no run in virtual time could be repeated"
        );
        let finding = Finding::error("ctos::program::not_deterministic", text);
        let help =
            "run it in real time, or have it draw from the seed of its hello and read no clock";
        findings.push(finding.help(help).at(at("command")));
    }
}

/// What is wrong between its tasks.
pub(crate) fn check_app(app: &App, registry: &Registry, findings: &mut Findings) {
    for task in app.tasks.iter().filter(|task| task.handler == HANDLER) {
        let Ok(args) = task.args.parse::<Args>() else {
            continue;
        };
        for asked in args.asks.iter().filter(|asked| app.task(asked).is_none()) {
            let text = format!(
                "task `{}` may ask `{asked}`, and there is no such task",
                task.name
            );
            let finding = Finding::error("ctos::config::unknown_task", text);
            let known = app.tasks.iter().map(|task| task.name.as_str());
            findings.push(finding.suggest(asked, known).at(place(task, app, "asks")));
        }
        let strange = |other: &&String| registry.kind(other).is_none();
        for other in args.stands_in_for.iter().filter(strange) {
            let text = format!(
                "task `{}` stands in for the event handler `{other}`, which nobody registered",
                task.name
            );
            let finding = Finding::error("ctos::config::unknown_handler", text);
            let known = registry.kinds().map(ctos::registry::HandlerKind::name);
            findings.push(
                finding
                    .suggest(other, known)
                    .at(place(task, app, "stands_in_for")),
            );
        }
    }
}

fn place(task: &TaskConfig, app: &App, key: &str) -> Place {
    let place = app.locate(&format!("task.{}.args.{key}", task.name));
    place.unwrap_or_else(|| task.place.clone())
}

/// Whether the program can be started on this host.
fn located(word: &str, app: &App) -> Result<(), String> {
    if word.contains('/') {
        return executable(&app.folder.join(word));
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut folders = std::env::split_paths(&path);
    match folders.any(|folder| executable(&folder.join(word)).is_ok()) {
        true => Ok(()),
        false => Err(format!("no folder of PATH has a program `{word}`")),
    }
}

fn executable(path: &Path) -> Result<(), String> {
    let shown = path.display();
    match path.metadata() {
        Err(error) => Err(format!("`{shown}`: {error}")),
        Ok(about) if !about.is_file() => Err(format!("`{shown}` is no file")),
        Ok(_) => rustix::fs::access(path, rustix::fs::Access::EXEC_OK)
            .map_err(|_| format!("`{shown}` is not executable: chmod +x {shown}")),
    }
}

/// The commands of the task `cx` is of, by their codes.
pub(crate) fn commands(cx: &ctos::task::Context) -> Arc<[CommandInfo]> {
    let registry = cx.registry();
    let config = cx.config();
    config.map_or_else(Arc::default, |config| {
        registry.commands_of(config, cx.app())
    })
}
