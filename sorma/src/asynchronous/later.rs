//! The class `later`: requests whose answers are collected later, are wanted by nobody, or go to another
//! object.

use super::answer::{begin, mirror, request};
use super::tickets::Tickets;
use crate::ipc::answer::{int, not_yet, split};
use crate::object::{self, Context, Outcome, ServiceObject, Waiting};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::{Method, Request};
use crate::sorm::{Sorm, parse};
use crate::transport::Transport;
use std::sync::LazyLock;

#[derive(Debug, Clone)]
pub(super) struct Later {
    capacity: i64,
}

impl Default for Later {
    fn default() -> Self {
        Self { capacity: 100 }
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Later>> = LazyLock::new(|| {
    OptionTable::new(
        "asks other objects without waiting. EXEC ask 'REQUEST': IMSG 1 TICKET; collect TICKET: the answer as if it \
         had been asked here, or `not yet`; ready TICKET: IMSG 1, whether it is there; drop TICKET: it is done, but not \
         heard; open: the tickets with their objects; tell 'REQUEST': one-way, no answer; call 'REQUEST' OBJECT: OBJECT \
         is asked with EXEC and what was answered, unless that was an error",
    )
    .int(
        "capacity",
        1..=10_000,
        "",
        "the most answers that wait to be collected",
        |later: &mut Later| &mut later.capacity,
    )
});

#[derive(Default)]
pub(super) struct LaterObject {
    options: Later,
    tickets: Tickets,
}

impl LaterObject {
    fn ask(&mut self, cx: &Waiting<'_>, request: Request) -> Result<u64, Report> {
        self.tickets.room(self.options.capacity)?;
        let name = request.name.to_string();
        let deferred = cx.here().sorm().ask_later(cx.comm(), request)?;
        Ok(self.tickets.add(name, deferred))
    }

    async fn exec(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let words = split(&io.text)?;
        let from = io.from.clone();
        match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["ask", text] => {
                let ticket = self.ask(cx, request(text, &from)?)?;
                io.empty();
                io.ints.push(int(ticket));
            }
            ["collect", word] => match self.tickets.collect(word)? {
                None => not_yet(io),
                Some(reply) => mirror(io, reply.body),
            },
            ["ready", word] => {
                let ready = self.tickets.is_ready(word)?;
                io.empty();
                io.ints.push(i64::from(ready));
            }
            ["drop", word] => {
                self.tickets.drop(word)?;
                io.empty();
            }
            ["open"] => {
                io.empty();
                io.text = self.tickets.lines();
            }
            ["tell", text] => {
                let request = request(text, &from)?;
                let told = cx.here().sorm().tell_only(cx.comm(), request);
                told.await?;
                io.empty();
            }
            ["call", text, object] => {
                call_back(cx, request(text, &from)?, object)?;
                io.empty();
            }
            _ => {
                return Err(raise!(
                    general::VALUE,
                    "EXEC takes ask 'REQUEST', collect TICKET, ready TICKET, drop TICKET, open, tell 'REQUEST' or \
                     call 'REQUEST' OBJECT, not `{}`",
                    begin(&io.text)
                ));
            }
        }
        Ok(())
    }
}

/// Asks, and hands what is answered on to another object.
fn call_back(cx: &Waiting<'_>, request: Request, object: &str) -> Outcome {
    let object = parse(object)?;
    let sorm: Sorm = cx.here().sorm().clone();
    cx.comm().spawn(Box::new(move |comm| {
        Box::pin(async move {
            let from = request.body.from.clone();
            let reply = sorm.ask(&*comm, request).await;
            if !reply.body.is_ok() {
                return sorm.unheard(&reply.name, &reply.body);
            }
            let mut body = reply.body.from(from);
            body.reports.clear();
            let request = Request {
                name: object,
                method: Method::Exec,
                body,
            };
            let reply = sorm.ask(&*comm, request).await;
            sorm.unheard(&reply.name, &reply.body);
        })
    }))
}

impl ServiceObject for LaterObject {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> object::Later<'a> {
        Some(Box::pin(self.exec(cx, io)))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        let open = self.tickets.len();
        format!("{}\n{open} tickets open", OPTIONS.dump(&self.options))
    }
}
