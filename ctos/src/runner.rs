//! The loop of a task: takes messages from its queue, calls its handler, contains its panics, and
//! builds the handler anew as `supervise.rs` rules.

use std::{
    cell::Cell,
    future::{Future, poll_fn},
    panic::{AssertUnwindSafe, catch_unwind},
    pin::{Pin, pin},
    rc::Rc,
    sync::Arc,
    task::{Context as PollContext, Poll},
};

use futures_util::{
    FutureExt,
    future::{Either, LocalBoxFuture, select},
};

use crate::{
    call::{Fault, ReplyKey, ReplySlot},
    chassis::{Chassis, TaskRecord},
    config::TaskConfig,
    context::{Context, TaskRef},
    mailbox::{Mailbox, TaskQueue},
    message::{Command, CommandInfo, Message, SYSTEM_COMMANDS, Tid},
    moving::{self, Arrival, Departed},
    processor::{Processor, ProcessorHandle, panic_text},
    record::{self, Ending as HandlerEnding},
    statistics::TaskStatistics,
    supervise::{Ending, Event, Policy, Restarts, State, Verdict},
    system::{
        Broke, Change, ChassisDown, ChassisUp, EnterPhase, MoveOut, RestartTask, Shutdown,
        StopTask, TaskChanged, TaskName, interrupts,
    },
    task::{DynHandler, EventHandler, Handled, HandlerError, Phase, StopReason},
    waits::Waits,
};

/// How many messages the queue of a runtime task holds.
const SYSTEM_QUEUE: usize = 1024;

type Build = Arc<dyn Fn(&Context) -> Result<Box<dyn DynHandler>, HandlerError> + Send + Sync>;

/// What others see of a task of the configuration, or of the runtime itself.
pub(crate) fn record(
    name: &str,
    tid: Tid,
    config: Option<&TaskConfig>,
    processor: &Arc<ProcessorHandle>,
) -> Arc<TaskRecord> {
    let capacity = config.map_or(SYSTEM_QUEUE, |config| config.queue);
    Arc::new(TaskRecord {
        name: name.into(),
        tid,
        mailbox: Mailbox::new(capacity, processor.clone(), tid.slot()),
        statistics: TaskStatistics::default(),
        waits: Waits::default(),
    })
}

