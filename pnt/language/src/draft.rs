//! A net as it was written: names with their places in the file, nothing resolved yet.
//! Its printed form is net text again. Knows neither how text is parsed nor what a net means.

mod print;

use std::{fmt, time::Duration};

use ctos::diagnostic::{Place as At, Source};

pub(crate) use print::InText;

use crate::timing::{Servers, Timing};

/// A name and where it stands. Two words are equal when they read the same.
#[derive(Debug, Clone)]
pub struct Word {
    /// The name.
    pub text: String,
    /// Where it stands.
    pub at: At,
}

impl Word {
    /// A word at a place of a text.
    #[must_use]
    pub fn new(text: impl Into<String>, at: At) -> Self {
        Self {
            text: text.into(),
            at,
        }
    }

    /// Another name that stands for the same place of the text, such as that of a generated part.
    #[must_use]
    pub fn derived(&self, text: impl Into<String>) -> Self {
        Self::new(text, self.at.clone())
    }
}

impl PartialEq for Word {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text
    }
}

impl Eq for Word {}

impl From<&str> for Word {
    /// A word that no file holds; findings about it show the word itself.
    fn from(text: &str) -> Self {
        let source = Source::new("built in code", text);
        Self::new(text, source.at(0..text.len()))
    }
}

impl fmt::Display for Word {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// A place as declared.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftPlace {
    /// Its name.
    pub name: Word,
    /// Tokens of the initial marking.
    pub tokens: u32,
    /// The most tokens it may hold.
    pub capacity: Option<u32>,
    /// The data object whose validity the place says.
    pub data: Option<Word>,
}

impl DraftPlace {
    /// A place without tokens, capacity and data object.
    #[must_use]
    pub fn new(name: Word) -> Self {
        Self {
            name,
            tokens: 0,
            capacity: None,
            data: None,
        }
    }
}

/// A name and the type of its value: `int`, `float`, `bool`, `text` or a unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftField {
    /// The name.
    pub name: Word,
    /// The type as written.
    pub kind: Word,
}

/// Data that the net declares and keeps itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftData {
    /// Its name.
    pub name: Word,
    /// What it consists of.
    pub shape: DraftShape,
}

/// What declared data consists of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DraftShape {
    /// One value.
    One {
        /// Its type.
        kind: Word,
        /// What it is at first: an expression without names.
        initial: Option<Word>,
    },
    /// Fields, each of which is one value.
    Fields(Vec<DraftField>),
}

/// A symbol of the input tape and the output symbols that answer it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftCommand {
    /// The input symbol.
    pub symbol: Word,
    /// What comes with it, if the net says so.
    pub parameters: Vec<DraftField>,
    /// The output symbols; exactly one of them is written per command.
    pub answers: Vec<Word>,
}

/// The requester's side of a coordination structure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftCoordinator {
    /// The coordinator's net.
    pub net: Word,
    /// What is asked of it.
    pub requests: Vec<Word>,
}

/// The coordinator's side of a coordination structure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftServes {
    /// The requester's net.
    pub net: Word,
    /// What it may ask.
    pub requests: Vec<Word>,
    /// The place that is marked when a request is done.
    pub done: Word,
    /// The place that is marked when a request has failed.
    pub failed: Option<Word>,
}

/// An arc: a place of this net, or (outputs only) of another one, and its weight.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftArc {
    /// The place.
    pub place: Word,
    /// The net of a remote place.
    pub net: Option<Word>,
    /// Tokens moved or compared.
    pub weight: u32,
}

impl DraftArc {
    /// An arc of weight one to a place of this net.
    #[must_use]
    pub fn local(place: Word) -> Self {
        Self {
            place,
            net: None,
            weight: 1,
        }
    }

    /// An arc of weight one to a place of another net.
    #[must_use]
    pub fn remote(place: Word, net: Word) -> Self {
        Self {
            place,
            net: Some(net),
            weight: 1,
        }
    }
}

/// An enabling function or its negation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftWhen {
    /// The function's name, or the text of the expression.
    pub function: Word,
    /// Whether the transition is enabled when it says no.
    pub negated: bool,
    /// Whether it is an expression. A single name may be one, too: that of declared data.
    pub expression: bool,
}

