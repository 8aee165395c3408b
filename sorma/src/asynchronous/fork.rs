//! The class `fork`: several requests at once, or with `-object` one object that is asked without waiting. It
//! is the `FORK.sound` of the SORMA technical report, section 2.1.2.

use super::answer::{begin, request};
use super::tickets::Tickets;
use crate::description::Form;
use crate::ipc::answer::{NOT_YET, int, split};
use crate::object::{self, Context, Outcome, ServiceObject, Waiting};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::request::{Method, Reply, Request};
use crate::sorm::parse;
use crate::transport::Transport;
use crate::words;
use std::sync::{Arc, LazyLock};
use tokio::sync::Semaphore;

/// No more requests than this in one.
const MOST: usize = 10_000;

#[derive(Debug, Clone)]
pub(super) struct Fork {
    object: String,
    width: i64,
    capacity: i64,
    /// What a CTRL request asks for besides options, before the object does any of it.
    orders: Vec<Order>,
}

impl Default for Fork {
    fn default() -> Self {
        Self {
            object: String::new(),
            width: 4,
            capacity: 100,
            orders: Vec::new(),
        }
    }
}

#[derive(Debug, Clone)]
enum Order {
    Collect(String),
    Drop(String),
    Open,
}

pub(super) static OPTIONS: LazyLock<OptionTable<Fork>> = LazyLock::new(|| {
    OptionTable::new(
        "asks several objects at once. EXEC 'REQUEST' 'REQUEST' ...: the replies, a line each in the order of the \
         requests; their floats in FMSG, one reply's after the other's; their return codes in IMSG; the first of these \
         that is not 0 is the answer's. With -object: EXEC with any data asks that object with EXEC and the same data, and \
         does not wait: IMSG 1 TICKET",
    )
    .exec(&[
        Form {
            text: "REQUEST ..",
            floats: 0,
            takes: "",
            gives: "the replies, a line each; their floats; their return codes in IMSG",
            results: "",
            help: "asks several objects at once",
        },
        Form {
            text: "",
            floats: Form::ANY,
            takes: "what the object takes",
            gives: "IMSG 1 TICKET",
            results: "",
            help: "with -object: asks that object, and does not wait",
        },
        Form {
            text: "TEXT",
            floats: Form::ANY,
            takes: "what the object takes",
            gives: "IMSG 1 TICKET",
            results: "",
            help: "with -object: asks that object, and does not wait",
        },
    ])
    .int(
        "width",
        1..=1000,
        "",
        "how many are under way at once; the others wait for their turn, in their order",
        |fork: &mut Fork| &mut fork.width,
    )
    .word(
        "object",
        "OBJECT",
        "which object EXEC asks, without waiting; empty: EXEC takes requests",
        |fork| &mut fork.object,
    )
    .int(
        "capacity",
        1..=10_000,
        "",
        "the most answers of -object that are kept; those that nobody collected give way, the oldest first",
        |fork| &mut fork.capacity,
    )
    .action(
        "collect",
        &["TICKET"],
        "the reply of that ticket as a line, or `not yet`",
        |fork, words| Ok(fork.order(Order::Collect(words.concat()))),
    )
    .action(
        "drop",
        &["TICKET"],
        "the reply of that ticket is not wanted",
        |fork, words| Ok(fork.order(Order::Drop(words.concat()))),
    )
    .action("open", &[], "the tickets with their objects", |fork, _| {
        Ok(fork.order(Order::Open))
    })
});

#[derive(Default)]
pub(super) struct ForkObject {
    options: Fork,
    tickets: Tickets,
    /// As many permits as may be under way, and how many these are.
    turns: Option<(i64, Arc<Semaphore>)>,
}

impl Fork {
    fn order(&mut self, order: Order) -> String {
        self.orders.push(order);
        String::new()
    }
}

