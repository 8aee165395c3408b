//! The schedule of one processor: which functions run at which base tick, and what happens when it comes
//! too late.

use std::{
    cell::{Cell, RefCell},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use ctos_config::{Lead, Overrun};

use super::{
    CyclicError, CyclicHandle, CyclicStatistics, Directory, FunctionView, ScheduleView,
    Synchronous, TickSource, TickSourceHandle, flow,
    function::{FailureHook, Function, Releases},
    grid::{Begun, Due, Grid},
    lead::Leading,
    source,
};
use crate::contain::{contained, drop_contained};
use ctos_time::{Clock, Instant};

/// What is fixed about a schedule before it has functions.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ScheduleSettings {
    /// The processor, `chassis/processor`, for messages.
    pub processor: String,
    /// The base period; `None` = functions bring their own.
    pub period: Option<Duration>,
    /// What happens after an overrun.
    pub overrun: Overrun,
    /// How long before a tick its processor wakes up and spins.
    pub lead: Lead,
}

/// The schedule of one processor.
///
/// A processor runs its own; [`Schedule::run`] in a loop of one's own does the same.
pub struct Schedule {
    settings: ScheduleSettings,
    leading: Leading,
    clock: Clock,
    directory: Option<Arc<Directory>>,
    grids: RefCell<Vec<Grid>>,
    next_number: Cell<u64>,
    /// There is nothing to run, and nothing to look at.
    idle: Cell<bool>,
}

impl Schedule {
    /// Shows its functions in `directory`.
    pub(crate) fn shown_in(mut self, directory: Arc<Directory>) -> Self {
        self.directory = Some(directory);
        self
    }

    fn add_to(
        &self,
        grids: &mut Vec<Grid>,
        what: Synchronous,
    ) -> Result<CyclicHandle, CyclicError> {
        let mut view = what.view;
        if grids.iter().any(|grid| has(grid, &view.name)) {
            return Err(CyclicError::SameName {
                function: view.name,
            });
        }
        let (index, base, every) = self.place(grids, &view, what.period)?;
        view.every = every;
        if view.phase >= every {
            return Err(CyclicError::Phase {
                function: view.name,
                phase: view.phase,
                every,
            });
        }
        let there = grids.get(index).into_iter().flat_map(Grid::views);
        flow::order(&there.chain([&view]).collect::<Vec<_>>())?;
        if index >= grids.len() {
            grids.push(self.grid(base));
        }
        let number = self.next_number.get();
        self.next_number.set(number + 1);
        let period_ns = u64::try_from(base.as_nanos()).unwrap_or(u64::MAX);
        let period = Duration::from_nanos(period_ns.saturating_mul(every));
        let handle = CyclicHandle {
            wanted: Arc::new(AtomicBool::new(true)),
            statistics: Arc::new(CyclicStatistics::new(period)),
        };
        if let Some(grid) = grids.get_mut(index) {
            let first = grid.first_release(every, view.phase);
            grid.add(Function {
                number,
                view,
                code: Some(what.code),
                wanted: handle.wanted.clone(),
                statistics: handle.statistics.clone(),
                on_failure: what.on_failure,
                releases: Releases::new(first, every),
                last: Duration::ZERO,
            });
        }
        self.idle.set(false);
        Ok(handle)
    }

