//! What goes between the server and the page: one JSON object a message.

use pnt::{
    layout::Drawing,
    stream::{Event, NetView, State},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What a page is told.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub(crate) enum Told<'t> {
    /// First: the app, what the page may do, and which nets follow.
    Hello {
        app: &'t str,
        /// `live` or `record`.
        mode: &'t str,
        control: bool,
        nets: Vec<&'t str>,
        displays: Vec<Overview>,
        /// When the app began, ns since 1970; not known of a record.
        origin_ns: Option<u64>,
    },
    /// A net with all that is known of its past.
    Net {
        net: &'t str,
        view: &'t NetView,
        written: &'t Drawing,
        full: &'t Drawing,
        base: &'t State,
        entries: Vec<Entry<'t>>,
        gone: Option<&'t str>,
        breakpoints: &'t [Breakpoint],
        notes: &'t [Note],
        now_ns: u64,
    },
    /// What a net did.
    Events { net: &'t str, events: &'t [Event] },
    /// Where a net is, after some events that are not told.
    State {
        net: &'t str,
        state: &'t State,
        skipped: u64,
    },
    /// A net cannot be reached.
    Gone { net: &'t str, reason: &'t str },
    /// The breakpoints of a net.
    Breakpoints {
        net: &'t str,
        breakpoints: &'t [Breakpoint],
    },
    /// Somebody has moved nodes of a net.
    Drawing {
        net: &'t str,
        written: &'t Drawing,
        full: &'t Drawing,
    },
    /// Somebody has moved nodes of an overview display.
    Displays { displays: Vec<Overview> },
    /// What the analysis found.
    Notes { notes: &'t [Note] },
    /// How a task is.
    Task { task: TaskState },
    /// What became of an order.
    Answer { id: u64, ok: bool, text: String },
    /// The app has ended.
    End {},
}

/// An event, or a state where events are not known.
#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
pub(crate) enum Entry<'t> {
    Event(&'t Event),
    State { state: &'t State, skipped: u64 },
}

/// Nodes of several nets, chosen by a person.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Overview {
    pub(crate) name: String,
    pub(crate) title: String,
    pub(crate) parts: Vec<OverviewPart>,
}

/// What an overview shows of one net.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct OverviewPart {
    pub(crate) net: String,
    pub(crate) drawing: Drawing,
}

/// A breakpoint.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Breakpoint {
    /// As it is written for the net.
    pub(crate) at: String,
    pub(crate) transition: Option<String>,
    pub(crate) place: Option<String>,
}

/// A finding about a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Note {
    pub(crate) net: String,
    pub(crate) node: String,
    pub(crate) severity: &'static str,
    pub(crate) message: String,
    pub(crate) at: String,
}

/// A task, as far as it says.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct TaskState {
    pub(crate) name: String,
    pub(crate) on: String,
    pub(crate) handled: u64,
    pub(crate) failed: u64,
    pub(crate) busy: bool,
    /// The command at hand, or the last one.
    pub(crate) command: Option<String>,
    pub(crate) error: Option<String>,
}

/// What a page asks for.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(crate) struct Asked {
    /// `task`, or an order for a net.
    pub(crate) kind: String,
    /// Its number on this connection, for the answer.
    #[serde(default)]
    pub(crate) id: u64,
    #[serde(default)]
    pub(crate) net: String,
    #[serde(default)]
    pub(crate) task: String,
    #[serde(default)]
    pub(crate) transition: Option<String>,
    #[serde(default)]
    pub(crate) place: Option<String>,
    /// A node that was moved, the overview display on which it was, and its centre, px.
    #[serde(default)]
    pub(crate) node: Option<String>,
    #[serde(default)]
    pub(crate) display: Option<String>,
    #[serde(default)]
    pub(crate) at: Option<[f64; 2]>,
}

impl Told<'_> {
    /// The message as it is sent.
    pub(crate) fn text(&self) -> String {
        // Maps have text keys and numbers are finite: it is always JSON.
        serde_json::to_string(self).unwrap_or_else(|_| Value::Null.to_string())
    }
}
