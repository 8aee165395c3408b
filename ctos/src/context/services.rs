//! The services of the runtime that a task reaches: synchronous functions, semaphores, and the person who
//! booted the app.

use std::time::Duration;

use super::Context;
use crate::{
    call::CallError,
    realtime::{self, Grant},
    semaphore::{self, Barrier, Scope, Semaphore, SemaphoreError, SemaphoreView},
    sync::{
        Cyclic, CyclicError, CyclicHandle, Pacemaker, Synchronous, TickSource, TickSourceHandle,
    },
    system::{self, AppResult},
};

impl Context {
    // -- synchronous functions --------------------------------------------------------------

    /// Calls a synchronous function every `period` on this task's processor, until the handle is
    /// dropped. If it panics, it is taken off the schedule and the task's restart policy decides; it has failed if the
    /// processor has a base period that `period` is no multiple of. [`Self::schedule`] says more of a
    /// function, and refuses instead.
    #[must_use]
    pub fn cyclic(&self, period: Duration, function: impl Cyclic + 'static) -> CyclicHandle {
        let tap = &self.inner.chassis.tap;
        tap.used(|| "a synchronous function".to_owned());
        let schedule = &self.inner.processor.schedule;
        let free = |name: &String| !schedule.has(&format!("{}.{name}", self.name()));
        let numbered = (2_u32..).map(|number| format!("cyclic-{number}"));
        let mut names = std::iter::once("cyclic".to_owned()).chain(numbered);
        let name = names.find(free).unwrap_or_default();
        let period = period.max(Duration::from_micros(1));
        let function = Synchronous::new(name, function).period(period);
        self.schedule(function).unwrap_or_else(|error| {
            self.fail(&error.to_string());
            CyclicHandle::of_nothing()
        })
    }

    /// Puts a synchronous function on the schedule of this task's processor, which it shares with those of
    /// the other tasks there, until the handle is dropped. Its name becomes `task.function`. If it panics,
    /// it is taken off the schedule, and the task's restart policy decides.
    ///
    /// # Errors
    /// [`CyclicError`]: data that flows in a circle, a period that does not fit, a name that is taken.
    pub fn schedule(&self, function: Synchronous) -> Result<CyclicHandle, CyclicError> {
        let name = format!("{}.{}", self.name(), function.name());
        let function = function.renamed(name).on_failure(self.when_broken());
        self.inner.processor.schedule.add(function)
    }

    /// Lets a device say when the base ticks of this task's processor are, until the handle is dropped. The
    /// processor needs a `period_s`, at which the clock goes on when the device fails. In virtual time
    /// there is no device, and the clock goes on ticking.
    ///
    /// # Errors
    /// [`CyclicError`]: the processor has no base period, or another source already.
    pub fn tick_source(
        &self,
        source: impl TickSource + 'static,
    ) -> Result<TickSourceHandle, CyclicError> {
        let (chassis, index) = (
            self.inner.chassis.clone(),
            self.inner.record.tid.processor(),
        );
        let handle = self.inner.processor.handle.clone();
        let pacemaker = Pacemaker {
            prepare: Box::new(move || {
                let config = chassis.processor_config(usize::from(index));
                // Memory was locked for the whole chassis; a refusal was said for the processor.
                let _ = realtime::prepare_thread(chassis.name(), config, &Grant::NotAsked);
            }),
            wake: Box::new(move || handle.unpark()),
        };
        let schedule = &self.inner.processor.schedule;
        schedule.pace(Box::new(source), pacemaker)
    }

    // -- what tasks take turns with ---------------------------------------------------------

    /// The counting semaphore called `name`, with `permits` unless `[semaphore.NAME]` of the configuration
    /// says how many. It is shared by the tasks of this chassis; by those of the whole app, if the
    /// configuration says so or its name begins with `app/`.
    ///
    /// # Errors
    /// [`SemaphoreError`]: no permits at all, or another number than others use.
    pub fn semaphore(&self, name: &str, permits: u32) -> Result<Semaphore, SemaphoreError> {
        Semaphore::find(self, name, permits)
    }

    /// The barrier called `name`, for `parties` unless `[barrier.NAME]` of the configuration says for how many.
    /// Shared as [`Self::semaphore`] says.
    ///
    /// # Errors
    /// [`SemaphoreError`]: nobody to wait for, or another number than others use.
    pub fn barrier(&self, name: &str, parties: u32) -> Result<Barrier, SemaphoreError> {
        Barrier::find(self, name, parties)
    }

    /// The semaphores that this task could use, who holds them and who waits: those of this chassis and
    /// those of the app.
    ///
    /// # Errors
    /// When the task that keeps those of the app cannot be asked.
    pub async fn semaphores(&self) -> Result<Vec<SemaphoreView>, CallError> {
        let mut views = semaphore::of_app(self).await?;
        let here = self.chassis().semaphores().into_iter();
        views.extend(here.filter(|view| view.scope == Scope::Chassis));
        Ok(views)
    }

    // -- the person who booted the app ------------------------------------------------------

    /// Shows how far the task is: `done` of `total` steps, each of which is a `step` ("position"), and
    /// what happened at this one.
    pub fn progress(&self, done: u64, total: u64, step: &str, what: &str) {
        let progress = system::Progress {
            task: self.name().to_owned(),
            done,
            total,
            step: step.to_owned(),
            what: what.to_owned(),
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, progress);
    }

    /// Ends the app with a result, if `until` of the configuration names this task.
    pub fn finish(&self, result: AppResult) {
        let finish = system::Finish {
            task: self.name().to_owned(),
            result,
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, finish);
    }

    /// Ends the app because this task stands at a breakpoint that was set for that.
    pub fn end_at_breakpoint(&self, reason: &str) {
        let at = system::AtBreakpoint {
            task: self.name().to_owned(),
            reason: reason.to_owned(),
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, at);
    }

    /// Reports that this task failed for good; the app is stopped.
    pub fn fail(&self, reason: &str) {
        tracing::error!(task = %self.name(), reason, "task failed");
        let failed = system::TaskFailed {
            task: self.name().to_owned(),
            reason: reason.to_owned(),
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, failed);
    }
}
