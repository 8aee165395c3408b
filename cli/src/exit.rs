//! The exit codes of every command.

/// Fine.
pub const OK: u8 = 0;
/// What was asked for failed.
pub const FAILED: u8 = 1;
/// The command line is wrong.
pub const USAGE: u8 = 2;
/// The configuration, or a file that it names, is wrong.
pub const CONFIG: u8 = 3;
/// A chassis could not be started or reached.
pub const UNREACHABLE: u8 = 5;
/// Interrupted by Ctrl-C.
pub const INTERRUPTED: u8 = 130;
