//! The exit codes of every command: one list, from which the help and `docs/commands.md` are made.

/// Fine.
pub const OK: u8 = 0;
/// What was asked for failed.
pub const FAILED: u8 = 1;
/// The command line is wrong.
pub const USAGE: u8 = 2;
/// The configuration, or a file that it names, is wrong.
pub const CONFIG: u8 = 3;
/// A name leads to nothing.
pub const NO_SUCH_NAME: u8 = 4;
/// An app or one of its chassis could not be started or reached.
pub const UNREACHABLE: u8 = 5;
/// It took too long.
pub const TIMED_OUT: u8 = 6;
/// A breakpoint or a limit that was asked for ended it.
pub const LIMIT: u8 = 7;
/// The key that was shown, or its role, does not permit it.
pub const NOT_ALLOWED: u8 = 8;
/// Interrupted by Ctrl-C (128 + SIGINT), or stopped by an operator.
pub const INTERRUPTED: u8 = 130;
/// Ended by SIGTERM (128 + SIGTERM).
pub const TERMINATED: u8 = 143;

/// Every code with what it means.
pub const CODES: [(u8, &str); 11] = [
    (OK, "fine; also when whoever reads the output has closed it"),
    (FAILED, "what was asked for failed"),
    (USAGE, "the command line is wrong"),
    (
        CONFIG,
        "the configuration, or a file that it names, is wrong",
    ),
    (NO_SUCH_NAME, "a name leads to nothing"),
    (
        UNREACHABLE,
        "an app or a chassis cannot be started or reached",
    ),
    (
        TIMED_OUT,
        "it took too long, or more memory or steps than its limits permit",
    ),
    (
        LIMIT,
        "stopped by a breakpoint or a limit that was asked for",
    ),
    (NOT_ALLOWED, "the key, or its role, does not permit it"),
    (
        INTERRUPTED,
        "interrupted by Ctrl-C, or stopped by `ctos stop`",
    ),
    (TERMINATED, "ended by SIGTERM"),
];

/// The list as the help shows it.
#[must_use]
pub fn help() -> String {
    let lines = CODES.map(|(code, meaning)| format!("  {code:>3}  {meaning}"));
    format!("Exit codes:\n{}", lines.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_stands_once_and_the_codes_of_signals_are_128_and_the_signal() {
        let mut codes: Vec<u8> = CODES.iter().map(|(code, _)| *code).collect();
        codes.dedup();
        assert!(codes.is_sorted());
        assert_eq!(codes.len(), CODES.len());
        assert_eq!((INTERRUPTED, TERMINATED), (128 + 2, 128 + 15));
    }
}
