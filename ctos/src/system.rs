//! The commands of the runtime itself, and the tasks that every app has.

use serde::{Deserialize, Serialize};

use crate::{
    bootstrap::{BootState, ChassisState},
    command,
    message::{Command, CommandInfo, Tid},
    statistics::TaskCounters,
    task::{Phase, StopReason},
    time::Instant,
};

/// The task that starts and stops the tasks of chassis `index`.
pub(crate) const fn agent_tid(index: u8) -> Tid {
    Tid::new(index, 0, 0)
}

/// The task identification service, on the chassis that boots.
pub(crate) const TID_SERVER: Tid = Tid::new(0, 0, 1);

/// The bootstrap service, on the chassis that boots.
pub(crate) const BOOTSTRAP: Tid = Tid::new(0, 0, 2);

/// The inter-processor blocking service, on the chassis that boots.
pub(crate) const SEMAPHORE_SERVER: Tid = Tid::new(0, 0, 7);

/// How an app ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AppResult {
    /// Whether it did what it was asked.
    pub ok: bool,
    /// What a person is told: a table or a reason, several lines.
    pub text: String,
    /// The same for a program, one JSON object.
    pub json: String,
}

/// A command as introspection shows it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommandDescription {
    /// Code in the header.
    pub code: u16,
    /// Name in nets and text.
    pub name: String,
    /// One line of help.
    pub doc: String,
}

/// A task as the task identification service knows it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskName {
    /// Its symbolic name.
    pub name: String,
    /// Its id.
    pub tid: Tid,
}

/// What became of the tasks that a chassis was told to create.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Created {
    pub(crate) tasks: Vec<TaskName>,
    /// Task and reason.
    pub(crate) failed: Vec<(String, String)>,
}

/// The name of a command of the runtime that a task of an app may be at; its code, of any other.
pub(crate) fn command_name(code: u16) -> String {
    let known = [
        EnterPhase::INFO,
        StopTask::INFO,
        ChassisDown::INFO,
        Ping::INFO,
        Introspect::INFO,
        Statistics::INFO,
    ];
    let found = known.into_iter().find(|command| command.code == code);
    found.map_or_else(|| format!("{code:#06x}"), |command| command.name.to_owned())
}

