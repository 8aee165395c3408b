//! The bootstrap service: brings an app up in three acknowledged phases, supervises its chassis, waits
//! for its end, and takes it down in order. It is a task like any other, so it works the same in real
//! and in virtual time.

mod board;
mod explain;
mod outcome;
mod overview;
mod quiesce;
mod sequence;
mod start;
mod states;
mod stop;
mod supervisor;

use std::{
    rc::Rc,
    sync::{Arc, Mutex},
    time::Duration,
};

use crate::watch;
use ctos_core::{
    context::Context,
    envelope::Replier,
    handled::Handled,
    phase::{Phase, StopReason},
    system::{
        AllLinked, AppResult, AtBreakpoint, ChassisLinked, ChassisWanted, Finish, Interrupt,
        ProcessEnded, RestartChassis, TaskFailed, TaskMoved,
    },
};
use ctos_message::ChassisNumber;
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;

use board::{Board, Event};
use supervisor::Supervisor;

pub use ctos_core::system::Progress;
pub use outcome::{BootError, HostError, Outcome};
pub use outcome::{contained, io_error};
pub use overview::{AppReport, MemberReport, Overview};
pub use start::start_system_tasks;
pub use states::{BootState, ChassisState};

/// What happens while an app is up, for the code that shows it to a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
#[non_exhaustive]
pub enum BootEvent {
    /// A chassis was started.
    Started {
        /// Its name.
        chassis: String,
        /// Its process id, if it has a process of its own.
        pid: Option<u32>,
        /// Its host, if that is not the boot's.
        #[serde(default)]
        host: Option<String>,
    },
    /// A startup phase is over.
    PhaseDone {
        /// Which.
        phase: Phase,
        /// How many tasks acknowledged it.
        tasks: usize,
        /// How long it took.
        #[serde(rename = "took_s", with = "in_seconds")]
        took: Duration,
    },
    /// A task tells how far it is.
    Progress(Progress),
    /// A line that a chassis wrote to its log.
    Log {
        /// The chassis.
        chassis: String,
        /// The line.
        line: String,
    },
    /// The app is being stopped.
    Stopping {
        /// Why.
        reason: String,
    },
    /// A step of the stop begins.
    StopStep {
        /// Which.
        step: StopStep,
    },
    /// The first step of the stop takes its time.
    QuietAwaited {
        /// The tasks that are not at rest yet.
        tasks: Vec<String>,
    },
    /// A task did not come to rest in the first step of the stop, which goes on without it.
    NotQuiet {
        /// The task.
        task: String,
        /// Why not: what it waits for, as far as its chassis can say.
        reason: String,
    },
    /// The first step of the stop is over.
    Quiet {
        /// How many tasks came to rest.
        tasks: usize,
        /// How many were asked to.
        of: usize,
        /// How long it took.
        #[serde(rename = "took_s", with = "in_seconds")]
        took: Duration,
    },
    /// A task was stopped, or could not be.
    Stopped {
        /// The task.
        task: String,
        /// What went wrong, if anything did.
        error: Option<String>,
    },
    /// A chassis is gone, or must go.
    ChassisFailed {
        /// The chassis.
        chassis: String,
        /// What happened to it.
        reason: String,
    },
    /// The process of a chassis is dead; the next one is started after a pause.
    Restarting {
        /// The chassis.
        chassis: String,
        /// The number of the next process, counted from 1.
        incarnation: u32,
        /// The pause.
        #[serde(rename = "pause_s", with = "in_seconds")]
        pause: Duration,
    },
    /// Somebody looks for a task of a chassis that starts on demand; its process is started.
    Wanted {
        /// The chassis.
        chassis: String,
        /// The task that is looked for; not known where a person had the chassis started.
        task: Option<String>,
        /// The task that looks for it; not known of a tool, which is none.
        by: Option<String>,
    },
    /// The tasks of a chassis that starts on demand have passed all phases for the first time.
    Awake {
        /// The chassis.
        chassis: String,
        /// How many tasks it has.
        tasks: usize,
        /// How long that took.
        #[serde(rename = "took_s", with = "in_seconds")]
        took: Duration,
    },
    /// A chassis is back, and its tasks have passed all phases.
    Restarted {
        /// The chassis.
        chassis: String,
        /// How many tasks it has.
        tasks: usize,
        /// How long it was away.
        #[serde(rename = "took_s", with = "in_seconds")]
        took: Duration,
    },
    /// A chassis with `stop_first` has stopped: whatever it moves is at rest.
    AtRest {
        /// The chassis.
        chassis: String,
    },
    /// A process was sent a signal because it did not end by itself.
    Signalled {
        /// The chassis.
        chassis: String,
        /// The signal's name.
        signal: String,
    },
    /// The process that boots was told to end by SIGTERM: the app is stopped as by Ctrl-C.
    Terminated,
}

