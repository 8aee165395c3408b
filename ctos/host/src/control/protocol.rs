//! What is said over the control socket: one JSON object a line. Fields are only ever added. A request that this
//! version does not know is answered with an error, and the connection stays open. What is no request at all ends
//! it. At a port without keys a first line says its secret: `{"token":"..."}`.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::{
    control::{Level, LogLine},
    doors::Secret,
};
use ctos_bootstrap::bootstrap::{BootEvent, BootState, ChassisState};
use ctos_core::report::RecordReport;
pub use ctos_core::report::{Activity, TaskReport as TaskView, WaitReport as WaitView};
use ctos_link::security::Role;
use ctos_message::fault::Fault;

/// The version of the protocol.
pub const VERSION: u32 = 1;

/// The longest request with its end of line, bytes.
pub const REQUEST_LIMIT: usize = 1 << 20;

/// The error for a longer one.
#[must_use]
pub fn too_long(length: Option<usize>) -> String {
    let has = length.map_or_else(String::new, |length| format!(", and this one has {length}"));
    format!("a request to an app is one line of at most {REQUEST_LIMIT} bytes{has}")
}

/// The first line of a caller of a port without keys.
#[derive(Debug, Serialize, Deserialize)]
pub struct Shown {
    /// The secret of the port.
    pub token: Secret,
}

/// A line that a client writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ask {
    /// [`VERSION`].
    pub version: u32,
    /// What is asked for.
    pub request: Request,
}

/// What can be asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Request {
    /// How the app, its chassis and its tasks are: an [`Answer::App`].
    Ps {},
    /// Everything about one task or chassis: an [`Answer::Status`].
    Status {
        /// Its name.
        name: String,
    },
    /// Log lines: [`Answer::Log`]s, then [`Answer::Done`].
    Logs(LogRequest),
    /// Stops the app: [`Answer::Event`]s as it happens, then [`Answer::Ended`].
    Stop {
        /// Skips the polite stop of every task that does not answer at once.
        now: bool,
    },
    /// Restarts a task, or a chassis with all its tasks: [`Answer::Waiting`] every second, [`Answer::Done`] when it
    /// runs again.
    Restart {
        /// Its name.
        name: String,
    },
    /// Records the running app: [`Answer::Recording`] at once and every second, [`Answer::Recorded`] at its
    /// end. It ends after its time, by [`Request::RecordStop`], with the client and with the app. Needs the
    /// role `watch` from a client of the app's own user. A client of another host names a folder of the
    /// app's hosts, which needs the role `control`.
    Record(RecordRequest),
    /// Ends a record: [`Answer::Done`], and [`Answer::Recorded`] to the client that began it. Needs the
    /// role `control` from a client of another host.
    RecordStop {
        /// Its key, from [`RecordView`].
        key: u64,
    },
    /// Moves a running task: [`Answer::Moving`] at once and every second, then [`Answer::Moved`]. Needs
    /// the role `control`.
    Move {
        /// The task's name.
        task: String,
        /// `CHASSIS` or `CHASSIS:PROCESSOR`.
        to: String,
    },
    /// Sends a task one of its commands: an [`Answer::Reply`]. Needs the role `call`.
    Call {
        /// The task's name.
        task: String,
        /// The command's name.
        command: String,
        /// Its data: postcard in base64.
        data: String,
        /// How long the task may take to answer, s.
        within_s: f64,
    },
    /// Says a line of text to a task that takes such lines, for example one with the handler
    /// `sorma.daemon`: [`Answer::Said`]. Needs the role `call`. When the connection ends, the tasks that
    /// were spoken to over it are told that who spoke is gone.
    Say(SayRequest),
}

/// A line of text for a task.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct SayRequest {
    /// The task's name.
    pub task: String,
    /// The line.
    pub line: String,
    /// The number by which the request is followed; 0 when it is not.
    pub trace: u64,
    /// How long the boot waits for its answer, s; ten minutes when it is left out.
    pub limit_s: Option<f64>,
}

/// What is to be recorded.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RecordRequest {
    /// The folder, by its whole path. Each process writes `APP.CHASSIS.mcap` there; what is there already
    /// is kept.
    pub folder: String,
    /// The channels, in whose names `*` stands for any characters; none: all.
    pub channels: Vec<String>,
    /// For how long, s; without it, until it is stopped.
    pub for_s: Option<f64>,
}

