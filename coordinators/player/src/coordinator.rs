//! What the coordinators of arm and hand have in common: their arguments, the store, and that each request is done for itself.

use std::{marker::PhantomData, rc::Rc};

use coordinators::{dom::DomStore, handler::NetArgs};
use ctos::{
    config::{App, TaskConfig},
    diagnostic::Findings,
};
use pnt::library::{Action, Library};
use serde::{Deserialize, de::DeserializeOwned};

use crate::wire::Hindrance;

/// The functions of one of them.
pub trait Functions: Clone + std::fmt::Debug + 'static {
    /// The handler's name.
    const HANDLER: &'static str;

    /// What is to be known of a real one.
    type Real: Clone + std::fmt::Debug + DeserializeOwned + 'static;

    /// Adds them to a library.
    fn add(library: Library<InRoom<Self>>) -> Library<InRoom<Self>>;

    /// Findings where what is to be known makes no sense.
    fn check(real: &Self::Real, task: &TaskConfig, app: &App, findings: &mut Findings);
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, bound = "")]
pub struct RoomArgs<F: Functions> {
    /// The data object manager.
    #[serde(default = "dom")]
    dom: String,
    /// The task of the room.
    #[serde(default = "room")]
    room: String,
    /// A real one; the room's when it is left out.
    real: Option<F::Real>,
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
pub struct InRoom<F: Functions> {
    pub(crate) store: DomStore,
    /// The task of the room.
    pub(crate) room: String,
    pub(crate) real: Rc<Option<F::Real>>,
    /// Why the latest request was not done.
    pub(crate) hindrance: Option<Hindrance>,
}

impl<F: Functions> InRoom<F> {
    /// Those of an action.
    pub(crate) fn of(action: &Action<Self>) -> Self {
        action.with_state(|state| state.clone())
    }
}

impl<F: Functions> NetArgs for RoomArgs<F> {
    const HANDLER: &'static str = F::HANDLER;
    type State = InRoom<F>;

    fn dom(&self) -> &str {
        &self.dom
    }

    fn library(self, store: DomStore) -> Library<InRoom<F>> {
        let Self { room, real, .. } = self;
        let real = Rc::new(real);
        let state = InRoom {
            store,
            room,
            real,
            hindrance: None,
        };
        let library = Library::new(state).kept(
            |state| state.hindrance.clone(),
            |state, hindrance| state.hindrance = hindrance,
        );
        F::add(library)
    }

    fn check(&self, task: &TaskConfig, app: &App, findings: &mut Findings) {
        coordinators::need_task(task, app, "room", &self.room, findings);
        if let Some(real) = &self.real {
            F::check(real, task, app, findings);
        }
    }
}
