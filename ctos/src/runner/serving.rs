//! The messages of a task, one after the other: which are begun, who is told how each ended.

use std::{
    cell::Cell,
    future::{Future, poll_fn},
    panic::{AssertUnwindSafe, catch_unwind},
    pin::{Pin, pin},
    rc::Rc,
    sync::Arc,
    task::{Context as PollContext, Poll},
};

use crate::{
    call::{Fault, ReplyKey},
    chassis::TaskRecord,
    context::Context,
    exchange::CallKey,
    mailbox::TaskQueue,
    message::{Command, Message, SYSTEM_COMMANDS},
    processor::panic_text,
    record::{self, Ending as HandlerEnding},
    statistics::Activity,
    system::StopTask,
    task::{EventHandler, Handled, HandlerError},
    time::Instant,
};

/// What the loop of a task needs besides its handler.
pub(crate) struct Serving {
    pub(super) cx: Context,
    pub(super) record: Arc<TaskRecord>,
    pub(super) activity: Arc<Activity>,
    pub(super) queue: Rc<TaskQueue>,
    /// It was told to stop: nothing more is begun, or hardware at rest would move again.
    pub(super) stopped: Cell<bool>,
}

/// Waits for the end of a handler that an order to stop interrupts. As a type, and not a closure, because its code
/// belongs into that of the loop, which is what a message takes.
struct AtWork<'a, 'h, F> {
    serving: &'a Serving,
    at_hand: &'a AtHand,
    handling: Pin<&'h mut Option<F>>,
}

impl<F: Future<Output = Handled>> Future for AtWork<'_, '_, F> {
    type Output = Ended;

    #[inline(always)]
    fn poll(self: Pin<&mut Self>, cx: &mut PollContext<'_>) -> Poll<Ended> {
        let Self {
            serving,
            at_hand,
            handling,
        } = self.get_mut();
        serving.poll(at_hand, handling.as_mut(), true, cx)
    }
}

/// Waits for the next message, in the same way.
struct Coming<'a> {
    serving: &'a Serving,
    next: &'a mut Option<Message>,
}

impl Future for Coming<'_> {
    type Output = ();

    #[inline(always)]
    fn poll(self: Pin<&mut Self>, _: &mut PollContext<'_>) -> Poll<()> {
        let Self { serving, next } = self.get_mut();
        serving.poll_next(next)
    }
}

/// Why the handling of a task's messages was interrupted.
pub(crate) enum Served {
    /// By a message that is not for the handler, or not for it alone.
    Next(Message),
    /// By a panic that said so.
    Panicked(String),
    /// By the end of the queue.
    Closed,
}

/// How the handling of one message ended. Two words: what is moved right after it was written in small pieces is
/// waited for.
pub(super) type Ended = Result<(), Box<Bad>>;

/// How the handling of one message ended otherwise than well.
pub(super) enum Bad {
    Refused(HandlerError),
    Panicked(String),
    /// By a message that ends whatever it does; whether because a part of it broke.
    Interrupted(bool),
}

/// The message that is about to be handled, or is. One place serves message after message: what is moved
/// right after it was written in small pieces is waited for.
#[derive(Default)]
pub(super) struct AtHand {
    command: Cell<u16>,
    pub(super) serial: Cell<u64>,
    began: Cell<Instant>,
    owed: Cell<Owed>,
    /// To whom, when that is [`Owed::Elsewhere`].
    owed_elsewhere: Cell<Option<ReplyKey>>,
    /// The message, for the record, if there is one.
    noted: Cell<Option<record::AtHand>>,
}

impl AtHand {
    /// Whoever has this key is owed the answer.
    #[inline(never)]
    fn owes_elsewhere(&self, key: Option<ReplyKey>) {
        self.owed.set(Owed::Elsewhere);
        self.owed_elsewhere.set(key);
    }
}

/// To whom the answer to a message is owed. What most are needs no destructor.
#[derive(Clone, Copy, Default)]
enum Owed {
    #[default]
    Nothing,
    /// To a call of this processor of the chassis.
    Here(u8, CallKey),
    /// To somebody else.
    Elsewhere,
}

