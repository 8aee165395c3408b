//! What a task can reach: the [`Context`] its handler is called with.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    fmt,
    future::{Future, IntoFuture},
    path::PathBuf,
    pin::Pin,
    rc::Rc,
    sync::Arc,
    task::{Context as PollContext, Poll},
    time::Duration,
};

use futures_util::future::{Either, LocalBoxFuture, select};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde::de::DeserializeOwned;

use crate::{
    call::{CallError, Fault},
    chassis::{Chassis, Envelope, Question, Sent, TaskRecord},
    circle,
    config::TaskConfig,
    diagnostic::Finding,
    exchange::Looked,
    message::{Command, CommandInfo, Data, Flags, Message, Tid},
    processor::{FutureId, Processor},
    realtime::{self, Grant},
    semaphore::{self, Barrier, Scope, Semaphore, SemaphoreError, SemaphoreView},
    sync::{
        Cyclic, CyclicError, CyclicHandle, Pacemaker, Synchronous, TickSource, TickSourceHandle,
    },
    system::{
        self, AppResult, AwaitTid, Broke, CommandDescription, Introspect, Monitor, Ping, QueryTid,
        Shutdown, Statistics,
    },
    task::Handled,
    time::Instant,
};

/// How long a call waits for its reply unless it, or the task's configuration, says otherwise.
pub const DEFAULT_DEADLINE: Duration = Duration::from_secs(10);

/// A task that was found by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TaskRef {
    name: Arc<str>,
    tid: Tid,
}

impl TaskRef {
    pub(crate) fn new(name: impl Into<Arc<str>>, tid: Tid) -> Self {
        Self {
            name: name.into(),
            tid,
        }
    }

    /// Its symbolic name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its id.
    #[must_use]
    pub fn tid(&self) -> Tid {
        self.tid
    }
}

