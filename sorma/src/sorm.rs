//! The service object request manager (SORM): keeps objects by their names, has them built on first
//! use, and passes requests to them (SORMA technical report, sections 1.4.2 and 1.5).
//!
//! One process, any thread; an object is called by reference at the cost of a virtual call.

use crate::class::Class;
use crate::comm::{Alone, Comm};
use crate::dictionary::{Dictionary, DictionaryObject};
use crate::manager::ManagerObject;
use crate::name::{Location, ObjectName, suggestion};
use crate::raise;
use crate::report::{Prototype, Report, code};
use crate::request::{Method, Reply, Request, RequestError};
use crate::results::Results;
use crate::slot::{Handle, Slot};
use crate::trade::{Market, Wanted};
use crate::transport::Transport;
use crate::watching::{Trace, Watch, Watchers};
use crate::words;
use ctos::time::{Clock, Instant};
use futures_util::FutureExt as _;
use parking_lot::{Mutex, ReentrantMutex, RwLock};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

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
    /// Objects being built now, outermost first: by one thread at a time.
    pub(crate) building: ReentrantMutex<RefCell<Vec<String>>>,
}

/// Which process serves an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Place {
    Here,
    There(Location),
    /// Whoever offers the class best.
    Traded(Wanted),
}

impl std::fmt::Debug for Sorm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let objects = self.inner.objects.read().len();
        write!(f, "Sorm({}, {objects} objects)", self.inner.process)
    }
}

impl Sorm {
    /// A manager that knows the classes `dict` and `sorm`, and one dictionary, which objects are built
    /// from. It has no name and a real clock.
    #[must_use]
    pub fn new(dictionary: Dictionary) -> Self {
        Self::of("", Clock::real(), dictionary)
    }

