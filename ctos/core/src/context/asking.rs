//! Calls and sends: futures that wait at the processor of their task, and take back what they asked when
//! they are dropped.

use std::{
    cell::Cell,
    future::Future,
    pin::Pin,
    rc::Rc,
    sync::Arc,
    task::{Context as PollContext, Poll, Waker, ready},
    time::Duration,
};

use serde::de::DeserializeOwned;

use super::core::{Context, Inner};
use crate::{
    chassis::{delivery::Outcome, pending::Outbound},
    circle,
    envelope::{Envelope, Message},
    exchange::Looked,
    reply::{CallKey, ReplySlot},
    tap::{Sent, WaitFor},
    task_ref::TaskRef,
    wait::Wait,
};
use ctos_message::{
    Data, Flags, PayloadError,
    fault::{CallError, Fault},
};

/// How what comes back is read.
type Read<R> = fn(&Ask, Option<Box<Envelope>>) -> Result<R, CallError>;

/// A call that ends with an `R`, or a one-way message that ends when it was taken; `.await` sends it. Dropped before
/// its end, it tells the receiver that nobody waits, and a message that was not taken is not delivered.
#[must_use = "nothing is sent before this is awaited"]
pub struct Call<R> {
    ask: Ask,
    read: Read<R>,
}

impl<R> Call<R> {
    #[inline]
    pub(super) fn new(ask: Ask, read: Read<R>) -> Self {
        Self { ask, read }
    }

    /// Waits at most this long for the reply, or for a place in the receiver's queue.
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.ask.deadline = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        if let State::Begins(message) = &mut self.ask.state {
            let header = &mut message.envelope.header;
            header.flags |= Flags::HIGH_PRIORITY;
        }
        self
    }
}

impl<R> Future for Call<R> {
    type Output = Result<R, CallError>;

    fn poll(self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<Self::Output> {
        let Self { ask, read } = self.get_mut();
        Poll::Ready(match ready!(ask.poll(cx)) {
            Ok(reply) => read(ask, reply),
            Err(fault) => Err(ask.error(*fault)),
        })
    }
}

/// How a question ends: with the envelope of the reply, or, where none was wanted, with nothing.
type Ended = Result<Option<Box<Envelope>>, Box<Fault>>;

/// Who asks whom for what, from before the message is sent until there is an answer; dropped in between, it takes
/// the question back.
pub(super) struct Ask {
    asker: Rc<Inner>,
    /// The asked task, as its caller names it.
    to: Arc<str>,
    command: &'static str,
    wait: WaitFor,
    deadline: Duration,
    sent: Sent,
    state: State,
}

/// How far a question has come.
enum State {
    Begins(Message),
    Waits(Waits),
    Over,
}

/// A question under way.
struct Waits {
    /// Where it waits.
    key: CallKey,
    /// The way to take it back when it went over a link.
    outbound: Option<Outbound>,
    /// Whether it has been looked for in vain.
    waited: bool,
}

impl Ask {
    /// Will send `message` to `to` and wait for what `wait` names.
    #[inline]
    pub(super) fn new(
        asker: Rc<Inner>,
        to: &TaskRef,
        command: &'static str,
        message: Message,
        wait: WaitFor,
    ) -> Self {
        Self {
            deadline: asker.call_deadline(),
            asker,
            to: to.name.clone(),
            command,
            wait,
            sent: Sent::of(&message),
            state: State::Begins(message),
        }
    }