/// A symbolic name that leads to no task.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// The task identification service knows no such name.
    #[error("no task is called `{name}` (asked by `{from}`); there are: {}", .known.join(", "))]
    Unknown {
        /// The asking task.
        from: String,
        /// The name.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// A task waits for a name that does not appear.
    #[error("`{from}` waited {:.3} s for a task called `{name}`: {why}", .after.as_secs_f64())]
    NotYet {
        /// The waiting task.
        from: String,
        /// The name.
        name: String,
        /// How long it waited.
        after: Duration,
        /// Who waits for whom.
        why: String,
    },
    /// Tasks wait for one another in a circle, so that none of the names can ever appear.
    #[error("nobody can go on: {circle}")]
    Circle {
        /// The circle in words.
        circle: String,
    },
    /// The service itself could not be asked.
    #[error(transparent)]
    Service(#[from] CallError),
}

/// A wait that took too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not finished within {:.3} s", .0.as_secs_f64())]
pub struct Elapsed(pub Duration);

pub(crate) struct Inner {
    pub(crate) record: Arc<TaskRecord>,
    pub(crate) chassis: Arc<Chassis>,
    pub(crate) processor: Rc<Processor>,
    /// Boxed, because it is large and tasks of the runtime have none.
    config: Option<Box<TaskConfig>>,
    commands: Arc<[CommandInfo]>,
    children: RefCell<Children>,
    /// Counts the handlers that the task had.
    incarnation: Cell<u64>,
    /// The tasks that this one started, oldest first.
    pub(crate) started: RefCell<Vec<TaskRef>>,
}

/// The children of a task that have not ended, by number, with what cancels them.
#[derive(Default)]
struct Children {
    running: BTreeMap<u64, FutureId>,
    next: u64,
}

/// A task's door to the rest of the app. Cheap to clone; stays on its processor.
#[derive(Clone)]
pub struct Context {
    pub(crate) inner: Rc<Inner>,
    /// The trace that whatever is sent from here belongs to; 0: each message begins its own.
    trace: u64,
}

impl Context {
    pub(crate) fn new(
        record: Arc<TaskRecord>,
        chassis: Arc<Chassis>,
        processor: Rc<Processor>,
        config: Option<TaskConfig>,
        commands: Arc<[CommandInfo]>,
    ) -> Self {
        Self {
            inner: Rc::new(Inner {
                record,
                chassis,
                processor,
                config: config.map(Box::new),
                commands,
                children: RefCell::default(),
                incarnation: Cell::new(0),
                started: RefCell::default(),
            }),
            trace: 0,
        }
    }

    /// This context for one message: what the handler sends belongs to the message's trace.
    pub(crate) fn within(&self, trace: u64) -> Self {
        Self {
            inner: self.inner.clone(),
            trace,
        }
    }

    /// This context at the beginning of a new trace: for work that no single message led to.
    #[must_use]
    pub fn new_trace(&self) -> Self {
        self.within(self.inner.chassis.fresh_trace())
    }

    /// The id shared by everything that the message being handled led to; 0 outside of a message.
    #[must_use]
    pub fn trace(&self) -> u64 {
        self.trace
    }

    /// The task's symbolic name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.inner.record.name
    }

    pub(crate) fn name_shared(&self) -> Arc<str> {
        self.inner.record.name.clone()
    }

    /// The task's id.
    #[must_use]
    pub fn tid(&self) -> Tid {
        self.inner.record.tid
    }

    /// The chassis that the task runs on.
    #[must_use]
    pub fn chassis(&self) -> &Arc<Chassis> {
        &self.inner.chassis
    }

    /// The processor that the task runs on.
    pub(crate) fn processor(&self) -> &Rc<Processor> {
        &self.inner.processor
    }

    /// The app's configuration.
    #[must_use]
    pub fn app(&self) -> &crate::config::App {
        &self.inner.chassis.app
    }

    /// The commands that the task takes.
    pub(crate) fn commands(&self) -> &[CommandInfo] {
        &self.inner.commands
    }

    /// The kinds of event handlers that this program knows.
    #[must_use]
    pub fn registry(&self) -> &crate::registry::Registry {
        &self.inner.chassis.registry
    }

    // -- other tasks ------------------------------------------------------------------------

    /// Finds a task by its symbolic name. Found once, a name is remembered by the chassis.
    ///
    /// # Errors
    /// [`NameError`] when no task has the name or the service cannot be reached.
    pub async fn task(&self, name: &str) -> Result<TaskRef, NameError> {
        let directory = &self.inner.chassis.directory;
        if let Some(tid) = directory.known(name) {
            return Ok(TaskRef::new(name, tid));
        }
        let query = QueryTid {
            name: name.to_owned(),
        };
        match self.call(&Self::server(), query).await? {
            Ok(tid) => Ok(TaskRef::new(name, directory.learn(name, tid))),
            Err(known) => Err(NameError::Unknown {
                from: self.name().to_owned(),
                name: name.to_owned(),
                known,
            }),
        }
    }

    /// The task identification service.
    pub(crate) fn server() -> TaskRef {
        TaskRef::new("tidsvr", system::TID_SERVER)
    }

    /// Finds a task by its symbolic name, and waits for the name to appear if there is none yet: another
    /// task may be about to [start](Self::start) it, or its chassis is just being started again.
    ///
    /// # Errors
    /// [`NameError::NotYet`] after `limit`, with who waits for whom; [`NameError::Circle`] at once, when
    /// the task that would start it waits, directly or not, for a name that only this task can start.
    pub async fn wait_for_task(&self, name: &str, limit: Duration) -> Result<TaskRef, NameError> {
        let directory = &self.inner.chassis.directory;
        if let Some(tid) = directory.known(name) {
            return Ok(TaskRef::new(name, tid));
        }
        let request = AwaitTid {
            name: name.to_owned(),
            waiter: self.name().to_owned(),
        };
        match self.call(&Self::server(), request).deadline(limit).await {
            Ok(Ok(tid)) => Ok(TaskRef::new(name, directory.learn(name, tid))),
            Ok(Err(circle)) => Err(NameError::Circle { circle }),
            Err(error) if matches!(error.fault, Fault::Deadline { .. }) => {
                let query = system::WhoWaits {
                    name: name.to_owned(),
                };
                Err(NameError::NotYet {
                    from: self.name().to_owned(),
                    name: name.to_owned(),
                    after: limit,
                    why: self.call(&Self::server(), query).await?,
                })
            }
            Err(error) => Err(error.into()),
        }
    }

    /// From now on the handler's `task_down` and `task_up` are called when `task` goes down and comes
    /// up again. When it is down already, `task_down` is called at once.
    ///
    /// # Errors
    /// When the task identification service cannot be asked.
    pub async fn monitor(&self, task: &TaskRef) -> Result<(), CallError> {
        let name = task.name().to_owned();
        let up = self.call(&Self::server(), Monitor { name }).await?;
        if !up {
            let changed = system::TaskChanged {
                task: system::TaskName {
                    name: task.name().to_owned(),
                    tid: task.tid(),
                },
                change: system::Change::Down {
                    reason: "it was not there when it began to be monitored".to_owned(),
                },
            };
            self.inner.chassis.post_system(self.tid(), changed);
        }
        Ok(())
    }

    /// Asks a task and waits for its reply. Ends with the reply or an error, always: 10 s after the
    /// call at the latest, unless [`Call::deadline`] or the task's `call_deadline_s` says otherwise.
    ///
    /// A request that its caller no longer waits for (the deadline passed, the call was dropped) is not
    /// begun any more, wherever the receiver runs.
    pub fn call<C: Command>(&self, to: &TaskRef, request: C) -> Call<C> {
        let deadline = self
            .inner
            .config
            .as_ref()
            .and_then(|config| config.call_deadline)
            .unwrap_or(DEFAULT_DEADLINE);
        Call {
            cx: self.clone(),
            to: to.clone(),
            request,
            deadline,
            flags: Flags::NONE,
        }
    }

    /// Sends a message that needs no reply, and waits until the receiver's queue has taken it.
    /// A message that was given up before it was taken is not delivered.
    pub fn send<C: Command>(&self, to: &TaskRef, request: C) -> Send<C> {
        Send {
            call: self.call(to, request),
        }
    }

    /// Sends only if the receiver is on this chassis and has room now.
    ///
    /// # Errors
    /// [`Fault::Full`], [`Fault::Elsewhere`] and the like, with both names.
    pub fn try_send<C: Command>(&self, to: &TaskRef, request: C) -> Result<(), CallError> {
        let envelope = self.envelope(to, C::CODE, Flags::NONE, Data::of(request));
        self.inner
            .chassis
            .try_send(&self.inner.processor, envelope)
            .map_err(|fault| self.error(to, C::NAME, fault))
    }

    /// Calls with bytes instead of types: the data of `command` and its reply are postcard. For nets
    /// and inspectors, which know commands by name only.
    ///
    /// # Errors
    /// As [`Self::call`].
    pub async fn call_raw(
        &self,
        to: &TaskRef,
        command: CommandInfo,
        data: Vec<u8>,
        deadline: Duration,
    ) -> Result<Vec<u8>, CallError> {
        let envelope = self.envelope(to, command.code, Flags::NONE, Data::Bytes(data));
        let cx = self.clone();
        let answer = Ask::call(cx, to.clone(), command.name, envelope, deadline).await;
        answer
            .and_then(|data| {
                data.into_bytes().map_err(|error| Fault::BadPayload {
                    text: error.to_string(),
                })
            })
            .map_err(|fault| self.error(to, command.name, fault))
    }

    /// What every task does with a message that its handler does not know: answers [`Ping`],
    /// [`Introspect`] and [`Statistics`], and refuses the rest by saying what the task takes. (A
    /// [`Shutdown`] does not come this far: the loop of the task carries it out.)
    ///
    /// # Errors
    /// Never; the result ends a handler.
    pub fn default_processing(&self, message: Message) -> Handled {
        match message.command() {
            Ping::CODE => {
                let (Ping {}, reply) = message.open::<Ping>()?;
                reply.ok(())
            }
            Introspect::CODE => {
                let (Introspect {}, reply) = message.open::<Introspect>()?;
                let describe = |command: &CommandInfo| CommandDescription {
                    code: command.code,
                    name: command.name.to_owned(),
                    doc: command.doc.to_owned(),
                };
                reply.ok(self.inner.commands.iter().map(describe).collect())
            }
            Shutdown::CODE => {
                // Tasks of the configuration come to their end in their own loop.
                let (Shutdown {}, reply) = message.open::<Shutdown>()?;
                reply.fail("it belongs to the runtime and ends with its chassis")
            }
            Statistics::CODE => {
                let (Statistics {}, reply) = message.open::<Statistics>()?;
                reply.ok(self.inner.record.statistics.read())
            }
            command => {
                tracing::warn!(task = %self.name(), command, from = %message.from(), "unknown command");
                if let Some(slot) = message.reply {
                    let names = self.inner.commands.iter();
                    slot.answer(Err(Fault::UnknownCommand {
                        takes: names.map(|command| command.name.to_owned()).collect(),
                    }));
                }
                Ok(())
            }
        }
    }

    #[inline]
    fn envelope(&self, to: &TaskRef, command: u16, flags: Flags, data: Data) -> Envelope {
        Envelope {
            to: to.tid,
            from: self.inner.record.tid,
            command,
            flags,
            data,
            trace: self.trace,
            deadline: None,
        }
    }

    fn error(&self, to: &TaskRef, command: &str, fault: Fault) -> CallError {
        CallError {
            from: self.name().to_owned(),
            to: to.name().to_owned(),
            command: command.to_owned(),
            fault,
        }
    }

    // -- time -------------------------------------------------------------------------------

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.inner.processor.now()
    }

    /// Waits.
    pub async fn sleep(&self, duration: Duration) {
        let deadline = self.now() + duration;
        self.inner.processor.sleep_until(deadline).await;
    }

    /// Waits for `future`, but not for long.
    ///
    /// # Errors
    /// [`Elapsed`] when `duration` was over first; the future is dropped.
    pub async fn timeout<F: Future>(
        &self,
        duration: Duration,
        future: F,
    ) -> Result<F::Output, Elapsed> {
        let future = std::pin::pin!(future);
        let deadline = self.now() + duration;
        let sleep = self.inner.processor.sleep_until(deadline);
        match select(future, sleep).await {
            Either::Left((output, _)) => Ok(output),
            Either::Right(((), _)) => Err(Elapsed(duration)),
        }
    }

    /// Calls a synchronous function every `period` on this task's processor, until the handle is
    /// dropped. If it panics, it is taken off the schedule and the task's restart policy decides; it has failed if the
    /// processor has a base period that `period` is no multiple of. [`Self::schedule`] says more of a
    /// function, and refuses instead.
    #[must_use]
    pub fn cyclic(&self, period: Duration, function: impl Cyclic + 'static) -> CyclicHandle {
        let tap = &self.inner.chassis.tap;
        tap.used(|| "a synchronous function".to_owned());
        let schedule = &self.inner.processor.schedule;
        let free = |name: &String| !schedule.has(&format!("{}.{name}", self.name()));
        let numbered = (2_u32..).map(|number| format!("cyclic-{number}"));
        let mut names = std::iter::once("cyclic".to_owned()).chain(numbered);
        let name = names.find(free).unwrap_or_default();
        let period = period.max(Duration::from_micros(1));
        let function = Synchronous::new(name, function).period(period);
        self.schedule(function).unwrap_or_else(|error| {
            self.fail(&error.to_string());
            CyclicHandle::of_nothing()
        })
    }

    /// Puts a synchronous function on the schedule of this task's processor, which it shares with those of
    /// the other tasks there, until the handle is dropped. Its name becomes `task.function`. If it panics,
    /// it is taken off the schedule, and the task's restart policy decides.
    ///
    /// # Errors
    /// [`CyclicError`]: data that flows in a circle, a period that does not fit, a name that is taken.
    pub fn schedule(&self, function: Synchronous) -> Result<CyclicHandle, CyclicError> {
        let name = format!("{}.{}", self.name(), function.name());
        let function = function.renamed(name).on_failure(self.when_broken());
        self.inner.processor.schedule.add(function)
    }

    /// Lets a device say when the base ticks of this task's processor are, until the handle is dropped. The
    /// processor needs a `period_s`, at which the clock goes on when the device fails. In virtual time
    /// there is no device, and the clock goes on ticking.
    ///
    /// # Errors
    /// [`CyclicError`]: the processor has no base period, or another source already.
    pub fn tick_source(
        &self,
        source: impl TickSource + 'static,
    ) -> Result<TickSourceHandle, CyclicError> {
        let (chassis, index) = (
            self.inner.chassis.clone(),
            self.inner.record.tid.processor(),
        );
        let handle = self.inner.processor.handle.clone();
        let pacemaker = Pacemaker {
            prepare: Box::new(move || {
                let config = chassis.processor_config(usize::from(index));
                // Memory was locked for the whole chassis; a refusal was said for the processor.
                let _ = realtime::prepare_thread(chassis.name(), config, &Grant::NotAsked);
            }),
            wake: Box::new(move || handle.unpark()),
        };
        let schedule = &self.inner.processor.schedule;
        schedule.pace(Box::new(source), pacemaker)
    }

    // -- the task itself --------------------------------------------------------------------

    /// Runs a child of this task beside it, on the same processor. It ends with the task's handler; if
    /// it panics, the handler has failed with it, and the task's restart policy decides.
    pub fn spawn(&self, future: impl Future<Output = ()> + 'static) {
        let broke = self.when_broken();
        let on_panic = move |text: String| broke(&format!("a child panicked: {text}"));
        let mut children = self.inner.children.borrow_mut();
        let number = children.next;
        children.next += 1;
        let cx = self.clone();
        let child = async move {
            future.await;
            cx.inner.children.borrow_mut().running.remove(&number);
        };
        let id = self.inner.processor.spawn(child, Some(Rc::new(on_panic)));
        children.running.insert(number, id);
    }

    /// What to call when a part of the present handler breaks: the task's loop decides what follows.
    pub(crate) fn when_broken(&self) -> impl Fn(&str) + 'static {
        let cx = self.clone();
        let incarnation = self.inner.incarnation.get();
        move |reason| {
            if cx.config().is_none() {
                return cx.fail(reason);
            }
            let reason = reason.to_owned();
            let broke = Broke {
                incarnation,
                reason,
            };
            cx.inner.chassis.post_system(cx.tid(), broke);
        }
    }

    /// Counts the handlers that the task had.
    pub(crate) fn incarnation(&self) -> u64 {
        self.inner.incarnation.get()
    }

    /// What breaks of the handler up to now is no news any more.
    pub(crate) fn next_incarnation(&self) {
        self.inner.incarnation.set(self.inner.incarnation.get() + 1);
    }

    /// Ends all children.
    pub(crate) fn cancel_children(&self) {
        // Not held while they are dropped: their destructors may reach the task.
        let children = std::mem::take(&mut self.inner.children.borrow_mut().running);
        for child in children.into_values() {
            self.inner.processor.cancel(child);
        }
    }

    /// The task's arguments, `[task.NAME.args]` of the configuration.
    ///
    /// # Errors
    /// A finding that points at the key that is wrong or unknown.
    pub fn args<T: DeserializeOwned>(&self) -> Result<T, Finding> {
        match &self.inner.config {
            Some(config) => config.args.parse(),
            None => crate::config::Node::table().parse(),
        }
    }

    /// The task's part of the configuration; `None` for tasks of the runtime.
    #[must_use]
    pub fn config(&self) -> Option<&TaskConfig> {
        self.inner.config.as_deref()
    }

    /// A path of the configuration, taken relative to the configuration's folder.
    #[must_use]
    pub fn path(&self, relative: &str) -> PathBuf {
        self.app().folder.join(relative)
    }

    /// A generator of random numbers that depends on the app's seed, the task's name and `stream`
    /// only.
    #[must_use]
    pub fn rng(&self, stream: &str) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(self.seed_of(stream))
    }

    /// The seed of [`Self::rng`].
    pub(crate) fn seed_of(&self, stream: &str) -> u64 {
        mix(self.app().seed, &[self.name(), stream])
    }

    /// Makes `value` known to the other tasks of this chassis.
    pub fn share<T: std::marker::Send + Sync + 'static>(&self, key: &str, value: Arc<T>) {
        self.inner.chassis.share(key, value);
    }

    /// What a task of this chassis made known under `key`.
    #[must_use]
    pub fn shared<T: std::marker::Send + Sync + 'static>(&self, key: &str) -> Option<Arc<T>> {
        self.inner.chassis.shared(key)
    }

    // -- what tasks take turns with ---------------------------------------------------------

    /// The counting semaphore called `name`, with `permits` unless `[semaphore.NAME]` of the configuration
    /// says how many. It is shared by the tasks of this chassis; by those of the whole app, if the
    /// configuration says so or its name begins with `app/`.
    ///
    /// # Errors
    /// [`SemaphoreError`]: no permits at all, or another number than others use.
    pub fn semaphore(&self, name: &str, permits: u32) -> Result<Semaphore, SemaphoreError> {
        Semaphore::find(self, name, permits)
    }

    /// The barrier called `name`, for `parties` unless `[barrier.NAME]` of the configuration says for how many.
    /// Shared as [`Self::semaphore`] says.
    ///
    /// # Errors
    /// [`SemaphoreError`]: nobody to wait for, or another number than others use.
    pub fn barrier(&self, name: &str, parties: u32) -> Result<Barrier, SemaphoreError> {
        Barrier::find(self, name, parties)
    }

    /// The semaphores that this task could use, who holds them and who waits: those of this chassis and
    /// those of the app.
    ///
    /// # Errors
    /// When the task that keeps those of the app cannot be asked.
    pub async fn semaphores(&self) -> Result<Vec<SemaphoreView>, CallError> {
        let mut views = semaphore::of_app(self).await?;
        let here = self.chassis().semaphores().into_iter();
        views.extend(here.filter(|view| view.scope == Scope::Chassis));
        Ok(views)
    }

    // -- the person who booted the app ------------------------------------------------------

    /// Shows how far the task is: `done` of `total` steps, each of which is a `step` ("position"), and
    /// what happened at this one.
    pub fn progress(&self, done: u64, total: u64, step: &str, what: &str) {
        let progress = system::Progress {
            task: self.name().to_owned(),
            done,
            total,
            step: step.to_owned(),
            what: what.to_owned(),
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, progress);
    }

    /// Ends the app with a result, if `until` of the configuration names this task.
    pub fn finish(&self, result: AppResult) {
        let finish = system::Finish {
            task: self.name().to_owned(),
            result,
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, finish);
    }

    /// Reports that this task failed for good; the app is stopped.
    pub fn fail(&self, reason: &str) {
        tracing::error!(task = %self.name(), reason, "task failed");
        let failed = system::TaskFailed {
            task: self.name().to_owned(),
            reason: reason.to_owned(),
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, failed);
    }
}

