//! The class `semaphore`: a counting semaphore for those that are no tasks: programs, scripts, people at an
//! inspector, other daemons. Tasks of an app have `ctos::semaphore`, which wakes them.
//!
//! A permit is held under a number, for somebody with a name. When a process was named, it is held only as
//! long as that process of this host runs. A holder that died without releasing is noticed with the next
//! request.

use super::answer::{NOT_YET, code, int, number, seconds, split, wrong};
use super::host::Host;
use super::tickets::{Tickets, Turn};
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::report::Report;
use crate::transport::Transport;
use ctos::time::Instant;
use sorma_snapshot::process::Process;
use std::fmt::Write as _;
use std::sync::LazyLock;

/// Somebody who holds a permit or waits for one.
#[derive(Debug, Clone, PartialEq)]
struct Holder {
    who: String,
    process: Option<Process>,
}

impl Holder {
    fn is_gone(&self) -> bool {
        self.process.is_some_and(|process| !process.is_alive())
    }
}

#[derive(Debug, Clone)]
struct Hold {
    number: u64,
    holder: Holder,
    since: Instant,
}

#[derive(Debug, Clone)]
pub(super) struct Semaphore {
    permits: i64,
    holds: Vec<Hold>,
    waiting: Tickets<Holder>,
    last: u64,
}

impl Default for Semaphore {
    fn default() -> Self {
        Self {
            permits: 1,
            holds: Vec::new(),
            waiting: Tickets::default(),
            last: 0,
        }
    }
}

impl Semaphore {
    fn free(&self) -> usize {
        let permits = usize::try_from(self.permits).unwrap_or(0);
        permits.saturating_sub(self.holds.len())
    }

    /// Takes permits back from processes that have ended; answers whose.
    fn bury(&mut self, now: Instant) -> Vec<String> {
        self.waiting.lapse(now, Holder::is_gone);
        let gone = self.holds.extract_if(.., |hold| hold.holder.is_gone());
        gone.map(|hold| hold.holder.who).collect()
    }

    fn grant(&mut self, holder: Holder, now: Instant) -> u64 {
        self.last += 1;
        self.holds.push(Hold {
            number: self.last,
            holder,
            since: now,
        });
        self.last
    }

    /// Gives back all that those have who are gone.
    fn forget(&mut self, now: Instant, gone: impl Fn(&str) -> bool) {
        self.holds.retain(|hold| !gone(&hold.holder.who));
        self.waiting.lapse(now, |holder| gone(&holder.who));
    }

    fn held_by(&self, now: Instant) -> String {
        let mut text = String::new();
        for hold in &self.holds {
            let since = now.since(hold.since).as_secs_f64();
            // Writing to a `String` cannot fail.
            let _ = writeln!(
                text,
                "hold {}: {} for {since:.3} s",
                hold.number, hold.holder.who
            );
        }
        for (ticket, holder) in self.waiting.iter() {
            let _ = writeln!(text, "ticket {ticket}: {} waits", holder.who);
        }
        text
    }
}

pub(super) static OPTIONS: LazyLock<OptionTable<Semaphore>> = LazyLock::new(|| {
    OptionTable::new(
        "a counting semaphore. EXEC acquire [WHO [SECONDS [PID]]], the caller when it says no WHO: IMSG 1 HOLD, or `not yet` with IMSG 1 TICKET when \
         there is a time to wait, with which claim TICKET asks again, in turn; release HOLD; drop TICKET: waits no \
         more; forget WHO: gives back all that WHO has; free: IMSG 2, free permits and those who wait; holders. \
         What is held for process PID of this host is given back when that ends",
    )
    .int(
        "permits",
        1..=1_000_000,
        "",
        "how many may hold it at once",
        |semaphore: &mut Semaphore| &mut semaphore.permits,
    )
});

pub(super) struct SemaphoreObject {
    host: Host,
    semaphore: Semaphore,
}

impl SemaphoreObject {
    pub(super) fn new(host: Host) -> Self {
        Self {
            host,
            semaphore: Semaphore::default(),
        }
    }

