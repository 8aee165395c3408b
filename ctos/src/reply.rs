//! The way of an answer: the right to give it, wherever that goes, and the futures of those who wait for
//! it outside of all tasks. (Tasks wait in [`crate::exchange`].)

use std::{
    fmt,
    future::Future,
    pin::Pin,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context as PollContext, Poll, Waker},
};

use crate::{
    call::{Fault, lock},
    chassis::{Chassis, Inbound, Outbound},
    exchange::{CallKey, Ticket},
    message::Data,
    processor::{Processor, ProcessorHandle},
};

/// What comes back.
pub(crate) type Answer = Result<Data, Fault>;

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
    fn is_abandoned(&self) -> bool {
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

/// The waiting end of a [`Promise`]. Dropping it tells whoever makes the promise that nobody waits.
pub(crate) struct Waiting {
    promise: Arc<Promise>,
    /// The call and who made it, when it went over a link.
    outbound: Option<(Arc<Chassis>, Outbound)>,
}

impl Waiting {
    /// Waits for an answer of this process.
    pub(crate) fn here(promise: Arc<Promise>) -> Self {
        let outbound = None;
        Self { promise, outbound }
    }

    /// Waits for an answer that comes over a link, if there is an `outbound`.
    pub(crate) fn for_call(
        promise: Arc<Promise>,
        chassis: &Arc<Chassis>,
        outbound: Option<Outbound>,
    ) -> Self {
        let outbound = outbound.map(|outbound| (chassis.clone(), outbound));
        Self { promise, outbound }
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.promise.abandoned.store(true, Ordering::Release);
        if let Some((chassis, outbound)) = self.outbound.take() {
            chassis.abandon(outbound);
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

/// Where an answer goes.
enum ReplyTo {
    /// To a call of a task of this chassis.
    Local(Ticket),
    /// To somebody in this process who is no task.
    Outside(Arc<Promise>),
    /// Over a link.
    Remote(Arc<Chassis>, Arc<Inbound>),
}

impl ReplyTo {
    fn answer(self, answer: Answer) {
        match self {
            Self::Local(ticket) => ticket.answer(answer),
            Self::Outside(promise) => promise.fulfil(answer),
            Self::Remote(chassis, request) => chassis.post_reply(&request, answer),
        }
    }
}

/// The right to answer one message. Dropped without an answer, it tells the caller
/// [`Fault::NoReply`]: at once, or, where the handler of the message itself drops it, when it is known
/// how that handler ended, which may be a better answer.
pub(crate) struct ReplySlot {
    to: Option<ReplyTo>,
    /// The message at hand; 0 while it is not being handled.
    serial: u64,
}

impl ReplySlot {
    pub(crate) fn call(ticket: Ticket) -> Self {
        Self {
            to: Some(ReplyTo::Local(ticket)),
            serial: 0,
        }
    }

    pub(crate) fn outside(promise: Arc<Promise>) -> Self {
        Self {
            to: Some(ReplyTo::Outside(promise)),
            serial: 0,
        }
    }

    pub(crate) fn remote(chassis: Arc<Chassis>, request: Arc<Inbound>) -> Self {
        Self {
            to: Some(ReplyTo::Remote(chassis, request)),
            serial: 0,
        }
    }

    /// Gives the answer. Every answer to a message passes here on its way out.
    pub(crate) fn answer(mut self, answer: Answer) {
        if let Some(to) = self.to.take() {
            to.answer(answer);
        }
    }

    /// Whether nobody waits for the answer any more.
    pub(crate) fn is_abandoned(&self) -> bool {
        match &self.to {
            Some(ReplyTo::Local(ticket)) => ticket.is_abandoned(),
            Some(ReplyTo::Outside(promise)) => promise.is_abandoned(),
            Some(ReplyTo::Remote(_, request)) => request.is_abandoned(),
            None => true,
        }
    }

    /// Message number `serial` of its processor is about to be handled.
    pub(crate) fn set_serial(&mut self, serial: u64) {
        self.serial = serial;
    }

    /// The number of the message that is being handled.
    pub(crate) fn serial(&self) -> u64 {
        self.serial
    }

    /// What is enough to answer in place of whoever has the slot.
    pub(crate) fn key(&self) -> Option<ReplyKey> {
        Some(match self.to.as_ref()? {
            ReplyTo::Local(ticket) => ReplyKey::Local(ticket.home().clone(), ticket.key()),
            ReplyTo::Outside(promise) => ReplyKey::Outside(promise.clone()),
            ReplyTo::Remote(_, request) => ReplyKey::Remote(request.clone()),
        })
    }
}

impl Drop for ReplySlot {
    fn drop(&mut self) {
        if let Some(to) = self.to.take() {
            drop_unanswered(Self {
                to: Some(to),
                serial: self.serial,
            });
        }
    }
}

#[cold]
fn drop_unanswered(slot: ReplySlot) {
    let unwanted = match Processor::here() {
        Some(processor) if slot.serial != 0 => processor.keep_orphan(slot),
        _ => Err(slot),
    };
    if let Err(slot) = unwanted {
        slot.answer(Err(Fault::NoReply));
    }
}

impl fmt::Debug for ReplySlot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ReplySlot {{ open: {} }}", self.to.is_some())
    }
}

/// Names an answer that is owed, without the right to give it: for the loop of the task, whose handler
/// has that right, and may have passed it on.
pub(crate) enum ReplyKey {
    /// To a call of a processor of this chassis.
    Local(Arc<ProcessorHandle>, CallKey),
    /// To somebody in this process who is no task.
    Outside(Arc<Promise>),
    /// Over a link.
    Remote(Arc<Inbound>),
}

#[cfg(test)]
mod tests {
    use std::{rc::Rc, task::Context as PollContext, time::Duration};

    use super::*;
    use crate::{
        exchange::Looked,
        time::{Clock, Instant},
    };

    fn call() -> (Rc<Processor>, ReplySlot, CallKey) {
        let processor = Processor::new(Arc::default(), Clock::virtual_clock());
        processor.enter();
        let ticket = processor.begin_call(Instant::START, Duration::from_secs(1), None);
        let key = ticket.key();
        (processor, ReplySlot::call(ticket), key)
    }

    fn answer(processor: &Processor, key: CallKey) -> Option<Answer> {
        match processor.poll_call(key, &PollContext::from_waker(Waker::noop())) {
            Looked::Ended(answer) => Some(answer),
            Looked::Waiting | Looked::Long | Looked::Late(..) => None,
        }
    }

    #[test]
    fn an_answer_reaches_its_call_and_no_later_one() {
        let (processor, slot, key) = call();
        slot.answer(Ok(Data::of(1_u8)));
        let first = answer(&processor, key).unwrap().unwrap();
        assert_eq!(first.take::<u8>().unwrap(), 1);
        // The next call uses the same slot.
        let next = processor.begin_call(Instant::START, Duration::from_secs(1), None);
        processor.take_answer(key, Ok(Data::of(2_u8)));
        assert!(answer(&processor, next.key()).is_none());
    }

    #[test]
    fn the_first_answer_counts() {
        let (processor, slot, key) = call();
        processor.take_answer(key, Ok(Data::of(1_u8)));
        slot.answer(Ok(Data::of(2_u8)));
        let first = answer(&processor, key).unwrap().unwrap();
        assert_eq!(first.take::<u8>().unwrap(), 1);
    }

    #[test]
    fn a_request_dropped_without_an_answer_still_ends_the_call() {
        let (processor, slot, key) = call();
        assert!(answer(&processor, key).is_none());
        drop(slot);
        assert_eq!(
            answer(&processor, key).unwrap().unwrap_err(),
            Fault::NoReply
        );
    }

    #[test]
    fn what_a_handler_drops_is_answered_when_it_has_ended() {
        let (processor, mut slot, key) = call();
        slot.set_serial(7);
        processor.handling(7, || drop(slot));
        assert!(answer(&processor, key).is_none());
        assert!(processor.take_orphan(8).is_none());
        let mut slot = processor.take_orphan(7).unwrap();
        slot.set_serial(0);
        drop(slot);
        assert_eq!(
            answer(&processor, key).unwrap().unwrap_err(),
            Fault::NoReply
        );
    }

    #[test]
    fn a_caller_that_gave_up_is_seen_by_the_receiver() {
        let (processor, slot, key) = call();
        assert!(!slot.is_abandoned());
        processor.give_up_call(key);
        assert!(slot.is_abandoned());
        let next = processor.begin_call(Instant::START, Duration::from_secs(1), None);
        assert!(slot.is_abandoned());
        slot.answer(Ok(Data::of(1_u8)));
        assert!(answer(&processor, next.key()).is_none());
    }

    #[test]
    fn an_answer_from_another_thread_comes_home() {
        let (processor, slot, key) = call();
        std::thread::spawn(move || slot.answer(Ok(Data::of(1_u8))))
            .join()
            .unwrap();
        assert!(answer(&processor, key).is_none());
        assert!(processor.run_jobs());
        assert!(answer(&processor, key).is_some_and(|answer| answer.is_ok()));
    }
}
