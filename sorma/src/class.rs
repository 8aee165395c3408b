//! A class: how its objects are built, and what is known about all of them.

use crate::description::ClassInfo;
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
    any_flavor: bool,
    info: Option<ClassInfo>,
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
            any_flavor: false,
            info: None,
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

    /// With flavors that need no recipe, because the flavor itself says what is meant: the queue of that
    /// name. A recipe is taken where there is one.
    #[must_use]
    pub fn any_flavor(mut self) -> Self {
        self.any_flavor = true;
        self
    }

    pub(crate) fn takes_any_flavor(&self) -> bool {
        self.any_flavor
    }

    /// With what a program may know about it, so that inspectors and panels in other processes can ask for it.
    #[must_use]
    pub fn described(mut self, info: ClassInfo) -> Self {
        self.info = Some(info);
        self
    }

    /// What a program may know about it, if it was said.
    #[must_use]
    pub fn info(&self) -> Option<&ClassInfo> {
        self.info.as_ref()
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
