//! The manager with the classes that every process has: `dict`, `sorm` and `watch`.

use crate::class::Class;
use crate::description::ClassInfo;
use crate::dictionary::Dictionary;
use crate::dictionary::object::{self as dict, DictionaryObject};
use crate::manager::{self, ManagerObject};
use crate::report::code;
use crate::sorm::Sorm;
use crate::watching::object::{self as watch, Watch};
use ctos::time::Clock;
use std::sync::Arc;

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
        let sorm = Self::bare(process, clock, dictionary);
        let version = env!("CARGO_PKG_VERSION");
        let dict = Class::new("dict", version, |_, sorm| {
            let dictionary = Arc::clone(&sorm.inner.dictionary);
            Ok(Box::new(DictionaryObject::of(dictionary)))
        });
        sorm.register(dict.described(dict::class()));
        let manager = Class::new("sorm", version, |_, _| Ok(Box::new(ManagerObject)));
        let manager = manager.described(manager::class());
        sorm.register(manager.codes(code::PROTOTYPES));
        let watch = Class::new("watch", version, |_, sorm| {
            Ok(Box::new(Watch::new(sorm.watchers())))
        });
        sorm.register(watch.described(watch::class()).waits().any_flavor());
        sorm
    }
}

/// The classes that every manager has: `dict`, `sorm` and `watch`.
#[must_use]
pub fn own_classes() -> Vec<ClassInfo> {
    vec![dict::class(), manager::class(), watch::class()]
}
