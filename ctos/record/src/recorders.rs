//! Who looks on at a chassis: its recorders, those that came while it ran too, or a replay.

use std::{
    fmt::Display,
    sync::{
        Arc, OnceLock, PoisonError, RwLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use super::{
    event::{Key, Side, Step, Traffic},
    lines::Schema,
    recorder::Recorder,
    replay::Others,
};
use ctos_core::{
    chassis::{Chassis, Extension},
    envelope::Message,
    phase::Phase,
    reply::ReplySlot,
    report::{Ending, RecordReport},
    tap::{Asked, AtHand, Came, ChannelSchema, Observer, WaitFor, WriteData},
};
use ctos_message::{ChassisNumber, CommandInfo, Data, Header, Tid, blob::Body, fault::Fault};
use ctos_time::Instant;
use serde_json::json;

/// What looks on.
#[derive(Default)]
pub struct Recorders {
    /// The chassis.
    index: ChassisNumber,
    /// Whether its clock goes on by itself.
    real: bool,
    /// The recorder that was there when the chassis began. Set once.
    first: OnceLock<Arc<Recorder>>,
    /// The replay that answers in place of the other tasks. Set once.
    others: OnceLock<Arc<Others>>,
    /// Whether there are guests.
    visited: AtomicBool,
    /// Recorders that came while the chassis ran, and may go before it does.
    guests: RwLock<Vec<Arc<Recorder>>>,
    /// How many recorders have come so far.
    came: AtomicU64,
    /// Numbers messages while there are guests alone.
    next_id: AtomicU64,
}

impl Extension for Recorders {
    fn new(chassis: &Chassis) -> Self {
        Self {
            index: chassis.index(),
            real: chassis.clock().origin_ns().is_some(),
            ..Self::default()
        }
    }
}

impl Recorders {
    /// Those of a chassis, which are shown everything that passes there.
    pub fn of(chassis: &Chassis) -> Arc<Self> {
        let all = chassis.extension::<Self>();
        chassis.tap.set(all.clone());
        all
    }

    /// From now on everything goes to `recorder`. The first call counts.
    pub(crate) fn record(chassis: &Chassis, recorder: Arc<Recorder>) {
        let all = Self::of(chassis);
        all.came.fetch_add(1, Ordering::AcqRel);
        let _ = all.first.set(recorder);
        chassis.tap.watch(true);
    }

    /// From now on everything goes to `recorder` too.
    pub(super) fn admit(chassis: &Chassis, recorder: Arc<Recorder>) {
        let all = Self::of(chassis);
        all.came.fetch_add(1, Ordering::AcqRel);
        let mut guests = all.guests.write().unwrap_or_else(PoisonError::into_inner);
        guests.push(recorder);
        all.visit(chassis, &guests);
    }

    /// From now on nothing goes to `recorder` any more.
    pub(super) fn dismiss(chassis: &Chassis, recorder: &Arc<Recorder>) {
        let all = Self::of(chassis);
        let mut guests = all.guests.write().unwrap_or_else(PoisonError::into_inner);
        guests.retain(|guest| !Arc::ptr_eq(guest, recorder));
        all.visit(chassis, &guests);
    }

    /// These are all guests.
    fn visit(&self, chassis: &Chassis, guests: &[Arc<Recorder>]) {
        let visited = !guests.is_empty();
        self.visited.store(visited, Ordering::Release);
        chassis.tap.watch(visited || self.first.get().is_some());
    }

    /// From now on everything goes to a replay. The first call counts.
    pub(crate) fn replay_at(chassis: &Chassis, others: Arc<Others>) {
        let _ = Self::of(chassis).others.set(others);
        chassis.tap.watch(true);
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
        let mut all: Vec<_> = self.first.get().cloned().into_iter().collect();
        all.extend(self.guests());
        all
    }

    /// How the records are.
    pub fn reports(&self) -> Vec<RecordReport> {
        let recorders = self.recorders();
        recorders.iter().map(|recorder| recorder.report()).collect()
    }

    /// Events that the records lack; `None` when nothing is recorded.
    pub fn dropped(&self) -> Option<u64> {
        let reports = self.reports();
        let all = reports.iter().map(|report| report.lost).sum();
        (!reports.is_empty()).then_some(all)
    }

    fn fresh_id(&self) -> u64 {
        match self.first.get() {
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
        // A virtual clock stands still meanwhile, and shows each chassis another time.
        let at = at.filter(|_| self.real);
        let event = |recorder: &Recorder| Traffic {
            at: at.map_or_else(|| recorder.now(), Instant::as_nanos),
            chassis: self.index,
            key,
            step,
        };
        if let Some(only) = self.first.get()
            && !self.visited.load(Ordering::Relaxed)
        {
            return only.note(place, |batch| batch.traffic(event(only), data));
        }
        let recorders = self.recorders();
        let Some(event) = recorders.first().map(|one| event(one)) else {
            return false;
        };
        let mut noted = false;
        for one in recorders {
            noted |= one.note(place, |batch| batch.traffic(event.clone(), &data));
        }
        noted
    }

    /// Notes with everybody who records that a task was built or has entered a phase.
    fn entered(&self, task: Tid, phase: &str) {
        for recorder in self.recorders() {
            let line = json!({ "task": &*recorder.name_of(task), "phase": phase });
            let (at, topic) = (recorder.now(), "/phase".to_owned());
            recorder.note(task, |batch| batch.json(at, topic, Schema::Phase, &line));
        }
    }

    /// Adds a line of a task's own channel, which `write` writes.
    fn line(&self, task: Tid, channel: &str, schema: &Schema, write: impl Fn(&mut Vec<u8>)) {
        let root = if channel.starts_with('/') { "" } else { "/" };
        for recorder in self.recorders() {
            let (at, topic) = (recorder.now(), format!("{root}{channel}"));
            let write = |buffer: &mut Vec<u8>| {
                write(buffer);
                true
            };
            recorder.note(task, |batch| batch.line(at, topic, schema.clone(), write));
        }
    }

    fn fresh_key(&self, header: &Header, trace: u64) -> Key {
        key_of(self.fresh_id(), &Asked::by_header(header, trace))
    }

    fn side_of(&self, to: Tid) -> Side {
        if to.chassis() == self.index {
            Side::Here
        } else {
            Side::Sender
        }
    }

    fn note_answer(
        &self,
        id: u64,
        asked: &Asked,
        side: Side,
        came: Came,
        answer: Result<&Data, &Fault>,
    ) {
        let step = Step::Answered {
            side,
            came,
            fault: answer.err().cloned(),
        };
        // Noted where it happened: at the one who answers, or at the one who asked.
        let place = match side {
            Side::Receiver => asked.to,
            Side::Here | Side::Sender => asked.by,
        };
        self.traffic(place, None, key_of(id, asked), step, |buffer| {
            answer.is_ok_and(|data| data.append_to(buffer).is_ok())
        });
    }
}

/// For what happens within a task, to no message.
fn key_within(task: Tid) -> Key {
    Key {
        id: 0,
        task,
        peer: task,
        command: 0,
        trace: 0,
    }
}

fn key_of(id: u64, asked: &Asked) -> Key {
    Key {
        id,
        task: asked.to,
        peer: asked.by,
        command: asked.command,
        trace: asked.trace,
    }
}

impl Observer for Recorders {
    fn is_recording(&self) -> bool {
        self.first.get().is_some() || self.visited.load(Ordering::Relaxed)
    }

    fn replays(&self) -> bool {
        self.others.get().is_some()
    }

    fn replay(&self, message: &Message, wait: WaitFor, now: Instant, slot: ReplySlot) {
        if let Some(others) = self.others.get() {
            others.dispatch(message, wait, now, slot);
        }
    }

    fn sent(&self, message: &Message, wait: WaitFor) -> u64 {
        let header = message.header();
        let key = self.fresh_key(header, message.trace());
        let step = Step::Sent {
            flags: (header.flags | wait.flags()).bits(),
            deadline: message.deadline().map(Instant::as_nanos),
            side: self.side_of(header.to),
        };
        let data = |buffer: &mut Vec<u8>| message.envelope.data.append_to(buffer).is_ok();
        let noted = self.traffic(header.from, None, key, step, data);
        if noted { key.id } else { 0 }
    }

    fn arrived(&self, header: &Header, trace: u64, deadline: Option<Instant>, body: &Body) -> u64 {
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

    fn began(&self, at_hand: &AtHand) {
        let AtHand { id, asked, began } = at_hand;
        if self.is_recording() {
            let key = key_of(*id, asked);
            self.traffic(asked.to, Some(*began), key, Step::Began, |_| true);
        }
    }

    fn ended(&self, at_hand: &AtHand, now: Instant, ending: Ending) {
        let AtHand { id, asked, began } = at_hand;
        if let Some(others) = self.others.get() {
            return others.ended(asked, ending);
        }
        let took = now.as_nanos().saturating_sub(began.as_nanos());
        let step = Step::Ended { took, ending };
        self.traffic(asked.to, Some(now), key_of(*id, asked), step, |_| true);
    }

    fn answered(&self, id: u64, asked: &Asked, came: Came, answer: Result<&Data, &Fault>) {
        self.note_answer(id, asked, self.side_of(asked.to), came, answer);
    }

    fn replied(&self, id: u64, asked: &Asked, answer: Result<&Data, &Fault>) {
        self.note_answer(id, asked, Side::Receiver, Came::Later, answer);
    }

    fn built(&self, task: Tid, name: &Arc<str>, commands: &[CommandInfo]) {
        for recorder in self.recorders() {
            recorder.named(task, name, commands);
        }
        self.entered(task, "built");
    }

    fn phase(&self, task: Tid, phase: Phase) {
        self.entered(task, &phase.to_string());
    }

    fn value(&self, task: Tid, channel: &str, value: WriteData<'_>) {
        self.line(task, channel, &Schema::Value, |json| {
            let start = json.len();
            if !value(json) || json.len() == start {
                json.truncate(start);
                json.extend_from_slice(b"null");
            }
        });
    }

    fn encoded(&self, task: Tid, channel: &str, schema: &Arc<ChannelSchema>, bytes: &[u8]) {
        let schema = Schema::Given(schema.clone());
        self.line(task, channel, &schema, |buffer| {
            buffer.extend_from_slice(bytes)
        });
    }

    fn polled(&self, task: Tid, part: u64) {
        let step = Step::Polled { part };
        self.traffic(task, None, key_within(task), step, |_| true);
    }

    fn read(&self, task: Tid, what: &dyn Display, value: Option<WriteData<'_>>) {
        let (what, lacking) = (what.to_string(), value.is_none());
        if let Some(others) = self.others.get() {
            return others.lacks(task, &what);
        }
        let step = Step::Read { what, lacking };
        self.traffic(task, None, key_within(task), step, |buffer| {
            value.is_none_or(|value| value(buffer))
        });
    }

    fn is_poll_of(&self, task: Tid, part: u64) -> bool {
        let others = self.others.get();
        others.is_none_or(|others| others.is_poll_of(task, part))
    }

    fn read_again(&self, task: Tid, what: &dyn Display) -> Option<Vec<u8>> {
        self.others.get()?.read_again(task, &what.to_string())
    }

    fn came(&self) -> u64 {
        self.came.load(Ordering::Acquire)
    }
}
