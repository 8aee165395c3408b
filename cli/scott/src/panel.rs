//! Panels (the report's `scottwish`): buttons, sliders, plots and joysticks for service objects, as a web page. A panel is
//! a short file, or made of the option table of a class; every control is one line of text to an object.
//!
//! `script` reads what stands on a panel, `logic` what follows from its values. `service` knows what a page may ask and what
//! it is told; `server` serves it. Two offer them: `task` is an event handler that anyone can put into an app,
//! `sorma.panel`; `pool` asks for `scott --panel`. Knows objects by their names only.

mod args;
mod logic;
mod pool;
pub mod script;
mod server;
mod service;
mod task;

pub use args::{DEFAULT_LISTEN, HANDLER};

use std::{io, net::SocketAddr, path::Path};

use ctos::{
    diagnostic::{Findings, Source},
    doors::Pages,
    registry::Registry,
};

use cli_common::{
    exit,
    page::{Door, drawn_token, loopback_pages},
    show,
};

use crate::backend::Backend;
use pool::Pool;
use script::{Panel, SOME_ARM, SOME_JOINTS, for_arms};
use service::Service;

/// Registers the handler.
pub fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &[], task::ObjectPanel::new)
        .checked_args(args::check);
}

/// Serves a panel until Ctrl-C; the exit code. `what` is a file, or the name of an object whose options are shown.
#[must_use]
pub fn run(backend: Backend, what: &str, listen: SocketAddr) -> u8 {
    let panel = match asked_for(what) {
        Ok(panel) => panel,
        Err(findings) => {
            show::findings(findings);
            return exit::CONFIG;
        }
    };
    let pages = match loopback_pages(listen) {
        Ok(pages) => pages,
        Err(error) => {
            show::say(&format!("error: cannot listen at {listen}: {error}"));
            return exit::UNREACHABLE;
        }
    };
    match serve(pages, Pool::new(backend), panel) {
        Ok(()) => exit::INTERRUPTED,
        Err(error) => {
            show::say(&format!("error: the panel cannot be served: {error}"));
            exit::FAILED
        }
    }
}

fn asked_for(what: &str) -> Result<Panel, Findings> {
    let path = Path::new(what);
    if !path.is_file() && !what.ends_with(".toml") {
        return Ok(Panel::of_object(what));
    }
    let mut findings = Findings::new();
    let source = findings.keep(Source::read(path));
    let (arms, joints) = ([SOME_ARM.to_owned()], SOME_JOINTS.map(str::to_owned));
    let source = source.and_then(|source| for_arms(&source, &arms, &joints).pop());
    let panel = source.and_then(|source| Panel::read(&source, &mut findings));
    match panel {
        Some(panel) if !findings.has_errors() => Ok(panel),
        _ => Err(findings),
    }
}

fn serve(pages: Pages, pool: Pool, panel: Panel) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let token = drawn_token()?;
    let url = pages.url();
    show::say(&format!("the panel is at {url}#{token}   (Ctrl-C ends it)"));
    let door = Door {
        token: Some(token),
        anybody_looks: false,
        allow_control: true,
        ..Door::default()
    };
    let service = Service::new("scott", vec![panel], door, pool);
    runtime.block_on(server::serve(pages, service, async {
        // Where the program cannot wait for Ctrl-C, Ctrl-C ends the process by itself.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }))
}