    fn acquire(&mut self, words: &[String], now: Instant, io: &mut Transport) -> Outcome {
        let who = words.first().unwrap_or(&io.from);
        if who.is_empty() {
            return Err(wrong("acquire takes the name of whoever wants the permit"));
        }
        let limit = seconds(words.get(1))?;
        let process = words.get(2).map(|pid| living(pid)).transpose()?;
        let holder = Holder {
            who: who.clone(),
            process,
        };
        let semaphore = &mut self.semaphore;
        io.empty();
        if semaphore.free() > semaphore.waiting.len() {
            io.ints.push(int(semaphore.grant(holder, now)));
        } else {
            NOT_YET.clone_into(&mut io.text);
            if !limit.is_zero() {
                let ticket = semaphore.waiting.draw(holder, now + limit).ok_or_else(|| {
                    let text = "too many wait already; try again later";
                    Report::error(code::FULL, text)
                })?;
                io.ints.push(int(ticket));
            }
        }
        Ok(())
    }

    fn claim(&mut self, ticket: u64, now: Instant, io: &mut Transport) -> Outcome {
        let semaphore = &mut self.semaphore;
        io.empty();
        match semaphore.waiting.ask(ticket, semaphore.free()) {
            Turn::Now(holder) => io.ints.push(int(semaphore.grant(holder, now))),
            Turn::NotYet => NOT_YET.clone_into(&mut io.text),
            Turn::None => {
                let held = semaphore.held_by(now);
                let text = format!(
                    "ticket {ticket} was used, given up, or not asked for in time; {}",
                    held.trim_end().replace('\n', "; ")
                );
                return Err(Report::error(code::LATE, text));
            }
        }
        Ok(())
    }

    fn release(&mut self, hold: u64, io: &mut Transport) -> Outcome {
        let holds = &mut self.semaphore.holds;
        let Some(place) = holds.iter().position(|one| one.number == hold) else {
            let text = format!("nobody has hold {hold}; it was released, or its process has ended");
            return Err(Report::error(code::UNKNOWN, text));
        };
        holds.remove(place);
        io.empty();
        Ok(())
    }
}

fn living(pid: &str) -> Result<Process, Report> {
    let number: Option<u32> = pid.parse().ok();
    number
        .and_then(Process::running)
        .ok_or_else(|| wrong(format!("`{pid}` is no process of this host")))
}

impl ServiceObject for SemaphoreObject {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let words = split(&io.text)?;
        let now = self.host.now();
        for who in self.semaphore.bury(now) {
            let text = format!("{who} has ended without releasing; the permit is free again");
            io.report(Report::verbose(text));
        }
        match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["acquire", ..] if words.len() <= 4 => {
                self.acquire(words.get(1..).unwrap_or_default(), now, io)
            }
            ["claim", ticket] => {
                number("a ticket", ticket).and_then(|ticket| self.claim(ticket, now, io))
            }
            ["release", hold] => number("a hold", hold).and_then(|hold| self.release(hold, io)),
            ["drop", ticket] => number("a ticket", ticket).map(|ticket| {
                // It is taken out of the line, even out of its turn.
                let _ = self.semaphore.waiting.ask(ticket, usize::MAX);
                io.empty();
            }),
            ["forget", who] => {
                self.semaphore.forget(now, |holder| holder == who);
                io.empty();
                Ok(())
            }
            ["free"] => {
                io.empty();
                io.ints.push(int(self.semaphore.free() as u64));
                io.ints.push(int(self.semaphore.waiting.len() as u64));
                Ok(())
            }
            ["holders"] => {
                io.empty();
                io.text = self.semaphore.held_by(now).trim_end().to_owned();
                Ok(())
            }
            _ => Err(wrong(format!(
                "EXEC takes acquire [WHO [SECONDS [PID]]], claim TICKET, release HOLD, drop TICKET, forget WHO, \
                 free or holders, not `{}`",
                io.text
            ))),
        }
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        OPTIONS.ctrl(&mut self.semaphore, io);
        Ok(())
    }

    fn forget(&mut self, gone: &dyn Fn(&str) -> bool) -> bool {
        let now = self.host.now();
        self.semaphore.forget(now, gone);
        false
    }

    fn dump(&self) -> String {
        let held = self.semaphore.held_by(self.host.now());
        format!("{}\n{held}", OPTIONS.dump(&self.semaphore))
            .trim_end()
            .to_owned()
    }
}
