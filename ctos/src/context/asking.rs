//! Calls and sends: futures that wait at the processor of their task, and take back what they asked when
//! they are dropped.

use std::{
    future::{Future, IntoFuture},
    pin::Pin,
    task::{Context as PollContext, Poll},
    time::Duration,
};

use futures_util::future::LocalBoxFuture;

use super::{Context, TaskRef};
use crate::{
    call::{CallError, Fault},
    chassis::{Envelope, Question, Sent},
    circle,
    exchange::Looked,
    message::{Command, Data, Flags},
    time::Instant,
};

/// A call that has not been made yet; `.await` makes it.
#[must_use = "a call is made when it is awaited"]
pub struct Call<C: Command> {
    pub(super) cx: Context,
    pub(super) to: TaskRef,
    pub(super) request: C,
    pub(super) deadline: Duration,
    pub(super) flags: Flags,
}

impl<C: Command> Call<C> {
    /// Waits at most this long for the reply.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        self.flags = self.flags.with(Flags::HIGH_PRIORITY);
        self
    }
}

impl<C: Command> IntoFuture for Call<C> {
    type Output = Result<C::Reply, CallError>;
    type IntoFuture = Calling<C>;

    fn into_future(self) -> Calling<C> {
        Calling(CallState::New(self))
    }
}

/// A call under way. Dropped before its end, it tells the receiver that nobody waits.
#[must_use = "a call is made when it is awaited"]
pub struct Calling<C: Command>(CallState<C>);

enum CallState<C: Command> {
    New(Call<C>),
    Asked(Ask),
    Ended,
}

impl<C: Command> CallState<C> {
    /// The call, if it has not been made yet.
    fn take_new(&mut self) -> Option<Call<C>> {
        if !matches!(self, Self::New(_)) {
            return None;
        }
        match std::mem::replace(self, Self::Ended) {
            Self::New(call) => Some(call),
            Self::Asked(_) | Self::Ended => None,
        }
    }

    /// Looks for the end of a call that has been made; `open` makes what was waited for of the answer.
    fn poll<T>(
        &mut self,
        poll: &mut PollContext<'_>,
        open: impl FnOnce(Data) -> Result<T, Fault>,
    ) -> Poll<Result<T, CallError>> {
        let Self::Asked(ask) = self else {
            // Polled after its end, which is the fault of whoever polls.
            return Poll::Pending;
        };
        let answer = std::task::ready!(ask.poll(poll));
        let result = answer.and_then(open);
        let result = result.map_err(|fault| ask.error(C::NAME, fault));
        *self = Self::Ended;
        Poll::Ready(result)
    }
}

impl<C: Command> Unpin for Calling<C> {}

impl<C: Command> Future for Calling<C> {
    type Output = Result<C::Reply, CallError>;

    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        let Self(state) = self.get_mut();
        if let Some(call) = state.take_new() {
            let data = Data::of(call.request);
            let envelope = call.cx.envelope(&call.to, C::CODE, call.flags, data);
            let ask = Ask::call(call.cx, call.to, C::NAME, envelope, call.deadline);
            *state = CallState::Asked(ask);
        }
        state.poll(poll, |data| {
            data.take::<C::Reply>().map_err(|error| Fault::BadPayload {
                text: format!("its reply: {error}"),
            })
        })
    }
}

/// A one-way message that has not been sent yet; `.await` sends it.
#[must_use = "a message is sent when it is awaited"]
pub struct Send<C: Command> {
    pub(super) call: Call<C>,
}

impl<C: Command> Send<C> {
    /// Waits at most this long for room in the receiver's queue.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.call.deadline = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        self.call = self.call.high_priority();
        self
    }
}

impl<C: Command> IntoFuture for Send<C> {
    type Output = Result<(), CallError>;
    type IntoFuture = Sending<C>;

    fn into_future(self) -> Sending<C> {
        Sending(CallState::New(self.call))
    }
}

/// A one-way message under way. Dropped before it is taken, it is not delivered.
#[must_use = "a message is sent when it is awaited"]
pub struct Sending<C: Command>(CallState<C>);

impl<C: Command> Unpin for Sending<C> {}

impl<C: Command> Future for Sending<C> {
    type Output = Result<(), CallError>;

    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        let Self(state) = self.get_mut();
        if let Some(call) = state.take_new() {
            let data = Data::of(call.request);
            let envelope = call.cx.envelope(&call.to, C::CODE, call.flags, data);
            let inner = &call.cx.inner;
            match inner
                .chassis
                .send(&inner.processor, envelope, call.deadline)
            {
                Sent::Ended(result) => {
                    let result = result.map_err(|fault| call.cx.error(&call.to, C::NAME, fault));
                    return Poll::Ready(result);
                }
                Sent::Waits(question) => {
                    *state = CallState::Asked(Ask::new(call.cx, call.to, C::NAME, question));
                }
            }
        }
        state.poll(poll, |_| Ok(()))
    }
}

/// Who asked whom for what. Kept with the call, so that it can be shown while it waits.
pub(crate) struct Note {
    cx: Context,
    to: TaskRef,
    command: &'static str,
    /// Where it is shown.
    place: Option<usize>,
}

impl Note {
    fn new(cx: &Context, to: TaskRef, command: &'static str) -> Self {
        Self {
            cx: cx.clone(),
            to,
            command,
            place: None,
        }
    }

