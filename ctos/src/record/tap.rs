//! The one place of a chassis that sees everything: what is sent, what a handler begins and ends, what
//! comes back. It hands it to a recorder, to a replay, or to nobody, which costs one load.

use std::sync::{
    Arc, OnceLock, PoisonError, RwLock,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use super::{
    event::{Ending, Key, Side, Step, Told, Traffic, What},
    recorder::Recorder,
    replay::Desk,
    report::RecordReport,
};
use crate::{
    blob::Body,
    call::Fault,
    chassis::WaitFor,
    message::{CommandInfo, Data, Header, Message, Tid},
    task::Phase,
    time::Instant,
};

enum Target {
    Record(Arc<Recorder>),
    Replay(Arc<Desk>),
}

/// What looks on.
#[derive(Default)]
pub(crate) struct Tap {
    /// The chassis.
    index: u8,
    /// What was there when the chassis began. Set once.
    first: OnceLock<Target>,
    /// Whether there are guests.
    visited: AtomicBool,
    /// Whether anything looks on at all: without, a message costs one load for it.
    watched: AtomicBool,
    /// Recorders that came while the chassis ran, and may go before it does.
    guests: RwLock<Vec<Arc<Recorder>>>,
    /// How many recorders have come so far.
    came: AtomicU64,
    /// Numbers messages while there are guests alone.
    next_id: AtomicU64,
}

/// A request as its sender knows it, kept until the answer comes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Asked {
    by: Tid,
    to: Tid,
    command: u16,
    trace: u64,
}

impl Asked {
    /// The asked task.
    pub(crate) fn to(&self) -> Tid {
        self.to
    }

    pub(crate) fn of(message: &Message) -> Self {
        let header = message.header();
        Self {
            by: header.from,
            to: header.to,
            command: header.command,
            trace: message.trace(),
        }
    }
}

/// A message at whose handler a task is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AtHand {
    key: Key,
    began: u64,
}

impl AtHand {
    /// `task` begins with `message` now.
    pub(crate) fn of(task: Tid, message: &Message, now: Instant) -> Self {
        Self {
            key: Key {
                id: message.envelope.recorded,
                task,
                peer: message.from(),
                command: message.command(),
                trace: message.trace(),
            },
            began: now.as_nanos(),
        }
    }
}

impl Tap {
    /// The tap of chassis `index`.
    pub(crate) fn new(index: u8) -> Self {
        Self {
            index,
            ..Self::default()
        }
    }

    /// From now on everything goes to `recorder`. The first call counts.
    pub(crate) fn record(&self, recorder: Arc<Recorder>) {
        self.came.fetch_add(1, Ordering::AcqRel);
        let _ = self.first.set(Target::Record(recorder));
        self.watched.store(true, Ordering::Release);
    }

    /// From now on everything goes to `recorder` too.
    pub(super) fn admit(&self, recorder: Arc<Recorder>) {
        self.came.fetch_add(1, Ordering::AcqRel);
        let mut guests = self.guests.write().unwrap_or_else(PoisonError::into_inner);
        guests.push(recorder);
        self.visit(&guests);
    }

    /// How many recorders have come so far.
    pub(crate) fn came(&self) -> u64 {
        self.came.load(Ordering::Acquire)
    }

    /// From now on nothing goes to `recorder` any more.
    pub(super) fn dismiss(&self, recorder: &Arc<Recorder>) {
        let mut guests = self.guests.write().unwrap_or_else(PoisonError::into_inner);
        guests.retain(|guest| !Arc::ptr_eq(guest, recorder));
        self.visit(&guests);
    }

    /// These are all guests.
    fn visit(&self, guests: &[Arc<Recorder>]) {
        let visited = !guests.is_empty();
        self.visited.store(visited, Ordering::Release);
        let watched = visited || self.first.get().is_some();
        self.watched.store(watched, Ordering::Release);
    }

    /// From now on everything goes to a replay. The first call counts.
    pub(crate) fn replay_at(&self, desk: Arc<Desk>) {
        let _ = self.first.set(Target::Replay(desk));
        self.watched.store(true, Ordering::Release);
    }

    /// The replay that answers in place of the other tasks, if there is one.
    pub(crate) fn replay(&self) -> Option<&Arc<Desk>> {
        match self.first.get()? {
            Target::Replay(desk) => Some(desk),
            Target::Record(_) => None,
        }
    }