impl Request {
    /// The role that a tool of another host needs for it.
    #[must_use]
    pub fn role(&self) -> Role {
        match self {
            Self::Ps {} | Self::Status { .. } | Self::Logs(_) => Role::Watch,
            Self::Call { .. } | Self::Say(_) => Role::Call,
            Self::Stop { .. }
            | Self::Restart { .. }
            | Self::Record(_)
            | Self::RecordStop { .. }
            | Self::Move { .. } => Role::Control,
        }
    }

    /// Its word on the wire.
    pub(crate) fn word(&self) -> String {
        let value = serde_json::to_value(self).unwrap_or_default();
        value["kind"].as_str().unwrap_or_default().to_owned()
    }
}

/// Which log lines.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LogRequest {
    /// Of this chassis, or about this task; all when absent.
    pub name: Option<String>,
    /// Those that matter at least so much.
    pub level: Option<Level>,
    /// Those from so many seconds after the start of the app on.
    pub since_s: Option<f64>,
    /// The last so many of those that there are.
    pub last: Option<usize>,
    /// And those that follow, until the app ends.
    pub follow: bool,
}

/// A line that the app answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Answer {
    /// The app.
    App(AppView),
    /// A task or a chassis.
    Status(Box<StatusView>),
    /// A log line.
    Log(LogLine),
    /// So many log lines were lost because they were not read in time.
    Lost {
        /// How many.
        lines: u64,
    },
    /// Something happened.
    Event {
        /// What.
        what: BootEvent,
    },
    /// The app has ended.
    Ended(EndView),
    /// The app is being recorded.
    Recording(RecordView),
    /// It was recorded.
    Recorded(RecordView),
    /// What a task answered.
    Reply {
        /// Its data: postcard in base64.
        data: String,
    },
    /// A task is on its way to another place.
    Moving(MoveView),
    /// It is there.
    Moved(MoveView),
    /// A restart is not over yet.
    Waiting {
        /// How long it has taken so far, s.
        took_s: f64,
        /// What it waits for.
        at: String,
    },
    /// What a task answered to a line of text.
    Said {
        /// Its line.
        line: String,
    },
    /// That was all.
    Done {},
    /// It could not be done.
    Error(ErrorView),
}

/// Why something could not be done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{message}")]
pub struct ErrorView {
    /// What kind of error.
    pub code: ErrorCode,
    /// What is wrong, and what to do.
    pub message: String,
    /// The names that there are, when the name is wrong.
    #[serde(default)]
    pub known: Vec<String>,
}

impl ErrorView {
    /// An error without other names.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
            known: Vec::new(),
        }
    }
}

impl From<Fault> for ErrorView {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::Refused { text } => Self::new(ErrorCode::Failed, text),
            Fault::Deadline { after } => {
                let text = format!("no answer within {:.1} s", after.as_secs_f64());
                Self::new(ErrorCode::TimedOut, text)
            }
            Fault::PeerDown { chassis } => {
                Self::new(ErrorCode::Failed, format!("chassis `{chassis}` is gone"))
            }
            other => Self::new(ErrorCode::Failed, other.to_string()),
        }
    }
}

/// Kinds of errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// The request cannot be read, or this version does not know it.
    BadRequest,
    /// Nothing has this name.
    NoSuchName,
    /// It was tried and failed.
    Failed,
    /// It took too long.
    TimedOut,
    /// Too many ask at once.
    Busy,
    /// The client's key does not permit it.
    NotAllowed,
    #[serde(other)]
    /// One that this version does not know.
    Other,
}

/// An app.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AppView {
    /// Its name.
    pub app: String,
    /// Its configuration's file.
    pub file: String,
    /// The process that booted it.
    pub pid: u32,
    /// Where it is between its first process and its last.
    pub state: BootState,
    /// How long ago it was started, s.
    pub up_s: f64,
    /// Its chassis, in declared order.
    pub chassis: Vec<ChassisView>,
    /// Its tasks, chassis by chassis.
    pub tasks: Vec<TaskView>,
    /// How many callers, and requests of tools, it has refused.
    #[serde(default)]
    pub refused: u64,
}

/// A chassis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChassisView {
    /// Its name.
    pub name: String,
    /// Its host, if that is not the boot's.
    #[serde(default)]
    pub host: Option<String>,
    /// Its process, if it has one.
    pub pid: Option<u32>,
    /// Where it is in its life.
    pub state: ChassisState,
    /// For how long, s.
    pub since_s: f64,
    /// How often its process was started again.
    pub restarts: u32,
    /// Why the process before this one ended.
    pub last_end: Option<String>,
    /// Whether it answers.
    pub answers: bool,
    /// Its processors, that of the runtime first.
    pub processors: Vec<String>,
    /// How many tasks it has.
    pub tasks: usize,
    /// Its records, if it is recorded.
    #[serde(default)]
    pub records: Vec<RecordReport>,
}

