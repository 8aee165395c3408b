//! What a task has of its own: its name, its time, its children, its arguments.

use std::{
    cell::{Cell, RefCell, RefMut},
    collections::BTreeMap,
    future::Future,
    path::PathBuf,
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use futures_util::future::{Either, select};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use serde::de::DeserializeOwned;

use super::quiet::Quiet;
use crate::{
    chassis::Chassis,
    kept::Kept,
    processor::{Processor, wake::FutureId},
    report::AtReport,
    system::Broke,
    tap::PartPolled,
    task_record::TaskRecord,
    task_ref::TaskRef,
};
use ctos_config::{TaskConfig, diagnostic::Finding};
use ctos_message::{CommandInfo, Tid};
use ctos_time::lock::lock;

/// How long a call waits for its reply unless it, or the task's configuration, says otherwise.
pub const DEFAULT_DEADLINE: Duration = Duration::from_secs(10);

/// How what is noted of shared memory begins: a task that alone uses its part of it can be replayed.
pub const SHARED: &str = "shared memory ";

/// A wait that took too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not finished within {:.3} s", .0.as_secs_f64())]
pub struct Elapsed(pub Duration);

pub(crate) struct Inner {
    pub(crate) record: Arc<TaskRecord>,
    pub(crate) chassis: Arc<Chassis>,
    pub(crate) processor: Rc<Processor>,
    /// Boxed, because it is large and tasks of the runtime have none.
    pub(crate) config: Option<Box<TaskConfig>>,
    /// Made for the first of it: most tasks have none.
    family: RefCell<Option<Box<Family>>>,
    /// Counts the handlers that the task had.
    incarnation: Cell<u32>,
    /// Of a task whose state survives its process.
    pub(crate) kept: Option<Arc<Kept>>,
    /// Which of its parts is polled.
    pub(super) polled: Cell<PartPolled>,
}

/// What belongs to a task besides its handler.
#[derive(Default)]
pub(crate) struct Family {
    /// Its children that have not ended, by number, with what cancels them.
    children: BTreeMap<u64, FutureId>,
    next_child: u64,
    /// The tasks that it started, oldest first.
    pub(crate) started: Vec<TaskRef>,
    /// Made when the app is being stopped.
    pub(super) quiet: Option<Box<Quiet>>,
}

impl Inner {
    /// How long a call waits if it does not say.
    pub(crate) fn call_deadline(&self) -> Duration {
        let config = self.config.as_ref();
        let deadline = config.and_then(|config| config.call_deadline);
        deadline.unwrap_or(DEFAULT_DEADLINE)
    }

    /// What belongs to the task.
    pub(crate) fn family(&self) -> RefMut<'_, Family> {
        RefMut::map(self.family.borrow_mut(), |family| {
            &mut **family.get_or_insert_default()
        })
    }

    /// What belongs to the task, if there ever was anything.
    pub(crate) fn any_family(&self) -> Option<RefMut<'_, Family>> {
        let family = RefMut::filter_map(self.family.borrow_mut(), Option::as_deref_mut);
        family.ok()
    }
}

/// A task's door to the rest of the app. Cheap to clone; stays on its processor.
#[derive(Clone, derive_more::Debug)]
#[debug("Context(`{}`, {})", self.name(), self.tid())]
pub struct Context {
    pub(crate) inner: Rc<Inner>,
    /// The trace that whatever is sent from here belongs to; 0: each message begins its own.
    pub(super) trace: u64,
}

impl Context {
    /// The context of a task, outside of all messages.
    pub(crate) fn of(inner: Rc<Inner>) -> Self {
        Self { inner, trace: 0 }
    }

    /// This context within a trace: what is sent from here belongs to it.
    #[must_use]
    pub fn within(&self, trace: u64) -> Self {
        Self {
            inner: self.inner.clone(),
            trace,
        }
    }