impl fmt::Debug for Context {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Context(`{}`, {})", self.name(), self.tid())
    }
}

/// Mixes a seed with words (FNV-1a over their bytes), the same on every machine.
#[must_use]
pub fn mix(seed: u64, words: &[&str]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64 ^ seed;
    for byte in words.iter().flat_map(|word| word.bytes().chain([0])) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    hash ^ seed.rotate_left(32)
}

/// A call that has not been made yet; `.await` makes it.
#[must_use = "a call is made when it is awaited"]
pub struct Call<C: Command> {
    cx: Context,
    to: TaskRef,
    request: C,
    deadline: Duration,
    flags: Flags,
}

impl<C: Command> Call<C> {
    /// Waits at most this long for the reply.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        self.flags = self.flags.with(Flags::HIGH_PRIORITY);
        self
    }
}

impl<C: Command> IntoFuture for Call<C> {
    type Output = Result<C::Reply, CallError>;
    type IntoFuture = Calling<C>;

    fn into_future(self) -> Calling<C> {
        Calling(CallState::New(self))
    }
}

/// A call under way. Dropped before its end, it tells the receiver that nobody waits.
#[must_use = "a call is made when it is awaited"]
pub struct Calling<C: Command>(CallState<C>);

enum CallState<C: Command> {
    New(Call<C>),
    Asked(Ask),
    Ended,
}

