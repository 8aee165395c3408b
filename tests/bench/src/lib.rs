//! A chassis without a boot, for benchmarks: tasks on processors of this process, and work that runs
//! among them.

use std::{
    future::Future,
    ops::Range,
    rc::Rc,
    sync::{Arc, mpsc},
};

use ctos_config::App;
use ctos_core::{
    chassis::Chassis,
    context::{Context, TaskRef},
    handled::HandlerError,
    processor::Processor,
    registry::Registry,
    runner::{TaskSpec, start_task},
    task_record::TaskRecord,
    threads::start_processors,
};
use ctos_message::Tid;
use ctos_time::Clock;
use tokio::sync::oneshot;

/// The slot that work runs as; tasks take those below.
const WORK: u32 = u16::MAX as u32;

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
        first: u32,
        count: u32,
    ) -> Result<Vec<TaskRef>, HandlerError> {
        let (kind, chassis) = (kind.to_owned(), self.chassis.clone());
        self.on(processor, move |here| {
            start_row(&chassis, here, (processor, &kind), first..first + count)
        })?
        .recv()?
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
        let home = self.chassis.clone();
        let (sender, done) = mpsc::channel();
        self.on(processor, move |here| {
            let tid = Tid::new(home.index(), processor, WORK);
            let record = TaskRecord::of_runtime("work", tid, Arc::default(), &here.handle);
            let work = work(Context::new(record, home, here.clone(), None));
            let result = async move {
                let _ = sender.send(work.await);
            };
            here.spawn(result, None);
        })?;
        Ok(done)
    }

    /// Has a processor do `job`; what comes of it comes through the channel.
    fn on<T: Send + 'static>(
        &self,
        processor: u8,
        job: impl FnOnce(&Rc<Processor>) -> T + Send + 'static,
    ) -> Result<mpsc::Receiver<T>, HandlerError> {
        let (sender, done) = mpsc::channel();
        let found = self.chassis.processors.get(usize::from(processor));
        let (_, handle) = found.ok_or("no such processor")?;
        handle.inject(move |here| {
            let _ = sender.send(job(here));
        });
        Ok(done)
    }
}

/// Starts tasks of a kind on a processor, of this number, in these slots.
fn start_row(
    chassis: &Arc<Chassis>,
    processor: &Rc<Processor>,
    (number, kind): (u8, &str),
    slots: Range<u32>,
) -> Result<Vec<TaskRef>, HandlerError> {
    let registry = chassis.registry();
    let registered = registry.kind(kind).ok_or("no such kind of handler")?;
    let recipe = registered.recipe();
    let started = slots.map(|slot| {
        let tid = Tid::new(chassis.index(), number, slot);
        let spec = TaskSpec::new(kind, tid, None, recipe.clone(), &processor.handle);
        let task = TaskRef::new(spec.record.name.clone(), tid);
        start_task(chassis, processor, spec)?;
        Ok(task)
    });
    started.collect()
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