    /// From now on it is that for another message.
    pub(crate) fn set_trace(&mut self, trace: u64) {
        self.trace = trace;
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
    pub fn app(&self) -> &ctos_config::App {
        &self.inner.chassis.app
    }

    /// The commands that the task takes.
    pub(crate) fn commands(&self) -> &[CommandInfo] {
        self.inner.record.statistics.commands()
    }

    /// Waits.
    pub async fn sleep(&self, duration: Duration) {
        let deadline = self.now() + duration;
        self.sleep_until(deadline).await;
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
        let sleep = std::pin::pin!(self.sleep_until(deadline));
        match select(future, sleep).await {
            Either::Left((output, _)) => Ok(output),
            Either::Right(((), _)) => Err(Elapsed(duration)),
        }
    }

    /// What to call when a part of the present handler breaks: the task's loop decides what follows.
    pub(crate) fn when_broken(&self) -> impl Fn(&str) + 'static {
        let cx = self.clone();
        let incarnation = self.incarnation();
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

    /// Says that something that the present handler needs has broken, as a panic of a child would: the task's restart policy
    /// decides what follows.
    pub fn broke(&self, reason: &str) {
        self.when_broken()(reason);
    }

    /// Counts the handlers that the task had.
    pub(crate) fn incarnation(&self) -> u64 {
        u64::from(self.inner.incarnation.get())
    }

    /// What breaks of the handler up to now is no news any more.
    pub(crate) fn next_incarnation(&self) {
        let incarnation = &self.inner.incarnation;
        incarnation.set(incarnation.get().wrapping_add(1));
    }

    /// Ends all children.
    pub(crate) fn cancel_children(&self) {
        // Not held while they are dropped: their destructors may reach the task.
        let (children, waits) = match self.inner.any_family() {
            Some(mut family) => {
                let waits = family.quiet.as_mut().map(|quiet| quiet.forget());
                (std::mem::take(&mut family.children), waits)
            }
            None => return,
        };
        drop(waits);
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
            None => ctos_config::Node::table().parse(),
        }
    }

    /// The task's part of the configuration; `None` for tasks of the runtime.
    #[must_use]
    pub fn config(&self) -> Option<&TaskConfig> {
        self.inner.config.as_deref()
    }

    /// Says what the task is at besides its messages, for `ctos status` and displays.
    pub fn is_at(&self, at: Option<AtReport>) {
        *lock(&self.inner.record.statistics.activity().at) = at;
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
        ctos_time::seed::mix(self.app().seed, &[self.name(), stream])
    }

    /// Makes `value` known to the other tasks of this chassis.
    pub fn share<T: std::marker::Send + Sync + 'static>(&self, key: &str, value: Arc<T>) {
        self.reads_unrecorded(format_args!("{SHARED}`{key}`"));
        self.inner.chassis.share(key, value);
    }

    /// What a task of this chassis made known under `key`.
    #[must_use]
    pub fn shared<T: std::marker::Send + Sync + 'static>(&self, key: &str) -> Option<Arc<T>> {
        self.reads_unrecorded(format_args!("{SHARED}`{key}`"));
        self.inner.chassis.shared(key)
    }

    /// The task's symbolic name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.inner.record.name
    }

    /// The task's id.
    #[must_use]
    pub fn tid(&self) -> Tid {
        self.inner.record.tid
    }

    // -- the task itself --------------------------------------------------------------------

    /// Runs a child of this task concurrently, on the same processor. It ends with the task's handler; if
    /// it panics, the handler has failed with it, and the task's restart policy decides.
    pub fn spawn(&self, future: impl Future<Output = ()> + 'static) {
        let broke = self.when_broken();
        let on_panic = move |text: String| broke(&format!("a child panicked: {text}"));
        let number = {
            let mut family = self.inner.family();
            family.next_child += 1;
            family.next_child
        };
        let cx = self.clone();
        let child = async move {
            future.await;
            cx.inner.family().children.remove(&number);
        };
        let child = self.inner.clone().polled_as(number, child);
        let id = self.inner.processor.spawn(child, Some(Rc::new(on_panic)));
        self.inner.family().children.insert(number, id);
    }
}

#[doc(hidden)]
impl Context {
    pub fn new(
        record: Arc<TaskRecord>,
        chassis: Arc<Chassis>,
        processor: Rc<Processor>,
        config: Option<Box<TaskConfig>>,
    ) -> Self {
        let durable = config.as_ref().is_some_and(|config| config.durable);
        Self::of(Rc::new(Inner {
            kept: durable.then(Arc::default),
            record,
            chassis,
            processor,
            config,
            family: RefCell::default(),
            incarnation: Cell::new(0),
            polled: Cell::new(PartPolled::No),
        }))
    }
}