    /// Shows the call to whoever wants to know what its task waits for.
    pub(crate) fn show(&mut self, since: Instant) {
        if self.place.is_none() {
            let waits = &self.cx.inner.record.waits;
            let to = self.to.name.clone();
            self.place = Some(waits.begin(to, self.to.tid, self.command, since));
        }
    }
}

impl Drop for Note {
    fn drop(&mut self) {
        if let Some(place) = self.place {
            self.cx.inner.record.waits.end(place);
        }
    }
}

/// Waits for an answer; dropped before, it takes the question back.
pub(super) struct Ask {
    cx: Context,
    state: AskState,
    circle: Circle,
    /// Who was asked, once it has ended.
    note: Option<Note>,
}

/// The search for a circle of tasks that wait for one another; see `circle.rs`.
enum Circle {
    NotLookedFor,
    LookedFor(LocalBoxFuture<'static, Option<String>>),
    Found(Option<String>),
}

enum AskState {
    Asked(Question),
    /// There was no time at all to ask.
    TooLate,
    Ended,
}

impl Circle {
    /// Goes on with the search.
    fn poll(&mut self, cx: &mut PollContext<'_>) {
        if let Self::LookedFor(looking) = self
            && let Poll::Ready(found) = looking.as_mut().poll(cx)
        {
            *self = Self::Found(found);
        }
    }
}

impl Ask {
    fn new(cx: Context, to: TaskRef, command: &'static str, question: Question) -> Self {
        let note = Note::new(&cx, to, command);
        cx.inner.processor.note_call(question.key, note);
        Self {
            cx,
            state: AskState::Asked(question),
            circle: Circle::NotLookedFor,
            note: None,
        }
    }

    /// Makes a call, at once.
    pub(super) fn call(
        cx: Context,
        to: TaskRef,
        command: &'static str,
        envelope: Envelope,
        deadline: Duration,
    ) -> Self {
        if deadline == Duration::ZERO {
            return Self {
                note: Some(Note::new(&cx, to, command)),
                cx,
                state: AskState::TooLate,
                circle: Circle::NotLookedFor,
            };
        }
        let inner = &cx.inner;
        let question = inner.chassis.call(&inner.processor, envelope, deadline);
        Self::new(cx, to, command, question)
    }

    #[inline]
    fn poll(&mut self, poll: &mut PollContext<'_>) -> Poll<Result<Data, Fault>> {
        let AskState::Asked(question) = &self.state else {
            return self.poll_late();
        };
        let processor = &self.cx.inner.processor;
        let fault = match processor.poll_call(question.key, &mut self.note, poll) {
            Looked::Answered(data) => return Poll::Ready(Ok(self.answered(data))),
            Looked::Waiting => {
                self.circle.poll(poll);
                return Poll::Pending;
            }
            Looked::Long => {
                let looking = circle::look(self.cx.clone(), question.asked.to());
                self.circle = Circle::LookedFor(Box::pin(looking));
                self.circle.poll(poll);
                return Poll::Pending;
            }
            Looked::Failed(fault) => fault,
            Looked::Late(after) => {
                match std::mem::replace(&mut self.circle, Circle::NotLookedFor) {
                    Circle::Found(Some(circle)) => Fault::Circle { after, circle },
                    _ => Fault::Deadline { after },
                }
            }
        };
        Poll::Ready(Err(self.failed(fault)))
    }

    /// There is a reply.
    #[inline]
    fn answered(&mut self, data: Data) -> Data {
        let AskState::Asked(question) = &self.state else {
            return data;
        };
        let tap = &self.cx.inner.chassis.tap;
        tap.answered(question.recorded, &question.asked, Ok(&data));
        self.state = AskState::Ended;
        data
    }

    /// It came to nothing.
    #[cold]
    fn failed(&mut self, fault: Fault) -> Fault {
        let AskState::Asked(question) = std::mem::replace(&mut self.state, AskState::Ended) else {
            return fault;
        };
        let tap = &self.cx.inner.chassis.tap;
        tap.answered(question.recorded, &question.asked, Err(&fault));
        if let (Some(outbound), Fault::Deadline { .. } | Fault::Circle { .. }) =
            (question.outbound, &fault)
        {
            outbound.abandon();
        }
        fault
    }

    #[cold]
    fn poll_late(&mut self) -> Poll<Result<Data, Fault>> {
        if !matches!(self.state, AskState::TooLate) {
            // Polled after its end, which is the fault of whoever polls.
            return Poll::Pending;
        }
        self.state = AskState::Ended;
        Poll::Ready(Err(Fault::Deadline {
            after: Duration::ZERO,
        }))
    }

    /// The error that `fault` makes of it, once it has ended.
    #[cold]
    fn error(&self, command: &str, fault: Fault) -> CallError {
        CallError {
            from: self.cx.name().to_owned(),
            // Every question is noted when it is asked.
            to: self
                .note
                .as_ref()
                .map_or_else(String::new, |note| note.to.name().to_owned()),
            command: command.to_owned(),
            fault,
        }
    }
}

impl Future for Ask {
    type Output = Result<Data, Fault>;

    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        self.get_mut().poll(poll)
    }
}

impl Drop for Ask {
    fn drop(&mut self) {
        if let AskState::Asked(question) = std::mem::replace(&mut self.state, AskState::Ended) {
            self.cx.inner.processor.give_up_call(question.key);
            if let Some(outbound) = question.outbound {
                outbound.abandon();
            }
        }
    }
}
