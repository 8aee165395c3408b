//! Between those who note what happens and the disk: a bounded buffer for each processor, emptied by
//! one writer.
//!
//! Noting takes a lock that only the writer ever contends for, and never waits for the disk. A buffer
//! that is full drops what comes and counts it. In real time the writer is a thread of its own. In
//! virtual time it is called where a buffer has grown, so that one seed gives one record.

use std::{
    sync::{
        Arc, Mutex, TryLockError,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel},
    },
    time::Duration,
};

use super::{batch::Batch, glossary::Glossary, writer::Writer};
use ctos_core::report::RecordReport;
use ctos_message::{CommandInfo, Tid};
use ctos_time::{Clock, Instant, lock::lock};

/// A buffer of this size wakes the writer, bytes.
const WAKE: usize = 128 * 1024;
/// How often the writer looks unasked.
const LOOK: Duration = Duration::from_millis(100);

/// The writer's thread.
struct Worker {
    /// Wakes it: a buffer has grown, or the record ends.
    wake: SyncSender<()>,
    /// Is disconnected when it has ended.
    ended: Mutex<Receiver<()>>,
}

/// Takes notes of one process, or of all chassis of a simulated app.
pub(crate) struct Recorder {
    clock: Clock,
    lanes: Vec<Mutex<Batch>>,
    limit: usize,
    next_id: AtomicU64,
    /// Events that found no space in the buffers.
    dropped: AtomicU64,
    report: Mutex<RecordReport>,
    /// The writer, and the buffers that it has emptied: they go back to the lanes.
    writer: Mutex<Option<(Writer, Vec<Batch>)>>,
    /// None: the writer is called where a buffer has grown.
    worker: Option<Worker>,
    ended: AtomicBool,
    names: Arc<Mutex<Glossary>>,
}

impl Recorder {
    /// A recorder with `lanes` buffers of at most `limit` bytes, whose writer is a thread.
    ///
    /// # Errors
    /// When the system refuses the thread.
    pub(crate) fn threaded(
        clock: Clock,
        writer: Writer,
        lanes: usize,
        limit: usize,
        flush: Duration,
    ) -> std::io::Result<Arc<Self>> {
        let (wake, woken) = sync_channel(1);
        let (end, ended) = channel();
        let ended = Mutex::new(ended);
        let worker = Some(Worker { wake, ended });
        let recorder = Arc::new(Self::new(clock, writer, lanes.max(1), limit, worker));
        let thread = recorder.clone();
        std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || thread.run(flush, &woken, end))?;
        Ok(recorder)
    }

    /// A recorder whose writer is called at once when a buffer has grown.
    pub(crate) fn inline(clock: Clock, writer: Writer, limit: usize) -> Arc<Self> {
        Arc::new(Self::new(clock, writer, 1, limit, None))
    }

    fn new(
        clock: Clock,
        writer: Writer,
        lanes: usize,
        limit: usize,
        worker: Option<Worker>,
    ) -> Self {
        let names = writer.names.clone();
        let report = Mutex::new(writer.parts.report());
        let batches = (0..lanes).map(|_| Batch::default()).collect();
        Self {
            clock,
            lanes: (0..lanes).map(|_| Mutex::default()).collect(),
            limit,
            next_id: AtomicU64::new(1),
            dropped: AtomicU64::new(0),
            report,
            writer: Mutex::new(Some((writer, batches))),
            worker,
            ended: AtomicBool::new(false),
            names,
        }
    }

    /// The present moment, ns.
    pub(crate) fn now(&self) -> u64 {
        self.clock.now().as_nanos()
    }

    pub(crate) fn fresh_id(&self) -> u64 {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    /// A task has a name from now on.
    pub(crate) fn name(&self, task: Tid, name: &str) {
        lock(&self.names).name(task, name);
    }

    /// A task has a name from now on, and takes these commands.
    pub(crate) fn named(&self, task: Tid, name: &str, commands: &[CommandInfo]) {
        let mut names = lock(&self.names);
        names.name(task, name);
        names.takes(name, commands);
    }

    /// The name of a task; its id when it has none that is known.
    pub(crate) fn name_of(&self, task: Tid) -> Arc<str> {
        lock(&self.names).task(task)
    }

    /// How the record is.
    pub(crate) fn report(&self) -> RecordReport {
        lock(&self.report).clone()
    }

    /// Notes what `add` adds at the processor of `place`. False when it was dropped.
    #[inline]
    pub(crate) fn note(&self, place: Tid, add: impl FnOnce(&mut Batch) -> bool) -> bool {
        if self.ended.load(Ordering::Relaxed) {
            return false;
        }
        let place = usize::from(place.processor());
        let Some(lane) = self.lanes.get(place).or_else(|| self.lanes.first()) else {
            return false;
        };
        let mut lane = lock(lane);
        if lane.len() >= self.limit || !add(&mut lane) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
            return false;
        }
        let grown = lane.len() >= WAKE;
        drop(lane);
        if grown {
            self.call_writer();
        }
        true
    }

    #[cold]
    fn call_writer(&self) {
        match &self.worker {
            // It is woken already when there is no space.
            Some(worker) => drop(worker.wake.try_send(())),
            None => self.write(false),
        }
    }

    /// Empties the buffers. Does nothing when somebody is at it already: what the writer itself has
    /// logged comes by here.
    fn write(&self, flush: bool) {
        let mut writer = match self.writer.try_lock() {
            Ok(writer) => writer,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        let Some((writer, batches)) = writer.as_mut() else {
            return;
        };
        for (lane, batch) in self.lanes.iter().zip(&mut *batches) {
            std::mem::swap(&mut *lock(lane), batch);
        }
        let now = self.now();
        writer.write(now, batches, self.dropped.load(Ordering::Relaxed));
        batches.iter_mut().for_each(Batch::clear);
        if flush {
            writer.parts.flush(now);
        }
        *lock(&self.report) = writer.parts.report();
    }

    /// The writer's thread; dropping `_end` tells that it has ended.
    fn run(&self, flush: Duration, woken: &Receiver<()>, _end: Sender<()>) {
        let mut flushed = self.clock.now();
        loop {
            let _ = woken.recv_timeout(LOOK.min(flush));
            // Looked at first: what was noted before the end is written.
            let ended = self.ended.load(Ordering::Acquire);
            let now: Instant = self.clock.now();
            let due = now.since(flushed) >= flush;
            if due {
                flushed = now;
            }
            self.write(due);
            if ended {
                return self.close();
            }
        }
    }

    fn close(&self) {
        let writer = lock(&self.writer).take();
        if let Some((mut writer, _)) = writer {
            writer.parts.close(self.now());
            *lock(&self.report) = writer.parts.report();
        }
    }

    /// Writes what is left and closes the file; what is noted afterwards is lost. A disk that does not
    /// answer within `timeout` is left to itself.
    pub(crate) fn finish(&self, timeout: Duration) {
        if self.ended.swap(true, Ordering::AcqRel) {
            return;
        }
        let Some(worker) = &self.worker else {
            self.write(false);
            return self.close();
        };
        self.call_writer();
        if lock(&worker.ended).recv_timeout(timeout) == Err(RecvTimeoutError::Timeout) {
            let timeout_s = timeout.as_secs_f64();
            tracing::error!(
                timeout_s,
                "the record was not closed in time: its disk does not answer"
            );
        }
    }
}
