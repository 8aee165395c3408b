//! The Dispatcher: the functions of `nets/path/dispatcher.net`, which turns the name of a place into a trip, and tells how it
//! went.

use std::collections::BTreeMap;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
    task::HandlerError,
};
use pnt::library::Library;
use serde::Deserialize;

use super::trip::{ACCOUNT, Account, TRIP, Trip};
use crate::{
    arm::radians,
    dispatching::{self, Dispatcher, Orders},
    dom::DomStore,
    handler::{self, NetArgs},
};

/// The handler's name.
pub const HANDLER: &str = "coordinators.go";

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct GoArgs {
    /// The places, by name: degrees of the arm's joints, m of those that slide.
    places: BTreeMap<String, Vec<f64>>,
    /// The data object manager.
    #[serde(default = "crate::dom_task")]
    dom: String,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    handler::register::<GoArgs>(registry);
}

impl NetArgs for GoArgs {
    const HANDLER: &'static str = HANDLER;
    type State = Dispatcher<Self>;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Dispatcher<Self>> {
        dispatching::library(self, store)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        check(self, task, app, findings);
    }
}

fn check(args: &GoArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let place = |key: &str| task.args.locate(key).unwrap_or_else(|| task.place.clone());
    let mut wrong = |key: &str, text: String, help: &str| {
        let finding = Finding::error("coordinators::path::place", text).at(place(key));
        findings.push(finding.help(help.to_owned()));
    };
    if args.places.is_empty() {
        wrong(
            "places",
            "there is no place to go to".to_owned(),
            "name one",
        );
    }
    if let Some(model) = mcs::manipulator(app) {
        for (name, position) in &args.places {
            let key = format!("places.{name}");
            let joints = model.dof();
            if position.len() != joints {
                let text = format!("place `{name}` has {} numbers", position.len());
                wrong(&key, text, &format!("the arm has {joints} joints"));
            } else if let Some(joint) = model.joint_outside(&radians(position)) {
                let text = format!("place `{name}`: joint {} is beyond its limits", joint + 1);
                wrong(&key, text, "give a position within them");
            }
        }
    }
}

impl Orders for GoArgs {
    type Order = Trip;
    const ORDER: &'static str = TRIP;
    type Account = Account;
    const ACCOUNT: &'static str = ACCOUNT;

    fn order(&self, command: u32, arguments: &[String]) -> Result<Trip, HandlerError> {
        trip(command, arguments, self)
    }
}

fn trip(command: u32, arguments: &[String], args: &GoArgs) -> Result<Trip, HandlerError> {
    let known = || args.places.keys().cloned().collect::<Vec<_>>().join(", ");
    let [to] = arguments else {
        return Err(HandlerError::new(format!(
            "`go` takes one place, and was given {}; there are {}",
            arguments.len(),
            known()
        )));
    };
    let position = args.places.get(to);
    let position = position.ok_or_else(|| {
        HandlerError::new(format!("there is no place `{to}`; there are {}", known()))
    })?;
    Ok(Trip {
        command,
        to: to.clone(),
        goal: radians(position),
    })
}