    fn first(&self) -> Option<&Arc<Recorder>> {
        match self.first.get()? {
            Target::Record(recorder) => Some(recorder),
            Target::Replay(_) => None,
        }
    }

    fn guests(&self) -> Vec<Arc<Recorder>> {
        if !self.visited.load(Ordering::Acquire) {
            return Vec::new();
        }
        let guests = self.guests.read().unwrap_or_else(PoisonError::into_inner);
        guests.clone()
    }

    /// All who record.
    pub(crate) fn recorders(&self) -> Vec<Arc<Recorder>> {
        let mut all: Vec<_> = self.first().cloned().into_iter().collect();
        all.extend(self.guests());
        all
    }

    /// How the records are.
    pub(crate) fn reports(&self) -> Vec<RecordReport> {
        let recorders = self.recorders();
        recorders.iter().map(|recorder| recorder.report()).collect()
    }

    /// Events that the records lack; `None` when nothing is recorded.
    pub(crate) fn dropped(&self) -> Option<u64> {
        let recorders = self.recorders();
        let all = recorders.iter().map(|recorder| recorder.dropped()).sum();
        (!recorders.is_empty()).then_some(all)
    }

    /// Whether anything looks on.
    pub(crate) fn is_on(&self) -> bool {
        self.watched.load(Ordering::Relaxed)
    }

    /// Whether anything is recorded.
    pub(crate) fn is_recording(&self) -> bool {
        self.first().is_some() || self.visited.load(Ordering::Relaxed)
    }

    fn fresh_id(&self) -> u64 {
        match self.first() {
            Some(recorder) => recorder.fresh_id(),
            None => self.next_id.fetch_add(1, Ordering::Relaxed) + 1,
        }
    }

    /// Notes with everybody who records what happened to a message, at `at`, or now; whether somebody took
    /// it.
    fn traffic(
        &self,
        place: Tid,
        at: Option<Instant>,
        key: Key,
        step: Step,
        data: impl Fn(&mut Vec<u8>) -> bool,
    ) -> bool {
        let first = self.first();
        let event = |recorder: &Recorder| Traffic {
            at: at.map_or_else(|| recorder.now(), Instant::as_nanos),
            chassis: self.index,
            key,
            step,
        };
        match first {
            Some(only) if !self.visited.load(Ordering::Relaxed) => {
                only.traffic(place, &event(only), data)
            }
            _ => {
                let recorders = self.recorders();
                let Some(one) = recorders.first() else {
                    return false;
                };
                let event = event(one);
                let mut noted = false;
                for recorder in &recorders {
                    noted |= recorder.traffic(place, &event, &data);
                }
                noted
            }
        }
    }

    /// Notes with everybody who records what is told now.
    fn told(&self, place: Tid, what: impl FnOnce() -> What, data: impl Fn(&mut Vec<u8>) -> bool) {
        let recorders = self.recorders();
        let Some(one) = recorders.first() else {
            return;
        };
        let told = Told {
            at: one.now(),
            what: what(),
        };
        for recorder in &recorders {
            recorder.told(place, &told, &data);
        }
    }

    /// A message is sent by a task of this chassis: its number in the record, if it has one.
    pub(crate) fn sent(&self, message: &Message, wait: WaitFor) -> u64 {
        if !self.is_recording() {
            return 0;
        }
        let header = message.header();
        let key = self.fresh_key(header, message.trace());
        let step = Step::Sent {
            flags: header.flags.with(wait.flags()).bits(),
            deadline: message.deadline().map(Instant::as_nanos),
            side: if header.to.chassis() == self.index {
                Side::Here
            } else {
                Side::Sender
            },
        };
        let data = |buffer: &mut Vec<u8>| message.envelope.data.append_to(buffer).is_ok();
        let noted = self.traffic(header.from, None, key, step, data);
        if noted { key.id } else { 0 }
    }

    fn fresh_key(&self, header: &Header, trace: u64) -> Key {
        Key {
            id: self.fresh_id(),
            task: header.to,
            peer: header.from,
            command: header.command,
            trace,
        }
    }

