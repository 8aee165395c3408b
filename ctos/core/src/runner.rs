//! The loop of a task: takes messages from its queue, calls its handler, contains its panics, and
//! builds the handler anew as `supervise.rs` rules.

pub mod dynamic;
mod incarnation;
pub(crate) mod serving;

use crate::{
    chassis::Chassis,
    contain::contained,
    context::Context,
    envelope::Message,
    handled::{Handled, HandlerError},
    mailbox::queue::TaskQueue,
    moving::{self, Arrival, Departed},
    phase::Phase,
    processor::{Processor, ProcessorHandle},
    registry::Recipe,
    reply,
    runner::{
        dynamic::{DynHandler, Notice},
        serving::{Served, Serving},
    },
    supervise::{Ending, Event, Policy, Restarts, State},
    system::{
        Broke, Change, ChassisDown, ChassisUp, EnterPhase, MoveOut, Quiesce, RestartTask, Shutdown,
        StopTask, TaskChanged, interrupts,
    },
    tap::LOOP,
    task_record::TaskRecord,
};
use ctos_config::TaskConfig;
use ctos_message::{Command, SYSTEM_COMMANDS, Tid, fault::Fault};
use std::{cell::Cell, future::poll_fn, pin::pin, rc::Rc, sync::Arc};

use futures_util::{FutureExt, future::LocalBoxFuture};

/// A task to start.
pub struct TaskSpec {
    pub record: Arc<TaskRecord>,
    pub(crate) recipe: Arc<Recipe>,
    pub(crate) config: Option<Box<TaskConfig>>,
}

impl TaskSpec {
    /// A task of the configuration, or, without one, of the runtime itself.
    pub fn new(
        name: &str,
        tid: Tid,
        config: Option<TaskConfig>,
        recipe: Arc<Recipe>,
        processor: &Arc<ProcessorHandle>,
    ) -> Self {
        let commands = recipe.commands.clone();
        let record = match &config {
            Some(config) => TaskRecord::new(name, tid, config.queue, commands, processor),
            None => TaskRecord::of_runtime(name, tid, commands, processor),
        };
        Self {
            record,
            recipe,
            config: config.map(Box::new),
        }
    }
}

/// Tells the task that started this one why it has failed.
type TellParent = Box<dyn Fn(&str)>;

