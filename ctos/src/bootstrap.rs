//! The bootstrap service: brings an app up in three acknowledged phases, waits for its end, and takes
//! it down in order. It is a task like any other, so it works the same in real and in virtual time.

use std::{
    cell::RefCell,
    collections::{BTreeMap, VecDeque},
    rc::Rc,
    sync::{Arc, Mutex},
    time::Duration,
};

use futures_util::future::{Either, join_all, select};

use crate::{
    call::{Fault, lock},
    chassis::BOOT_CHASSIS,
    context::{Context, TaskRef},
    message::{Command, CommandInfo, Message},
    sync::Signal,
    system::{
        self, AllLinked, AppResult, CreateTasks, EnterPhase, Exit, Finish, Interrupt, Progress,
        StopTask, TaskFailed, TaskName,
    },
    task::{EventHandler, Handled, Phase, StopReason},
};

/// What the service takes.
pub(crate) const COMMANDS: [CommandInfo; 5] = [
    AllLinked::INFO,
    Progress::INFO,
    Finish::INFO,
    TaskFailed::INFO,
    Interrupt::INFO,
];

/// What happens while an app is up, for whoever shows it to a person.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum BootEvent {
    /// A chassis was started.
    Started {
        /// Its name.
        chassis: String,
        /// Its process id, if it has a process of its own.
        pid: Option<u32>,
    },
    /// A startup phase is over.
    PhaseDone {
        /// Which.
        phase: Phase,
        /// How many tasks acknowledged it.
        tasks: usize,
        /// How long it took.
        took: Duration,
    },
    /// A task tells how far it is.
    Progress {
        /// The task.
        task: String,
        /// Steps done.
        done: u64,
        /// Steps in all.
        total: u64,
        /// What a step is.
        step: String,
        /// What happened at this one.
        what: String,
    },
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
    /// A task came to rest, or did not.
    Stopped {
        /// The task.
        task: String,
        /// What went wrong, if anything did.
        error: Option<String>,
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
        signal: &'static str,
    },
}

/// Sees [`BootEvent`]s as they happen, on the thread of the bootstrap service.
pub type Observer = Arc<dyn Fn(&BootEvent) + Send + Sync>;

