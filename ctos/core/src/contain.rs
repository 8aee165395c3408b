//! Panics of code that is not the runtime's, contained.

use std::{
    any::Any,
    cell::Cell,
    panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind},
};

thread_local! {
    /// Where the last panic of this thread was, until somebody reports it.
    static PLACE: Cell<Option<String>> = const { Cell::new(None) };
}

/// For a program's panic hook: keeps where the panic is, for the text that tells of it.
pub fn note_panic(panic: &PanicHookInfo<'_>) {
    PLACE.set(panic.location().map(ToString::to_string));
}

/// Calls code of others.
///
/// # Errors
/// What it said when it panicked.
pub fn contained<T>(code: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(code)).map_err(|panic| panic_text(panic.as_ref()))
}

/// Drops what may hold code of others: a destructor that panics must not end the thread.
pub(crate) fn drop_contained<T>(value: T) {
    if let Err(panic) = contained(|| drop(value)) {
        tracing::error!(%panic, "a destructor panicked");
    }
}

/// What a panic said, and where it was if this thread's hook has noted that ([`note_panic`]).
pub fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = if let Some(text) = panic.downcast_ref::<&str>() {
        (*text).to_owned()
    } else if let Some(text) = panic.downcast_ref::<String>() {
        text.clone()
    } else {
        "a value that is not text".to_owned()
    };
    match PLACE.take() {
        Some(place) => format!("{text} (at {place})"),
        None => text,
    }
}
