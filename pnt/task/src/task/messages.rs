//! The commands of net tasks.

use std::sync::Arc;

use ctos::message::{Command as _, CommandInfo};
use serde::{Deserialize, Serialize};

use crate::stream::{Describe, Follow};

/// The answer to a command on the input tape.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TapeAnswer {
    /// The output symbol.
    pub symbol: String,
    /// What actions noted and why some of them failed, line by line.
    pub text: String,
    /// Whether it is the answer that the net declares first for the command: that of success.
    pub first: bool,
}

/// A symbol on the output tape that nobody was there to take.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Its number on the output tape, from 1.
    pub number: u64,
    /// The command that it answers.
    pub command: String,
    /// What that command came with.
    pub arguments: Vec<String>,
    /// The answer.
    pub answer: TapeAnswer,
}

/// One event of a net: a firing, an intervention, or the end of the net.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FiringEvent {
    /// When, nanoseconds since the app started.
    pub at_ns: u64,
    /// The transition; empty when it is about the net itself.
    pub transition: String,
    /// `fired`, `started`, `completed`, `failed` or `stopped`; `control` for an intervention, `paused`
    /// where a breakpoint was met, `resumed` after a restart of the process.
    pub phase: String,
    /// Why it failed or stopped, or what was done by hand; empty otherwise.
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
    /// Why it fires nothing for the moment, if it is paused.
    pub paused: Option<String>,
    /// Answers on the output tape that nobody has taken.
    pub output: Vec<Output>,
    /// Other nets and how many transfers wait to be taken by them.
    pub sending: Vec<(String, u32)>,
    /// The breakpoints that are set, as they were written.
    pub breakpoints: Vec<String>,
    /// The data that the net declares, each value by its name.
    pub data: Vec<(String, String)>,
}

/// What one firing sends to another net.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transfer {
    /// Places and numbers of tokens.
    pub tokens: Vec<(String, u32)>,
    /// A symbol for the input tape, with what goes along.
    pub symbol: Option<(String, Vec<String>)>,
}

/// Something done to a running net by hand.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// Fires an enabled transition now, paused or not.
    Fire {
        /// Its name.
        transition: String,
    },
    /// Puts tokens into a place.
    Put {
        /// Its name.
        place: String,
        /// How many.
        tokens: u32,
    },
    /// Takes tokens out of a place.
    Take {
        /// Its name.
        place: String,
        /// How many.
        tokens: u32,
    },
    /// Begins no more firings; actions that are going on come to their ends.
    Pause,
    /// Goes on.
    Resume,
    /// Begins so many firings, then pauses again.
    Step {
        /// How many.
        firings: u32,
    },
    /// Sets a breakpoint: `TRANSITION`, before whose firing the net pauses, or `PLACE>=N`, `PLACE<=N` or
    /// `PLACE=N`, which pauses it when that becomes true.
    Break {
        /// Where.
        at: String,
    },
    /// Removes a breakpoint, or all.
    Clear {
        /// Where, as it was set.
        at: Option<String>,
    },
    /// Ends the action of a transition that is going on, as failed.
    Cancel {
        /// Its name.
        transition: String,
    },
    /// Ends the action of a transition that is going on, as completed; what it would have put into data
    /// objects is not put.
    Complete {
        /// Its name.
        transition: String,
    },
    /// Replaces the net at its next safe marking.
    Replace {
        /// The name of the file, for findings.
        file: String,
        /// The text of the new net.
        text: String,
        /// How long to wait for the safe marking, ms.
        within_ms: u64,
    },
}

/// Which of all requests a command is: a repeated request gives the same.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RequestId {
    /// Who asks, and in which of its lives, if it forgets.
    pub from: String,
    /// The number of the request, which its caller uses once.
    pub number: u64,
}