impl ForkObject {
    /// Asks the object of the recipe, and answers the ticket.
    fn forward(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        let name = parse(&self.options.object)?;
        if name.class().eq_ignore_ascii_case("fork") {
            return Err(raise!(
                general::VALUE,
                "-object {name}: a fork forwards to an object that does the job, not to another fork"
            ));
        }
        let sorm = cx.here().sorm();
        while let Err(full) = self.tickets.room(self.options.capacity) {
            match self.tickets.oldest_answer() {
                Some(reply) => sorm.unheard(&reply.name, &reply.body),
                None => return Err(full),
            }
        }
        let mut body = Transport::default();
        body.inherit(io);
        body.take_data(std::mem::take(io));
        let (from, trace) = (body.from.clone(), body.trace);
        let called = name.to_string();
        let request = Request {
            name,
            method: Method::Exec,
            body,
        };
        let deferred = sorm.ask_in_turn(cx.comm(), request, self.turns())?;
        (io.from, io.trace) = (from, trace);
        io.ints.push(int(self.tickets.add(called, deferred)));
        Ok(())
    }

    /// Who may be under way. After a change of -width those that are under way do not count any more.
    fn turns(&mut self) -> Arc<Semaphore> {
        let width = self.options.width;
        match &self.turns {
            Some((of, turns)) if *of == width => Arc::clone(turns),
            _ => {
                let turns = Arc::new(Semaphore::new(usize::try_from(width).unwrap_or(1)));
                self.turns = Some((width, Arc::clone(&turns)));
                turns
            }
        }
    }

    fn obey(&mut self, order: &Order) -> Result<String, Report> {
        Ok(match order {
            Order::Collect(ticket) => match self.tickets.collect(ticket)? {
                Some(reply) => line(&reply),
                None => NOT_YET.to_owned(),
            },
            Order::Drop(ticket) => {
                self.tickets.drop(ticket)?;
                String::new()
            }
            Order::Open => self.tickets.lines(),
        })
    }

    async fn exec(&mut self, cx: &Waiting<'_>, io: &mut Transport) -> Outcome {
        if !self.options.object.is_empty() {
            return self.forward(cx, io);
        }
        // A text that is one quoted word has lost its quotes on the way.
        let words = match io.text.parse::<Request>() {
            Ok(_) => vec![io.text.clone()],
            Err(_) => split(&io.text)?,
        };
        if words.is_empty() || words.len() > MOST {
            return Err(raise!(
                general::VALUE,
                "EXEC takes 1 to {MOST} requests, each quoted as one word, not {}",
                words.len()
            ));
        }
        let from = io.from.clone();
        let requests = words.iter().map(|text| request(text, &from));
        let requests = requests.collect::<Result<Vec<Request>, Report>>()?;
        let width = usize::try_from(self.options.width).unwrap_or(1);
        let replies = cx.fork(requests, width, io).await;
        io.empty();
        let mut lines = Vec::new();
        for reply in replies {
            io.ints.push(i64::from(reply.body.code));
            io.floats.extend(&reply.body.floats);
            if io.code == 0 {
                io.code = reply.body.code;
            }
            lines.push(line(&reply));
        }
        io.text = lines.join("\n");
        Ok(())
    }
}

/// A reply as a line; its reports have gone to the caller, and opaque bytes have no text.
fn line(reply: &Reply) -> String {
    reply.to_text().unwrap_or_else(|error| {
        let code = reply.body.code;
        format!(
            "{} RET {code} {}",
            reply.name,
            words::quoted(&error.to_string())
        )
    })
}

impl ServiceObject for ForkObject {
    fn exec_waiting<'a>(
        &'a mut self,
        cx: &'a Waiting<'a>,
        io: &'a mut Transport,
    ) -> object::Later<'a> {
        if io.text.is_empty() && self.options.object.is_empty() {
            // Said by itself, so that it names the object's form.
            return Some(Box::pin(std::future::ready(Err(raise!(
                general::VALUE,
                "EXEC takes requests, each quoted as one word: `{} EXEC 'foo.a EXEC' 'bar EXEC'`",
                begin(cx.name())
            )))));
        }
        Some(Box::pin(self.exec(cx, io)))
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(&mut self.options, io);
        let orders = std::mem::take(&mut self.options.orders);
        if !io.is_ok() {
            return Ok(());
        }
        let mut answers = Vec::new();
        if !io.text.is_empty() {
            answers.push(std::mem::take(&mut io.text));
        }
        for order in &orders {
            let answer = self.obey(order)?;
            answers.extend(Some(answer).filter(|answer| !answer.is_empty()));
        }
        io.text = answers.join("\n");
        Ok(())
    }

    fn dump(&self) -> String {
        let open = self.tickets.len();
        format!("{}\n{open} tickets open", OPTIONS.dump(&self.options))
    }
}
