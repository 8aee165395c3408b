//! Channel drivers by the name that the configuration uses for them.

use std::collections::BTreeMap;
use std::sync::Arc;

use ctos::config::{App, Node, TaskConfig};
use ctos::diagnostic::{Finding, Findings};
use ctos::registry::unread_args;
use ctos::task::{Context, HandlerError};

use super::ChannelDriver;

type Build =
    Arc<dyn Fn(&Context, &Node) -> Result<Box<dyn ChannelDriver>, HandlerError> + Send + Sync>;
type Check = Arc<dyn Fn(&TaskConfig, &App, &Node, &mut Findings) + Send + Sync>;
type Slots = Arc<dyn Fn(&App, &Node) -> Option<usize> + Send + Sync>;

/// A kind of channel driver.
#[derive(Clone)]
pub struct DriverKind {
    build: Build,
    check: Option<Check>,
    keys: Vec<&'static str>,
    slots: Option<Slots>,
}

impl DriverKind {
    /// Declares the keys of `driver_args` that a driver without a [`check`](Self::check) reads. Any other key is found before
    /// anything starts.
    pub fn keys(&mut self, keys: &[&'static str]) -> &mut Self {
        self.keys.extend(keys);
        self
    }

    /// Adds a check of the driver's arguments that runs before anything starts; it is given the servo
    /// task, the app and the node `driver_args` (an empty table when there is none). It finds the keys that the driver does
    /// not know, too.
    pub fn check(
        &mut self,
        check: impl Fn(&TaskConfig, &App, &Node, &mut Findings) + Send + Sync + 'static,
    ) {
        self.check = Some(Arc::new(check));
    }

    /// Tells, before anything starts, how many slots the driver will have with the node `driver_args` (an empty table when
    /// there is none): it is then found where they do not fit the arm. `None` where that cannot be told.
    pub fn slots(
        &mut self,
        slots: impl Fn(&App, &Node) -> Option<usize> + Send + Sync + 'static,
    ) -> &mut Self {
        self.slots = Some(Arc::new(slots));
        self
    }

    /// How many slots the driver will have with these arguments, where that can be told.
    pub fn count_slots(&self, app: &App, args: &Node) -> Option<usize> {
        self.slots.as_ref().and_then(|slots| slots(app, args))
    }

    /// Checks the arguments that `task` gives the driver: as it was registered, or for keys that nobody reads.
    pub fn run_check(&self, task: &TaskConfig, app: &App, args: &Node, findings: &mut Findings) {
        if let Some(check) = &self.check {
            return check(task, app, args, findings);
        }
        let driver = task.args.get("driver").and_then(Node::as_str);
        let (name, driver) = (&task.name, driver.unwrap_or_default());
        unread_args(
            args,
            &self.keys,
            Some(&task.place),
            |key| {
                format!(
                    "task `{name}` gives `args.driver_args.{key}`, and its channel driver `{driver}`"
                )
            },
            "the driver reads where it is registered: `drivers.driver(..).keys(..)`, or `check`",
            findings,
        );
    }

    /// Builds the driver with the arguments `args`.
    ///
    /// # Errors
    /// Why it cannot be built.
    pub fn build(&self, cx: &Context, args: &Node) -> Result<Box<dyn ChannelDriver>, HandlerError> {
        (self.build)(cx, args)
    }
}

/// The channel drivers that a program offers; given to `mcs::register`.
#[derive(Clone, Default)]
pub struct DriverRegistry {
    kinds: BTreeMap<String, DriverKind>,
}

impl DriverRegistry {
    /// No drivers.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Registers a driver under `name`. It is built on the servo task's processor, with that task's
    /// context and the node `driver_args` of its arguments.
    pub fn driver(
        &mut self,
        name: &str,
        build: impl Fn(&Context, &Node) -> Result<Box<dyn ChannelDriver>, HandlerError>
        + Send
        + Sync
        + 'static,
    ) -> &mut DriverKind {
        let kind = DriverKind {
            build: Arc::new(build),
            check: None,
            keys: Vec::new(),
            slots: None,
        };
        match self.kinds.entry(name.to_owned()) {
            std::collections::btree_map::Entry::Vacant(entry) => entry.insert(kind),
            std::collections::btree_map::Entry::Occupied(entry) => {
                let entry = entry.into_mut();
                *entry = kind;
                entry
            }
        }
    }

    /// The driver called `name`.
    #[must_use]
    pub fn kind(&self, name: &str) -> Option<&DriverKind> {
        self.kinds.get(name)
    }

    /// The driver called `name`, which `task` names.
    ///
    /// # Errors
    /// A finding without a place, when nobody registered it.
    pub fn find(&self, name: &str, task: &str) -> Result<&DriverKind, Finding> {
        self.kind(name).ok_or_else(|| {
            let text =
                format!("task `{task}` names the channel driver `{name}`, which nobody registered");
            Finding::error("mcs::unknown_driver", text).suggest(name, self.names())
        })
    }

    /// These drivers, [`NAMED_SLOTS`](super::NAMED_SLOTS), [`DRIVES`](super::DRIVES) made of one of them, and [`TESTBED`](super::TESTBED) made of any.
    #[must_use]
    pub fn with_testbed(mut self) -> Self {
        super::named::register(&mut self);
        super::drives::register(&mut self);
        super::testbed::register(&mut self);
        self
    }

    /// All names, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.kinds.keys().map(String::as_str)
    }
}
