//! The arguments of a panel's task and what can be wrong with them.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
};
use serde::Deserialize;
use sorma::{ObjectName, daemon};

use super::script::{Panel, SOME_ARM, SOME_JOINTS, for_arms};
use cli_common::page;

/// The handler's name.
pub const HANDLER: &str = "sorma.panel";

/// Where a page is served unless the configuration says otherwise.
pub const DEFAULT_LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8109);

/// `[task.NAME.args]` of a panel.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PanelArgs {
    /// Where the page is served; port 0 takes any that is free.
    #[serde(default = "listen")]
    pub(super) listen: SocketAddr,
    /// Whether the page may ask what changes something.
    #[serde(default)]
    pub(super) allow_control: bool,
    /// What a page must show to do so; drawn at random when it is left out.
    pub(super) token: Option<String>,
    /// What else than its own name and its addresses browsers may call this host.
    #[serde(default)]
    pub(super) names: Vec<String>,
    /// Files of panels, relative to the configuration's folder.
    #[serde(default)]
    pub(super) panels: Vec<String>,
    /// The flavors for which a panel stands that says `{arm}`, as in `pino.{arm}`; one panel for each.
    #[serde(default = "arms")]
    pub(super) arms: Vec<String>,
    /// The names of their joints: such a panel shows as many.
    #[serde(default = "joints")]
    pub(super) joints: Vec<String>,
    /// Objects whose options are shown, each on a panel of its own.
    #[serde(default)]
    pub(super) objects: Vec<String>,
    /// The daemon that is asked when a name says none; the app's first when it is left out.
    pub(super) daemon: Option<String>,
}

fn listen() -> SocketAddr {
    DEFAULT_LISTEN
}

fn arms() -> Vec<String> {
    vec![SOME_ARM.to_owned()]
}

fn joints() -> Vec<String> {
    SOME_JOINTS.map(str::to_owned).into()
}

impl PanelArgs {
    /// The panels; what is wrong in a file is left out and said.
    pub(super) fn read(&self, app: &App, findings: &mut Findings) -> Vec<Panel> {
        let files = self.panels.iter();
        let mut panels = Vec::new();
        for source in files.filter_map(|file| app.read(file).ok()) {
            let sources = for_arms(&source, &self.arms, &self.joints).into_iter();
            panels.extend(sources.filter_map(|source| Panel::read(&source, findings)));
        }
        panels.extend(self.objects.iter().map(|object| Panel::of_object(object)));
        panels
    }

    /// The daemon that is asked; `None` when the app has none.
    pub(super) fn daemon(&self, app: &App) -> Option<String> {
        self.daemon.clone().or_else(|| daemons(app).next())
    }
}

fn daemons(app: &App) -> impl Iterator<Item = String> {
    let tasks = app.tasks.iter();
    let daemons = tasks.filter(|task| task.handler == daemon::HANDLER);
    daemons.map(|task| task.name.clone())
}

/// Checks a panel's arguments against the app.
pub(super) fn check(args: &PanelArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let at = |finding: Finding, key: &str| page::at(task, key, finding);
    let name = &task.name;
    for file in &args.panels {
        match app.read(file) {
            // What is wrong for one arm is so for all.
            Ok(source) => for_arms(&source, &args.arms, &args.joints)
                .iter()
                .take(1)
                .for_each(|source| drop(Panel::read(source, findings))),
            Err(finding) => findings.push(at(finding, "panels")),
        }
    }
    for object in &args.objects {
        if let Err(error) = object.parse::<ObjectName>() {
            let text = format!("panel `{name}`: `{object}` is no name of an object: {error}");
            findings.push(at(Finding::error("sorma::panel::object", text), "objects"));
        }
    }
    if args.panels.is_empty() && args.objects.is_empty() {
        let finding = Finding::error(
            "sorma::panel::empty",
            format!("panel `{name}` shows nothing"),
        );
        findings
            .push(at(finding, "panels").help("name files in `panels`, or objects in `objects`"));
    }
    let known: Vec<String> = daemons(app).collect();
    let missing = match &args.daemon {
        Some(wanted) if !known.contains(wanted) => Some(format!(
            "panel `{name}` asks a daemon `{wanted}`, which is none of the app's"
        )),
        None if known.is_empty() => Some(format!(
            "panel `{name}` has nobody to ask: the app has no daemon"
        )),
        _ => None,
    };
    if let Some(text) = missing {
        let finding = at(Finding::error("sorma::panel::daemon", text), "daemon");
        let finding = finding.help("a daemon is a task with `handler = \"sorma.daemon\"`");
        let wanted = args.daemon.as_deref().unwrap_or_default();
        findings.push(finding.suggest(wanted, known.iter().map(String::as_str)));
    }
    page::check(task, args.listen, app, "sorma::panel::open", findings);
}
