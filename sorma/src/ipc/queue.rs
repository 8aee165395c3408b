//! The class `queue`: messages that wait until they are taken, first in, first out (SORMA technical report,
//! section 1.7, "queuing requests and results").

use super::answer::{after, code, int, not_yet, number, seconds, split, wrong};
use super::tickets::{Tickets, Turn};
use crate::description::Form;
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::report::Report;
use crate::transport::Transport;
use ctos::time::Instant;
use std::collections::VecDeque;
use std::sync::LazyLock;
use std::time::Duration;

/// A bounded queue with a line of those who wait for items.
#[derive(Debug, Clone)]
pub(super) struct Queue {
    capacity: i64,
    items: VecDeque<Transport>,
    takers: Tickets<()>,
    put: u64,
    taken: u64,
}

impl Default for Queue {
    fn default() -> Self {
        Self {
            capacity: 100,
            items: VecDeque::new(),
            takers: Tickets::default(),
            put: 0,
            taken: 0,
        }
    }
}

impl Queue {
    fn put(&mut self, item: Transport) -> Result<(), Report> {
        if self.items.len() >= usize::try_from(self.capacity).unwrap_or(0) {
            let text = format!(
                "the queue is full with {} items; put it again later, or set -capacity",
                self.items.len()
            );
            return Err(Report::error(code::FULL, text));
        }
        self.items.push_back(item);
        self.put += 1;
        Ok(())
    }

    /// An item for somebody without a ticket: only when there are more than those who wait will take.
    fn take(&mut self) -> Option<Transport> {
        if self.items.len() <= self.takers.len() {
            return None;
        }
        self.pop()
    }

    fn pop(&mut self) -> Option<Transport> {
        let item = self.items.pop_front();
        self.taken += u64::from(item.is_some());
        item
    }

    fn wait(&mut self, now: Instant, limit: Duration) -> Result<u64, Report> {
        self.takers.draw((), now + limit).ok_or_else(|| {
            let text = format!("{} wait already; that is the most", self.takers.len());
            Report::error(code::FULL, text)
        })
    }

    fn claim(&mut self, ticket: u64) -> Result<Option<Transport>, Report> {
        match self.takers.ask(ticket, self.items.len()) {
            Turn::Now(()) => Ok(self.pop()),
            Turn::NotYet => Ok(None),
            Turn::None => {
                let text = format!("ticket {ticket} was used, given up, or not asked for in time");
                Err(Report::error(code::LATE, text))
            }
        }
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Queue>> = LazyLock::new(|| {
    OptionTable::new(
        "a queue. EXEC put [TEXT] with FMSG, IMSG, opaque: adds an item; take [SECONDS]: the oldest item, or \
         `not yet`, with IMSG 1 TICKET when there is a time to wait, with which claim TICKET asks again, in turn; \
         drop TICKET: waits no more; length: IMSG 2, items and those who wait",
    )
    .exec(&[
        Form {
            text: "put",
            floats: Form::ANY,
            takes: "the item",
            gives: "nothing",
            results: "",
            help: "adds an item",
        },
        Form {
            text: "put TEXT",
            floats: Form::ANY,
            takes: "the item",
            gives: "nothing",
            results: "",
            help: "adds an item",
        },
        Form {
            text: "take",
            floats: 0,
            takes: "",
            gives: "the oldest item, or `not yet`",
            results: "",
            help: "takes an item",
        },
        Form {
            text: "take SECONDS",
            floats: 0,
            takes: "",
            gives: "the oldest item, or `not yet` with IMSG 1 TICKET",
            results: "",
            help: "takes an item, or stands in line for so long",
        },
        Form {
            text: "claim TICKET",
            floats: 0,
            takes: "",
            gives: "the item, or `not yet`",
            results: "",
            help: "asks again, in turn",
        },
        Form {
            text: "drop TICKET",
            floats: 0,
            takes: "",
            gives: "nothing",
            results: "",
            help: "waits no more",
        },
        Form {
            text: "length",
            floats: 0,
            takes: "",
            gives: "IMSG 2: items, and those who wait",
            results: "",
            help: "tells how long it is",
        },
    ])
    .int(
        "capacity",
        1..=1_000_000,
        "",
        "the most items",
        |queue: &mut Queue| &mut queue.capacity,
    )
    .action("clear", &[], "throws all items away", |queue, _| {
        let count = queue.items.len();
        queue.items.clear();
        Ok(format!("{count} items thrown away"))
    })
});

/// Puts an item into the answer, or that there is none yet.
fn answer(io: &mut Transport, item: Option<Transport>) {
    match item {
        Some(item) => io.take_data(item),
        None => not_yet(io),
    }
}

impl ServiceObject for Queue {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let now = cx.sorm().now();
        self.takers.lapse(now, |()| false);
        let text = io.text.clone();
        let words = split(&text)?;
        match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["put", ..] => {
                self.put(Transport {
                    text: after(&text, 1)?,
                    floats: io.floats.clone(),
                    ints: io.ints.clone(),
                    opaque: io.opaque.to_own(),
                    ..Transport::default()
                })?;
                io.empty();
            }
            ["take"] => {
                let item = self.take();
                answer(io, item);
            }
            ["take", _] => {
                let limit = seconds(words.get(1))?;
                let item = self.take();
                let ticket = match item {
                    None if !limit.is_zero() => Some(self.wait(now, limit)?),
                    _ => None,
                };
                answer(io, item);
                io.ints.extend(ticket.map(int));
            }
            ["claim", ticket] => {
                let item = self.claim(number("a ticket", ticket)?)?;
                answer(io, item);
            }
            ["drop", ticket] => {
                let ticket = number("a ticket", ticket)?;
                // It is taken out of the line, even out of its turn.
                let _ = self.takers.ask(ticket, usize::MAX);
                io.empty();
            }
            ["length"] => {
                io.empty();
                io.ints.push(int(self.items.len() as u64));
                io.ints.push(int(self.takers.len() as u64));
            }
            _ => {
                return Err(wrong(format!(
                    "EXEC takes put [TEXT], take [SECONDS], claim TICKET, drop TICKET or length, not `{text}`"
                )));
            }
        }
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(self, io);
        Ok(())
    }

    fn dump(&self) -> String {
        format!(
            "{}\n{} items, {} put, {} taken, {} wait",
            OPTIONS.dump(self),
            self.items.len(),
            self.put,
            self.taken,
            self.takers.len()
        )
    }
}