impl<C: Command> CallState<C> {
    /// The call, if it has not been made yet.
    fn take_new(&mut self) -> Option<Call<C>> {
        if !matches!(self, Self::New(_)) {
            return None;
        }
        match std::mem::replace(self, Self::Ended) {
            Self::New(call) => Some(call),
            Self::Asked(_) | Self::Ended => None,
        }
    }

    /// Looks for the end of a call that has been made; `open` makes what was waited for of the answer.
    fn poll<T>(
        &mut self,
        poll: &mut PollContext<'_>,
        open: impl FnOnce(Data) -> Result<T, Fault>,
    ) -> Poll<Result<T, CallError>> {
        let Self::Asked(ask) = self else {
            // Polled after its end, which is the fault of whoever polls.
            return Poll::Pending;
        };
        let answer = std::task::ready!(ask.poll(poll));
        let result = answer.and_then(open);
        let result = result.map_err(|fault| ask.error(C::NAME, fault));
        *self = Self::Ended;
        Poll::Ready(result)
    }
}

impl<C: Command> Unpin for Calling<C> {}

impl<C: Command> Future for Calling<C> {
    type Output = Result<C::Reply, CallError>;

    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        let Self(state) = self.get_mut();
        if let Some(call) = state.take_new() {
            let data = Data::of(call.request);
            let envelope = call.cx.envelope(&call.to, C::CODE, call.flags, data);
            let ask = Ask::call(call.cx, call.to, C::NAME, envelope, call.deadline);
            *state = CallState::Asked(ask);
        }
        state.poll(poll, |data| {
            data.take::<C::Reply>().map_err(|error| Fault::BadPayload {
                text: format!("its reply: {error}"),
            })
        })
    }
}

