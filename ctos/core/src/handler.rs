//! Event handlers and what they can do: the interface that most users of CTOS see.
//!
//! An [`EventHandler`] is called with one message at a time and runs to completion. It may wait for
//! others with `.await` (the report's reply-wait); its processor runs other tasks meanwhile. The
//! [`Context`] is its door to everything else: other tasks by name, time, randomness, its arguments,
//! its own children.

use serde::{Serialize, de::DeserializeOwned};

use crate::{
    context::{Context, TaskRef},
    envelope::Message,
    handled::{Handled, HandlerError},
    phase::{Phase, StopReason},
};

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
#[expect(
    async_fn_in_trait,
    unused_variables,
    reason = "handlers stay on their processor; most need few of the notices"
)]
pub trait EventHandler: 'static {
    /// Handles one message to its end. An `Err` is the answer to a caller that waits.
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled;

    /// Enters a startup phase; returning `Ok` acknowledges it, an `Err` undoes the boot.
    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        Ok(())
    }

    /// The app is about to be stopped: begins to come to rest, while every task still takes messages.
    /// Returning `Ok` acknowledges that it is at rest. No message is handled until this returns, so what
    /// takes longer than a moment runs concurrently: [`Context::quiet_after`].
    async fn quiesce(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        Ok(())
    }

    /// Comes to an orderly stop. Hardware is at rest when this returns.
    async fn stop(&mut self, cx: &Context, reason: &StopReason) -> Handled {
        Ok(())
    }

    /// Another chassis of the app is gone, with all its tasks.
    async fn chassis_down(&mut self, cx: &Context, chassis: &str) -> Handled {
        Ok(())
    }

    /// Another chassis that was gone is back, and its tasks have passed all phases. Its names lead to
    /// its new tasks.
    async fn chassis_up(&mut self, cx: &Context, chassis: &str) -> Handled {
        Ok(())
    }

    /// A task that this one [monitors](Context::monitor) takes no messages: it is being restarted, has
    /// ended, has failed, or its chassis is gone.
    async fn task_down(&mut self, cx: &Context, task: &str, reason: &str) -> Handled {
        Ok(())
    }

    /// A task that this one [monitors](Context::monitor) and that was down takes messages again.
    async fn task_up(&mut self, cx: &Context, task: &TaskRef) -> Handled {
        Ok(())
    }
}

/// An event handler that can pass on its state: to its next incarnation after a restart. When its
/// task is moved, it passes the state to another processor, process or host. Registered with
/// [`Registry::handover`](crate::registry::Registry::handover).
///
/// What belongs to the place (children, synchronous functions, files) is not passed on: it ends with the
/// old handler. [`take_over`](Self::take_over) begins it again, or the startup phases, which the new
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

/// An event handler whose state can survive its process. Registered with
/// [`Registry::durable`](crate::registry::Registry::durable); the tasks whose configuration says `state = "durable"`
/// make use of it.
///
/// When the handling of a message has ended and the state is another one, it is stored. The answers that the handler
/// gave leave after that, so nobody has seen what a kill can take back. What it sends or asks before its end leaves
/// at once: [`Context::keep`] stores the state before that. A handler that panics has stored nothing; the next one
/// takes over what was stored last, in the same process or another.
pub trait Durable: Handover {
    /// The state at this moment, between two messages.
    fn state(&self) -> Self::State;
}
