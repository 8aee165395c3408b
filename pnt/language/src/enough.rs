//! How many findings about one file are enough. Knows no form of file.

use ctos::diagnostic::Findings;

/// So many findings about one file are enough: nobody reads more, and each costs as much as it has
/// before it.
const MOST_FINDINGS: usize = 200;

/// Whether reading on is of no use to anybody.
pub(crate) fn enough(findings: &Findings) -> bool {
    findings.iter().nth(MOST_FINDINGS).is_some()
}
