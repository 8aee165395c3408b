//! The plant: finds an object by its name, or builds it (SORMA technical report, section 1.5).

use crate::name::{ObjectName, suggestion};
use crate::object::Slot;
use crate::raise;
use crate::report::{Report, code};
use crate::request::Method;
use crate::slot::{Handle, Owned, PATIENCE};
use crate::sorm::{Building, Place, Sorm, parse};
use crate::transport::Transport;
use crate::words;
use std::sync::Arc;
use std::thread::ThreadId;

/// An object is being built, by a thread, until this is dropped.
struct Begun<'s>(&'s Sorm, String, ThreadId);

impl Drop for Begun<'_> {
    fn drop(&mut self) {
        let Self(sorm, name, by) = self;
        let mut all = sorm.inner.building.lock();
        let place = all
            .iter()
            .rposition(|one| one.name == *name && one.by == *by);
        if let Some(place) = place {
            all.remove(place);
        }
        sorm.inner.built.notify_all();
    }
}

impl Sorm {
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
        match self.aliased(&local) {
            Some(to) => self.first_use(&parse(&to)?),
            None => self.first_use(name),
        }
    }

    fn first_use(&self, name: &ObjectName) -> Result<Handle, Report> {
        let local = name.local();
        let mut all = self.inner.building.lock();
        let is_elsewhere =
            |one: &Building| one.name == local && one.by != std::thread::current().id();
        while all.iter().any(is_elsewhere) {
            if self.inner.built.wait_for(&mut all, PATIENCE).timed_out() {
                drop(all);
                return Err(self.in_the_making(&local));
            }
        }
        // Another thread may have built it meanwhile.
        if let Some(slot) = self.find(&local) {
            return Ok(Handle { slot });
        }
        let begun = self.begin(local, &mut all)?;
        drop(all);
        let slot = Arc::new(self.build_one(name)?);
        self.add(Arc::clone(&slot));
        drop(begun);
        Ok(Handle { slot })
    }

    /// The report to a caller that no longer waits for an object which is being built for another
    /// caller.
    pub(crate) fn in_the_making(&self, local: &str) -> Report {
        let all = self.inner.building.lock();
        let since = all.iter().find(|one| one.name == local);
        let time = since.map_or(0.0, |one| self.now().since(one.since).as_secs_f64());
        raise!(
            code::BUSY,
            "`{local}` has been in the making for {time:.1} s; ask again when it is built, or `ctos restart {}` ends that",
            self.process()
        )
    }

    /// Builds an object that stands in no repository: for the caller alone, as a part of its own.
    ///
    /// # Errors
    /// As [`Sorm::get`].
    pub fn private(&self, name: &str) -> Result<Owned, Report> {
        let name = parse(name)?;
        let begun = self.begin(name.local(), &mut self.inner.building.lock())?;
        let built = self.build_one(&name).map(Owned::new);
        drop(begun);
        built
    }

    /// Notes that this thread builds an object from now on.
    fn begin(&self, local: String, all: &mut Vec<Building>) -> Result<Begun<'_>, Report> {
        let by = std::thread::current().id();
        let chain = all.iter().filter(|one| one.by == by);
        let chain: Vec<&str> = chain.map(|one| &*one.name).collect();
        if chain.contains(&&*local) {
            let chain = chain.join(" -> ");
            return Err(raise!(
                code::RECIPE,
                "objects need each other to be built: {chain} -> {local}"
            ));
        }
        all.push(Building {
            name: local.clone(),
            by,
            since: self.now(),
        });
        Ok(Begun(self, local, by))
    }

    /// Builds the object: the class makes it, it takes its recipe, it tests itself.
    fn build_one(&self, name: &ObjectName) -> Result<Slot, Report> {
        let class = self.class(name)?;
        let local = name.local();
        let recipe = self.inner.dictionary.read().recipe(&local)?;
        if recipe.is_none() && name.flavor().is_some() && !class.takes_any_flavor() {
            return Err(self.unknown_flavor(name));
        }
        let slot = Slot::new(local.clone(), class.build(name, self)?, class);
        if let Some(recipe) = recipe {
            let recipe = words::join(recipe.iter().map(String::as_str));
            self.cook(&slot, "recipe", &recipe)?;
        }
        if let Some(options) = self.kept_options(slot.name()) {
            let taken = self.cook(&slot, "kept options", &options);
            taken.map_err(|report| {
                let text = format!("{}; `sorm CTRL -free {local}` begins afresh", report.text);
                Report::error(report.code, text)
            })?;
        }
        self.test(&slot)?;
        Ok(slot)
    }

    /// Has the object take its recipe, or what was kept of it.
    fn cook(&self, slot: &Slot, what: &str, options: &str) -> Result<(), Report> {
        let mut io = Transport::text(options);
        slot.call_unseen(self, None, Method::Ctrl, &mut io);
        if io.is_ok() {
            return Ok(());
        }
        let name = slot.name();
        let why = io.texts();
        Err(raise!(
            io.code,
            "`{name}` does not take its {what} `{options}`: {why}"
        ))
    }

    fn test(&self, slot: &Slot) -> Result<(), Report> {
        let mut io = Transport::default();
        let mut body = slot.lock(None)?;
        slot.with_reports(&mut body, self, None, &mut io, |body, cx, _| {
            body.object.self_test(cx)
        });
        if io.is_ok() {
            return Ok(());
        }
        let (name, why) = (slot.name(), io.texts());
        Err(raise!(
            code::SELF_TEST,
            "`{name}` does not pass its self-test: {why}"
        ))
    }

    fn unknown_flavor(&self, name: &ObjectName) -> Report {
        let dictionary = self.inner.dictionary.read();
        let prefix = format!("{}.", name.class());
        let known = dictionary
            .index()
            .filter(|index| index.starts_with(&prefix));
        let local = name.local();
        let hint = suggestion(&local, known);
        raise!(
            code::UNKNOWN_FLAVOR,
            "the dictionary has no recipe for `{local}`{hint}"
        )
    }
}
