//! The service object request manager (SORM): builds objects from their names on first use, keeps
//! them, and passes requests to them (SORMA technical report, sections 1.4.2 and 1.5).
//!
//! One process and one thread; an object is called by reference at the cost of a virtual call.

use crate::dictionary::{self, Dictionary};
use crate::name::{Location, ObjectName, suggestion};
use crate::object::{Context, Meta, Outcome, ServiceObject, unsupported};
use crate::report::{Report, code};
use crate::request::{Method, Reply, Request};
use crate::transport::Transport;
use crate::words;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

type Build = dyn Fn(&ObjectName, &Sorm) -> Result<Box<dyn ServiceObject>, Report>;

/// A registered class.
struct Class {
    version: &'static str,
    build: Rc<Build>,
}

/// The manager of one process's service objects.
pub struct Sorm {
    classes: RefCell<BTreeMap<&'static str, Class>>,
    objects: RefCell<BTreeMap<String, Rc<Slot>>>,
    dictionary: Rc<RefCell<Dictionary>>,
    /// Objects being built now, outermost first.
    building: RefCell<Vec<String>>,
}

/// An object in the repository.
struct Slot {
    name: String,
    object: RefCell<Box<dyn ServiceObject>>,
    meta: RefCell<Meta>,
}

/// A reference to an object; it stays usable after the object was removed from the repository.
#[derive(Clone)]
pub struct Handle {
    slot: Rc<Slot>,
}

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Handle({})", self.slot.name)
    }
}

impl Sorm {
    /// A manager that knows the class `dict` and one dictionary, which objects are built from.
    #[must_use]
    pub fn new(dictionary: Dictionary) -> Self {
        let dictionary = Rc::new(RefCell::new(dictionary));
        let sorm = Self {
            classes: RefCell::default(),
            objects: RefCell::default(),
            dictionary: Rc::clone(&dictionary),
            building: RefCell::default(),
        };
        sorm.register("dict", env!("CARGO_PKG_VERSION"), move |_, _| {
            let dictionary = Rc::clone(&dictionary);
            Ok(Box::new(DictionaryObject { dictionary }))
        });
        sorm
    }

    /// Registers a class under its lower-case name. A class that is registered again replaces the
    /// earlier one for objects built from now on.
    pub fn register(
        &self,
        class: &'static str,
        version: &'static str,
        build: impl Fn(&ObjectName, &Self) -> Result<Box<dyn ServiceObject>, Report> + 'static,
    ) {
        let build: Rc<Build> = Rc::new(build);
        self.classes
            .borrow_mut()
            .insert(class, Class { version, build });
    }