    /// Whether a function of that name is on the schedule.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.grids.borrow().iter().any(|grid| has(grid, name))
    }

    /// Whether there is nothing to run, and nothing to look at.
    #[inline]
    pub(crate) fn is_idle(&self) -> bool {
        self.idle.get()
    }

    /// A grid of base ticks. If the configuration gives the period, the grid counts from the start of
    /// the app, so that the processors of a host tick together. Else it counts from now.
    fn grid(&self, base: Duration) -> Grid {
        let now = self.clock.now();
        match self.settings.period {
            Some(_) => Grid::new(base, Instant::START, now),
            None => Grid::new(base, now, now),
        }
    }

    /// The grid for a function, or one past the last for a new one; its base; the function's period in base ticks.
    fn place(
        &self,
        grids: &[Grid],
        view: &FunctionView,
        period: Option<Duration>,
    ) -> Result<(usize, Duration, u64), CyclicError> {
        let function = view.name.clone();
        let processor = self.settings.processor.clone();
        match (period, self.settings.period) {
            (None, _) if view.every == 0 => Err(CyclicError::NoPeriod { function }),
            (Some(period), _) if period < Duration::from_micros(1) => {
                Err(CyclicError::NoPeriod { function })
            }
            (None, Some(base)) => Ok((0, base, view.every)),
            (None, None) => Err(CyclicError::NoBase {
                function,
                processor,
            }),
            // Seconds are rounded to nanoseconds, each base period by less than one.
            (Some(period), Some(base)) => match multiple(period, base, 1) {
                Some(every) => Ok((0, base, every)),
                None => Err(CyclicError::NotAMultiple {
                    function,
                    period,
                    processor,
                    base,
                    nearest: nearest(period, base),
                }),
            },
            (Some(period), None) => {
                let mut fitting = grids.iter().enumerate();
                let found = fitting.find_map(|(index, grid)| {
                    let every = multiple(period, grid.base(), 0)?;
                    Some((index, grid.base(), every))
                });
                Ok(found.unwrap_or((grids.len(), period, 1)))
            }
        }
    }

    /// Lets a device say when the base ticks are. In virtual time, where there are no devices, the
    /// clock goes on doing so.
    ///
    /// # Errors
    /// [`CyclicError::NoBase`], [`CyclicError::SameSource`], [`CyclicError::Thread`].
    pub(crate) fn pace(
        &self,
        source: impl TickSource + 'static,
        prepare: impl FnOnce() + Send + 'static,
        wake: impl Fn() + Send + 'static,
    ) -> Result<TickSourceHandle, CyclicError> {
        let processor = || self.settings.processor.clone();
        let Some(base) = self.settings.period else {
            return Err(CyclicError::NoBase {
                function: "a tick source".to_owned(),
                processor: processor(),
            });
        };
        if self.clock.origin_ns().is_none() {
            return Ok(TickSourceHandle(None));
        }
        let mut grids = self.grids.borrow_mut();
        if grids.iter().any(Grid::is_paced) {
            return Err(CyclicError::SameSource {
                processor: processor(),
            });
        }
        if grids.is_empty() {
            grids.push(self.grid(base));
        }
        let name = format!("{}/ticks", self.settings.processor);
        let started = source::start(name, source, prepare, wake, self.clock.clone());
        let ticks = started.map_err(|error| CyclicError::Thread {
            processor: processor(),
            error,
        })?;
        if let Some(grid) = grids.first_mut() {
            grid.pace(ticks.clone(), self.clock.now());
        }
        self.idle.set(false);
        Ok(TickSourceHandle(Some(ticks)))
    }

    fn tick(&self, at: usize, due: &Due, mut now: Instant) {
        let overrun = self.settings.overrun;
        let mut next = 0;
        loop {
            let mut grids = self.grids.borrow_mut();
            let grid = grids.get_mut(at);
            let out = grid.and_then(|grid| grid.take_out(next, due, overrun, now));
            // Not borrowed while it runs: it may reach the schedule.
            drop(grids);
            let Some((place, mut code, tick)) = out else {
                break;
            };
            next = place + 1;
            let ran = contained(|| code.tick(&tick));
            let ended = self.clock.now();
            let mut left = Some(code);
            let mut broken = None;
            if let Some(grid) = self.grids.borrow_mut().get_mut(at)
                && let Some(function) = grid.functions.get_mut(place)
            {
                match ran {
                    Ok(()) => {
                        function.ran(due, now, ended);
                        function.code = left.take();
                        now = ended;
                    }
                    Err(panic) => {
                        function.wanted.store(false, Ordering::Release);
                        let name = &function.view.name;
                        let text = format!("the synchronous function `{name}` panicked: {panic}");
                        broken = Some((function.on_failure.take(), text));
                    }
                }
            }
            if let Some((hook, text)) = broken {
                report(hook, &text);
            }
            drop_contained(left);
        }
        let mut grids = self.grids.borrow_mut();
        let Some(grid) = grids.get_mut(at) else {
            return;
        };
        if grid.end(due) && overrun == Overrun::Stop {
            let (text, hooks) = (self.overrun_text(grid, due), grid.hooks());
            drop(grids);
            report(hooks, &text);
        }
    }

    /// What a person is told when an overrun stops the app.
    fn overrun_text(&self, grid: &Grid, due: &Due) -> String {
        let longest = grid.functions.iter().max_by_key(|function| function.last);
        let culprit = longest.map(|function| {
            format!(
                "; of its functions `{}` took longest last time, {:.3} ms",
                function.view.name,
                function.last.as_secs_f64() * 1e3
            )
        });
        format!(
            "processor `{}` missed {} of its ticks, {} ms apart{}; its configuration says overrun = \"stop\"",
            self.settings.processor,
            due.missed,
            grid.base().as_secs_f64() * 1e3,
            culprit.unwrap_or_default()
        )
    }

    /// Forgets functions that nobody wants and grids without functions, and shows what has changed; after the tick,
    /// if one is under way.
    fn tidy(&self) {
        let mut grids = self.grids.borrow_mut();
        if grids.iter().any(|grid| grid.running) {
            return;
        }
        let (mut gone, mut changed) = (Vec::new(), false);
        for grid in grids.iter_mut() {
            changed |= grid.tidy(&mut gone);
        }
        if changed {
            grids.retain(|grid| grid.is_paced() || !grid.functions.is_empty());
            self.idle.set(grids.is_empty());
            self.show(&grids);
        }
        drop(grids);
        // Outside the borrow: their destructors may reach the schedule.
        drop_contained(gone);
    }

    fn show(&self, grids: &[Grid]) {
        let Some(directory) = &self.directory else {
            return;
        };
        let shown = grids.iter().filter(|grid| !grid.functions.is_empty());
        let shown = shown.map(|grid| {
            let all = grid.functions.iter();
            let (functions, statistics): (Vec<_>, Vec<_>) = all
                .map(|one| (one.view.clone(), one.statistics.clone()))
                .unzip();
            let view = ScheduleView {
                processor: self.settings.processor.clone(),
                period: grid.base(),
                overrun: self.settings.overrun,
                unwritten: flow::unwritten(&functions.iter().collect::<Vec<_>>()),
                functions,
            };
            (view, statistics)
        });
        directory.show(&self.settings.processor, shown.collect());
    }

    fn spins_from(&self, grid: &Grid) -> Instant {
        let due = grid.next_due();
        if grid.is_paced() {
            return due;
        }
        let lead = self.leading.before(grid.base());
        Instant::from_nanos(due.as_nanos().saturating_sub(lead.as_nanos() as u64))
    }

    /// A sleep that was to end at [`Self::wake_at`] ended at `now`: what is learned from it is how long before
    /// a tick to wake up.
    pub fn woke(&self, planned: Instant, now: Instant) {
        if now >= planned {
            self.leading.woke_late(now.since(planned));
        }
    }

    /// Spins to the next tick, if it is so near that no other work should be begun before it. True if
    /// it has.
    pub fn spin_to_tick(&self) -> bool {
        // A virtual clock stands still while somebody waits for it.
        let stands = self.clock.origin_ns().is_none();
        if self.idle.get() || self.leading.is_none() || stands {
            return false;
        }
        let now = self.clock.now();
        let next = {
            let grids = self.grids.borrow();
            let near = grids.iter().filter(|grid| self.spins_from(grid) <= now);
            near.filter_map(Grid::next_tick).min()
        };
        let Some(next) = next else {
            return false;
        };
        while self.clock.now() < next {
            std::hint::spin_loop();
        }
        true
    }

    /// Forgets everything. True when there was something.
    pub(crate) fn clear(&self) -> bool {
        let grids = std::mem::take(&mut *self.grids.borrow_mut());
        self.idle.set(true);
        self.show(&[]);
        let any = !grids.is_empty();
        drop_contained(grids);
        any
    }

    /// Without functions.
    #[must_use]
    pub fn new(settings: ScheduleSettings, clock: Clock) -> Self {
        Self {
            leading: Leading::new(settings.lead),
            settings,
            clock,
            directory: None,
            grids: RefCell::default(),
            next_number: Cell::new(0),
            idle: Cell::new(true),
        }
    }

    /// Puts a function on the schedule: it runs first at the next tick that releases it.
    ///
    /// # Errors
    /// [`CyclicError`]; the schedule is then as it was.
    pub fn add(&self, what: Synchronous) -> Result<CyclicHandle, CyclicError> {
        let added = self.add_to(&mut self.grids.borrow_mut(), what);
        self.tidy();
        added
    }

    /// Runs the functions that are released, if a base tick is due. True when one was.
    ///
    /// Allocates nothing, waits for no lock and logs nothing, unless the schedule changes or a function fails.
    pub fn run(&self) -> bool {
        if self.idle.get() {
            return false;
        }
        let mut ticked = false;
        let mut index = 0;
        loop {
            let now = self.clock.now();
            let begun = match self.grids.borrow_mut().get_mut(index) {
                Some(grid) => grid.begin(now),
                None => break,
            };
            match begun {
                Begun::Nothing => {}
                Begun::Tick(due) => {
                    ticked = true;
                    self.tick(index, &due, now);
                }
                Begun::SourceFailed(reason, hooks) => {
                    let processor = &self.settings.processor;
                    let text =
                        format!("the tick source of processor `{processor}` failed: {reason}");
                    report(hooks, &text);
                }
            }
            index += 1;
        }
        if ticked {
            self.tidy();
        }
        ticked
    }

    /// The next moment at which [`Self::run`] has something to do, as far as the clock knows.
    #[must_use]
    pub fn next_due(&self) -> Option<Instant> {
        if self.idle.get() {
            return None;
        }
        self.grids.borrow().iter().map(Grid::next_due).min()
    }

    /// The moment at which a processor that sleeps must wake up for its schedule: a little before the next
    /// tick, where it spins.
    #[must_use]
    #[inline]
    pub fn wake_at(&self) -> Option<Instant> {
        if self.idle.get() {
            return None;
        }
        let grids = self.grids.borrow();
        grids.iter().map(|grid| self.spins_from(grid)).min()
    }
}

