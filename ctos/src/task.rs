//! Event handlers and what they can do: the interface that most users of CTOS see.
//!
//! An [`EventHandler`] is called with one message at a time and runs to completion; it may wait for
//! others with `.await` (the report's reply-wait), and its processor goes on with other tasks
//! meanwhile. The [`Context`] is its door to everything else: other tasks by name, time, randomness,
//! its arguments, its own children.

use std::{fmt, future::Future, pin::Pin};

use futures_util::future::LocalBoxFuture;
use serde::{Deserialize, Serialize};

use crate::message::Message;

pub use crate::context::{Call, Context, Elapsed, NameError, Send, TaskRef};

/// What a handler returns.
pub type Handled = Result<(), HandlerError>;

/// Why a handler could not do what it was asked. The caller gets the text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HandlerError {
    text: String,
}

impl HandlerError {
    /// An error that says `text`.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into() }
    }
}

impl fmt::Display for HandlerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Every error, and text, can end a handler. (For this, `HandlerError` is itself not an `Error`.)
impl<E: Into<Box<dyn std::error::Error>>> From<E> for HandlerError {
    fn from(error: E) -> Self {
        let error: Box<dyn std::error::Error> = error.into();
        Self {
            text: error.to_string(),
        }
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
}

/// [`EventHandler`] behind a pointer; implemented for every event handler.
pub(crate) trait DynHandler {
    fn handle<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled>;
    fn phase<'a>(&'a mut self, cx: &'a Context, phase: Phase) -> LocalBoxFuture<'a, Handled>;
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
}

fn boxed<'a, T>(future: impl Future<Output = T> + 'a) -> Pin<Box<dyn Future<Output = T> + 'a>> {
    Box::pin(future)
}

impl<H: EventHandler> DynHandler for H {
    fn handle<'a>(&'a mut self, cx: &'a Context, message: Message) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::handle(self, cx, message))
    }

    fn phase<'a>(&'a mut self, cx: &'a Context, phase: Phase) -> LocalBoxFuture<'a, Handled> {
        boxed(EventHandler::phase(self, cx, phase))
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
}
