//! In place of all other tasks: takes what the replayed task sends, compares it with the record, and
//! gives the recorded answers when their time has come.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::Mutex,
};

use super::{
    super::lines::{self, Number},
    ReplayReport,
    script::{Recorded, Script, Sent},
};
use crate::glossary::Glossary;
use ctos_core::{
    envelope::Message,
    reply::{Answer, ReplySlot},
    report::Ending,
    system::{self, FindTid, Missing},
    tap::WaitFor,
};
use ctos_message::{Command, Data, Flags, Shape, Tid, fault::Fault};
use ctos_time::{Clock, Instant, lock::lock};

/// Text of data in a difference is cut here, letters.
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
    used: BTreeSet<String>,
    report: ReplayReport,
}

/// The other tasks, as a record knows them.
pub(crate) struct Others {
    task: Tid,
    /// Messages whose sender does not wait, and that were not taken.
    refused: BTreeMap<Number, Fault>,
    /// What whoever sent it was told in the same poll, and when.
    at_once: BTreeMap<Number, (Instant, Recorded)>,
    clock: Clock,
    names: Glossary,
    state: Mutex<State>,
}

impl Others {
    /// In place of the tasks that `script` knows besides its own.
    pub(super) fn new(clock: Clock, names: Glossary, script: &mut Script) -> Self {
        let outputs = std::mem::take(&mut script.outputs);
        let state = State {
            outputs: outputs.into_iter().map(|output| (output, true)).collect(),
            ..State::default()
        };
        Self {
            task: script.tid,
            refused: std::mem::take(&mut script.refused),
            at_once: std::mem::take(&mut script.at_once),
            clock,
            names,
            state: Mutex::new(state),
        }
    }

    /// Takes a message that the replayed chassis sends; `slot` waits for what `wait` names.
    pub(crate) fn dispatch(&self, message: &Message, wait: WaitFor, now: Instant, slot: ReplySlot) {
        let accepted = || Ok(Data::NOTHING);
        // What the runtime says in the task's name (progress, results) is not compared.
        if message.header().from != self.task {
            return slot.answer(accepted());
        }
        let found = self.output(message, now);
        if wait == WaitFor::Nothing {
            let refused = found.and_then(|id| self.refused.get(&id));
            return slot.answer(refused.map_or_else(accepted, |fault| Err(fault.clone())));
        }
        match found {
            Some(id) => match self.at_once.get(&id) {
                // Before whatever else the task does in this poll, as it was.
                Some((at, answer)) => {
                    self.clock.advance_to(*at);
                    slot.answer(answer.clone().into_answer());
                }
                None => {
                    lock(&self.state).promises.insert(id, slot);
                }
            },
            None => match self.name_of_another(message) {
                Some(answer) => slot.answer(answer),
                None if wait == WaitFor::Acceptance => slot.answer(accepted()),
                None => lock(&self.state).unanswered.push(slot),
            },
        }
    }

    /// Finds a message among the recorded ones: the first that is like it, among those that the task
    /// sent before it was given anything else. Whoever waits for its answer, or its acceptance, is given
    /// that before it sends on, so what stands side by side here was sent by children side by side, in
    /// an order that the scheduler drew.
    fn output(&self, message: &Message, now: Instant) -> Option<Number> {
        // What cannot be encoded is like nothing in the record.
        let data = bytes_of(&message.envelope.data).ok();
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
            .filter(|(output, expected)| *expected && is_like(output, message, data.as_deref()));
        if let Some((output, expected)) = found.next() {
            *expected = false;
            report.same();
            return Some(output.id);
        }
        // A name that another task had found before was not asked for then.
        if self.name_of_another(message).is_some() {
            return None;
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

    /// The answer to a question for a name, if it is one.
    fn name_of_another(&self, message: &Message) -> Option<Answer> {
        if message.header().to != system::TID_SERVER || message.header().command != FindTid::CODE {
            return None;
        }
        let data = bytes_of(&message.envelope.data).ok()?;
        let FindTid { name, .. } = postcard::from_bytes(&data).ok()?;
        let answer: Result<Tid, Missing> = Ok(self.names.tid(&name)?);
        Some(Ok(Data::of(answer)))
    }

    /// Whether the recorded output was made again.
    pub(super) fn is_done(&self, index: usize) -> bool {
        let state = lock(&self.state);
        state
            .outputs
            .get(index)
            .is_some_and(|(_, expected)| !expected)
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

    /// The answer to output `id` has come.
    pub(super) fn answer(&self, id: Number, answer: Answer) {
        let promise = lock(&self.state).promises.remove(&id);
        if let Some(promise) = promise {
            promise.answer(answer);
        }
    }

    /// A handler has returned.
    pub(crate) fn ended(&self, command: u16, ending: Ending) {
        if ending != Ending::Stopped {
            lock(&self.state).ends.push_back((command, ending));
        }
    }

    /// How the next handler ended, taken out when `take` says so.
    pub(super) fn next_end(&self, take: bool) -> Option<(u16, Ending)> {
        let mut state = lock(&self.state);
        if take {
            state.ends.pop_front()
        } else {
            state.ends.front().cloned()
        }
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
        let task = self.names.task(self.task);
        let said = |command: u16, ending: &Ending| {
            let command = self.names.command_name(&task, command);
            match lines::words(ending) {
                (result, "") => format!("`{command}` ended: {result}"),
                (result, text) => format!("`{command}` ended: {result}: {text}"),
            }
        };
        let wanted = said(command, expected);
        let got = got.map_or_else(
            || "it is still at it".to_owned(),
            |(command, ending)| said(command, &ending),
        );
        let mut state = lock(&self.state);
        if wanted == got {
            state.report.same();
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
        let wanted = match &expected.0 {
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
        let got = got.map(|answer| answer.and_then(|data| bytes_of(&data)));
        let mut state = lock(&self.state);
        if got.as_ref() == Some(&wanted) {
            return state.report.same();
        }
        let task = self.names.task(self.task);
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

    /// The task used something that no record holds.
    pub(crate) fn used(&self, what: String) {
        lock(&self.state).used.insert(what);
    }

    /// What was found.
    pub(super) fn report(&self, task: &str) -> ReplayReport {
        let mut state = lock(&self.state);
        let mut report = std::mem::take(&mut state.report);
        task.clone_into(&mut report.task);
        report.used = std::mem::take(&mut state.used).into_iter().collect();
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

fn is_like(output: &Sent, message: &Message, data: Option<&[u8]>) -> bool {
    let urgent = |flags: Flags| flags.contains(Flags::HIGH_PRIORITY);
    output.to == message.header().to
        && output.command == message.header().command
        && urgent(output.flags) == urgent(message.header().flags)
        && Some(&*output.data) == data
}

fn bytes_of(data: &Data) -> Result<Vec<u8>, Fault> {
    let mut bytes = Vec::new();
    match data.append_to(&mut bytes) {
        Ok(()) => Ok(bytes),
        Err(error) => Err(Fault::BadPayload {
            text: error.to_string(),
        }),
    }
}

/// Data in words: as JSON where its type is known.
fn text_of(data: &[u8], shape: Option<&Shape>) -> String {
    let mut json = Vec::new();
    if shape
        .and_then(|shape| shape.convert(data, &mut json))
        .is_none()
    {
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
    use std::fmt::Write;
    let mut text = format!("of {} bytes", data.len());
    for (index, byte) in data.iter().take(32).enumerate() {
        let gap = if index == 0 { ": " } else { " " };
        // A string takes all that is written to it.
        let _ = write!(text, "{gap}{byte:02x}");
    }
    if data.len() > 32 {
        text.push('…');
    }
    text
}
