//! What is ready is polled, what panics is contained.

use std::{
    future::Future,
    num::NonZeroU64,
    panic::{AssertUnwindSafe, catch_unwind},
    rc::Rc,
    sync::{Arc, atomic::AtomicBool},
    task::{Context as PollContext, Poll, Waker},
};

use super::{
    core::Processor,
    futures::{Entry, FutureWaker, PanicHook, Running, WakerOf},
    wake::{FutureId, LocalWake},
};
use crate::contain::{drop_contained, panic_text};

/// So many calls of one poll run their receivers at once. Later ones go through the queue of ready futures, so
/// that a task which calls without end does not keep the processor.
const HAND_OVERS: u32 = 32;

/// Calls within calls that run at once: each takes stack.
const DEEPEST: u32 = 8;

impl Processor {
    /// Adds a future; the id cancels it again.
    pub fn spawn(
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
        entry.running = Some(Box::new(Running {
            future: Box::pin(future),
            waker: Waker::from(shared.clone()),
            on_panic,
        }));
        entry.shared = Some(shared);
        futures.ready.push(id);
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
            futures.ready.push(id);
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
    pub fn ready_count(&self) -> usize {
        self.futures.borrow().ready.len()
    }

    /// Polls the `index`-th ready future. False when there is none.
    pub fn poll_ready(self: &Rc<Self>, index: usize) -> bool {
        let Some(id) = self.take_ready(index) else {
            return false;
        };
        self.enter();
        self.handed_over.set(0);
        self.poll_future(id);
        true
    }

    /// Polls every future once, whether it is ready or not: in a replay, where each knows whether it was polled.
    pub fn poll_all(self: &Rc<Self>) {
        let futures = self.futures.borrow();
        let taken = (0..).zip(&futures.entries).filter(|(_, entry)| entry.taken);
        let ids: Vec<FutureId> = taken
            .filter_map(|(index, entry)| {
                let generation = NonZeroU64::new(entry.generation)?;
                Some(FutureId { generation, index })
            })
            .collect();
        drop(futures);
        ids.into_iter().for_each(|id| self.wake(id));
        for _ in 0..self.ready_count() {
            self.poll_ready(0);
        }
    }

    /// Polls the receiver of a call at once if this delivery woke it: more than the `ready` futures from before are
    /// ready. Not on a processor with synchronous functions.
    pub(crate) fn hand_over(&self, ready: usize) {
        let (handed_over, depth) = (self.handed_over.get(), self.depth.get());
        let may = handed_over < HAND_OVERS && depth < DEEPEST && self.schedule.is_idle();
        if !may || self.ready_count() <= ready {
            return;
        }
        let Some(id) = self.take_ready(ready) else {
            return;
        };
        self.handed_over.set(handed_over + 1);
        self.depth.set(depth + 1);
        self.poll_future(id);
        self.depth.set(depth);
        self.leave();
    }

    /// Polls a future, which is out of its entry meanwhile, and puts it back unless it has ended.
    fn poll_future(&self, id: FutureId) {
        let running = {
            let mut futures = self.futures.borrow_mut();
            futures.entry(id).and_then(|entry| entry.running.take())
        };
        let Some(mut running) = running else {
            return;
        };
        let outer = self
            .current
            .replace(Some((id, WakerOf::the(&running.waker))));
        let polled = {
            let Running { future, waker, .. } = &mut *running;
            let mut cx = PollContext::from_waker(waker);
            self.leave();
            catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(&mut cx)))
        };
        self.current.set(outer);
        self.moment();
        if !matches!(polled, Ok(Poll::Pending)) {
            let Running {
                future, on_panic, ..
            } = *running;
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

    fn take_ready(&self, index: usize) -> Option<FutureId> {
        let mut futures = self.futures.borrow_mut();
        let id = futures.ready.take(index)?;
        if let Some(entry) = futures.entry(id) {
            entry.ready = false;
        }
        Some(id)
    }
}