    /// Sends the message, if that has not been done yet, and looks for the answer.
    fn poll(&mut self, cx: &mut PollContext<'_>) -> Poll<Ended> {
        if let State::Begins(_) = self.state
            && let State::Begins(message) = std::mem::replace(&mut self.state, State::Over)
            && let Some(ended) = self.begin(message)
        {
            return Poll::Ready(ended);
        }
        let State::Waits(waits) = &mut self.state else {
            // Polled after its end, which is the fault of the polling code.
            return Poll::Pending;
        };
        let (key, at_once) = (waits.key, !waits.waited);
        let ended = match self.asker.processor.poll_call(key, cx) {
            Looked::Waiting => {
                if at_once {
                    waits.waited = true;
                    let wait = Wait {
                        activity: self.asker.record.statistics.activity().clone(),
                        to: self.to.clone(),
                        tid: self.sent.asked.to,
                        command: self.command,
                        place: None,
                    };
                    self.asker.processor.await_call(key, self.deadline, wait);
                }
                return Poll::Pending;
            }
            Looked::Long => {
                circle::look_for(Context::of(self.asker.clone()), key, self.sent.asked.to);
                return Poll::Pending;
            }
            Looked::Ended(answer) => answer.map(Some),
            Looked::Late(fault) => {
                if let Some(outbound) = waits.outbound.take() {
                    self.asker.chassis.abandon(outbound);
                }
                Err(Box::new(fault))
            }
        };
        self.state = State::Over;
        self.show(at_once, &ended);
        Poll::Ready(ended)
    }

    /// Sends the message. How the question ends, if that is known at once.
    fn begin(&mut self, mut message: Message) -> Option<Ended> {
        let after = self.deadline;
        if after.is_zero() {
            return Some(Err(Box::new(Fault::Deadline { after })));
        }
        let Inner {
            chassis, processor, ..
        } = &*self.asker;
        let key = Cell::new(None);
        let replies = self.wait == WaitFor::Reply;
        let began = replies.then(|| processor.look_at_clock());
        message.envelope.deadline = began.map(|began| began + after);
        let slot = || {
            let began = began.unwrap_or_else(|| processor.now());
            let ticket = processor.begin_call(began, after);
            key.set(Some(ticket.key()));
            ReplySlot::call(ticket)
        };
        self.asker.note_poll();
        let ready = processor.ready_count();
        let outcome = chassis.deliver(message, self.wait, &mut self.sent, slot);
        if replies {
            let meter = &self.asker.record.statistics.activity().meter;
            meter.while_it_waits(|| processor.hand_over(ready));
        }
        let ended = match (outcome, key.get()) {
            (Outcome::Waits(outbound), Some(key)) => {
                self.state = State::Waits(Waits {
                    key,
                    outbound,
                    waited: false,
                });
                return None;
            }
            (Outcome::Failed(fault), key) => {
                if let Some(key) = key {
                    processor.give_up_call(key);
                }
                Err(Box::new(fault))
            }
            (Outcome::Taken | Outcome::Waits(_), _) => Ok(None),
        };
        self.show(true, &ended);
        Some(ended)
    }

    /// Sends the message now, or not at all.
    ///
    /// # Errors
    /// Why it was not taken.
    pub(super) fn at_once(mut self) -> Result<(), CallError> {
        match self.poll(&mut PollContext::from_waker(Waker::noop())) {
            Poll::Ready(Ok(_)) => Ok(()),
            Poll::Ready(Err(fault)) => Err(self.error(*fault)),
            // A message that nobody waits for is taken or refused at once.
            Poll::Pending => Err(self.error(Fault::NoReply)),
        }
    }

    /// Shows a recorder how the question ended.
    fn show(&self, at_once: bool, ended: &Ended) {
        let recorder = self.asker.chassis.tap.recorder();
        if let Some(recorder) = recorder
            && (self.wait != WaitFor::Nothing || ended.is_err())
        {
            let answer = match ended {
                Ok(Some(reply)) => Ok(&reply.data),
                Ok(None) => Ok(&Data::NOTHING),
                Err(fault) => Err(&**fault),
            };
            let came = self.asker.came(at_once);
            recorder.answered(self.sent.id, &self.sent.asked, came, answer);
        }
    }

    /// The reply as a value.
    pub(super) fn read<R: DeserializeOwned + 'static>(
        &self,
        reply: Option<Box<Envelope>>,
    ) -> Result<R, CallError> {
        let mut reply = reply.ok_or_else(|| self.error(Fault::NoReply))?;
        let value = reply.data.take_out();
        value.map_err(|error| self.misread(&error))
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
        if let State::Waits(waits) = &mut self.state {
            self.asker.processor.give_up_call(waits.key);
            if let Some(outbound) = waits.outbound.take() {
                self.asker.chassis.abandon(outbound);
            }
        }
    }
}
