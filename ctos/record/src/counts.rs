//! What a file that is closed says at its end of all that is in it, so that nobody need read it to count.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use ctos_time::Instant;

/// The metadata record that holds the counts of a file.
pub(crate) const COUNTS: &str = "ctos.counts";
/// The member of the metadata.
const MEMBER: &str = "json";

/// Lines of each channel with their bytes, and between which moments they are. Moments are ns.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Counts {
    pub(crate) channels: BTreeMap<String, (u64, u64)>,
    span: Option<(u64, u64)>,
    /// So far from the moment of a stretch of events may be those of its events, ns.
    pub(crate) longest: u64,
}

impl Counts {
    /// One more line.
    pub(crate) fn add(&mut self, topic: &str, at: u64, bytes: usize) {
        let bytes = u64::try_from(bytes).unwrap_or(0);
        self.add_lines(topic, (1, bytes), (at, at));
    }

    /// So many lines with so many bytes in all, between two moments.
    pub(crate) fn add_lines(&mut self, topic: &str, (lines, bytes): (u64, u64), span: (u64, u64)) {
        let counted = match self.channels.get_mut(topic) {
            Some(counted) => counted,
            None => self.channels.entry(topic.to_owned()).or_default(),
        };
        counted.0 += lines;
        counted.1 += bytes;
        let whole = self.span.get_or_insert(span);
        *whole = (whole.0.min(span.0), whole.1.max(span.1));
    }

    /// Adds what else is in the file.
    pub(crate) fn extend(&mut self, other: &Self) {
        if let Some(span) = other.span {
            self.longest = self.longest.max(other.longest);
            for (topic, counted) in &other.channels {
                self.add_lines(topic, *counted, span);
            }
        }
    }

    /// The first and the last moment.
    pub(crate) fn span(&self) -> Option<(Instant, Instant)> {
        let moment = Instant::from_nanos;
        self.span.map(|(first, last)| (moment(first), moment(last)))
    }

    /// As metadata.
    pub(crate) fn page(&self) -> BTreeMap<String, String> {
        // Texts and numbers, all of which JSON can hold.
        let json = serde_json::to_string(self).unwrap_or_default();
        BTreeMap::from([(MEMBER.to_owned(), json)])
    }

    /// What [`Counts::page`] made.
    pub(crate) fn of_page(metadata: &BTreeMap<String, String>) -> Option<Self> {
        serde_json::from_str(metadata.get(MEMBER)?).ok()
    }
}
