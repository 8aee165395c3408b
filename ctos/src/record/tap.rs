//! The one place of a chassis that sees everything: what is sent, what a handler begins and ends, what
//! comes back. It hands it to a recorder, to a replay, or to nobody, which costs one load.

use std::sync::{Arc, OnceLock};

use super::{
    event::{Ending, Happened, Head, Side},
    recorder::Recorder,
    replay::Desk,
};
use crate::{
    call::Fault,
    chassis::{Envelope, WaitFor},
    message::{Data, Flags, Header, Message, Tid},
    task::Phase,
    time::Instant,
};

enum Target {
    Record {
        recorder: Arc<Recorder>,
        chassis: u8,
    },
    Replay(Arc<Desk>),
}

/// What looks on. Set once, when recording begins.
#[derive(Default)]
pub(crate) struct Tap(OnceLock<Target>);

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

    pub(crate) fn of(envelope: &Envelope) -> Self {
        Self {
            by: envelope.from,
            to: envelope.to,
            command: envelope.command,
            trace: envelope.trace,
        }
    }
}

/// A message at whose handler a task is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AtHand {
    id: u64,
    task: Tid,
    from: Tid,
    command: u16,
    trace: u64,
    began: u64,
}

impl AtHand {
    /// `task` begins with `message` now.
    pub(crate) fn of(task: Tid, message: &Message, now: Instant) -> Self {
        Self {
            id: message.recorded,
            task,
            from: message.header.from,
            command: message.header.command,
            trace: message.trace,
            began: now.as_nanos(),
        }
    }
}

impl Tap {
    /// From now on everything goes to `recorder`, as of chassis `chassis`. The first call counts.
    pub(crate) fn record(&self, recorder: Arc<Recorder>, chassis: u8) {
        let _ = self.0.set(Target::Record { recorder, chassis });
    }

    /// From now on everything goes to a replay. The first call counts.
    pub(crate) fn replay_at(&self, desk: Arc<Desk>) {
        let _ = self.0.set(Target::Replay(desk));
    }

    /// The replay that answers in place of the other tasks, if there is one.
    pub(crate) fn replay(&self) -> Option<&Arc<Desk>> {
        match self.0.get()? {
            Target::Replay(desk) => Some(desk),
            Target::Record { .. } => None,
        }
    }

    fn recorder(&self) -> Option<(&Arc<Recorder>, u8)> {
        match self.0.get()? {
            Target::Record { recorder, chassis } => Some((recorder, *chassis)),
            Target::Replay(_) => None,
        }
    }

    /// Events that the record lacks; `None` when nothing is recorded.
    pub(crate) fn dropped(&self) -> Option<u64> {
        self.recorder().map(|(recorder, _)| recorder.dropped())
    }

    /// Whether anything looks on.
    pub(crate) fn is_on(&self) -> bool {
        self.0.get().is_some()
    }

    /// Whether anything is recorded.
    pub(crate) fn is_recording(&self) -> bool {
        self.recorder().is_some()
    }

    /// A task sends a message. The number stands for it in the record; 0 when it is not in it.
    pub(crate) fn sent(&self, envelope: &Envelope, wait: Option<WaitFor>) -> u64 {
        let Some((recorder, chassis)) = self.recorder() else {
            return 0;
        };
        let flag = match wait {
            Some(WaitFor::Reply) => Flags::REPLY_WAIT,
            Some(WaitFor::Acceptance) => Flags::ACCEPT_WAIT,
            None => Flags::NONE,
        };
        let id = recorder.fresh_id();
        let what = Happened::Message {
            id,
            to: envelope.to,
            from: envelope.from,
            command: envelope.command,
            flags: envelope.flags.with(flag).bits(),
            trace: envelope.trace,
            deadline: envelope.deadline.map(Instant::as_nanos),
            side: if envelope.to.chassis() == chassis {
                Side::Here
            } else {
                Side::Sender
            },
        };
        let head = Head {
            at: recorder.now(),
            chassis,
            what,
        };
        let noted = recorder.note(envelope.from, &head, |buffer| {
            envelope.data.append_to(buffer).is_ok()
        });
        if noted { id } else { 0 }
    }

    /// A message has come over a link.
    pub(crate) fn arrived(
        &self,
        header: &Header,
        trace: u64,
        deadline: Option<Instant>,
        body: &[u8],
    ) -> u64 {
        let Some((recorder, chassis)) = self.recorder() else {
            return 0;
        };
        let id = recorder.fresh_id();
        let what = Happened::Message {
            id,
            to: header.to,
            from: header.from,
            command: header.command,
            flags: header.flags.bits(),
            trace,
            deadline: deadline.map(Instant::as_nanos),
            side: Side::Receiver,
        };
        let head = Head {
            at: recorder.now(),
            chassis,
            what,
        };
        let noted = recorder.note(header.to, &head, |buffer| {
            buffer.extend_from_slice(body);
            true
        });
        if noted { id } else { 0 }
    }

