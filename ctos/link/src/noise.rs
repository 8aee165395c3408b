//! Bytes that nobody guesses, for secrets and names.

use std::io;

/// So many of them.
///
/// # Errors
/// The system has no randomness to give.
pub(crate) fn bytes<const COUNT: usize>() -> io::Result<[u8; COUNT]> {
    let mut bytes = [0; COUNT];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes)
}

/// Bytes as text, two characters for each.
pub(crate) fn text<const COUNT: usize>(bytes: [u8; COUNT]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
