//! Calls and sends: futures that wait at the processor of their task, and take back what they asked when
//! they are dropped.

use std::{
    cell::RefCell,
    future::{Future, IntoFuture},
    marker::PhantomData,
    pin::Pin,
    rc::Rc,
    sync::Arc,
    task::{Context as PollContext, Poll},
    time::Duration,
};

use futures_util::future::LocalBoxFuture;

use super::{Context, Inner, TaskRef};
use crate::{
    call::{CallError, Fault},
    chassis::{Called, CalledBeside, Outbound, Question, Sent},
    circle,
    exchange::{Brought, CallKey, Looked},
    message::{Command, Data, Flags, Letter, Message, PayloadError, Tid},
    record::Asked,
    time::Instant,
};

/// A call that has not been made yet; `.await` makes it.
#[must_use = "a call is made when it is awaited"]
pub struct Call<C: Command> {
    pub(super) asker: Rc<Inner>,
    pub(super) message: Message,
    pub(super) command: PhantomData<fn(C) -> C::Reply>,
}

impl<C: Command> Call<C> {
    /// Waits at most this long for the reply.
    #[inline]
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.message.letter.limit = deadline;
        self
    }

    /// Overtakes messages of normal priority in the receiver's queue.
    pub fn high_priority(mut self) -> Self {
        let flags = self.message.header().flags.with(Flags::HIGH_PRIORITY);
        self.message = self.message.flagged(flags);
        self
    }
}

impl<C: Command> IntoFuture for Call<C> {
    type Output = Result<C::Reply, CallError>;
    type IntoFuture = Calling<C>;

    #[inline]
    fn into_future(self) -> Calling<C> {
        Calling {
            ask: Ask::new(self.asker, self.message),
            command: PhantomData,
        }
    }
}

/// A call under way. Dropped before its end, it tells the receiver that nobody waits.
#[must_use = "a call is made when it is awaited"]
pub struct Calling<C: Command> {
    ask: Ask,
    command: PhantomData<fn(C) -> C::Reply>,
}

impl<C: Command> Unpin for Calling<C> {}

impl<C: Command> Future for Calling<C> {
    type Output = Result<C::Reply, CallError>;

    #[inline]
    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        let Self { ask, .. } = self.get_mut();
        match ask.begin(C::NAME) {
            // One arm for each end: what is passed on in one piece is moved, however little of it there is.
            Ok(Some(letter)) => match letter.take::<C::Reply>() {
                Ok(reply) => Poll::Ready(Ok(reply)),
                Err(error) => Poll::Ready(Err(ask.misread(C::NAME, &error))),
            },
            Ok(None) => Self::look(ask, poll),
            Err(error) => Poll::Ready(Err(*error)),
        }
    }
}

impl<C: Command> Calling<C> {
    /// Looks for the answer.
    #[inline(never)]
    fn look(ask: &mut Ask, poll: &mut PollContext<'_>) -> Poll<<Self as Future>::Output> {
        let mut reply = None;
        let mut open = |letter: Box<Letter>| {
            let taken = letter.take::<C::Reply>();
            reply = Some(taken.map_err(|error| bad_reply(&error))?);
            Ok(())
        };
        let ended = std::task::ready!(ask.poll(poll, C::NAME, &mut open));
        ended.map_err(|error| *error)?;
        // It was opened, or there would be an error.
        reply.map_or(Poll::Pending, |reply| Poll::Ready(Ok(reply)))
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
        self.call.message.letter.limit = deadline;
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
        Sending {
            ask: Ask::new(self.call.asker, self.call.message),
            command: PhantomData,
        }
    }
}

/// A one-way message under way. Dropped before it is taken, it is not delivered.
#[must_use = "a message is sent when it is awaited"]
pub struct Sending<C: Command> {
    ask: Ask,
    command: PhantomData<fn(C)>,
}

impl<C: Command> Unpin for Sending<C> {}

impl<C: Command> Future for Sending<C> {
    type Output = Result<(), CallError>;

    fn poll(self: Pin<&mut Self>, poll: &mut PollContext<'_>) -> Poll<Self::Output> {
        let Self { ask, .. } = self.get_mut();
        let ended = match ask.begin_send(C::NAME) {
            Poll::Ready(ended) => Poll::Ready(ended),
            Poll::Pending => ask.poll(poll, C::NAME, &mut |letter| {
                letter.open();
                Ok(())
            }),
        };
        ended.map_err(|error| *error)
    }
}