/// Everything about one task or chassis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StatusView {
    /// The app.
    pub app: String,
    /// How long ago the app was started, s.
    pub up_s: f64,
    /// The chassis, or that of the task.
    pub chassis: ChassisView,
    /// The task, or all tasks of the chassis.
    pub tasks: Vec<TaskView>,
    /// Whether it is about one task.
    pub is_task: bool,
    /// The last log lines of the present process and of those before it, that of the present one last.
    pub logs: Vec<ProcessLog>,
}

/// The log of one process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProcessLog {
    /// Which of its chassis's processes, counted from 1.
    pub incarnation: u32,
    /// Its process id.
    pub pid: Option<u32>,
    /// Its last lines.
    pub lines: VecDeque<LogLine>,
}

/// A record of a running app.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordView {
    /// Stops it.
    pub key: u64,
    /// For how long so far, s.
    pub took_s: f64,
    /// The files, by chassis.
    pub files: Vec<RecordFile>,
}

/// The part of one process in a record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordFile {
    /// The chassis; `boot` for the process that boots.
    pub chassis: String,
    /// Its record.
    #[serde(flatten)]
    pub record: RecordReport,
}

/// A task that moves, or has moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MoveView {
    /// Its name.
    pub task: String,
    /// Where it was, `CHASSIS:PROCESSOR`.
    pub from: String,
    /// Where it goes.
    pub to: String,
    /// How long it takes, or has taken so far, s.
    pub took_s: f64,
    /// What keeps it: what its handler is at.
    pub at: Option<String>,
}

/// How an app ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndView {
    /// Whether it has done what it was asked.
    pub ok: bool,
    /// Why it ended.
    pub reason: String,
    /// Chassis that ended otherwise than they should have: name and how.
    pub casualties: Vec<(String, String)>,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn requests_and_answers_are_what_the_reference_says() {
        let ask = Ask {
            version: VERSION,
            request: Request::Logs(LogRequest {
                name: Some("arm".to_owned()),
                level: Some(Level::Warn),
                follow: true,
                ..LogRequest::default()
            }),
        };
        let text = r#"{"version":1,"request":{"kind":"logs","name":"arm","level":"warn","since_s":null,"last":null,"follow":true}}"#;
        assert_eq!(serde_json::to_string(&ask).unwrap(), text);
        let short =
            r#"{"version":1,"request":{"kind":"logs","name":"arm","level":"warn","follow":true}}"#;
        assert_eq!(serde_json::from_str::<Ask>(short).unwrap(), ask);
        let done = serde_json::to_string(&Answer::Done {}).unwrap();
        assert_eq!(done, r#"{"kind":"done"}"#);
    }

    #[test]
    fn who_may_call_asks_objects_and_tasks_and_does_nothing_to_the_app() {
        let request = |text: &str| serde_json::from_str::<Request>(text).unwrap().role();
        for (text, role) in [
            (r#"{"kind":"ps"}"#, Role::Watch),
            (r#"{"kind":"status","name":"a"}"#, Role::Watch),
            (r#"{"kind":"logs"}"#, Role::Watch),
            (r#"{"kind":"say","task":"a","line":"foo EXEC"}"#, Role::Call),
            (
                r#"{"kind":"call","task":"a","command":"go","data":"","within_s":1}"#,
                Role::Call,
            ),
            (r#"{"kind":"stop","now":true}"#, Role::Control),
            (r#"{"kind":"restart","name":"a"}"#, Role::Control),
            (r#"{"kind":"move","task":"a","to":"b"}"#, Role::Control),
            (r#"{"kind":"record","folder":"/r"}"#, Role::Control),
            (r#"{"kind":"record_stop","key":1}"#, Role::Control),
        ] {
            assert_eq!(request(text), role, "{text}");
        }
    }

    #[test]
    fn an_error_of_a_later_version_is_still_an_error() {
        let text = r#"{"kind":"error","code":"frobnicated","message":"no","more":1}"#;
        let Answer::Error(error) = serde_json::from_str(text).unwrap() else {
            panic!("not an error");
        };
        assert_eq!(error.code, ErrorCode::Other);
    }

    proptest! {
        #[test]
        fn rubbish_is_no_request_and_no_panic(text in ".{0,200}") {
            let _ = serde_json::from_str::<Ask>(&text);
        }
    }
}
