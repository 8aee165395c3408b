//! The compiled net: everything resolved to numbers, coordination structures expanded. Made by
//! [`crate::compile`], so a net in hand is well formed. Knows no marking but the initial one.

use std::{
    ops::{Index, Range},
    sync::OnceLock,
    time::Duration,
};

use ctos::diagnostic::Place as At;
use serde::{Deserialize, Serialize};

pub use crate::timing::{Servers, Timing};
use crate::{
    data::{Declared, Kind, Parameter},
    expression::Expression,
};

macro_rules! number {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        pub struct $name(pub u32);

        impl $name {
            /// Its position in the net's list.
            #[must_use]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl From<$name> for u32 {
            fn from(id: $name) -> Self {
                id.0
            }
        }
    };
}

number! {
    /// Number of a place in its net.
    PlaceId
}
number! {
    /// Number of a transition in its net.
    TransitionId
}
number! {
    /// Number of a command (an input tape symbol) in its net.
    CommandId
}

/// What a place is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Declared by the author.
    Declared,
    /// Part of a coordination structure (`SI`, `I`, `O`, `OF`, `SO`, `..._active`).
    Coordination,
}

/// A place.
#[derive(Debug, Clone)]
pub struct Place {
    /// Its name, unique in the net.
    pub name: String,
    /// Tokens of the initial marking.
    pub tokens: u32,
    /// The most tokens it may hold, by the strict rule. A transition starts only if, after it has
    /// taken its tokens, there is space for all that it may put at its end. That is its `out`
    /// places, and its `fail` places or what it took. That space is reserved for it until then.
    pub capacity: Option<u32>,
    /// The data object whose validity it says.
    pub data: Option<String>,
    /// Who made it.
    pub role: Role,
    /// Where it stands in the net text.
    pub at: At,
}

/// An arc to or from a place of the same net.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arc {
    /// The place.
    pub place: PlaceId,
    /// Tokens moved or compared, at least one.
    pub weight: u32,
}

/// An output arc to a place of another net: a token message.
#[derive(Debug, Clone)]
pub struct RemoteArc {
    /// The other net.
    pub net: String,
    /// Its place.
    pub place: String,
    /// Tokens sent, at least one.
    pub weight: u32,
    /// Whether the arc belongs to a coordination structure.
    pub role: Role,
    /// Where the net text asks for it.
    pub at: At,
}

/// Two are equal when they send the same tokens to the same place.
impl PartialEq for RemoteArc {
    fn eq(&self, other: &Self) -> bool {
        (&self.net, &self.place, self.weight) == (&other.net, &other.place, other.weight)
    }
}

/// Output arcs of one end of a transition.
#[derive(Debug, Clone, Default)]
pub struct Outputs {
    /// Within the net.
    pub local: Vec<Arc>,
    /// To other nets.
    pub remote: Vec<RemoteArc>,
}

/// An enabling function or an expression, asserted or negated.
#[derive(Debug, Clone)]
pub struct When {
    /// The function's name, or the text of the expression.
    pub function: String,
    /// What it is, if it is an expression over declared data.
    pub expression: Option<Expression>,
    /// Whether the transition is enabled when it says no.
    pub negated: bool,
    /// Where it stands.
    pub at: At,
}

/// What happens between taking tokens and putting them.
#[derive(Debug, Clone)]
pub enum Action {
    /// A local function.
    Local {
        /// Its name.
        function: String,
        /// The data objects that are its arguments: each is one, or one of them is all.
        inputs: Vec<String>,
        /// The data objects that its result is stored as: one for all of it, or several for its
        /// fields in order.
        outputs: Vec<String>,
        /// Whether it may be called again when a crash left open how it ended.
        idempotent: bool,
        /// Where it stands.
        at: At,
    },
    /// A message to a task.
    Message {
        /// The task's symbolic name.
        task: String,
        /// The command's name.
        command: String,
        /// The data objects that go along: their bytes, one after the other, are the request.
        inputs: Vec<String>,
        /// The data objects that the reply is stored as: one for all of it, or several for its
        /// fields in order.
        outputs: Vec<String>,
        /// Whether it may be sent again when a crash left open how it ended.
        idempotent: bool,
        /// Where the task's name stands.
        at: At,
    },
    /// What stands in the net's text itself.
    Written {
        /// What is done.
        does: Option<Does>,
        /// What data becomes when that is complete, in order: all of it, or nothing when one fails.
        sets: Vec<Set>,
        /// Whether it may be done again when a crash left open how it ended.
        idempotent: bool,
        /// Where it stands.
        at: At,
    },
}

