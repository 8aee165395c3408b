//! The class `later`: requests whose answers are collected later, are wanted by nobody, or go to another
//! object.

use super::answer::{begin, code, mirror, request};
use crate::ipc::answer::{int, not_yet, split};
use crate::later::Deferred;
use crate::object::{self, Context, Outcome, ServiceObject, Waiting};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::{Method, Reply, Request};
use crate::sorm::{Sorm, parse};
use crate::transport::Transport;
use std::collections::BTreeMap;
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
    last: u64,
    open: BTreeMap<u64, (String, Deferred<Reply>)>,
}

impl LaterObject {
    fn ask(&mut self, cx: &Waiting<'_>, request: Request) -> Result<u64, Report> {
        if self.open.len() >= usize::try_from(self.options.capacity).unwrap_or(0) {
            return Err(raise!(
                code::FULL,
                "{} answers wait to be collected already",
                self.open.len()
            ));
        }
        let name = request.name.to_string();
        let deferred = cx.here().sorm().ask_later(cx.comm(), request)?;
        self.last += 1;
        self.open.insert(self.last, (name, deferred));
        Ok(self.last)
    }

    fn ticket(&mut self, word: &str) -> Result<(u64, &mut Deferred<Reply>), Report> {
        let number: Option<u64> = word.parse().ok();
        let found = number.and_then(|number| {
            let (_, deferred) = self.open.get_mut(&number)?;
            Some((number, deferred))
        });
        found.ok_or_else(|| {
            raise!(
                code::UNKNOWN,
                "there is no ticket `{}`; it was collected or dropped, or never given",
                begin(word)
            )
        })
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
            ["collect", word] => {
                let (number, deferred) = self.ticket(word)?;
                match deferred.try_collect() {
                    None => not_yet(io),
                    Some(reply) => {
                        self.open.remove(&number);
                        mirror(io, reply.body);
                    }
                }
            }
            ["ready", word] => {
                let (_, deferred) = self.ticket(word)?;
                let ready = deferred.is_ready();
                io.empty();
                io.ints.push(i64::from(ready));
            }
            ["drop", word] => {
                let (number, _) = self.ticket(word)?;
                self.open.remove(&number);
                io.empty();
            }
            ["open"] => {
                let lines = self.open.iter();
                let lines = lines.map(|(ticket, (name, _))| format!("{ticket} {name}"));
                let lines = lines.collect::<Vec<_>>().join("\n");
                io.empty();
                io.text = lines;
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
        let open = self.open.len();
        format!("{}\n{open} tickets open", OPTIONS.dump(&self.options))
    }
}