/// A one-way message that has not been sent yet; `.await` sends it.
#[must_use = "a message is sent when it is awaited"]
pub struct Send<C: Command> {
    call: Call<C>,
}

impl<C: Command> Send<C> {
    /// Waits at most this long for room in the receiver's queue.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.call.deadline = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        self.call = self.call.high_priority();
        self
    }
}

impl<C: Command> IntoFuture for Send<C> {
    type Output = Result<(), CallError>;
    type IntoFuture = Sending<C>;

    fn into_future(self) -> Sending<C> {
        Sending(CallState::New(self.call))
    }
}

/// A one-way message under way. Dropped before it is taken, it is not delivered.
#[must_use = "a message is sent when it is awaited"]
pub struct Sending<C: Command>(CallState<C>);

impl<C: Command> Unpin for Sending<C> {}

impl<C: Command> Future for Sending<C> {
    type Output = Result<(), CallError>;

    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        let Self(state) = self.get_mut();
        if let Some(call) = state.take_new() {
            let data = Data::of(call.request);
            let envelope = call.cx.envelope(&call.to, C::CODE, call.flags, data);
            let inner = &call.cx.inner;
            match inner
                .chassis
                .send(&inner.processor, envelope, call.deadline)
            {
                Sent::Ended(result) => {
                    let result = result.map_err(|fault| call.cx.error(&call.to, C::NAME, fault));
                    return Poll::Ready(result);
                }
                Sent::Waits(question) => {
                    *state = CallState::Asked(Ask::new(call.cx, call.to, C::NAME, question));
                }
            }
        }
        state.poll(poll, |_| Ok(()))
    }
}

