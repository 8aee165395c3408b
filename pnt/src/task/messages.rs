//! The commands of net tasks.

use serde::{Deserialize, Serialize};

/// The answer to a command on the input tape.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TapeAnswer {
    /// The output symbol.
    pub symbol: String,
    /// What actions noted and why some of them failed, line by line.
    pub text: String,
}

/// One event of a net: a firing, or the end of the net.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FiringEvent {
    /// When, nanoseconds since the app started.
    pub at_ns: u64,
    /// The transition; empty when the net itself has stopped.
    pub transition: String,
    /// `fired`, `started`, `completed`, `failed` or `stopped`.
    pub phase: String,
    /// Why it failed or stopped; empty otherwise.
    pub text: String,
}

/// A net as it is at one moment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Snapshot {
    /// The net's name.
    pub net: String,
    /// All places and their tokens, in order of place number.
    pub places: Vec<(String, u32)>,
    /// Transitions whose actions are going on, oldest first.
    pub in_action: Vec<String>,
    /// Symbols on the input tape that have not been read, next one first.
    pub tape: Vec<String>,
    /// The command that has been read and not answered.
    pub in_progress: Option<String>,
    /// Why the net has stopped, if it has.
    pub halted: Option<String>,
    /// Firings ended so far.
    pub firings: u64,
    /// The latest events, oldest first.
    pub events: Vec<FiringEvent>,
}

ctos::command! {
    /// Puts a symbol on the input tape; answered when an output symbol is written for it.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct PutTape {
        /// The symbol.
        pub symbol: String,
        /// What goes along with it, for the actions.
        pub arguments: Vec<String>,
    } => TapeAnswer, 0x0001, "put_tape"
}

ctos::command! {
    /// Puts tokens that another net sends; answered when they are in their places, all or none.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Tokens {
        /// The sending net.
        pub from: String,
        /// Places and numbers of tokens.
        pub tokens: Vec<(String, u32)>,
    } => (), 0x0002, "tokens"
}

ctos::command! {
    /// Shows the marking, the tape and the latest firings.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Marking => Snapshot, 0x0003, "marking"
}
