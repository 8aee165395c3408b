//! The schedule of one processor: which functions run at which base tick, and what happens when it comes
//! too late.

use std::{
    cell::{Cell, RefCell},
    fmt,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use ctos_config::{Lead, Overrun};

use super::{
    CyclicError, CyclicHandle, CyclicStatistics, Directory, ScheduleView, Synchronous, TickSource,
    TickSourceHandle, flow,
    function::{FailureHook, Function, Rate, Releases},
    grid::{Begun, Due, Grid, Node},
    lead::Leading,
    source::{self, Pacemaker},
};
use crate::contain::{drop_contained, panic_text};
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
        let name = what.flow.name.clone();
        let known = |grid: &Grid| grid.nodes.iter().any(|node| node.flow.name == name);
        if grids.iter().any(known) {
            return Err(CyclicError::SameName { function: name });
        }
        let (index, base, every) = self.place(grids, &name, what.rate)?;
        if what.phase >= every {
            return Err(CyclicError::Phase {
                function: name,
                phase: what.phase,
                every,
            });
        }
        match grids.get(index) {
            Some(grid) => grid.check(&what.flow)?,
            None => flow::order(&[&what.flow]).map(|_| ())?,
        }
        if index >= grids.len() {
            grids.push(self.grid(base));
        }
        let number = self.next_number.get();
        self.next_number.set(number + 1);
        let wanted = Arc::new(AtomicBool::new(true));
        let period_ns = u64::try_from(base.as_nanos()).unwrap_or(u64::MAX);
        let period = Duration::from_nanos(period_ns.saturating_mul(every));
        let statistics = Arc::new(CyclicStatistics::new(period));
        if let Some(grid) = grids.get_mut(index) {
            let first = grid.first_release(every, what.phase);
            let node = Node {
                number,
                flow: what.flow,
                every,
                phase: what.phase,
                wanted: wanted.clone(),
            };
            let function = Function {
                number,
                rank: 0,
                function: what.function,
                wanted: wanted.clone(),
                statistics: statistics.clone(),
                on_failure: what.on_failure,
                releases: Releases::new(first, every),
                last: Duration::ZERO,
            };
            grid.add(node, function);
        }
        self.idle.set(false);
        let directory = self.directory.clone();
        Ok(CyclicHandle::new(name, wanted, statistics, directory))
    }

    /// Whether a function of that name is on the schedule.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        let grids = self.grids.borrow();
        let mut nodes = grids.iter().flat_map(|grid| &grid.nodes);
        nodes.any(|node| node.flow.name == name && node.wanted.load(Ordering::Acquire))
    }

    /// Whether there is nothing to run, and nothing to look at.
    #[inline]
    pub(crate) fn is_idle(&self) -> bool {
        self.idle.get()
    }

    /// A grid of base ticks: counted from the start of the app where the configuration gives the period,
    /// so that the processors of a host tick together; else from now.
    fn grid(&self, base: Duration) -> Grid {
        let now = self.clock.now();
        match self.settings.period {
            Some(_) => Grid::new(base, Instant::START, now),
            None => Grid::new(base, now, now),
        }
    }

    /// The grid for a rate, or one past the last for a new one; its base; the rate in base ticks.
    fn place(
        &self,
        grids: &[Grid],
        name: &str,
        rate: Rate,
    ) -> Result<(usize, Duration, u64), CyclicError> {
        let function = || name.to_owned();
        let processor = || self.settings.processor.clone();
        match (rate, self.settings.period) {
            (Rate::Ticks(0), _) => Err(CyclicError::NoPeriod {
                function: function(),
            }),
            (Rate::Period(period), _) if period < Duration::from_micros(1) => {
                Err(CyclicError::NoPeriod {
                    function: function(),
                })
            }
            (Rate::Ticks(every), Some(base)) => Ok((0, base, every)),
            (Rate::Ticks(_), None) => Err(CyclicError::NoBase {
                function: function(),
                processor: processor(),
            }),
            // Seconds are rounded to nanoseconds, each base period by less than one.
            (Rate::Period(period), Some(base)) => match multiple(period, base, 1) {
                Some(every) => Ok((0, base, every)),
                None => Err(CyclicError::NotAMultiple {
                    function: function(),
                    period,
                    processor: processor(),
                    base,
                    nearest: nearest(period, base),
                }),
            },
            (Rate::Period(period), None) => {
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
        source: Box<dyn TickSource>,
        pacemaker: Pacemaker,
    ) -> Result<TickSourceHandle, CyclicError> {
        let processor = || self.settings.processor.clone();
        let Some(base) = self.settings.period else {
            return Err(CyclicError::NoBase {
                function: "a tick source".to_owned(),
                processor: processor(),
            });
        };
        if self.clock.origin_ns().is_none() {
            return Ok(TickSourceHandle::new(None));
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
        let (ticks, _thread) =
            source::start(name, source, pacemaker, self.clock.clone()).map_err(|error| {
                CyclicError::Thread {
                    processor: processor(),
                    error,
                }
            })?;
        if let Some(grid) = grids.first_mut() {
            grid.pace(ticks.clone(), self.clock.now());
        }
        self.idle.set(false);
        Ok(TickSourceHandle::new(Some(ticks)))
    }

    fn tick(&self, grid: usize, due: &Due, mut functions: Vec<Function>, mut now: Instant) {
        let mut index = 0;
        while let Some(function) = functions.get_mut(index) {
            if !function.is_wanted() {
                drop_contained(functions.remove(index));
                continue;
            }
            let overrun = self.settings.overrun;
            let run = || function.run(due, overrun, now, &self.clock);
            match catch_unwind(AssertUnwindSafe(run)) {
                Ok(ended) => {
                    now = ended;
                    index += 1;
                }
                Err(panic) => {
                    let function = functions.remove(index);
                    let text = panic_text(panic.as_ref());
                    let name = self.name_of(grid, function.number);
                    let text = format!("the synchronous function `{name}` panicked: {text}");
                    report(function.on_failure.iter().cloned(), &text);
                    drop_contained(function);
                }
            }
        }
        let mut grids = self.grids.borrow_mut();
        let Some(grid) = grids.get_mut(grid) else {
            return;
        };
        if grid.end(functions, due) && self.settings.overrun == Overrun::Stop {
            let text = self.overrun_text(grid, due);
            let hooks = grid.functions.iter();
            let hooks: Vec<_> = hooks.filter_map(|one| one.on_failure.clone()).collect();
            drop(grids);
            report(hooks.into_iter(), &text);
        }
    }

    fn name_of(&self, grid: usize, number: u64) -> String {
        let grids = self.grids.borrow();
        let mut nodes = grids.get(grid).map_or(&[][..], |grid| &grid.nodes).iter();
        nodes
            .find(|node| node.number == number)
            .map_or_else(String::new, |node| node.flow.name.clone())
    }

    /// What a person is told when an overrun stops the app.
    fn overrun_text(&self, grid: &Grid, due: &Due) -> String {
        let longest = grid.functions.iter().max_by_key(|function| function.last);
        let culprit = longest.and_then(|function| {
            let node = grid
                .nodes
                .iter()
                .find(|node| node.number == function.number)?;
            let took_ms = function.last.as_secs_f64() * 1e3;
            Some(format!(
                "; of its functions `{}` took longest last time, {took_ms:.3} ms",
                node.flow.name
            ))
        });
        format!(
            "processor `{}` missed {} of its ticks, {} ms apart{}; its configuration says overrun = \"stop\"",
            self.settings.processor,
            due.missed,
            grid.base().as_secs_f64() * 1e3,
            culprit.unwrap_or_default()
        )
    }

    /// After a tick: forgets grids without functions, and shows what has changed.
    fn tidy(&self) {
        let changed = {
            let mut grids = self.grids.borrow_mut();
            let changed = grids.iter().any(|grid| grid.changed);
            if changed {
                grids.retain(|grid| grid.is_paced() || !grid.nodes.is_empty());
                self.idle.set(grids.is_empty());
            }
            changed
        };
        if changed {
            self.show();
        }
    }

    fn show(&self) {
        let mut grids = self.grids.borrow_mut();
        for grid in grids.iter_mut() {
            grid.changed = false;
        }
        let Some(directory) = &self.directory else {
            return;
        };
        let views = grids.iter().filter(|grid| !grid.nodes.is_empty());
        let views = views.map(|grid| {
            let flows: Vec<_> = grid.nodes.iter().map(|node| &node.flow).collect();
            ScheduleView {
                processor: self.settings.processor.clone(),
                period: grid.base(),
                overrun: self.settings.overrun,
                functions: grid.view(),
                unwritten: flow::unwritten(&flows),
            }
        });
        directory.show(&self.settings.processor, views.collect());
    }

    fn spins_from_first(&self) -> Option<Instant> {
        let grids = self.grids.borrow();
        grids.iter().map(|grid| self.spins_from(grid)).min()
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
        let any = !grids.is_empty();
        for grid in grids {
            for function in grid.functions {
                drop_contained(function);
            }
        }
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
        let mut gone = Vec::new();
        let added = {
            let mut grids = self.grids.borrow_mut();
            for grid in grids.iter_mut() {
                gone.extend(grid.purge());
            }
            self.add_to(&mut grids, what)
        };
        // Outside the borrow: their destructors may reach the schedule.
        drop_contained(gone);
        self.show();
        added
    }

    /// Runs the functions that are released, if a base tick is due. True when one was.
    ///
    /// Allocates nothing, takes no lock and logs nothing, unless the schedule changes or a function fails.
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
                Begun::Tick(due, functions) => {
                    ticked = true;
                    self.tick(index, &due, functions, now);
                }
                Begun::SourceFailed(reason, hooks) => {
                    let processor = &self.settings.processor;
                    let text =
                        format!("the tick source of processor `{processor}` failed: {reason}");
                    report(hooks.into_iter(), &text);
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
            None
        } else {
            self.spins_from_first()
        }
    }
}

impl fmt::Debug for Schedule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Schedule")
            .field("settings", &self.settings)
            .finish_non_exhaustive()
    }
}

/// Tells those who asked to be told; says it in the log when there is nobody.
fn report(hooks: impl Iterator<Item = FailureHook>, text: &str) {
    let mut told = false;
    for hook in hooks {
        told = true;
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| hook(text))) {
            let panic = panic_text(panic.as_ref());
            tracing::error!(panic = %panic, "whoever is told of a failed synchronous function panicked");
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
