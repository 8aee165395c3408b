//! Why nothing was fired, put or taken.

use thiserror::Error;

use crate::net::{Command, Net};

/// Why nothing was fired or put. The execution is as it was before.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum FireError {
    /// The transition's inputs, inhibitors or tape do not allow it.
    #[error("transition `{0}` is not enabled")]
    NotEnabled(String),
    /// The transition has an action and cannot fire in one step.
    #[error("transition `{0}` has an action: start it and complete it")]
    HasAction(String),
    /// No such firing is going on.
    #[error("no firing {0} is going on")]
    NotRunning(u64),
    /// A place would hold more tokens than can be counted.
    #[error("place `{0}` would hold more than {max} tokens", max = u32::MAX)]
    TooManyTokens(String),
    /// A place would hold more tokens than its capacity allows.
    #[error(
        "place `{place}` holds {tokens} tokens (promised ones too) of {capacity} at most, and {more} more do not fit"
    )]
    Full {
        /// The place.
        place: String,
        /// Its tokens and those that running firings may yet put there.
        tokens: u32,
        /// Its capacity.
        capacity: u32,
        /// What was to come.
        more: u32,
    },
    /// A place holds fewer tokens than are to be taken.
    #[error("place `{place}` holds {tokens} tokens, and {wanted} are to be taken")]
    TooFewTokens {
        /// The place.
        place: String,
        /// Its tokens.
        tokens: u32,
        /// What was to be taken.
        wanted: u32,
    },
    /// As many commands wait on the tape as it may hold.
    #[error("the tape of net `{net}` is full: {room} commands wait")]
    TapeFull {
        /// The net.
        net: String,
        /// How many may wait.
        room: usize,
    },
    /// The symbol is not in the net's input alphabet.
    #[error("net `{net}` takes no command `{symbol}`; it takes: {accepted}")]
    UnknownSymbol {
        /// The net.
        net: String,
        /// What was put.
        symbol: String,
        /// What could be put, with commas.
        accepted: String,
    },
    /// What came with the symbol does not fit.
    #[error("command `{symbol}` of net `{net}` takes ({wanted}), {what}")]
    Arguments {
        /// The net.
        net: String,
        /// What was put.
        symbol: String,
        /// Its arguments with their types.
        wanted: String,
        /// What came instead.
        what: String,
    },
    /// The place is not in the net.
    #[error("net `{net}` has no place `{place}`")]
    UnknownPlace {
        /// The net.
        net: String,
        /// What was asked for.
        place: String,
    },
}

/// What came with a command, if it is what the net declares.
pub(super) fn fitting(net: &Net, command: &Command, arguments: &[String]) -> Result<(), FireError> {
    let parameters = &command.parameters;
    if parameters.is_empty() {
        return Ok(());
    }
    let what = if parameters.len() == arguments.len() {
        let mut pairs = parameters.iter().zip(arguments);
        match pairs.find(|(parameter, word)| parameter.kind.read(word).is_none()) {
            None => return Ok(()),
            Some((parameter, word)) => {
                let word: String = word.chars().take(40).collect();
                format!(
                    "and `{word}` is no {} for `{}`",
                    parameter.kind, parameter.name
                )
            }
        }
    } else {
        format!("and {} came with it", arguments.len())
    };
    let wanted: Vec<String> = parameters
        .iter()
        .map(|one| format!("{} : {}", one.name, one.kind))
        .collect();
    Err(FireError::Arguments {
        net: net.name().to_owned(),
        symbol: command.symbol.clone(),
        wanted: wanted.join(", "),
        what,
    })
}

pub(super) fn unknown_symbol(net: &Net, symbol: &str) -> FireError {
    let accepted: Vec<&str> = net.commands().iter().map(|c| c.symbol.as_str()).collect();
    FireError::UnknownSymbol {
        net: net.name().to_owned(),
        symbol: symbol.to_owned(),
        accepted: if accepted.is_empty() {
            "none".to_owned()
        } else {
            accepted.join(", ")
        },
    }
}
