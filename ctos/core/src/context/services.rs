//! The services of the runtime that a task reaches: synchronous functions, the record, and the person who
//! booted the app. (Semaphores and barriers are in [`crate::semaphore`].)

use std::{sync::Arc, time::Duration};

use super::core::Context;
use crate::{
    realtime::{self, Grant},
    sync::{Cyclic, CyclicError, CyclicHandle, Synchronous, TickSource, TickSourceHandle},
    system::{self, AppResult},
    tap::ChannelSchema,
};

impl Context {
    // -- synchronous functions --------------------------------------------------------------

    /// Calls a synchronous function every `period` on this task's processor, until the handle is dropped. If it
    /// panics, it is taken off the schedule and the task's restart policy decides. It has failed if the processor has
    /// a base period of which `period` is not a multiple. [`Self::schedule`] says more of a function, and refuses
    /// instead.
    #[must_use]
    pub fn cyclic(&self, period: Duration, function: impl Cyclic + 'static) -> CyclicHandle {
        let schedule = &self.inner.processor.schedule;
        let free = |name: &String| !schedule.has(&format!("{}.{name}", self.name()));
        let numbered = (2_u32..).map(|number| format!("cyclic-{number}"));
        let mut names = std::iter::once("cyclic".to_owned()).chain(numbered);
        let name = names.find(free).unwrap_or_default();
        let period = period.max(Duration::from_micros(1));
        let function = Synchronous::new(name, function).period(period);
        self.schedule(function).unwrap_or_else(|error| {
            self.fail(&error.to_string());
            CyclicHandle::default()
        })
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
        let prepare = move || {
            let config = chassis.processor_config(usize::from(index));
            // Memory was locked for the whole chassis; a refusal was reported for the processor.
            let _ = realtime::prepare_thread(chassis.name(), config, &Grant::NotAsked);
        };
        let schedule = &self.inner.processor.schedule;
        schedule.pace(source, prepare, move || handle.unpark())
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
            chassis: self.inner.chassis.index(),
            reason: reason.to_owned(),
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, failed);
    }

    // -- the record ---------------------------------------------------------------------------

    /// Puts `value` on a channel of the record, if the app is recorded: `/firing/carry`, say. It is
    /// shown there as JSON, with the present moment.
    pub fn record<T: serde::Serialize + ?Sized>(&self, channel: &str, value: &T) {
        if let Some(recorder) = self.inner.chassis.tap.recorder() {
            let write = |buffer: &mut Vec<u8>| serde_json::to_writer(buffer, value).is_ok();
            recorder.value(self.tid(), channel, &write);
        }
    }

    /// [`Self::record`] of what is encoded already. All that stands on `channel` is written as `schema` says, so that
    /// programs which know the schema read it from the record.
    pub fn record_encoded(&self, channel: &str, schema: &Arc<ChannelSchema>, bytes: &[u8]) {
        if let Some(recorder) = self.inner.chassis.tap.recorder() {
            recorder.encoded(self.tid(), channel, schema, bytes);
        }
    }

    /// Whether the app is recorded: for values that are expensive to make.
    #[must_use]
    pub fn is_recording(&self) -> bool {
        self.inner.chassis.tap.recorder().is_some()
    }

    /// Puts a synchronous function on the schedule of this task's processor until the handle is dropped.
    /// It shares that schedule with the functions of the other tasks there. Its name becomes
    /// `task.function`. If it panics, it is taken off the schedule, and the task's restart policy decides.
    ///
    /// # Errors
    /// [`CyclicError`]: data that flows in a circle, a period that does not fit, a name that is taken.
    pub fn schedule(&self, function: Synchronous) -> Result<CyclicHandle, CyclicError> {
        self.reads_unrecorded("a synchronous function");
        let name = format!("{}.{}", self.name(), function.name());
        let function = function.renamed(name).on_failure(self.when_broken());
        self.inner.processor.schedule.add(function)
    }

    /// Ends the app with a result, if `until` of the configuration names this task.
    pub fn finish(&self, result: AppResult) {
        let finish = system::Finish {
            task: self.name().to_owned(),
            result,
        };
        self.inner.chassis.post_system(system::BOOTSTRAP, finish);
    }

    /// How many recorders have come to this chassis so far, those that are gone included. By that, a
    /// task that records only changes sees that a newcomer lacks the whole.
    #[must_use]
    pub fn recorders(&self) -> u64 {
        self.inner.chassis.tap.came()
    }
}
