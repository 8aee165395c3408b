//! Guards by the name that the configuration uses for their kind.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use ctos::config::Node;
use ctos::task::{Context, HandlerError};

use super::contact::Contact;
use super::force::Force;
use super::speed::Speed;
use super::workspace::Workspace;
use super::{Guard, Neighbour};
use crate::model::Model;

type Build = Arc<dyn Fn(&GuardSettings<'_>) -> Result<Box<dyn Guard>, HandlerError> + Send + Sync>;

/// What else there is on the chassis of a servo.
pub trait Around {
    /// The arm of the servo task called `servo`.
    ///
    /// # Errors
    /// There is none on this chassis.
    fn neighbour(&self, servo: &str) -> Result<Neighbour, HandlerError>;
}

/// What a guard is made from.
#[derive(Clone, Copy)]
pub struct GuardSettings<'a> {
    /// The arm; its tip is the tool.
    pub model: &'a Arc<Model>,
    /// Servo period.
    pub period: Duration,
    /// The name of the servo's task.
    pub servo: &'a str,
    /// What else there is on its chassis.
    pub around: &'a dyn Around,
    /// The servo's task, through which a guard may share with tasks of its chassis what it writes in its ticks; `None`
    /// while the app is checked.
    pub cx: Option<&'a Context>,
    /// The guard's own arguments: `args` of the recipe, or an empty table.
    pub args: &'a Node,
}

/// The kinds of guard that a program offers; given to `mcs::register`.
#[derive(Clone)]
pub struct GuardRegistry {
    kinds: BTreeMap<String, Build>,
}

impl Default for GuardRegistry {
    fn default() -> Self {
        Self::new()
    }
}

impl GuardRegistry {
    /// The kinds that come with this crate: `workspace`, `speed`, `force` and `contact`.
    #[must_use]
    pub fn new() -> Self {
        let mut registry = Self {
            kinds: BTreeMap::new(),
        };
        registry.guard("workspace", Workspace::from_args);
        registry.guard("speed", Speed::from_args);
        registry.guard("force", Force::from_args);
        registry.guard("contact", Contact::from_args);
        registry
    }

    /// Registers a kind under `name`, in place of one that has it already. It is built when the app is checked, and
    /// again on the servo task's processor, there also when a recipe is changed; what it refuses is a finding.
    pub fn guard(
        &mut self,
        name: &str,
        build: impl Fn(&GuardSettings<'_>) -> Result<Box<dyn Guard>, HandlerError>
        + Send
        + Sync
        + 'static,
    ) {
        self.kinds.insert(name.to_owned(), Arc::new(build));
    }

    /// Makes a guard of the kind called `name`; `None` when none is.
    ///
    /// # Errors
    /// What the kind does not like about its settings.
    pub fn build(
        &self,
        name: &str,
        settings: &GuardSettings<'_>,
    ) -> Option<Result<Box<dyn Guard>, HandlerError>> {
        self.kinds.get(name).map(|build| build(settings))
    }

    /// All names, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.kinds.keys().map(String::as_str)
    }
}