/// A step of the stop of an app, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopStep {
    /// All tasks come to rest at the same time: nets end what they have begun, and devices still serve them.
    Quiesce,
    /// One task after the other is stopped, those of chassis with `stop_first` first.
    Tasks,
    /// The processes end.
    Processes,
}

impl StopStep {
    /// All steps, in order.
    pub const ALL: [Self; 3] = [Self::Quiesce, Self::Tasks, Self::Processes];
}

impl std::fmt::Display for StopStep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.serialize(f)
    }
}

/// Durations as a number of seconds.
mod in_seconds {
    use std::time::Duration;

    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(time: &Duration, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_f64(time.as_secs_f64())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Duration, D::Error> {
        let seconds = f64::deserialize(from)?;
        Duration::try_from_secs_f64(seconds).map_err(D::Error::custom)
    }
}

/// Sees [`BootEvent`]s as they happen, on the thread of the bootstrap service.
pub type Observer = Arc<dyn Fn(&BootEvent) + Send + Sync>;

/// Why an app ended.
#[derive(Debug, Clone, PartialEq)]
pub enum End {
    /// The task named by `until` finished.
    Finished(AppResult),
    /// The person asked for it by Ctrl-C, or somebody by SIGTERM.
    Interrupted,
    /// An operator asked for it.
    Stopped,
    /// A chassis is gone.
    ChassisDown {
        /// Its name.
        chassis: String,
    },
    /// A chassis failed, and may not be started again.
    GivenUp {
        /// Its name.
        chassis: String,
        /// Why: how often it was restarted, and what happened to it last.
        reason: String,
    },
    /// A task failed for good.
    TaskFailed {
        /// The task.
        task: String,
        /// Why.
        reason: String,
    },
    /// A task came to a breakpoint at which the app was to end.
    Breakpoint {
        /// The task.
        task: String,
        /// Where it stands.
        reason: String,
    },
    /// A startup phase failed and the boot was undone.
    PhaseFailed {
        /// Which.
        phase: Phase,
        /// Task and reason, for each that did not acknowledge.
        failures: Vec<(String, String)>,
    },
    /// Every task waits for another one: nothing can ever happen again (virtual time only).
    Stuck,
}

impl End {
    /// What the tasks are told.
    pub fn reason(&self) -> StopReason {
        match self {
            Self::Finished(_) => StopReason::Finished,
            Self::Interrupted => StopReason::Interrupted,
            Self::Stopped => StopReason::Stopped,
            Self::ChassisDown { chassis } => StopReason::ChassisDown {
                chassis: chassis.clone(),
            },
            Self::GivenUp { chassis, reason } => StopReason::Failed {
                what: format!("chassis `{chassis}` {reason}"),
            },
            Self::TaskFailed { task, reason } => StopReason::Failed {
                what: format!("task `{task}` failed: {reason}"),
            },
            Self::Breakpoint { reason, .. } => StopReason::Failed {
                what: reason.clone(),
            },
            Self::PhaseFailed { phase, .. } => StopReason::Failed {
                what: format!("startup phase `{phase}` failed"),
            },
            Self::Stuck => StopReason::Failed {
                what: "every task waits for another one".to_owned(),
            },
        }
    }
}

/// What the service found out, left where the process that boots picks it up.
pub type EndSlot = Arc<Mutex<Option<End>>>;

/// What the service wants of the processes of chassis. [`ChassisLinked`] and [`ProcessEnded`] tell
/// the service what becomes of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProcessOrder {
    /// Start the process of chassis `index` with this incarnation. The one before it is dead.
    Start(ChassisNumber, u32),
    /// End the process of chassis `index` at once.
    Kill(ChassisNumber),
}