    /// The names of all registered classes.
    #[must_use]
    pub fn classes(&self) -> Vec<&'static str> {
        self.classes.borrow().keys().copied().collect()
    }

    /// The names of all objects built so far.
    #[must_use]
    pub fn objects(&self) -> Vec<String> {
        self.objects.borrow().keys().cloned().collect()
    }

    /// Removes an object from the repository; its next use builds it anew. Says whether it was there.
    pub fn remove(&self, name: &str) -> bool {
        self.objects.borrow_mut().remove(name).is_some()
    }

    /// The object of that name. The first use builds it: the class makes an object, whose own CTRL
    /// then takes the recipe that the dictionary has for the name.
    ///
    /// # Errors
    /// No name, no such class, no such flavor, a recipe that its class does not take, a daemon that
    /// cannot be reached from here.
    pub fn get(&self, name: &str) -> Result<Handle, Report> {
        let name: ObjectName = name
            .parse()
            .map_err(|error| Report::error(code::SYNTAX, format!("no name: {error}")))?;
        self.resolve(&name)
    }

    fn resolve(&self, name: &ObjectName) -> Result<Handle, Report> {
        self.check_location(name)?;
        let local = name.local();
        if let Some(slot) = self.objects.borrow().get(&local) {
            let slot = Rc::clone(slot);
            return Ok(Handle { slot });
        }
        if self.building.borrow().contains(&local) {
            let chain = self.building.borrow().join(" -> ");
            let text = format!("objects need each other to be built: {chain} -> {local}");
            return Err(Report::error(code::RECIPE, text));
        }
        self.building.borrow_mut().push(local);
        let built = self.build(name);
        self.building.borrow_mut().pop();
        let slot = Rc::new(built?);
        let kept = Rc::clone(&slot);
        self.objects.borrow_mut().insert(slot.name.clone(), kept);
        Ok(Handle { slot })
    }

    /// Whether the name is served by this process.
    fn check_location(&self, name: &ObjectName) -> Result<(), Report> {
        let upper = name.class().to_ascii_uppercase();
        let (index, given) = match name.location() {
            Location::Local | Location::Here => return Ok(()),
            Location::Address { .. } => (None, name.location().clone()),
            Location::Alias(alias) => (Some(alias.as_str()), name.location().clone()),
            Location::Default => (Some(upper.as_str()), name.location().clone()),
        };
        let dictionary = self.dictionary.borrow();
        let found = match index.map(|index| (index, dictionary.entry(index))) {
            None => given,
            Some((_, Some([word]))) => Location::parse(word).unwrap_or(given),
            Some((index, _)) => {
                let text = format!(
                    "`{name}`: the dictionary names no daemon for `{index}`; \
                     add a line `{index} self` or `{index} host:number`"
                );
                return Err(Report::error(code::DAEMON, text));
            }
        };
        match found {
            Location::Here => Ok(()),
            _ => {
                let text = format!(
                    "`{name}` is served by another daemon, and this process has no link to it"
                );
                Err(Report::error(code::DAEMON, text))
            }
        }
    }

    fn build(&self, name: &ObjectName) -> Result<Slot, Report> {
        let (version, build) = self.class(name)?;
        let local = name.local();
        let recipe = self.dictionary.borrow().recipe(&local)?;
        if recipe.is_none() && name.flavor().is_some() {
            return Err(self.unknown_flavor(name));
        }
        let slot = Slot {
            object: RefCell::new(build(name, self)?),
            meta: RefCell::new(Meta::new(name.class(), version)),
            name: local,
        };
        let Some(recipe) = recipe else {
            return Ok(slot);
        };
        let recipe = words::join(recipe.iter().map(String::as_str));
        let mut io = Transport::text(recipe.as_str());
        slot.call(self, Method::Ctrl, &mut io);
        if io.is_ok() {
            return Ok(slot);
        }
        let why: Vec<&str> = io
            .reports
            .iter()
            .map(|report| report.text.as_str())
            .collect();
        let name = &slot.name;
        let text = format!(
            "`{name}` does not take its recipe `{recipe}`: {}",
            why.join("; ")
        );
        Err(Report::error(io.code, text))
    }

    fn class(&self, name: &ObjectName) -> Result<(&'static str, Rc<Build>), Report> {
        let classes = self.classes.borrow();
        match classes.get(name.class()) {
            Some(class) => Ok((class.version, Rc::clone(&class.build))),
            None => {
                let hint = suggestion(name.class(), classes.keys().copied());
                let text = format!("`{name}`: there is no class `{}`{hint}", name.class());
                Err(Report::error(code::UNKNOWN_CLASS, text))
            }
        }
    }

    fn unknown_flavor(&self, name: &ObjectName) -> Report {
        let dictionary = self.dictionary.borrow();
        let prefix = format!("{}.", name.class());
        let known = dictionary
            .index()
            .filter(|index| index.starts_with(&prefix));
        let local = name.local();
        let hint = suggestion(&local, known);
        let text = format!("the dictionary has no recipe for `{local}`{hint}");
        Report::error(code::UNKNOWN_FLAVOR, text)
    }

    /// Passes a request to its object; the reply always comes, errors and all.
    #[must_use]
    pub fn request(&self, request: Request) -> Reply {
        let Request {
            name,
            method,
            mut body,
        } = request;
        match self.resolve(&name) {
            Ok(handle) => handle.call(self, method, &mut body),
            Err(report) => {
                body.clear();
                body.report(report);
            }
        }
        Reply { name, body }
    }

    /// One line of text in, one line of text out. A line that is no request is answered in the name
    /// of `sorm`.
    #[must_use]
    pub fn dispatch(&self, line: &str) -> String {
        let refused = |text: String, name: Option<ObjectName>| {
            let mut body = Transport::default();
            body.report(Report::error(code::SYNTAX, text));
            let name = name.map_or_else(|| "sorm".to_owned(), |name| name.to_string());
            let report = body.reports.iter().map(Report::to_line).collect::<String>();
            format!("{name} RET {} TDBX {}", body.code, words::quoted(&report))
        };
        let request: Request = match line.parse() {
            Ok(request) => request,
            Err(error) => return refused(error.to_string(), None),
        };
        let reply = self.request(request);
        match reply.to_text() {
            Ok(text) => text,
            Err(error) => refused(error.to_string(), Some(reply.name)),
        }
    }
}

