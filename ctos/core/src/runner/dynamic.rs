//! Event handlers behind a pointer, as the loop of a task calls them.

use std::{future::Future, pin::Pin};

use futures_util::future::LocalBoxFuture;

use super::serving::{Served, Serving};
use crate::{
    context::{Context, TaskRef},
    envelope::Message,
    handled::{Handled, HandlerError},
    handler::{EventHandler, Handover},
    phase::{Phase, StopReason},
};

/// [`EventHandler`] behind a pointer; implemented for every event handler.
pub trait DynHandler {
    /// Handles `first` and the messages after it, until there is one that is not for the handler.
    fn serve<'a>(&'a mut self, serving: &'a Serving, first: Message) -> LocalBoxFuture<'a, Served>;
    fn handle<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled>;
    fn phase<'a>(&'a mut self, cx: &'a Context, phase: Phase) -> LocalBoxFuture<'a, Handled>;
    fn quiesce<'a>(
        &'a mut self,
        cx: &'a Context,
        reason: &'a StopReason,
    ) -> LocalBoxFuture<'a, Handled>;
    fn stop<'a>(
        &'a mut self,
        cx: &'a Context,
        reason: &'a StopReason,
    ) -> LocalBoxFuture<'a, Handled>;
    fn chassis_down<'a>(
        &'a mut self,
        cx: &'a Context,
        chassis: &'a str,
    ) -> LocalBoxFuture<'a, Handled>;
    fn chassis_up<'a>(
        &'a mut self,
        cx: &'a Context,
        chassis: &'a str,
    ) -> LocalBoxFuture<'a, Handled>;
    fn task_down<'a>(
        &'a mut self,
        cx: &'a Context,
        task: &'a str,
        reason: &'a str,
    ) -> LocalBoxFuture<'a, Handled>;
    fn task_up<'a>(&'a mut self, cx: &'a Context, task: &'a TaskRef)
    -> LocalBoxFuture<'a, Handled>;

    /// The state in postcard; `None` when the handler passes none on.
    fn hand_over(&mut self) -> Option<Result<Vec<u8>, HandlerError>> {
        None
    }

    /// Whether [`Self::hand_over`] may be asked after a panic.
    fn survives_panic(&self) -> bool {
        false
    }

    fn take_over(&mut self, cx: &Context, state: &[u8]) -> Handled {
        let _ = (cx, state);
        Err(HandlerError::new("the handler takes no state over"))
    }
}

fn boxed<'a, T>(future: impl Future<Output = T> + 'a) -> Pin<Box<dyn Future<Output = T> + 'a>> {
    Box::pin(future)
}

impl<H: EventHandler> DynHandler for H {
    fn serve<'a>(&'a mut self, serving: &'a Serving, first: Message) -> LocalBoxFuture<'a, Served> {
        boxed(serving.serve(self, first))
    }

    fn handle<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::handle(self, cx, message))
    }

    fn phase<'a>(&'a mut self, cx: &'a Context, phase: Phase) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::phase(self, cx, phase))
    }

    fn quiesce<'a>(
        &'a mut self,
        cx: &'a Context,
        reason: &'a StopReason,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::quiesce(self, cx, reason))
    }

    fn stop<'a>(
        &'a mut self,
        cx: &'a Context,
        reason: &'a StopReason,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::stop(self, cx, reason))
    }

    fn chassis_down<'a>(
        &'a mut self,
        cx: &'a Context,
        chassis: &'a str,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::chassis_down(self, cx, chassis))
    }

    fn chassis_up<'a>(
        &'a mut self,
        cx: &'a Context,
        chassis: &'a str,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::chassis_up(self, cx, chassis))
    }

    fn task_down<'a>(
        &'a mut self,
        cx: &'a Context,
        task: &'a str,
        reason: &'a str,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::task_down(self, cx, task, reason))
    }

    fn task_up<'a>(
        &'a mut self,
        cx: &'a Context,
        task: &'a TaskRef,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::task_up(self, cx, task))
    }
}

/// An event handler whose [`Handover`] is used.
pub(crate) struct WithHandover<H>(pub(crate) H);

impl<H: Handover> DynHandler for WithHandover<H> {
    fn serve<'a>(&'a mut self, serving: &'a Serving, first: Message) -> LocalBoxFuture<'a, Served> {
        boxed(serving.serve(&mut self.0, first))
    }

    fn handle<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::handle(&mut self.0, cx, message))
    }

    fn phase<'a>(&'a mut self, cx: &'a Context, phase: Phase) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::phase(&mut self.0, cx, phase))
    }

    fn quiesce<'a>(
        &'a mut self,
        cx: &'a Context,
        reason: &'a StopReason,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::quiesce(&mut self.0, cx, reason))
    }

    fn stop<'a>(
        &'a mut self,
        cx: &'a Context,
        reason: &'a StopReason,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::stop(&mut self.0, cx, reason))
    }

    fn chassis_down<'a>(
        &'a mut self,
        cx: &'a Context,
        chassis: &'a str,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::chassis_down(&mut self.0, cx, chassis))
    }

    fn chassis_up<'a>(
        &'a mut self,
        cx: &'a Context,
        chassis: &'a str,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::chassis_up(&mut self.0, cx, chassis))
    }

    fn task_down<'a>(
        &'a mut self,
        cx: &'a Context,
        task: &'a str,
        reason: &'a str,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::task_down(&mut self.0, cx, task, reason))
    }

    fn task_up<'a>(
        &'a mut self,
        cx: &'a Context,
        task: &'a TaskRef,
    ) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::task_up(&mut self.0, cx, task))
    }

    fn hand_over(&mut self) -> Option<Result<Vec<u8>, HandlerError>> {
        let state = Handover::hand_over(&mut self.0);
        Some(state.and_then(|state| Ok(postcard::to_stdvec(&state)?)))
    }

    fn survives_panic(&self) -> bool {
        H::AFTER_PANIC
    }

    fn take_over(&mut self, cx: &Context, state: &[u8]) -> Handled {
        match postcard::take_from_bytes::<H::State>(state) {
            Ok((state, [])) => Handover::take_over(&mut self.0, cx, state),
            Ok((_, rest)) => Err(HandlerError::new(format!(
                "its state has {} bytes too many",
                rest.len()
            ))),
            Err(error) => Err(HandlerError::new(format!(
                "its state cannot be read: {error}"
            ))),
        }
    }
}