/// Why an app ended.
#[derive(Debug, Clone, PartialEq)]
pub enum End {
    /// The task named by `until` finished.
    Finished(AppResult),
    /// The person asked for it.
    Interrupted,
    /// A chassis is gone.
    ChassisDown {
        /// Its name.
        chassis: String,
    },
    /// A task failed for good.
    TaskFailed {
        /// The task.
        task: String,
        /// Why.
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
    fn reason(&self) -> StopReason {
        match self {
            Self::Finished(_) => StopReason::Finished,
            Self::Interrupted => StopReason::Interrupted,
            Self::ChassisDown { chassis } => StopReason::ChassisDown {
                chassis: chassis.clone(),
            },
            Self::TaskFailed { task, reason } => StopReason::Failed {
                what: format!("task `{task}` failed: {reason}"),
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
pub(crate) type EndSlot = Arc<Mutex<Option<End>>>;

#[derive(Default)]
struct Events {
    ends: VecDeque<End>,
    /// The app is being taken down: how far its tasks are is no news any more.
    stopping: bool,
}

/// The service's state.
pub(crate) struct Bootstrap {
    observer: Observer,
    slot: EndSlot,
    events: Rc<RefCell<Events>>,
    signal: Signal,
}

impl Bootstrap {
    pub(crate) fn new(observer: Observer, slot: EndSlot) -> Self {
        Self {
            observer,
            slot,
            events: Rc::default(),
            signal: Signal::new(),
        }
    }

    fn end(&self, end: End) {
        self.events.borrow_mut().ends.push_back(end);
        self.signal.raise();
    }
}

impl EventHandler for Bootstrap {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            AllLinked::CODE => {
                let sequence = Sequence {
                    cx: cx.clone(),
                    observer: self.observer.clone(),
                    slot: self.slot.clone(),
                    events: self.events.clone(),
                    signal: self.signal.clone(),
                    tasks: Vec::new(),
                };
                cx.spawn(sequence.run());
                Ok(())
            }
            Progress::CODE => {
                let (progress, _) = message.open::<Progress>()?;
                if self.events.borrow().stopping {
                    return Ok(());
                }
                (self.observer)(&BootEvent::Progress {
                    task: progress.task,
                    done: progress.done,
                    total: progress.total,
                    step: progress.step,
                    what: progress.what,
                });
                Ok(())
            }
            Finish::CODE => {
                let (Finish { task, result }, _) = message.open::<Finish>()?;
                let until = cx.app().until.as_deref();
                if until.is_none_or(|until| until == task) {
                    self.end(End::Finished(result));
                }
                Ok(())
            }
            TaskFailed::CODE => {
                let (TaskFailed { task, reason }, _) = message.open::<TaskFailed>()?;
                self.end(End::TaskFailed { task, reason });
                Ok(())
            }
            Interrupt::CODE => {
                self.end(End::Interrupted);
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn chassis_down(&mut self, _cx: &Context, chassis: &str) -> Handled {
        self.end(End::ChassisDown {
            chassis: chassis.to_owned(),
        });
        Ok(())
    }
}

/// One app from its first phase to its last stop.
struct Sequence {
    cx: Context,
    observer: Observer,
    slot: EndSlot,
    events: Rc<RefCell<Events>>,
    signal: Signal,
    tasks: Vec<TaskName>,
}

impl Sequence {
    async fn run(mut self) {
        let events = self.events.clone();
        let signal = self.signal.clone();
        let end = {
            let phases = std::pin::pin!(self.phases());
            let ended = std::pin::pin!(next_end(&events, &signal));
            match select(phases, ended).await {
                Either::Left((Err(end), _)) => end,
                Either::Left((Ok(()), ended)) => ended.await,
                Either::Right((end, _)) => end,
            }
        };
        self.stop(&end).await;
        *lock(&self.slot) = Some(end);
        self.cx.chassis().exit(0);
    }

    fn event(&self, event: &BootEvent) {
        (self.observer)(event);
    }

    async fn phases(&mut self) -> Result<(), End> {
        for phase in Phase::ALL {
            let began = self.cx.now();
            let failures = match phase {
                Phase::Create => {
                    let mut failures = self.create().await;
                    if failures.is_empty() {
                        failures = self.enter(phase).await;
                    }
                    failures
                }
                Phase::Connect | Phase::Run => self.enter(phase).await,
            };
            if !failures.is_empty() {
                return Err(End::PhaseFailed { phase, failures });
            }
            self.event(&BootEvent::PhaseDone {
                phase,
                tasks: self.tasks.len(),
                took: self.cx.now().since(began),
            });
        }
        Ok(())
    }

    /// Lets the agent of every chassis create its tasks.
    async fn create(&mut self) -> Vec<(String, String)> {
        let limit = self.cx.app().phase_timeout;
        let chassis: Vec<u8> = self.cx.chassis().others().collect();
        let calls = chassis.iter().map(|index| {
            let name = format!("agent of {}", self.cx.chassis().name_of(*index));
            let agent = TaskRef::new(name, system::agent_tid(*index));
            let call = self
                .cx
                .call(
                    &agent,
                    CreateTasks {
                        first_slots: Vec::new(),
                    },
                )
                .deadline(limit);
            async move { (agent, call.await) }
        });
        let answers = join_all(calls).await;
        let mut failures = Vec::new();
        for (agent, answer) in answers {
            match answer {
                Ok(created) => {
                    self.tasks.extend(created.tasks);
                    failures.extend(created.failed);
                }
                Err(error) => failures.push((agent.name().to_owned(), error.to_string())),
            }
        }
        failures
    }

    /// Tells every task to enter `phase` and waits for all of them.
    async fn enter(&self, phase: Phase) -> Vec<(String, String)> {
        let limit = self.cx.app().phase_timeout;
        let calls = self.tasks.iter().map(|task| {
            let reference = TaskRef::new(task.name.as_str(), task.tid);
            let call = self
                .cx
                .call(&reference, EnterPhase { phase })
                .deadline(limit);
            async move { (task.name.clone(), call.await) }
        });
        let answers = join_all(calls).await;
        answers
            .into_iter()
            .filter_map(|(name, answer)| answer.err().map(|error| (name, error.reason())))
            .collect()
    }

    /// Stops all tasks: those of chassis with `stop_first` before the others, each group in the
    /// reverse of the order in which it was created; then ends the processes.
    async fn stop(&self, end: &End) {
        self.events.borrow_mut().stopping = true;
        let reason = end.reason();
        self.event(&BootEvent::Stopping {
            reason: reason.to_string(),
        });
        let (first, rest): (Vec<_>, Vec<_>) = self
            .tasks
            .iter()
            .rev()
            .partition(|task| self.stops_first(task));
        let mut at_rest = BTreeMap::new();
        for task in first {
            let chassis = self.place_of(task);
            let stopped = self.stop_task(task, &reason).await;
            *at_rest.entry(chassis).or_insert(true) &= stopped;
        }
        for (chassis, _) in at_rest.into_iter().filter(|(_, stopped)| *stopped) {
            let chassis = self.cx.chassis().name_of(chassis).to_owned();
            self.event(&BootEvent::AtRest { chassis });
        }
        for task in rest {
            self.stop_task(task, &reason).await;
        }
        let code = i32::from(!matches!(end, End::Finished(result) if result.ok));
        for index in self.cx.chassis().others() {
            if self.cx.chassis().is_linked(index) {
                let agent = TaskRef::new("agent", system::agent_tid(index));
                let limit = self.cx.app().stop_timeout;
                // A chassis that does not answer is ended by its process, from outside.
                let _ = self.cx.call(&agent, Exit { code }).deadline(limit).await;
            }
        }
    }

    /// The chassis that a task is on now: it may have moved.
    fn place_of(&self, task: &TaskName) -> u8 {
        self.cx.chassis().directory.current(task.tid).chassis()
    }

    fn stops_first(&self, task: &TaskName) -> bool {
        let chassis = self.cx.chassis().name_of(self.place_of(task));
        debug_assert_ne!(chassis, BOOT_CHASSIS);
        let mut configured = self.cx.app().chassis.iter();
        configured.any(|config| config.name == chassis && config.stop_first)
    }

    /// Stops one task, unless its chassis is gone; a further interrupt goes on to the next one at
    /// once. Whether it has stopped in order.
    async fn stop_task(&self, task: &TaskName, reason: &StopReason) -> bool {
        if !self.cx.chassis().is_linked(self.place_of(task)) {
            return false;
        }
        let reference = TaskRef::new(task.name.as_str(), task.tid);
        let request = StopTask {
            reason: reason.clone(),
        };
        let limit = self.cx.app().stop_timeout;
        let call = self.cx.call(&reference, request).deadline(limit);
        let interrupted =
            async { while next_end(&self.events, &self.signal).await != End::Interrupted {} };
        let error = match select(
            std::pin::pin!(call.into_future()),
            std::pin::pin!(interrupted),
        )
        .await
        {
            Either::Left((Ok(()), _)) => None,
            // It was shut down before.
            Either::Left((Err(error), _)) if error.fault == Fault::UnknownTask => None,
            Either::Left((Err(error), _)) => Some(error.reason()),
            Either::Right(((), _)) => Some("skipped at a second interrupt".to_owned()),
        };
        let stopped = error.is_none();
        self.event(&BootEvent::Stopped {
            task: task.name.clone(),
            error,
        });
        stopped
    }
}

/// The next thing that ends the app.
async fn next_end(events: &Rc<RefCell<Events>>, signal: &Signal) -> End {
    loop {
        let end = events.borrow_mut().ends.pop_front();
        match end {
            Some(end) => return end,
            None => signal.wait().await,
        }
    }
}
