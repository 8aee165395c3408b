//! Fault profiles: what goes wrong how often, and faults at moments of their own, as TOML.
//!
//! Four profiles are built in. A file of one's own has the same form; whatever is wrong in it is
//! reported at once, with places. Knows no app: whether a chassis exists is found out when it is used.

use std::{collections::BTreeMap, path::Path};

use crate::{
    fault::{Fault, KINDS, Kind},
    reader::Reader,
};
use ctos_config::{
    Node,
    diagnostic::{Findings, Source},
};

/// What goes wrong how often on one chassis or link, for how long and how badly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rate {
    /// How often per simulated second.
    pub(crate) per_s: f64,
    /// How long it lasts at least and at most, s.
    pub(crate) lasts_s: (f64, f64),
    /// How bad it is at least and at most: a share or a time in s.
    pub(crate) extent: (f64, f64),
}

/// What goes wrong in a simulated app: how often, and at given moments.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Faults {
    name: String,
    pub(crate) drift_ppm: f64,
    pub(crate) ahead_s: f64,
    /// By the kind of the fault.
    pub(crate) rates: BTreeMap<&'static str, Rate>,
    /// What happens at a given moment.
    pub script: Vec<Fault>,
}

/// The longest that a fault may last, and the largest time in a profile, s.
const TIME_MOST: f64 = 86_400.0;

impl Faults {
    /// The names of the built-in profiles, from nothing to the worst, with their texts.
    pub const BUILT_IN: [(&'static str, &'static str); 4] = [
        ("none", include_str!("profiles/none.toml")),
        ("light", include_str!("profiles/light.toml")),
        ("rough", include_str!("profiles/rough.toml")),
        ("hostile", include_str!("profiles/hostile.toml")),
    ];

    /// No faults.
    #[must_use]
    pub fn none() -> Self {
        Self {
            name: "none".to_owned(),
            ..Self::default()
        }
    }

    /// The built-in profile called `name`.
    #[must_use]
    pub fn built_in(name: &str) -> Option<Self> {
        let (name, text) = Self::BUILT_IN.iter().find(|(known, _)| *known == name)?;
        // A test reads all of them.
        Self::parse(&Source::new(format!("{name}.toml"), *text))
            .ok()
            .map(|faults| Self {
                name: (*name).to_owned(),
                ..faults
            })
    }

    /// Only what happens at given moments.
    #[must_use]
    pub fn of_script(name: &str, script: Vec<Fault>) -> Self {
        Self {
            name: name.to_owned(),
            script,
            ..Self::default()
        }
    }

    /// Reads a file of faults.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn read(path: &Path) -> Result<Self, Findings> {
        Self::parse(&Source::read(path)?)
    }

    /// Reads the text of a file of faults.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(source: &Source) -> Result<Self, Findings> {
        let mut findings = Findings::new();
        let root = Node::from_toml(source, &mut findings);
        let mut faults = Self {
            name: source.name().to_owned(),
            ..Self::default()
        };
        let drawn = || KINDS.iter().filter(|kind| !kind.seed.is_empty());
        let tables = drawn().map(|kind| kind.word).chain(["clocks", "fault"]);
        let tables: Vec<&str> = tables.collect();
        let mut reader = Reader::new(&root, "a file of faults", &tables, &mut findings);
        if let Some(mut clocks) = reader.table("clocks", &["drift_ppm", "ahead_s"]) {
            faults.drift_ppm = clocks.number("drift_ppm", 0.0..=100_000.0).unwrap_or(0.0);
            faults.ahead_s = clocks.number("ahead_s", 0.0..=TIME_MOST).unwrap_or(0.0);
        }
        for kind in drawn() {
            let rate = rate(&mut reader, kind);
            faults.rates.extend(rate.map(|rate| (kind.word, rate)));
        }
        faults.script = super::script::read(&mut reader);
        if findings.has_errors() {
            return Err(findings);
        }
        Ok(faults)
    }

    /// Its name, or that of its file.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// `[KIND]` with `per_s`, `lasts_s` and what says how bad it is.
fn rate(reader: &mut Reader<'_, '_>, kind: &Kind) -> Option<Rate> {
    let lasts = kind.lasts.then_some("lasts_s");
    let known = ["per_s"].into_iter().chain(lasts).chain(kind.extent);
    let mut table = reader.table(kind.word, &known.collect::<Vec<_>>())?;
    let nothing = Some((0.0, 0.0));
    let per_s = table.needed("per_s", 0.0..=1000.0);
    let mut range = |key, most| table.range(key, 0.0..=most);
    let lasts_s = lasts.map_or(nothing, |key| range(key, TIME_MOST));
    let extent = match kind.extent {
        Some("extra_s") => range("extra_s", TIME_MOST),
        Some(key) => range(key, 1.0),
        None => nothing,
    };
    Some(Rate {
        per_s: per_s?,
        lasts_s: lasts_s?,
        extent: extent?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Faults, Findings> {
        Faults::parse(&Source::new("faults.toml", text))
    }

    #[test]
    fn every_built_in_profile_reads_and_only_none_is_empty() {
        for (name, _) in Faults::BUILT_IN {
            let faults = Faults::built_in(name).unwrap();
            assert_eq!(faults.name(), name);
            assert_eq!(faults == Faults::none(), name == "none");
            assert_eq!(faults.rates.contains_key("kill"), name == "hostile");
        }
        assert_eq!(Faults::built_in("nice"), None);
    }

    #[test]
    fn all_that_is_wrong_is_found_at_once_each_with_its_place() {
        let text = "[cut]\nper_s = -1\nlasts_s = [2.0, 1.0]\n[los]\nper_s = 1\n[loss]\nper_s = 1\n\
                    lasts_s = [0.1, 0.2]\nshare = 3\n[[fault]]\nkind = \"cutt\"\n[[fault]]\nkind = \"kill\"\n";
        let found: Vec<String> = parse(text)
            .unwrap_err()
            .into_sorted()
            .iter()
            .map(ToString::to_string)
            .collect();
        let expected = [
            "faults.toml:2:9: error: [cut]: `per_s` must be a number from 0 to 1000",
            "faults.toml:3:11: error: [cut]: `lasts_s` must be [least, most]",
            "faults.toml:4:2: error: unknown key `los` in a file of faults",
            "faults.toml:9:9: error: [loss]: `share` must be [least, most]",
            "faults.toml:11:8: error: there is no fault `cutt`",
            "faults.toml:12:1: error: [[fault]] `kill` has no `at_s`",
            "faults.toml:12:1: error: [[fault]] `kill` has no `chassis`",
        ];
        assert_eq!(found.len(), expected.len(), "{found:#?}");
        for (found, expected) in found.iter().zip(expected) {
            assert!(found.starts_with(expected), "{found}\n{expected}");
        }
    }

    #[test]
    fn a_range_is_two_numbers_and_a_link_two_chassis() {
        for text in [
            "[cut]\nper_s = 1\nlasts_s = [0.1, 0.2, 0.3]\n",
            "[cut]\nper_s = 1\nlasts_s = [0.1]\n",
            "[[fault]]\nkind = \"refuse\"\nat_s = 1\nbetween = [\"a\", \"b\", \"c\"]\n",
            "[[fault]]\nkind = \"refuse\"\nat_s = 1\nbetween = [\"a\", \"a\"]\n",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
    }
}
