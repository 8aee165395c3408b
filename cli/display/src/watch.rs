//! `ctos display`.

mod hops;
mod live;
mod screen;

use std::{
    collections::BTreeMap,
    io::{self, IsTerminal},
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
};

use clap::Args;
use ctos::{
    diagnostic::{Findings, Source},
    registry::Registry,
};
use pnt::layout::Drawing;
use tokio::sync::{mpsc, oneshot};

use cli_common::{
    exit,
    page::{Door, loopback_pages},
    remote::{self, RemoteArgs},
    show,
};

use crate::{
    assets,
    draw::moment,
    hub::Hub,
    overview::Overviews,
    record::Recorded,
    server::{self, Service},
    text,
};
use live::Nets;

/// Pictures of a page that is written as one file take so many bytes at most.
const MOST_PICTURES: usize = 8_000_000;

/// Watch the nets of a running app in the terminal, or those of a recorded run in a browser
///
/// Without a record: the nets of a running app, one at a time, with what runs, what is enabled, the last events, and the
/// neighbourhood of a transition. With records (MCAP): serves the page that `ctos boot --display` serves for a running
/// app, on the loopback, until Ctrl-C; the run can be played, stepped and scrubbed. Several files of one run, one of each
/// process, are shown together.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos display
  ctos display --app calibrate --once
  ctos display run.mcap
  ctos display run.ws1.mcap --export run.html
  ctos display run.ws1.mcap --once --moment 12.5")]
pub struct DisplayArgs {
    /// Which app, where no record is given
    #[command(flatten)]
    pub remote: RemoteArgs,
    /// Records (MCAP) of an app that ran nets
    #[arg(value_name = "RECORD")]
    pub records: Vec<PathBuf>,
    /// Write one page that needs no server, with the run in it, and leave
    #[arg(long, value_name = "FILE", requires = "records")]
    pub export: Option<PathBuf>,
    /// Print the nets as text and leave
    #[arg(long, conflicts_with = "export")]
    pub once: bool,
    /// Print one JSON object for each net and leave
    #[arg(long, conflicts_with_all = ["export", "once"])]
    pub json: bool,
    /// The moment that `--once` and `--json` show, s since the start of the app; the end when left out
    #[arg(long, value_name = "SECONDS", value_parser = moment, requires = "records")]
    pub moment: Option<u64>,
    /// This net only
    #[arg(long, value_name = "NET")]
    pub net: Option<String>,
    /// A file of overview displays and layouts; without it, that which the record keeps
    #[arg(long, value_name = "FILE")]
    pub displays: Option<PathBuf>,
    /// Where the page is served; port 0 takes any that is free
    #[arg(long, value_name = "ADDRESS", default_value_t = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0))]
    pub listen: SocketAddr,
}

/// Runs the command.
#[must_use]
pub fn run(args: &DisplayArgs, registry: &Registry) -> u8 {
    if args.records.is_empty() {
        return watch(args, registry);
    }
    let mut recorded = match Recorded::read(&args.records) {
        Ok(recorded) => recorded,
        Err(error) => {
            show::say(&format!("error: {error}"));
            if let [name] = args.records.as_slice()
                && name.extension().is_none()
                && !name.exists()
            {
                let name = name.display();
                show::say(&format!(
                    "to watch a running app: ctos display --app {name}"
                ));
            }
            return exit::CONFIG;
        }
    };
    for warning in &recorded.warnings {
        show::say(&format!("warning: {warning}"));
    }
    if let Some(net) = &args.net {
        if !recorded.nets.contains_key(net) {
            let known: Vec<&str> = recorded.nets.keys().map(String::as_str).collect();
            show::say(&format!(
                "error: no net `{net}` is in these records; there are: {}",
                known.join(", ")
            ));
            return exit::NO_SUCH_NAME;
        }
        recorded.nets.retain(|name, _| name == net);
    }
    let prints = args.once || args.json;
    if recorded.is_empty() || (prints && recorded.nets.is_empty()) {
        return exit::FAILED;
    }
    if prints {
        return print(args, &recorded);
    }
    let overviews = match args.displays.as_deref().map(overviews).transpose() {
        Ok(Some(named)) => named,
        Ok(None) => {
            let (kept, findings) = recorded.overviews();
            show::findings(findings);
            kept
        }
        Err(code) => return code,
    };
    if args.export.is_some() {
        let left_out = recorded.thin(MOST_PICTURES);
        if left_out > 0 {
            show::say(&format!(
                "warning: {left_out} pictures are left out, evenly: a page has {} MB of them at most",
                MOST_PICTURES / 1_000_000
            ));
        }
    }
    let displays = overviews.clone();
    let hub = recorded.hub(overviews);
    let drawings = recorded.nets.keys();
    let drawings: BTreeMap<&str, Drawing> = drawings
        .filter_map(|net| Some((net.as_str(), hub.written(net)?)))
        .collect();
    for unknown in displays.unknown(|net| drawings.get(net)) {
        show::say(&format!(
            "warning: no net of the record has the node of {unknown}"
        ));
    }
    match &args.export {
        Some(file) => export(&hub, file),
        None => serve(hub, args.listen),
    }
}