    /// A message has come over a link.
    pub(crate) fn arrived(
        &self,
        header: &Header,
        trace: u64,
        deadline: Option<Instant>,
        body: &Body,
    ) -> u64 {
        if !self.is_recording() {
            return 0;
        }
        let key = self.fresh_key(header, trace);
        let step = Step::Sent {
            flags: header.flags.bits(),
            deadline: deadline.map(Instant::as_nanos),
            side: Side::Receiver,
        };
        let noted = self.traffic(header.to, None, key, step, |buffer| {
            body.append_to(buffer);
            true
        });
        if noted { key.id } else { 0 }
    }

    /// A handler is called.
    pub(crate) fn began(&self, at_hand: &AtHand) {
        if self.is_recording() {
            let AtHand { key, began } = *at_hand;
            let at = Some(Instant::from_nanos(began));
            self.traffic(key.task, at, key, Step::Began, |_| true);
        }
    }

    /// It has returned.
    pub(crate) fn ended(&self, at_hand: &AtHand, now: Instant, ending: impl FnOnce() -> Ending) {
        let AtHand { key, began } = *at_hand;
        if let Some(desk) = self.replay() {
            return desk.ended(key.command, ending());
        }
        if !self.is_recording() {
            return;
        }
        let ending = ending();
        let step = Step::Ended { began, ending };
        self.traffic(key.task, Some(now), key, step, |_| true);
    }

    /// An answer has come to whoever asked; `at_once`, if nothing happened in between.
    pub(crate) fn answered(
        &self,
        id: u64,
        asked: &Asked,
        at_once: bool,
        answer: Result<&Data, &Fault>,
    ) {
        if self.is_recording() {
            let side = self.side_of(asked);
            self.note_answer(id, asked, side, at_once, answer);
        }
    }

    fn side_of(&self, asked: &Asked) -> Side {
        if asked.to.chassis() == self.index {
            Side::Here
        } else {
            Side::Sender
        }
    }

    /// A task of this chassis answers a message from another one.
    pub(crate) fn replied(
        &self,
        id: u64,
        request: &Header,
        trace: u64,
        answer: Result<&Data, &Fault>,
    ) {
        let asked = Asked {
            by: request.from,
            to: request.to,
            command: request.command,
            trace,
        };
        if self.is_recording() {
            self.note_answer(id, &asked, Side::Receiver, false, answer);
        }
    }

    fn note_answer(
        &self,
        id: u64,
        asked: &Asked,
        side: Side,
        at_once: bool,
        answer: Result<&Data, &Fault>,
    ) {
        let key = Key {
            id,
            task: asked.to,
            peer: asked.by,
            command: asked.command,
            trace: asked.trace,
        };
        let fault = answer.err().cloned();
        let step = Step::Answered {
            side,
            at_once,
            fault,
        };
        // Noted where it happened: at the one who answers, or at the one who asked.
        let place = if side == Side::Receiver {
            asked.to
        } else {
            asked.by
        };
        self.traffic(place, None, key, step, |buffer| {
            answer.is_ok_and(|data| data.append_to(buffer).is_ok())
        });
    }

    /// A task has entered a startup phase; without one, its handler has been built.
    pub(crate) fn phase(&self, task: Tid, phase: Option<Phase>) {
        self.told(task, || What::Phase { task, phase }, |_| true);
    }

    /// A task puts a value on a channel of its own.
    pub(crate) fn value<T: serde::Serialize + ?Sized>(&self, task: Tid, channel: &str, value: &T) {
        let what = || What::Value {
            channel: if channel.starts_with('/') {
                channel.to_owned()
            } else {
                format!("/{channel}")
            },
        };
        self.told(task, what, |buffer| {
            serde_json::to_writer(buffer, value).is_ok()
        });
    }

    /// A task of this chassis was built, which takes `commands`.
    pub(crate) fn built(&self, task: Tid, name: &Arc<str>, commands: &[CommandInfo]) {
        if !self.is_recording() {
            return;
        }
        for recorder in self.recorders() {
            recorder.named(task, name, commands);
        }
        self.phase(task, None);
    }

    /// A task used something that no message brings it, so that no record holds it.
    pub(crate) fn used(&self, what: impl FnOnce() -> String) {
        if let Some(Target::Replay(desk)) = self.first.get() {
            desk.used(what());
        }
    }
}
