//! The way of an answer: the right to give it, wherever that goes. Also the futures of those who wait
//! for it outside of all tasks. (Tasks wait in [`crate::exchange`].)

use std::{
    cell::{Cell, RefCell},
    future::Future,
    pin::Pin,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context as PollContext, Poll},
};

use tokio::sync::oneshot;

use crate::envelope::{Envelope, Message};
use ctos_message::{Data, Tid, fault::Fault};
use ctos_time::lock::lock;

/// What comes back.
pub type Answer = Result<Data, Fault>;

/// An answer on its way to a call of a task: a pointer, and mostly the envelope that brought the request.
pub(crate) type Returned = Result<Box<Envelope>, Box<Fault>>;

/// An answer that comes without the envelope of its request.
fn returned(answer: Answer) -> Returned {
    let data = answer.map_err(Box::new)?;
    Ok(Message::with_data(Tid::default(), Tid::default(), 0, data).envelope)
}

/// One answer on its way from any thread to the one future that waits for it. The first one counts.
pub struct Promise(Mutex<Option<oneshot::Sender<Answer>>>);

impl Promise {
    /// With the future that waits for it.
    pub fn new() -> (Arc<Self>, Waiting) {
        let (sender, answer) = oneshot::channel();
        let take_back = None;
        let waiting = Waiting { answer, take_back };
        (Arc::new(Self(Mutex::new(Some(sender)))), waiting)
    }
}

impl Caller for Promise {
    fn answer(&self, answer: Answer) {
        let sender = lock(&self.0).take();
        // Nobody listens any more when it was abandoned.
        let _ = sender.map(|sender| sender.send(answer));
    }

    fn is_abandoned(&self) -> bool {
        lock(&self.0)
            .as_ref()
            .is_none_or(oneshot::Sender::is_closed)
    }
}

/// The caller behind a message of the runtime: it needs no answer, and the message stays wanted.
pub(crate) struct Nobody;

impl Caller for Nobody {
    fn answer(&self, _answer: Answer) {}

    fn is_abandoned(&self) -> bool {
        false
    }
}

/// The waiting end of a [`Promise`]. Dropping it tells the promising end that nobody waits.
pub struct Waiting {
    answer: oneshot::Receiver<Answer>,
    /// Takes the question back, when it went over a link.
    pub(crate) take_back: Option<Box<dyn FnOnce() + Send>>,
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.answer.close();
        if let Some(take_back) = self.take_back.take() {
            take_back();
        }
    }
}

impl Future for Waiting {
    type Output = Answer;

    fn poll(mut self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<Answer> {
        let answer = Pin::new(&mut self.answer).poll(cx);
        answer.map(|answer| answer.unwrap_or(Err(Fault::NoReply)))
    }
}

/// Where the calls of one processor wait.
pub(crate) trait Home: Send + Sync {
    /// Takes the answer to a call, from any thread.
    fn take_answer(&self, key: CallKey, answer: Returned);
}

/// A caller that is not a task of this chassis: a task of another one, or somebody outside of all tasks.
pub(crate) trait Caller: Send + Sync {
    /// Gives it the answer; nothing comes of it when that was done already.
    fn answer(&self, answer: Answer);
    /// Whether it waits no longer.
    fn is_abandoned(&self) -> bool;
}

/// One slot, as those who answer see it.
pub(crate) struct Shared {
    pub(crate) home: Arc<dyn Home>,
    pub(crate) slot: u32,
    /// The last generation whose caller went without its answer; [`NOBODY`] before there is one.
    pub(crate) gone: AtomicU64,
}

/// No call has this generation.
pub(crate) const NOBODY: u64 = 0;

/// The right to answer one call, from any thread. Its holder must use it: a ticket that is merely
/// dropped leaves its caller to its deadline.
pub(crate) struct Ticket {
    pub(crate) shared: Arc<Shared>,
    pub(crate) generation: u64,
}

impl Ticket {
    /// Gives the answer. When the caller waits no longer, nothing comes of it.
    pub(crate) fn answer(self, answer: Returned) {
        self.shared.home.take_answer(self.key(), answer);
    }

