//! In place of all other tasks: takes what the replayed task sends and compares it with the record.
//! It gives the recorded answers when their time has come.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Mutex,
};

use super::{
    super::lines::{self, Number},
    ReplayReport,
    script::{Reads, Recorded, Script, Sent, Takes, What},
};
use crate::glossary::Glossary;
use ctos_core::{
    envelope::Message,
    reply::{Answer, ReplySlot},
    report::Ending,
    system::Statistics,
    tap::{Asked, LOOP, WaitFor},
};
use ctos_message::{Command, Data, Flags, Shape, Tid, fault::Fault};
use ctos_time::{Clock, Instant, lock::lock};

/// Text of data in a difference is cut here, characters.
const SHOWN: usize = 300;

#[derive(Default)]
struct State {
    /// What the task sent, and whether it is still to be made again.
    outputs: Vec<(Sent, bool)>,
    /// Who waits for the answer to an output that was made.
    promises: BTreeMap<Number, ReplySlot>,
    /// Of calls that the record does not know: kept, so that they end by their deadlines.
    unanswered: Vec<ReplySlot>,
    ends: VecDeque<(u16, Ending)>,
    /// The part that is polled, and what that still reads.
    polled: Option<(u64, Reads)>,
    /// Which part sent what, of what it still waits for.
    senders: BTreeMap<Number, u64>,
    /// Answers that come to the present poll before their questions were made again.
    early: BTreeMap<Number, Answer>,
    report: ReplayReport,
}

/// The other tasks, as a record knows them.
pub(crate) struct Others {
    /// Without what the task sent and is to do.
    script: Script,
    clock: Clock,
    names: Glossary,
    state: Mutex<State>,
}

impl Others {
    /// In place of the tasks that `script` knows besides its own.
    pub(super) fn new(clock: Clock, names: Glossary, mut script: Script) -> Self {
        let outputs = std::mem::take(&mut script.outputs);
        let state = State {
            outputs: outputs.into_iter().map(|output| (output, true)).collect(),
            ..State::default()
        };
        Self {
            script,
            clock,
            names,
            state: Mutex::new(state),
        }
    }

    /// Takes a message that the replayed chassis sends; `slot` waits for what `wait` names.
    pub(crate) fn dispatch(&self, message: &Message, wait: WaitFor, now: Instant, slot: ReplySlot) {
        let accepted = || Ok(Data::NOTHING);
        // What the runtime says in the task's name (progress, results) is not compared.
        if message.header().from != self.script.tid {
            return slot.answer(accepted());
        }
        let found = self.output(message, now);
        if wait == WaitFor::Nothing {
            let refused = found.and_then(|id| self.script.refused.get(&id));
            return slot.answer(refused.map_or_else(accepted, |fault| Err(fault.clone())));
        }
        match found {
            Some(id) => match self.script.at_once.get(&id) {
                // Before whatever else the task does in this poll, as it was.
                Some((at, answer)) => {
                    self.clock.advance_to(*at);
                    slot.answer(answer.clone().map(Data::Bytes));
                }
                None => {
                    let mut state = lock(&self.state);
                    if let Some(early) = state.early.remove(&id) {
                        drop(state);
                        return slot.answer(early);
                    }
                    let part = state.polled.as_ref().map_or(LOOP, |(part, _)| *part);
                    state.senders.insert(id, part);
                    state.promises.insert(id, slot);
                }
            },
            None if wait == WaitFor::Acceptance => slot.answer(accepted()),
            None => lock(&self.state).unanswered.push(slot),
        }
    }

    /// Finds a message among the recorded ones: the first that is like it, among those that the task
    /// sent before it was given anything else. A sender that waits for an answer or an acceptance gets
    /// it before it sends on. So messages side by side here were sent by children side by side, in an
    /// order that the scheduler drew.
    fn output(&self, message: &Message, now: Instant) -> Option<Number> {
        // What cannot be encoded is like nothing in the record.
        let data = message.envelope.data.to_bytes().ok();
        let header = message.header();
        let mut state = lock(&self.state);
        let State {
            outputs, report, ..
        } = &mut *state;
        let first = outputs.iter().position(|(_, expected)| *expected);
        let left = outputs.get_mut(first.unwrap_or(0)..).unwrap_or_default();
        let segment = left.first().map(|(output, _)| output.segment);
        let mut found = left
            .iter_mut()
            .take_while(|(output, _)| Some(output.segment) == segment)
            .filter(|(output, expected)| {
                *expected && self.is_like(output, message, data.as_deref())
            });
        if let Some((output, expected)) = found.next() {
            *expected = false;
            report.same += 1;
            return Some(output.id);
        }
        let data = data.unwrap_or_default();
        let got = self.shown(header.to, header.command, header.flags, &data);
        let front = left.first_mut().filter(|(_, expected)| *expected);
        let wanted = front.as_ref().map(|(output, _)| self.output_shown(output));
        let wanted = wanted.unwrap_or_else(|| "nothing more".to_owned());
        report.differs(now, message.trace(), wanted, got);
        // The same question with other data gets the recorded answer, so that what follows is compared.
        let (output, expected) = front
            .filter(|(output, _)| output.to == header.to && output.command == header.command)?;
        *expected = false;
        Some(output.id)
    }

