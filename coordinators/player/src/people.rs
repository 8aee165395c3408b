//! The People Coordinator of the checkers player: the functions of `nets/checkers/people.net`, which note what people want. The player takes it up between two moves.

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;

use crate::wire::{self, WISH, Wish};

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeopleArgs {
    /// The data object manager.
    #[serde(default = "crate::coordinator::dom")]
    dom: String,
}

/// What the functions share.
pub struct People {
    store: DomStore,
}

type Act = Action<People>;

impl NetArgs for PeopleArgs {
    const HANDLER: &'static str = "checkers.people";
    type State = People;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<People> {
        Library::new(People { store })
            // Between two requests there is nothing to know.
            .kept(|_| (), |_, ()| ())
            .action("hear", hear)
    }

    fn check(&self, _task: &TaskConfig, _app: &App, _findings: &mut Findings) {}
}

async fn hear(action: Act) -> Acted {
    let store = action.with_state(|state| state.store.clone());
    let cx = action.cx();
    let what = action.command().map(|command| command.symbol.clone());
    let before: Option<Wish> = store.fetch(cx, WISH).await.ok();
    let wish = Wish {
        number: before.map_or(0, |before| before.number) + 1,
        what: what.unwrap_or_default(),
    };
    wire::keep(cx, &store, WISH, &wish).await
}
