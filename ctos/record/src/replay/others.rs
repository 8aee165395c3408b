//! In place of all other tasks: takes what the replayed task sends, compares it with the record, and
//! gives the recorded answers when their time has come.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::{Arc, Mutex},
};

use super::{
    super::lines::{self, Number},
    ReplayReport,
    script::{Output, Recorded, Script},
};
use crate::names::Names;
use ctos_core::report::Ending;
use ctos_core::{
    envelope::Message,
    reply::{Answer, ReplySlot},
    system::{self, FindTid, Missing},
    tap::WaitFor,
};
use ctos_message::{Command, Data, DataType, Flags, Tid, fault::Fault};
use ctos_time::{Clock, Instant, lock::lock};

/// Text of data in a difference is cut here, letters.
const SHOWN: usize = 300;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    Expected,
    Done,
    Missing,
}

#[derive(Default)]
struct State {
    fates: Vec<Fate>,
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
    outputs: Vec<Output>,
    /// Messages whose sender does not wait, and that were not taken.
    refused: BTreeMap<Number, Fault>,
    /// What whoever sent it was told in the same poll, and when.
    at_once: BTreeMap<Number, (Instant, Recorded)>,
    clock: Clock,
    names: Arc<Names>,
    state: Mutex<State>,
}

impl Others {
    /// In place of the tasks that `script` knows besides its own.
    pub(super) fn new(clock: Clock, names: Arc<Names>, script: &mut Script) -> Self {
        let outputs = std::mem::take(&mut script.outputs);
        let state = State {
            fates: vec![Fate::Expected; outputs.len()],
            ..State::default()
        };
        Self {
            task: script.tid,
            outputs,
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
        let mut state = lock(&self.state);
        let expected = |index: &usize| state.fates.get(*index) == Some(&Fate::Expected);
        let first = (0..self.outputs.len()).find(expected);
        let front = first.and_then(|index| self.outputs.get(index));
        let mut found = None;
        if let (Some(data), Some(front)) = (&data, front) {
            let candidates = self.outputs.iter().enumerate().skip(first.unwrap_or(0));
            for (index, output) in candidates {
                if output.segment != front.segment {
                    break;
                }
                if state.fates.get(index) != Some(&Fate::Expected) {
                    continue;
                }
                if is_like(output, message, data) {
                    found = Some((index, output.id));
                    break;
                }
            }
        }
        if let Some((index, id)) = found {
            if let Some(fate) = state.fates.get_mut(index) {
                *fate = Fate::Done;
            }
            state.report.same();
            return Some(id);
        }
        // A name that another task had found before was not asked for then.
        if self.name_of_another(message).is_some() {
            return None;
        }
        let got = self.shown(
            message.header().to,
            message.header().command,
            message.header().flags,
            &data.unwrap_or_default(),
        );
        let shown =
            |output: &Output| self.shown(output.to, output.command, output.flags, &output.data);
        let expected = front.map_or_else(|| "nothing more".to_owned(), shown);
        state.report.differs(now, message.trace(), expected, got);
        // The same question with other data gets the recorded answer, so that what follows is compared.
        let (place, front) = first.zip(front)?;
        if front.to != message.header().to || front.command != message.header().command {
            return None;
        }
        *state.fates.get_mut(place)? = Fate::Done;
        Some(front.id)
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
        lock(&self.state).fates.get(index) == Some(&Fate::Done)
    }

    /// The record goes on after an output: when it was not made again, it is missing.
    pub(super) fn must_be_done(&self, index: usize, at: Instant) {
        let mut state = lock(&self.state);
        let (Some(fate), Some(output)) = (state.fates.get_mut(index), self.outputs.get(index))
        else {
            return;
        };
        if *fate == Fate::Expected {
            *fate = Fate::Missing;
            let expected = self.shown(output.to, output.command, output.flags, &output.data);
            let got = "nothing".to_owned();
            state.report.differs(at, output.trace, expected, got);
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
        expected: &(String, String),
        got: Option<(u16, Ending)>,
    ) {
        let said = |command: u16, (result, text): (&str, &str)| {
            let command = self.command_name(self.task, command);
            match text {
                "" => format!("`{command}` ended: {result}"),
                text => format!("`{command}` ended: {result}: {text}"),
            }
        };
        let wanted = said(command, (&expected.0, &expected.1));
        let got = got.map_or_else(
            || "it is still at it".to_owned(),
            |(command, ending)| said(command, lines::words(&ending)),
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
        let known = self.names.command(&self.names.task(self.task), command);
        let kind = known.map(|known| known.reply);
        let name = self.command_name(self.task, command);
        let shown = |answer: &Result<Vec<u8>, Fault>| match answer {
            Ok(data) => format!("answer to `{name}`: {}", text_of(data, kind)),
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

    fn command_name(&self, task: Tid, command: u16) -> String {
        let name = self.names.task(task);
        let known = self.names.command(&name, command);
        known.map_or_else(|| format!("{command:#06x}"), |known| known.name.to_owned())
    }

    /// A message in words.
    fn shown(&self, to: Tid, command: u16, flags: Flags, data: &[u8]) -> String {
        let name = self.names.task(to);
        let known = self.names.command(&name, command);
        let data = text_of(data, known.map(|known| known.request));
        let verb = match lines::waits(flags) {
            "reply" => "call",
            _ => "send",
        };
        let urgent = match lines::priority(flags) {
            "high" => " (urgent)",
            _ => "",
        };
        let command = self.command_name(to, command);
        format!("{verb} `{command}` to `{name}`{urgent} {data}")
    }
}

fn is_like(output: &Output, message: &Message, data: &[u8]) -> bool {
    let urgent = |flags: Flags| flags.contains(Flags::HIGH_PRIORITY);
    output.to == message.header().to
        && output.command == message.header().command
        && urgent(output.flags) == urgent(message.header().flags)
        && output.data == data
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
fn text_of(data: &[u8], kind: Option<DataType>) -> String {
    let mut json = Vec::new();
    let shape = kind.and_then(DataType::shape);
    let read = shape.and_then(|shape| shape.convert(data, &mut json));
    if read.is_none() {
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
