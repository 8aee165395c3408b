//! Event handlers that run a net with functions of this crate: how all of them are registered and checked.

use std::rc::Rc;

use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    registry::{Registry, Vocabulary},
};
use pnt::{
    check::FunctionNames,
    library::Library,
    task::{COMMANDS, KEYS, NetTask, args as net_args, args_of, check_args},
};
use serde::de::DeserializeOwned;

use crate::dom::DomStore;

/// The arguments of a handler, and the functions that they make.
pub trait NetArgs: DeserializeOwned + Clone + 'static {
    /// The handler's name.
    const HANDLER: &'static str;
    /// What the functions share.
    type State: 'static;

    /// The task of the data object manager.
    fn dom(&self) -> &str;

    /// The functions that the net may name.
    fn library(self, store: DomStore) -> Library<Self::State>;

    /// Findings where the arguments make no sense. That the functions are those of the net, and that there is a data object
    /// manager, is checked besides.
    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings);
}

/// Registers a handler.
pub fn register<A: NetArgs>(registry: &mut Registry) {
    registry
        .handler(A::HANDLER, &COMMANDS, |cx| {
            let args: A = args_of(cx)?;
            let store = DomStore::new(args.dom());
            let library = args.library(store.clone());
            NetTask::from_args(cx, library, Some(Rc::new(store)))
        })
        .speaks(|task| match net_args::<A>(task) {
            Ok(args) => names(&args).vocabulary(),
            Err(_) => Vocabulary::new(),
        })
        .keys(&KEYS)
        .checked_args::<A>(|args, task, app, findings| {
            crate::need_task(task, app, "dom", args.dom(), findings);
            args.check(task, app, findings);
            check_args(task, app, &names(args), findings);
        });
}

fn names<A: NetArgs>(args: &A) -> FunctionNames {
    let store = DomStore::new(args.dom());
    args.clone().library(store).names()
}
