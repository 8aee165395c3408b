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

    fn missing<T>(&mut self, key: &str, expected: &str) -> Option<T> {
        let message = format!("{} has no `{key}`", self.what);
        let finding = Finding::error("ctos::faults::missing_key", message)
            .help(format!("add `{key}`: {expected}"));
        self.push(finding, None);
        None
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
        let node = self.value(key)?;
        let number = node.as_f64().filter(|number| range.contains(number));
        if number.is_none() {
            let expected = format!("a number from {} to {}", range.start(), range.end());
            return self.wrong(key, node, &expected);
        }
        number
    }

    /// A number that must be there.
    pub(crate) fn needed(&mut self, key: &str, range: RangeInclusive<f64>) -> Option<f64> {
        if self.value(key).is_none() {
            let expected = format!("a number from {} to {}", range.start(), range.end());
            return self.missing(key, &expected);
        }
        self.number(key, range)
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
        let Some(node) = self.value(key) else {
            return self.missing(key, &expected);
        };
        let numbers: Vec<f64> = node.elements().iter().filter_map(Node::as_f64).collect();
        match (numbers[..].first_chunk::<2>(), node.elements().len()) {
            (Some([least, most]), 2)
                if least <= most && allowed.contains(least) && allowed.contains(most) =>
            {
                Some((*least, *most))
            }
            _ => self.wrong(key, node, &expected),
        }
    }

    /// A text that must be there.
    pub(crate) fn text(&mut self, key: &str, expected: &str) -> Option<String> {
        let Some(node) = self.value(key) else {
            return self.missing(key, expected);
        };
        match node.as_str() {
            Some(text) if !text.is_empty() => Some(text.to_owned()),
            _ => self.wrong(key, node, expected),
        }
    }

    /// Two different names that must be there.
    pub(crate) fn pair(&mut self, key: &str) -> Option<(String, String)> {
        let expected = "two different chassis, for example [\"desk\", \"cage\"]";
        let Some(node) = self.value(key) else {
            return self.missing(key, expected);
        };
        let names: Vec<&str> = node.elements().iter().filter_map(Node::as_str).collect();
        match (&names[..], node.elements().len()) {
            ([one, other], 2) if one != other => Some(((*one).to_owned(), (*other).to_owned())),
            _ => self.wrong(key, node, expected),
        }
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