/// What an action in the net's text does.
#[derive(Debug, Clone)]
pub enum Does {
    /// Asks a service object.
    Request(Line),
    /// Waits.
    Wait(Duration),
    /// Writes a line of the log.
    Log(Line),
}

/// A line of text with values in it.
#[derive(Debug, Clone)]
pub struct Line {
    /// As it is written.
    pub text: String,
    /// What it consists of.
    pub parts: Vec<LinePart>,
    /// Where it stands.
    pub at: At,
}

/// A part of a line.
#[derive(Debug, Clone)]
pub enum LinePart {
    /// Text as it is.
    Text(String),
    /// `$name`: one value, or the fields of one name.
    Values {
        /// The name.
        name: String,
        /// The names of the values, and their types.
        values: Vec<(String, Kind)>,
        /// Where it stands.
        at: At,
    },
}

impl Line {
    /// The line with a text in the place of each of its values, blanks between the fields of one name.
    pub fn filled(&self, mut value: impl FnMut(&str) -> String) -> String {
        let mut out = String::new();
        for part in &self.parts {
            match part {
                LinePart::Text(text) => out.push_str(text),
                LinePart::Values { values, .. } => {
                    let values = values.iter().map(|(name, _)| value(name));
                    out.push_str(&values.collect::<Vec<String>>().join(" "));
                }
            }
        }
        out
    }
}

/// Declared data gets a value.
#[derive(Debug, Clone)]
pub struct Set {
    /// The data, or a field of it with a point between.
    pub name: String,
    /// The numbers of its values.
    pub slots: Range<usize>,
    /// What it becomes.
    pub to: SetTo,
    /// Where it stands.
    pub at: At,
}

/// What data becomes.
#[derive(Debug, Clone)]
pub enum SetTo {
    /// What the request was answered with.
    Reply,
    /// What an expression says.
    Value(Expression),
}

/// Which part of a coordination structure a transition is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// As the author wrote it.
    Whole,
    /// Hands a request to the coordinator.
    Start,
    /// Takes back control after a finished request.
    End,
    /// Takes back control after a failed request; `branch` says whether the author wrote one.
    Fail {
        /// Whether there is a `fail` line.
        branch: bool,
    },
    /// Returns control to the requester.
    Return,
}

impl Part {
    /// What stands before the author's name in the name of the part.
    #[must_use]
    pub fn prefix(self) -> &'static str {
        match self {
            Self::Whole | Self::Return => "",
            Self::Start => "start_",
            Self::End => "end_",
            Self::Fail { .. } => "fail_",
        }
    }
}

/// A transition.
#[derive(Debug, Clone)]
pub struct Transition {
    /// Its name, unique in the net.
    pub name: String,
    /// Tokens it takes.
    pub inputs: Vec<Arc>,
    /// Tokens it needs and leaves.
    pub reads: Vec<Arc>,
    /// Enabled only while each of these places holds fewer tokens than the weight.
    pub inhibitors: Vec<Arc>,
    /// Places that it empties when it starts, after its inputs were taken. The tokens are gone: they do
    /// not come back when its action fails.
    pub resets: Vec<PlaceId>,
    /// The command that it reads from the input tape.
    pub tape: Option<CommandId>,
    /// Its enabling function.
    pub when: Option<When>,
    /// Its action; without one it fires in one step.
    pub action: Option<Action>,
    /// What it puts when the action is complete.
    pub outputs: Outputs,
    /// What it puts when the action has failed; without one, what it took goes back.
    pub fail: Option<Outputs>,
    /// What it writes to the output tape when the action is complete.
    pub write: Option<String>,
    /// Higher goes first; then declared order.
    pub priority: u32,
    /// Limit of the action.
    pub within: Option<Duration>,
    /// How long it takes from enabled to fired. Of a transition with an action, what the action is
    /// taken to last in stochastic simulation and analysis.
    pub timing: Timing,
    /// Its share in conflicts of equal priority that chance decides, above zero.
    pub weight: f64,
    /// How many of its firings may go on at once.
    pub servers: Servers,
    /// Which part of a coordination structure it is.
    pub part: Part,
    /// Where it stands in the net text.
    pub at: At,
}

