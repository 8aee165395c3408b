//! The base ticks of a schedule, counted by the clock or by a device, and the functions that run at them.

use std::{
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

use super::{
    CyclicError, FunctionView,
    flow::{self, Flow},
    function::{FailureHook, Function},
    source::Ticks,
};
use ctos_time::Instant;

/// A device that paces a schedule and gives no tick for so long has failed.
const SILENCE: Duration = Duration::from_secs(1);

/// What is said of a function: stays here while the function itself is out, running.
pub(super) struct Node {
    pub(super) number: u64,
    pub(super) flow: Flow,
    pub(super) every: u64,
    pub(super) phase: u64,
    pub(super) wanted: Arc<AtomicBool>,
}

/// Base ticks, and who runs at them.
pub(super) struct Grid {
    base_ns: u64,
    /// A tick and its moment, from which the clock counts the others.
    anchor: (u64, Instant),
    /// The next tick.
    next: u64,
    source: Option<Paced>,
    /// In the order in which they were added.
    pub(super) nodes: Vec<Node>,
    /// In running order; empty while they run.
    pub(super) functions: Vec<Function>,
    running: bool,
    /// Somebody was added while the others ran, or is to be forgotten.
    unsorted: bool,
    /// It is not shown as it is.
    pub(super) changed: bool,
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
    Tick(Due, Vec<Function>),
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
            nodes: Vec::new(),
            functions: Vec::new(),
            running: false,
            unsorted: false,
            changed: false,
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

    /// Takes the functions out if a tick is due.
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
                Begun::Tick(due, std::mem::take(&mut self.functions))
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
            // Whoever had it there took it away.
            Some(None) => return Begun::Nothing,
            Some(Some(reason)) => reason,
            None => format!("no tick for {} s", patience.as_secs_f64()),
        };
        let hooks = self
            .functions
            .iter()
            .filter_map(|one| one.on_failure.clone());
        Begun::SourceFailed(reason, hooks.collect())
    }

    /// Puts the functions back after their tick. True when the overrun is to be reported now.
    pub(super) fn end(&mut self, mut functions: Vec<Function>, due: &Due) -> bool {
        self.running = false;
        functions.append(&mut self.functions);
        self.functions = functions;
        if self.unsorted || self.nodes.len() != self.functions.len() {
            self.sort();
        }
        let first = due.missed > 0 && !self.stopped;
        self.stopped |= due.missed > 0;
        first
    }

    /// Forgets the functions that nobody wants any more; they are returned, to be dropped elsewhere.
    pub(super) fn purge(&mut self) -> Vec<Function> {
        let gone = |wanted: &Arc<AtomicBool>| !wanted.load(std::sync::atomic::Ordering::Acquire);
        let before = self.nodes.len();
        self.nodes.retain(|node| !gone(&node.wanted));
        self.changed |= self.nodes.len() != before;
        self.functions
            .extract_if(.., |function| gone(&function.wanted))
            .collect()
    }

    /// Sorts the functions by the order that the data flow demands.
    fn sort(&mut self) {
        self.unsorted = false;
        self.changed = true;
        self.nodes
            .retain(|node| self.functions.iter().any(|one| one.number == node.number));
        let flows: Vec<&Flow> = self.nodes.iter().map(|node| &node.flow).collect();
        // What was ordered with more functions can be ordered with less, so there is no error.
        let order = flow::order(&flows).unwrap_or_default();
        for (rank, place) in order.into_iter().enumerate() {
            let number = self.nodes.get(place).map(|node| node.number);
            let mut functions = self.functions.iter_mut();
            if let Some(function) = functions.find(|one| Some(one.number) == number) {
                function.rank = rank;
            }
        }
        self.functions.sort_by_key(|function| function.rank);
    }

    /// Adds a function whose data flow was found to be in order.
    pub(super) fn add(&mut self, node: Node, function: Function) {
        self.nodes.push(node);
        self.functions.push(function);
        if self.running {
            self.unsorted = true;
        } else {
            self.sort();
        }
    }

    /// The functions in running order, as others see them.
    pub(super) fn view(&self) -> Vec<FunctionView> {
        let flows: Vec<&Flow> = self.nodes.iter().map(|node| &node.flow).collect();
        let order = flow::order(&flows).unwrap_or_default();
        let nodes = order.into_iter().filter_map(|place| self.nodes.get(place));
        nodes
            .map(|node| FunctionView {
                name: node.flow.name.clone(),
                every: node.every,
                phase: node.phase,
                reads: node.flow.reads.clone(),
                reads_previous: node.flow.reads_previous.clone(),
                writes: node.flow.writes.clone(),
            })
            .collect()
    }

    /// What becomes of the data flow when `flow` is added.
    ///
    /// # Errors
    /// As [`flow::order`].
    pub(super) fn check(&self, flow: &Flow) -> Result<(), CyclicError> {
        let flows: Vec<&Flow> = self
            .nodes
            .iter()
            .map(|node| &node.flow)
            .chain([flow])
            .collect();
        flow::order(&flows).map(|_| ())
    }
}
