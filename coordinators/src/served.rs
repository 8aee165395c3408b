//! Service objects at daemons of the app, as Coordinators ask them by name.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    task::{Context, HandlerError},
};
use sorma::{Comm as _, Location, Method, ObjectName, Report, Request, Transport, daemon::Tasks};

/// A service object, at its daemon.
#[derive(Debug, Clone, PartialEq)]
pub struct Served(ObjectName);

impl Served {
    /// The object of that name, such as `fork.sound@speaker`.
    ///
    /// # Errors
    /// It is no name, or no daemon is named.
    pub fn named(name: &str) -> Result<Self, String> {
        let object: ObjectName = name.parse().map_err(|error| format!("{error}"))?;
        match object.location() {
            Location::Alias(_) | Location::Address { .. } => Ok(Self(object)),
            _ => Err(format!("`{name}` does not say at which daemon")),
        }
    }

    /// The task of its daemon, if it is named by that.
    #[must_use]
    pub fn daemon(&self) -> Option<&str> {
        match self.0.location() {
            Location::Alias(task) => Some(task),
            _ => None,
        }
    }

    fn request(&self, method: Method, body: Transport) -> Request {
        Request {
            name: self.0.here(),
            method,
            body,
        }
    }

    /// Has its EXEC do something. Nobody waits for it.
    ///
    /// # Errors
    /// The daemon cannot be reached.
    pub async fn tell(&self, cx: &Context, body: Transport) -> Result<(), Report> {
        let request = self.request(Method::Exec, body);
        Tasks::of(cx).tell(self.0.location(), request).await
    }

    /// Has it do something that may be done twice, and waits for the answer.
    ///
    /// # Errors
    /// There is no answer, or the object says what went wrong.
    pub async fn ask(
        &self,
        cx: &Context,
        method: Method,
        body: Transport,
    ) -> Result<Transport, HandlerError> {
        let tasks = Tasks::of(cx).idempotent(1);
        let failed = |text: &str| HandlerError::new(format!("{}: {text}", self.0));
        let request = self.request(method, body);
        let answer = tasks.ask(self.0.location(), request).await;
        let answer = answer.map_err(|report| failed(&report.text))?;
        if answer.code == 0 {
            return Ok(answer);
        }
        let last = answer.reports.last();
        Err(failed(last.map_or("it failed", |report| &report.text)))
    }
}

impl std::fmt::Display for Served {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// Findings where the argument `key` names no object at a daemon of the app.
pub fn check(
    (key, name): (&str, &str),
    example: &str,
    task: &TaskConfig,
    app: &App,
    findings: &mut Findings,
) {
    match Served::named(name) {
        Ok(served) => {
            if let Some(daemon) = served.daemon() {
                crate::need_task(task, app, key, daemon, findings);
            }
        }
        Err(text) => {
            let place = task.args.locate(key);
            findings.push(
                Finding::error("coordinators::served::name", text)
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help(format!("name an object at its daemon, such as `{example}`")),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_is_asked_at_a_daemon() {
        let speaker = Served::named("fork.sound@speaker").unwrap();
        assert_eq!(speaker.daemon(), Some("speaker"));
        for name in ["fork.sound", "fork.sound@self", "a b@c", ""] {
            assert!(Served::named(name).is_err(), "{name}");
        }
    }
}
