//! Reads the keys of one table of a file of faults one by one, so that all that is wrong is found.

use std::{ops::RangeInclusive, time::Duration};

use ctos_config::{
    Node, Value,
    diagnostic::{Finding, Findings, Place},
};

/// A table, with a name for messages. A getter returns `None` for a key that is absent, and, with a
/// finding, for one that is wrong.
pub(crate) struct Reader<'n, 'f> {
    node: &'n Node,
    /// Where the table begins.
    place: Option<Place>,
    what: String,
    findings: &'f mut Findings,
}

impl<'n, 'f> Reader<'n, 'f> {
    /// Reports keys that are not `known`.
    pub(crate) fn new(
        node: &'n Node,
        what: impl Into<String>,
        known: &[&str],
        findings: &'f mut Findings,
    ) -> Self {
        let mut reader = Self {
            node,
            place: node.place().cloned(),
            what: what.into(),
            findings,
        };
        for entry in node.entries() {
            if !known.contains(&entry.key.as_str()) {
                let message = format!("unknown key `{}` in {}", entry.key, reader.what);
                let finding = Finding::error("ctos::faults::unknown_key", message)
                    .label("nobody reads this key")
                    .suggest(&entry.key, known.iter().copied());
                reader.push(finding, entry.key_place.as_ref());
            }
        }
        reader
    }

    pub(crate) fn push(&mut self, finding: Finding, place: Option<&Place>) {
        self.findings.push(match place.or(self.place.as_ref()) {
            Some(place) => finding.at(place.clone()),
            None => finding,
        });
    }

    fn value(&self, key: &str) -> Option<&'n Node> {
        self.node.entry(key).map(|entry| &entry.value)
    }

    fn wrong<T>(&mut self, key: &str, node: &Node, expected: &str) -> Option<T> {
        let message = format!("{}: `{key}` must be {expected}", self.what);
        let finding = Finding::error("ctos::faults::value", message);
        self.push(finding, node.place());
        None
    }

    /// What `read` makes of the value of a key that must be there.
    fn must<T>(
        &mut self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&Node) -> Option<T>,
    ) -> Option<T> {
        let Some(node) = self.value(key) else {
            let message = format!("{} has no `{key}`", self.what);
            let finding = Finding::error("ctos::faults::missing_key", message)
                .help(format!("add `{key}`: {expected}"));
            self.push(finding, None);
            return None;
        };
        read(node).or_else(|| self.wrong(key, node, expected))
    }

    /// A table below this one.
    pub(crate) fn table(&mut self, key: &str, known: &[&str]) -> Option<Reader<'n, '_>> {
        let node = self.value(key)?;
        if !matches!(node.value(), Value::Table(_)) {
            return self.wrong(key, node, "a table of keys");
        }
        Some(Reader::new(node, format!("[{key}]"), known, self.findings))
    }

    /// The tables of an array, each with the name that `named` gives it.
    pub(crate) fn tables(&mut self, key: &str) -> &'n [Node] {
        let Some(node) = self.value(key) else {
            return &[];
        };
        let is_table = |node: &Node| matches!(node.value(), Value::Table(_));
        if !matches!(node.value(), Value::Array(_)) || !node.elements().iter().all(is_table) {
            let expected = format!("a list of tables, written [[{key}]]");
            let _: Option<()> = self.wrong(key, node, &expected);
            return &[];
        }
        node.elements()
    }

    /// A reader of one of [`Self::tables`].
    pub(crate) fn element(
        &mut self,
        node: &'n Node,
        what: String,
        known: &[&str],
    ) -> Reader<'n, '_> {
        Reader::new(node, what, known, self.findings)
    }

    /// A number.
    pub(crate) fn number(&mut self, key: &str, range: RangeInclusive<f64>) -> Option<f64> {
        self.value(key)?;
        self.needed(key, range)
    }

    /// A number that must be there.
    pub(crate) fn needed(&mut self, key: &str, range: RangeInclusive<f64>) -> Option<f64> {
        let expected = format!("a number from {} to {}", range.start(), range.end());
        let number = |node: &Node| node.as_f64().filter(|number| range.contains(number));
        self.must(key, &expected, number)
    }

    /// A time in s that must be there, to the nanosecond.
    pub(crate) fn time(&mut self, key: &str, most: f64) -> Option<Duration> {
        self.needed(key, 0.0..=most).map(nanos)
    }

    /// Two numbers in order, `[least, most]`, that must be there.
    pub(crate) fn range(&mut self, key: &str, allowed: RangeInclusive<f64>) -> Option<(f64, f64)> {
        let expected = format!(
            "[least, most], two numbers from {} to {}",
            allowed.start(),
            allowed.end()
        );
        self.must(key, &expected, |node| {
            let [least, most] = node.elements() else {
                return None;
            };
            let (least, most) = (least.as_f64()?, most.as_f64()?);
            let right = least <= most && allowed.contains(&least) && allowed.contains(&most);
            right.then_some((least, most))
        })
    }

    /// A text that must be there.
    pub(crate) fn text(&mut self, key: &str, expected: &str) -> Option<String> {
        let text = |node: &Node| {
            node.as_str()
                .filter(|text| !text.is_empty())
                .map(str::to_owned)
        };
        self.must(key, expected, text)
    }

    /// Two different names that must be there.
    pub(crate) fn pair(&mut self, key: &str) -> Option<(String, String)> {
        let expected = "two different chassis, for example [\"desk\", \"cage\"]";
        self.must(key, expected, |node| {
            let [one, other] = node.elements() else {
                return None;
            };
            let (one, other) = (one.as_str()?, other.as_str()?);
            (one != other).then(|| (one.to_owned(), other.to_owned()))
        })
    }

    /// The place of a key's value, or of the table.
    pub(crate) fn place_of(&self, key: &str) -> Option<Place> {
        let place = self.value(key).and_then(|node| node.place().cloned());
        place.or_else(|| self.place.clone())
    }
}

/// Seconds as a duration, to the nearest nanosecond.
pub(crate) fn nanos(seconds: f64) -> Duration {
    let nanos = (seconds * 1e9).round();
    // Numbers that are read are neither negative nor longer than some days.
    Duration::from_nanos(nanos as u64)
}
