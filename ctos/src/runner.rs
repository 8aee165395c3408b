//! The loop of a task: takes messages from its queue, calls its handler, contains its panics, and
//! builds the handler anew as `supervise.rs` rules.

use std::{panic::AssertUnwindSafe, pin::pin, rc::Rc, sync::Arc};

use futures_util::{
    FutureExt,
    future::{Either, LocalBoxFuture, select},
};

use crate::{
    call::{Fault, ReplySlot},
    chassis::{Chassis, TaskRecord},
    config::TaskConfig,
    context::{Context, TaskRef},
    mailbox::Mailbox,
    message::{Command, CommandInfo, Message, SYSTEM_COMMANDS, Tid},
    moving::{self, Arrival, Departed},
    processor::{Processor, panic_text},
    record::{AtHand, Ending as HandlerEnding},
    supervise::{Ending, Event, Policy, Restarts, State, Verdict},
    system::{
        Broke, Change, ChassisDown, ChassisUp, EnterPhase, MoveOut, RestartTask, Shutdown,
        StopTask, TaskChanged, TaskName, interrupts,
    },
    task::{DynHandler, Handled, HandlerError, Phase, StopReason},
    waits::Waits,
};

/// How many messages the queue of a runtime task holds.
const SYSTEM_QUEUE: usize = 1024;

type Build = Arc<dyn Fn(&Context) -> Result<Box<dyn DynHandler>, HandlerError> + Send + Sync>;

/// What others see of a task of the configuration, or of the runtime itself.
pub(crate) fn record(name: &str, tid: Tid, config: Option<&TaskConfig>) -> Arc<TaskRecord> {
    let capacity = config.map_or(SYSTEM_QUEUE, |config| config.queue);
    Arc::new(TaskRecord {
        name: name.into(),
        tid,
        mailbox: Arc::new(Mailbox::new(capacity)),
        statistics: Arc::default(),
        waits: Waits::default(),
    })
}

/// A task to start.
pub(crate) struct TaskSpec {
    pub(crate) record: Arc<TaskRecord>,
    pub(crate) config: Option<TaskConfig>,
    pub(crate) commands: Vec<CommandInfo>,
    pub(crate) build: Build,
}

/// Tells the task that started this one why it has failed.
type TellParent = Box<dyn Fn(&str)>;

/// How a task came to be.
pub(crate) enum Origin {
    /// By the configuration, or as a part of the runtime.
    Boot,
    /// By another task of its processor, which is told when it fails.
    StartedBy(TellParent),
    /// From another place, with its state.
    Moved(Arrival),
}

/// What the loop does after a message.
enum Next {
    Take,
    End,
    Forward(Departed),
}

/// What came of building a handler anew.
enum Rebuilt {
    Yes,
    No(String),
    StopWaits,
}

pub(crate) struct Runner {
    pub(crate) cx: Context,
    pub(crate) record: Arc<TaskRecord>,
    build: Build,
    /// None between two incarnations.
    pub(crate) handler: Option<Box<dyn DynHandler>>,
    restarts: Restarts,
    state: State,
    /// What the next handler takes over.
    pub(crate) kept: Option<Vec<u8>>,
    /// The last phase that was entered: a restarted handler is brought back to it.
    pub(crate) phase: Option<Phase>,
    /// Who is told when it fails for good, in place of the bootstrap service.
    parent: Option<TellParent>,
}

/// Builds a handler and starts its task on `processor`.
///
/// # Errors
/// Why the handler could not be built.
pub(crate) fn start_task(
    chassis: &Arc<Chassis>,
    processor: &Rc<Processor>,
    spec: TaskSpec,
) -> Result<(), HandlerError> {
    start_at(chassis, processor, spec, Origin::Boot)
}

/// [`start_task`] for a task of any origin.
///
/// # Errors
/// As [`start_task`].
pub(crate) fn start_at(
    chassis: &Arc<Chassis>,
    processor: &Rc<Processor>,
    spec: TaskSpec,
    origin: Origin,
) -> Result<(), HandlerError> {
    let policy = spec
        .config
        .as_ref()
        .map_or_else(Policy::default, |config| config.restart);
    let cx = Context::new(
        spec.record.clone(),
        chassis.clone(),
        processor.clone(),
        spec.config,
        spec.commands,
    );
    let handler = build_contained(&spec.build, &cx)?;
    chassis.add_task(spec.record.clone());
    spec.record.statistics.meter.count(cx.commands());
    chassis
        .tap
        .built(spec.record.tid, &spec.record.name, cx.commands());
    let (parent, arrival) = match origin {
        Origin::Boot => (None, None),
        Origin::StartedBy(parent) => (Some(parent), None),
        Origin::Moved(arrival) => (None, Some(arrival)),
    };
    let runner = Runner {
        cx: cx.clone(),
        record: spec.record,
        build: spec.build,
        handler: Some(handler),
        restarts: Restarts::new(policy, cx.rng("restart")),
        state: State::Running,
        kept: None,
        phase: None,
        parent,
    };
    // Panics of the handler are caught where it is called. What is left is its destructor.
    let on_panic = move |text: String| {
        cx.fail(&format!("it panicked while it ended: {text}"));
        cx.cancel_children();
        cx.chassis().remove_task(cx.tid());
    };
    processor.spawn(runner.run(arrival), Some(Rc::new(on_panic)));
    Ok(())
}

