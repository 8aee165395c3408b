//! Who an object is reserved for: a lock that somebody asked for, or a prepared commitment.

use ctos::time::Instant;

/// A reservation of an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Reservation {
    by: String,
    until: Instant,
    /// Under which name something is prepared.
    prepared: Option<String>,
}

impl Reservation {
    pub(crate) fn lock(by: &str, until: Instant) -> Self {
        Self {
            by: by.to_owned(),
            until,
            prepared: None,
        }
    }

    /// What is prepared under the name `commitment`.
    pub(crate) fn prepared(by: &str, until: Instant, commitment: &str) -> Self {
        Self {
            prepared: Some(commitment.to_owned()),
            ..Self::lock(by, until)
        }
    }

    pub(crate) fn is_over(&self, now: Instant) -> bool {
        now >= self.until
    }

    /// Whether `from` may use the object. The caller that has locked it may; while something is
    /// prepared in it, none may.
    pub(crate) fn is_of(&self, from: &str) -> bool {
        self.prepared.is_none() && self.by == from
    }

    pub(crate) fn by(&self) -> &str {
        &self.by
    }

    pub(crate) fn is_prepared(&self) -> bool {
        self.prepared.is_some()
    }

    pub(crate) fn is_commitment(&self, by: &str, commitment: &str) -> bool {
        self.by == by && self.prepared.as_deref() == Some(commitment)
    }

    /// Completes "the object is ...".
    pub(crate) fn words(&self, now: Instant) -> String {
        let left = self.until.since(now).as_secs_f64();
        let by = if self.by.is_empty() {
            "this process"
        } else {
            &self.by
        };
        match &self.prepared {
            None => format!("locked by `{by}` for another {left:.1} s"),
            Some(commitment) => {
                format!("prepared for `{commitment}` of `{by}` for another {left:.1} s")
            }
        }
    }
}