fn has(grid: &Grid, name: &str) -> bool {
    grid.views().any(|view| view.name == name)
}

/// Calls the hooks of those who asked for that; logs it when there are none.
fn report(hooks: impl IntoIterator<Item = FailureHook>, text: &str) {
    let mut told = false;
    for hook in hooks {
        told = true;
        if let Err(panic) = contained(|| hook(text)) {
            tracing::error!(%panic, "whoever is told of a failed synchronous function panicked");
        }
    }
    if !told {
        tracing::error!("{text}");
    }
}

/// How often `base` goes into `period`, if it does but for `slack_ns` in each base period.
fn multiple(period: Duration, base: Duration, slack_ns: u128) -> Option<u64> {
    let (period, base) = (period.as_nanos(), base.as_nanos().max(1));
    let times = (period + base / 2) / base;
    let off = period.abs_diff(times * base);
    (times > 0 && off <= times * slack_ns)
        .then(|| u64::try_from(times).ok())
        .flatten()
}

/// The whole number of base periods, at least one, that is nearest to `period`.
fn nearest(period: Duration, base: Duration) -> Duration {
    let (period, base) = (period.as_nanos(), base.as_nanos().max(1));
    let times = ((period + base / 2) / base).max(1);
    Duration::from_nanos(u64::try_from(times * base).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests;