/// Who asked whom for what. Kept with the call, so that it can be shown while it waits.
pub(crate) struct Note {
    asker: Rc<Inner>,
    /// The asked task: as its caller names it, and its id; see [`Inner::name_to_keep`].
    to: Option<Arc<str>>,
    named: Tid,
    command: &'static str,
    asked: Asked,
    /// The message's number in the record.
    recorded: u64,
    /// Where it is shown.
    place: Option<usize>,
}

impl Inner {
    /// The name of a task that is about to be asked, for the error that may come, unless the processor knows
    /// it: those of tasks of its chassis it keeps, so that a call needs no share of the name.
    #[inline(always)]
    pub(super) fn name_to_keep(&self, to: &TaskRef) -> Option<Arc<str>> {
        if self.record.tid.is_beside(to.tid) && self.processor.knows_name(to.tid.slot(), &to.name) {
            None
        } else {
            self.far_name_to_keep(to)
        }
    }

    #[inline(never)]
    fn far_name_to_keep(&self, to: &TaskRef) -> Option<Arc<str>> {
        let (own, tid) = (self.record.tid, to.tid);
        let known = own.chassis() == tid.chassis()
            && !own.is_beside(tid)
            && self.processor.knows_far_name(tid, &to.name);
        if known { None } else { Some(to.name.clone()) }
    }

    /// The name of a task that was asked.
    #[cold]
    fn name_of(&self, kept: Option<&Arc<str>>, asked: Tid) -> Arc<str> {
        let known = || {
            if self.record.tid.processor() == asked.processor() {
                self.processor.known_name(asked.slot())
            } else {
                self.processor.far_name(asked)
            }
        };
        // One or the other is there.
        kept.cloned().or_else(known).unwrap_or_else(|| "".into())
    }
}

impl Note {
    /// The asked task.
    pub(crate) fn to(&self) -> Tid {
        self.asked.to()
    }

    /// Shows the call to whoever wants to know what its task waits for.
    pub(crate) fn show(&mut self, since: Instant) {
        if self.place.is_none() {
            let waits = &self.asker.record.statistics.activity().waits;
            let to = self.asker.name_of(self.to.as_ref(), self.named);
            self.place = Some(waits.begin(to, self.asked.to(), self.command, since));
        }
    }
}

impl Drop for Note {
    #[inline]
    fn drop(&mut self) {
        if let Some(place) = self.place {
            self.asker.record.statistics.activity().waits.end(place);
        }
    }
}

/// Waits for an answer; dropped before, it takes the question back.
pub(super) struct Ask {
    asker: Rc<Inner>,
    /// Whom it asks.
    named: Tid,
    /// The message, until it is sent.
    message: Option<Message>,
    /// The question, from then until there is an answer.
    waits: Option<Waits>,
    /// Whether it has been looked for in vain.
    waited: bool,
}

/// The search for a circle of tasks that wait for one another; see `circle.rs`.
enum Circle {
    LookedFor(LocalBoxFuture<'static, Option<String>>),
    Found(Option<String>),
}

/// A question under way.
struct Waits {
    key: CallKey,
    /// The way to take it back when it went over a link.
    outbound: Option<Outbound>,
    /// Set once it has waited long. Shared with nobody: but what ends a shared value is no part of the code that
    /// ends each call.
    circle: Option<Rc<RefCell<Circle>>>,
}

impl Waits {
    fn new(key: CallKey, outbound: Option<Outbound>) -> Self {
        Self {
            key,
            outbound,
            circle: None,
        }
    }
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
    /// Will send this.
    #[inline]
    pub(super) fn new(asker: Rc<Inner>, message: Message) -> Self {
        Self {
            asker,
            named: Tid::default(),
            message: Some(message),
            waits: None,
            waited: false,
        }
    }

    /// Makes the call, if that has not been done yet. The answer, if it is there at once.
    ///
    /// # Errors
    /// When there is no time at all for it.
    pub(super) fn begin(
        &mut self,
        command: &'static str,
    ) -> Result<Option<Box<Letter>>, Box<CallError>> {
        let Some(message) = self.message.take() else {
            return Ok(None);
        };
        let limit = message.letter.limit;
        // Otherwise the processor does not know the name, or there is no time.
        if message.letter.to.is_some() || limit.is_zero() {
            return self.begin_in_turn(command, message);
        }
        self.named = message.header().to;
        let asker = &*self.asker;
        let meter = &asker.record.statistics.activity().meter;
        let (chassis, processor) = (&asker.chassis, &asker.processor);
        match chassis.call_beside(processor, message, limit, meter) {
            CalledBeside::Answered(letter) => Ok(Some(letter)),
            CalledBeside::Begun(key, asked) => {
                self.wait(command, key, asked);
                Ok(None)
            }
            CalledBeside::Unmade(message) => self.begin_in_turn(command, message),
        }
    }