/// A task to start.
pub(crate) struct TaskSpec {
    pub(crate) record: Arc<TaskRecord>,
    pub(crate) config: Option<TaskConfig>,
    pub(crate) commands: Arc<[CommandInfo]>,
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

/// What the loop of a task needs besides its handler.
pub(crate) struct Serving {
    cx: Context,
    record: Arc<TaskRecord>,
    queue: Rc<TaskQueue>,
    /// It was told to stop: nothing more is begun, or hardware at rest would move again.
    stopped: Cell<bool>,
}

/// Why the handling of a task's messages was interrupted.
pub(crate) enum Served {
    /// By a message that is not for the handler, or not for it alone.
    Next(Message),
    /// By a panic that said so.
    Panicked(String),
    /// By the end of the queue.
    Closed,
}

pub(crate) struct Runner {
    pub(crate) cx: Context,
    pub(crate) record: Arc<TaskRecord>,
    pub(crate) queue: Rc<TaskQueue>,
    serving: Rc<Serving>,
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
    let queue = TaskQueue::new(spec.record.mailbox.clone());
    processor.add_queue(spec.record.tid.slot(), queue.clone());
    chassis.add_task(spec.record.clone());
    spec.record.statistics.meter.count(cx.commands());
    chassis.tap.built(spec.record.tid, &spec.record.name);
    let (parent, arrival) = match origin {
        Origin::Boot => (None, None),
        Origin::StartedBy(parent) => (Some(parent), None),
        Origin::Moved(arrival) => (None, Some(arrival)),
    };
    let runner = Runner {
        cx: cx.clone(),
        record: spec.record.clone(),
        queue: queue.clone(),
        serving: Rc::new(Serving {
            cx: cx.clone(),
            record: spec.record,
            queue: queue.clone(),
            stopped: Cell::new(false),
        }),
        build: spec.build,
        handler: Some(handler),
        restarts: Restarts::new(policy, cx.seed_of("restart")),
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
    let runner = processor.spawn(runner.run(arrival), Some(Rc::new(on_panic)));
    queue.set_runner(runner);
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

/// How the handling of one message ended.
enum Ended {
    Done(Handled),
    Panicked(String),
    /// By a message that ends whatever it does; whether because a part of it broke.
    Interrupted(bool),
}

/// A message that is about to be handled, or is.
struct AtHand {
    command: u16,
    serial: u64,
    owed: Option<ReplyKey>,
    /// The message, for the record.
    noted: record::AtHand,
}

impl Serving {
    /// Puts the next message that is to be handled into `next`; none once the queue is closed.
    #[inline(always)]
    fn poll_next(&self, next: &mut Option<Message>) -> Poll<()> {
        loop {
            if self.queue.poll_next(next).is_pending() {
                return Poll::Pending;
            }
            if next
                .as_mut()
                .is_none_or(|message| self.is_wanted(message))
            {
                return Poll::Ready(());
            }
            if let Some(message) = next.take() {
                self.pass_over(message);
            }
        }
    }

    /// The next message that is to be handled; `None` once the queue is closed.
    async fn next(&self) -> Option<Message> {
        let mut next = None;
        poll_fn(|_| self.poll_next(&mut next)).await;
        next
    }

    /// Whether a message is still to be begun.
    #[inline]
    fn is_wanted(&self, message: &mut Message) -> bool {
        if self.refuses(message) {
            return false;
        }
        let Some(slot) = &message.reply else {
            return true;
        };
        // A stop is carried out even when whoever ordered it had to go on.
        if slot.is_abandoned() && message.command() != StopTask::CODE {
            return false;
        }
        if message.deadline.is_none() {
            message.deadline = slot.deadline_on(self.cx.processor());
        }
        true
    }

    /// Ends a message that is not begun.
    #[cold]
    fn pass_over(&self, message: Message) {
        let command = message.command();
        tracing::debug!(task = %self.cx.name(), command, "caller gave up, or the task is stopping");
        if let Some(slot) = message.reply {
            slot.answer(Err(Fault::Stopping));
        }
    }

    fn refuses(&self, message: &Message) -> bool {
        self.stopped.get() && message.command() < SYSTEM_COMMANDS
    }

    /// The handler is called with `message`. This is the one place that every message passes on its
    /// way to a handler.
    #[inline]
    fn begin(&self, message: &mut Message) -> AtHand {
        let processor = self.cx.processor();
        let chassis = self.cx.chassis();
        let began = processor.recent();
        let at_hand = AtHand {
            command: message.command(),
            noted: record::AtHand::of(self.record.tid, message, began),
            serial: processor.next_serial(),
            owed: message.reply.as_ref().and_then(ReplySlot::key),
        };
        if let Some(slot) = &mut message.reply {
            slot.set_serial(at_hand.serial);
        }
        chassis.delivered(&self.record, message);
        self.record.statistics.begin(at_hand.command, began);
        chassis.tap.began(&at_hand.noted);
        at_hand
    }

    /// The handler has ended, in whatever way: what it owes is answered. What its panic said, if it
    /// panicked.
    fn end(&self, at_hand: AtHand, ended: Ended) -> Option<String> {
        let AtHand {
            command,
            serial,
            owed,
            noted,
            ..
        } = at_hand;
        let processor = self.cx.processor();
        let ok = matches!(ended, Ended::Done(Ok(())));
        let now = processor.look_at_clock();
        self.record.statistics.end(ok, now);
        self.cx.chassis().tap.ended(&noted, now, || match &ended {
            Ended::Done(Ok(())) => HandlerEnding::Done,
            Ended::Done(Err(error)) => HandlerEnding::Refused(error.to_string()),
            Ended::Panicked(text) => HandlerEnding::Panicked(text.clone()),
            Ended::Interrupted(_) => HandlerEnding::Stopped,
        });
        let (fault, panic) = match ended {
            Ended::Done(Ok(())) => {
                // A right to answer that it kept is still good; one that it dropped is not.
                drop(processor.take_orphan(serial).map(|mut slot| {
                    slot.set_serial(0);
                    slot
                }));
                return None;
            }
            Ended::Done(Err(error)) => {
                tracing::debug!(task = %self.cx.name(), command, error = %error, "refused");
                let text = error.to_string();
                (Fault::Refused { text }, None)
            }
            Ended::Interrupted(true) => {
                let text = "a part of it did, while it was handled".to_owned();
                (Fault::Panicked { text }, None)
            }
            Ended::Interrupted(false) => (Fault::Stopping, None),
            Ended::Panicked(text) => {
                tracing::error!(task = %self.cx.name(), command, panic = %text, "handler panicked");
                let fault = Fault::Panicked { text: text.clone() };
                (fault, Some(text))
            }
        };
        match (processor.take_orphan(serial), owed) {
            (Some(slot), _) => slot.answer(Err(fault)),
            (None, Some(key)) => self.cx.chassis().answer_by_key(key, Err(fault)),
            (None, None) => {}
        }
        panic
    }

    /// Polls a handler: to its end, its panic, or, if it is `interruptible`, an order to stop.
    #[inline]
    fn poll<F: Future<Output = Handled>>(
        &self,
        at_hand: &AtHand,
        handling: Pin<&mut Option<F>>,
        interruptible: bool,
        cx: &mut PollContext<'_>,
    ) -> Poll<Ended> {
        let Some(handling) = handling.as_pin_mut() else {
            return Poll::Pending;
        };
        let processor = self.cx.processor();
        processor.leave();
        let polled = self.record.statistics.meter.in_turn(|| {
            catch_unwind(AssertUnwindSafe(|| {
                processor.handling(at_hand.serial, || handling.poll(cx))
            }))
        });
        match polled {
            Ok(Poll::Ready(handled)) => Poll::Ready(Ended::Done(handled)),
            Err(panic) => Poll::Ready(Ended::Panicked(panic_text(panic.as_ref()))),
            // A handler that waits for others must not delay an orderly stop: it is dropped there.
            Ok(Poll::Pending) if interruptible => match self.queue.interruption() {
                Some(broke) => Poll::Ready(Ended::Interrupted(broke)),
                None => Poll::Pending,
            },
            Ok(Poll::Pending) => Poll::Pending,
        }
    }

    /// See [`DynHandler::serve`].
    pub(crate) async fn serve<H: EventHandler>(&self, handler: &mut H, first: Message) -> Served {
        let mut next = Some(first);
        while let Some(mut message) = next.take() {
            let at_hand = self.begin(&mut message);
            let cx = self.cx.within(message.trace());
            let mut handling = pin!(Some(EventHandler::handle(handler, &cx, message)));
            let ended = poll_fn(|poll| self.poll(&at_hand, handling.as_mut(), true, poll)).await;
            let processor = self.cx.processor();
            processor.handling(at_hand.serial, || handling.set(None));
            if let Some(panic) = self.end(at_hand, ended) {
                return Served::Panicked(panic);
            }
            poll_fn(|_| self.poll_next(&mut next)).await;
            if let Some(of_runtime) = next.take_if(|next| next.command() >= SYSTEM_COMMANDS) {
                return Served::Next(of_runtime);
            }
        }
        Served::Closed
    }
}

impl Runner {
    async fn run(mut self, arrival: Option<Arrival>) {
        let settled = match arrival {
            Some(arrival) => moving::arrive(&mut self, arrival).boxed_local().await,
            None => true,
        };
        if settled {
            self.serve().await;
        }
        self.cx.cancel_children();
        self.cx.end_all_started().boxed_local().await;
        self.cx.chassis().remove_task(self.cx.tid());
    }

    async fn serve(&mut self) {
        let serving = self.serving.clone();
        let mut next = serving.next().await;
        while let Some(message) = next.take() {
            let of_tasks = message.command() < SYSTEM_COMMANDS;
            let then = match self.handler.as_deref_mut() {
                Some(handler) if of_tasks => match handler.serve(&serving, message).await {
                    Served::Next(message) => {
                        next = Some(message);
                        continue;
                    }
                    Served::Closed => return,
                    Served::Panicked(text) => {
                        let why = format!("its handler panicked: {text}");
                        self.supervise(Ending::Failure, why).boxed_local().await
                    }
                },
                _ => self.take(message).boxed_local().await,
            };
            match then {
                Next::Take => next = serving.next().await,
                Next::End => return,
                Next::Forward(departed) => {
                    let forwarding = moving::forward(&self.cx, &self.queue, departed);
                    return forwarding.boxed_local().await;
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
        self.cx.processor().leave();
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
        let serving = self.serving.clone();
        let mut message = message;
        let at_hand = serving.begin(&mut message);
        let cx = self.cx.within(message.trace());
        let interruptible = !interrupts(message.command());
        let ended = {
            let mut handling = pin!(Some(self.call(&cx, message)));
            let ended =
                poll_fn(|poll| serving.poll(&at_hand, handling.as_mut(), interruptible, poll));
            let ended = ended.await;
            let processor = serving.cx.processor();
            processor.handling(at_hand.serial, || handling.set(None));
            ended
        };
        match serving.end(at_hand, ended) {
            Some(text) => {
                let why = format!("its handler panicked: {text}");
                self.supervise(Ending::Failure, why).await
            }
            None => Next::Take,
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
        let (StopTask { reason }, reply) = message.open::<StopTask>()?;
        self.step(Event::Stop);
        self.serving.stopped.set(true);
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
        self.cx.processor().leave();
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
        let stop = pin!(self.queue.stop_waits());
        matches!(select(sleep, stop).await, Either::Left(_))
    }

    async fn rebuild_or_stop(&mut self) -> Rebuilt {
        let (cx, queue) = (self.cx.clone(), self.queue.clone());
        let limit = cx.app().phase_timeout;
        let rebuilt = AssertUnwindSafe(cx.timeout(limit, self.rebuild())).catch_unwind();
        match select(pin!(rebuilt), pin!(queue.stop_waits())).await {
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
        self.queue.forget_broken();
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
