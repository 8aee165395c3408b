//! A fleet: sites with cells, an operator for each site and a company above.
//!
//! [`table`] reads how many replicas of a cell there are. [`wire`] is what the tasks say to each other. A cell's
//! [`agent`] offers its work to a [`trader`]; the [`operator`] of the site lends it jobs and keeps them in its [`book`];
//! the [`company`] gives jobs to sites, rolls out new versions ([`rollout`]) and sums up (`sums`) for displays. A cell's net has its steps done by
//! stand-ins, which take recorded times ([`stand_in`], [`cell`]). What is so, whatever they know, is the [`world`]: a
//! referee counts there. `docs/fleet.md` tells how it fits together, and why no job is done twice.
//!
//! Knows no robot, no camera and no simulator of physics.

pub mod agent;
pub mod book;
pub mod cell;
pub mod company;
pub mod operator;
pub mod rollout;
pub mod stand_in;
mod sums;
pub mod table;
pub mod trader;
pub mod wire;
pub mod world;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
};

use crate::agent::Leases;

/// Registers the event handlers.
pub fn register(registry: &mut Registry) {
    register_with(registry, Leases::Kept);
}

/// The same with agents that keep to their leases, or do not.
#[doc(hidden)]
pub fn register_with(registry: &mut Registry, leases: Leases) {
    trader::register(registry);
    operator::register(registry);
    company::register(registry);
    agent::register(registry, leases);
    cell::register(registry);
    stand_in::register(registry);
}

/// Finds a task that another one needs and the app has not.
fn need_task(task: &TaskConfig, app: &App, key: &str, name: &str, findings: &mut Findings) {
    if app.task(name).is_some() {
        return;
    }
    let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
    let needing = &task.name;
    let text = format!("task `{needing}` needs a task `{name}`, which the app does not have");
    let finding = Finding::error("ctos::config::unknown_task", text).at(place);
    let names = app.tasks.iter().map(|task| task.name.as_str());
    findings.push(
        finding
            .label(format!("`{key}` of `{needing}`"))
            .suggest(name, names),
    );
}