/// How a task came to be.
pub(crate) enum Origin {
    /// By the configuration, or as a part of the runtime.
    Boot,
    /// By another task of its processor, which hears when it fails.
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

pub struct Runner {
    pub(crate) cx: Context,
    pub(crate) record: Arc<TaskRecord>,
    pub(super) recipe: Arc<Recipe>,
    pub(crate) queue: Rc<TaskQueue>,
    serving: Rc<Serving>,
    /// None between two incarnations.
    pub(crate) handler: Option<Box<dyn DynHandler>>,
    /// Made when there is something to judge: most tasks never end before their app.
    restarts: Option<Box<Restarts>>,
    state: State,
    /// Whether it goes on from what was stored, if it is durable.
    pub(crate) resumed: bool,
    /// What the next handler takes over.
    pub(crate) kept: Option<Vec<u8>>,
    /// The last phase that was entered: a restarted handler is brought back to it.
    pub(crate) phase: Option<Phase>,
    /// Who hears of it when it fails for good, in place of the bootstrap service.
    parent: Option<TellParent>,
}

/// Builds a handler and starts its task on `processor`.
///
/// # Errors
/// Why the handler could not be built.
pub fn start_task(
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
    let cx = Context::new(spec.record, chassis.clone(), processor.clone(), spec.config);
    let recipe = spec.recipe;
    let handler = cx.inner.building_polled(|| build_contained(&recipe, &cx))?;
    let record = cx.inner.record.clone();
    let (parent, arrival) = match origin {
        Origin::Boot => (None, None),
        Origin::StartedBy(by) => (Some(by), None),
        Origin::Moved(from) => (None, Some(Box::new(from))),
    };
    let queue = if arrival.is_some() {
        let gates = chassis.others().chain([chassis.index()]).collect();
        TaskQueue::gated(record.clone(), gates)
    } else {
        TaskQueue::open(record.clone())
    };
    processor.add_queue(record.tid.slot(), queue.clone());
    chassis.add_built(record.clone());
    let runner = Box::new(Runner {
        serving: Rc::new(Serving {
            cx: cx.clone(),
            activity: record.statistics.activity().clone(),
            record: record.clone(),
            queue: queue.clone(),
            stopped: Cell::new(false),
        }),
        cx: cx.clone(),
        record,
        recipe,
        queue: queue.clone(),
        handler: Some(handler),
        restarts: None,
        state: State::Running,
        resumed: cx.inner.kept.is_none(),
        kept: None,
        phase: None,
        parent,
    });
    let inner = cx.inner.clone();
    // Panics of the handler are caught where it is called. What is left is its destructor.
    let on_panic = move |text: String| {
        cx.fail(&format!("it panicked while it ended: {text}"));
        cx.cancel_children();
        cx.chassis().remove_task(cx.tid());
    };
    let running = inner.polled_as(LOOP, runner.run(arrival));
    queue.set_runner(processor.spawn(running, Some(Rc::new(on_panic))));
    Ok(())
}

fn build_contained(recipe: &Recipe, cx: &Context) -> Result<Box<dyn DynHandler>, HandlerError> {
    contained(|| (recipe.build)(cx)).unwrap_or_else(|panic| {
        let text = format!("panicked while it was built: {panic}");
        Err(HandlerError::new(text))
    })
}

impl Runner {
    /// The loop. Boxed, both: what an asynchronous function is given stands twice in its future, and a chassis
    /// may have very many of them.
    async fn run(mut self: Box<Self>, arrival: Option<Box<Arrival>>) {
        let mut lives = match arrival {
            Some(arrival) => moving::arrive(&mut self, *arrival).boxed_local().await,
            None => true,
        };
        let serving = self.serving.clone();
        let mut next = None;
        while lives {
            let message = match next.take() {
                Some(message) => message,
                None => match serving.next().await {
                    Some(message) => message,
                    None => break,
                },
            };
            let of_tasks = message.command() < SYSTEM_COMMANDS;
            let then = match self.handler.as_deref_mut() {
                Some(handler) if of_tasks && self.cx.inner.kept.is_none() => {
                    match handler.serve(&serving, message).await {
                        Served::Next(message) => {
                            next = Some(message);
                            continue;
                        }
                        Served::Closed => break,
                        Served::Panicked(text) => {
                            let why = format!("its handler panicked: {text}");
                            self.supervise(Ending::Failure, why).boxed_local().await
                        }
                    }
                }
                _ => self.take(message).boxed_local().await,
            };
            match then {
                Next::Take => {}
                Next::End => lives = false,
                Next::Forward(departed) => {
                    let forwarding = moving::forward(&self.cx, &self.queue, departed);
                    forwarding.boxed_local().await;
                    lives = false;
                }
            }
        }
        self.cx.cancel_children();
        self.cx.end_all_started().boxed_local().await;
        self.cx.chassis().remove_task(self.cx.tid());
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

    /// What judges its ends by its policy.
    fn restarts(&mut self) -> &mut Restarts {
        let cx = &self.cx;
        self.restarts.get_or_insert_with(|| {
            let policy = cx
                .config()
                .map_or_else(Policy::default, |config| config.restart);
            Box::new(Restarts::new(policy, cx.seed_of("restart")))
        })
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
        if let Some(kept) = &self.cx.inner.kept {
            kept.hold(&mut message);
        }
        let mut at_hand = serving.begin(&mut message);
        let cx = self.cx.within(message.trace());
        let interruptible = !interrupts(message.command());
        let ended = {
            let mut handling = pin!(Some(self.call(&cx, message)));
            poll_fn(|poll| serving.poll(&at_hand, handling.as_mut(), interruptible, poll)).await
        };
        // What the handler owed belongs to what it answered.
        let panicked = reply::handling(at_hand.serial, || serving.end(&mut at_hand, ended));
        match self.store_state(panicked).await {
            Ok(()) => Next::Take,
            Err(why) => self.supervise(Ending::Failure, why).await,
        }
    }

    /// Stores the state of a durable task after a message, if it has changed, and lets go of the answers that waited
    /// for that. Why the handler has failed, if it has.
    async fn store_state(&mut self, panicked: Option<String>) -> Result<(), String> {
        let failed = match (panicked, &self.handler) {
            (Some(text), _) => {
                let why = format!("its handler panicked: {text}");
                Some((Fault::Panicked { text }, why))
            }
            (None, Some(handler)) if self.resumed && self.cx.inner.kept.is_some() => {
                let stored = match contained(|| handler.state()) {
                    Ok(Ok(state)) => self.cx.store_state(state).await,
                    Ok(Err(error)) => Err(error),
                    Err(panic) => Err(HandlerError::new(panic)),
                };
                stored.err().map(|error| {
                    let text = format!("its state could not be stored: {error}");
                    (Fault::Refused { text: text.clone() }, text)
                })
            }
            (None, _) => None,
        };
        if let Some(kept) = &self.cx.inner.kept {
            kept.release(failed.as_ref().map(|(instead, _)| instead));
        }
        failed.map_or(Ok(()), |(_, why)| Err(why))
    }

    /// Calls the handler of a durable task for the first time: it goes on from what its last process has stored.
    async fn resume(&mut self, cx: &Context, message: Message) -> Handled {
        if let (Some(state), Some(handler)) = (cx.load_state().await?, &mut self.handler) {
            handler.take_over(cx, &state)?;
        }
        self.resumed = true;
        self.call(cx, message).await
    }

    fn call<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled> {
        match message.command() {
            command
                if !self.resumed && (command < SYSTEM_COMMANDS || command == EnterPhase::CODE) =>
            {
                return Box::pin(self.resume(cx, message));
            }
            EnterPhase::CODE => return Box::pin(self.enter_phase(cx, message)),
            Quiesce::CODE => return Box::pin(self.quiesce(cx, message)),
            StopTask::CODE => return Box::pin(self.stop(cx, message)),
            _ => {}
        }
        let Some(handler) = self.handler.as_deref_mut() else {
            // Between two incarnations a message is begun only before a stop that waits behind it.
            message.refuse(Fault::Stopping);
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
        handler.tell(cx, Notice::Phase(phase)).await?;
        self.entered(phase);
        reply.ok(())
    }

    pub(crate) fn entered(&mut self, phase: Phase) {
        self.phase = Some(phase);
        self.record
            .statistics
            .activity()
            .entered(phase, self.cx.now());
        if let Some(recorder) = self.cx.chassis().tap.recorder() {
            recorder.phase(self.cx.tid(), phase);
        }
    }

    async fn quiesce(&mut self, cx: &Context, message: Message) -> Handled {
        let (Quiesce { reason }, reply) = message.open::<Quiesce>()?;
        cx.begin_stop(&reason, Some(reply));
        self.come_to_rest(cx).await
    }

    /// Lets the handler, and the tasks that it has started, come to rest if the app is being stopped. One that has
    /// not begun to run has nothing to bring to rest.
    pub(crate) async fn come_to_rest(&mut self, cx: &Context) -> Handled {
        let Some(reason) = cx.stop_reason() else {
            return Ok(());
        };
        if let Some(handler) = &mut self.handler
            && self.phase == Some(Phase::Run)
        {
            handler.tell(cx, Notice::Quiesce(&reason)).await?;
        }
        cx.quiet_after_started(&reason);
        cx.said_quiet();
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, message: Message) -> Handled {
        let (StopTask { reason, .. }, reply) = message.open::<StopTask>()?;
        self.step(Event::Stop);
        self.serving.stopped.set(true);
        cx.chassis().set_stopping();
        cx.begin_stop(&reason, None);
        if let Some(handler) = &mut self.handler {
            handler.tell(cx, Notice::Stop(&reason)).await?;
        }
        cx.end_all_started().await;
        reply.ok(())
    }
}

/// Drops a handler; a destructor that panics is not a reason to lose the task.
pub(crate) fn drop_handler(cx: &Context, handler: Box<dyn DynHandler>) {
    if let Err(panic) = contained(|| drop(handler)) {
        tracing::error!(task = %cx.name(), %panic, "its destructor panicked");
    }
}

async fn chassis_down(handler: &mut dyn DynHandler, cx: &Context, message: Message) -> Handled {
    let (ChassisDown { chassis }, _) = message.open::<ChassisDown>()?;
    handler.tell(cx, Notice::ChassisDown(&chassis)).await
}

async fn chassis_up(handler: &mut dyn DynHandler, cx: &Context, message: Message) -> Handled {
    let (ChassisUp { chassis }, _) = message.open::<ChassisUp>()?;
    handler.tell(cx, Notice::ChassisUp(&chassis)).await
}

async fn task_changed(handler: &mut dyn DynHandler, cx: &Context, message: Message) -> Handled {
    let (TaskChanged { task, change }, _) = message.open::<TaskChanged>()?;
    match change {
        Change::Up => handler.tell(cx, Notice::TaskUp(&task)).await,
        Change::Down { reason } | Change::Ended { reason } => {
            handler
                .tell(cx, Notice::TaskDown(&task.name, &reason))
                .await
        }
    }
}