fn build_contained(build: &Build, cx: &Context) -> Result<Box<dyn DynHandler>, HandlerError> {
    std::panic::catch_unwind(AssertUnwindSafe(|| build(cx))).unwrap_or_else(|panic| {
        Err(HandlerError::new(format!(
            "panicked while it was built: {}",
            panic_text(panic.as_ref())
        )))
    })
}

impl Runner {
    async fn run(mut self, arrival: Option<Arrival>) {
        let settled = match arrival {
            Some(arrival) => moving::arrive(&mut self, arrival).await,
            None => true,
        };
        if settled {
            self.serve().await;
        }
        self.cx.cancel_children();
        self.cx.end_all_started().await;
        self.cx.chassis().remove_task(self.cx.tid());
    }

    async fn serve(&mut self) {
        while let Some(message) = self.record.mailbox.next().await {
            let abandoned = message.reply.as_ref().is_some_and(ReplySlot::is_abandoned);
            // A stop is carried out even when whoever ordered it had to go on.
            if abandoned && message.command() != StopTask::CODE {
                tracing::debug!(task = %self.cx.name(), command = message.command(), "caller gave up");
                continue;
            }
            if self.state == State::Stopped && message.command() < SYSTEM_COMMANDS {
                if let Some(slot) = message.reply {
                    slot.answer(Err(Fault::Stopping));
                }
                continue;
            }
            match self.take(message).await {
                Next::Take => {}
                Next::End => return,
                Next::Forward(departed) => {
                    return moving::forward(&self.cx, &self.record, departed).await;
                }
            }
        }
    }

    /// Moves along the table of `supervise.rs`.
    pub(crate) fn step(&mut self, event: Event) {
        match self.state.next(event) {
            Some(next) => self.state = next,
            None => {
                let state = self.state;
                tracing::error!(task = %self.cx.name(), ?state, ?event, "this cannot be");
            }
        }
    }

    pub(crate) fn is_running(&self) -> bool {
        self.state == State::Running && self.phase == Some(Phase::Run)
    }

    pub(crate) fn is_child(&self) -> bool {
        self.parent.is_some()
    }

    /// Handles one message.
    async fn take(&mut self, message: Message) -> Next {
        match message.command() {
            command if command < SYSTEM_COMMANDS || self.cx.config().is_none() => {}
            Broke::CODE => return self.broke(message).await,
            Shutdown::CODE => return self.shut_down(message).await,
            RestartTask::CODE => return self.restart(message).await,
            MoveOut::CODE => {
                return match moving::depart(self, message).await {
                    Some(departed) => {
                        self.step(Event::Moved);
                        Next::Forward(departed)
                    }
                    None if self.handler.is_none() => self.rebuilt_after_failed_move().await,
                    None => Next::Take,
                };
            }
            _ => {}
        }
        let slot = message.reply.clone();
        let command = message.command();
        let record = self.record.clone();
        let cx = self.cx.within(message.trace());
        cx.chassis().delivered(&record, &message);
        let began = cx.now();
        record.statistics.begin(command, began);
        let at_hand = AtHand::of(record.tid, &message, began);
        cx.chassis().tap.began(&at_hand);
        let handling = AssertUnwindSafe(self.call(&cx, message)).catch_unwind();
        let handling = record.statistics.meter.in_turns(handling);
        let outcome = if interrupts(command) {
            handling.await
        } else {
            // A handler that waits for others must not delay an orderly stop: it is dropped there.
            match select(handling, pin!(record.mailbox.interruption_waits())).await {
                Either::Left((outcome, _)) => outcome,
                Either::Right((broke, _)) => {
                    let now = cx.now();
                    record.statistics.end(false, now);
                    cx.chassis()
                        .tap
                        .ended(&at_hand, now, || HandlerEnding::Stopped);
                    if let Some(slot) = slot {
                        slot.answer(Err(if broke {
                            let text = "a part of it did, while it was handled".to_owned();
                            Fault::Panicked { text }
                        } else {
                            Fault::Stopping
                        }));
                    }
                    return Next::Take;
                }
            }
        };
        let now = cx.now();
        record.statistics.end(matches!(outcome, Ok(Ok(()))), now);
        cx.chassis().tap.ended(&at_hand, now, || match &outcome {
            Ok(Ok(())) => HandlerEnding::Done,
            Ok(Err(error)) => HandlerEnding::Refused(error.to_string()),
            Err(panic) => HandlerEnding::Panicked(panic_text(panic.as_ref())),
        });
        match outcome {
            Ok(Ok(())) => Next::Take,
            Ok(Err(error)) => {
                tracing::debug!(task = %self.cx.name(), command, error = %error, "refused");
                if let Some(slot) = slot {
                    slot.answer(Err(Fault::Refused {
                        text: error.to_string(),
                    }));
                }
                Next::Take
            }
            Err(panic) => {
                let text = panic_text(panic.as_ref());
                tracing::error!(task = %self.cx.name(), command, panic = %text, "handler panicked");
                if let Some(slot) = slot {
                    slot.answer(Err(Fault::Panicked { text: text.clone() }));
                }
                let why = format!("its handler panicked: {text}");
                self.supervise(Ending::Failure, why).await
            }
        }
    }

