//! The Hand Coordinator of the checkers player: the functions of `nets/checkers/hand.net`, which grasp discs and let them go.

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
    task::HandlerError,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::wire::{self, Errand};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandArgs {
    /// The data object manager.
    #[serde(default = "dom")]
    dom: String,
    /// The task of the room.
    #[serde(default = "room")]
    room: String,
}

fn dom() -> String {
    "dom".to_owned()
}

fn room() -> String {
    "room".to_owned()
}

/// What the functions share.
pub struct Hand {
    args: HandArgs,
    store: DomStore,
}

type Act = Action<Hand>;

impl NetArgs for HandArgs {
    const HANDLER: &'static str = "checkers.hand";
    type State = Hand;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<Hand> {
        Library::new(Hand { args: self, store })
            // Between two requests there is nothing to know.
            .kept(|_| (), |_, ()| ())
            .action("grasp", grasp)
            .action("release", release)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
    }
}

fn parts(action: &Act) -> (HandArgs, DomStore) {
    action.with_state(|state| (state.args.clone(), state.store.clone()))
}

async fn grasp(action: Act) -> Acted {
    let (args, store) = parts(&action);
    let cx = action.cx();
    let Errand { number, discs, .. } = wire::fetch(cx, &store, wire::ERRAND).await?;
    let close = wire::Close {
        errand: number,
        discs,
    };
    if wire::ask(cx, &args.room, close).await? == discs {
        return Ok(());
    }
    Err(HandlerError::new("there is nothing between the fingers"))
}

/// Fails when the hand was empty before.
async fn release(action: Act) -> Acted {
    let (args, store) = parts(&action);
    let cx = action.cx();
    let Errand { number, discs, .. } = wire::fetch(cx, &store, wire::ERRAND).await?;
    if wire::ask(cx, &args.room, wire::Open { errand: number }).await? == discs {
        return Ok(());
    }
    Err(HandlerError::new("the disc was lost on the way"))
}
