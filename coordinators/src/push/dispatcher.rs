//! The Dispatcher of `push`: the functions of `nets/push/dispatcher.net`, which turns a command into a job, and tells what
//! became of it.

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::HandlerError,
};
use nalgebra::Point2;
use pnt::library::Library;
use serde::Deserialize;

use super::job::{ACCOUNT, Account, JOB, Job};
use crate::{
    dispatching::{self, Dispatcher, Orders},
    dom::DomStore,
    handler::{self, NetArgs},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.push";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PushArgs {
    /// The longest way, m.
    #[serde(default = "longest_m")]
    longest_m: f64,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
}

fn longest_m() -> f64 {
    1.0
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<PushArgs>(registry);
}

impl NetArgs for PushArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Dispatcher<Self>;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Dispatcher<Self>> {
        dispatching::library(self, store)
    }

    fn check(&self, task: &TaskConfig, _app: &App, findings: &mut Findings) {
        if !(0.01..=10.0).contains(&self.longest_m) {
            let place = task.args.locate("longest_m");
            let text = format!("`longest_m` is {}", self.longest_m);
            findings.push(
                Finding::error("coordinators::push::range", text)
                    .at(place.unwrap_or_else(|| task.place.clone()))
                    .help("give from 0.01 to 10 m"),
            );
        }
    }
}

impl Orders for PushArgs {
    type Order = Job;
    const ORDER: &'static str = JOB;
    type Account = Account;
    const ACCOUNT: &'static str = ACCOUNT;

    fn order(&self, command: u32, arguments: &[String]) -> Result<Job, HandlerError> {
        job(command, arguments, self.longest_m)
    }
}

fn job(command: u32, arguments: &[String], longest_m: f64) -> Result<Job, HandlerError> {
    let [from, to] = arguments else {
        return Err(HandlerError::new(format!(
            "`push` takes FROM and TO, two points X,Y in m such as 0.5,-0.2 0.5,0.1, and was given {}",
            arguments.len()
        )));
    };
    let point = |text: &str| -> Result<Point2<f64>, HandlerError> {
        let numbers: Option<Vec<f64>> = text
            .split(',')
            .map(|number| {
                number
                    .trim()
                    .parse()
                    .ok()
                    .filter(|number: &f64| number.is_finite())
            })
            .collect();
        match numbers.as_deref() {
            Some(&[x, y]) => Ok(Point2::new(x, y)),
            _ => Err(HandlerError::new(format!(
                "`{text}` is no point: write X,Y in m of the arm's base frame"
            ))),
        }
    };
    let job = Job {
        command,
        from: point(from)?,
        to: point(to)?,
    };
    let length = job.length();
    if !(0.005..=longest_m).contains(&length) {
        return Err(HandlerError::new(format!(
            "a push is 0.005 to {longest_m} m long, not {length:.3} m"
        )));
    }
    Ok(job)
}

#[cfg(test)]
mod tests {

    #[test]
    fn a_command_names_two_points_or_is_refused_in_words() {
        let job = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(ToString::to_string).collect();
            super::job(1, &words, 0.5).map_err(|error| error.to_string())
        };
        let found = job(&["0.5,-0.2", "0.5,0.1"]).unwrap();
        assert!((found.length() - 0.3).abs() < 1e-12);
        for (words, text) in [
            (&["0.5,0"][..], "FROM and TO"),
            (&["0.5", "0.5,0.1"], "is no point"),
            (&["nan,0", "0.5,0.1"], "is no point"),
            (&["0.5,0", "0.5,0"], "not 0.000 m"),
            (&["0.5,0", "0.5,0.7"], "not 0.700 m"),
        ] {
            let error = job(words).unwrap_err();
            assert!(error.contains(text), "{words:?}: {error}");
        }
    }
}
