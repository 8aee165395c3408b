//! Calls and sends: futures that wait at the processor of their task, and take back what they asked when
//! they are dropped.

use std::{
    cell::Cell,
    future::Future,
    marker::PhantomData,
    pin::Pin,
    rc::Rc,
    sync::Arc,
    task::{Context as PollContext, Poll, Waker, ready},
    time::Duration,
};

use futures_util::future::LocalBoxFuture;

use super::{
    core::{Context, Inner},
    task_ref::TaskRef,
};
use crate::{
    chassis::{delivery::Outcome, pending::Outbound},
    circle,
    envelope::Message,
    exchange::Looked,
    reply::{CallKey, ReplySlot},
    tap::{Asked, WaitFor},
    wait::Wait,
};
use ctos_message::{
    Command, Data, Flags, PayloadError,
    fault::{CallError, Fault},
};

/// A call; `.await` makes it. Dropped before its end, it tells the receiver that nobody waits.
#[must_use = "a call is made when it is awaited"]
pub struct Call<C: Command> {
    ask: Ask,
    command: PhantomData<fn(C) -> C::Reply>,
}

impl<C: Command> Call<C> {
    pub(super) fn new(asker: Rc<Inner>, to: &TaskRef, message: Message) -> Self {
        let deadline = asker.call_deadline();
        Self {
            ask: Ask::new(asker, to, C::NAME, message, WaitFor::Reply, deadline),
            command: PhantomData,
        }
    }

    /// Waits at most this long for the reply.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.ask.deadline = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        self.ask.hurry();
        self
    }
}

impl<C: Command> Unpin for Call<C> {}

impl<C: Command> Future for Call<C> {
    type Output = Result<C::Reply, CallError>;

    fn poll(self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<Self::Output> {
        let ask = &mut self.get_mut().ask;
        let data = ready!(ask.poll(cx))?;
        let reply = data.take::<C::Reply>();
        Poll::Ready(reply.map_err(|error| ask.misread(&error)))
    }
}

/// A one-way message; `.await` sends it. Dropped before it is taken, it is not delivered.
#[must_use = "a message is sent when it is awaited"]
pub struct Send<C: Command> {
    ask: Ask,
    command: PhantomData<fn(C)>,
}

impl<C: Command> Send<C> {
    pub(super) fn new(asker: Rc<Inner>, to: &TaskRef, message: Message) -> Self {
        let deadline = asker.call_deadline();
        Self {
            ask: Ask::new(asker, to, C::NAME, message, WaitFor::Acceptance, deadline),
            command: PhantomData,
        }
    }

    /// Waits at most this long for a place in the receiver's queue.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.ask.deadline = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        self.ask.hurry();
        self
    }
}

impl<C: Command> Unpin for Send<C> {}

impl<C: Command> Future for Send<C> {
    type Output = Result<(), CallError>;

    fn poll(self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<Self::Output> {
        let ask = &mut self.get_mut().ask;
        ready!(ask.poll(cx))?;
        Poll::Ready(Ok(()))
    }
}

/// Who asks whom for what, from before the message is sent until there is an answer; dropped in between, it takes
/// the question back.
pub(super) struct Ask {
    asker: Rc<Inner>,
    /// The asked task, as its caller names it.
    to: Arc<str>,
    command: &'static str,
    wait: WaitFor,
    pub(super) deadline: Duration,
    /// The message, until it is sent.
    message: Option<Message>,
    /// The question, from then on.
    waits: Option<Waits>,
}

/// A question under way.
struct Waits {
    /// Where it waits, if it does.
    key: Option<CallKey>,
    /// The way to take it back when it went over a link.
    outbound: Option<Outbound>,
    asked: Asked,
    /// The message's number in the record.
    recorded: u64,
    /// Whether it has been looked for in vain.
    waited: bool,
    circle: Circle,
}

/// The search for a circle of tasks that wait for one another; see `circle.rs`.
enum Circle {
    NotLookedFor,
    LookedFor(LocalBoxFuture<'static, Option<String>>),
    Found(Option<String>),
}

impl Ask {
    /// Will send `message` to `to` and wait for what `wait` names.
    pub(super) fn new(
        asker: Rc<Inner>,
        to: &TaskRef,
        command: &'static str,
        message: Message,
        wait: WaitFor,
        deadline: Duration,
    ) -> Self {
        Self {
            asker,
            to: to.name.clone(),
            command,
            wait,
            deadline,
            message: Some(message),
            waits: None,
        }
    }

    fn hurry(&mut self) {
        if let Some(message) = &mut self.message {
            let header = &mut message.envelope.header;
            header.flags = header.flags.with(Flags::HIGH_PRIORITY);
        }
    }