    fn call<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled> {
        match message.command() {
            EnterPhase::CODE => return Box::pin(self.enter_phase(cx, message)),
            StopTask::CODE => return Box::pin(self.stop(cx, message)),
            _ => {}
        }
        let Some(handler) = self.handler.as_deref_mut() else {
            // Between two incarnations a message is begun only before a stop that waits behind it.
            if let Some(slot) = message.reply {
                slot.answer(Err(Fault::Stopping));
            }
            return Box::pin(std::future::ready(Ok(())));
        };
        match message.command() {
            ChassisDown::CODE => Box::pin(chassis_down(handler, cx, message)),
            ChassisUp::CODE => Box::pin(chassis_up(handler, cx, message)),
            TaskChanged::CODE if cx.config().is_some() => {
                Box::pin(task_changed(handler, cx, message))
            }
            command if command >= SYSTEM_COMMANDS && cx.config().is_some() => {
                let handled = cx.default_processing(message);
                Box::pin(std::future::ready(handled))
            }
            _ => handler.handle(cx, message),
        }
    }

    async fn enter_phase(&mut self, cx: &Context, message: Message) -> Handled {
        let (EnterPhase { phase }, reply) = message.open::<EnterPhase>()?;
        let handler = self.handler.as_mut().ok_or("it is being restarted")?;
        handler.phase(cx, phase).await?;
        self.entered(phase);
        reply.ok(())
    }

    pub(crate) fn entered(&mut self, phase: Phase) {
        self.phase = Some(phase);
        self.record.statistics.entered(phase, self.cx.now());
        let tap = &self.cx.chassis().tap;
        tap.phase(self.cx.tid(), Some(phase));
    }

    async fn stop(&mut self, cx: &Context, message: Message) -> Handled {
        let (StopTask { reason, .. }, reply) = message.open::<StopTask>()?;
        self.step(Event::Stop);
        cx.chassis().set_stopping();
        if let Some(handler) = &mut self.handler {
            handler.stop(cx, &reason).await?;
        }
        cx.end_all_started().await;
        reply.ok(())
    }

    /// A child or a synchronous function of this task panicked.
    async fn broke(&mut self, message: Message) -> Next {
        match message.open::<Broke>() {
            Ok((broke, _)) if broke.incarnation == self.cx.incarnation() => {
                tracing::error!(task = %self.cx.name(), reason = %broke.reason, "a part of it broke");
                self.supervise(Ending::Failure, broke.reason).await
            }
            _ => Next::Take,
        }
    }

    /// A person wants the handler built anew, whatever the policy says.
    async fn restart(&mut self, message: Message) -> Next {
        let Ok((RestartTask {}, reply)) = message.open::<RestartTask>() else {
            return Next::Take;
        };
        // Below, a reply cannot fail.
        if self.state == State::Stopped {
            let _ = reply.fail("it is being stopped");
            return Next::Take;
        }
        let why = "it is restarted by order".to_owned();
        self.end_incarnation(Ending::Order).await;
        self.tell(Change::Down { reason: why });
        self.record.statistics.restarted();
        match self.rebuild_or_stop().await {
            Rebuilt::Yes => {
                self.tell(Change::Up);
                tracing::warn!(task = %self.cx.name(), "restarted by order");
                let _ = reply.ok(());
                Next::Take
            }
            Rebuilt::StopWaits => {
                let _ = reply.fail("it is being stopped");
                Next::Take
            }
            Rebuilt::No(broken) => {
                let why = format!("it could not be restarted: {broken}");
                let _ = reply.fail(&why);
                self.kept = None;
                self.supervise(Ending::Failure, why).await
            }
        }
    }