    /// Whether the caller waits no longer.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.generation <= self.shared.gone.load(Ordering::Acquire)
    }

    /// Names the call that the ticket is for.
    pub(crate) fn key(&self) -> CallKey {
        CallKey {
            slot: self.shared.slot,
            generation: self.generation,
        }
    }
}

/// Names one call among all that one processor has ever waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CallKey {
    pub(crate) slot: u32,
    pub(crate) generation: u64,
}

/// Where an answer goes.
enum ReplyTo {
    /// To a call of a task of this chassis.
    Local(Ticket),
    /// To another caller.
    Other(Arc<dyn Caller>),
}

/// The right to answer one message. Dropped without an answer, it tells the caller [`Fault::NoReply`]
/// at once. If the handler of the message itself drops it, the caller is told when that handler ends:
/// that end may be a better answer.
#[derive(derive_more::Debug)]
#[debug("ReplySlot {{ open: {} }}", self.to.is_some())]
pub struct ReplySlot {
    to: Option<ReplyTo>,
    /// The message at hand; 0 while it is not being handled.
    serial: u64,
}

impl ReplySlot {
    pub(crate) fn call(ticket: Ticket) -> Self {
        Self::of(ReplyTo::Local(ticket))
    }

    /// To somebody in this process who is not a task.
    pub fn outside(promise: Arc<Promise>) -> Self {
        Self::other(promise)
    }

    pub(crate) fn other(caller: Arc<dyn Caller>) -> Self {
        Self::of(ReplyTo::Other(caller))
    }

    fn of(to: ReplyTo) -> Self {
        let to = Some(to);
        Self { to, serial: 0 }
    }

    /// Gives the answer. Every answer to a message passes here on its way out.
    pub fn answer(mut self, answer: Answer) {
        match self.to.take() {
            Some(ReplyTo::Local(ticket)) => ticket.answer(returned(answer)),
            Some(ReplyTo::Other(caller)) => caller.answer(answer),
            None => {}
        }
    }

    /// Tells a sender that waits for no more that its message was taken.
    pub(crate) fn accept(self) {
        self.answer(Ok(Data::NOTHING));
    }

    /// Answers the request that `envelope` brought with the data that is in it now.
    pub(crate) fn send_back(mut envelope: Box<Envelope>) {
        match envelope.reply.as_mut().and_then(|slot| slot.to.take()) {
            Some(ReplyTo::Local(ticket)) => ticket.answer(Ok(envelope)),
            Some(ReplyTo::Other(caller)) => caller.answer(Ok(envelope.data)),
            None => {}
        }
    }

    /// Whether nobody waits for the answer any more.
    pub(crate) fn is_abandoned(&self) -> bool {
        match &self.to {
            Some(ReplyTo::Local(ticket)) => ticket.is_abandoned(),
            Some(ReplyTo::Other(caller)) => caller.is_abandoned(),
            None => true,
        }
    }

    /// Message number `serial` is about to be handled.
    pub(crate) fn set_serial(&mut self, serial: u64) {
        self.serial = serial;
    }

