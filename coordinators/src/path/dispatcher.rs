//! The Dispatcher: the functions of `nets/path/dispatcher.net`, which turns the name of a place into a trip, and tells how it
//! went.

use std::{collections::BTreeMap, rc::Rc};

use ctos::{
    config::{App, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::{Registry, Vocabulary},
    task::{Context, HandlerError},
};
use mcs::Joints;
use pnt::{
    check::FunctionNames,
    library::{Acted, Action, Library},
    task::{COMMANDS, KEYS, NetTask, args as net_args, args_of, check_args},
};
use serde::Deserialize;

use super::trip::{ACCOUNT, Account, TRIP, Trip};
use crate::dom::DomStore;

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

/// What the functions share.
struct Dispatcher {
    args: Rc<GoArgs>,
    store: DomStore,
    /// Number of the command in work, from 1.
    command: u32,
}

/// Registers the handler.
pub(super) fn register(registry: &mut Registry) {
    registry
        .handler(HANDLER, &COMMANDS, |cx| {
            let args: GoArgs = args_of(cx)?;
            let store = DomStore::new(&args.dom);
            NetTask::from_args(cx, library(args, store.clone()), Some(Rc::new(store)))
        })
        .speaks(|task| match net_args::<GoArgs>(task) {
            Ok(args) => names(&args).vocabulary(),
            Err(_) => Vocabulary::new(),
        })
        .keys(&KEYS)
        .checked_args(check);
}

fn check(args: &GoArgs, task: &TaskConfig, app: &App, findings: &mut Findings) {
    crate::need_task(task, app, "dom", &args.dom, findings);
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
    check_args(task, app, &names(args), findings);
}

/// Joint positions in degrees, as this arm has only joints that turn.
fn radians(position: &[f64]) -> Joints {
    Joints::from_fn(position.len(), |joint| position[joint].to_radians())
}

fn names(args: &GoArgs) -> FunctionNames {
    library(args.clone(), DomStore::new(&args.dom)).names()
}

fn library(args: GoArgs, store: DomStore) -> Library<Dispatcher> {
    let state = Dispatcher {
        args: Rc::new(args),
        store,
        command: 0,
    };
    Library::new(state)
        .kept(
            |state| state.command,
            |state, command| state.command = command,
        )
        .action("begin", begin)
        .action("report", report)
}

type Act = Action<Dispatcher>;

fn parts(action: &Act) -> (Context, Rc<GoArgs>, DomStore) {
    let (args, store) = action.with_state(|state| (state.args.clone(), state.store.clone()));
    (action.cx().clone(), args, store)
}

/// Reads the name of a place, and makes the trip of it. Why it makes none goes into the answer.
async fn begin(action: Act) -> Acted {
    let (cx, args, store) = parts(&action);
    let command = action.with_state(|state| state.command.wrapping_add(1));
    let began = match trip(command, action.arguments(), &args) {
        Ok(trip) => store.store(&cx, TRIP, &trip).await,
        Err(error) => {
            action.note(error.to_string());
            Err(error)
        }
    };
    action.with_state(|state| state.command = command);
    began
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

/// Tells, in the answer, which ways were tried and how they ended.
async fn report(action: Act) -> Acted {
    let (cx, _, store) = parts(&action);
    let command = action.with_state(|state| state.command);
    if let Ok(account) = store.fetch::<Account>(&cx, ACCOUNT).await
        && account.command == command
    {
        for line in account.lines() {
            action.note(line);
        }
    }
    Ok(())
}
