//! What goes between the server and the page: one JSON object a message.

use ctos::control::Level;
use pnt::{
    layout::Drawing,
    stream::{Event, NetView, State},
};
use scene::track::{SceneStep, Shown};
use scene_summary::Step;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    handles,
    panes::{Layout, Named},
    plans,
};

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
        /// The tasks of which more can be told.
        tasks: &'t [String],
        displays: Vec<Overview>,
        layouts: Vec<Named<'t>>,
        handles: Vec<handles::Named<'t>>,
        plans: Vec<plans::Named<'t>>,
        /// How many tasks show something of the scene.
        scenes: usize,
        /// The tasks that sum up those below them.
        summaries: Vec<&'t str>,
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
    /// Somebody has saved a layout.
    Layouts { layouts: Vec<Named<'t>> },
    /// What the analysis found.
    Notes { notes: &'t [Note] },
    /// How a task is.
    Task { task: TaskState },
    /// How the app stands as a whole.
    Standing { standing: &'t Standing },
    /// How loaded its tasks are at a moment.
    Load { at_ns: u64, tasks: &'t [Load] },
    /// What became of an order.
    Answer { id: u64, ok: bool, text: String },
    /// What a task shows of the scene, with all that is known of its past: the first step has all parts.
    Scene {
        source: &'t str,
        gone: Option<&'t str>,
        steps: Vec<&'t SceneStep>,
    },
    /// What changed of it.
    Moved {
        source: &'t str,
        step: &'t SceneStep,
    },
    /// It cannot be seen.
    Dark { source: &'t str, reason: &'t str },
    /// What a task sums up, or what of it has changed.
    Summary { source: &'t str, step: &'t Step },
    /// It cannot be asked.
    Unsummed { source: &'t str, reason: &'t str },
    /// A net is not followed any more.
    Left { net: &'t str },
    /// A picture of a camera.
    Picture { picture: &'t Shown },
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

/// A task at a moment, or all that a record says of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct TaskState {
    pub(crate) name: String,
    /// Its chassis; empty where that is not known.
    pub(crate) on: String,
    /// What is told of a running app only.
    pub(crate) now: Option<TaskNow>,
    /// The messages that it handled last, oldest first.
    pub(crate) messages: Vec<TaskMessage>,
    /// So many are not told, because there are too many.
    pub(crate) left_out: u64,
    /// The last lines of the log about it, oldest first.
    pub(crate) lines: Vec<TaskLine>,
    /// Why nothing is known.
    pub(crate) error: Option<String>,
}

/// How a task is.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct TaskNow {
    pub(crate) handled: u64,
    pub(crate) failed: u64,
    pub(crate) queued: u64,
    pub(crate) restarts: u64,
    /// What it does, in words; `None` when it is idle.
    pub(crate) doing: Option<String>,
    /// Whom it waits for, longest first.
    pub(crate) waits: Vec<TaskWait>,
    /// What it says that it is at, and until when if that is known, ns.
    pub(crate) at: Option<String>,
    pub(crate) until_ns: Option<u64>,
}

/// Somebody whom a task waits for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct TaskWait {
    pub(crate) to: String,
    pub(crate) command: String,
}

/// A message that a task handled.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct TaskMessage {
    /// When its handler was called, ns.
    pub(crate) at_ns: u64,
    pub(crate) from: String,
    pub(crate) command: String,
    /// How long the handler took; `None` while it has not returned.
    pub(crate) took_ns: Option<u64>,
    /// Why it failed, if it did.
    pub(crate) failed: Option<String>,
}

/// A line of the log about a task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct TaskLine {
    at_ns: u64,
    level: Level,
    text: String,
}

/// How an app stands as a whole.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Standing {
    /// Its chassis, in declared order; none of a record.
    pub(crate) chassis: Vec<ChassisStanding>,
    /// The last lines of the log that warn, oldest first.
    pub(crate) warnings: Vec<Warning>,
}

/// A task: its name, the messages that wait for it, those that it has handled, and how long that took, s.
pub(crate) type Load = (String, u64, u64, f64);

/// How a chassis is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct ChassisStanding {
    pub(crate) name: String,
    /// In words.
    pub(crate) state: String,
    /// Whether its tasks run and it answers.
    pub(crate) fine: bool,
    /// How often its process was started again.
    pub(crate) restarts: u32,
    /// Why the process before this one ended.
    pub(crate) last_end: Option<String>,
    /// How many tasks it has.
    pub(crate) tasks: usize,
}

/// A line of the log that warns.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Warning {
    /// Since the start of the app.
    pub(crate) at_ns: u64,
    pub(crate) level: Level,
    /// The chassis; of a record the task or the module.
    pub(crate) from: String,
    pub(crate) text: String,
}

impl TaskLine {
    /// What a line of `at_ns` says after its time and its level.
    pub(crate) fn new(at_ns: u64, level: Level, text: &str) -> Self {
        let text = text.to_owned();
        Self { at_ns, level, text }
    }

    /// The same as a warning `from` somebody, if it is one.
    pub(crate) fn warning(&self, from: String) -> Option<Warning> {
        let Self { at_ns, level, text } = self;
        (*level >= Level::Warn).then(|| Warning {
            at_ns: *at_ns,
            level: *level,
            from,
            text: text.clone(),
        })
    }
}

/// What a page asks for.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(crate) struct Asked {
    /// `task` or `follow`, which only look; or an order for a net or a task.
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
    /// What of a place a breakpoint waits for: `>=`, `=` or `<=`, and a number.
    #[serde(default)]
    pub(crate) when: Option<String>,
    /// A breakpoint as it was written.
    #[serde(default)]
    pub(crate) breakpoint: Option<String>,
    /// A node that was moved, the overview display on which it was, and its centre, px.
    #[serde(default)]
    pub(crate) node: Option<String>,
    #[serde(default)]
    pub(crate) display: Option<String>,
    #[serde(default)]
    pub(crate) at: Option<[f64; 2]>,
    /// A question that waits for a person, and what is decided.
    #[serde(default)]
    pub(crate) key: String,
    #[serde(default)]
    pub(crate) choice: String,
    /// A command for the net's tape, word by word.
    #[serde(default)]
    pub(crate) words: Vec<String>,
    /// A layout to be saved, and its name.
    #[serde(default)]
    pub(crate) layout: Option<Layout>,
    #[serde(default)]
    pub(crate) name: String,
}

impl Told<'_> {
    /// The message as it is sent.
    pub(crate) fn text(&self) -> String {
        // Maps have text keys and numbers are finite: it is always JSON.
        serde_json::to_string(self).unwrap_or_else(|_| Value::Null.to_string())
    }
}
