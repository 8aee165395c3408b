//! The commands of the runtime itself, and the tasks that every app has.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{
    last_messages::TaskLook,
    phase::{Phase, StopReason},
    report::{ChassisReport, TaskCounters},
    task_ref::TaskRef,
};
use ctos_message::{ChassisNumber, Command, Tid, command};

/// The task that starts and stops the tasks of chassis `index`.
pub const fn agent_tid(index: ChassisNumber) -> Tid {
    Tid::new(index, 0, 0)
}

/// The task identification service, on the chassis that boots.
pub const TID_SERVER: Tid = Tid::new(0, 0, 1);

/// The bootstrap service, on the chassis that boots.
pub const BOOTSTRAP: Tid = Tid::new(0, 0, 2);

/// The inter-processor blocking service, on the chassis that boots.
pub const SEMAPHORE_SERVER: Tid = Tid::new(0, 0, 7);

/// How an app ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AppResult {
    /// Whether it did what it was asked.
    pub ok: bool,
    /// The text for a person: a table or a reason, several lines.
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

/// What became of the tasks that a chassis was told to create.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Created {
    pub tasks: Vec<TaskRef>,
    /// Task and reason.
    pub failed: Vec<(String, String)>,
}

// All the commands of the runtime, but for those of the services that have a list of their own.
command! {
    all ALL;

    /// Asks whether the task is alive.
    pub struct Ping => (), 0xff00, "ping";

    /// Asks which commands the task takes.
    pub struct Introspect => Vec<CommandDescription>, 0xff01, "introspect";

    /// Asks what the task has done so far.
    pub struct Statistics => TaskCounters, 0xff05, "statistics";

    /// Enters a startup phase.
    pub struct EnterPhase { pub phase: Phase } => (), 0xff02, "phase";

    /// Comes to an orderly stop. With a chassis, the task only if it is there: one that has just moved
    /// away goes on.
    pub struct StopTask { pub reason: StopReason, pub on: Option<ChassisNumber> } => (), 0xff03, "stop";

    /// Comes to rest, before any task is stopped; answered when it has.
    pub struct Quiesce { pub reason: StopReason } => (), 0xff06, "quiesce";

    /// Asks a task that comes to rest what it still waits for, in words.
    pub struct NotQuiet => Option<String>, 0xff07, "not_quiet";

    /// Tells that another chassis is gone.
    pub struct ChassisDown { pub chassis: String } => (), 0xff04, "chassis_down";

    /// Adds a task to the names.
    pub struct RegisterTid { pub task: TaskRef } => (), 0xff10, "register_tid";

    /// Asks for the task behind a name, and where it is if it is not there. `gone` is an id of it whose chassis
    /// the asker is not linked to. With `waits`, the answer comes when the task is back or will never be.
    pub struct FindTid {
        pub name: String,
        pub gone: Option<Tid>,
        pub waits: bool,
    } => Result<Tid, Missing>, 0xff15, "find_tid";

    /// Tells the task identification service what becomes of a chassis, or of the app.
    pub struct ChassisNews { pub news: News } => (), 0xff16, "chassis_news";

    /// Creates the tasks of this chassis. No task of an earlier incarnation has a slot from
    /// `first_slots` on, by the number of the processor.
    pub struct CreateTasks { pub first_slots: BTreeMap<u8, u32> } => Created, 0xff20, "create_tasks";

    /// Ends the process.
    pub struct Exit { pub code: i32 } => (), 0xff21, "exit";

    /// Tells how far a task is.
    #[derive(Debug, Clone, PartialEq)]
    pub struct Progress {
        /// The task.
        pub task: String,
        /// Steps done.
        pub done: u64,
        /// Steps in all.
        pub total: u64,
        /// What a step is.
        pub step: String,
        /// What happened at this one.
        pub what: String,
    } => (), 0xff30, "progress";

    /// Ends the app with a result.
    pub struct Finish { pub task: String, pub result: AppResult } => (), 0xff31, "finish";

    /// Tells that a task failed for good.
    pub struct TaskFailed { pub task: String, pub chassis: ChassisNumber, pub reason: String } => (), 0xff32, "task_failed";

    /// Tells that a task is at a breakpoint at which the app shall end.
    pub struct AtBreakpoint { pub task: String, pub reason: String } => (), 0xff3f, "at_breakpoint";

    /// Tells that the person wants the app to stop: an operator, or whoever interrupts the process that boots.
    pub struct Interrupt { pub by_operator: bool } => (), 0xff33, "interrupt";

    /// Tells that every chassis is connected.
    pub struct AllLinked => (), 0xff34, "all_linked";

    /// Tells that a chassis that was gone is back.
    pub struct ChassisUp { pub chassis: String } => (), 0xff51, "chassis_up";

    /// Lets an agent tell all its tasks that a chassis is back.
    pub struct AnnounceUp { pub chassis: String } => (), 0xff52, "announce_up";

    /// Builds the task's handler anew.
    pub struct RestartTask => (), 0xff53, "restart";

    /// Tells the bootstrap service that the process of a chassis is dead, and how it died.
    pub struct ProcessEnded {
        pub chassis: ChassisNumber,
        pub incarnation: u32,
        pub how: String,
        pub code: Option<i32>,
    } => (), 0xff54, "process_ended";

    /// Tells the bootstrap service that a chassis that was started anew is connected to all others.
    pub struct ChassisLinked { pub chassis: ChassisNumber, pub incarnation: u32 } => (), 0xff55, "chassis_linked";

    /// Restarts a chassis whatever its policy; answered when its tasks have passed all phases.
    pub struct RestartChassis { pub chassis: ChassisNumber } => (), 0xff56, "restart_chassis";

    /// Tells the bootstrap service that somebody looks for a task of a chassis that starts on demand.
    pub struct ChassisWanted {
        pub chassis: ChassisNumber,
        /// The task looked for.
        pub task: String,
        /// The task that looks for it; not known of a tool, which is none.
        pub by: Option<String>,
    } => (), 0xff59, "chassis_wanted";

    /// Asks an agent for everything that is known of its chassis.
    pub struct Survey => ChassisReport, 0xff50, "survey";

    /// Asks an agent how a task is and what it handled last; from then on that is kept, without messages of
    /// the commands `without`.
    pub struct LookAt { pub task: Tid, pub without: Vec<u16> } => Option<TaskLook>, 0xff58, "look_at";

    /// Comes to an orderly stop; the app goes on without the task, or with it built anew.
    pub struct Shutdown => (), 0xff60, "shutdown";

    /// Tells a task that a part of one of its incarnations panicked.
    pub struct Broke { pub incarnation: u64, pub reason: String } => (), 0xff61, "broke";

    /// Moves a running task to `CHASSIS` or `CHASSIS:PROCESSOR`; answers with the place.
    pub struct MoveTask {
        /// Its symbolic name.
        pub task: String,
        /// The place.
        pub to: String,
    } => String, 0xff62, "move_task";

    /// Tells a task to go on at another place.
    pub struct MoveOut { pub to: Place } => Tid, 0xff63, "move_out";

    /// Makes a place for a task that comes from `from`.
    pub struct MoveIn {
        pub name: String,
        pub from: Tid,
        pub processor: u8,
        pub state: Vec<u8>,
    } => Tid, 0xff64, "move_in";

    /// Brings something that was sent to a task's old place.
    #[derive(Clone)]
    pub struct Transfer { pub to: Tid, pub what: Load } => Delivered, 0xff65, "transfer";

    /// Gives a task's name to its new place.
    pub struct CommitMove { pub name: String, pub old: Tid, pub new: Tid } => (), 0xff66, "commit_move";

    /// Forbids a move that has not been committed; answers whether it has.
    pub struct AbortMove { pub new: Tid } => bool, 0xff67, "abort_move";

    /// Tells an agent what becomes of a place.
    pub struct Settle { pub place: Tid, pub how: Settled } => (), 0xff68, "settle";

    /// Tells that a name has another task id now, or none.
    #[derive(Clone)]
    pub struct Rebound {
        pub name: String,
        pub old: Tid,
        pub new: Option<Tid>,
        pub moved: bool,
    } => (), 0xff69, "rebound";

    /// Goes to the old place of a task, behind everything that a chassis sent there.
    pub struct Fence { pub chassis: ChassisNumber } => (), ctos_message::FENCE, "fence";

    /// Waits until a name is known.
    pub struct AwaitTid { pub name: String, pub waiter: String } => Result<Tid, String>, 0xff6b, "await_tid";

    /// Asks to be told when a task goes down and comes up.
    pub struct Monitor { pub name: String } => bool, 0xff6c, "monitor";

    /// Tells what became of a task.
    pub struct TaskChanged { pub task: TaskRef, pub change: Change } => (), 0xff6d, "task_changed";

    /// Asks an agent whom a task waits for.
    pub struct WaitsFor { pub task: Tid } => Option<Waits>, 0xff6e, "waits_for";

    /// Asks for the first slot of each processor of a chassis that no task of this run ever had.
    pub struct FirstSlots { pub chassis: ChassisNumber } => BTreeMap<u8, u32>, 0xff6f, "first_slots";

    /// Says in words who waits for a name and for whom.
    pub struct WhoWaits { pub name: String } => String, 0xff12, "who_waits";

    /// Asks where the tasks are that were moved away from where the configuration puts them.
    pub struct MovedTasks => Vec<(String, Place)>, 0xff13, "moved_tasks";

    /// Asks for the names of tasks, those too that have ended.
    pub struct NamesOf { pub tids: Vec<Tid> } => Vec<Option<String>>, 0xff14, "names_of";

    /// Tells the bootstrap service that a task is at another place now.
    pub struct TaskMoved { pub task: TaskRef, pub old: Tid } => (), 0xff70, "task_moved";
}

