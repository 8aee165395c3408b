//! The arguments of a display and what can be wrong with them.

use std::{collections::BTreeMap, net::SocketAddr};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings, Source},
    registry::Registry,
};
use pnt::{
    layout::{Detail, Drawing},
    stream::NetView,
};
use serde::Deserialize;

use super::overview::{Overviews, usual_file};
use cli_common::page;

/// The handler's name.
pub const HANDLER: &str = "pnt.display";

/// Where a page is served unless the configuration says otherwise.
pub const DEFAULT_LISTEN: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 8108);

/// How slow and how fast virtual time may go for a page.
const SLOWEST: f64 = 0.01;
const FASTEST: f64 = 1000.0;

/// The most viewers that can be asked for.
const MOST_VIEWERS: usize = 1000;

/// `[task.NAME.args]` of a display.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DisplayArgs {
    /// Where the page is served; port 0 takes any that is free.
    #[serde(default = "listen")]
    pub(super) listen: SocketAddr,
    /// Whether the page may intervene: fire, put and take tokens, pause, set breakpoints.
    #[serde(default)]
    pub(super) allow_control: bool,
    /// What a page must show to intervene; drawn at random when it is left out.
    pub(super) token: Option<String>,
    /// What else than its own name and its addresses browsers may call this host.
    #[serde(default)]
    pub(super) names: Vec<String>,
    /// How many browsers may look on at a time.
    #[serde(default = "viewers")]
    pub(super) viewers: usize,
    /// The nets that are shown; all of the app when it is left out.
    pub(super) nets: Option<Vec<String>>,
    /// In virtual time: so many seconds of the app go by in one of the host, at most. Without it no page is served then.
    pub(super) pace: Option<f64>,
    /// A file of overview displays and layouts, relative to the configuration's folder; `displays/APP.toml` when it is left
    /// out.
    displays: Option<String>,
}

impl DisplayArgs {
    /// The file of displays, whether it is there or not.
    pub(super) fn displays(&self, app: &App) -> String {
        let file = self.displays.clone();
        file.unwrap_or_else(|| usual_file(&app.name))
    }

    /// The file of displays, if one is named or the usual one is there.
    pub(super) fn read_displays(&self, app: &App) -> Option<Result<Source, Finding>> {
        let file = self.displays(app);
        let read = self.displays.is_some() || app.file_at(&file).is_file();
        read.then(|| app.read(&file))
    }
}

/// The file of displays of an app, relative to its configuration's folder: that of its display, or the usual one if it is there.
#[must_use]
pub fn displays_of(app: &App) -> Option<String> {
    let mut tasks = app.tasks.iter();
    let own = tasks.find(|task| task.handler == HANDLER);
    let named = own.and_then(|task| task.args.get("displays")?.as_str().map(str::to_owned));
    let file = named.unwrap_or_else(|| usual_file(&app.name));
    app.file_at(&file).is_file().then_some(file)
}

fn listen() -> SocketAddr {
    DEFAULT_LISTEN
}

fn viewers() -> usize {
    32
}

/// Checks a display's arguments against the app.
pub(super) fn check(args: &DisplayArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let at = |finding: Finding, key: &str| page::at(task, key, finding);
    if args.viewers == 0 || args.viewers > MOST_VIEWERS {
        let text = format!("a display for {} viewers", args.viewers);
        let finding = Finding::error("pnt::display::viewers", text);
        findings.push(at(finding, "viewers").help(format!("write 1 to {MOST_VIEWERS}")));
    }
    page::check(task, args.listen, app, "pnt::display::open", findings);
    if let Some(pace) = args.pace.filter(|pace| !(SLOWEST..=FASTEST).contains(pace)) {
        let text = format!("a display at a pace of {pace}");
        let help = format!("write {SLOWEST} to {FASTEST}, seconds of the app in one of the host");
        let finding = Finding::error("pnt::display::pace", text);
        findings.push(at(finding, "pace").help(help));
    }
    for net in args.nets.iter().flatten() {
        if app.task(net).is_none() {
            let names = app.tasks.iter().map(|task| task.name.as_str());
            let text = format!(
                "display `{}` shows a net `{net}`, which is no task",
                task.name
            );
            let finding = Finding::error("pnt::display::unknown_net", text);
            findings.push(at(finding, "nets").suggest(net, names));
        }
    }
    match args.read_displays(app) {
        Some(Ok(source)) => {
            let mut overviews = Overviews::read(&source, findings);
            overviews.arrange_from(&app.file_at(args.displays(app)), findings);
        }
        Some(Err(finding)) => findings.push(at(finding, "displays")),
        None => {}
    }
}

/// Overview displays must name nodes that there are. Nothing is said when a net is wrong by itself.
pub(super) fn check_overviews(app: &App, registry: &Registry, findings: &mut Findings) {
    let displays = app.tasks.iter().filter(|task| task.handler == HANDLER);
    for task in displays {
        let Ok(args) = task.args.parse::<DisplayArgs>() else {
            continue;
        };
        let source = args.read_displays(app);
        let (Some(Ok(source)), Ok(nets)) = (source, pnt::task::nets(app, registry)) else {
            continue;
        };
        // What is wrong with the file itself has been said.
        let overviews = Overviews::read(&source, &mut Findings::new());
        let drawings: BTreeMap<&str, Drawing> = nets
            .iter()
            .map(|net| {
                (
                    net.name(),
                    Drawing::new(&NetView::new(net), Detail::Written),
                )
            })
            .collect();
        let known = |net: &str| nets.iter().any(|one| one.name() == net);
        for unknown in overviews.unknown_nets(known) {
            let text = format!(
                "{}: no net or display has the name of {unknown}",
                source.name()
            );
            let finding = Finding::warning("pnt::display::unknown_layout_net", text)
                .help("write a net of the app, or a display of this file");
            findings.push(page::at(task, "displays", finding));
        }
        let takes = |name: &str, command: &str| {
            let net = nets.iter().find(|net| net.name() == name);
            net.is_some_and(|net| {
                let commands = NetView::new(net).commands;
                commands.iter().any(|one| one.symbol == command)
            })
        };
        for unknown in overviews.unknown_commands(takes) {
            let text = format!("{}: no net takes the command of {unknown}", source.name());
            let finding = Finding::warning("pnt::display::unknown_command", text)
                .help("write `NET/COMMAND`, a net of the app and a command of its tape");
            findings.push(page::at(task, "displays", finding));
        }
        for unknown in overviews.unknown_tasks(|name| app.task(name).is_some()) {
            let text = format!("{}: no task has the name of {unknown}", source.name());
            let finding = Finding::warning("pnt::display::unknown_task", text)
                .help("write a task of the app that shows something of the scene");
            findings.push(page::at(task, "displays", finding));
        }
        for unknown in overviews.unknown(|net| drawings.get(net)) {
            let text = format!("{}: no net has the node of {unknown}", source.name());
            let finding = Finding::warning("pnt::display::unknown_node", text)
                .help("write `NET/NODE`, in which `*` stands for any letters");
            findings.push(page::at(task, "displays", finding));
        }
    }
}