/// What the service wants, for the code that carries it out.
pub type ProcessOrders = mpsc::UnboundedReceiver<ProcessOrder>;

/// What the service is started with.
#[derive(Clone)]
pub struct Seat {
    observer: Observer,
    /// Where the end of the app is put.
    pub end: EndSlot,
    orders: mpsc::UnboundedSender<ProcessOrder>,
}

impl Seat {
    /// A seat whose service tells `observer` what happens, and what it wants of the processes.
    #[must_use]
    pub fn new(observer: &Observer) -> (Self, ProcessOrders) {
        let (sender, orders) = mpsc::unbounded_channel();
        let seat = Self {
            observer: observer.clone(),
            end: EndSlot::default(),
            orders: sender,
        };
        (seat, orders)
    }
}

/// The service's state.
pub(crate) struct Bootstrap(Rc<Board>);

impl Bootstrap {
    pub(crate) fn new(cx: &Context, seat: Seat) -> Self {
        Self(Rc::new(Board::new(cx.clone(), seat)))
    }
}

#[ctos_derive::handler]
impl Bootstrap {
    #[command]
    fn all_linked(&self, cx: &Context, _: AllLinked) {
        watch::start(cx);
        self.0.all_linked();
        cx.spawn(sequence::run(self.0.clone()));
        for member in &self.0.members {
            let (board, member) = (self.0.clone(), member.clone());
            let supervisor = Supervisor { board, member };
            cx.spawn(async move { drop(supervisor.run().await) });
        }
    }

    #[command]
    fn progress(&self, progress: Progress) {
        // How far its tasks are is no news any more once the app is being taken down.
        if !self.0.is_stopping() {
            self.0.event(&BootEvent::Progress(progress));
        }
    }

    #[command]
    fn finish(&self, cx: &Context, Finish { task, result }: Finish) {
        let until = cx.app().until.as_deref();
        if until.is_none_or(|until| until == task) {
            self.0.end(End::Finished(result));
        }
    }

    #[command]
    fn task_failed(&self, failed: TaskFailed) {
        self.0
            .task_failed(failed.chassis, failed.task, failed.reason);
    }

    #[command]
    fn at_breakpoint(&self, AtBreakpoint { task, reason }: AtBreakpoint) {
        self.0.end(End::Breakpoint { task, reason });
    }

    #[command]
    fn interrupt(&self, Interrupt { by_operator }: Interrupt) {
        self.0.end(if by_operator {
            End::Stopped
        } else {
            End::Interrupted
        });
    }

    #[command]
    fn process_ended(&self, ended: ProcessEnded) {
        let (chassis, incarnation) = (ended.chassis, ended.incarnation);
        self.0
            .tell_incarnation(chassis, incarnation, Event::Dead(ended));
    }

    #[command]
    fn chassis_linked(&self, linked: ChassisLinked) {
        self.0
            .tell_incarnation(linked.chassis, linked.incarnation, Event::Joined);
    }

    #[command]
    fn restart(&self, order: RestartChassis, reply: Replier<RestartChassis>) -> Handled {
        self.0.restart(order.chassis, reply)
    }

    #[command]
    fn chassis_wanted(&self, wanted: ChassisWanted) {
        self.0.is_wanted(wanted);
    }

    #[command]
    fn moved(&self, TaskMoved { task, old }: TaskMoved) {
        self.0.moved(task, old);
    }

    #[command]
    fn overview(&self, _: Overview) -> AppReport {
        self.0.report()
    }

    #[chassis_down]
    async fn lost(&mut self, _: &Context, chassis: &str) -> Handled {
        self.0.lost(chassis);
        Ok(())
    }
}