impl Handle {
    /// The object's full local name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.slot.name
    }

    /// Calls a method by reference. Results and reports are in `io`; its code is 0 when all went well.
    pub fn call(&self, sorm: &Sorm, method: Method, io: &mut Transport) {
        self.slot.call(sorm, method, io);
    }

    /// All data inside the object, as text; `None` while the object is in a call.
    #[must_use]
    pub fn dump(&self) -> Option<String> {
        self.slot
            .object
            .try_borrow()
            .ok()
            .map(|object| object.dump())
    }
}

impl Slot {
    fn call(&self, sorm: &Sorm, method: Method, io: &mut Transport) {
        io.code = 0;
        let before = io.reports.len();
        let Ok(mut object) = self.object.try_borrow_mut() else {
            let text = format!(
                "`{}` is in a call already: it was called by itself, directly or not",
                self.name
            );
            io.report(self.signed(Report::error(code::BUSY, text)));
            return;
        };
        let cx = Context {
            sorm,
            name: &self.name,
            meta: &self.meta,
        };
        let outcome = match method {
            Method::Exec => object.exec(&cx, io),
            Method::Ctrl => {
                let asked = io.text.clone();
                let outcome = object.ctrl(&cx, io);
                let code = outcome.as_ref().err().map_or(io.code, |report| report.code);
                self.meta.borrow_mut().audited(&asked, code);
                outcome
            }
            Method::Dbx => object.dbx(&cx, io),
        };
        if let Err(report) = outcome {
            io.report(report);
        }
        let meta = self.meta.borrow();
        let own = io.reports.split_off(before.min(io.reports.len()));
        let own = own.into_iter().filter(|report| meta.passes(report));
        io.reports.extend(own.map(|report| self.signed(report)));
    }

    /// The report with this object's name, unless a sub-service has put its own.
    fn signed(&self, mut report: Report) -> Report {
        if report.object.is_empty() {
            report.object.clone_from(&self.name);
        }
        report
    }
}

/// The dictionary as a service object.
struct DictionaryObject {
    dictionary: Rc<RefCell<Dictionary>>,
}

impl ServiceObject for DictionaryObject {
    fn exec(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Err(unsupported(Method::Exec))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        dictionary::OPTIONS.ctrl(&mut self.dictionary.borrow_mut(), io);
        Ok(())
    }

    fn dump(&self) -> String {
        let dictionary = self.dictionary.borrow();
        let lines = dictionary.index().map(|index| {
            let words = dictionary.entry(index).unwrap_or_default();
            words::join(std::iter::once(index).chain(words.iter().map(String::as_str)))
        });
        lines.collect::<Vec<_>>().join("\n")
    }
}