/// Why a name leads to no task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Missing {
    /// There is none; these are the names there are.
    Unknown(Vec<String>),
    /// Its chassis is being restarted.
    Away { chassis: String },
    /// Its chassis is gone and is not restarted, for a reason that completes "which ...".
    Gone { chassis: String, why: String },
}

/// What becomes of a chassis, by number, or of the app.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum News {
    /// Every task of the app has passed all phases for the first time.
    AppUp,
    /// It is gone or must go, and may be started again.
    Away(ChassisNumber),
    /// Its tasks have passed all phases.
    Back(ChassisNumber),
    /// It is gone, and is not started again.
    Gone(ChassisNumber, String),
    /// The app is being stopped: nothing is started again.
    Stopping,
}

/// A processor of a chassis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    pub chassis: ChassisNumber,
    pub processor: u8,
}

/// What is brought from the old place of a task to the new one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Load {
    /// A message, as it was sent.
    Message(Forwarded),
    /// Everything that this chassis sent to the old place is there: its direct messages may come in.
    Gate(ChassisNumber),
    /// The old place is gone, so nothing of `chassis` comes from there any more.
    Without {
        chassis: ChassisNumber,
        old: ChassisNumber,
    },
    /// The sender wants to know that everything before this has been taken.
    Sync,
}

