//! How a handler ends.

use std::sync::Arc;

/// What a handler returns.
pub type Handled = Result<(), HandlerError>;

/// Why a handler could not do what it was asked. The caller gets the text.
#[derive(Debug, Clone, PartialEq, Eq, derive_more::Display)]
pub struct HandlerError(
    /// One pointer, so that what a handler returns costs nothing to pass on.
    Arc<String>,
);

impl HandlerError {
    /// An error that says `text`.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self(Arc::new(text.into()))
    }
}

/// Every error, and text, can end a handler. (For this, `HandlerError` is itself not an `Error`.)
impl<E: Into<Box<dyn std::error::Error>>> From<E> for HandlerError {
    fn from(error: E) -> Self {
        let error: Box<dyn std::error::Error> = error.into();
        Self::new(error.to_string())
    }
}