    /// What is enough to answer in place of the holder of the slot.
    pub(crate) fn key(&self) -> Option<ReplyKey> {
        Some(match self.to.as_ref()? {
            ReplyTo::Local(ticket) => ReplyKey::Local(ticket.key()),
            ReplyTo::Other(caller) => ReplyKey::Other(caller.clone()),
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
    let serial = slot.serial;
    let is_at_hand = HANDLING.try_with(|handling| serial != 0 && serial == handling.get());
    if is_at_hand == Ok(true) {
        ORPHANS.with(|orphans| orphans.borrow_mut().push(slot));
    } else {
        slot.answer(Err(Fault::NoReply));
    }
}

/// Names an answer that is owed, without the right to give it. It is for the loop of the task, whose
/// handler has that right, and may have passed it on.
pub(crate) enum ReplyKey {
    /// To a call of a task of this chassis.
    Local(CallKey),
    /// To another caller.
    Other(Arc<dyn Caller>),
}

impl ReplyKey {
    /// Answers in place of the holder of the right; it has no effect when that has answered already. A call of a
    /// task of this chassis waits at `home`.
    pub(crate) fn answer(self, home: &dyn Home, answer: Answer) {
        match self {
            Self::Local(key) => home.take_answer(key, returned(answer)),
            Self::Other(caller) => caller.answer(answer),
        }
    }
}

// -- rights to answer that a handler at work drops ----------------------------------------------

/// How many messages one thread may number.
const PER_THREAD: u64 = 1 << 44;

/// Counts the threads that number messages.
static THREADS: AtomicU64 = AtomicU64::new(0);

thread_local! {
    /// The message whose handler is at work; 0: none is.
    static HANDLING: Cell<u64> = const { Cell::new(0) };
    /// Rights to answer that handlers at work have dropped.
    static ORPHANS: RefCell<Vec<ReplySlot>> = const { RefCell::new(Vec::new()) };
    static NEXT: Cell<u64> = Cell::new(THREADS.fetch_add(1, Ordering::Relaxed) * PER_THREAD + 1);
}

/// A number for a message that is about to be handled; no other message of the process has it.
pub(crate) fn next_serial() -> u64 {
    NEXT.with(|next| next.replace(next.get() + 1))
}

/// Runs code of the handler of message `serial`. If that code drops the right to answer the
/// message, the right is kept until the end of the handler is known.
pub(crate) fn handling<T>(serial: u64, code: impl FnOnce() -> T) -> T {
    let _restore = scopeguard::guard(HANDLING.replace(serial), |before| HANDLING.set(before));
    code()
}

/// Whether code of a handler runs.
pub(crate) fn is_handling() -> bool {
    HANDLING.get() != 0
}

/// The right to answer message `serial`, if its handler dropped it.
pub(crate) fn take_orphan(serial: u64) -> Option<ReplySlot> {
    ORPHANS.with(|orphans| {
        let mut orphans = orphans.borrow_mut();
        let place = orphans.iter().position(|slot| slot.serial == serial)?;
        Some(orphans.swap_remove(place))
    })
}

#[cfg(test)]
mod tests {
    use std::{rc::Rc, task::Waker, time::Duration};

    use super::*;
    use crate::{exchange::Looked, processor::Processor};
    use ctos_time::{Clock, Instant};

    fn call() -> (Rc<Processor>, ReplySlot, CallKey) {
        let processor = Processor::new(Arc::default(), Clock::virtual_clock());
        processor.enter();
        let ticket = processor.begin_call(Instant::START, Duration::from_secs(1));
        let key = ticket.key();
        (processor, ReplySlot::call(ticket), key)
    }

    fn answer(processor: &Processor, key: CallKey) -> Option<Answer> {
        match processor.poll_call(key, &PollContext::from_waker(Waker::noop())) {
            Looked::Ended(Ok(envelope)) => Some(Ok(envelope.data)),
            Looked::Ended(Err(fault)) => Some(Err(*fault)),
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
        let next = processor.begin_call(Instant::START, Duration::from_secs(1));
        processor.take_answer(key, returned(Ok(Data::of(2_u8))));
        assert!(answer(&processor, next.key()).is_none());
    }

    #[test]
    fn the_first_answer_counts() {
        let (processor, slot, key) = call();
        processor.take_answer(key, returned(Ok(Data::of(1_u8))));
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
        handling(7, || drop(slot));
        assert!(answer(&processor, key).is_none());
        assert!(take_orphan(8).is_none());
        let mut slot = take_orphan(7).unwrap();
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
        let next = processor.begin_call(Instant::START, Duration::from_secs(1));
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
