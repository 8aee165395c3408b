//! The base ticks of a schedule, counted by the clock or by a device, and the functions that run at them.

use std::{sync::Arc, time::Duration};

use super::{
    Cyclic, FunctionView, Overrun, Tick, flow,
    function::{FailureHook, Function},
    source::Ticks,
};
use ctos_time::Instant;

/// A device that paces a schedule and gives no tick for so long has failed.
const SILENCE: Duration = Duration::from_secs(1);

/// Base ticks, and who runs at them.
pub(super) struct Grid {
    base_ns: u64,
    /// A tick and its moment, from which the clock counts the others.
    anchor: (u64, Instant),
    /// The next tick.
    next: u64,
    source: Option<Paced>,
    /// In running order, but for those that were added last if it is `unsorted`.
    pub(super) functions: Vec<Function>,
    unsorted: bool,
    /// A tick is under way: functions keep their places.
    pub(super) running: bool,
    /// The overrun that stops the app was reported.
    stopped: bool,
}

/// A grid that a device paces.
struct Paced {
    ticks: Arc<Ticks>,
    /// The tick before the device's first one.
    offset: u64,
}

/// A base tick that is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Due {
    /// Its number.
    pub(super) tick: u64,
    /// When it was due.
    pub(super) at: Instant,
    /// When the next one will be.
    pub(super) next: Instant,
    /// How many ticks before it were skipped.
    pub(super) missed: u64,
    base_ns: u64,
}

impl Due {
    /// When `tick`, not later than this one, was due.
    pub(super) fn of_tick(&self, tick: u64) -> Instant {
        let back = self.base_ns.saturating_mul(self.tick.saturating_sub(tick));
        Instant::from_nanos(self.at.as_nanos().saturating_sub(back))
    }
}

/// What a look at the clock, or the device, brought.
pub(super) enum Begun {
    Nothing,
    Tick(Due),
    /// The device has failed, and the clock took over.
    SourceFailed(String, Vec<FailureHook>),
}

impl Grid {
    /// Ticks every `base` from `anchor` on; the first one is the first after `now`.
    pub(super) fn new(base: Duration, anchor: Instant, now: Instant) -> Self {
        let base_ns = u64::try_from(base.as_nanos()).unwrap_or(u64::MAX).max(1);
        let passed = u64::try_from(now.since(anchor).as_nanos()).unwrap_or(u64::MAX);
        Self {
            base_ns,
            anchor: (0, anchor),
            next: passed / base_ns + 1,
            source: None,
            functions: Vec::new(),
            unsorted: false,
            running: false,
            stopped: false,
        }
    }

    pub(super) fn base(&self) -> Duration {
        Duration::from_nanos(self.base_ns)
    }

    pub(super) fn is_paced(&self) -> bool {
        self.source.is_some()
    }

    /// The first tick to come at which a function of this rate runs.
    pub(super) fn first_release(&self, every: u64, phase: u64) -> u64 {
        let over = self.next % every;
        let wait = if over <= phase {
            phase - over
        } else {
            every - over + phase
        };
        self.next + wait
    }

    fn moment(&self, tick: u64) -> Instant {
        let ticks = tick.saturating_sub(self.anchor.0);
        self.anchor.1 + Duration::from_nanos(self.base_ns.saturating_mul(ticks))
    }

    /// The moment of the next tick, if the clock decides it.
    pub(super) fn next_tick(&self) -> Option<Instant> {
        self.source.is_none().then(|| self.moment(self.next))
    }

    /// The moment at which something is due without being told: the next tick, or the end of the
    /// patience with a silent device.
    pub(super) fn next_due(&self) -> Instant {
        match &self.source {
            None => self.moment(self.next),
            Some(paced) if paced.ticks.is_over() => Instant::START,
            Some(_) => self.anchor.1 + self.patience(),
        }
    }

    fn patience(&self) -> Duration {
        SILENCE.max(Duration::from_nanos(self.base_ns.saturating_mul(20)))
    }

    /// Lets a device decide when the ticks are.
    pub(super) fn pace(&mut self, ticks: Arc<Ticks>, now: Instant) {
        self.anchor = (self.next - 1, now);
        let offset = self.next - 1;
        self.source = Some(Paced { ticks, offset });
    }

