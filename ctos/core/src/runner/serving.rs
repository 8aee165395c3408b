//! The messages of a task, one after the other: which are begun, who is told how each ended.

use crate::{
    contain::panic_text,
    context::Context,
    envelope::Message,
    handled::{Handled, HandlerError},
    handler::EventHandler,
    mailbox::queue::TaskQueue,
    reply,
    reply::ReplyKey,
    report::Ending as HandlerEnding,
    statistics::Activity,
    tap,
    tap::Asked,
    task_record::TaskRecord,
};
use ctos_message::{SYSTEM_COMMANDS, fault::Fault};
use std::{
    cell::Cell,
    future::{Future, poll_fn},
    panic::{AssertUnwindSafe, catch_unwind},
    pin::{Pin, pin},
    rc::Rc,
    sync::Arc,
    task::{Context as PollContext, Poll},
};

/// What the loop of a task needs besides its handler.
pub struct Serving {
    pub(super) cx: Context,
    pub(super) record: Arc<TaskRecord>,
    pub(super) activity: Arc<Activity>,
    pub(super) queue: Rc<TaskQueue>,
    /// It was told to stop: nothing more is begun, or hardware at rest would move again.
    pub(super) stopped: Cell<bool>,
}

/// Why the handling of a task's messages was interrupted.
pub enum Served {
    /// By a message that is not for the handler, or not for it alone.
    Next(Message),
    /// By a panic that said so.
    Panicked(String),
    /// By the end of the queue.
    Closed,
}

/// How the handling of one message ended.
pub(super) type Ended = Result<(), Bad>;

/// How the handling of one message ended otherwise than well.
pub(super) enum Bad {
    Refused(HandlerError),
    Panicked(String),
    /// By a message that ends whatever it does; whether because a part of it broke.
    Interrupted(bool),
}

/// The message that is being handled.
pub(super) struct AtHand {
    noted: tap::AtHand,
    pub(super) serial: u64,
    /// Whether an observer was shown its beginning.
    shown: bool,
    /// The answer that is owed.
    owed: Option<ReplyKey>,
}

impl Serving {
    /// Puts the next message that is to be handled into `next`; none once the queue is closed.
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
    fn is_wanted(&self, message: &Message) -> bool {
        !self.refuses(message) && !message.is_abandoned()
    }

    /// Ends a message that is not begun.
    fn pass_over(&self, message: Message) {
        let command = message.command();
        tracing::debug!(task = %self.cx.name(), command, "caller gave up, or the task is stopping");
        message.refuse(Fault::Stopping);
    }

    fn refuses(&self, message: &Message) -> bool {
        self.stopped.get() && message.command() < SYSTEM_COMMANDS
    }

    /// The handler is called with `message`: every message passes here on its way to a handler.
    pub(super) fn begin(&self, message: &mut Message) -> AtHand {
        let processor = self.cx.processor();
        let chassis = self.cx.chassis();
        let began = processor.recent();
        let serial = reply::next_serial();
        let owed = message.envelope.reply.as_mut().and_then(|slot| {
            slot.set_serial(serial);
            slot.key()
        });
        chassis.delivered(&self.record, message);
        let noted = tap::AtHand {
            id: message.envelope.recorded,
            asked: Asked::of(message),
            began,
        };
        let Asked { by, command, .. } = noted.asked;
        self.activity.begin(command, began);
        self.activity.recent.began(by, command, began);
        let observer = chassis.tap.observer();
        if let Some(observer) = observer {
            self.cx.inner.poll_is_told();
            observer.began(&noted);
        }
        AtHand {
            noted,
            serial,
            shown: observer.is_some(),
            owed,
        }
    }

    /// The handler has ended, in whatever way: what it owes is answered. What its panic said, if it
    /// panicked.
    pub(super) fn end(&self, at_hand: &mut AtHand, ended: Ended) -> Option<String> {
        let (noted, serial) = (at_hand.noted, at_hand.serial);
        let processor = self.cx.processor();
        let statistics = &self.activity;
        let now = processor.moment();
        statistics.end(ended.is_ok(), now.since(noted.began));
        let ending = || match &ended {
            Ok(()) => HandlerEnding::Done,
            Err(Bad::Refused(error)) => HandlerEnding::Refused(error.to_string()),
            Err(Bad::Panicked(text)) => HandlerEnding::Panicked(text.clone()),
            Err(Bad::Interrupted(_)) => HandlerEnding::Stopped,
        };
        statistics.recent.ended(noted.asked.command, now, ending);
        if let Some(observer) = self.cx.chassis().tap.observer().filter(|_| at_hand.shown) {
            self.cx.inner.note_poll();
            observer.ended(&noted, now, ending());
        }
        match ended {
            Ok(()) => {
                // A right to answer that it kept is still good; one that it dropped is not.
                drop(reply::take_orphan(serial).map(|mut slot| {
                    slot.set_serial(0);
                    slot
                }));
                None
            }
            Err(bad) => self.end_badly(at_hand, bad),
        }
    }

    /// The handler has ended otherwise than well.
    fn end_badly(&self, at_hand: &mut AtHand, bad: Bad) -> Option<String> {
        let Asked { by, command, .. } = at_hand.noted.asked;
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
        match (reply::take_orphan(at_hand.serial), at_hand.owed.take()) {
            (Some(slot), _) => slot.answer(Err(fault)),
            (None, Some(key)) => {
                let processors = &self.cx.chassis().processors;
                let home = processors.get(usize::from(by.processor()));
                if let Some((_, home)) = home {
                    key.answer(&**home, Err(fault));
                }
            }
            (None, None) => {}
        }
        panic
    }

    /// Polls a handler: to its end, its panic, or, if it is `interruptible`, an order to stop. With any of these it is
    /// dropped, while it is still at work: what it owes then is kept apart from what others owe.
    pub(super) fn poll<F: Future<Output = Handled>>(
        &self,
        at_hand: &AtHand,
        mut handling: Pin<&mut Option<F>>,
        interruptible: bool,
        cx: &mut PollContext<'_>,
    ) -> Poll<Ended> {
        let processor = self.cx.processor();
        processor.leave();
        let polled = self.activity.meter.in_poll(|| {
            catch_unwind(AssertUnwindSafe(|| {
                reply::handling(at_hand.serial, || {
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
        reply::handling(at_hand.serial, || handling.set(None));
        Poll::Ready(Err(bad))
    }

    /// See [`DynHandler::serve`].
    pub(crate) async fn serve<H: EventHandler>(&self, handler: &mut H, first: Message) -> Served {
        let mut next = Some(first);
        // One context serves message after message.
        let mut cx = self.cx.within(0);
        while let Some(mut message) = next.take() {
            let mut at_hand = self.begin(&mut message);
            cx.set_trace(message.trace());
            let ended = {
                let mut handling = pin!(Some(EventHandler::handle(handler, &cx, message)));
                poll_fn(|poll| self.poll(&at_hand, handling.as_mut(), true, poll)).await
            };
            if let Some(panic) = self.end(&mut at_hand, ended) {
                return Served::Panicked(panic);
            }
            next = self.next().await;
            if let Some(of_runtime) = next.take_if(|next| next.command() >= SYSTEM_COMMANDS) {
                return Served::Next(of_runtime);
            }
        }
        Served::Closed
    }
}