/// The data of a command that a net, or a caller, at another site sends to a net here: it gets the name `NAME@SITE`, so that its
/// numbers are not taken for those of one here. Other commands, and data that cannot be read, stay as they are.
#[must_use]
pub fn from_site(command: u16, data: Vec<u8>, site: &str) -> Vec<u8> {
    let renamed = match command {
        Tokens::CODE => postcard::from_bytes(&data).and_then(|mut tokens: Tokens| {
            tokens.from = format!("{}@{site}", tokens.from).into();
            postcard::to_stdvec(&tokens)
        }),
        PutOnce::CODE => postcard::from_bytes(&data).and_then(|mut put: PutOnce| {
            put.request.from = format!("{}@{site}", put.request.from);
            postcard::to_stdvec(&put)
        }),
        _ => return data,
    };
    renamed.unwrap_or(data)
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
    /// Puts what another net sends; answered with the number of the last transfer that is taken for good.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Tokens {
        /// The sending net.
        pub from: Arc<str>,
        /// The stream to which the numbers belong; a sender that has forgotten begins another.
        pub stream: u64,
        /// Number of the first transfer; the others follow without gaps.
        pub first: u64,
        /// The transfers. The tokens of one are put all or none.
        pub transfers: Vec<Arc<Transfer>>,
    } => u64, 0x0002, "tokens"
}

ctos::command! {
    /// Shows the marking, the tape and the latest firings.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Marking => Snapshot, 0x0003, "marking"
}

ctos::command! {
    /// Intervenes by hand; only where the net's task says `allow_control = true`.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct Control {
        /// What to do.
        pub order: Order,
        /// Who orders it, for the log, the displays and the record; empty when nobody says.
        pub by: String,
    } => String, 0x0004, "control"
}

ctos::command! {
    /// Reads the output tape: answers that nobody waited for. Those up to `taken` are removed first.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct ReadTape {
        /// Number of the last one that the reader has; 0 for none.
        pub taken: u64,
    } => Vec<Output>, 0x0005, "read_tape"
}

ctos::command! {
    /// Puts a symbol on the input tape once, however often it is asked for; answered as `put_tape`.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct PutOnce {
        /// Which request it is.
        pub request: RequestId,
        /// The symbol.
        pub symbol: String,
        /// What goes along with it, for the actions.
        pub arguments: Vec<String>,
    } => TapeAnswer, 0x0006, "put_once"
}

/// The commands of every net task, for registration.
pub const COMMANDS: [CommandInfo; 8] = [
    PutTape::INFO,
    PutOnce::INFO,
    Tokens::INFO,
    Marking::INFO,
    Control::INFO,
    ReadTape::INFO,
    Describe::INFO,
    Follow::INFO,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_net_at_another_site_sends_bears_its_name_and_that_of_its_site() {
        let tokens = Tokens {
            from: "belt".into(),
            stream: 7,
            first: 3,
            transfers: vec![Arc::new(Transfer {
                tokens: vec![("p".to_owned(), 2)],
                symbol: None,
            })],
        };
        let sent = postcard::to_stdvec(&tokens).unwrap();
        let came = from_site(Tokens::CODE, sent.clone(), "north");
        let came: Tokens = postcard::from_bytes(&came).unwrap();
        let named = Tokens {
            from: "belt@north".into(),
            ..tokens
        };
        assert_eq!(came, named);
        let put = PutOnce {
            request: RequestId {
                from: "person".to_owned(),
                number: 1,
            },
            symbol: "go".to_owned(),
            arguments: vec!["fast".to_owned()],
        };
        let came = from_site(PutOnce::CODE, postcard::to_stdvec(&put).unwrap(), "north");
        let came: PutOnce = postcard::from_bytes(&came).unwrap();
        assert_eq!(came.request.from, "person@north");
        assert_eq!((came.symbol, came.arguments), (put.symbol, put.arguments));
        assert_eq!(from_site(Marking::CODE, vec![1, 2], "north"), [1, 2]);
        assert_eq!(
            from_site(Tokens::CODE, vec![0xff], "north"),
            [0xff],
            "refused by the net"
        );
    }
}