/// Who asked whom for what. Kept with the call, so that it can be shown while it waits.
pub(crate) struct Note {
    cx: Context,
    to: TaskRef,
    command: &'static str,
    /// Where it is shown.
    place: Option<usize>,
}

impl Note {
    fn new(cx: &Context, to: TaskRef, command: &'static str) -> Self {
        Self {
            cx: cx.clone(),
            to,
            command,
            place: None,
        }
    }

    /// Shows the call to whoever wants to know what its task waits for.
    pub(crate) fn show(&mut self, since: Instant) {
        if self.place.is_none() {
            let waits = &self.cx.inner.record.waits;
            let to = self.to.name.clone();
            self.place = Some(waits.begin(to, self.to.tid, self.command, since));
        }
    }
}

impl Drop for Note {
    fn drop(&mut self) {
        if let Some(place) = self.place {
            self.cx.inner.record.waits.end(place);
        }
    }
}

/// Waits for an answer; dropped before, it takes the question back.
struct Ask {
    cx: Context,
    state: AskState,
    circle: Circle,
    /// Who was asked, once it has ended.
    note: Option<Note>,
}

/// The search for a circle of tasks that wait for one another; see `circle.rs`.
enum Circle {
    NotLookedFor,
    LookedFor(LocalBoxFuture<'static, Option<String>>),
    Found(Option<String>),
}

enum AskState {
    Asked(Question),
    /// There was no time at all to ask.
    TooLate,
    Ended,
}

impl Circle {
    /// Goes on with the search.
    fn poll(&mut self, cx: &mut PollContext<'_>) {
        if let Self::LookedFor(looking) = self
            && let Poll::Ready(found) = looking.as_mut().poll(cx)
        {
            *self = Self::Found(found);
        }
    }
}

impl Ask {
    fn new(cx: Context, to: TaskRef, command: &'static str, question: Question) -> Self {
        let note = Note::new(&cx, to, command);
        cx.inner.processor.note_call(question.key, note);
        Self {
            cx,
            state: AskState::Asked(question),
            circle: Circle::NotLookedFor,
            note: None,
        }
    }

