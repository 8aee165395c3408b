//! A chassis: the tasks of one process, where their messages go, and what they share.
//!
//! `delivery` alone decides how a message travels. A task of this chassis gets a value; a task of
//! another one gets a frame over the link. The sender waits the same way for both.

pub(crate) mod delivery;
mod extension;
mod links;
pub(crate) mod pending;

use std::{
    any::Any,
    collections::BTreeMap,
    rc::Rc,
    sync::{
        Arc, Mutex, OnceLock, PoisonError, RwLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use crossbeam_utils::CachePadded;

use self::{extension::Extensions, pending::Links};
use crate::{
    directory::TaskDirectory,
    envelope::Message,
    processor::{Processor, ProcessorHandle},
    realtime::RealtimeGrant,
    sync::{CyclicStatistics, Directory, Schedule, ScheduleSettings, ScheduleView},
    tap::Tap,
    task_record::TaskRecord,
};
use ctos_config::{App, ChassisConfig, ProcessorConfig, Start};
use ctos_message::{ChassisNumber, Tid, fault::Fault};
use ctos_time::{Clock, lock::lock, park::Park};

pub use self::extension::Extension;

pub use ctos_config::BOOT_CHASSIS;

type OnExit = Box<dyn FnOnce(i32) + Send>;

/// Makes a place where one thread sleeps and looks at the links.
pub(crate) type MakePark = Box<dyn Fn() -> Arc<dyn Park> + Send + Sync>;

/// Sees each message that a task of the chassis begins to handle.
pub(crate) type OnDelivery = Box<dyn Fn(&TaskRecord, &Message) + Send + Sync>;

/// Chassis count from 1: 0 is the one that boots.
fn configured(app: &App, index: ChassisNumber) -> Option<&ChassisConfig> {
    app.chassis.get(usize::from(index).checked_sub(1)?)
}

/// One process's share of an app. Shared by its threads.
#[derive(derive_more::Debug)]
#[debug("Chassis({} `{}`)", self.index, self.name())]
pub struct Chassis {
    index: ChassisNumber,
    #[doc(hidden)]
    pub clock: Clock,
    #[doc(hidden)]
    pub app: Arc<App>,
    /// Processor 0 belongs to the runtime; the configured ones follow.
    #[doc(hidden)]
    pub processors: Vec<(String, Arc<ProcessorHandle>)>,
    tasks: CachePadded<RwLock<BTreeMap<Tid, Arc<TaskRecord>>>>,
    links: Mutex<Links>,
    shared: Mutex<BTreeMap<String, Arc<dyn Any + Send + Sync>>>,
    #[doc(hidden)]
    pub directory: TaskDirectory,
    on_exit: Mutex<Option<OnExit>>,
    on_delivery: OnceLock<OnDelivery>,
    /// Set by the first order to stop: from then on a chassis that goes is no news.
    stopping: AtomicBool,
    leaving: AtomicBool,
    /// Padded, as `tasks` is: senders write both for each message, and receivers read what would stand beside them.
    next_trace: CachePadded<AtomicU64>,
    cyclics: Arc<Directory>,
    realtime: Mutex<Vec<RealtimeGrant>>,
    /// What services keep for it.
    extensions: Extensions,
    /// What looks on: a recorder, a replay, nobody.
    #[doc(hidden)]
    pub tap: Tap,
    /// Makes places where threads sleep that look at its links, when these are real ones.
    parks: OnceLock<MakePark>,
}

impl Chassis {
    /// Chassis number `index` of `app`; its processors' threads are started elsewhere.
    pub(crate) fn bare(index: ChassisNumber, app: Arc<App>, clock: Clock) -> Arc<Self> {
        let configured = configured(&app, index).map_or(&[][..], |one| &one.processors);
        let processors = std::iter::once("system".to_owned())
            .chain(configured.iter().map(|one| one.name.clone()))
            .map(|name| (name, Arc::default()))
            .collect();
        Arc::new(Self {
            index,
            extensions: Extensions::default(),
            clock,
            app,
            processors,
            tasks: CachePadded::default(),
            links: Mutex::default(),
            shared: Mutex::default(),
            directory: TaskDirectory::default(),
            on_exit: Mutex::default(),
            on_delivery: OnceLock::new(),
            stopping: AtomicBool::new(false),
            leaving: AtomicBool::new(false),
            next_trace: AtomicU64::new(1).into(),
            cyclics: Arc::default(),
            realtime: Mutex::default(),
            tap: Tap::default(),
            parks: OnceLock::new(),
        })
    }

    /// Its number; 0 is the chassis that booted the app.
    #[must_use]
    pub fn index(&self) -> ChassisNumber {
        self.index
    }

    /// The name of chassis number `index`.
    #[must_use]
    pub fn name_of(&self, index: ChassisNumber) -> &str {
        match (index, self.config_of(index)) {
            (0, _) => BOOT_CHASSIS,
            (_, Some(config)) => &config.name,
            (_, None) => "unknown",
        }
    }

    /// The number of the chassis of that name.
    #[must_use]
    pub fn number_of(&self, name: &str) -> Option<ChassisNumber> {
        if name == BOOT_CHASSIS {
            return Some(0);
        }
        let place = self.app.place_of_chassis(name)?;
        ChassisNumber::try_from(place + 1).ok()
    }

    /// What the configuration says of chassis number `index`; nothing of the one that boots, 0.
    #[must_use]
    pub fn config_of(&self, index: ChassisNumber) -> Option<&ChassisConfig> {
        configured(&self.app, index)
    }

    /// Whether the process of chassis `index` starts when somebody looks for one of its tasks.
    #[doc(hidden)]
    #[must_use]
    pub fn starts_on_demand(&self, index: ChassisNumber) -> bool {
        self.config_of(index)
            .is_some_and(|config| config.start == Start::OnDemand)
    }

    /// What the configuration says of processor `index`; nothing of the runtime's own, 0.
    pub(crate) fn processor_config(&self, index: usize) -> Option<&ProcessorConfig> {
        let processors = &self.config_of(self.index)?.processors;
        processors.get(index.checked_sub(1)?)
    }

    /// Where the thread of processor `index` sleeps and looks at links. Nowhere if something must run in time
    /// there; the runtime's own processor does only where there is no other.
    pub(crate) fn park_of(&self, index: usize) -> Option<Arc<dyn Park>> {
        let may = match self.processor_config(index) {
            Some(config) => !config.realtime && config.period.is_none(),
            None => self.processors.len() == 1,
        };
        self.parks.get().filter(|_| may).map(|make| make())
    }

    /// The synchronous functions that run here, by `task.function`, with what is known of each.
    #[must_use]
    pub fn cyclics(&self) -> Vec<(String, Arc<CyclicStatistics>)> {
        self.cyclics.functions()
    }

    /// What the system granted to each configured processor; nothing in virtual time.
    #[must_use]
    pub fn realtime(&self) -> Vec<RealtimeGrant> {
        lock(&self.realtime).clone()
    }

    pub(crate) fn set_realtime(&self, grants: Vec<RealtimeGrant>) {
        *lock(&self.realtime) = grants;
    }

    /// Puts `value` where the other tasks of this chassis find it.
    pub fn share<T: Send + Sync + 'static>(&self, key: &str, value: Arc<T>) {
        lock(&self.shared).insert(key.to_owned(), value);
    }

    /// What was shared under `key`, if it is a `T`.
    #[must_use]
    pub fn shared<T: Send + Sync + 'static>(&self, key: &str) -> Option<Arc<T>> {
        lock(&self.shared).get(key)?.clone().downcast::<T>().ok()
    }

    /// [`Self::add_task`] of one whose handler was just built.
    pub(crate) fn add_built(&self, task: Arc<TaskRecord>) {
        let tid = task.tid;
        self.add_task(task);
        if let (Some(recorder), Some(task)) = (self.tap.recorder(), self.task(tid)) {
            recorder.built(tid, &task.name, task.statistics.commands());
        }
    }

    /// The app is being taken down.
    pub(crate) fn set_stopping(&self) {
        self.stopping.store(true, Ordering::Release);
    }

    /// `task` begins to handle `message`.
    #[inline]
    pub(crate) fn delivered(&self, task: &TaskRecord, message: &Message) {
        if let Some(on_delivery) = self.on_delivery.get() {
            on_delivery(task, message);
        }
    }

    pub(crate) fn peer_down_fault(&self, peer: ChassisNumber) -> Fault {
        Fault::PeerDown {
            chassis: self.name_of(peer).to_owned(),
        }
    }

    /// The app's time, as this chassis sees it.
    #[must_use]
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Its name in the configuration.
    #[must_use]
    pub fn name(&self) -> &str {
        self.name_of(self.index)
    }

    /// The schedules of the processors here that have synchronous functions.
    #[must_use]
    pub fn schedules(&self) -> Vec<ScheduleView> {
        self.cyclics.schedules()
    }
}

