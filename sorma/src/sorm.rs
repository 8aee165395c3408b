//! The service object request manager (SORM; SORMA technical report, sections 1.4.2 and 1.5). It
//! keeps objects by their names, has them built on first use, and passes requests to them.
//!
//! One process, any thread; an object is called by reference at the cost of a virtual call.

use crate::arrival::Arrivals;
use crate::class::Class;
use crate::dictionary::Dictionary;
use crate::name::{Location, ObjectName, suggestion};
use crate::object::Slot;
use crate::raise;
use crate::report::{Prototype, Report, code};
use crate::results::Results;
use crate::trade::market::Market;
use crate::trade::wanted::Wanted;
use crate::transport::Transport;
use crate::watching::Watchers;
use ctos::time::{Clock, Instant};
use parking_lot::{Condvar, Mutex, RwLock};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::thread::ThreadId;

/// The word of the dictionary by which a daemon is sought among those that offer the class.
const TRADE: &str = "trade";

/// The manager of one process's service objects. Clones are the same manager.
#[derive(Clone)]
pub struct Sorm {
    pub(crate) inner: Arc<Inner>,
}

pub(crate) struct Inner {
    process: String,
    clock: Clock,
    classes: RwLock<BTreeMap<&'static str, Arc<Class>>>,
    objects: RwLock<BTreeMap<String, Arc<Slot>>>,
    aliases: RwLock<BTreeMap<String, String>>,
    /// What is in use of other daemons.
    proxies: Mutex<BTreeMap<Location, BTreeSet<ObjectName>>>,
    /// The results that are subscribed to, by the local names of the objects.
    results: Mutex<BTreeMap<String, Arc<Results>>>,
    pub(crate) market: Mutex<Market>,
    /// Who watches the requests that are met here.
    watchers: Arc<Watchers>,
    pub(crate) dictionary: Arc<RwLock<Dictionary>>,
    /// What CTRL has changed of objects, for a process to come; `None`: nobody keeps it.
    kept: Mutex<Option<Kept>>,
    /// Objects being built now; of each thread the outermost first.
    pub(crate) building: Mutex<Vec<Building>>,
    /// One of them is built.
    pub(crate) built: Condvar,
    /// Who asks in which order for objects that are not built yet, by their local names.
    pub(crate) arrivals: Arrivals,
}

/// An object that is being built.
pub(crate) struct Building {
    pub(crate) name: String,
    pub(crate) by: ThreadId,
    pub(crate) since: Instant,
}

/// Objects by their local names, with the options that they had after the last CTRL that changed them, as `-dump`
/// answers them.
pub type Kept = BTreeMap<String, String>;

/// Which process serves an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Place {
    Here,
    There(Location),
    /// The daemon with the best offer of the class.
    Traded(Wanted),
}

impl std::fmt::Debug for Sorm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let objects = self.inner.objects.read().len();
        write!(f, "Sorm({}, {objects} objects)", self.inner.process)
    }
}

impl Sorm {
    /// A manager that knows no classes yet.
    pub(crate) fn bare(process: &str, clock: Clock, dictionary: Dictionary) -> Self {
        Self {
            inner: Arc::new(Inner {
                process: process.to_owned(),
                clock,
                classes: RwLock::default(),
                objects: RwLock::default(),
                aliases: RwLock::default(),
                proxies: Mutex::default(),
                results: Mutex::default(),
                market: Mutex::default(),
                watchers: Arc::default(),
                kept: Mutex::default(),
                dictionary: Arc::new(RwLock::new(dictionary)),
                building: Mutex::default(),
                built: Condvar::new(),
                arrivals: Arrivals::default(),
            }),
        }
    }

    /// The process's name.
    #[must_use]
    pub fn process(&self) -> &str {
        &self.inner.process
    }

    /// The app's clock.
    #[inline]
    pub(crate) fn clock(&self) -> &Clock {
        &self.inner.clock
    }

