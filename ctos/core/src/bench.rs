//! A chassis without a boot, for benchmarks: tasks on processors of this process, and work that runs
//! among them; and what tests of other crates need of a processor. Not part of the interface.

use crate::{
    chassis::Chassis,
    context::{Context, TaskRef},
    handled::HandlerError,
    registry::Registry,
    runner::{TaskSpec, start_task},
    task_record::TaskRecord,
    threads::start_processors,
};
use ctos_config::App;
use ctos_message::Tid;
use ctos_time::Clock;
use std::{future::Future, sync::Arc, sync::mpsc};
use tokio::sync::oneshot;

/// The slot that work runs as; tasks take those below.
const WORK: u16 = u16::MAX;

/// The first chassis of an app, running.
pub struct Bench {
    chassis: Arc<Chassis>,
    threads: Vec<oneshot::Receiver<()>>,
}

impl Bench {
    /// Starts the processors of the first chassis of `app`. Its tasks are started one by one.
    ///
    /// # Errors
    /// When the system refuses a thread.
    pub fn start(app: App, registry: Registry) -> std::io::Result<Self> {
        let chassis = Chassis::new(1, Arc::new(app), Arc::new(registry), Clock::real());
        let threads = start_processors(&chassis)?;
        Ok(Self { chassis, threads })
    }

    /// Starts `count` tasks of a registered kind in the slots from `first` of configured processor
    /// number `processor`, counted from 1.
    ///
    /// # Errors
    /// Why one could not be built.
    pub fn tasks(
        &self,
        kind: &str,
        processor: u8,
        first: u16,
        count: u16,
    ) -> Result<Vec<TaskRef>, HandlerError> {
        let kind = kind.to_owned();
        self.run(processor, move |cx| async move {
            start_row(&cx, &kind, first, count)
        })?
    }

    /// Makes a task known by its name, as the task identification service would.
    pub fn name(&self, task: &TaskRef) {
        self.chassis.directory.learn(task.name(), task.tid());
    }

    /// Runs `work` as a task of processor number `processor`, and waits for its end.
    ///
    /// # Errors
    /// When there is no such processor, or the work panicked.
    pub fn run<T: Send + 'static, F: Future<Output = T> + 'static>(
        &self,
        processor: u8,
        work: impl FnOnce(Context) -> F + Send + 'static,
    ) -> Result<T, HandlerError> {
        Ok(self.begin(processor, work)?.recv()?)
    }

    /// [`Self::run`] without waiting: the end comes through the channel.
    ///
    /// # Errors
    /// When there is no such processor.
    pub fn begin<T: Send + 'static, F: Future<Output = T> + 'static>(
        &self,
        processor: u8,
        work: impl FnOnce(Context) -> F + Send + 'static,
    ) -> Result<mpsc::Receiver<T>, HandlerError> {
        let (sender, done) = mpsc::channel();
        let home = self.chassis.clone();
        let found = home.processors.get(usize::from(processor));
        let (_, handle) = found.ok_or("no such processor")?;
        handle.clone().inject(move |here| {
            let tid = Tid::new(home.index(), processor, WORK);
            let record = TaskRecord::of_runtime("work", tid, Arc::default(), &here.handle);
            let cx = Context::new(record, home, here.clone(), None);
            let work = work(cx);
            let result = async move {
                let _ = sender.send(work.await);
            };
            here.spawn(result, None);
        });
        Ok(done)
    }
}

/// Starts `count` tasks of a kind on the processor of `cx`, in slots from `first` on.
fn start_row(
    cx: &Context,
    kind: &str,
    first: u16,
    count: u16,
) -> Result<Vec<TaskRef>, HandlerError> {
    let (processor, registry) = (cx.processor(), cx.registry());
    let registered = registry.kind(kind).ok_or("no such kind of handler")?;
    let recipe = registered.recipe();
    let mut tasks = Vec::with_capacity(usize::from(count));
    for slot in first..first + count {
        let tid = Tid::new(cx.tid().chassis(), cx.tid().processor(), slot);
        let spec = TaskSpec::new(kind, tid, None, recipe.clone(), &processor.handle);
        tasks.push(TaskRef::new(spec.record.name.clone(), tid));
        start_task(cx.chassis(), processor, spec)?;
    }
    Ok(tasks)
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.chassis.stop_processors();
        for thread in self.threads.drain(..) {
            // Ends when the thread has dropped everything it ran, in whatever way.
            let _ = thread.blocking_recv();
        }
        self.chassis.close();
    }
}
