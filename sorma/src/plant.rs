//! The plant: builds an object from its name (SORMA technical report, section 1.5).

use crate::class::Class;
use crate::dbx::Meta;
use crate::name::{ObjectName, suggestion};
use crate::raise;
use crate::report::{Report, code};
use crate::slot::{Owned, Slot};
use crate::sorm::Sorm;
use crate::transport::Transport;
use crate::words;
use std::cell::RefCell;
use std::sync::Arc;

impl Sorm {
    /// Builds an object that stands in no repository: for whoever asks alone, as a part of its own.
    ///
    /// # Errors
    /// As [`Sorm::get`].
    pub fn private(&self, name: &str) -> Result<Owned, Report> {
        let name: ObjectName = name
            .parse()
            .map_err(|error| raise!(code::SYNTAX, "no name: {error}"))?;
        let building = self.inner.building.lock();
        self.build(&name, &building).map(Owned::new)
    }

    /// Builds the object: the class makes it, it takes its recipe, it tests itself.
    pub(crate) fn build(
        &self,
        name: &ObjectName,
        building: &RefCell<Vec<String>>,
    ) -> Result<Slot, Report> {
        let local = name.local();
        if building.borrow().contains(&local) {
            let chain = building.borrow().join(" -> ");
            return Err(raise!(
                code::RECIPE,
                "objects need each other to be built: {chain} -> {local}"
            ));
        }
        building.borrow_mut().push(local);
        let built = self.build_one(name);
        building.borrow_mut().pop();
        built
    }

    fn build_one(&self, name: &ObjectName) -> Result<Slot, Report> {
        let class = self.class(name)?;
        let local = name.local();
        let recipe = self.inner.dictionary.read().recipe(&local)?;
        if recipe.is_none() && name.flavor().is_some() && !class.takes_any_flavor() {
            return Err(self.unknown_flavor(name));
        }
        let slot = self.bare(name, &class, local)?;
        if let Some(recipe) = recipe {
            self.cook(&slot, &recipe)?;
        }
        self.test(&slot)?;
        Ok(slot)
    }

    fn bare(&self, name: &ObjectName, class: &Arc<Class>, local: String) -> Result<Slot, Report> {
        let object = class.build(name, self)?;
        Ok(Slot::new(local, object, Meta::new(Arc::clone(class))))
    }

    /// Has the object take its recipe.
    fn cook(&self, slot: &Slot, recipe: &[String]) -> Result<(), Report> {
        let recipe = words::join(recipe.iter().map(String::as_str));
        let io = self.ctrl_text(slot, &recipe);
        if io.is_ok() {
            return Ok(());
        }
        let name = slot.name();
        let why = texts(&io);
        Err(raise!(
            io.code,
            "`{name}` does not take its recipe `{recipe}`: {why}"
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
        let (name, why) = (slot.name(), texts(&io));
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

fn texts(io: &Transport) -> String {
    let texts = io.reports.iter().map(|report| report.text.as_str());
    texts.collect::<Vec<_>>().join("; ")
}
