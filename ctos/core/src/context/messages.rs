//! Messages to other tasks, and what every task does with those that its handler does not know.

use std::time::Duration;

use super::{
    asking::{Ask, Call},
    core::Context,
};
use crate::{
    envelope::{Envelope, Message},
    handled::Handled,
    system::{CommandDescription, Introspect, NotQuiet, Ping, Shutdown, Statistics},
    tap::WaitFor,
    task_ref::TaskRef,
};
use ctos_message::{
    Command, CommandInfo, Data,
    fault::{CallError, Fault},
};

impl Context {
    /// Asks a task and waits for its reply. Ends with the reply or an error, always: 10 s after the
    /// call at the latest, unless [`Call::deadline`] or the task's `call_deadline_s` says otherwise.
    ///
    /// A request that its caller no longer waits for (the deadline passed, the call was dropped) is not
    /// begun any more, wherever the receiver runs.
    pub fn call<C: Command>(&self, to: &TaskRef, request: C) -> Call<C::Reply> {
        Call::new(self.ask(to, request, WaitFor::Reply), Ask::read)
    }

    /// Sends a message that needs no reply, and waits until the receiver's queue has taken it.
    /// A message that was given up before it was taken is not delivered.
    pub fn send<C: Command>(&self, to: &TaskRef, request: C) -> Call<()> {
        Call::new(self.ask(to, request, WaitFor::Acceptance), |_, _| Ok(()))
    }

    /// Sends only if the receiver is on this chassis and has a credit for it now.
    ///
    /// # Errors
    /// [`Fault::Full`], [`Fault::Elsewhere`] and the like, with both names.
    pub fn try_send<C: Command>(&self, to: &TaskRef, request: C) -> Result<(), CallError> {
        self.ask(to, request, WaitFor::Nothing).at_once()
    }

    /// Calls with bytes instead of types: the data of `command` and its reply are postcard. For nets
    /// and inspectors, which know commands by name only.
    ///
    /// # Errors
    /// As [`Self::call`].
    pub fn call_raw(
        &self,
        to: &TaskRef,
        command: CommandInfo,
        data: Vec<u8>,
        deadline: Duration,
    ) -> Call<Vec<u8>> {
        let message = self.message(to, command.code, Data::Bytes(data));
        let inner = self.inner.clone();
        let ask = Ask::new(inner, to, command.name, message, WaitFor::Reply);
        let read = |ask: &Ask, reply: Option<Box<Envelope>>| {
            let bytes = reply.map_or(Ok(Vec::new()), |reply| reply.data.into_bytes());
            bytes.map_err(|error| ask.misread(&error))
        };
        Call::new(ask, read).deadline(deadline)
    }

    /// [`Self::send`] with bytes instead of types, as [`Self::call_raw`].
    pub fn send_raw(&self, to: &TaskRef, command: CommandInfo, data: Vec<u8>) -> Call<()> {
        let message = self.message(to, command.code, Data::Bytes(data));
        let inner = self.inner.clone();
        let ask = Ask::new(inner, to, command.name, message, WaitFor::Acceptance);
        Call::new(ask, |_, _| Ok(()))
    }

    /// What every task does with a message that its handler does not know. It answers [`Ping`],
    /// [`Introspect`] and [`Statistics`], and refuses the rest by saying what the task takes. (A
    /// [`Shutdown`] does not come this far: the loop of the task carries it out.)
    ///
    /// # Errors
    /// Never; the result ends a handler.
    pub fn default_processing(&self, message: Message) -> Handled {
        match message.command() {
            Ping::CODE => {
                let (Ping {}, reply) = message.open::<Ping>()?;
                reply.ok(())
            }
            Introspect::CODE => {
                let (Introspect {}, reply) = message.open::<Introspect>()?;
                let describe = |command: &CommandInfo| CommandDescription {
                    code: command.code,
                    name: command.name.to_owned(),
                    doc: command.doc.to_owned(),
                };
                reply.ok(self.commands().iter().map(describe).collect())
            }
            Shutdown::CODE => {
                // Tasks of the configuration come to their end in their own loop.
                let (Shutdown {}, reply) = message.open::<Shutdown>()?;
                reply.fail("it belongs to the runtime and ends with its chassis")
            }
            NotQuiet::CODE => {
                let (NotQuiet {}, reply) = message.open::<NotQuiet>()?;
                reply.ok(self.not_quiet())
            }
            Statistics::CODE => {
                let (Statistics {}, reply) = message.open::<Statistics>()?;
                reply.ok(self.inner.record.statistics.read())
            }
            command => {
                tracing::warn!(task = %self.name(), command, from = %message.from(), "unknown command");
                if let Some(slot) = message.envelope.reply {
                    let names = self.commands().iter();
                    slot.answer(Err(Fault::UnknownCommand {
                        takes: names.map(|command| command.name.to_owned()).collect(),
                    }));
                }
                Ok(())
            }
        }
    }

    #[inline]
    fn ask<C: Command>(&self, to: &TaskRef, request: C, wait: WaitFor) -> Ask {
        let message = self.message(to, C::CODE, Data::of(request));
        Ask::new(self.inner.clone(), to, C::NAME, message, wait)
    }

    #[inline]
    fn message(&self, to: &TaskRef, command: u16, data: Data) -> Message {
        let from = self.inner.record.tid;
        Message::with_data(to.tid, from, command, data).in_trace(self.trace)
    }
}
