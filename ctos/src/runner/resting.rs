//! A task for which there is nothing to do: what is kept of it then, which is little, and how its loop begins
//! again. It takes no turn for that: a chassis may have very many such tasks.

use std::{cell::Cell, rc::Rc, sync::Arc};

use super::{Runner, Serving, TellParent};
use crate::{
    chassis::{Chassis, TaskRecord},
    config::TaskConfig,
    context::{Context, Inner},
    mailbox::TaskQueue,
    moving::Arrival,
    processor::{FutureId, Processor},
    supervise::{Restarts, State},
    task::DynHandler,
};

/// What is kept of a task to which nothing has come yet, and whose context nobody has.
pub(crate) struct Built {
    pub(super) config: Option<Box<TaskConfig>>,
    pub(super) handler: Box<dyn DynHandler>,
}

impl Built {
    /// The same task, resting.
    pub(crate) fn rest(
        self,
        record: Arc<TaskRecord>,
        chassis: Arc<Chassis>,
        processor: Rc<Processor>,
    ) -> Resting {
        let inner = Inner::new(record, chassis, processor, self.config);
        Resting::new(Rc::new(inner), self.handler, None)
    }
}

/// What is kept of a task that rests: its handler, and how to go on.
pub(crate) struct Resting {
    inner: Rc<Inner>,
    handler: Box<dyn DynHandler>,
    rare: Option<Box<Rare>>,
}

/// What few tasks have.
struct Rare {
    restarts: Option<Box<Restarts>>,
    kept: Option<Vec<u8>>,
    parent: Option<TellParent>,
}

impl Resting {
    /// A task that has just been built.
    pub(super) fn new(
        inner: Rc<Inner>,
        handler: Box<dyn DynHandler>,
        parent: Option<TellParent>,
    ) -> Self {
        let rare = parent.map(|parent| Rare {
            restarts: None,
            kept: None,
            parent: Some(parent),
        });
        Self {
            inner,
            handler,
            rare: rare.map(Box::new),
        }
    }

    /// The queue of the task, which waits for what comes to it.
    pub(crate) fn wait(self) -> Rc<TaskQueue> {
        let queue = TaskQueue::open(self.inner.record.clone());
        queue.rest(self);
        queue
    }

    /// Begins the loop of the task, which takes its messages out of `queue`.
    pub(crate) fn begin(self, queue: &Rc<TaskQueue>, arrival: Option<Box<Arrival>>) -> FutureId {
        let Self {
            inner,
            handler,
            rare,
        } = self;
        let phase = inner.phase.get();
        let cx = Context::of(inner);
        let record = cx.inner.record.clone();
        let (restarts, kept, parent) = match rare.map(|rare| *rare) {
            Some(rare) => (rare.restarts, rare.kept, rare.parent),
            None => (None, None, None),
        };
        let runner = Box::new(Runner {
            cx: cx.clone(),
            record: record.clone(),
            queue: queue.clone(),
            serving: Rc::new(Serving {
                cx: cx.clone(),
                activity: record.statistics.activity().clone(),
                record,
                queue: queue.clone(),
                stopped: Cell::new(false),
            }),
            handler: Some(handler),
            restarts,
            state: State::Running,
            kept,
            phase,
            parent,
        });
        let processor = cx.processor().clone();
        // Panics of the handler are caught where it is called. What is left is its destructor.
        let on_panic = move |text: String| {
            cx.fail(&format!("it panicked while it ended: {text}"));
            cx.cancel_children();
            cx.chassis().remove_task(cx.tid());
        };
        processor.spawn(runner.run(arrival), Some(Rc::new(on_panic)))
    }
}

impl Runner {
    /// Whether a loop begun anew would go on as this one, if nothing comes before.
    pub(super) fn may_rest(&self) -> bool {
        let is_running = self.state == State::Running && !self.serving.stopped.get();
        is_running && self.handler.is_some()
    }

    /// The loop is about to end, and the task rests. False, and nothing is done, without a handler.
    pub(super) fn rest(&mut self) -> bool {
        let Some(handler) = self.handler.take() else {
            return false;
        };
        let rare = Rare {
            restarts: self.restarts.take(),
            kept: self.kept.take(),
            parent: self.parent.take(),
        };
        let is_rare = rare.restarts.is_some() || rare.kept.is_some() || rare.parent.is_some();
        self.cx.inner.phase.set(self.phase);
        self.queue.rest(Resting {
            inner: self.cx.inner.clone(),
            handler,
            rare: is_rare.then(|| Box::new(rare)),
        });
        true
    }
}

#[cfg(test)]
mod tests;
