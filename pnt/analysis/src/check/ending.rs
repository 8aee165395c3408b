//! Whether what is on given tapes can always come to its end.

use crate::{
    analysis::{explicit::Limits, returns::always_reachable, verdict::Looked},
    compose::tape::Ends,
};

/// Whether the end of what comes on given tapes always stays within reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum End {
    /// From every reachable marking.
    Always,
    /// Not from this one.
    NotFrom(Vec<u32>),
    /// A limit came first.
    Unknown,
}

/// Whether it does, among the markings that the search has seen.
pub(super) fn end(ends: &Ends, looked: &Looked<'_>, limits: &Limits) -> End {
    match always_reachable(
        &looked.explored,
        &|marking| ends.holds(marking),
        limits.bytes,
    ) {
        None => End::Unknown,
        Some(None) => End::Always,
        Some(Some(marking)) => End::NotFrom(marking),
    }
}
