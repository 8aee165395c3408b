//! A message as a task gets it, and the right to answer it.

use std::{fmt, marker::PhantomData};

use serde::Serialize;

use crate::{handled::Handled, reply::ReplySlot, system::StopTask};
use ctos_message::{Command, Data, Flags, Header, PayloadError, Tid, fault::Fault};
use ctos_time::Instant;

/// What an event handler is called with.
#[derive(Debug)]
pub struct Message {
    /// A pointer: messages are passed on often, and wait in the futures of handlers.
    #[doc(hidden)]
    pub envelope: Box<Envelope>,
}

/// What a message consists of.
#[derive(Debug)]
pub struct Envelope {
    pub(crate) header: Header,
    pub(crate) trace: u64,
    /// Its number in the record; 0 when it is not in it.
    pub(crate) recorded: u64,
    pub(crate) deadline: Option<Instant>,
    pub data: Data,
    pub reply: Option<ReplySlot>,
}

impl Message {
    /// Ends the call that the message is. Without one, nothing comes of it.
    pub(crate) fn refuse(self, fault: Fault) {
        if let Some(slot) = self.envelope.reply {
            slot.answer(Err(fault));
        }
    }

    /// The right to tell its sender that the queue has taken it, if the sender waits for no more than that.
    pub(crate) fn take_acceptance(&mut self) -> Option<ReplySlot> {
        let replies = self.header().flags.contains(Flags::REPLY_WAIT);
        if replies {
            None
        } else {
            self.envelope.reply.take()
        }
    }

    /// Whether its sender waited for an answer, or for a credit, and does no more. A stop is carried out even when
    /// its sender had to go on.
    pub(crate) fn is_abandoned(&self) -> bool {
        let slot = self.envelope.reply.as_ref();
        self.command() != StopTask::CODE && slot.is_some_and(ReplySlot::is_abandoned)
    }

    /// The header.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.envelope.header
    }

    /// Who sent it.
    #[must_use]
    pub fn from(&self) -> Tid {
        self.envelope.header.from
    }

    /// The id that this message shares with whatever led to it and whatever follows from it.
    #[must_use]
    pub fn trace(&self) -> u64 {
        self.envelope.trace
    }

    /// When the sender stops waiting for the reply; `None` when it does not wait for one.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.envelope.deadline
    }

    /// Takes the typed request and the right to answer it.
    ///
    /// # Errors
    /// [`PayloadError`] when the data is not a `C`; the caller is answered with it.
    pub fn open<C: Command>(self) -> Result<(C, Replier<C>), PayloadError> {
        let mut envelope = self.envelope;
        match envelope.data.take_out::<C>() {
            Ok(request) => Ok((request, Replier::new(envelope))),
            Err(error) => {
                Self { envelope }.refuse(error.clone().into());
                Err(error)
            }
        }
    }

    /// Takes the postcard bytes of the request and the right to answer it, whatever it is: for what passes requests on.
    ///
    /// # Errors
    /// [`PayloadError`] when the data cannot be encoded; the caller is answered with it.
    pub fn open_raw(self) -> Result<(Vec<u8>, RawReplier), PayloadError> {
        let mut envelope = self.envelope;
        match std::mem::replace(&mut envelope.data, Data::NOTHING).into_bytes() {
            Ok(bytes) => Ok((bytes, RawReplier(envelope))),
            Err(error) => {
                Self { envelope }.refuse(error.clone().into());
                Err(error)
            }
        }
    }

    /// What the sender asks for.
    #[must_use]
    pub fn command(&self) -> u16 {
        self.envelope.header.command
    }
}

#[doc(hidden)]
impl Message {
    /// A request of `from` that nothing led to and that nobody waits for.
    pub fn request<T: Serialize + Send + 'static>(
        to: Tid,
        from: Tid,
        command: u16,
        value: T,
    ) -> Self {
        Self::with_data(to, from, command, Data::of(value))
    }

    /// [`Self::request`] with data of any kind.
    #[inline]
    pub fn with_data(to: Tid, from: Tid, command: u16, data: Data) -> Self {
        let header = Header {
            to,
            from,
            command,
            flags: Flags::NONE,
            size: 0,
        };
        let envelope = Box::new(Envelope {
            header,
            trace: 0,
            recorded: 0,
            deadline: None,
            data,
            reply: None,
        });
        Self { envelope }
    }

    /// The same with these flags instead.
    pub fn flagged(mut self, flags: Flags) -> Self {
        self.envelope.header.flags = flags;
        self
    }

    /// The same in this trace; 0 when nothing led to it: it then begins one of its own.
    pub fn in_trace(mut self, trace: u64) -> Self {
        self.envelope.trace = trace;
        self
    }

    /// The same with a moment at which the sender stops waiting.
    pub fn until(mut self, deadline: Option<Instant>) -> Self {
        self.envelope.deadline = deadline;
        self
    }
}

/// The right to answer one request, now or later. Dropped without an answer, it tells the caller so.
#[derive(Debug)]
pub struct Replier<C: Command> {
    /// That of the request, which takes the reply back.
    envelope: Box<Envelope>,
    command: PhantomData<fn() -> C>,
}

impl<C: Command> Replier<C> {
    fn new(envelope: Box<Envelope>) -> Self {
        Self {
            envelope,
            command: PhantomData,
        }
    }

    /// Answers with the reply. `Ok` so that it can end a handler; a one-way message needs no answer
    /// and gets none.
    ///
    /// # Errors
    /// Never.
    pub fn ok(mut self, reply: C::Reply) -> Handled {
        if self.envelope.reply.is_some() {
            self.envelope.data = Data::of(reply);
            ReplySlot::send_back(self.envelope);
        }
        Ok(())
    }

    /// Refuses: the caller gets [`Fault::Refused`] with `text`.
    ///
    /// # Errors
    /// Never.
    pub fn fail(self, text: impl fmt::Display) -> Handled {
        if let Some(slot) = self.envelope.reply {
            let text = text.to_string();
            slot.answer(Err(Fault::Refused { text }));
        }
        Ok(())
    }

    /// The task that sent the request.
    #[must_use]
    pub fn asker(&self) -> Tid {
        self.envelope.header.from
    }

    /// Whether the caller no longer waits (its deadline passed, or it is gone).
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        let slot = self.envelope.reply.as_ref();
        slot.is_some_and(ReplySlot::is_abandoned)
    }
}

/// The right to answer one request with the postcard bytes of its reply. Dropped without an answer, it tells the caller so.
#[derive(Debug)]
pub struct RawReplier(Box<Envelope>);

impl RawReplier {
    /// Answers with the bytes of the reply.
    pub fn ok(mut self, reply: Vec<u8>) {
        if self.0.reply.is_some() {
            self.0.data = Data::Bytes(reply);
            ReplySlot::send_back(self.0);
        }
    }

    /// Refuses: the caller gets [`Fault::Refused`] with `text`.
    pub fn fail(self, text: impl fmt::Display) {
        if let Some(slot) = self.0.reply {
            let text = text.to_string();
            slot.answer(Err(Fault::Refused { text }));
        }
    }

    /// Ends the request with the fault of another one, which it was passed on as.
    pub fn end(self, fault: Fault) {
        if let Some(slot) = self.0.reply {
            slot.answer(Err(fault));
        }
    }

    /// Whether anybody waits for an answer, or ever did.
    #[must_use]
    pub fn is_wanted(&self) -> bool {
        let slot = self.0.reply.as_ref();
        slot.is_some_and(|slot| !slot.is_abandoned())
    }
}
