//! How a call ends: with a reply or with an error that names both tasks. Always.

use std::{
    fmt,
    future::Future,
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context as PollContext, Poll, Waker},
    time::Duration,
};

use serde::{Deserialize, Serialize};

use crate::{
    chassis::{Chassis, Inbound, Outbound},
    message::Data,
};

/// Why a message did not lead to a reply, without the names of the tasks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// No task has this id (any more).
    UnknownTask,
    /// The receiver's queue is full and so is the room for senders that wait.
    Full {
        /// The capacity of the queue.
        capacity: usize,
    },
    /// Too much is under way to the receiver's chassis already: it does not read, or not fast enough.
    LinkFull {
        /// Bytes that are under way.
        bytes: usize,
    },
    /// The reply did not come in time.
    Deadline {
        /// How long the sender waited.
        after: Duration,
    },
    /// The reply did not come in time, and could not: tasks wait for one another.
    Circle {
        /// How long the sender waited.
        after: Duration,
        /// Who waits for whom.
        circle: String,
    },
    /// The chassis of the receiver is gone.
    PeerDown {
        /// Its name.
        chassis: String,
    },
    /// The receiver takes no such command.
    UnknownCommand {
        /// What it takes.
        takes: Vec<String>,
    },
    /// The data is not what the command needs.
    BadPayload {
        /// What is wrong with it.
        text: String,
    },
    /// The receiver understood and said no.
    Refused {
        /// Its reason.
        text: String,
    },
    /// The receiver ended the request without an answer.
    NoReply,
    /// The receiver's handler panicked.
    Panicked {
        /// What the panic said.
        text: String,
    },
    /// The receiver is being stopped.
    Stopping,
    /// Whether there is room cannot be seen from here: the receiver is on another chassis.
    Elsewhere {
        /// Its name.
        chassis: String,
    },
}

/// A call or a send that failed: who asked whom for what, and why it failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CallError {
    /// The asking task.
    pub from: String,
    /// The asked task.
    pub to: String,
    /// The command's name.
    pub command: String,
    /// What went wrong.
    pub fault: Fault,
}

impl CallError {
    /// The receiver's own words, when it refused; else the whole error.
    #[must_use]
    pub fn reason(&self) -> String {
        match &self.fault {
            Fault::Refused { text } => text.clone(),
            _ => self.to_string(),
        }
    }

    /// Whether the receiver, or the chassis it lives on, is gone.
    #[must_use]
    pub fn is_gone(&self) -> bool {
        matches!(
            self.fault,
            Fault::PeerDown { .. } | Fault::UnknownTask | Fault::Stopping
        )
    }
}

impl fmt::Display for CallError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            from,
            to,
            command,
            fault,
        } = self;
        match fault {
            Fault::UnknownTask => write!(
                f,
                "`{to}`, asked by `{from}` for `{command}`, is not running"
            ),
            Fault::Full { capacity } => write!(
                f,
                "the queue of `{to}` is full ({capacity} messages), so `{command}` from `{from}` was not taken; give it a larger `queue` or send less"
            ),
            Fault::LinkFull { bytes } => write!(
                f,
                "the link to the chassis of `{to}` is full ({bytes} bytes under way), so `{command}` from `{from}` was not sent; it reads too slowly or not at all: send less, or raise `app.link_room_mib`"
            ),
            Fault::Deadline { after } => write!(
                f,
                "`{to}` did not answer `{command}` from `{from}` within {:.3} s",
                after.as_secs_f64()
            ),
            Fault::Circle { after, circle } => write!(
                f,
                "`{to}` did not answer `{command}` from `{from}` within {:.3} s, because tasks wait for one another: {circle}",
                after.as_secs_f64()
            ),
            Fault::PeerDown { chassis } => write!(
                f,
                "chassis `{chassis}` is gone, and with it `{to}`, which `{from}` asked for `{command}`"
            ),
            Fault::UnknownCommand { takes } => write!(
                f,
                "`{to}` takes no `{command}` (from `{from}`); it takes: {}",
                takes.join(", ")
            ),
            Fault::BadPayload { text } => {
                write!(
                    f,
                    "`{to}` cannot read the data of `{command}` from `{from}`: {text}"
                )
            }
            Fault::Refused { text } => {
                write!(f, "`{to}` refused `{command}` from `{from}`: {text}")
            }
            Fault::NoReply => write!(
                f,
                "`{to}` ended `{command}` from `{from}` without an answer"
            ),
            Fault::Panicked { text } => write!(
                f,
                "the handler of `{to}` panicked at `{command}` from `{from}`: {text}"
            ),
            Fault::Elsewhere { chassis } => write!(
                f,
                "`{to}` is on chassis `{chassis}`, so `{from}` cannot see whether it has room for `{command}`; use `send`, which waits"
            ),
            Fault::Stopping => {
                write!(
                    f,
                    "`{to}` is being stopped and took no `{command}` from `{from}`"
                )
            }
        }
    }
}

impl std::error::Error for CallError {}

/// What comes back.
pub(crate) type Answer = Result<Data, Fault>;

/// A lock that ignores poisoning: no code that holds one of this crate's locks leaves its data
/// half changed when it panics.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[derive(Default)]
enum PromiseState {
    #[default]
    Empty,
    Waiting(Waker),
    Answered(Answer),
    Taken,
}

/// One answer on its way from any thread to the one future that waits for it.
#[derive(Default)]
pub(crate) struct Promise {
    state: Mutex<PromiseState>,
    abandoned: AtomicBool,
}

