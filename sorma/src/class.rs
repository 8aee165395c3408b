//! A class: how its objects are built, and what is known about all of them.

use crate::name::ObjectName;
use crate::object::ServiceObject;
use crate::report::{Prototype, Report};
use crate::sorm::Sorm;

type Build = dyn Fn(&ObjectName, &Sorm) -> Result<Box<dyn ServiceObject>, Report> + Send + Sync;

/// A class of service objects, as it is registered with [`Sorm::register`].
pub struct Class {
    name: &'static str,
    version: &'static str,
    build: Box<Build>,
    codes: &'static [Prototype],
    waits: bool,
}

impl Class {
    /// A class with its lower-case name, its version, and what makes an object of it; the recipe is
    /// given to that object's own CTRL afterwards.
    pub fn new(
        name: &'static str,
        version: &'static str,
        build: impl Fn(&ObjectName, &Sorm) -> Result<Box<dyn ServiceObject>, Report>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self {
            name,
            version,
            build: Box::new(build),
            codes: &[],
            waits: false,
        }
    }

    /// With the prototypes of its reports.
    #[must_use]
    pub fn codes(mut self, codes: &'static [Prototype]) -> Self {
        self.codes = codes;
        self
    }

    /// With objects that ask others and wait for them:
    /// [`ServiceObject::exec_waiting`]. They are asked with [`Sorm::ask`].
    #[must_use]
    pub fn waits(mut self) -> Self {
        self.waits = true;
        self
    }

    pub(crate) fn is_waiting(&self) -> bool {
        self.waits
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Its version.
    #[must_use]
    pub fn version(&self) -> &'static str {
        self.version
    }

    /// What its reports mean.
    #[must_use]
    pub fn prototypes(&self) -> &'static [Prototype] {
        self.codes
    }

    pub(crate) fn build(
        &self,
        name: &ObjectName,
        sorm: &Sorm,
    ) -> Result<Box<dyn ServiceObject>, Report> {
        (self.build)(name, sorm)
    }
}

impl std::fmt::Debug for Class {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Class({} {})", self.name, self.version)
    }
}