    /// Begins a tick if one is due.
    pub(super) fn begin(&mut self, now: Instant) -> Begun {
        let due = match &self.source {
            None => self.due_by_clock(now),
            Some(paced) => match paced.ticks.read() {
                _ if paced.ticks.is_over() => return self.end_source(now),
                Some((count, at)) if paced.offset + count >= self.next => {
                    let tick = paced.offset + count;
                    self.anchor = (tick, at);
                    let missed = tick - self.next;
                    Some(self.due(tick, at, missed))
                }
                _ if now >= self.next_due() => return self.end_source(now),
                _ => None,
            },
        };
        match due {
            Some(due) if !self.running => {
                self.next = due.tick + 1;
                self.running = true;
                Begun::Tick(due)
            }
            _ => Begun::Nothing,
        }
    }

    fn due_by_clock(&self, now: Instant) -> Option<Due> {
        let at = self.moment(self.next);
        if at > now {
            return None;
        }
        let late = u64::try_from(now.since(at).as_nanos()).unwrap_or(u64::MAX);
        let missed = late / self.base_ns;
        let tick = self.next + missed;
        Some(self.due(tick, self.moment(tick), missed))
    }

    fn due(&self, tick: u64, at: Instant, missed: u64) -> Due {
        Due {
            tick,
            at,
            next: at + self.base(),
            missed,
            base_ns: self.base_ns,
        }
    }

    /// The clock counts on from here.
    fn end_source(&mut self, now: Instant) -> Begun {
        let patience = self.patience();
        let Some(paced) = self.source.take() else {
            return Begun::Nothing;
        };
        self.anchor = (self.next - 1, now);
        let reason = match paced.ticks.end() {
            // The task that installed the source removed it.
            Some(None) => return Begun::Nothing,
            Some(Some(reason)) => reason,
            None => format!("no tick for {} s", patience.as_secs_f64()),
        };
        Begun::SourceFailed(reason, self.hooks())
    }

    /// Whom to tell when something is wrong with all of them.
    pub(super) fn hooks(&self) -> Vec<FailureHook> {
        let hooks = self.functions.iter().map(|one| one.on_failure.clone());
        hooks.flatten().collect()
    }

    /// Takes out the code of the next function, from place `from` on, that the tick releases; with its place.
    pub(super) fn take_out(
        &mut self,
        from: usize,
        due: &Due,
        overrun: Overrun,
        now: Instant,
    ) -> Option<(usize, Box<dyn Cyclic>, Tick)> {
        let functions = self.functions.iter_mut().enumerate().skip(from);
        let mut wanted = functions.filter(|(_, function)| function.is_wanted());
        wanted.find_map(|(place, function)| {
            let tick = function.release(due, overrun, now)?;
            Some((place, function.code.take()?, tick))
        })
    }

    /// The tick is over. True when the overrun is to be reported now.
    pub(super) fn end(&mut self, due: &Due) -> bool {
        self.running = false;
        let first = due.missed > 0 && !self.stopped;
        self.stopped |= due.missed > 0;
        first
    }

    /// The functions that somebody wants.
    pub(super) fn views(&self) -> impl Iterator<Item = &FunctionView> {
        let wanted = self.functions.iter().filter(|one| one.is_wanted());
        wanted.map(|one| &one.view)
    }

    /// Adds a function whose data flow was found to be in order.
    pub(super) fn add(&mut self, function: Function) {
        self.functions.push(function);
        self.unsorted = true;
    }

    /// Moves the functions that nobody wants any more to `gone`, and sorts the others by the order that the data
    /// flow demands. Whether anything has changed.
    pub(super) fn tidy(&mut self, gone: &mut Vec<Function>) -> bool {
        let before = gone.len();
        gone.extend(self.functions.extract_if(.., |one| !one.is_wanted()));
        let changed = std::mem::take(&mut self.unsorted) || gone.len() > before;
        if !changed {
            return false;
        }
        self.functions.sort_by_key(|function| function.number);
        let views: Vec<_> = self.functions.iter().map(|one| &one.view).collect();
        // Each was checked when it was added, and what was ordered with more can be ordered with less.
        if let Ok(order) = flow::order(&views) {
            let mut all: Vec<_> = self.functions.drain(..).map(Some).collect();
            let sorted = order.into_iter();
            self.functions = sorted
                .filter_map(|place| all.get_mut(place)?.take())
                .collect();
        }
        true
    }
}