    /// Sends the message, if that has not been done yet, and looks for the answer.
    pub(super) fn poll(&mut self, cx: &mut PollContext<'_>) -> Poll<Result<Data, CallError>> {
        if let Some(message) = self.message.take() {
            if self.deadline.is_zero() {
                let after = self.deadline;
                return Poll::Ready(Err(self.error(Fault::Deadline { after })));
            }
            if let Some(answer) = self.begin(message) {
                return Poll::Ready(self.end(answer));
            }
        }
        let Some(waits) = &mut self.waits else {
            // Polled after its end, which is the fault of whoever polls.
            return Poll::Pending;
        };
        let Some(key) = waits.key else {
            return Poll::Pending;
        };
        match self.asker.processor.poll_call(key, cx) {
            Looked::Waiting => {
                if let Circle::LookedFor(looking) = &mut waits.circle
                    && let Poll::Ready(found) = looking.as_mut().poll(cx)
                {
                    waits.circle = Circle::Found(found);
                }
                if !std::mem::replace(&mut waits.waited, true) {
                    let wait = Wait {
                        activity: self.asker.record.statistics.activity().clone(),
                        to: self.to.clone(),
                        tid: waits.asked.to,
                        command: self.command,
                        place: None,
                    };
                    self.asker.processor.await_call(key, self.deadline, wait);
                }
                Poll::Pending
            }
            Looked::Long => {
                self.look_for_circle(cx);
                Poll::Pending
            }
            Looked::Ended(answer) => Poll::Ready(self.end(answer)),
            Looked::Late(after) => Poll::Ready(self.late(after)),
        }
    }

    /// Sends the message. The answer, if it is known at once.
    fn begin(&mut self, mut message: Message) -> Option<Result<Data, Fault>> {
        let Inner {
            chassis, processor, ..
        } = &*self.asker;
        let key = Cell::new(None);
        let began = (self.wait == WaitFor::Reply).then(|| processor.look_at_clock());
        message.envelope.deadline = began.map(|began| began + self.deadline);
        let mut slot = || {
            let began = began.unwrap_or_else(|| processor.now());
            let ticket = processor.begin_call(began, self.deadline);
            key.set(Some(ticket.key()));
            Some(ReplySlot::call(ticket))
        };
        let ready = processor.ready_count();
        let delivered = chassis.deliver(message, self.wait, &mut slot);
        if self.wait == WaitFor::Reply {
            let meter = &self.asker.record.statistics.activity().meter;
            meter.while_it_waits(|| processor.hand_over(ready));
        }
        let (outbound, answer) = match delivered.outcome {
            Outcome::Taken => (None, Some(Ok(Data::NOTHING))),
            Outcome::Failed(fault) => (None, Some(Err(fault))),
            Outcome::Waits(outbound) => (outbound, None),
        };
        if let (Some(key), Some(_)) = (key.get(), &answer) {
            processor.give_up_call(key);
        }
        self.waits = Some(Waits {
            key: key.get(),
            outbound,
            asked: delivered.asked,
            recorded: delivered.recorded,
            waited: false,
            circle: Circle::NotLookedFor,
        });
        answer
    }

    /// Sends the message now, or not at all.
    ///
    /// # Errors
    /// Why it was not taken.
    pub(super) fn at_once(mut self) -> Result<(), CallError> {
        match self.poll(&mut PollContext::from_waker(Waker::noop())) {
            Poll::Ready(ended) => ended.map(drop),
            // A message that nobody waits for is taken or refused at once.
            Poll::Pending => Err(self.error(Fault::NoReply)),
        }
    }

    fn look_for_circle(&mut self, poll: &mut PollContext<'_>) {
        if let Some(waits) = &mut self.waits {
            let cx = Context::of(self.asker.clone());
            let mut looking: LocalBoxFuture<'_, _> = Box::pin(circle::look(cx, waits.asked.to));
            waits.circle = match looking.as_mut().poll(poll) {
                Poll::Ready(found) => Circle::Found(found),
                Poll::Pending => Circle::LookedFor(looking),
            };
        }
    }

    /// The question is over: there is nothing to take back.
    fn end(&mut self, answer: Result<Data, Fault>) -> Result<Data, CallError> {
        if let Some(waits) = self.waits.take() {
            let recorder = self.asker.chassis.tap.recorder();
            if let Some(recorder) = recorder
                && (self.wait != WaitFor::Nothing || answer.is_err())
            {
                let at_once = !waits.waited;
                recorder.answered(waits.recorded, &waits.asked, at_once, answer.as_ref());
            }
        }
        answer.map_err(|fault| self.error(fault))
    }

    fn late(&mut self, after: Duration) -> Result<Data, CallError> {
        let mut fault = Fault::Deadline { after };
        if let Some(waits) = &mut self.waits {
            let circle = std::mem::replace(&mut waits.circle, Circle::NotLookedFor);
            if let Circle::Found(Some(circle)) = circle {
                fault = Fault::Circle { after, circle };
            }
            if let Some(outbound) = waits.outbound.take() {
                self.asker.chassis.abandon(outbound);
            }
        }
        self.end(Err(fault))
    }

    pub(super) fn misread(&self, error: &PayloadError) -> CallError {
        let text = format!("its reply: {error}");
        self.error(Fault::BadPayload { text })
    }

    fn error(&self, fault: Fault) -> CallError {
        let error = CallError {
            from: self.asker.record.name.to_string(),
            to: self.to.to_string(),
            command: self.command.to_owned(),
            fault,
        };
        if error.is_gone() {
            self.asker.chassis.directory.forget(&self.to);
        }
        error
    }
}

impl Drop for Ask {
    fn drop(&mut self) {
        if let Some(waits) = self.waits.take() {
            if let Some(key) = waits.key {
                self.asker.processor.give_up_call(key);
            }
            if let Some(outbound) = waits.outbound {
                self.asker.chassis.abandon(outbound);
            }
        }
    }
}
