//! Stopping one task, or the process of one chassis. A task that does not stop in time is reported, and a process
//! that does not answer is ended from outside. `sequence.rs` has the order in which an app stops.

use futures_util::future::{Either, select};

use crate::bootstrap::{BootEvent, board::Board};
use ctos_core::{
    context::TaskRef,
    phase::StopReason,
    system::{self, Exit, StopTask},
};
use ctos_message::ChassisNumber;
use ctos_message::fault::{CallError, Fault};

impl Board {
    /// Stops one task of chassis `index`, unless it has moved away.
    pub(super) async fn stop_task_of(
        &self,
        index: ChassisNumber,
        task: &TaskRef,
        reason: &StopReason,
    ) {
        if self.place_of(task) == index {
            self.order_stop(task, reason, Some(index)).await;
        }
    }

    /// Stops one task, unless its chassis is gone. Whether it has stopped in order.
    async fn order_stop(
        &self,
        task: &TaskRef,
        reason: &StopReason,
        on: Option<ChassisNumber>,
    ) -> bool {
        if !self.cx.chassis().is_linked(self.place_of(task)) {
            return false;
        }
        let request = StopTask {
            reason: reason.clone(),
            on,
        };
        let timeout = self.cx.app().stop_timeout;
        let stopped = self.cx.call(task, request).deadline(timeout).await;
        // A task that is not there was shut down before.
        let there = |error: &CallError| error.fault != Fault::UnknownTask;
        let error = stopped.err().filter(there).map(|error| error.reason());
        self.stopped(task, error)
    }

    /// Tells of a task: whether it has stopped in order.
    fn stopped(&self, task: &TaskRef, error: Option<String>) -> bool {
        let (task, stopped) = (task.name().to_owned(), error.is_none());
        self.event(&BootEvent::Stopped { task, error });
        stopped
    }

    /// Stops one task, unless its chassis is gone; a further interrupt goes on to the next task at once. Whether it has
    /// stopped in order.
    pub(super) async fn stop_task_or_skip(&self, task: &TaskRef, reason: &StopReason) -> bool {
        let interrupted = std::pin::pin!(self.interrupted());
        let stopping = std::pin::pin!(self.order_stop(task, reason, None));
        match select(stopping, interrupted).await {
            Either::Left((stopped, _)) => stopped,
            Either::Right((why, _)) => self.stopped(task, Some(why.to_owned())),
        }
    }

    /// Tells chassis `index` to end its process. One that does not answer is ended from outside.
    pub(super) async fn exit_chassis(&self, index: ChassisNumber, code: i32) {
        if self.cx.chassis().is_linked(index) {
            let agent = TaskRef::new("agent", system::agent_tid(index));
            let timeout = self.cx.app().stop_timeout;
            let _ = self.cx.call(&agent, Exit { code }).deadline(timeout).await;
        }
    }

    /// The chassis that a task is on now: it may have moved.
    pub(super) fn place_of(&self, task: &TaskRef) -> ChassisNumber {
        self.cx.chassis().directory.current(task.tid()).chassis()
    }

    pub(super) fn stops_first(&self, task: &TaskRef) -> bool {
        let config = self.cx.chassis().config_of(self.place_of(task));
        config.is_some_and(|config| config.stop_first)
    }
}
