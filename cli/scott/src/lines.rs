//! The lines of a script, of any length and kind of bytes: what is not a line is reported and skipped.

use std::io::{self, BufRead, Read as _};

/// A longer line is refused and skipped, bytes.
pub const LONGEST_LINE: usize = 16 << 20;

/// The next line without its end, or why it cannot be one: it is too long (and skipped to its end) or
/// not UTF-8. `None` after the last.
pub(crate) fn next_line(input: &mut impl BufRead) -> io::Result<Option<Result<String, String>>> {
    let mut bytes = Vec::new();
    let most = u64::try_from(LONGEST_LINE).unwrap_or(u64::MAX) + 1;
    input.by_ref().take(most).read_until(b'\n', &mut bytes)?;
    if bytes.is_empty() {
        return Ok(None);
    }
    if bytes.len() > LONGEST_LINE && !bytes.ends_with(b"\n") {
        let rest = skip_line(input)?;
        let read = u64::try_from(bytes.len()).unwrap_or(u64::MAX);
        let length = read.saturating_add(rest);
        let why = format!("the line has {length} bytes; lines up to {LONGEST_LINE} bytes are read");
        return Ok(Some(Err(why)));
    }
    while bytes.last().is_some_and(|last| b"\r\n".contains(last)) {
        bytes.pop();
    }
    Ok(Some(String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to() + 1;
        format!("byte {at} of the line is not UTF-8")
    })))
}

/// Reads to the end of the line without keeping it; the bytes that it had.
fn skip_line(input: &mut impl BufRead) -> io::Result<u64> {
    let mut length = 0;
    loop {
        let part = input.fill_buf()?;
        if part.is_empty() {
            return Ok(length);
        }
        let (used, done) = match part.iter().position(|byte| *byte == b'\n') {
            Some(at) => (at + 1, true),
            None => (part.len(), false),
        };
        input.consume(used);
        length += u64::try_from(used).unwrap_or(u64::MAX);
        if done {
            return Ok(length);
        }
    }
}