/// A command of the input tape.
#[derive(Debug, Clone)]
pub struct Command {
    /// The input symbol.
    pub symbol: String,
    /// What comes with it, if the net says so.
    pub parameters: Vec<Parameter>,
    /// The output symbols, one of which answers it.
    pub answers: Vec<String>,
    /// Where it stands.
    pub at: At,
}

/// One end of a coordination structure.
#[derive(Debug, Clone)]
pub struct Partner {
    /// The net at the other end.
    pub net: String,
    /// Where its name stands.
    pub at: At,
    /// The requests, with their places in the text.
    pub requests: Vec<(String, At)>,
}

/// A compiled net.
#[derive(Debug, Clone)]
pub struct Net {
    pub(crate) name: String,
    pub(crate) at: At,
    pub(crate) title: Option<String>,
    pub(crate) places: Vec<Place>,
    pub(crate) declared: Declared,
    pub(crate) transitions: Vec<Transition>,
    pub(crate) commands: Vec<Command>,
    pub(crate) coordinators: Vec<Partner>,
    pub(crate) serves: Vec<Partner>,
    pub(crate) safe: Vec<Vec<Arc>>,
    /// Computed when it is first asked for: a durable net stores it with each state.
    pub(crate) digest: OnceLock<u64>,
}

impl Net {
    /// Its name, by which other nets address its places.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same net under another name.
    #[must_use]
    pub fn named(&self, name: &str) -> Self {
        Self {
            name: name.to_owned(),
            digest: OnceLock::new(),
            ..self.clone()
        }
    }

    /// Where its name stands.
    #[must_use]
    pub fn at(&self) -> &At {
        &self.at
    }

    /// One sentence about it.
    #[must_use]
    pub fn title(&self) -> Option<&str> {
        self.title.as_deref()
    }

    /// Places, declared ones first, in order of their numbers.
    #[must_use]
    pub fn places(&self) -> &[Place] {
        &self.places
    }

    /// Data that it keeps itself.
    #[must_use]
    pub fn declared(&self) -> &Declared {
        &self.declared
    }

    /// Transitions in order of their numbers, which is the declared order.
    #[must_use]
    pub fn transitions(&self) -> &[Transition] {
        &self.transitions
    }

    /// Commands of the input tape.
    #[must_use]
    pub fn commands(&self) -> &[Command] {
        &self.commands
    }

    /// Coordinators that this net asks.
    #[must_use]
    pub fn coordinators(&self) -> &[Partner] {
        &self.coordinators
    }

    /// Requesters that this net serves.
    #[must_use]
    pub fn serves(&self) -> &[Partner] {
        &self.serves
    }

    /// The declared safe markings, at which a running net may be replaced: each by the tokens that must
    /// at least be there. When none is declared, the rest (initial) marking is the only one.
    #[must_use]
    pub fn safe(&self) -> &[Vec<Arc>] {
        &self.safe
    }

    /// The same net with other places and transitions, and with neither tape nor partners: for analyses that
    /// rewrite a net before they run it. The transitions must name these places only.
    #[must_use]
    pub fn flattened(&self, places: Vec<Place>, transitions: Vec<Transition>) -> Self {
        Self {
            places,
            transitions,
            commands: Vec::new(),
            coordinators: Vec::new(),
            serves: Vec::new(),
            ..self.clone()
        }
    }

    /// Whether the net may be replaced at a marking (tokens in order of place number), provided that no
    /// action is going on.
    #[must_use]
    pub fn is_safe(&self, marking: &[u32]) -> bool {
        let holds = |arc: &Arc| marking.get(arc.place.index()) >= Some(&arc.weight);
        if self.safe.is_empty() {
            let rest = self.places.iter().map(|place| place.tokens);
            return rest.eq(marking.iter().copied());
        }
        self.safe.iter().any(|arcs| arcs.iter().all(holds))
    }