/// What a transition does between taking its tokens and putting them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DraftAction {
    /// Calls a local function.
    Do {
        /// Its name.
        function: Word,
        /// The data objects that are its arguments.
        inputs: Vec<Word>,
        /// The data objects that its result is stored as: all of it, or its fields in order.
        outputs: Vec<Word>,
    },
    /// Hands a request to a coordinator through the coordination structure.
    Ask {
        /// The coordinator's net.
        coordinator: Word,
        /// The request.
        request: Word,
    },
    /// Sends a message and waits for its reply.
    Send {
        /// The task's symbolic name.
        task: Word,
        /// The command's name.
        command: Word,
        /// The data objects that go along, one after the other.
        inputs: Vec<Word>,
        /// The data objects that the reply is stored as: all of it, or its fields in order.
        outputs: Vec<Word>,
    },
    /// Asks a service object by a line of text, in which `$name` stands for a value.
    Request {
        /// The line.
        line: Word,
    },
    /// Waits.
    Wait {
        /// How long, in whole microseconds.
        time: Duration,
        /// Where it stands.
        at: Spot,
    },
    /// Writes a line of the log, in which `$name` stands for a value.
    Log {
        /// The line.
        line: Word,
    },
}

/// A place of the text. Any two are equal, as words are that read the same.
#[derive(Debug, Clone)]
pub struct Spot(pub At);

impl PartialEq for Spot {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Spot {}

/// Declared data gets a value when the action is complete.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftSet {
    /// The data, or a field of it with a point between.
    pub target: Word,
    /// An expression, or `reply`: what the request was answered with.
    pub value: Word,
}

impl DraftSet {
    /// What stands for the answer to a request.
    pub const REPLY: &'static str = "reply";
}

/// A transition as written.
#[derive(Debug, Clone, PartialEq)]
pub struct DraftTransition {
    /// Its name.
    pub name: Word,
    /// Input arcs.
    pub inputs: Vec<DraftArc>,
    /// Read arcs: needed, not taken.
    pub reads: Vec<DraftArc>,
    /// Inhibitor arcs: enabled while the place holds fewer tokens than the weight.
    pub inhibitors: Vec<DraftArc>,
    /// Places that it empties when it starts.
    pub resets: Vec<Word>,
    /// Input tape symbol.
    pub tape: Option<Word>,
    /// Enabling function.
    pub when: Option<DraftWhen>,
    /// Action.
    pub action: Option<DraftAction>,
    /// What data becomes when the action is complete, in order.
    pub sets: Vec<DraftSet>,
    /// Output arcs.
    pub outputs: Vec<DraftArc>,
    /// Failure branch; empty means that the tokens go back.
    pub fail: Vec<DraftArc>,
    /// Output tape symbol.
    pub write: Option<Word>,
    /// Higher goes first.
    pub priority: u32,
    /// Limit of the action, in whole microseconds.
    pub within: Option<Duration>,
    /// Its time.
    pub timing: Timing,
    /// Its share in conflicts of equal priority that chance decides.
    pub weight: f64,
    /// How many of its firings may go on at once, if it says so.
    pub servers: Option<Servers>,
    /// Whether its action may be asked again after a crash.
    pub idempotent: bool,
}

impl DraftTransition {
    /// A transition without arcs.
    #[must_use]
    pub fn new(name: Word) -> Self {
        Self {
            name,
            inputs: Vec::new(),
            reads: Vec::new(),
            inhibitors: Vec::new(),
            resets: Vec::new(),
            tape: None,
            when: None,
            action: None,
            sets: Vec::new(),
            outputs: Vec::new(),
            fail: Vec::new(),
            write: None,
            priority: 0,
            within: None,
            timing: Timing::Immediate,
            weight: 1.0,
            servers: None,
            idempotent: false,
        }
    }
}

/// A whole net as written.
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// Its name, by which other nets address its places.
    pub name: Word,
    /// One sentence about it.
    pub title: Option<String>,
    /// Places in declared order.
    pub places: Vec<DraftPlace>,
    /// Data that the net keeps itself.
    pub data: Vec<DraftData>,
    /// Commands of the input tape.
    pub commands: Vec<DraftCommand>,
    /// Coordinators that this net asks.
    pub coordinators: Vec<DraftCoordinator>,
    /// Requesters that this net serves.
    pub serves: Vec<DraftServes>,
    /// Markings at which the net may be replaced, each by the tokens it needs.
    pub safe: Vec<Vec<DraftArc>>,
    /// Transitions in declared order, which decides conflicts of equal priority.
    pub transitions: Vec<DraftTransition>,
}

impl Draft {
    /// An empty net.
    #[must_use]
    pub fn new(name: Word) -> Self {
        Self {
            name,
            title: None,
            places: Vec::new(),
            data: Vec::new(),
            commands: Vec::new(),
            coordinators: Vec::new(),
            serves: Vec::new(),
            safe: Vec::new(),
            transitions: Vec::new(),
        }
    }
}