    /// The app's time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.inner.clock.now()
    }

    /// Who watches.
    #[inline]
    pub(crate) fn watchers(&self) -> &Arc<Watchers> {
        &self.inner.watchers
    }

    /// Registers a class. A class that is registered again replaces the earlier one for objects built
    /// from now on.
    pub fn register(&self, class: Class) {
        let mut classes = self.inner.classes.write();
        classes.insert(class.name(), Arc::new(class));
    }

    /// All registered classes, by name.
    #[must_use]
    pub fn classes(&self) -> Vec<Arc<Class>> {
        self.inner.classes.read().values().cloned().collect()
    }

    /// What the codes of reports mean: of all classes, each with its class.
    #[must_use]
    pub fn prototypes(&self) -> Vec<(&'static str, Prototype)> {
        let mut prototypes = Vec::new();
        for class in self.inner.classes.read().values() {
            let own = class.prototypes().iter();
            prototypes.extend(own.map(|prototype| (class.name(), *prototype)));
        }
        prototypes
    }

    /// The names of all objects built so far, in alphabetical order.
    #[must_use]
    pub fn objects(&self) -> Vec<String> {
        self.inner.objects.read().keys().cloned().collect()
    }

    pub(crate) fn slots(&self) -> Vec<Arc<Slot>> {
        self.inner.objects.read().values().cloned().collect()
    }

    /// What an alias leads to.
    pub(crate) fn aliased(&self, alias: &str) -> Option<String> {
        self.inner.aliases.read().get(alias).cloned()
    }

    /// The object of that name if it is built already.
    pub(crate) fn find(&self, name: &str) -> Option<Arc<Slot>> {
        let aliased = self.aliased(name);
        let objects = self.inner.objects.read();
        objects.get(aliased.as_deref().unwrap_or(name)).cloned()
    }

    /// Adds an object that was built; earlier subscribers to its results go on with them.
    pub(crate) fn add(&self, slot: Arc<Slot>) {
        if let Some(results) = self.inner.results.lock().get(slot.name()) {
            slot.feed(results);
        }
        let mut objects = self.inner.objects.write();
        objects.insert(slot.name().to_owned(), slot);
    }

    /// Removes an object from the repository; its next use builds it anew. Says whether it was there.
    pub fn remove(&self, name: &str) -> bool {
        let removed = self.inner.objects.write().remove(name);
        // Its destructor is its own affair, outside the lock.
        removed.is_some()
    }

    /// From now on what CTRL changes is kept, beginning with what an earlier process has kept. An object that is built
    /// takes it after its recipe.
    pub fn keep(&self, kept: Kept) {
        *self.inner.kept.lock() = Some(kept);
    }

    /// What is kept; nothing before [`Self::keep`].
    #[must_use]
    pub fn kept(&self) -> Kept {
        self.inner.kept.lock().clone().unwrap_or_default()
    }

    /// Whether the changes of that object are kept: those of one that is being built are its recipe's.
    pub(crate) fn keeps(&self, slot: &Slot) -> bool {
        let is_it = |there: Arc<Slot>| std::ptr::eq(&raw const *there, slot);
        self.inner.kept.lock().is_some() && self.find(slot.name()).is_some_and(is_it)
    }

    /// Keeps the options of an object; `None`: begins afresh with its recipe.
    pub(crate) fn keep_options(&self, name: &str, options: Option<String>) {
        if let Some(kept) = &mut *self.inner.kept.lock() {
            match options {
                Some(options) => kept.insert(name.to_owned(), options),
                None => kept.remove(name),
            };
        }
    }

    /// The options that are kept of an object.
    pub(crate) fn kept_options(&self, name: &str) -> Option<String> {
        self.inner.kept.lock().as_ref()?.get(name).cloned()
    }

    /// Has `alias` lead to the object `name`.
    ///
    /// # Errors
    /// One of the two is no local name, or `alias` is an object, or leads on to itself.
    pub fn alias(&self, alias: &str, name: &str) -> Result<(), Report> {
        let local = |text: &str| -> Result<String, Report> {
            let parsed = parse(text)?;
            match parsed.location() {
                Location::Local | Location::Here => Ok(parsed.local()),
                _ => Err(raise!(
                    code::SYNTAX,
                    "`{text}`: an alias leads to an object of this process"
                )),
            }
        };
        let (alias, name) = (local(alias)?, local(name)?);
        if self.inner.objects.read().contains_key(&alias) {
            return Err(raise!(
                code::SYNTAX,
                "`{alias}` is an object; free it first, or take another alias"
            ));
        }
        let mut aliases = self.inner.aliases.write();
        if alias == name || aliases.contains_key(&name) || aliases.values().any(|to| *to == alias) {
            return Err(raise!(
                code::SYNTAX,
                "an alias leads to an object, and `{name}` or `{alias}` is an alias already"
            ));
        }
        aliases.insert(alias, name);
        Ok(())
    }

    /// Forgets an alias. Says whether there was one.
    pub fn unalias(&self, alias: &str) -> bool {
        self.inner.aliases.write().remove(alias).is_some()
    }

    /// All aliases with what they lead to.
    #[must_use]
    pub fn aliases(&self) -> Vec<(String, String)> {
        let aliases = self.inner.aliases.read();
        aliases
            .iter()
            .map(|(from, to)| (from.clone(), to.clone()))
            .collect()
    }

    /// Which process serves the name.
    pub(crate) fn place(&self, name: &ObjectName) -> Result<Place, Report> {
        let upper = name.class().to_ascii_uppercase();
        let (index, given) = match name.location() {
            Location::Local | Location::Here => return Ok(Place::Here),
            Location::Address { .. } => return Ok(Place::There(name.location().clone())),
            Location::Alias(alias) => (alias.as_str(), Some(name.location().clone())),
            Location::Default => (upper.as_str(), None),
        };
        let dictionary = self.inner.dictionary.read();
        let found = match dictionary.entry(index) {
            Some([word]) if word != TRADE => Location::parse(word),
            Some([first, wanted @ ..]) if first == TRADE => {
                return Wanted::read(index, wanted).map(Place::Traded);
            }
            _ => given,
        };
        match found {
            Some(Location::Here) => Ok(Place::Here),
            Some(at) => Ok(Place::There(at)),
            None => Err(raise!(
                code::DAEMON,
                "`{name}`: the dictionary names no daemon for `{index}`; \
                 add a line `{index} self`, `{index} ALIAS`, `{index} host:number` or `{index} trade`"
            )),
        }
    }

    /// Where the results of the object of that local name go.
    pub(crate) fn results(&self, name: &str) -> Arc<Results> {
        let mut results = self.inner.results.lock();
        if !results.contains_key(name) {
            // What neither an object nor a subscriber has is nobody's.
            results
                .retain(|_, results| Arc::strong_count(results) > 1 || results.subscribers() > 0);
        }
        Arc::clone(results.entry(name.to_owned()).or_default())
    }

    /// Notes that an object of another daemon is in use here.
    pub(crate) fn used(&self, at: &Location, name: &ObjectName) {
        let mut proxies = self.inner.proxies.lock();
        let names = proxies.entry(at.clone()).or_default();
        if !names.contains(name) {
            names.insert(name.clone());
        }
    }

    /// The objects of other daemons that were asked from here, by daemon.
    #[must_use]
    pub fn proxies(&self) -> BTreeMap<Location, BTreeSet<ObjectName>> {
        self.inner.proxies.lock().clone()
    }

    /// Answers in place of an object that cannot be reached.
    pub(crate) fn refuse(&self, body: &mut Transport, mut report: Report) {
        body.clear();
        if report.process.is_empty() {
            self.process().clone_into(&mut report.process);
            report.time_ns = self.now().as_nanos();
        }
        body.report(report);
    }

    /// Answers in place of an object that gave no answer.
    pub(crate) fn unanswered(&self, name: &ObjectName, body: &mut Transport, mut report: Report) {
        if report.object.is_empty() {
            report.object = name.to_string();
        }
        self.refuse(body, report);
    }

    pub(crate) fn class(&self, name: &ObjectName) -> Result<Arc<Class>, Report> {
        let classes = self.inner.classes.read();
        classes.get(name.class()).cloned().ok_or_else(|| {
            let hint = suggestion(name.class(), classes.keys().copied());
            raise!(
                code::UNKNOWN_CLASS,
                "`{name}`: there is no class `{}`{hint}",
                name.class()
            )
        })
    }
}

pub(crate) fn parse(name: &str) -> Result<ObjectName, Report> {
    name.parse()
        .map_err(|error| raise!(code::SYNTAX, "no name: {error}"))
}