    /// Comes to an orderly stop by itself.
    async fn shut_down(&mut self, message: Message) -> Next {
        let Ok((Shutdown {}, reply)) = message.open::<Shutdown>() else {
            return Next::Take;
        };
        let limit = self.cx.app().stop_timeout;
        let cx = self.cx.clone();
        let mut why = "it was told to shut down".to_owned();
        if let Some(handler) = &mut self.handler {
            let stopping = AssertUnwindSafe(handler.stop(&cx, &StopReason::Shutdown));
            match cx.timeout(limit, stopping.catch_unwind()).await {
                Ok(Ok(Ok(()))) => {}
                Ok(Ok(Err(error))) => why = format!("it was told to shut down and said: {error}"),
                Ok(Err(panic)) => {
                    let text = panic_text(panic.as_ref());
                    why = format!("it panicked while it shut down: {text}");
                }
                Err(elapsed) => why = format!("it was told to shut down: {elapsed}"),
            }
        }
        let next = self.supervise(Ending::Order, why).await;
        // Never an error: a reply cannot fail.
        let _ = reply.ok(());
        next
    }

    /// What happens after an end: what the restart policy rules.
    async fn supervise(&mut self, ending: Ending, why: String) -> Next {
        let (mut ending, mut why) = (ending, why);
        loop {
            self.end_incarnation(ending).await;
            let verdict = if self.state == State::Stopped {
                Verdict::StayDown
            } else {
                self.restarts.judge(ending, self.cx.now())
            };
            let Verdict::RestartAfter(backoff) = verdict else {
                self.give_up(ending, &why, verdict).await;
                return Next::End;
            };
            self.step(Event::RestartAllowed);
            self.tell(Change::Down {
                reason: why.clone(),
            });
            if !self.backs_off(backoff).await {
                return Next::Take;
            }
            self.step(Event::BackoffOver);
            self.record.statistics.restarted();
            match self.rebuild_or_stop().await {
                Rebuilt::Yes => {
                    self.step(Event::Rebuilt);
                    self.tell(Change::Up);
                    tracing::warn!(task = %self.cx.name(), reason = %why, "restarted");
                    return Next::Take;
                }
                // Half rebuilt, but what can be stopped of it is stopped next.
                Rebuilt::StopWaits => return Next::Take,
                Rebuilt::No(broken) => {
                    // What may have broken it is not tried twice.
                    self.kept = None;
                    ending = Ending::Failure;
                    why = format!("it could not be restarted: {broken}");
                }
            }
        }
    }

    /// Waits before a restart; false when an order to stop came meanwhile.
    async fn backs_off(&self, backoff: std::time::Duration) -> bool {
        let sleep = pin!(self.cx.sleep(backoff));
        let stop = pin!(self.record.mailbox.stop_waits());
        matches!(select(sleep, stop).await, Either::Left(_))
    }

    async fn rebuild_or_stop(&mut self) -> Rebuilt {
        let (cx, mailbox) = (self.cx.clone(), self.record.mailbox.clone());
        let limit = cx.app().phase_timeout;
        let rebuilt = AssertUnwindSafe(cx.timeout(limit, self.rebuild())).catch_unwind();
        match select(pin!(rebuilt), pin!(mailbox.stop_waits())).await {
            Either::Left((Ok(Ok(Ok(()))), _)) => Rebuilt::Yes,
            Either::Left((Ok(Ok(Err(error))), _)) => Rebuilt::No(error.to_string()),
            Either::Left((Ok(Err(elapsed)), _)) => Rebuilt::No(elapsed.to_string()),
            Either::Left((Err(panic), _)) => {
                Rebuilt::No(format!("it panicked again: {}", panic_text(panic.as_ref())))
            }
            Either::Right(_) => Rebuilt::StopWaits,
        }
    }