    /// The call has been begun with, and waits.
    #[inline(never)]
    fn wait(&mut self, command: &'static str, key: CallKey, asked: Asked) {
        let Self { asker, named, .. } = self;
        let processor = &asker.processor;
        processor.note_call(key, true, || Note {
            asker: asker.clone(),
            to: None,
            named: *named,
            command,
            asked,
            recorded: 0,
            place: None,
        });
        processor.time_call(key);
        processor.leave();
        self.waits = Some(Waits::new(key, None));
    }

    /// [`Self::begin`] when it takes more than a turn of a task beside.
    #[inline(never)]
    fn begin_in_turn(
        &mut self,
        command: &'static str,
        mut message: Message,
    ) -> Result<Option<Box<Letter>>, Box<CallError>> {
        let asker = &self.asker;
        let to = message.letter.take_to();
        let (named, limit) = (message.header().to, message.letter.limit);
        if limit == Duration::ZERO {
            let fault = Fault::Deadline { after: limit };
            let name = asker.name_of(to.as_ref(), named);
            return Err(Box::new(call_error(asker, &name, command, fault)));
        }
        // The processor knows the name.
        let spared = to.is_none();
        let note = |asked, recorded| Note {
            asker: asker.clone(),
            to,
            named,
            command,
            asked,
            recorded,
            place: None,
        };
        let meter = &asker.record.statistics.activity().meter;
        let called = asker
            .chassis
            .call(&asker.processor, message, limit, meter, spared, note);
        self.named = named;
        match called {
            Called::Answered(letter) => Ok(Some(letter)),
            Called::Waits(key, outbound) => {
                self.waits = Some(Waits::new(key, outbound));
                Ok(None)
            }
        }
    }

    /// What came of opening an answer that was there at once.
    ///
    /// # Errors
    /// What was wrong with it.
    pub(super) fn opened(
        &self,
        command: &'static str,
        opened: Result<(), Fault>,
    ) -> Result<(), Box<CallError>> {
        opened.map_err(|fault| {
            let to = self.asker.name_of(None, self.named);
            Box::new(call_error(&self.asker, &to, command, fault))
        })
    }

    /// The error of an answer that was there at once and is not what it should be.
    #[cold]
    fn misread(&self, command: &'static str, error: &PayloadError) -> CallError {
        let to = self.asker.name_of(None, self.named);
        call_error(&self.asker, &to, command, bad_reply(error))
    }

    /// Sends the message, if that has not been done yet. Pending when its end is still to come.
    fn begin_send(&mut self, command: &'static str) -> Poll<Result<(), Box<CallError>>> {
        let Some(mut message) = self.message.take() else {
            return Poll::Pending;
        };
        let asker = &self.asker;
        let to = message.letter.take_to();
        let (named, limit) = (message.header().to, message.letter.limit);
        match asker.chassis.send(&asker.processor, message, limit) {
            Sent::Ended(Ok(())) => Poll::Ready(Ok(())),
            Sent::Ended(Err(fault)) => {
                let name = asker.name_of(to.as_ref(), named);
                let error = call_error(asker, &name, command, fault);
                Poll::Ready(Err(Box::new(error)))
            }
            Sent::Waits(question) => {
                let Question {
                    key,
                    outbound,
                    recorded,
                    asked,
                } = question;
                asker.processor.note_call(key, false, || Note {
                    asker: asker.clone(),
                    to,
                    named,
                    command,
                    asked,
                    recorded,
                    place: None,
                });
                self.waits = Some(Waits::new(key, outbound));
                Poll::Pending
            }
        }
    }