command! {
    /// Asks whether the task is alive.
    pub struct Ping => (), 0xff00, "ping"
}
command! {
    /// Asks which commands the task takes.
    pub struct Introspect => Vec<CommandDescription>, 0xff01, "introspect"
}
command! {
    /// Asks what the task has done so far.
    pub struct Statistics => TaskCounters, 0xff05, "statistics"
}
command! {
    /// Enters a startup phase.
    pub(crate) struct EnterPhase { pub(crate) phase: Phase } => (), 0xff02, "phase"
}
command! {
    /// Comes to an orderly stop.
    pub(crate) struct StopTask { pub(crate) reason: StopReason } => (), 0xff03, "stop"
}
command! {
    /// Tells that another chassis is gone.
    pub(crate) struct ChassisDown { pub(crate) chassis: String } => (), 0xff04, "chassis_down"
}
command! {
    /// Adds a task to the names.
    pub(crate) struct RegisterTid { pub(crate) task: TaskName } => (), 0xff10, "register_tid"
}
command! {
    /// Asks for the task behind a name; without one, for the names there are.
    pub(crate) struct QueryTid { pub(crate) name: String } => Result<Tid, Vec<String>>, 0xff11, "query_tid"
}
command! {
    /// Creates the tasks of this chassis. No task of an earlier incarnation has a slot from
    /// `first_slots` on, which holds one number for each processor.
    pub(crate) struct CreateTasks { pub(crate) first_slots: Vec<u16> } => Created, 0xff20, "create_tasks"
}
command! {
    /// Ends the process.
    pub(crate) struct Exit { pub(crate) code: i32 } => (), 0xff21, "exit"
}
command! {
    /// Tells how far a task is.
    pub(crate) struct Progress {
        pub(crate) task: String,
        pub(crate) done: u64,
        pub(crate) total: u64,
        pub(crate) step: String,
        pub(crate) what: String,
    } => (), 0xff30, "progress"
}
command! {
    /// Ends the app with a result.
    pub(crate) struct Finish { pub(crate) task: String, pub(crate) result: AppResult } => (), 0xff31, "finish"
}
command! {
    /// Tells that a task failed for good.
    pub(crate) struct TaskFailed { pub(crate) task: String, pub(crate) reason: String } => (), 0xff32, "task_failed"
}
command! {
    /// Tells that the person wants the app to stop.
    pub(crate) struct Interrupt => (), 0xff33, "interrupt"
}
command! {
    /// Tells that every chassis is connected.
    pub(crate) struct AllLinked => (), 0xff34, "all_linked"
}
command! {
    /// Tells that a chassis that was gone is back.
    pub(crate) struct ChassisUp { pub(crate) chassis: String } => (), 0xff51, "chassis_up"
}
command! {
    /// Lets an agent tell all its tasks that a chassis is back.
    pub(crate) struct AnnounceUp { pub(crate) chassis: String } => (), 0xff52, "announce_up"
}
command! {
    /// Builds the task's handler anew.
    pub(crate) struct RestartTask => (), 0xff53, "restart"
}
command! {
    /// Tells the bootstrap service that the process of a chassis is dead, and how it died.
    pub(crate) struct ProcessEnded {
        pub(crate) chassis: u8,
        pub(crate) incarnation: u32,
        pub(crate) how: String,
        pub(crate) code: Option<i32>,
    } => (), 0xff54, "process_ended"
}
command! {
    /// Tells the bootstrap service that a chassis that was started anew is connected to all others.
    pub(crate) struct ChassisLinked { pub(crate) chassis: u8, pub(crate) incarnation: u32 } => (), 0xff55, "chassis_linked"
}
command! {
    /// Restarts a chassis whatever its policy; answered when its tasks have passed all phases.
    pub(crate) struct RestartChassis { pub(crate) chassis: u8 } => (), 0xff56, "restart_chassis"
}
command! {
    /// Asks the bootstrap service how the app and its chassis are.
    pub(crate) struct Overview => AppReport, 0xff57, "overview"
}

/// The app as its bootstrap service sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AppReport {
    /// Where it is between its first process and its last.
    pub state: BootState,
    /// The moment, on the app's clock.
    pub now: Instant,
    /// Its chassis, in declared order.
    pub chassis: Vec<MemberReport>,
}

/// A chassis as the bootstrap service sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MemberReport {
    /// Its name.
    pub name: String,
    /// Where it is in its life.
    pub state: ChassisState,
    /// Since when.
    pub since: Instant,
    /// Counts its processes from 1.
    pub incarnation: u32,
    /// Why the process before this one ended; `None` for the first.
    pub last_end: Option<String>,
    /// The tasks of this incarnation.
    pub tasks: Vec<TaskName>,
}

/// Whether a handler that is at work is dropped for the sake of `command`.
pub(crate) const fn interrupts(command: u16) -> bool {
    command == StopTask::CODE || command == RestartTask::CODE
}

/// Every command of the runtime that a task may be seen at.
pub(crate) const ALL: &[CommandInfo] = &[
    Ping::INFO,
    Introspect::INFO,
    Statistics::INFO,
    EnterPhase::INFO,
    StopTask::INFO,
    ChassisDown::INFO,
    ChassisUp::INFO,
    RestartTask::INFO,
    RegisterTid::INFO,
    QueryTid::INFO,
    CreateTasks::INFO,
    Exit::INFO,
    Progress::INFO,
    Finish::INFO,
    TaskFailed::INFO,
    Interrupt::INFO,
    AllLinked::INFO,
    AnnounceUp::INFO,
    ProcessEnded::INFO,
    ChassisLinked::INFO,
    RestartChassis::INFO,
    Overview::INFO,
    crate::survey::Survey::INFO,
];
