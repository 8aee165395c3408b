//! What the coordinators of the room have in common: their arguments, the store, and that each request is done for itself.

use std::marker::PhantomData;

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
};
use pnt::library::{Action, Library};
use serde::Deserialize;

/// The functions of one of them.
pub trait Functions: Clone + 'static {
    /// The handler's name.
    const HANDLER: &'static str;

    /// Adds them to a library.
    fn add(library: Library<InRoom>) -> Library<InRoom>;
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, bound = "")]
pub struct RoomArgs<F> {
    /// The data object manager.
    #[serde(default = "dom")]
    dom: String,
    /// The task of the room.
    #[serde(default = "room")]
    room: String,
    #[serde(skip)]
    functions: PhantomData<F>,
}

pub(crate) fn dom() -> String {
    "dom".to_owned()
}

pub(crate) fn room() -> String {
    "room".to_owned()
}

/// What the functions share.
#[derive(Debug, Clone)]
pub struct InRoom {
    pub(crate) store: DomStore,
    /// The task of the room.
    pub(crate) room: String,
}

impl InRoom {
    /// Those of an action.
    pub(crate) fn of(action: &Action<Self>) -> Self {
        action.with_state(|state| state.clone())
    }
}

impl<F: Functions> NetArgs for RoomArgs<F> {
    const HANDLER: &'static str = F::HANDLER;
    type State = InRoom;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<InRoom> {
        let Self { room, .. } = self;
        // Between two requests there is nothing to know.
        let library = Library::new(InRoom { store, room }).kept(|_| (), |_, ()| ());
        F::add(library)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
    }
}
