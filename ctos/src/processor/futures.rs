//! The futures of a processor: what is ready is polled, what panics is contained.

use std::{
    collections::VecDeque,
    future::Future,
    num::NonZeroU64,
    panic::{AssertUnwindSafe, catch_unwind},
    pin::Pin,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context as PollContext, Poll, RawWakerVTable, Wake, Waker},
};

use super::{Processor, ProcessorHandle, drop_contained, handle::Item, panic_text};

/// Names one future among all that a processor has ever run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct FutureId {
    generation: NonZeroU64,
    index: u32,
}

pub(super) struct FutureWaker {
    id: FutureId,
    /// Whether the wake-up is in the inbox already.
    pub(super) brought: AtomicBool,
    processor: Arc<ProcessorHandle>,
}

impl Wake for FutureWaker {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        if let Some(here) = Processor::here_if(&self.processor) {
            here.wake(self.id);
        } else if !self.brought.swap(true, Ordering::AcqRel) {
            drop(self.processor.bring(Item::Wake(self.id)));
        }
    }
}

/// What a future of this processor is woken by. Free of atomics when the future is a task's own.
#[derive(Clone)]
pub(crate) enum LocalWake {
    /// It is polled again.
    Future(FutureId),
    /// Whoever polls it within another future is told.
    Waker(Waker),
}

/// Tells wakers apart, as [`Waker::will_wake`] does.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct WakerOf {
    data: *const (),
    functions: *const RawWakerVTable,
}

impl WakerOf {
    fn the(waker: &Waker) -> Self {
        Self {
            data: waker.data(),
            functions: waker.vtable(),
        }
    }
}

/// Called with what a child future's panic said.
pub(super) type PanicHook = Rc<dyn Fn(String)>;

/// What is out of its entry while it is polled.
pub(super) struct Running {
    future: Pin<Box<dyn Future<Output = ()>>>,
    waker: Waker,
    on_panic: Option<PanicHook>,
}

#[derive(Default)]
pub(super) struct Entry {
    generation: u64,
    /// Whether it is among the ready ones.
    ready: bool,
    taken: bool,
    running: Option<Running>,
    pub(super) shared: Option<Arc<FutureWaker>>,
}

#[derive(Default)]
pub(super) struct Futures {
    pub(super) entries: Vec<Entry>,
    free: Vec<u32>,
    ready: VecDeque<FutureId>,
}

impl Futures {
    pub(super) fn entry(&mut self, id: FutureId) -> Option<&mut Entry> {
        let entry = self.entries.get_mut(id.index as usize)?;
        (entry.taken && entry.generation == id.generation.get()).then_some(entry)
    }

    fn remove(&mut self, id: FutureId) -> Option<Running> {
        let entry = self.entry(id)?;
        entry.taken = false;
        entry.shared = None;
        let running = entry.running.take();
        self.free.push(id.index);
        running
    }
}

impl Processor {
    /// Adds a future; the id cancels it again.
    pub(crate) fn spawn(
        &self,
        future: impl Future<Output = ()> + 'static,
        on_panic: Option<PanicHook>,
    ) -> FutureId {
        let mut futures = self.futures.borrow_mut();
        let index = futures.free.pop().unwrap_or_else(|| {
            futures.entries.push(Entry::default());
            (futures.entries.len() - 1) as u32
        });
        // The index was free or has just been made.
        #[allow(clippy::indexing_slicing, reason = "see above")]
        let entry = &mut futures.entries[index as usize];
        let generation = NonZeroU64::MIN.saturating_add(entry.generation);
        entry.generation = generation.get();
        let id = FutureId { generation, index };
        let shared = Arc::new(FutureWaker {
            id,
            brought: AtomicBool::new(false),
            processor: self.handle.clone(),
        });
        entry.taken = true;
        entry.ready = true;
        entry.running = Some(Running {
            future: Box::pin(future),
            waker: Waker::from(shared.clone()),
            on_panic,
        });
        entry.shared = Some(shared);
        futures.ready.push_back(id);
        id
    }

    /// Drops a future. A future that cancels itself ends at its next await.
    pub(crate) fn cancel(&self, id: FutureId) {
        let running = self.futures.borrow_mut().remove(id);
        // Dropped outside the borrow: destructors may spawn, wake or cancel.
        drop_contained(running);
    }

    /// A future is ready to be polled.
    pub(crate) fn wake(&self, id: FutureId) {
        let mut futures = self.futures.borrow_mut();
        if let Some(entry) = futures.entry(id)
            && !entry.ready
        {
            entry.ready = true;
            futures.ready.push_back(id);
        }
    }

    pub(super) fn wake_local(&self, wake: LocalWake) {
        match wake {
            LocalWake::Future(id) => self.wake(id),
            LocalWake::Waker(waker) => waker.wake(),
        }
    }

    /// What the future polled with `cx` is woken by.
    pub(super) fn waits(&self, cx: &PollContext<'_>) -> LocalWake {
        match self.current.get() {
            Some((id, waker)) if waker == WakerOf::the(cx.waker()) => LocalWake::Future(id),
            _ => LocalWake::Waker(cx.waker().clone()),
        }
    }

    /// How many futures are ready to be polled.
    pub(crate) fn ready_count(&self) -> usize {
        self.futures.borrow().ready.len()
    }

    /// Polls the `index`-th ready future. False when there is none.
    pub(crate) fn poll_ready(self: &Rc<Self>, index: usize) -> bool {
        let Some((id, running)) = self.take_ready(index) else {
            return false;
        };
        if let Some(running) = running {
            self.enter();
            self.poll_running(id, running);
        }
        true
    }

    /// Polls a future that was taken out of its entry, and puts it back unless it has ended.
    fn poll_running(&self, id: FutureId, mut running: Running) {
        self.current.set(Some((id, WakerOf::the(&running.waker))));
        let polled = {
            let Running { future, waker, .. } = &mut running;
            let mut cx = PollContext::from_waker(waker);
            self.leave();
            catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(&mut cx)))
        };
        self.current.set(None);
        self.moment();
        if !matches!(polled, Ok(Poll::Pending)) {
            let Running {
                future, on_panic, ..
            } = running;
            drop_contained(future);
            self.cancel(id);
            if let (Err(panic), Some(on_panic)) = (polled, on_panic) {
                on_panic(panic_text(panic.as_ref()));
            }
            return;
        }
        let cancelled = {
            let mut futures = self.futures.borrow_mut();
            match futures.entry(id) {
                Some(entry) => {
                    entry.running = Some(running);
                    None
                }
                None => Some(running),
            }
        };
        // It was cancelled while it was polled.
        if cancelled.is_some() {
            drop_contained(cancelled);
        }
    }

    fn take_ready(&self, index: usize) -> Option<(FutureId, Option<Running>)> {
        let mut futures = self.futures.borrow_mut();
        let id = futures.ready.remove(index)?;
        let running = futures.entry(id).and_then(|entry| {
            entry.ready = false;
            entry.running.take()
        });
        Some((id, running))
    }
}