/// A message that was sent to a task's old place.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Forwarded {
    pub from: Tid,
    pub command: u16,
    pub flags: u16,
    pub trace: u64,
    /// How long its sender still waits, ns.
    pub left_ns: Option<u64>,
    pub body: Vec<u8>,
    /// Whether its sender waits for a reply, or for the message to be taken.
    pub reply: bool,
}

/// What came of a [`Load`]: the reply, or why there is none.
pub type Delivered = Result<Vec<u8>, ctos_message::fault::Fault>;

/// What becomes of a place that a task comes to or has left.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Settled {
    /// It is the task's; these chassis send nothing by the old place any more.
    Go { gone: Vec<ChassisNumber> },
    /// It is not; nothing may have begun there.
    Drop,
    /// Nobody sends to it any more.
    Retire,
}

/// What became of a task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Change {
    /// It takes messages again.
    Up,
    /// Its handler is being built anew.
    Down { reason: String },
    /// It is gone and its name is free.
    Ended { reason: String },
}

/// Whom a task waits for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Waits {
    /// The waiting task.
    pub name: String,
    /// The task whose reply it waits for.
    pub to: Tid,
}

/// Whether a message of `command` interrupts a handler that is at work.
pub const fn interrupts(command: u16) -> bool {
    command == StopTask::CODE || command == RestartTask::CODE || command == Broke::CODE
}
