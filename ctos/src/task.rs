//! Event handlers and what they can do: the interface that most users of CTOS see.
//!
//! An [`EventHandler`] is called with one message at a time and runs to completion; it may wait for
//! others with `.await` (the report's reply-wait), and its processor goes on with other tasks
//! meanwhile. The [`Context`] is its door to everything else: other tasks by name, time, randomness,
//! its arguments, its own children.

use std::{fmt, future::Future, pin::Pin};

use futures_util::future::LocalBoxFuture;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    message::Message,
    runner::{Served, Serving},
};

pub use crate::{
    children::StartError,
    context::{Call, Calling, Context, Elapsed, Find, NameError, Send, Sending, TaskRef},
};

/// What a handler returns.
pub type Handled = Result<(), HandlerError>;

/// Why a handler could not do what it was asked. The caller gets the text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HandlerError {
    /// A pointer, so that what a handler returns costs nothing to pass on.
    said: Box<Said>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Said {
    text: String,
}

impl HandlerError {
    /// An error that says `text`.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        let said = Said { text: text.into() };
        Self {
            said: Box::new(said),
        }
    }
}

impl fmt::Display for HandlerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.said.text)
    }
}

/// Every error, and text, can end a handler. (For this, `HandlerError` is itself not an `Error`.)
impl<E: Into<Box<dyn std::error::Error>>> From<E> for HandlerError {
    fn from(error: E) -> Self {
        let error: Box<dyn std::error::Error> = error.into();
        Self::new(error.to_string())
    }
}

/// The three startup phases. Each is acknowledged by every task before the next begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Phase {
    /// The task exists and has read its arguments. Other tasks may not exist yet.
    Create,
    /// All tasks exist: find the others by name, open what is needed.
    Connect,
    /// Everybody is connected: begin.
    Run,
}

impl Phase {
    /// All phases, in order.
    pub const ALL: [Self; 3] = [Self::Create, Self::Connect, Self::Run];
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Create => "create",
            Self::Connect => "connect",
            Self::Run => "run",
        })
    }
}

/// Why tasks are told to stop.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum StopReason {
    /// The app has its result.
    Finished,
    /// The person asked for it.
    Interrupted,
    /// This task alone was told to end; the app goes on.
    Shutdown,
    /// A chassis is gone.
    ChassisDown {
        /// Its name.
        chassis: String,
    },
    /// A task failed for good, or a startup phase did.
    Failed {
        /// Who and why.
        what: String,
    },
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Finished => f.write_str("the app has finished"),
            Self::Interrupted => f.write_str("the app was interrupted"),
            Self::Shutdown => f.write_str("the task was told to shut down"),
            Self::ChassisDown { chassis } => write!(f, "chassis `{chassis}` is gone"),
            Self::Failed { what } => f.write_str(what),
        }
    }
}

/// A type that handles messages. One value of it, with its queue, is a task.
///
/// ```
/// use ctos::{message::{Command, Message}, task::{Context, EventHandler, Handled}};
///
/// ctos::command! {
///     /// Counts, and tells how often it has.
///     pub struct Count => u64, 0x0001, "count"
/// }
///
/// struct Counter(u64);
///
/// impl EventHandler for Counter {
///     async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
///         match message.command() {
///             Count::CODE => {
///                 let (Count {}, reply) = message.open::<Count>()?;
///                 self.0 += 1;
///                 reply.ok(self.0)
///             }
///             _ => cx.default_processing(message),
///         }
///     }
/// }
/// ```
pub trait EventHandler: 'static {
    /// Handles one message to its end. An `Err` is the answer to a caller that waits.
    fn handle(&mut self, cx: &Context, message: Message) -> impl Future<Output = Handled>;

    /// Enters a startup phase; returning `Ok` acknowledges it, an `Err` undoes the boot.
    fn phase(&mut self, cx: &Context, phase: Phase) -> impl Future<Output = Handled> {
        let _ = (cx, phase);
        async { Ok(()) }
    }

    /// The app is about to be stopped: begins to come to rest, while every task still takes messages.
    /// Returning `Ok` acknowledges that it is at rest. No message is handled until this returns, so what
    /// takes longer than a moment goes on beside it: [`Context::quiet_after`].
    fn quiesce(&mut self, cx: &Context, reason: &StopReason) -> impl Future<Output = Handled> {
        let _ = (cx, reason);
        async { Ok(()) }
    }

    /// Comes to an orderly stop. Hardware is at rest when this returns.
    fn stop(&mut self, cx: &Context, reason: &StopReason) -> impl Future<Output = Handled> {
        let _ = (cx, reason);
        async { Ok(()) }
    }

    /// Another chassis of the app is gone, with all its tasks.
    fn chassis_down(&mut self, cx: &Context, chassis: &str) -> impl Future<Output = Handled> {
        let _ = (cx, chassis);
        async { Ok(()) }
    }

    /// Another chassis that was gone is back, and its tasks have passed all phases. Its names lead to
    /// its new tasks.
    fn chassis_up(&mut self, cx: &Context, chassis: &str) -> impl Future<Output = Handled> {
        let _ = (cx, chassis);
        async { Ok(()) }
    }

    /// A task that this one [monitors](Context::monitor) takes no messages: it is being restarted, has
    /// ended, has failed, or its chassis is gone.
    fn task_down(
        &mut self,
        cx: &Context,
        task: &str,
        reason: &str,
    ) -> impl Future<Output = Handled> {
        let _ = (cx, task, reason);
        async { Ok(()) }
    }

    /// A task that this one [monitors](Context::monitor) and that was down takes messages again.
    fn task_up(&mut self, cx: &Context, task: &TaskRef) -> impl Future<Output = Handled> {
        let _ = (cx, task);
        async { Ok(()) }
    }
}

/// An event handler that can pass on what it knows: to its next incarnation when it is restarted, and
/// to another processor, process or host when its task is moved. Registered with
/// [`Registry::handover`](crate::registry::Registry::handover).
///
/// What belongs to the place (children, synchronous functions, files) is not passed on: it ends with the
/// old handler and is begun again by [`take_over`](Self::take_over) or the startup phases, which the new
/// handler enters afterwards, in order.
pub trait Handover: EventHandler {
    /// What is passed on.
    type State: Serialize + DeserializeOwned;

    /// Whether the state is good also after a panic of this handler. If not, the next incarnation begins
    /// afresh.
    const AFTER_PANIC: bool = false;

    /// Gives the state away. Called between two messages; nothing is called afterwards. Repliers that it
    /// still holds end without an answer.
    ///
    /// # Errors
    /// Why that cannot be now; the task then stays where it is and goes on.
    fn hand_over(&mut self) -> Result<Self::State, HandlerError>;

    /// Takes the state of the handler before this one, before the first startup phase.
    ///
    /// # Errors
    /// Why the state cannot be used.
    fn take_over(&mut self, cx: &Context, state: Self::State) -> Handled;
}

/// [`EventHandler`] behind a pointer; implemented for every event handler.
pub(crate) trait DynHandler {
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
