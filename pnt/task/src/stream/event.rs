//! Events and states, as they are sent, recorded and shown. They name places and transitions, so that a
//! record is readable by itself.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::NetView;

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventPhase {
    /// A transition without action took its tokens and put its tokens.
    Fired,
    /// A transition took its tokens; its action goes on.
    Started,
    /// The action is complete; the transition put its tokens.
    Completed,
    /// The action has failed: the tokens of the failure branch are put, or those taken are back.
    Failed,
    /// The action was cancelled from outside; what was taken is back.
    Cancelled,
    /// Tokens came from another net.
    Received,
    /// A symbol was put at the end of the input tape.
    Asked,
    /// A person put tokens into a place.
    Put,
    /// A person took tokens out of a place.
    Taken,
    /// A person intervened in another way; the text says how.
    Ordered,
    /// A person stopped the net for a while, or a breakpoint did.
    Paused,
    /// The net goes on after a pause.
    Resumed,
    /// The net has stopped for good.
    Stopped,
}

impl EventPhase {
    /// Its word in records and on displays.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Fired => "fired",
            Self::Started => "started",
            Self::Completed => "completed",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
            Self::Received => "received",
            Self::Asked => "asked",
            Self::Put => "put",
            Self::Taken => "taken",
            Self::Ordered => "ordered",
            Self::Paused => "paused",
            Self::Resumed => "resumed",
            Self::Stopped => "stopped",
        }
    }

    /// What happened to the transition that the author wrote: the parts of a request fire in one step each.
    /// `part` is that of a [`TransitionView`](super::TransitionView).
    #[must_use]
    pub fn of_part(self, part: &str) -> Self {
        match (self, part) {
            (Self::Fired, "start") => Self::Started,
            (Self::Fired, "end") => Self::Completed,
            (Self::Fired, "fail" | "back") => Self::Failed,
            (phase, _) => phase,
        }
    }
}

impl fmt::Display for EventPhase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

/// Tokens on their way to a place of another net.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sent {
    /// The other net.
    pub net: String,
    /// Its place.
    pub place: String,
    /// How many.
    pub tokens: u32,
}

/// One event of a net.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// Its number, counted from 1 since the net's task began.
    pub seq: u64,
    /// When, ns since the start of the app.
    pub at_ns: u64,
    /// The net.
    pub net: String,
    /// The transition; empty when the event is none of a transition's.
    pub transition: String,
    /// What happened.
    pub phase: EventPhase,
    /// Why it failed or stopped, who sent tokens, what came with a symbol; empty otherwise.
    pub text: String,
    /// Which firing of those with an action, counted since the net began.
    pub firing: Option<u64>,
    /// Tokens taken, by place.
    pub consumed: Vec<(String, u32)>,
    /// Tokens put, by place.
    pub produced: Vec<(String, u32)>,
    /// Tokens sent to other nets.
    pub sent: Vec<Sent>,
    /// The symbol that was read from the input tape; put at its end when the phase is `asked`; back at its
    /// front after a failure.
    pub read: Option<String>,
    /// The symbol that was written to the output tape.
    pub wrote: Option<String>,
    /// What the action calls: `task.command`, or a local function; empty without an action.
    pub target: String,
    /// The trace of the message that made it possible, `CHASSIS.NUMBER`; empty when no message did.
    pub trace: String,
    /// Declared data that has changed, by name, with its new values as people write them.
    #[serde(default)]
    pub data: Vec<(String, String)>,
}

/// A firing whose action goes on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Running {
    /// The transition.
    pub transition: String,
    /// Which firing.
    pub firing: u64,
    /// When it started, ns since the start of the app.
    pub since_ns: u64,
}

/// A net at one moment. Lists go by the numbers of places and transitions in the net's
/// [view](super::NetView).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// The net.
    pub net: String,
    /// The last event before the moment.
    pub seq: u64,
    /// When, ns since the start of the app.
    pub at_ns: u64,
    /// Tokens per place.
    pub places: Vec<u32>,
    /// Firings between start and end, oldest first.
    pub running: Vec<Running>,
    /// Symbols on the input tape that have not been read, next one first.
    pub tape: Vec<String>,
    /// The command that has been read and not answered.
    pub in_progress: Option<String>,
    /// Firings that ended well, per transition.
    pub ended: Vec<u64>,
    /// Firings that failed, per transition.
    pub failed: Vec<u64>,
    /// Time spent in actions that have ended, ns, per transition.
    pub busy_ns: Vec<u64>,
    /// Why the net stands still for a while, if it does.
    pub paused: Option<String>,
    /// Why the net has stopped for good, if it has.
    pub stopped: Option<String>,
    /// The values of declared data, as people write them, by number.
    #[serde(default)]
    pub data: Vec<String>,
}

impl State {
    /// A net at its initial marking.
    #[must_use]
    pub fn initial(view: &NetView) -> Self {
        let count = view.transitions.len();
        Self {
            net: view.name.clone(),
            seq: 0,
            at_ns: 0,
            places: view.places.iter().map(|place| place.tokens).collect(),
            running: Vec::new(),
            tape: Vec::new(),
            in_progress: None,
            ended: vec![0; count],
            failed: vec![0; count],
            busy_ns: vec![0; count],
            paused: None,
            stopped: None,
            data: view.data.iter().map(|data| data.initial.clone()).collect(),
        }
    }
}