    /// Whether a message is the recorded one: to the task of that name, whatever its id, with the same data.
    fn is_like(&self, output: &Sent, message: &Message, data: Option<&[u8]>) -> bool {
        let urgent = |flags: Flags| flags.contains(Flags::HIGH_PRIORITY);
        let to = message.header().to;
        let name = |tid: Tid| self.script.names.get(&tid);
        (output.to == to || name(output.to).is_some_and(|wanted| name(to) == Some(wanted)))
            && output.command == message.header().command
            && urgent(output.flags) == urgent(message.header().flags)
            && Some(&*output.data) == data
    }

    /// The record goes on after an output: when it was not made again, it is missing.
    pub(super) fn must_be_done(&self, index: usize, at: Instant) {
        let mut state = lock(&self.state);
        let State {
            outputs, report, ..
        } = &mut *state;
        if let Some((output, expected)) = outputs.get_mut(index)
            && std::mem::take(expected)
        {
            let wanted = self.output_shown(output);
            report.differs(at, output.trace, wanted, "nothing".to_owned());
        }
    }

    /// A poll begins: of the part that `what` tells, with what it takes.
    pub(super) fn begin_poll(&self, what: &What, takes: Takes) {
        let mut state = lock(&self.state);
        let part = match what {
            What::Polled(part) => *part,
            What::Answered(id) => state.senders.remove(id).unwrap_or(LOOP),
            _ => LOOP,
        };
        state.polled = Some((part, takes.reads));
        drop(state);
        for (id, answer) in takes.answers {
            let answer = answer.map(Data::Bytes);
            let mut state = lock(&self.state);
            match state.promises.remove(&id) {
                Some(promise) => {
                    drop(state);
                    promise.answer(answer);
                }
                None => drop(state.early.insert(id, answer)),
            }
        }
    }

    /// The poll is over.
    pub(super) fn end_poll(&self) {
        let mut state = lock(&self.state);
        state.polled = None;
        // Dropped when the lock is free again.
        let _early = std::mem::take(&mut state.early);
        drop(state);
    }

    /// Whether a part of a task is polled now. What the task has started does as it likes: nobody listens.
    pub(crate) fn is_poll_of(&self, task: Tid, part: u64) -> bool {
        let state = lock(&self.state);
        task != self.script.tid || state.polled.as_ref().is_some_and(|(now, _)| *now == part)
    }

    /// What the task read in this poll under a name, once.
    pub(crate) fn read_again(&self, task: Tid, what: &str) -> Option<Vec<u8>> {
        let mut state = lock(&self.state);
        let (_, reads) = state.polled.as_mut().filter(|_| task == self.script.tid)?;
        let place = reads.iter().position(|(name, _)| name == what)?;
        reads.remove(place).map(|(_, value)| value)
    }

    /// The task reads what it did not read in the record.
    pub(crate) fn lacks(&self, task: Tid, what: &str) {
        // A virtual clock, which stands still in a poll, is not noted.
        if task == self.script.tid && (self.script.real || what != "clock") {
            let now = self.clock.now();
            let (wanted, got) = ("no such read".to_owned(), format!("read {what}"));
            lock(&self.state).report.differs(now, 0, wanted, got);
        }
    }

    /// A handler has returned.
    pub(crate) fn ended(&self, asked: &Asked, ending: Ending) {
        if ending != Ending::Stopped && asked.to == self.script.tid {
            lock(&self.state).ends.push_back((asked.command, ending));
        }
    }

    /// How the next handler ended.
    pub(super) fn next_end(&self) -> Option<(u16, Ending)> {
        lock(&self.state).ends.pop_front()
    }