    /// The place called `name`.
    #[must_use]
    pub fn place(&self, name: &str) -> Option<PlaceId> {
        let index = self.places.iter().position(|place| place.name == name)?;
        u32::try_from(index).ok().map(PlaceId)
    }

    /// The transition called `name`.
    #[must_use]
    pub fn transition(&self, name: &str) -> Option<TransitionId> {
        let index = self.transitions.iter().position(|t| t.name == name)?;
        u32::try_from(index).ok().map(TransitionId)
    }

    /// The transition that its author calls `name`; a request is the part that begins it.
    #[must_use]
    pub fn written(&self, name: &str) -> Option<TransitionId> {
        let begins = |one: &Transition| one.part == Part::Start && one.written() == name;
        let request = || {
            let index = self.transitions.iter().position(begins)?;
            u32::try_from(index).ok().map(TransitionId)
        };
        self.transition(name).or_else(request)
    }

    /// The command whose symbol is `symbol`.
    #[must_use]
    pub fn command(&self, symbol: &str) -> Option<CommandId> {
        let index = self.commands.iter().position(|c| c.symbol == symbol)?;
        u32::try_from(index).ok().map(CommandId)
    }

    /// Every net whose places get tokens from this one, in order of name.
    #[must_use]
    pub fn remote_nets(&self) -> Vec<&str> {
        let mut nets: Vec<&str> = self
            .transitions
            .iter()
            .flat_map(|t| {
                t.outputs
                    .remote
                    .iter()
                    .chain(t.fail.iter().flat_map(|f| &f.remote))
            })
            .map(|arc| arc.net.as_str())
            .collect();
        nets.sort_unstable();
        nets.dedup();
        nets
    }
}

/// Numbers come from the net they are used with; see [`Net::place`].
impl Index<PlaceId> for Net {
    type Output = Place;
    fn index(&self, id: PlaceId) -> &Place {
        &self.places[id.index()]
    }
}

/// Numbers come from the net they are used with; see [`Net::transition`].
impl Index<TransitionId> for Net {
    type Output = Transition;
    fn index(&self, id: TransitionId) -> &Transition {
        &self.transitions[id.index()]
    }
}

/// Numbers come from the net they are used with; see [`Net::command`].
impl Index<CommandId> for Net {
    type Output = Command;
    fn index(&self, id: CommandId) -> &Command {
        &self.commands[id.index()]
    }
}

impl Transition {
    /// What its author calls it. The parts of a request are one transition in the net text.
    #[must_use]
    pub fn written(&self) -> &str {
        self.name
            .strip_prefix(self.part.prefix())
            .unwrap_or(&self.name)
    }

    /// Its firing in words: a part of a request begins or ends what the author wrote.
    #[must_use]
    pub fn step(&self) -> String {
        let does = match self.part {
            Part::Whole | Part::Return => "",
            Part::Start => " starts",
            Part::End => " completes",
            Part::Fail { .. } => " fails",
        };
        format!("{}{does}", self.written())
    }

    /// What people call it: a request by its author's name, and its ends by their own.
    #[must_use]
    pub fn called(&self) -> &str {
        match self.part {
            Part::Start => self.written(),
            _ => &self.name,
        }
    }
}

impl Action {
    /// Whether it may be asked again when a crash left open how it ended.
    #[must_use]
    pub fn is_idempotent(&self) -> bool {
        match self {
            Self::Local { idempotent, .. }
            | Self::Message { idempotent, .. }
            | Self::Written { idempotent, .. } => *idempotent,
        }
    }

    /// What it does, in a few words.
    #[must_use]
    pub fn called(&self) -> String {
        match self {
            Self::Local { function, .. } => function.clone(),
            Self::Message { task, command, .. } => format!("{task}.{command}"),
            Self::Written { does, sets, .. } => match does {
                Some(Does::Request(line)) => line.text.clone(),
                Some(Does::Wait(time)) => format!("wait {} s", time.as_secs_f64()),
                Some(Does::Log(line)) => format!("log {}", line.text),
                None => {
                    let names: Vec<&str> = sets.iter().map(|set| set.name.as_str()).collect();
                    format!("set {}", names.join(", "))
                }
            },
        }
    }
}