    /// Looks for the answer to `command`; `open` is given it, if there is one, and says what is wrong
    /// with it.
    pub(super) fn poll(
        &mut self,
        poll: &mut PollContext<'_>,
        command: &'static str,
        open: &mut dyn FnMut(Box<Letter>) -> Result<(), Fault>,
    ) -> Poll<Result<(), Box<CallError>>> {
        let Some(waits) = &mut self.waits else {
            // Polled after its end, which is the fault of whoever polls.
            return Poll::Pending;
        };
        let mut note = None;
        let fault = match self.asker.processor.poll_call(waits.key, &mut note, poll) {
            Looked::Ended(Brought::Data(letter)) => {
                if let Some(note) = &note {
                    self.tell(note, Ok(&letter.data));
                }
                self.waits = None;
                match open(letter) {
                    Ok(()) => return Poll::Ready(Ok(())),
                    Err(fault) => fault,
                }
            }
            Looked::Waiting => {
                self.waited = true;
                if let Some(circle) = &waits.circle {
                    circle.borrow_mut().poll(poll);
                }
                return Poll::Pending;
            }
            Looked::Long(to) => {
                self.waited = true;
                self.look_for_circle(to, poll);
                return Poll::Pending;
            }
            Looked::Ended(Brought::Fault(fault)) => self.failed(note.as_ref(), *fault),
            Looked::Late(after) => self.late(note.as_ref(), after),
        };
        let to = match &note {
            Some(note) => self.asker.name_of(note.to.as_ref(), note.named),
            None => self.asker.name_of(None, self.named),
        };
        let error = call_error(&self.asker, &to, command, fault);
        Poll::Ready(Err(Box::new(error)))
    }

    /// Tells whoever records what came of it.
    #[inline]
    fn tell(&self, note: &Note, answer: Result<&Data, &Fault>) {
        let Inner {
            chassis, processor, ..
        } = &*self.asker;
        let Note {
            asked, recorded, ..
        } = note;
        if !chassis.tap.is_on() {
            return;
        }
        // An answer of the same processor was there before the last look.
        let to = asked.to();
        let beside = to.chassis() == chassis.index() && chassis.is_on(to, processor);
        let at = if answer.is_ok() && beside {
            processor.seen_at()
        } else {
            let now = processor.look_within();
            processor.leave();
            now
        };
        if self.waited {
            chassis.tap.answered(*recorded, asked, at, answer);
        } else {
            chassis.tap.answered_at_once(*recorded, asked, at, answer);
        }
    }

    #[cold]
    fn look_for_circle(&mut self, to: Tid, poll: &mut PollContext<'_>) {
        let cx = Context {
            inner: self.asker.clone(),
            trace: 0,
        };
        let mut circle = Circle::LookedFor(Box::pin(circle::look(cx, to)));
        circle.poll(poll);
        if let Some(waits) = &mut self.waits {
            waits.circle = Some(Rc::new(RefCell::new(circle)));
        }
    }

    #[cold]
    fn late(&mut self, note: Option<&Note>, after: Duration) -> Fault {
        let circle = self.waits.as_mut().and_then(|waits| waits.circle.take());
        let found = match circle.map(|circle| circle.replace(Circle::Found(None))) {
            Some(Circle::Found(found)) => found,
            _ => None,
        };
        let fault = match found {
            Some(circle) => Fault::Circle { after, circle },
            None => Fault::Deadline { after },
        };
        self.failed(note, fault)
    }

    /// Nobody waits for the answer any more.
    #[cold]
    fn give_up(&mut self) {
        if let Some(waits) = self.waits.take() {
            self.asker.processor.give_up_call(waits.key);
            if let Some(outbound) = waits.outbound {
                self.asker.chassis.abandon(outbound);
            }
        }
    }

    /// It came to nothing.
    #[cold]
    fn failed(&mut self, note: Option<&Note>, fault: Fault) -> Fault {
        let waits = self.waits.take();
        if let Some(note) = note {
            self.tell(note, Err(&fault));
        }
        if let Some(waits) = waits
            && let Some(outbound) = waits.outbound
            && matches!(fault, Fault::Deadline { .. } | Fault::Circle { .. })
        {
            self.asker.chassis.abandon(outbound);
        }
        fault
    }
}

#[cold]
fn bad_reply(error: &PayloadError) -> Fault {
    Fault::BadPayload {
        text: format!("its reply: {error}"),
    }
}

/// The error that `fault` makes of a call.
#[cold]
fn call_error(asker: &Inner, to: &str, command: &str, fault: Fault) -> CallError {
    let error = CallError {
        from: asker.record.name.to_string(),
        to: to.to_owned(),
        command: command.to_owned(),
        fault,
    };
    if error.is_gone() {
        asker.chassis.directory.forget(to);
    }
    error
}

impl Drop for Ask {
    #[inline]
    fn drop(&mut self) {
        if self.waits.is_some() {
            self.give_up();
        }
    }
}
