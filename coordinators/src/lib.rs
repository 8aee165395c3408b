//! The Coordination Level: a Dispatcher and its Coordinators, each a Petri net transducer under
//! `configs/nets/` and the few functions it names, and the data object manager through which they
//! exchange data (CIRSSE report 108, sections 6 and 7).
//!
//! They reach the Execution Level only by messages to the client interface of MCS and the Services
//! Manager of VSS; no simulator is named here.

pub mod arm;
pub mod carry;
pub mod dispatcher;
mod dispatching;
pub mod dom;
mod drawn;
mod game;
pub mod hand_eye;
pub mod handler;
pub mod motion;
pub mod objects;
mod observations;
pub mod operator;
pub mod organization;
pub mod outcome;
pub mod path;
pub mod positions;
pub mod push;
pub mod referee;
mod results;
pub mod served;
pub mod services;
pub mod strategy;
pub mod vision;
pub mod wrist;

#[cfg(test)]
mod tests;

use std::{future::Future, time::Duration};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::Context,
};
use pnt::library::Acted;
#[cfg(test)]
use tests::{bench, rig};

/// Registers every event handler of the Coordination Level, and the check of all nets of an app
/// together.
pub fn register(registry: &mut Registry) {
    dom::register(registry);
    dispatcher::register(registry);
    motion::register(registry);
    vision::register(registry);
    operator::register(registry);
    organization::planner::register(registry);
    referee::register(registry);
    hand_eye::register(registry);
    carry::register(registry);
    path::register(registry);
    push::register(registry);
    pnt::task::check_nets(registry);
}

/// The task of the data object manager, unless arguments say otherwise.
pub(crate) fn dom_task() -> String {
    "dom".to_owned()
}

/// How often giving something back is tried before a person has to see to it.
const GIVE_BACK_TRIES: u32 = 3;

/// Tries to give something back until it succeeds, a few times.
pub(crate) async fn insist<F: Future<Output = Acted>>(give_back: impl Fn() -> F) -> Acted {
    let mut given = give_back().await;
    for _ in 1..GIVE_BACK_TRIES {
        if given.is_ok() {
            break;
        }
        given = give_back().await;
    }
    given
}

/// How long a service that is gone, and may be started again, is waited for unless arguments say otherwise, s.
pub(crate) fn service_within_s() -> f64 {
    30.0
}

/// The wait before a service that is gone is asked again.
const ASK_AGAIN: Duration = Duration::from_millis(250);

/// Asks a service that may be started again until it answers, at most for `within` and not when the app is
/// being stopped. Only for requests that may be done twice.
pub async fn patiently<T, E, F: Future<Output = Result<T, E>>>(
    cx: &Context,
    within: Duration,
    is_lost: impl Fn(&E) -> bool,
    ask: impl Fn() -> F,
) -> Result<T, E> {
    let until = cx.now() + within;
    loop {
        match ask().await {
            Err(error) if is_lost(&error) && !cx.is_stopping() && cx.now() + ASK_AGAIN < until => {
                cx.sleep(ASK_AGAIN).await;
            }
            answered => return answered,
        }
    }
}

/// A finding when a number of seconds in `task`'s arguments is none.
pub(crate) fn check_seconds(task: &TaskConfig, key: &str, value: f64, findings: &mut Findings) {
    if !(0.0..1e9).contains(&value) {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        findings.push(
            Finding::error("coordinators::args::seconds", format!("`{key}` is {value}"))
                .at(place)
                .help("give a number of seconds, 0 or more"),
        );
    }
}

/// A finding when a fraction of full speed in `task`'s arguments is none.
pub(crate) fn check_speed(task: &TaskConfig, key: &str, value: f64, findings: &mut Findings) {
    if !(value > 0.0 && value <= 1.0) {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        findings.push(
            Finding::error("coordinators::motion::speed", format!("`{key}` is {value}"))
                .at(place)
                .help("give a fraction of full speed, above 0 and up to 1"),
        );
    }
}

/// A finding when `task` names a task that the app does not have.
pub fn need_task(task: &TaskConfig, app: &App, key: &str, name: &str, findings: &mut Findings) {
    if app.task(name).is_none() {
        let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
        let names = app.tasks.iter().map(|task| task.name.as_str());
        findings.push(
            Finding::error(
                "ctos::config::unknown_task",
                format!(
                    "task `{}` needs a task `{name}`, which the app does not have",
                    task.name
                ),
            )
            .at(place)
            .label(format!("`{key}` of `{}`", task.name))
            .suggest(name, names),
        );
    }
}