impl Serving {
    /// Puts the next message that is to be handled into `next`; none once the queue is closed.
    #[inline(always)]
    pub(super) fn poll_next(&self, next: &mut Option<Message>) -> Poll<()> {
        loop {
            if self.queue.poll_next(next).is_pending() {
                return Poll::Pending;
            }
            if next.as_ref().is_none_or(|message| self.is_wanted(message)) {
                return Poll::Ready(());
            }
            if let Some(message) = next.take() {
                self.pass_over(message);
            }
        }
    }

    /// The next message that is to be handled; `None` once the queue is closed.
    pub(super) async fn next(&self) -> Option<Message> {
        let mut next = None;
        poll_fn(|_| self.poll_next(&mut next)).await;
        next
    }

    /// Whether a message is still to be begun.
    #[inline]
    fn is_wanted(&self, message: &Message) -> bool {
        if self.refuses(message) {
            return false;
        }
        let Some(slot) = &message.letter.reply else {
            return true;
        };
        // A stop is carried out even when whoever ordered it had to go on.
        !slot.is_abandoned() || message.command() == StopTask::CODE
    }

    /// Ends a message that is not begun.
    #[cold]
    fn pass_over(&self, message: Message) {
        let command = message.command();
        tracing::debug!(task = %self.cx.name(), command, "caller gave up, or the task is stopping");
        message.refuse(Fault::Stopping);
    }

    fn refuses(&self, message: &Message) -> bool {
        self.stopped.get() && message.command() < SYSTEM_COMMANDS
    }

    /// The handler is called with `message`. This is the one place that every message passes on its
    /// way to a handler.
    #[inline]
    pub(super) fn begin(&self, at_hand: &AtHand, message: &mut Message) {
        let processor = self.cx.processor();
        let chassis = self.cx.chassis();
        let (began, command) = (processor.recent(), message.command());
        let serial = processor.next_serial();
        at_hand.command.set(command);
        at_hand.serial.set(serial);
        at_hand.began.set(began);
        match &mut message.letter.reply {
            None => at_hand.owed.set(Owed::Nothing),
            Some(slot) => {
                slot.set_serial(serial);
                match slot.local_key() {
                    Some((home, call)) => at_hand.owed.set(Owed::Here(home, call)),
                    None => at_hand.owes_elsewhere(slot.key()),
                }
            }
        }
        chassis.delivered(&self.record, message);
        let statistics = &self.activity;
        statistics.begin(command, began);
        statistics.recent.began(message.from(), command, began);
        if chassis.tap.is_on() {
            let noted = record::AtHand::of(self.record.tid, message, began);
            chassis.tap.began(&noted);
            at_hand.noted.set(Some(noted));
        }
    }

    /// The handler has ended, in whatever way: what it owes is answered. What its panic said, if it
    /// panicked.
    #[inline]
    pub(super) fn end(&self, at_hand: &AtHand, ended: Ended) -> Option<String> {
        let (command, serial) = (at_hand.command.get(), at_hand.serial.get());
        let processor = self.cx.processor();
        let ok = ended.is_ok();
        let tap = &self.cx.chassis().tap;
        let statistics = &self.activity;
        let is_seen = tap.is_on() || statistics.recent.is_kept();
        let took = processor.time_since(at_hand.began.get(), is_seen);
        statistics.end(ok, took);
        if is_seen {
            let ending = || match ended.as_ref().map_err(Box::as_ref) {
                Ok(()) => HandlerEnding::Done,
                Err(Bad::Refused(error)) => HandlerEnding::Refused(error.to_string()),
                Err(Bad::Panicked(text)) => HandlerEnding::Panicked(text.clone()),
                Err(Bad::Interrupted(_)) => HandlerEnding::Stopped,
            };
            let now = processor.recent();
            statistics.recent.ended(command, now, ending);
            if let Some(noted) = at_hand.noted.take() {
                tap.ended(&noted, now, ending);
            }
        }
        let owed = at_hand.owed.get();
        match ended {
            Ok(()) => {
                if let Owed::Elsewhere = owed {
                    at_hand.owes_elsewhere(None);
                }
                // A right to answer that it kept is still good; one that it dropped is not.
                drop(processor.take_orphan(serial).map(|mut slot| {
                    slot.set_serial(0);
                    slot
                }));
                None
            }
            Err(bad) => {
                let owed = match owed {
                    Owed::Nothing => None,
                    Owed::Here(home, call) => Some(ReplyKey::Local(home, call)),
                    Owed::Elsewhere => at_hand.owed_elsewhere.take(),
                };
                self.end_badly(command, serial, owed, *bad)
            }
        }
    }