impl Promise {
    /// Whether nobody waits any more.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.abandoned.load(Ordering::Acquire)
    }

    /// Gives the answer; later ones are ignored.
    pub(crate) fn fulfil(&self, answer: Answer) {
        let mut state = lock(&self.state);
        if matches!(*state, PromiseState::Answered(_) | PromiseState::Taken) {
            return;
        }
        let before = std::mem::replace(&mut *state, PromiseState::Answered(answer));
        drop(state);
        if let PromiseState::Waiting(waker) = before {
            waker.wake();
        }
    }
}

/// The waiting end of a [`Promise`]. Dropping it tells the receiver, also behind a link, that nobody
/// waits.
pub(crate) struct Waiting {
    promise: Arc<Promise>,
    /// The call, when it went over a link.
    outbound: Option<Outbound>,
    /// The message's number in the record.
    recorded: u64,
}

impl Waiting {
    /// Waits for an answer of this chassis.
    pub(crate) fn here(promise: Arc<Promise>) -> Self {
        Self {
            promise,
            outbound: None,
            recorded: 0,
        }
    }

    /// Waits for an answer that comes over a link.
    pub(crate) fn there(promise: Arc<Promise>, outbound: Outbound) -> Self {
        Self {
            promise,
            outbound: Some(outbound),
            recorded: 0,
        }
    }

    /// The message is number `recorded` of the record.
    pub(crate) fn recorded_as(mut self, recorded: u64) -> Self {
        self.recorded = recorded;
        self
    }

    /// The message's number in the record; 0 when it is not in it.
    pub(crate) fn recorded(&self) -> u64 {
        self.recorded
    }

    /// Lets the message go its way without anybody who waits for it.
    pub(crate) fn forget(mut self) {
        if let Some(outbound) = self.outbound.take() {
            outbound.forget();
        }
    }
}

impl Future for Waiting {
    type Output = Answer;

    fn poll(self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<Answer> {
        let mut state = lock(&self.promise.state);
        match std::mem::replace(&mut *state, PromiseState::Taken) {
            PromiseState::Answered(answer) => Poll::Ready(answer),
            PromiseState::Taken => Poll::Ready(Err(Fault::NoReply)),
            PromiseState::Empty | PromiseState::Waiting(_) => {
                *state = PromiseState::Waiting(cx.waker().clone());
                Poll::Pending
            }
        }
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.promise.abandoned.store(true, Ordering::Release);
        if let Some(outbound) = self.outbound.take() {
            outbound.abandon();
        }
    }
}

/// Where an answer goes.
enum ReplyTo {
    /// To a future of this chassis.
    Local(Arc<Promise>),
    /// Over a link.
    Remote {
        chassis: Arc<Chassis>,
        request: Inbound,
    },
}

struct SlotInner {
    to: ReplyTo,
    answered: AtomicBool,
}

impl Drop for SlotInner {
    fn drop(&mut self) {
        self.answer(Err(Fault::NoReply));
    }
}

impl SlotInner {
    fn answer(&self, answer: Answer) {
        if self.answered.swap(true, Ordering::AcqRel) {
            return;
        }
        match &self.to {
            ReplyTo::Local(promise) => promise.fulfil(answer),
            ReplyTo::Remote { chassis, request } => chassis.post_reply(request, answer),
        }
    }
}

/// The right to answer one message, shared by the handler and the loop that calls it. The first
/// answer counts; when the last owner goes without one, the caller gets [`Fault::NoReply`].
#[derive(Clone)]
pub(crate) struct ReplySlot(Arc<SlotInner>);

impl ReplySlot {
    pub(crate) fn local(promise: Arc<Promise>) -> Self {
        Self::new(ReplyTo::Local(promise))
    }

    pub(crate) fn remote(chassis: Arc<Chassis>, request: Inbound) -> Self {
        Self::new(ReplyTo::Remote { chassis, request })
    }

    fn new(to: ReplyTo) -> Self {
        Self(Arc::new(SlotInner {
            to,
            answered: AtomicBool::new(false),
        }))
    }

    pub(crate) fn answer(&self, answer: Answer) {
        self.0.answer(answer);
    }

    pub(crate) fn is_abandoned(&self) -> bool {
        match &self.0.to {
            ReplyTo::Local(promise) => promise.is_abandoned(),
            ReplyTo::Remote { request, .. } => request.is_abandoned(),
        }
    }
}

impl fmt::Debug for ReplySlot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let answered = self.0.answered.load(Ordering::Relaxed);
        write!(f, "ReplySlot {{ answered: {answered} }}")
    }
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt;

    use super::*;

    #[test]
    fn the_first_answer_counts() {
        let promise = Arc::new(Promise::default());
        let slot = ReplySlot::local(promise.clone());
        slot.answer(Ok(Data::of(1_u8)));
        slot.answer(Ok(Data::of(2_u8)));
        let answer = Waiting::here(promise).now_or_never().unwrap().unwrap();
        assert_eq!(answer.take::<u8>().unwrap(), 1);
    }

    #[test]
    fn a_request_dropped_without_an_answer_still_ends_the_call() {
        let promise = Arc::new(Promise::default());
        let slot = ReplySlot::local(promise.clone());
        let kept = slot.clone();
        drop(slot);
        let mut waiting = Waiting::here(promise);
        assert!((&mut waiting).now_or_never().is_none());
        drop(kept);
        let answer = (&mut waiting).now_or_never().unwrap();
        assert_eq!(answer.unwrap_err(), Fault::NoReply);
    }

    #[test]
    fn a_caller_that_gave_up_is_seen_by_the_receiver() {
        let promise = Arc::new(Promise::default());
        let slot = ReplySlot::local(promise.clone());
        assert!(!slot.is_abandoned());
        drop(Waiting::here(promise));
        assert!(slot.is_abandoned());
    }
}