    /// The old incarnation is finished before anything of a new one begins: its state is kept where that
    /// is allowed, and its children, its tasks and what it had not answered yet end now.
    pub(crate) async fn end_incarnation(&mut self, ending: Ending) {
        self.cx.next_incarnation();
        self.cx.cancel_children();
        self.record.mailbox.forget_broken();
        if let Some(mut handler) = self.handler.take() {
            if ending == Ending::Order || handler.survives_panic() {
                let given = std::panic::catch_unwind(AssertUnwindSafe(|| handler.hand_over()));
                match given {
                    Ok(Some(Ok(state))) => self.kept = Some(state),
                    Ok(Some(Err(error))) => {
                        tracing::warn!(task = %self.cx.name(), error = %error, "no state is kept");
                    }
                    Ok(None) | Err(_) => {}
                }
            }
            drop_handler(&self.cx, handler);
        }
        self.cx.end_all_started().await;
    }

    /// It is not restarted: whoever must know is told, and its name is free.
    async fn give_up(&mut self, ending: Ending, why: &str, verdict: Verdict) {
        let tried = match verdict {
            Verdict::GiveUp { restarts } => format!(" (after {restarts} restarts)"),
            _ => String::new(),
        };
        let reason = format!("{why}{tried}");
        match ending {
            Ending::Order if self.state == State::Running => self.step(Event::ShutDown),
            Ending::Order => {}
            Ending::Failure => {
                self.step(Event::RestartRefused);
                match &self.parent {
                    Some(parent) => parent(&format!("`{}`: {reason}", self.cx.name())),
                    None => self.cx.fail(&reason),
                }
            }
        }
        // Whatever is still in its queue is answered before the name can be anybody else's.
        self.cx.chassis().remove_task(self.cx.tid());
        let changed = self.changed(Change::Ended { reason });
        let told = self.cx.call(&Context::server(), changed);
        if let Err(error) = told.deadline(self.cx.app().stop_timeout).await {
            tracing::debug!(task = %self.cx.name(), error = %error, "its name is not free");
        }
    }

    fn changed(&self, change: Change) -> TaskChanged {
        TaskChanged {
            task: TaskName {
                name: self.cx.name().to_owned(),
                tid: self.cx.tid(),
            },
            change,
        }
    }

    fn tell(&self, change: Change) {
        let changed = self.changed(change);
        let chassis = self.cx.chassis();
        chassis.post_system(crate::system::TID_SERVER, changed);
    }

    /// A move came to nothing after the state had been given away.
    async fn rebuilt_after_failed_move(&mut self) -> Next {
        match self.rebuild_or_stop().await {
            Rebuilt::Yes | Rebuilt::StopWaits => Next::Take,
            Rebuilt::No(why) => {
                let why = format!("it could not go on after a move that failed: {why}");
                self.supervise(Ending::Failure, why).await
            }
        }
    }

    /// Builds the handler anew and brings it to the phase that the old one had reached. Messages
    /// that wait in the queue stay there.
    async fn rebuild(&mut self) -> Handled {
        let mut handler = build_contained(&self.build, &self.cx)?;
        if let Some(state) = &self.kept {
            handler.take_over(&self.cx, state)?;
        }
        let handler = self.handler.insert(handler);
        let reached = self.phase;
        for phase in Phase::ALL {
            if reached.is_some_and(|reached| phase <= reached) {
                handler.phase(&self.cx, phase).await?;
            }
        }
        self.kept = None;
        Ok(())
    }
}

/// Drops a handler; a destructor that panics is no reason to lose the task.
pub(crate) fn drop_handler(cx: &Context, handler: Box<dyn DynHandler>) {
    if let Err(panic) = std::panic::catch_unwind(AssertUnwindSafe(|| drop(handler))) {
        let text = panic_text(panic.as_ref());
        tracing::error!(task = %cx.name(), panic = %text, "its destructor panicked");
    }
}

async fn chassis_down(handler: &mut dyn DynHandler, cx: &Context, message: Message) -> Handled {
    let (ChassisDown { chassis }, _) = message.open::<ChassisDown>()?;
    handler.chassis_down(cx, &chassis).await
}

async fn chassis_up(handler: &mut dyn DynHandler, cx: &Context, message: Message) -> Handled {
    let (ChassisUp { chassis }, _) = message.open::<ChassisUp>()?;
    handler.chassis_up(cx, &chassis).await
}

async fn task_changed(handler: &mut dyn DynHandler, cx: &Context, message: Message) -> Handled {
    let (TaskChanged { task, change }, _) = message.open::<TaskChanged>()?;
    match change {
        Change::Up => {
            let task = TaskRef::new(task.name, task.tid);
            handler.task_up(cx, &task).await
        }
        Change::Down { reason } | Change::Ended { reason } => {
            handler.task_down(cx, &task.name, &reason).await
        }
    }
}
