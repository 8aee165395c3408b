//! The handler `pnt.net`: runs any net file. What its transitions do stands in the net's text; requests go to service
//! objects of the app.
//!
//! - `template`: the line of a request with its values left open;
//! - `objects`: data objects that only this net has;
//! - this file: the handler, and its checks before anything starts.
//!
//! Knows no robot, and of nets only what a library knows.

mod objects;
mod template;

#[cfg(test)]
mod tests;

use std::{cell::RefCell, collections::BTreeMap, rc::Rc, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::{Context, HandlerError},
};
use pnt::{
    check::FunctionNames,
    data::Value,
    library::{Answer, DataStore, Later, Library, Requests},
    net::{Action, Does, Line, Net},
    task::{COMMANDS, KEYS, NetTask, args_of, check_args, check_nets, net_of, settings},
};
use serde::Deserialize;
use sorma::{
    Dictionary, Location, ObjectName, Sorm,
    daemon::{self, Tasks},
};

use objects::Objects;
use template::Template;

/// The handler's name.
pub const HANDLER: &str = "pnt.net";

/// What stands in the arguments of a task besides those of every net.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct NetArgs {
    /// The daemon of the objects that are named without one.
    daemon: Option<String>,
}

/// Registers the handler.
pub fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &COMMANDS, |cx| {
            let args: NetArgs = args_of(cx)?;
            let daemon = args.daemon.or_else(|| only_daemon(cx.app()));
            let objects = Objects::default();
            let store: Rc<dyn DataStore> = Rc::new(objects.clone());
            NetTask::from_args(cx, library(objects, Lines::of(daemon)), Some(store))
        })
        .keys(&KEYS)
        .checked_args::<NetArgs>(|args, task, app, findings| {
            check_args(task, app, &names(), findings);
            check_requests(args, task, app, findings);
        })
        .speaks(|_| names().vocabulary());
    check_nets(registry);
}

fn library(objects: Objects, lines: Lines) -> Library<Objects> {
    Library::new(objects)
        .kept(Objects::kept, |objects, kept| objects.take_up(kept))
        .requests(lines)
}

fn names() -> FunctionNames {
    library(Objects::default(), Lines::of(None)).names()
}

/// The daemon of an app that has one.
fn only_daemon(app: &App) -> Option<String> {
    let mut daemons = app.tasks_with(daemon::HANDLER);
    let only = daemons.next()?;
    daemons.next().is_none().then(|| only.name.clone())
}

/// Requests as lines of text; each line is read once.
struct Lines {
    daemon: Option<String>,
    sorm: Sorm,
    known: RefCell<BTreeMap<String, Rc<Template>>>,
}

impl Lines {
    fn of(daemon: Option<String>) -> Self {
        Self {
            daemon,
            sorm: Sorm::new(Dictionary::new()),
            known: RefCell::default(),
        }
    }

    fn template(&self, line: &Line) -> Result<Rc<Template>, HandlerError> {
        if let Some(known) = self.known.borrow().get(&line.text) {
            return Ok(Rc::clone(known));
        }
        let read = Template::of(line, self.daemon.as_deref());
        let template = Rc::new(read.map_err(HandlerError::from)?);
        let mut known = self.known.borrow_mut();
        known.insert(line.text.clone(), Rc::clone(&template));
        Ok(template)
    }
}

impl Requests for Lines {
    fn ask(
        &self,
        cx: &Context,
        line: &Line,
        values: Vec<Value>,
        limit: Duration,
    ) -> Later<Result<Answer, HandlerError>> {
        let request = self.template(line).map(|template| template.filled(&values));
        let (sorm, tasks) = (self.sorm.clone(), Tasks::of(cx).deadline(limit));
        Box::pin(async move {
            let reply = sorm.ask(&tasks, request?).await;
            let body = reply.body;
            if !body.is_ok() {
                return Err(HandlerError::new(body.said()));
            }
            Ok(Answer {
                text: body.text,
                floats: body.floats,
                ints: body.ints,
            })
        })
    }
}

/// The lines of a net's requests.
fn requests(net: &Net) -> impl Iterator<Item = &Line> {
    net.transitions()
        .iter()
        .filter_map(|one| match &one.action {
            Some(Action::Written {
                does: Some(Does::Request(line)),
                ..
            }) => Some(line),
            _ => None,
        })
}

/// What is wrong with the lines of a net's requests, whatever app it runs in.
#[must_use]
pub fn check_lines(net: &Net) -> Findings {
    let mut findings = Findings::new();
    for line in requests(net) {
        // Which daemon serves an object is the app's to say.
        if let Err(finding) = Template::of(line, Some("objects")) {
            findings.push(finding);
        }
    }
    findings
}

/// Checks what can be known of requests before anything starts: that each is a request, that its values fit where
/// they stand, and that its daemon is a task of the app.
fn check_requests(args: &NetArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let default = args.daemon.clone().or_else(|| only_daemon(app));
    if let Some(daemon) = &args.daemon {
        check_daemon(
            daemon,
            app,
            &|finding| {
                let node = task
                    .args
                    .get("daemon")
                    .and_then(|node| node.place().cloned());
                finding.at(node.unwrap_or_else(|| task.place.clone()))
            },
            findings,
        );
    }
    let stood_in = settings(task).is_ok_and(|settings| settings.stand_in.is_some());
    let Ok(net) = net_of(task, app) else { return };
    for line in requests(&net) {
        match Template::of(line, default.as_deref().or(stood_in.then_some("objects"))) {
            Err(finding) => findings.push(finding),
            Ok(template) if !stood_in => {
                if let Location::Alias(daemon) = template.name().location() {
                    let at = |finding: Finding| finding.at(line.at.clone());
                    check_daemon(daemon, app, &at, findings);
                }
            }
            Ok(_) => {}
        }
    }
}

fn check_daemon(daemon: &str, app: &App, at: &dyn Fn(Finding) -> Finding, findings: &mut Findings) {
    let daemons = || {
        app.tasks
            .iter()
            .filter(|task| task.handler == daemon::HANDLER)
    };
    if daemons().any(|task| task.name == daemon) {
        return;
    }
    let text = format!("no task `{daemon}` of this app serves objects");
    let finding = Finding::error("pnt::net::daemon", text)
        .help(format!(
            "add a task with the handler `{}`, or name another one",
            daemon::HANDLER
        ))
        .suggest(daemon, daemons().map(|task| task.name.as_str()));
    findings.push(at(finding));
}

/// The object with the daemon that serves it.
fn served(name: &ObjectName, daemon: Option<&str>) -> Result<ObjectName, &'static str> {
    match (name.location(), daemon) {
        (Location::Local, Some(daemon)) => {
            let whole = format!("{}@{daemon}", name.local());
            whole
                .parse()
                .map_err(|_| "the daemon's name is no name of one")
        }
        (Location::Local | Location::Here, _) => {
            Err("it does not say which daemon serves it, and the app has not just one")
        }
        (Location::Default, _) => Err("a net has no dictionary that says which daemon is meant"),
        (Location::Alias(_) | Location::Address { .. }, _) => Ok(name.clone()),
    }
}