    /// A handler is called.
    pub(crate) fn began(&self, at_hand: &AtHand) {
        let Some((recorder, chassis)) = self.recorder() else {
            return;
        };
        let AtHand {
            id,
            task,
            from,
            command,
            trace,
            began,
        } = *at_hand;
        let what = Happened::Began {
            id,
            task,
            from,
            command,
            trace,
        };
        let head = Head {
            at: began,
            chassis,
            what,
        };
        recorder.note(task, &head, |_| true);
    }

    /// It has returned.
    pub(crate) fn ended(&self, at_hand: &AtHand, now: Instant, ending: impl FnOnce() -> Ending) {
        let (recorder, chassis) = match self.0.get() {
            None => return,
            Some(Target::Replay(desk)) => return desk.ended(at_hand.command, ending()),
            Some(Target::Record { recorder, chassis }) => (recorder, *chassis),
        };
        let AtHand {
            id,
            task,
            from,
            command,
            trace,
            began,
        } = *at_hand;
        let what = Happened::Ended {
            id,
            task,
            from,
            command,
            trace,
            began,
            ending: ending(),
        };
        let head = Head {
            at: now.as_nanos(),
            chassis,
            what,
        };
        recorder.note(task, &head, |_| true);
    }

    /// A sender has what it waited for.
    pub(crate) fn answered(&self, id: u64, asked: &Asked, answer: Result<&Data, &Fault>) {
        let Some((recorder, chassis)) = self.recorder() else {
            return;
        };
        let side = if asked.to.chassis() == chassis {
            Side::Here
        } else {
            Side::Sender
        };
        note_answer(recorder, chassis, id, asked, side, answer);
    }

    /// A task of this chassis answers a message from another one.
    pub(crate) fn replied(
        &self,
        id: u64,
        request: &Header,
        trace: u64,
        answer: Result<&Data, &Fault>,
    ) {
        let Some((recorder, chassis)) = self.recorder() else {
            return;
        };
        let asked = Asked {
            by: request.from,
            to: request.to,
            command: request.command,
            trace,
        };
        note_answer(recorder, chassis, id, &asked, Side::Receiver, answer);
    }

    /// A task has entered a startup phase; without one, its handler has been built.
    pub(crate) fn phase(&self, task: Tid, phase: Option<Phase>) {
        if let Some((recorder, chassis)) = self.recorder() {
            let head = Head {
                at: recorder.now(),
                chassis,
                what: Happened::Phase { task, phase },
            };
            recorder.note(task, &head, |_| true);
        }
    }

    /// A task puts a value on a channel of its own.
    pub(crate) fn value<T: serde::Serialize + ?Sized>(&self, task: Tid, channel: &str, value: &T) {
        if let Some((recorder, chassis)) = self.recorder() {
            let channel = if channel.starts_with('/') {
                channel.to_owned()
            } else {
                format!("/{channel}")
            };
            let head = Head {
                at: recorder.now(),
                chassis,
                what: Happened::Value { channel },
            };
            recorder.note(task, &head, |buffer| {
                serde_json::to_writer(buffer, value).is_ok()
            });
        }
    }

    /// A task of this chassis was built.
    pub(crate) fn built(&self, task: Tid, name: &Arc<str>) {
        if let Some((recorder, _)) = self.recorder() {
            recorder.named(task, name);
            self.phase(task, None);
        }
    }

    /// A task used something that no message brings it, so that no record holds it.
    pub(crate) fn used(&self, what: impl FnOnce() -> String) {
        if let Some(Target::Replay(desk)) = self.0.get() {
            desk.used(what());
        }
    }
}

fn note_answer(
    recorder: &Recorder,
    chassis: u8,
    id: u64,
    asked: &Asked,
    side: Side,
    answer: Result<&Data, &Fault>,
) {
    let what = Happened::Answered {
        id,
        by: asked.to,
        to: asked.by,
        command: asked.command,
        trace: asked.trace,
        side,
        fault: answer.err().cloned(),
    };
    let head = Head {
        at: recorder.now(),
        chassis,
        what,
    };
    // Noted where it happened: at the one who answers, or at the one who asked.
    let place = if side == Side::Receiver {
        asked.to
    } else {
        asked.by
    };
    recorder.note(place, &head, |buffer| {
        answer.is_ok_and(|data| data.append_to(buffer).is_ok())
    });
}