    /// Makes a call, at once.
    fn call(
        cx: Context,
        to: TaskRef,
        command: &'static str,
        envelope: Envelope,
        deadline: Duration,
    ) -> Self {
        if deadline == Duration::ZERO {
            return Self {
                note: Some(Note::new(&cx, to, command)),
                cx,
                state: AskState::TooLate,
                circle: Circle::NotLookedFor,
            };
        }
        let inner = &cx.inner;
        let question = inner.chassis.call(&inner.processor, envelope, deadline);
        Self::new(cx, to, command, question)
    }

    #[inline]
    fn poll(&mut self, poll: &mut PollContext<'_>) -> Poll<Result<Data, Fault>> {
        let AskState::Asked(question) = &self.state else {
            return self.poll_late();
        };
        let processor = &self.cx.inner.processor;
        let fault = match processor.poll_call(question.key, &mut self.note, poll) {
            Looked::Answered(data) => return Poll::Ready(Ok(self.answered(data))),
            Looked::Waiting => {
                self.circle.poll(poll);
                return Poll::Pending;
            }
            Looked::Long => {
                let looking = circle::look(self.cx.clone(), question.asked.to());
                self.circle = Circle::LookedFor(Box::pin(looking));
                self.circle.poll(poll);
                return Poll::Pending;
            }
            Looked::Failed(fault) => fault,
            Looked::Late(after) => {
                match std::mem::replace(&mut self.circle, Circle::NotLookedFor) {
                    Circle::Found(Some(circle)) => Fault::Circle { after, circle },
                    _ => Fault::Deadline { after },
                }
            }
        };
        Poll::Ready(Err(self.failed(fault)))
    }