/// The nets of a running app.
fn watch(args: &DisplayArgs, registry: &Registry) -> u8 {
    let mut nets = match Nets::follow(&args.remote, args.net.as_deref(), registry) {
        Ok(nets) => nets,
        Err(error) => return remote::failed(&error),
    };
    let full = io::stdout().is_terminal() && !args.once && !args.json;
    if full {
        screen::run(&mut nets);
        return exit::OK;
    }
    nets.complete();
    if nets.nets.is_empty() {
        show::say(&format!("error: no such net runs in {}", nets.app));
        return exit::NO_SUCH_NAME;
    }
    for net in nets.nets.values() {
        let shown = if args.json {
            text::json(&net.view, net.state(), &net.events, &net.breakpoints)
        } else {
            text::plain(&net.view, net.state(), &net.events, &net.breakpoints)
        };
        // A reader that went away has what it wanted.
        if show::data(shown.trim_end()).is_err() {
            break;
        }
    }
    exit::OK
}

fn overviews(path: &Path) -> Result<Overviews, u8> {
    let mut findings = Findings::new();
    let read = findings.keep(Source::read(path));
    let overviews = read.map(|source| {
        let mut overviews = Overviews::read(&source, &mut findings);
        overviews.arrange_from(path, &mut findings);
        overviews
    });
    let wrong = findings.has_errors();
    show::findings(findings);
    overviews.filter(|_| !wrong).ok_or(exit::CONFIG)
}

fn print(args: &DisplayArgs, recorded: &Recorded) -> u8 {
    for net in recorded.nets.values() {
        let Some((state, events)) = net.at(args.moment, text::EVENTS) else {
            show::say(&format!(
                "warning: the record of net `{}` begins later",
                net.view.name
            ));
            continue;
        };
        let shown = if args.json {
            text::json(&net.view, &state, &events, &[])
        } else {
            text::plain(&net.view, &state, &events, &[])
        };
        // A reader that went away has what it wanted.
        if show::data(shown.trim_end()).is_err() {
            break;
        }
    }
    exit::OK
}

fn export(hub: &Hub, file: &Path) -> u8 {
    let (messages, _) = hub.join(false);
    let page = assets::standalone(&messages);
    match std::fs::write(file, page) {
        Ok(()) => {
            show::say(&format!("written  {}", file.display()));
            exit::OK
        }
        Err(error) => {
            show::say(&format!(
                "error: {} cannot be written: {error}",
                file.display()
            ));
            exit::FAILED
        }
    }
}

/// Serves until Ctrl-C.
fn serve(hub: Hub, listen: SocketAddr) -> u8 {
    let served = || -> io::Result<()> {
        let pages = loopback_pages(listen).map_err(io::Error::other)?;
        let url = pages.url();
        // Nobody carries out orders: there is nothing to order of a record.
        let (orders, _) = mpsc::channel(1);
        let (_stop, stopped) = oneshot::channel();
        let service = Service {
            hub: Arc::new(hub),
            door: Door {
                anybody_looks: true,
                ..Door::default()
            },
            viewers: 32,
            permits: server::permits(32),
            orders,
        };
        show::say(&format!("display  {url}  (Ctrl-C ends it)"));
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        runtime.block_on(async {
            tokio::select! {
                served = server::serve(pages, service, stopped) => served,
                interrupted = tokio::signal::ctrl_c() => interrupted,
            }
        })
    };
    match served() {
        Ok(()) => exit::INTERRUPTED,
        Err(error) => {
            show::say(&format!(
                "error: nothing can be served at {listen}: {error}"
            ));
            exit::FAILED
        }
    }
}