    /// The manager of the process of that name, which stands in its reports, on the app's clock.
    #[must_use]
    pub fn of(process: &str, clock: Clock, dictionary: Dictionary) -> Self {
        let dictionary = Arc::new(RwLock::new(dictionary));
        let sorm = Self {
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
                dictionary: Arc::clone(&dictionary),
                building: ReentrantMutex::default(),
            }),
        };
        let version = env!("CARGO_PKG_VERSION");
        let dict = Class::new("dict", version, move |_, _| {
            Ok(Box::new(DictionaryObject::of(Arc::clone(&dictionary))))
        });
        sorm.register(dict.described(crate::dictionary::class()));
        let manager = Class::new("sorm", version, |_, _| Ok(Box::new(ManagerObject)));
        let manager = manager.described(crate::manager::class());
        sorm.register(manager.codes(code::PROTOTYPES));
        let watch = Class::new("watch", version, |_, sorm| {
            Ok(Box::new(Watch::new(sorm.watchers())))
        });
        let watch = watch.described(crate::watching::class());
        sorm.register(watch.waits().any_flavor());
        sorm
    }

    /// The process's name.
    #[must_use]
    pub fn process(&self) -> &str {
        &self.inner.process
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
        let of_class = |class: &Arc<Class>| {
            let name = class.name();
            class
                .prototypes()
                .iter()
                .map(move |prototype| (name, *prototype))
        };
        self.inner
            .classes
            .read()
            .values()
            .flat_map(of_class)
            .collect()
    }

    /// The names of all objects built so far, in alphabetical order.
    #[must_use]
    pub fn objects(&self) -> Vec<String> {
        self.inner.objects.read().keys().cloned().collect()
    }

    pub(crate) fn slots(&self) -> Vec<Arc<Slot>> {
        self.inner.objects.read().values().cloned().collect()
    }

    /// The object of that name if it is built already.
    pub(crate) fn find(&self, name: &str) -> Option<Arc<Slot>> {
        let name = self
            .inner
            .aliases
            .read()
            .get(name)
            .cloned()
            .unwrap_or_else(|| name.to_owned());
        self.inner.objects.read().get(&name).cloned()
    }

    /// Removes an object from the repository; its next use builds it anew. Says whether it was there.
    pub fn remove(&self, name: &str) -> bool {
        let removed = self.inner.objects.write().remove(name);
        // Its destructor is its own affair, outside the lock.
        removed.is_some()
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

    /// The object of that name. The first use builds it: the class makes an object, whose own CTRL
    /// then takes the recipe that the dictionary has for the name.
    ///
    /// # Errors
    /// No name, no such class, no such flavor, a recipe that its class does not take, a daemon that
    /// cannot be reached from here.
    pub fn get(&self, name: &str) -> Result<Handle, Report> {
        self.resolve(&parse(name)?)
    }

    /// The object of that name in this process.
    pub(crate) fn resolve(&self, name: &ObjectName) -> Result<Handle, Report> {
        if self.place(name)? != Place::Here {
            return Err(raise!(
                code::DAEMON,
                "`{name}` is served by another daemon: it is asked with `Sorm::ask`, over a link"
            ));
        }
        let local = name.local();
        if let Some(slot) = self.find(&local) {
            return Ok(Handle { slot });
        }
        let aliased = self.inner.aliases.read().get(&local).cloned();
        match aliased {
            Some(to) => self.first_use(&parse(&to)?),
            None => self.first_use(name),
        }
    }

    fn first_use(&self, name: &ObjectName) -> Result<Handle, Report> {
        let building = self.inner.building.lock();
        // Another thread may have built it meanwhile.
        if let Some(slot) = self.find(&name.local()) {
            return Ok(Handle { slot });
        }
        let slot = Arc::new(self.build(name, &building)?);
        if let Some(results) = self.inner.results.lock().get(slot.name()) {
            slot.feed(results);
        }
        let mut objects = self.inner.objects.write();
        objects.insert(slot.name().to_owned(), Arc::clone(&slot));
        Ok(Handle { slot })
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

    /// Passes a request to its object; the reply always comes, errors, panics and all.
    #[must_use]
    pub fn request(&self, request: Request) -> Reply {
        let Request {
            name,
            method,
            mut body,
        } = request;
        match self.resolve(&name) {
            Ok(handle) if handle.slot.waits() && method == Method::Exec => {
                return self.request_alone(Request { name, method, body });
            }
            Ok(handle) => {
                if handle.slot.call_contained(self, method, &mut body) {
                    // Nobody knows what state it is in.
                    self.remove(handle.name());
                }
            }
            Err(report) => self.refuse(&mut body, report),
        }
        Reply { name, body }
    }

    /// A request to an object that may wait for others, as far as nobody has to be waited for.
    fn request_alone(&self, request: Request) -> Reply {
        let (name, from) = (request.name.clone(), request.body.from.clone());
        self.ask(&Alone, request).now_or_never().unwrap_or_else(|| {
            let mut body = Transport::default().from(from);
            let report = raise!(
                code::UNSUPPORTED,
                "`{name}` asks other objects and waits for them: it is asked with `Sorm::ask`, in an app that runs"
            );
            self.refuse(&mut body, report);
            Reply { name, body }
        })
    }

    /// One line of text in, one line of text out. A line that is no request is answered in the name
    /// of `sorm`.
    #[must_use]
    pub fn dispatch(&self, line: &str) -> String {
        self.dispatch_from(line, "")
    }

    /// [`Self::dispatch`] for the caller `from`, whose locks count.
    #[must_use]
    pub fn dispatch_from(&self, line: &str, from: &str) -> String {
        match read(line, from) {
            Ok(request) => write(&self.request(request)),
            Err(answer) => answer,
        }
    }

    /// [`Self::dispatch_from`] for whatever may wait, or be met by another daemon.
    pub async fn tell(&self, comm: &dyn Comm, line: &str, from: &str) -> String {
        self.tell_traced(comm, line, from, Trace::default()).await
    }

    /// [`Self::tell`] for a request that is followed through all that it leads to.
    pub async fn tell_traced(
        &self,
        comm: &dyn Comm,
        line: &str,
        from: &str,
        trace: Trace,
    ) -> String {
        match read(line, from) {
            Ok(mut request) => {
                request.body.trace = trace;
                write(&self.ask(comm, request).await)
            }
            Err(answer) => answer,
        }
    }

    /// Ends all locks of callers that are gone, aborts what is prepared for them, and has the objects give back
    /// what they keep for them. Answers whether that was all: an object that is in a call now is to be asked
    /// again.
    pub fn release(&self, gone: impl Fn(&str) -> bool) -> bool {
        let mut is_all = true;
        for slot in self.slots() {
            let Some(mut body) = slot.try_lock() else {
                is_all = false;
                continue;
            };
            let reserved = body.reserved.as_ref();
            if reserved.is_some_and(|reserved| gone(reserved.by())) {
                slot.let_go(&mut body, self);
            }
            if body.object.forget(&gone) {
                drop(body);
                self.remove(slot.name());
            }
        }
        is_all
    }

    /// Asks an object by name for something that is not one of its methods.
    pub(crate) fn ctrl_text(&self, slot: &Slot, text: &str) -> Transport {
        let mut io = Transport::text(text);
        slot.call_unseen(self, None, Method::Ctrl, &mut io);
        io
    }
}

/// Reads a request, or answers that it is none.
fn read(line: &str, from: &str) -> Result<Request, String> {
    let mut request: Request = line
        .parse()
        .map_err(|error: RequestError| refusal("sorm", &error))?;
    from.clone_into(&mut request.body.from);
    Ok(request)
}

fn write(reply: &Reply) -> String {
    reply
        .to_text()
        .unwrap_or_else(|error| refusal(&reply.name.to_string(), &error))
}

fn refusal(name: &str, error: &RequestError) -> String {
    let report = Report::error(code::SYNTAX, error.to_string());
    let text = words::quoted(&report.to_line());
    format!("{name} RET {} TDBX {text}", report.code)
}

fn parse(name: &str) -> Result<ObjectName, Report> {
    name.parse()
        .map_err(|error| raise!(code::SYNTAX, "no name: {error}"))
}
