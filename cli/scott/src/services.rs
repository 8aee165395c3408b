//! The service objects that `scott --local` carries itself: every class of the workspace.

use std::{path::PathBuf, sync::LazyLock};

use ctos::{
    diagnostic::{Finding, Findings, Source},
    time::Clock,
};
use sorma::ipc::{self, Host};
use sorma::{ClassInfo, Dictionary, Sorm, asynchronous, demo, describe, sound};

/// What a program may know about all classes, by name.
pub static CLASSES: LazyLock<Vec<ClassInfo>> = LazyLock::new(|| {
    let mut classes = describe::own_classes();
    classes.extend(asynchronous::classes());
    classes.extend(demo::classes());
    classes.extend(ipc::classes());
    classes.extend(sound::classes());
    classes.extend(mcs::services::classes());
    classes.extend(mcs_hand::services::classes());
    classes.extend(mcs_path::services::classes());
    classes.extend(vss::services::classes());
    classes.extend(coordinators::services::classes());
    classes.extend(bridge_program::classes());
    classes.sort_by(|a, b| a.name.cmp(&b.name));
    classes
});

/// The dictionaries that are shipped with the classes.
const SHIPPED: &[(&str, &str)] = &[
    ("the demo classes' dictionary", demo::DICTIONARY),
    ("the dictionary of sound", sound::DICTIONARY),
    ("the arm's dictionary", mcs::services::DICTIONARY),
    ("the hand's dictionary", mcs_hand::services::DICTIONARY),
    ("the dictionary of paths", mcs_path::services::DICTIONARY),
    (
        "the dictionary of tasks",
        coordinators::services::DICTIONARY,
    ),
];

/// A manager with all classes, the shipped dictionary, and the given files over it.
///
/// # Errors
/// What is wrong with the files.
pub fn manager(files: &[PathBuf]) -> Result<Sorm, Findings> {
    let mut dictionary = shipped()?;
    for file in files {
        let source = Source::read(file).map_err(of_one)?;
        dictionary.load(&source)?;
    }
    let sorm = Sorm::new(dictionary);
    register(&sorm, &Host::new("scott", Clock::real()));
    Ok(sorm)
}

/// The dictionary that is shipped with the classes.
///
/// # Errors
/// None; a test reads it.
pub fn shipped() -> Result<Dictionary, Findings> {
    let mut dictionary = Dictionary::new();
    for &(name, text) in SHIPPED {
        dictionary.load(&Source::new(name, text))?;
    }
    Ok(dictionary)
}

/// Registers all classes of the workspace with a manager, for the app of `host`.
pub fn register(sorm: &Sorm, host: &Host) {
    asynchronous::register(sorm);
    demo::register(sorm);
    ipc::register(sorm, host);
    sound::register(sorm);
    mcs::services::register(sorm);
    mcs_hand::services::register(sorm);
    mcs_path::services::register(sorm);
    vss::services::register(sorm);
    coordinators::services::register(sorm);
    bridge_program::register_class(sorm);
}

fn of_one(finding: Finding) -> Findings {
    let mut findings = Findings::new();
    findings.push(finding);
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_registered_class_is_described_and_every_described_one_registered() {
        let sorm = manager(&[]).unwrap();
        let registered: Vec<String> = sorm
            .classes()
            .iter()
            .map(|class| class.name().to_owned())
            .collect();
        let described: Vec<String> = CLASSES.iter().map(|class| class.name.clone()).collect();
        assert_eq!(registered, described);
    }

    #[test]
    fn codes_of_reports_are_not_used_twice() {
        let sorm = manager(&[]).unwrap();
        let mut seen = std::collections::BTreeMap::new();
        for (_, prototype) in sorm.prototypes() {
            let before = seen.insert(prototype.code, prototype.name);
            assert!(
                before.is_none_or(|name| name == prototype.name),
                "{prototype:?}"
            );
        }
    }
}
