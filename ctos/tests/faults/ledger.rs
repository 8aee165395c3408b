//! What the tasks of the app did and saw, written down by themselves while they run. One number counts
//! all entries, so that what happened before what is known exactly.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use ctos::{
    call::Fault,
    message::Tid,
    task::{Context, Phase},
    time::{Clock, Instant},
};

/// A message on its way: a call, or one that is only sent.
#[derive(Debug, Clone)]
pub struct Sent {
    pub from: String,
    pub to: String,
    /// Its number among those of the same pair and priority.
    pub number: u64,
    pub urgent: bool,
    pub is_call: bool,
    /// On the same chassis.
    pub near: bool,
    /// When it was sent, by the sender's clock and in true time, and how long its sender waits.
    pub began: Instant,
    pub began_true: Instant,
    pub deadline: Duration,
    /// How it ended for the sender: when by its clock, at which entry, and with what.
    pub ended: Option<(Instant, u64, Result<(), Fault>)>,
    pub ended_true: Option<Instant>,
    /// The entry at which its receiver began with it.
    pub begun: Option<u64>,
}

/// A task enters a phase, or acknowledges it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    Enters,
    Entered,
}

#[derive(Default)]
pub struct Book {
    pub entries: u64,
    pub sent: Vec<Sent>,
    numbers: BTreeMap<(String, String, bool), u64>,
    last_begun: BTreeMap<(String, String, bool), u64>,
    /// Urgent messages that a receiver has taken, as their senders know, and not begun.
    urgent: BTreeMap<String, BTreeSet<usize>>,
    pub tids: BTreeMap<String, BTreeSet<Tid>>,
    /// Tasks whose handler has panicked and not been built anew.
    pub broken: BTreeSet<String>,
    /// The id with which each task was built last.
    built: BTreeMap<String, Tid>,
    pub incarnations: BTreeMap<String, u32>,
    /// Task, incarnation, phase, step, in order.
    pub phases: Vec<(String, u32, Phase, Step)>,
    /// When each task was told to stop, in true time.
    pub stops: BTreeMap<String, Instant>,
    pub alive: i64,
    pub token: Option<u64>,
    /// Nobody begins anything new any more.
    pub quiet: bool,
    /// Tasks that still send or call.
    pub active: BTreeSet<String>,
    pub wrong: Vec<String>,
    /// When the app began to stop, in true time.
    pub stopping: Option<Instant>,
    pub running: bool,
    /// Chassis that failed, and when their processes were dead, in true time.
    pub failures: Vec<(String, Option<Instant>)>,
    /// Chassis that came back.
    pub returned: usize,
}

#[derive(Clone)]
pub struct Ledger {
    book: Arc<Mutex<Book>>,
    pub clock: Clock,
}

impl Ledger {
    pub fn new(clock: Clock) -> Self {
        Self {
            book: Arc::default(),
            clock,
        }
    }

    pub fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap()
    }

    /// A task sends; the number goes with the message.
    pub fn sends(
        &self,
        cx: &Context,
        to: &ctos::task::TaskRef,
        urgent: bool,
        deadline: Duration,
        is_call: bool,
    ) -> u64 {
        let mut book = self.book();
        let (from, near) = (
            cx.name().to_owned(),
            cx.tid().chassis() == to.tid().chassis(),
        );
        let to = to.name().to_owned();
        let number = book
            .numbers
            .entry((from.clone(), to.clone(), urgent))
            .or_default();
        *number += 1;
        let number = *number;
        book.sent.push(Sent {
            from,
            to,
            number,
            urgent,
            is_call,
            near,
            began: cx.now(),
            began_true: self.clock.now(),
            deadline,
            ended: None,
            ended_true: None,
            begun: None,
        });
        book.entries += 1;
        book.sent.len() as u64 - 1
    }

    /// A message has ended for its sender.
    pub fn ended(&self, cx: &Context, id: u64, result: Result<(), Fault>) {
        let mut book = self.book();
        book.entries += 1;
        let entry = book.entries;
        let index = id as usize;
        let taken = result.is_ok();
        let sent = &mut book.sent[index];
        sent.ended = Some((cx.now(), entry, result));
        sent.ended_true = Some(self.clock.now());
        // A reply says more than that it was taken; it is checked with the calls.
        let waits = taken && sent.urgent && sent.begun.is_none() && !sent.is_call;
        let to = sent.to.clone();
        if waits {
            book.urgent.entry(to).or_default().insert(index);
        }
    }

    /// A task begins with a message that says whose it is.
    pub fn begins(&self, cx: &Context, id: u64, to: &str, from: &str) {
        let mut book = self.book();
        book.entries += 1;
        let entry = book.entries;
        let here = cx.name();
        let index = id as usize;
        let Some(sent) = book.sent.get(index).cloned() else {
            book.wrong
                .push(format!("{here} got a message that nobody sent"));
            return;
        };
        if to != here || sent.to != to || sent.from != from {
            book.wrong.push(format!(
                "{here} got what was sent to {to} by {from}: {sent:?}"
            ));
        }
        if sent.begun.is_some() {
            book.wrong.push(format!("delivered twice: {sent:?}"));
            return;
        }
        if let Some((_, at, Err(fault))) = &sent.ended
            && sent.near
        {
            book.wrong.push(format!(
                "begun at entry {entry} though its sender had given up at {at} ({fault:?}): {sent:?}"
            ));
        }
        book.sent[index].begun = Some(entry);
        let lane = (sent.from.clone(), sent.to.clone(), sent.urgent);
        let last = book.last_begun.insert(lane, sent.number).unwrap_or(0);
        if last >= sent.number {
            book.wrong
                .push(format!("out of order, after number {last}: {sent:?}"));
        }
        if let Some(waiting) = book.urgent.get_mut(here) {
            waiting.remove(&index);
        }
        if !sent.urgent
            && let Some(first) = book
                .urgent
                .get(here)
                .and_then(|waiting| waiting.first().copied())
        {
            let overtaken = book.sent[first].clone();
            book.wrong.push(format!(
                "{sent:?} was handled before the urgent {overtaken:?}"
            ));
        }
    }

    /// A name led to a task.
    pub fn resolved(&self, name: &str, tid: Tid) {
        self.book()
            .tids
            .entry(name.to_owned())
            .or_default()
            .insert(tid);
    }

    /// A handler is built. With another id its task has lost its queue, with its chassis.
    pub fn built(&self, cx: &Context) {
        let mut book = self.book();
        book.broken.remove(cx.name());
        let before = book.built.insert(cx.name().to_owned(), cx.tid());
        if before != Some(cx.tid()) {
            book.urgent.remove(cx.name());
        }
    }

    /// A task takes a step of a phase.
    pub fn phase(&self, cx: &Context, incarnation: u32, phase: Phase, step: Step) {
        let mut book = self.book();
        book.entries += 1;
        let task = cx.name().to_owned();
        book.phases.push((task, incarnation, phase, step));
        drop(book);
        self.resolved(cx.name(), cx.tid());
    }

    /// The token of the ring arrives with its number.
    pub fn token(&self, cx: &Context, number: u64) {
        let mut book = self.book();
        let expected = book.token.map_or(0, |last| last + 1);
        if number != expected {
            let text = format!("{} got token {number}, expected {expected}", cx.name());
            book.wrong.push(text);
        }
        book.token = Some(number);
    }
}