    /// Compares how a handler ended with the record.
    pub(super) fn compare_end(
        &self,
        at: Instant,
        trace: u64,
        command: u16,
        expected: &Ending,
        got: Option<(u16, Ending)>,
    ) {
        let task = self.names.task(self.script.tid);
        let said = |command: u16, ending: &Ending| {
            let command = self.names.command_name(&task, command);
            match lines::words(ending) {
                (result, "") => format!("`{command}` ended: {result}"),
                (result, text) => format!("`{command}` ended: {result}: {text}"),
            }
        };
        let wanted = said(command, expected);
        let got = got.map(|(command, ending)| said(command, &ending));
        let got = got.unwrap_or_else(|| "it is still at it".to_owned());
        let mut state = lock(&self.state);
        if wanted == got {
            state.report.same += 1;
        } else {
            state.report.differs(at, trace, wanted, got);
        }
    }

    /// Compares an answer that the task gave with the record.
    pub(super) fn compare_reply(
        &self,
        at: Instant,
        trace: u64,
        command: u16,
        expected: &Recorded,
        got: Option<Answer>,
    ) {
        // What the runtime counts of a task is not the task's doing.
        if command == Statistics::CODE {
            return;
        }
        let wanted = match expected {
            Ok(data) => Ok(data.clone()),
            // Not the task's own doing: its caller gave up, or never reached it.
            Err(
                Fault::Deadline { .. }
                | Fault::Full { .. }
                | Fault::Stopping
                | Fault::UnknownTask
                | Fault::PeerDown { .. }
                | Fault::Elsewhere { .. },
            ) => return,
            Err(fault) => Err(fault.clone()),
        };
        let got = got.map(|answer| answer.and_then(|data| Ok(data.to_bytes()?)));
        let mut state = lock(&self.state);
        if got.as_ref() == Some(&wanted) {
            state.report.same += 1;
            return;
        }
        let task = self.names.task(self.script.tid);
        let known = self.names.command(&task, command);
        let shape = known.and_then(|known| known.reply.as_ref());
        let name = self.names.command_name(&task, command);
        let shown = |answer: &Result<Vec<u8>, Fault>| match answer {
            Ok(data) => format!("answer to `{name}`: {}", text_of(data, shape)),
            Err(fault) => format!("answer to `{name}`: {fault}"),
        };
        let got = got.as_ref().map_or_else(|| "no answer".to_owned(), shown);
        let wanted = shown(&wanted);
        state.report.differs(at, trace, wanted, got);
    }

    /// What was found.
    pub(super) fn report(&self, task: &str) -> ReplayReport {
        let mut state = lock(&self.state);
        let mut report = std::mem::take(&mut state.report);
        task.clone_into(&mut report.task);
        report
    }

    fn output_shown(&self, output: &Sent) -> String {
        self.shown(output.to, output.command, output.flags, &output.data)
    }

    /// A message in words.
    fn shown(&self, to: Tid, command: u16, flags: Flags, data: &[u8]) -> String {
        let name = self.names.task(to);
        let known = self.names.command(&name, command);
        let data = text_of(data, known.and_then(|known| known.request.as_ref()));
        let verb = match lines::waits(flags) {
            "reply" => "call",
            _ => "send",
        };
        let urgent = match lines::priority(flags) {
            "high" => " (urgent)",
            _ => "",
        };
        let command = self.names.command_name(&name, command);
        format!("{verb} `{command}` to `{name}`{urgent} {data}")
    }
}

/// Data in words: as JSON where its type is known.
fn text_of(data: &[u8], shape: Option<&Shape>) -> String {
    let mut json = Vec::new();
    let converted = shape.and_then(|shape| shape.convert(data, &mut json));
    if converted.is_none() {
        return hex(data);
    }
    let text = String::from_utf8_lossy(&json);
    if text.chars().count() <= SHOWN {
        return text.into_owned();
    }
    let cut: String = text.chars().take(SHOWN).collect();
    format!("{cut}…")
}

fn hex(data: &[u8]) -> String {
    let shown = data.iter().take(32).map(|byte| format!("{byte:02x}"));
    let shown = shown.collect::<Vec<_>>().join(" ");
    let colon = if data.is_empty() { "" } else { ": " };
    let more = if data.len() > 32 { "…" } else { "" };
    format!("of {} bytes{colon}{shown}{more}", data.len())
}
