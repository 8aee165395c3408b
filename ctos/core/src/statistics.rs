//! The statistics of a task while it runs. Its loop counts them; any thread can read them without
//! disturbing it.

use crate::{
    last_messages::Recent,
    meter::{CommandCount, TaskMeter, add},
    phase::Phase,
    report::{AtReport, TaskCounters},
    waits::Waits,
};
use ctos_message::CommandInfo;
use ctos_time::{Instant, lock::lock};
use std::{
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicU8, AtomicU16, AtomicU64, Ordering},
    },
    time::Duration,
};

/// The statistics of one task: empty until it has something to do.
#[derive(Default)]
pub struct TaskStatistics {
    commands: Arc<[CommandInfo]>,
    /// Made when there is something to count: of very many tasks most may be idle.
    activity: OnceLock<Arc<Activity>>,
}

/// What one task does.
#[derive(Debug, Default)]
pub struct Activity {
    handled: AtomicU64,
    failed: AtomicU64,
    busy_ns: AtomicU64,
    longest_ns: AtomicU64,
    /// When the message at hand was begun, ns since the start of the app plus one; 0: none is.
    began_ns: AtomicU64,
    command: AtomicU16,
    restarts: AtomicU64,
    /// The place of the last startup phase in their order, from 1 on; 0: none was entered.
    phase: AtomicU8,
    phase_since_ns: AtomicU64,
    /// Further counters, for displays and metrics.
    pub meter: TaskMeter,
    /// Its last messages, for displays.
    pub recent: Recent,
    /// Whom it waits for.
    pub(crate) waits: Waits,
    /// What it says that it is at.
    pub(crate) at: Mutex<Option<AtReport>>,
}

impl TaskStatistics {
    /// Of a task that takes `commands`, which are counted one by one.
    pub(crate) fn of(commands: Arc<[CommandInfo]>) -> Self {
        Self {
            commands,
            activity: OnceLock::new(),
        }
    }

    /// The commands that the task takes.
    pub fn commands(&self) -> &[CommandInfo] {
        &self.commands
    }

    fn blank(&self) -> Activity {
        Activity {
            meter: TaskMeter::of(self.commands.clone()),
            ..Activity::default()
        }
    }

    /// What the task does, from now on at the latest.
    #[inline]
    pub fn activity(&self) -> &Arc<Activity> {
        self.activity.get_or_init(|| Arc::new(self.blank()))
    }

    /// The counters as they are now. Each is exact; together they may be of slightly different moments.
    pub fn read(&self) -> TaskCounters {
        let activity = self.activity.get();
        activity.map_or_else(TaskCounters::default, |activity| activity.read())
    }

    /// When the last startup phase was entered.
    pub fn phase_since(&self) -> Option<Instant> {
        self.activity.get()?.phase_since()
    }

    /// What the task says that it is at.
    pub fn at(&self) -> Option<AtReport> {
        lock(&self.activity.get()?.at).clone()
    }

    /// Whom the task waits for, if it ever waited for anybody.
    pub fn waits(&self) -> Option<&Waits> {
        self.activity.get().map(|activity| &activity.waits)
    }

    /// The poll of the handler that is under way, if one is.
    pub fn poll(&self) -> Option<u64> {
        self.activity.get()?.meter.poll()
    }

    /// Messages by command, and how many took at most the bound of each bucket, and longer than all.
    pub fn counts(&self) -> (Vec<CommandCount>, Vec<u64>) {
        let of = |activity: &Activity| (activity.meter.commands(), activity.meter.durations());
        match self.activity.get() {
            Some(activity) => of(activity),
            None => of(&self.blank()),
        }
    }
}

impl Activity {
    /// The handler is called with `command`.
    #[inline]
    pub(crate) fn begin(&self, command: u16, now: Instant) {
        self.command.store(command, Ordering::Relaxed);
        self.began_ns
            .store(now.as_nanos().saturating_add(1), Ordering::Release);
    }

    /// The handler has returned, after `took`.
    pub(crate) fn end(&self, ok: bool, took: Duration) {
        let took = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        self.began_ns.store(0, Ordering::Release);
        add(&self.busy_ns, took);
        if took > self.longest_ns.load(Ordering::Relaxed) {
            self.longest_ns.store(took, Ordering::Relaxed);
        }
        add(&self.handled, 1);
        let command = self.command.load(Ordering::Relaxed);
        self.meter.ended(command, ok, took);
        if !ok {
            add(&self.failed, 1);
        }
    }

    /// The handler was built anew.
    pub(crate) fn restarted(&self) {
        self.restarts.fetch_add(1, Ordering::Relaxed);
    }

    /// The task has entered `phase`.
    pub(crate) fn entered(&self, phase: Phase, now: Instant) {
        self.phase_since_ns.store(now.as_nanos(), Ordering::Relaxed);
        self.phase.store(phase as u8 + 1, Ordering::Release);
    }

    fn phase_since(&self) -> Option<Instant> {
        let entered = self.phase.load(Ordering::Acquire) > 0;
        let since = self.phase_since_ns.load(Ordering::Relaxed);
        entered.then_some(Instant::from_nanos(since))
    }

    fn read(&self) -> TaskCounters {
        let began = self.began_ns.load(Ordering::Acquire);
        TaskCounters {
            handled: self.handled.load(Ordering::Relaxed),
            failed: self.failed.load(Ordering::Relaxed),
            busy: Duration::from_nanos(self.busy_ns.load(Ordering::Relaxed)),
            longest: Duration::from_nanos(self.longest_ns.load(Ordering::Relaxed)),
            began: began.checked_sub(1).map(Instant::from_nanos),
            command: self.command.load(Ordering::Relaxed),
            restarts: self.restarts.load(Ordering::Relaxed),
            phase: Phase::ALL
                .into_iter()
                .find(|phase| *phase as u8 + 1 == self.phase.load(Ordering::Relaxed)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_counts_once_with_the_time_it_took() {
        let statistics = TaskStatistics::default();
        assert_eq!(statistics.read(), TaskCounters::default());
        let activity = statistics.activity();
        activity.entered(Phase::Run, Instant::START);
        activity.begin(7, Instant::START);
        assert_eq!(statistics.read().began, Some(Instant::START));
        activity.end(true, Duration::from_nanos(30));
        activity.begin(8, Instant::from_nanos(40));
        activity.end(false, Duration::from_nanos(10));
        let counters = statistics.read();
        assert_eq!(
            counters,
            TaskCounters {
                handled: 2,
                failed: 1,
                busy: Duration::from_nanos(40),
                longest: Duration::from_nanos(30),
                began: None,
                command: 8,
                restarts: 0,
                phase: Some(Phase::Run),
            }
        );
    }
}
