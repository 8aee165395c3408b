//! The loop of a task: takes messages from its queue, calls its handler, contains its panics.

use std::{panic::AssertUnwindSafe, pin::pin, rc::Rc, sync::Arc};

use futures_util::{
    FutureExt,
    future::{Either, LocalBoxFuture, select},
};

use crate::{
    call::{Fault, ReplySlot},
    chassis::{Chassis, TaskRecord},
    config::{Restart, TaskConfig},
    context::Context,
    mailbox::Mailbox,
    message::{Command, CommandInfo, Message, SYSTEM_COMMANDS, Tid},
    processor::{Processor, panic_text},
    system::{ChassisDown, ChassisUp, EnterPhase, RestartTask, StopTask},
    task::{DynHandler, Handled, HandlerError, Phase},
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

struct Runner {
    cx: Context,
    record: Arc<TaskRecord>,
    build: Build,
    handler: Box<dyn DynHandler>,
    restart: Restart,
    restarts: u32,
    /// The last phase that was entered: a restarted handler is brought back to it.
    phase: Option<Phase>,
    /// It was told to stop: nothing more is begun, or hardware at rest would move again.
    stopped: bool,
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
    let restart = spec
        .config
        .as_ref()
        .map_or(Restart::Never, |config| config.restart);
    let cx = Context::new(
        spec.record.clone(),
        chassis.clone(),
        processor.clone(),
        spec.config,
        spec.commands,
    );
    let handler = build_contained(&spec.build, &cx)?;
    chassis.add_task(spec.record.clone());
    let runner = Runner {
        cx: cx.clone(),
        record: spec.record,
        build: spec.build,
        handler,
        restart,
        restarts: 0,
        phase: None,
        stopped: false,
    };
    // Panics of the handler are caught where it is called. What is left is its destructor.
    let on_panic = move |text: String| {
        cx.fail(&format!("it panicked while it ended: {text}"));
        cx.cancel_children();
        cx.chassis().remove_task(cx.tid());
    };
    processor.spawn(runner.run(), Some(Rc::new(on_panic)));
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
    async fn run(mut self) {
        while let Some(message) = self.record.mailbox.next().await {
            let abandoned = message.reply.as_ref().is_some_and(ReplySlot::is_abandoned);
            // A stop is carried out even when whoever ordered it had to go on.
            if abandoned && message.command() != StopTask::CODE {
                tracing::debug!(task = %self.cx.name(), command = message.command(), "caller gave up");
                continue;
            }
            if self.stopped && message.command() < SYSTEM_COMMANDS {
                if let Some(slot) = message.reply {
                    slot.answer(Err(Fault::Stopping));
                }
                continue;
            }
            if !self.take(message).await {
                break;
            }
        }
        self.cx.cancel_children();
        self.cx.chassis().remove_task(self.cx.tid());
    }

    /// Handles one message. False when the task has failed for good.
    async fn take(&mut self, message: Message) -> bool {
        let slot = message.reply.clone();
        let command = message.command();
        let record = self.record.clone();
        let cx = self.cx.within(message.trace());
        cx.chassis().delivered(&record, &message);
        record.statistics.begin(command, cx.now());
        let handling = AssertUnwindSafe(self.call(&cx, message)).catch_unwind();
        let outcome = if command == StopTask::CODE {
            handling.await
        } else {
            // A handler that waits for others must not delay an orderly stop: it is dropped there.
            match select(handling, pin!(record.mailbox.stop_waits())).await {
                Either::Left((outcome, _)) => outcome,
                Either::Right(((), _)) => {
                    record.statistics.end(false, cx.now());
                    if let Some(slot) = slot {
                        slot.answer(Err(Fault::Stopping));
                    }
                    return true;
                }
            }
        };
        record
            .statistics
            .end(matches!(outcome, Ok(Ok(()))), cx.now());
        match outcome {
            Ok(Ok(())) => true,
            Ok(Err(error)) => {
                tracing::debug!(task = %self.cx.name(), command, error = %error, "refused");
                if let Some(slot) = slot {
                    slot.answer(Err(Fault::Refused {
                        text: error.to_string(),
                    }));
                }
                true
            }
            Err(panic) => {
                let text = panic_text(panic.as_ref());
                tracing::error!(task = %self.cx.name(), command, panic = %text, "handler panicked");
                if let Some(slot) = slot {
                    slot.answer(Err(Fault::Panicked { text: text.clone() }));
                }
                self.supervise(&text).await
            }
        }
    }

    fn call<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled> {
        match message.command() {
            EnterPhase::CODE => Box::pin(self.enter_phase(cx, message)),
            StopTask::CODE => Box::pin(self.stop(cx, message)),
            ChassisDown::CODE => Box::pin(self.chassis_down(cx, message)),
            ChassisUp::CODE => Box::pin(self.chassis_up(cx, message)),
            RestartTask::CODE => Box::pin(self.restart(cx, message)),
            command if command >= SYSTEM_COMMANDS && cx.config().is_some() => {
                let handled = cx.default_processing(message);
                Box::pin(std::future::ready(handled))
            }
            _ => self.handler.handle(cx, message),
        }
    }

    async fn enter_phase(&mut self, cx: &Context, message: Message) -> Handled {
        let (EnterPhase { phase }, reply) = message.open::<EnterPhase>()?;
        self.handler.phase(cx, phase).await?;
        self.phase = Some(phase);
        self.record.statistics.entered(phase, cx.now());
        reply.ok(())
    }

    async fn stop(&mut self, cx: &Context, message: Message) -> Handled {
        let (StopTask { reason }, reply) = message.open::<StopTask>()?;
        self.stopped = true;
        cx.chassis().set_stopping();
        self.handler.stop(cx, &reason).await?;
        reply.ok(())
    }

    async fn chassis_down(&mut self, cx: &Context, message: Message) -> Handled {
        let (ChassisDown { chassis }, _) = message.open::<ChassisDown>()?;
        self.handler.chassis_down(cx, &chassis).await
    }

    async fn chassis_up(&mut self, cx: &Context, message: Message) -> Handled {
        let (ChassisUp { chassis }, _) = message.open::<ChassisUp>()?;
        self.handler.chassis_up(cx, &chassis).await
    }

    /// A person wants the handler built anew. One that cannot be is no handler any more.
    async fn restart(&mut self, cx: &Context, message: Message) -> Handled {
        let (RestartTask {}, reply) = message.open::<RestartTask>()?;
        if self.stopped || cx.config().is_none() {
            return reply.fail("it is being stopped, or belongs to the runtime".to_owned());
        }
        self.record.statistics.restarted();
        if let Err(error) = self.rebuild().await {
            cx.fail(&format!("could not be restarted: {error}"));
            return Err(error);
        }
        tracing::warn!(task = %cx.name(), "restarted by order");
        reply.ok(())
    }

    /// What happens after a panic: the configuration's restart policy, or the end of the task.
    async fn supervise(&mut self, panic: &str) -> bool {
        let allowed = match self.restart {
            Restart::Never => 0,
            Restart::Always { max } => max,
        };
        if self.stopped || self.restarts >= allowed {
            let tried = match self.restarts {
                0 => String::new(),
                restarts => format!(" (after {restarts} restarts)"),
            };
            self.cx
                .fail(&format!("its handler panicked: {panic}{tried}"));
            return false;
        }
        self.restarts += 1;
        self.record.statistics.restarted();
        let restarts = self.restarts;
        let limit = self.cx.app().phase_timeout;
        let (cx, mailbox) = (self.cx.clone(), self.record.mailbox.clone());
        let rebuilt = AssertUnwindSafe(cx.timeout(limit, self.rebuild())).catch_unwind();
        let why = match select(pin!(rebuilt), pin!(mailbox.stop_waits())).await {
            Either::Left((Ok(Ok(Ok(()))), _)) => {
                tracing::warn!(task = %cx.name(), restarts, "restarted");
                return true;
            }
            // Half rebuilt, but what can be stopped of it is stopped next.
            Either::Right(((), _)) => return true,
            Either::Left((Ok(Ok(Err(error))), _)) => error.to_string(),
            Either::Left((Ok(Err(elapsed)), _)) => elapsed.to_string(),
            Either::Left((Err(panic), _)) => {
                format!("it panicked again: {}", panic_text(panic.as_ref()))
            }
        };
        cx.fail(&format!("could not be restarted after a panic: {why}"));
        false
    }

    /// Builds the handler anew and brings it to the phase that the old one had reached. Messages
    /// that wait in the queue stay there.
    async fn rebuild(&mut self) -> Handled {
        self.cx.cancel_children();
        self.handler = build_contained(&self.build, &self.cx)?;
        let reached = self.phase;
        for phase in Phase::ALL {
            if reached.is_some_and(|reached| phase <= reached) {
                self.handler.phase(&self.cx, phase).await?;
            }
        }
        Ok(())
    }
}
