//! Event handlers behind a pointer, as the loop of a task calls them.

use futures_util::future::LocalBoxFuture;

use super::serving::{Served, Serving};
use crate::{
    context::{Context, TaskRef},
    envelope::Message,
    handled::{Handled, HandlerError},
    handler::{Durable, EventHandler, Handover},
    phase::{Phase, StopReason},
};

/// What the runtime tells a handler; each goes to the method of [`EventHandler`] of that name.
pub enum Notice<'a> {
    Phase(Phase),
    Quiesce(&'a StopReason),
    Stop(&'a StopReason),
    ChassisDown(&'a str),
    ChassisUp(&'a str),
    TaskDown(&'a str, &'a str),
    TaskUp(&'a TaskRef),
}

/// An event handler behind a pointer.
pub trait DynHandler {
    /// Handles `first` and the messages after it, until there is one that is not for the handler.
    fn serve<'a>(&'a mut self, serving: &'a Serving, first: Message) -> LocalBoxFuture<'a, Served>;
    fn handle<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled>;
    fn tell<'a>(&'a mut self, cx: &'a Context, notice: Notice<'a>) -> LocalBoxFuture<'a, Handled>;
    /// The state in postcard; `None` when the handler passes none on.
    fn hand_over(&mut self) -> Option<Result<Vec<u8>, HandlerError>>;
    /// Whether [`Self::hand_over`] may be asked after a panic.
    fn survives_panic(&self) -> bool;
    fn take_over(&mut self, cx: &Context, state: &[u8]) -> Handled;
    /// The state to store, in postcard.
    fn state(&self) -> Result<Vec<u8>, HandlerError>;
}

/// An event handler, with what passes its state on, if it does so.
struct Erased<H: 'static> {
    handler: H,
    passing: Option<&'static Passing<H>>,
}

/// A state in postcard.
type State = Result<Vec<u8>, HandlerError>;

/// How the state of a handler is passed on.
struct Passing<H> {
    after_panic: bool,
    give: fn(&mut H) -> State,
    take: fn(&mut H, &Context, &[u8]) -> Handled,
    /// Of a durable handler.
    state: Option<fn(&H) -> State>,
}

impl<H: Handover> Erased<H> {
    const PASSING: Passing<H> = Passing {
        after_panic: H::AFTER_PANIC,
        give: |handler| Ok(postcard::to_stdvec(&handler.hand_over()?)?),
        take: |handler, cx, state| match postcard::take_from_bytes::<H::State>(state) {
            Ok((state, [])) => handler.take_over(cx, state),
            Ok((_, rest)) => {
                let why = format!("its state has {} bytes too many", rest.len());
                Err(HandlerError::new(why))
            }
            Err(error) => {
                let why = format!("its state cannot be read: {error}");
                Err(HandlerError::new(why))
            }
        },
        state: None,
    };
}

impl<H: Durable> Erased<H> {
    const DURABLE: Passing<H> = Passing {
        state: Some(|handler| Ok(postcard::to_stdvec(&handler.state())?)),
        ..Self::PASSING
    };
}

/// A handler that passes nothing on.
pub fn plain<H: EventHandler>(handler: H) -> Box<dyn DynHandler> {
    let passing = None;
    Box::new(Erased { handler, passing })
}

/// A handler whose [`Handover`] is used.
pub fn passing<H: Handover>(handler: H) -> Box<dyn DynHandler> {
    let passing = Some(&Erased::<H>::PASSING);
    Box::new(Erased { handler, passing })
}

/// A handler whose [`Durable`] is used.
pub fn durable<H: Durable>(handler: H) -> Box<dyn DynHandler> {
    let passing = Some(&Erased::<H>::DURABLE);
    Box::new(Erased { handler, passing })
}

impl<H: EventHandler> DynHandler for Erased<H> {
    fn serve<'a>(&'a mut self, serving: &'a Serving, first: Message) -> LocalBoxFuture<'a, Served> {
        Box::pin(serving.serve(&mut self.handler, first))
    }

    fn handle<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled> {
        Box::pin(self.handler.handle(cx, message))
    }

    fn tell<'a>(&'a mut self, cx: &'a Context, notice: Notice<'a>) -> LocalBoxFuture<'a, Handled> {
        let handler = &mut self.handler;
        match notice {
            Notice::Phase(phase) => Box::pin(handler.phase(cx, phase)),
            Notice::Quiesce(reason) => Box::pin(handler.quiesce(cx, reason)),
            Notice::Stop(reason) => Box::pin(handler.stop(cx, reason)),
            Notice::ChassisDown(chassis) => Box::pin(handler.chassis_down(cx, chassis)),
            Notice::ChassisUp(chassis) => Box::pin(handler.chassis_up(cx, chassis)),
            Notice::TaskDown(task, reason) => Box::pin(handler.task_down(cx, task, reason)),
            Notice::TaskUp(task) => Box::pin(handler.task_up(cx, task)),
        }
    }

    fn hand_over(&mut self) -> Option<Result<Vec<u8>, HandlerError>> {
        self.passing
            .map(|passing| (passing.give)(&mut self.handler))
    }

    fn survives_panic(&self) -> bool {
        self.passing.is_some_and(|passing| passing.after_panic)
    }

    fn take_over(&mut self, cx: &Context, state: &[u8]) -> Handled {
        match self.passing {
            Some(passing) => (passing.take)(&mut self.handler, cx, state),
            None => Err(HandlerError::new("the handler takes no state over")),
        }
    }

    fn state(&self) -> Result<Vec<u8>, HandlerError> {
        let state = self.passing.and_then(|passing| passing.state);
        state.ok_or("its handler has no state that can be stored")?(&self.handler)
    }
}
