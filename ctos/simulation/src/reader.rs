//! Reads the keys of one table of a file of faults one by one, so that all that is wrong is found.

use std::{ops::RangeInclusive, time::Duration};

use ctos_config::{
    Entry, Node, Value,
    diagnostic::{Finding, Findings},
};

/// A table, with a name for messages. A getter returns `None` for a key that is absent, and, with a
/// finding, for one that is wrong.
pub(crate) struct Reader<'n, 'f> {
    node: &'n Node,
    what: String,
    pub(crate) findings: &'f mut Findings,
}

impl<'n, 'f> Reader<'n, 'f> {
    /// Reports keys that are not `known`.
    pub(crate) fn new(
        node: &'n Node,
        what: impl Into<String>,
        known: &[&str],
        findings: &'f mut Findings,
    ) -> Self {
        let what = what.into();
        let unknown = |entry: &&Entry| !known.contains(&entry.key.as_str());
        for entry in node.entries().iter().filter(unknown) {
            let message = format!("unknown key `{}` in {what}", entry.key);
            let finding = Finding::error("ctos::faults::unknown_key", message)
                .label("nobody reads this key")
                .suggest(&entry.key, known.iter().copied());
            findings.push(finding.at(entry.key_place.clone()));
        }
        Self {
            node,
            what,
            findings,
        }
    }

    /// Reports what is wrong with the value of a key, or with the table where there is none.
    pub(crate) fn push(&mut self, finding: Finding, key: &str) {
        let place = self.value(key).unwrap_or(self.node).place();
        self.findings.push(finding.at(place.cloned()));
    }

    fn value(&self, key: &str) -> Option<&'n Node> {
        self.node.entry(key).map(|entry| &entry.value)
    }

    fn wrong(&mut self, key: &str, expected: &str) {
        let message = format!("{}: `{key}` must be {expected}", self.what);
        self.push(Finding::error("ctos::faults::value", message), key);
    }

    /// What `read` makes of the value of a key that must be there.
    fn must<T>(
        &mut self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&'n Node) -> Option<T>,
    ) -> Option<T> {
        let Some(node) = self.value(key) else {
            let message = format!("{} has no `{key}`", self.what);
            let finding = Finding::error("ctos::faults::missing_key", message);
            self.push(finding.help(format!("add `{key}`: {expected}")), key);
            return None;
        };
        let read = read(node);
        if read.is_none() {
            self.wrong(key, expected);
        }
        read
    }

    /// A table below this one.
    pub(crate) fn table(&mut self, key: &str, known: &[&str]) -> Option<Reader<'n, '_>> {
        let node = self.value(key)?;
        if !is_table(node) {
            self.wrong(key, "a table of keys");
            return None;
        }
        Some(Reader::new(node, format!("[{key}]"), known, self.findings))
    }

    /// The tables of an array.
    pub(crate) fn tables(&mut self, key: &str) -> &'n [Node] {
        let tables = |node: &'n Node| {
            let tables = node.elements();
            let is_array = matches!(node.value(), Value::Array(_));
            (is_array && tables.iter().all(is_table)).then_some(tables)
        };
        self.value(key)
            .and_then(|_| self.must(key, &format!("a list of tables, written [[{key}]]"), tables))
            .unwrap_or_default()
    }

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
        let (from, to) = (allowed.start(), allowed.end());
        let expected = format!("[least, most], two numbers from {from} to {to}");
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
        let text = self.must(key, expected, |node| {
            node.as_str().filter(|text| !text.is_empty())
        });
        text.map(str::to_owned)
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
}

fn is_table(node: &Node) -> bool {
    matches!(node.value(), Value::Table(_))
}

/// Seconds as a duration, to the nearest nanosecond.
pub(crate) fn nanos(seconds: f64) -> Duration {
    let nanos = (seconds * 1e9).round();
    // Numbers that are read are neither negative nor longer than some days.
    Duration::from_nanos(nanos as u64)
}
