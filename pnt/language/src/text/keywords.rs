//! The keywords of net text.

/// Keywords that begin a line of the net itself.
pub(super) const DECLARATIONS: [&str; 12] = [
    "net",
    "place",
    "data",
    "command",
    "coordinator",
    "serves",
    "safe",
    "transition",
    "subnet",
    "use",
    "end",
    "include",
];

/// Keywords that begin a line of a transition.
pub(super) const CLAUSES: [&str; 22] = [
    "in",
    "read",
    "inhibit",
    "reset",
    "tape",
    "when",
    "do",
    "ask",
    "send",
    "request",
    "wait",
    "log",
    "set",
    "idempotent",
    "out",
    "fail",
    "write",
    "priority",
    "weight",
    "time",
    "servers",
    "within",
];

/// Whether lines of net text begin with `word`.
pub(crate) fn is_keyword(word: &str) -> bool {
    DECLARATIONS.contains(&word) || CLAUSES.contains(&word)
}
