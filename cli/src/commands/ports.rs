//! Ports of this host that an app wants and others have. Knows where configurations name them.

use std::net::{SocketAddr, TcpListener};

use ctos::{
    config::{App, TimeMode},
    diagnostic::{Finding, Findings, Severity},
};

/// Handlers that serve a page at `args.listen`, and where they do without it.
const PAGES: [(&str, SocketAddr); 2] = [
    (cli_display::HANDLER, cli_display::DEFAULT_LISTEN),
    (cli_scott::panel::HANDLER, cli_scott::panel::DEFAULT_LISTEN),
];

/// Who of an app listens, where, and the path of the key that says so.
type Wanted = (String, SocketAddr, String);

/// Finds the ports that are not to be had now, where nothing else is wrong: the app itself may be running.
#[must_use]
pub fn warnings(app: &App) -> Findings {
    let mut findings = Findings::new();
    for mut finding in busy(app).map(|(_, finding)| finding) {
        finding.severity = Severity::Warning;
        findings.push(finding.help(
            "if this app is running, it has the port itself, and all is well; else free it, choose another `listen`, or leave it out for a free one",
        ));
    }
    findings
}

/// Finds the ports without which an app cannot start. The two are what `--display` and `--foxglove` gave.
#[must_use]
pub fn taken(app: &App, display: Option<SocketAddr>, foxglove: Option<SocketAddr>) -> Findings {
    let options = [("display", display), ("viewers", foxglove)];
    let mut findings = Findings::new();
    for ((_, address, path), finding) in busy(app) {
        let typed = options.iter().find(|(task, given)| {
            *given == Some(address) && path == format!("task.\"{task}\".args.listen")
        });
        findings.push(match typed {
            Some(("display", _)) => of_option(&finding, "--display", "page", address),
            Some(_) => of_option(&finding, "--foxglove", "viewer", address),
            None => finding
                .help("free the port, choose another `listen`, or leave it out for a free one"),
        });
    }
    findings
}

fn of_option(finding: &Finding, option: &str, what: &str, listen: SocketAddr) -> Finding {
    let why = finding.message.rsplit(": ").next().unwrap_or_default();
    let text = format!("`{option}={listen}`: no {what} can be served there: {why}");
    let help = format!(
        "choose another port, or 0 for a free one: `{option}={}:0`",
        listen.ip()
    );
    Finding::error(finding.code, text).help(help)
}

fn links(app: &App) -> impl Iterator<Item = Wanted> {
    let chassis = app.chassis.iter().filter(|chassis| chassis.host.is_none());
    let chassis = chassis.filter_map(|chassis| {
        let path = format!("chassis.\"{}\".listen", chassis.name);
        Some((format!("chassis `{}`", chassis.name), chassis.listen?, path))
    });
    let tables = [
        ("the boot", app.listen, "app.listen"),
        ("[control]", app.control, "control.listen"),
        ("[metrics]", app.metrics, "metrics.listen"),
    ];
    let tables = tables.into_iter();
    chassis.chain(tables.filter_map(|(who, at, path)| Some((who.to_owned(), at?, path.to_owned()))))
}

fn pages(app: &App) -> impl Iterator<Item = Wanted> {
    let here = |name: &str| app.host_of(name).is_none();
    let tasks = app.tasks.iter().filter(move |task| here(&task.chassis));
    tasks.filter_map(|task| {
        let page = PAGES.iter().find(|(handler, _)| *handler == task.handler);
        let listen = match task.args.get("listen") {
            Some(listen) if page.is_some() || task.handler == scene_viewers::HANDLER => {
                listen.as_str()?.parse().ok()?
            }
            _ => page?.1,
        };
        let path = format!("task.\"{}\".args.listen", task.name);
        let what = page.map_or("task", |_| "the page of task");
        Some((format!("{what} `{}`", task.name), listen, path))
    })
}

/// Who cannot listen where it shall, and why.
fn busy(app: &App) -> impl Iterator<Item = (Wanted, Finding)> {
    let real = app.time == TimeMode::Real;
    let wanted = links(app).chain(pages(app)).filter(move |_| real);
    wanted.filter_map(|wanted| {
        let (who, address, path) = &wanted;
        let error = TcpListener::bind(address).err()?;
        let text = format!("{who} cannot listen on {address} here: {error}");
        let finding = Finding::error("ctos::doctor::address", text).at(app.locate(path));
        Some((wanted, finding))
    })
}
