//! Panels (the report's `scottwish`): buttons, sliders, plots and joysticks for service objects, as a web page. A panel is
//! a short file, or made of the option table of a class; every control is one line of text to an object.
//!
//! `script` reads what stands on a panel, `server` serves it. Knows objects by their names only.

pub mod script;
mod server;

use std::{
    net::{SocketAddr, TcpListener},
    path::Path,
    sync::{Mutex, PoisonError},
};

use serde_json::{Value, json};
use sorma::Reply;

use crate::{
    exit,
    scott::{backend::Backend, session},
    show,
};
use script::{Panel, Widget};

/// Those who are asked. A request that takes long keeps no other waiting: each has one for itself.
pub(crate) struct Desk {
    free: Mutex<Vec<Backend>>,
    panel: Panel,
}

impl Desk {
    /// What an object answers to a line, for a page.
    fn ask(&self, line: &str) -> Value {
        let Some(mut backend) = self.backend() else {
            return json!({ "ret": 7, "text": "", "reports": [{ "text": "the app cannot be reached" }] });
        };
        let told = backend.dispatch(line, 0);
        let reply = told.ok().and_then(|reply| reply.parse::<Reply>().ok());
        self.put_back(backend);
        match reply {
            Some(reply) => session::as_json(&reply, None),
            None => json!({ "ret": 7, "text": "", "reports": [{ "text": "there is no answer" }] }),
        }
    }

    fn backend(&self) -> Option<Backend> {
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let found = match free.as_slice() {
            // The last one is the pattern of all others.
            [only] => only.again(),
            _ => free.pop(),
        };
        drop(free);
        found
    }

    fn put_back(&self, backend: Backend) {
        /// More at once are not kept.
        const MOST: usize = 16;
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        if free.len() < MOST {
            free.push(backend);
        }
    }

    /// The panel with what its widgets need to know: descriptions and values of options.
    fn described(&self) -> Value {
        let classes = self.backend().map(|mut backend| {
            let classes = backend.known().1;
            self.put_back(backend);
            classes
        });
        let classes = classes.unwrap_or_default();
        let widgets: Vec<Value> = self
            .panel
            .widgets
            .iter()
            .map(|widget| {
                let mut value = serde_json::to_value(widget).unwrap_or_default();
                if let Widget::Options { object, .. } = widget {
                    let class = object.split(['.', '@']).next().unwrap_or_default();
                    let info = classes.iter().find(|info| info.name == class);
                    value["class"] = json!(info);
                    let dump = self.ask(&format!("{object} CTRL -dump"));
                    value["dump"] = dump["text"].clone();
                }
                value
            })
            .collect();
        json!({ "title": self.panel.title, "widgets": widgets })
    }
}

/// Serves a panel until Ctrl-C; the exit code. `what` is a file, or the name of an object whose options are shown.
#[must_use]
pub fn run(backend: Backend, what: &str, listen: SocketAddr) -> u8 {
    let panel = if Path::new(what).is_file() || what.ends_with(".toml") {
        match Panel::load(Path::new(what)) {
            Ok(panel) => panel,
            Err(why) => {
                show::say(&format!("error: {why}"));
                return exit::CONFIG;
            }
        }
    } else {
        Panel::of_object(what)
    };
    let listener = match TcpListener::bind(listen) {
        Ok(listener) => listener,
        Err(error) => {
            show::say(&format!("error: cannot listen at {listen}: {error}"));
            return exit::UNREACHABLE;
        }
    };
    let desk = Desk {
        free: Mutex::new(vec![backend]),
        panel,
    };
    match server::serve(listener, desk) {
        Ok(()) => exit::INTERRUPTED,
        Err(error) => {
            show::say(&format!("error: the panel cannot be served: {error}"));
            exit::FAILED
        }
    }
}
