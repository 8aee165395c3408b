//! What these classes read of a request, what they answer, and the codes of their reports.

use crate::raise;
use crate::report::{Report, code as general};
use crate::request::Request;
use crate::transport::Transport;

crate::prototypes! {
    /// The codes of the reports of these classes.
    pub mod code {
        UNKNOWN = 190, Error, "no such ticket", "see EXEC open; a ticket is collected once";
        FULL = 191, Error, "too many answers wait to be collected",
            "collect some, or raise -capacity";
        MISSED = 192, Warning, "results were made that this stream did not keep",
            "ask more often, or set -keep every and a larger -capacity";
        RESUMED = 193, Warning, "the stream was interrupted, and what was made meanwhile is lost",
            "go on; the numbers of the results may have begun again";
    }
}

/// A request that stands as one word in the text of another one, asked by the same caller.
pub(super) fn request(text: &str, from: &str) -> Result<Request, Report> {
    let mut request: Request = text
        .parse()
        .map_err(|error| raise!(general::SYNTAX, "in `{}`: {error}", begin(text)))?;
    from.clone_into(&mut request.body.from);
    Ok(request)
}

/// The beginning of a text of any length.
pub(super) fn begin(text: &str) -> &str {
    const MOST: usize = 80;
    let end = text
        .char_indices()
        .nth(MOST)
        .map_or(text.len(), |(at, _)| at);
    text.get(..end).unwrap_or_default()
}

/// Answers as another object has: data, code and reports.
pub(super) fn mirror(io: &mut Transport, mut body: Transport) {
    io.code = body.code;
    io.reports.append(&mut body.reports);
    io.take_data(body);
}