    /// There is a reply.
    #[inline]
    fn answered(&mut self, data: Data) -> Data {
        let AskState::Asked(question) = &self.state else {
            return data;
        };
        let tap = &self.cx.inner.chassis.tap;
        let data = if tap.is_on() {
            let answer = Ok(data);
            tap.answered(question.recorded, &question.asked, &answer);
            answer.unwrap_or_else(|_: Fault| Data::Bytes(Vec::new()))
        } else {
            data
        };
        self.state = AskState::Ended;
        data
    }

    /// It came to nothing.
    #[cold]
    fn failed(&mut self, fault: Fault) -> Fault {
        let AskState::Asked(question) = std::mem::replace(&mut self.state, AskState::Ended) else {
            return fault;
        };
        let answer = Err(fault.clone());
        let tap = &self.cx.inner.chassis.tap;
        tap.answered(question.recorded, &question.asked, &answer);
        if let (Some(outbound), Fault::Deadline { .. } | Fault::Circle { .. }) =
            (question.outbound, &fault)
        {
            outbound.abandon();
        }
        fault
    }

    #[cold]
    fn poll_late(&mut self) -> Poll<Result<Data, Fault>> {
        if !matches!(self.state, AskState::TooLate) {
            // Polled after its end, which is the fault of whoever polls.
            return Poll::Pending;
        }
        self.state = AskState::Ended;
        Poll::Ready(Err(Fault::Deadline {
            after: Duration::ZERO,
        }))
    }

    /// The error that `fault` makes of it, once it has ended.
    #[cold]
    fn error(&self, command: &str, fault: Fault) -> CallError {
        CallError {
            from: self.cx.name().to_owned(),
            // Every question is noted when it is asked.
            to: self
                .note
                .as_ref()
                .map_or_else(String::new, |note| note.to.name().to_owned()),
            command: command.to_owned(),
            fault,
        }
    }
}

impl Future for Ask {
    type Output = Result<Data, Fault>;

    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        self.get_mut().poll(poll)
    }
}

impl Drop for Ask {
    fn drop(&mut self) {
        if let AskState::Asked(question) = std::mem::replace(&mut self.state, AskState::Ended) {
            self.cx.inner.processor.give_up_call(question.key);
            if let Some(outbound) = question.outbound {
                outbound.abandon();
            }
        }
    }
}