#[doc(hidden)]
impl Chassis {
    /// The numbers of all chassis of the app but this one.
    pub fn others(&self) -> impl Iterator<Item = ChassisNumber> + '_ {
        (0..=ChassisNumber::MAX)
            .take(self.app.chassis.len() + 1)
            .filter(|index| *index != self.index)
    }

    /// Processor `index`, to be run by the calling thread.
    pub fn processor(&self, index: usize) -> Option<Rc<Processor>> {
        let (name, handle) = self.processors.get(index)?;
        let mut settings = ScheduleSettings {
            processor: format!("{}/{name}", self.name()),
            ..ScheduleSettings::default()
        };
        if let Some(config) = self.processor_config(index) {
            settings.period = config.period;
            settings.overrun = config.overrun;
            settings.lead = config.lead();
        }
        let schedule = Schedule::new(settings, self.clock.clone());
        let schedule = schedule.shown_in(self.cyclics.clone());
        Some(Processor::with_schedule(
            handle.clone(),
            self.clock.clone(),
            schedule,
        ))
    }

    /// Its processors' threads sleep there when they have nothing else to do, and look at its links.
    pub fn set_parks(&self, make: MakePark) {
        let _ = self.parks.set(make);
    }

    pub fn add_task(&self, task: Arc<TaskRecord>) {
        let mut tasks = self.tasks.write().unwrap_or_else(PoisonError::into_inner);
        tasks.insert(task.tid, task);
    }

    /// Takes a task out; what is in its mailbox is answered.
    pub fn remove_task(self: &Arc<Self>, tid: Tid) {
        for extension in self.extensions() {
            extension.task_ended(self, tid);
        }
        let mut tasks = self.tasks.write().unwrap_or_else(PoisonError::into_inner);
        let removed = tasks.remove(&tid);
        drop(tasks);
        if let Some(task) = removed {
            task.mailbox.close();
        }
    }

    pub fn task(&self, tid: Tid) -> Option<Arc<TaskRecord>> {
        let tasks = self.tasks.read().unwrap_or_else(PoisonError::into_inner);
        tasks.get(&tid).cloned()
    }

    /// The tasks of this chassis, by id.
    pub fn tasks(&self) -> Vec<Arc<TaskRecord>> {
        let tasks = self.tasks.read().unwrap_or_else(PoisonError::into_inner);
        tasks.values().cloned().collect()
    }

    /// A trace id that no other message of the run has.
    pub fn fresh_trace(&self) -> u64 {
        // The highest 16 bits keep the chassis apart; 2^48 messages of one chassis do not come about.
        (u64::from(self.index) << 48) | self.next_trace.fetch_add(1, Ordering::Relaxed)
    }

    /// This chassis has been told to end: that another is gone is no news from here on, not even of the boot.
    pub fn set_leaving(&self) {
        self.set_stopping();
        self.leaving.store(true, Ordering::Release);
    }

    /// Whether the app is being taken down.
    pub fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Acquire)
    }

    /// Whom to show each message that a task begins to handle. The first one counts.
    pub fn on_delivery(&self, on_delivery: OnDelivery) {
        let _ = self.on_delivery.set(on_delivery);
    }

    /// The name of one of its tasks.
    pub fn task_name(&self, tid: Tid) -> Option<Arc<str>> {
        self.task(tid).map(|task| task.name.clone())
    }

    /// What to do when the chassis shall end.
    pub fn set_on_exit(&self, on_exit: impl FnOnce(i32) + Send + 'static) {
        *lock(&self.on_exit) = Some(Box::new(on_exit));
    }

    /// Ends the chassis with an exit code. The first call counts.
    pub fn exit(&self, code: i32) {
        let on_exit = lock(&self.on_exit).take();
        if let Some(on_exit) = on_exit {
            on_exit(code);
        }
    }

    /// Forgets all tasks and links. Messages that wait in the queues are answered; calls that wait for
    /// others end with the fault that these are gone. Without it a chassis that ends inside a process
    /// that goes on would keep itself alive through its messages.
    pub fn close(&self) {
        let tasks =
            std::mem::take(&mut *self.tasks.write().unwrap_or_else(PoisonError::into_inner));
        for task in tasks.values() {
            task.mailbox.close();
        }
        let links = std::mem::take(&mut *lock(&self.links));
        for pending in links.pending.into_values() {
            let fault = self.peer_down_fault(pending.peer());
            pending.answer(Err(fault));
        }
        lock(&self.shared).clear();
        for extension in self.extensions() {
            extension.closed();
        }
    }

    /// Stops the threads of its processors.
    pub fn stop_processors(&self) {
        for (_, handle) in &self.processors {
            handle.stop();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use super::*;
    use crate::registry::Registry;
    use ctos_config::load_texts;

    fn app(tasks: usize) -> Arc<App> {
        let mut text = "[chassis.desk]\n[chassis.cell]\n".to_owned();
        for task in 0..tasks {
            let on = if task % 2 == 0 { "desk" } else { "cell" };
            writeln!(text, "[task.t{task}]\nhandler = \"h\"\non = \"{on}\"").unwrap();
        }
        Arc::new(load_texts(&[("app.toml", &text)], &[], &[]).unwrap())
    }

    #[test]
    fn a_chassis_has_one_number_and_one_name() {
        let chassis = Chassis::new(1, app(2), Arc::new(Registry::new()), Clock::real());
        for (name, number) in [(BOOT_CHASSIS, 0), ("desk", 1), ("cell", 2)] {
            assert_eq!(chassis.number_of(name), Some(number));
            assert_eq!(chassis.name_of(number), name);
        }
        assert_eq!(chassis.number_of("cage"), None);
    }

    #[test]
    fn a_task_of_the_configuration_is_found_among_thousands_as_fast_as_among_ten() {
        let clock = Clock::real();
        let took = |tasks: usize| {
            let app = app(tasks);
            let names: Vec<String> = (0..tasks).map(|task| format!("t{task}")).collect();
            let begun = clock.now();
            for name in names.iter().cycle().take(30_000) {
                assert_eq!(app.task(name).unwrap().name, *name);
            }
            clock.now().since(begun)
        };
        let (few, many) = (took(10), took(3000));
        // Looking through all of them takes some hundred times as long.
        assert!(many < few * 20, "{many:?} among 3000, {few:?} among 10");
    }
}