    /// The handler has ended otherwise than well.
    #[cold]
    fn end_badly(
        &self,
        command: u16,
        serial: u64,
        owed: Option<ReplyKey>,
        bad: Bad,
    ) -> Option<String> {
        let processor = self.cx.processor();
        let (fault, panic) = match bad {
            Bad::Refused(error) => {
                tracing::debug!(task = %self.cx.name(), command, error = %error, "refused");
                let text = error.to_string();
                (Fault::Refused { text }, None)
            }
            Bad::Interrupted(true) => {
                let text = "a part of it did, while it was handled".to_owned();
                (Fault::Panicked { text }, None)
            }
            Bad::Interrupted(false) => (Fault::Stopping, None),
            Bad::Panicked(text) => {
                tracing::error!(task = %self.cx.name(), command, panic = %text, "handler panicked");
                let fault = Fault::Panicked { text: text.clone() };
                (fault, Some(text))
            }
        };
        match (processor.take_orphan(serial), owed) {
            (Some(slot), _) => slot.answer(Err(fault)),
            (None, Some(key)) => self.cx.chassis().answer_by_key(key, Err(fault)),
            (None, None) => {}
        }
        panic
    }

    /// Polls a handler: to its end, its panic, or, if it is `interruptible`, an order to stop. With any of these it is
    /// dropped, while it is still at work: what it owes then is told apart from what others owe.
    #[inline(always)]
    pub(super) fn poll<F: Future<Output = Handled>>(
        &self,
        at_hand: &AtHand,
        mut handling: Pin<&mut Option<F>>,
        interruptible: bool,
        cx: &mut PollContext<'_>,
    ) -> Poll<Ended> {
        let processor = self.cx.processor();
        processor.leave();
        let polled = self.activity.meter.in_turn(|| {
            catch_unwind(AssertUnwindSafe(|| {
                processor.handling(at_hand.serial.get(), || {
                    let polled = handling.as_mut().as_pin_mut()?.poll(cx);
                    if polled.is_ready() {
                        handling.set(None);
                    }
                    Some(polled)
                })
            }))
        });
        let bad = match polled {
            Ok(Some(Poll::Ready(Ok(())))) => return Poll::Ready(Ok(())),
            Ok(Some(Poll::Ready(Err(error)))) => Bad::Refused(error),
            Err(panic) => Bad::Panicked(panic_text(panic.as_ref())),
            // A handler that waits for others must not delay an orderly stop: it is dropped there.
            Ok(Some(Poll::Pending)) if interruptible => match self.queue.interruption() {
                Some(broke) => Bad::Interrupted(broke),
                None => return Poll::Pending,
            },
            Ok(Some(Poll::Pending) | None) => return Poll::Pending,
        };
        processor.handling(at_hand.serial.get(), || handling.set(None));
        Poll::Ready(Err(Box::new(bad)))
    }

    /// See [`DynHandler::serve`].
    pub(crate) async fn serve<H: EventHandler>(&self, handler: &mut H, first: Message) -> Served {
        let mut next = Some(first);
        let at_hand = AtHand::default();
        // One context serves message after message.
        let mut cx = self.cx.within(0);
        while let Some(mut message) = next.take() {
            self.begin(&at_hand, &mut message);
            cx.set_trace(message.trace());
            let handling = pin!(Some(EventHandler::handle(handler, &cx, message)));
            let at_work = AtWork {
                serving: self,
                at_hand: &at_hand,
                handling,
            };
            let ended = at_work.await;
            if let Some(panic) = self.end(&at_hand, ended) {
                return Served::Panicked(panic);
            }
            let coming = Coming {
                serving: self,
                next: &mut next,
            };
            coming.await;
            if let Some(of_runtime) = next.take_if(|next| next.command() >= SYSTEM_COMMANDS) {
                return Served::Next(of_runtime);
            }
        }
        Served::Closed
    }
}
