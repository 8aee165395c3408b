//! The futures of a processor, and how they are woken.

use std::{
    future::Future,
    pin::Pin,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{RawWakerVTable, Wake, Waker},
};

use super::{
    core::Processor,
    handle::{Item, ProcessorHandle},
    ready::Ready,
    wake::FutureId,
};

pub(super) struct FutureWaker {
    pub(super) id: FutureId,
    /// Whether the wake-up is in the inbox already.
    pub(super) brought: AtomicBool,
    pub(super) processor: Arc<ProcessorHandle>,
}

impl Wake for FutureWaker {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        if let Some(here) = Processor::here_if(&self.processor) {
            here.wake(self.id);
        } else if !self.brought.swap(true, Ordering::AcqRel) {
            self.processor.send(Item::Wake(self.id));
        }
    }
}

/// Tells wakers apart, as [`Waker::will_wake`] does.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct WakerOf {
    data: *const (),
    functions: *const RawWakerVTable,
}

impl WakerOf {
    pub(super) fn the(waker: &Waker) -> Self {
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
    pub(super) future: Pin<Box<dyn Future<Output = ()>>>,
    pub(super) waker: Waker,
    pub(super) on_panic: Option<PanicHook>,
}

#[derive(Default)]
pub(super) struct Entry {
    pub(super) generation: u64,
    /// Whether it is among the ready ones.
    pub(super) ready: bool,
    pub(super) taken: bool,
    pub(super) running: Option<Box<Running>>,
    pub(super) shared: Option<Arc<FutureWaker>>,
}

#[derive(Default)]
pub(super) struct Futures {
    pub(super) entries: Vec<Entry>,
    pub(super) free: Vec<u32>,
    pub(super) ready: Ready<FutureId>,
}

impl Futures {
    pub(super) fn entry(&mut self, id: FutureId) -> Option<&mut Entry> {
        let entry = self.entries.get_mut(id.index as usize)?;
        (entry.taken && entry.generation == id.generation.get()).then_some(entry)
    }

    pub(super) fn remove(&mut self, id: FutureId) -> Option<Box<Running>> {
        let entry = self.entry(id)?;
        entry.taken = false;
        entry.shared = None;
        let running = entry.running.take();
        self.free.push(id.index);
        running
    }
}
