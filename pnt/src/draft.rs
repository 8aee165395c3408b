//! A net as it was written: names with their places in the file, nothing resolved yet.
//! Its printed form is net text again. Knows neither how text is parsed nor what a net means.

use std::{fmt, time::Duration};

use ctos::diagnostic::{Place as At, Source};

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
    /// The data object whose validity the place says.
    pub data: Option<Word>,
}

/// A symbol of the input tape and the output symbols that answer it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftCommand {
    /// The input symbol.
    pub symbol: Word,
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
    /// The function's name.
    pub function: Word,
    /// Whether the transition is enabled when it says no.
    pub negated: bool,
}

/// What a transition does between taking its tokens and putting them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DraftAction {
    /// Calls a local function.
    Do(Word),
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
        /// The data object that goes along.
        input: Option<Word>,
        /// The data object that the reply is stored as.
        output: Option<Word>,
    },
}

/// A transition as written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DraftTransition {
    /// Its name.
    pub name: Word,
    /// Input arcs.
    pub inputs: Vec<DraftArc>,
    /// Read arcs: needed, not taken.
    pub reads: Vec<DraftArc>,
    /// Inhibitor arcs: enabled while the place holds fewer tokens than the weight.
    pub inhibitors: Vec<DraftArc>,
    /// Input tape symbol.
    pub tape: Option<Word>,
    /// Enabling function.
    pub when: Option<DraftWhen>,
    /// Action.
    pub action: Option<DraftAction>,
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
            tape: None,
            when: None,
            action: None,
            outputs: Vec::new(),
            fail: Vec::new(),
            write: None,
            priority: 0,
            within: None,
        }
    }
}

/// A whole net as written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Draft {
    /// Its name, by which other nets address its places.
    pub name: Word,
    /// One sentence about it.
    pub title: Option<String>,
    /// Places in declared order.
    pub places: Vec<DraftPlace>,
    /// Commands of the input tape.
    pub commands: Vec<DraftCommand>,
    /// Coordinators that this net asks.
    pub coordinators: Vec<DraftCoordinator>,
    /// Requesters that this net serves.
    pub serves: Vec<DraftServes>,
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
            commands: Vec::new(),
            coordinators: Vec::new(),
            serves: Vec::new(),
            transitions: Vec::new(),
        }
    }
}

/// Prints `items` with commas between them.
struct List<'a, T>(&'a [T]);

impl<T: fmt::Display> fmt::Display for List<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, item) in self.0.iter().enumerate() {
            if index > 0 {
                f.write_str(", ")?;
            }
            item.fmt(f)?;
        }
        Ok(())
    }
}

impl fmt::Display for DraftPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.name)?;
        if self.tokens > 0 {
            write!(f, " = {}", self.tokens)?;
        }
        if let Some(data) = &self.data {
            write!(f, " data {data}")?;
        }
        Ok(())
    }
}

impl fmt::Display for DraftArc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.place)?;
        if let Some(net) = &self.net {
            write!(f, "@{net}")?;
        }
        if self.weight != 1 {
            write!(f, "*{}", self.weight)?;
        }
        Ok(())
    }
}

impl fmt::Display for DraftAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Do(function) => write!(f, "do {function}"),
            Self::Ask {
                coordinator,
                request,
            } => write!(f, "ask {coordinator} {request}"),
            Self::Send {
                task,
                command,
                input,
                output,
            } => {
                write!(f, "send {task}.{command}")?;
                match (input, output) {
                    (None, None) => Ok(()),
                    (Some(input), None) => write!(f, "({input})"),
                    (None, Some(output)) => write!(f, "(-> {output})"),
                    (Some(input), Some(output)) => write!(f, "({input} -> {output})"),
                }
            }
        }
    }
}

impl fmt::Display for DraftTransition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let arcs = |f: &mut fmt::Formatter<'_>, keyword: &str, arcs: &[DraftArc]| {
            if arcs.is_empty() {
                Ok(())
            } else {
                writeln!(f, "  {keyword} {}", List(arcs))
            }
        };
        writeln!(f, "transition {}", self.name)?;
        arcs(f, "in", &self.inputs)?;
        arcs(f, "read", &self.reads)?;
        arcs(f, "inhibit", &self.inhibitors)?;
        if let Some(tape) = &self.tape {
            writeln!(f, "  tape {tape}")?;
        }
        if let Some(when) = &self.when {
            let not = if when.negated { "not " } else { "" };
            writeln!(f, "  when {not}{}", when.function)?;
        }
        if let Some(action) = &self.action {
            writeln!(f, "  {action}")?;
        }
        arcs(f, "out", &self.outputs)?;
        arcs(f, "fail", &self.fail)?;
        if let Some(symbol) = &self.write {
            writeln!(f, "  write {symbol}")?;
        }
        if self.priority > 0 {
            writeln!(f, "  priority {}", self.priority)?;
        }
        if let Some(within) = self.within {
            let micros = within.as_micros();
            writeln!(f, "  within {}.{:03} ms", micros / 1000, micros % 1000)?;
        }
        Ok(())
    }
}

impl fmt::Display for Draft {
    /// Net text; parsing it gives an equal draft.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "net {}", self.name)?;
        match &self.title {
            Some(title) => writeln!(f, " \"{title}\"")?,
            None => writeln!(f)?,
        }
        for place in &self.places {
            writeln!(f, "place {place}")?;
        }
        for command in &self.commands {
            writeln!(
                f,
                "command {} -> {}",
                command.symbol,
                List(&command.answers)
            )?;
        }
        for coordinator in &self.coordinators {
            let requests = List(&coordinator.requests);
            writeln!(f, "coordinator {} : {requests}", coordinator.net)?;
        }
        for serves in &self.serves {
            let requests = List(&serves.requests);
            write!(
                f,
                "serves {} : {requests} ; done {}",
                serves.net, serves.done
            )?;
            if let Some(failed) = &serves.failed {
                write!(f, " ; failed {failed}")?;
            }
            writeln!(f)?;
        }
        for transition in &self.transitions {
            write!(f, "{transition}")?;
        }
        Ok(())
    }
}
