//! Where a chassis shows everything that passes: what is sent, what a handler begins and ends, what comes back.
//! A recorder looks on there, or a replay, or nobody, which costs one load.

use std::{
    borrow::Cow,
    fmt::Display,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

use serde::{Deserialize, Serialize};

use crate::{envelope::Message, phase::Phase, reply::ReplySlot, report::Ending};
use ctos_message::{CommandInfo, Data, Flags, Header, Tid, blob::Body, fault::Fault};
use ctos_time::Instant;

/// What the sender of a message waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitFor {
    /// The reply.
    Reply,
    /// That the receiver's queue has taken the message.
    Acceptance,
    /// Nothing: the message is taken now, or refused.
    Nothing,
}

impl WaitFor {
    /// The flags of a message whose sender waits so.
    pub fn flags(self) -> Flags {
        match self {
            Self::Reply => Flags::REPLY_WAIT,
            Self::Acceptance => Flags::ACCEPT_WAIT,
            Self::Nothing => Flags::NONE,
        }
    }
}

/// A request as its sender knows it, kept until the answer comes.
#[derive(Debug, Clone, Copy)]
pub struct Asked {
    pub by: Tid,
    pub to: Tid,
    pub command: u16,
    pub trace: u64,
}

impl Asked {
    pub(crate) fn of(message: &Message) -> Self {
        Self::by_header(message.header(), message.trace())
    }

    pub fn by_header(header: &Header, trace: u64) -> Self {
        Self {
            by: header.from,
            to: header.to,
            command: header.command,
            trace,
        }
    }
}

/// A message that was sent, as its sender knows it.
#[derive(Debug, Clone, Copy)]
pub struct Sent {
    pub(crate) asked: Asked,
    /// Its number in the record; 0: it is not in it.
    pub(crate) id: u64,
}

impl Sent {
    /// Before it is sent.
    pub(crate) fn of(message: &Message) -> Self {
        let asked = Asked::of(message);
        Self { asked, id: 0 }
    }
}

/// A message at whose handler a task is.
#[derive(Debug, Clone, Copy)]
pub struct AtHand {
    /// Its number in the record; 0: it is not in it.
    pub id: u64,
    pub asked: Asked,
    pub began: Instant,
}

/// When the sender of a message was told what it waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Came {
    /// In a poll that had begun otherwise.
    Later,
    /// In the poll in which it was sent: its sender did not wait.
    AtOnce,
    /// In a poll of its sender that began with it.
    First,
}

/// Which part of a task is polled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PartPolled {
    /// None.
    No,
    /// This one, and the record does not say so yet.
    Of(u64),
    /// One of which the record says so.
    Noted,
}

/// The number of a task's own loop among its parts; its children have others.
pub const LOOP: u64 = 0;

/// Writes data behind what is in a buffer: whether it could be written.
pub type WriteData<'a> = &'a dyn Fn(&mut Vec<u8>) -> bool;

/// How what a task records on a channel is written, in the words of MCAP.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChannelSchema {
    /// The name of the schema: `foxglove.SceneUpdate`.
    pub name: Cow<'static, str>,
    /// In which language the schema is written: `protobuf`, `jsonschema`.
    pub language: Cow<'static, str>,
    /// The schema.
    pub text: Cow<'static, [u8]>,
    /// How what stands in the channel is written: `protobuf`, `json`.
    pub encoding: Cow<'static, str>,
}

/// Who looks on. Every method is called on the thread on which it happens.
pub trait Observer: Send + Sync {
    /// Whether anything is recorded; if not, only [`Self::began`], [`Self::ended`] and what a replay answers are of use.
    fn is_recording(&self) -> bool;
    /// Whether it answers in place of all other tasks.
    fn replays(&self) -> bool;
    /// Answers in place of the receiver.
    fn replay(&self, message: &Message, wait: WaitFor, now: Instant, slot: ReplySlot);
    /// A message is sent by a task of this chassis: its number in the record, if it has one.
    fn sent(&self, message: &Message, wait: WaitFor) -> u64;
    /// A message has come over a link: its number.
    fn arrived(&self, header: &Header, trace: u64, deadline: Option<Instant>, body: &Body) -> u64;
    /// A handler is called.
    fn began(&self, at_hand: &AtHand);
    /// It has returned.
    fn ended(&self, at_hand: &AtHand, now: Instant, ending: Ending);
    /// An answer to message `id` has come to its sender.
    fn answered(&self, id: u64, asked: &Asked, came: Came, answer: Result<&Data, &Fault>);
    /// A task of this chassis answers message `id`, which came over a link.
    fn replied(&self, id: u64, asked: &Asked, answer: Result<&Data, &Fault>);
    /// A task was built, which takes `commands`.
    fn built(&self, task: Tid, name: &Arc<str>, commands: &[CommandInfo]);
    /// A task has entered a startup phase.
    fn phase(&self, task: Tid, phase: Phase);
    /// A task puts a value, as JSON, on a channel of its own.
    fn value(&self, task: Tid, channel: &str, value: WriteData<'_>);
    /// A task puts something, written as `schema` says, on a channel of its own.
    fn encoded(&self, task: Tid, channel: &str, schema: &Arc<ChannelSchema>, bytes: &[u8]);
    /// A part of a task is polled.
    fn polled(&self, task: Tid, part: u64);
    /// A task has read something that no message brings it; without `value` nobody can read that again.
    fn read(&self, task: Tid, what: &dyn Display, value: Option<WriteData<'_>>);
    /// Whether a replay polls a part of a task now.
    fn is_poll_of(&self, task: Tid, part: u64) -> bool;
    /// What a task has read at this place of a replayed record.
    fn read_again(&self, task: Tid, what: &dyn Display) -> Option<Vec<u8>>;
    /// How many recorders have come so far.
    fn came(&self) -> u64;
}

/// The place where observers look on.
#[derive(Default)]
pub struct Tap {
    watched: AtomicBool,
    observer: OnceLock<Arc<dyn Observer>>,
}

impl Tap {
    /// From now on `observer` is shown everything while it watches. The first call counts.
    pub fn set(&self, observer: Arc<dyn Observer>) {
        let _ = self.observer.set(observer);
    }

    /// Whether the observer looks on.
    pub fn watch(&self, watched: bool) {
        self.watched.store(watched, Ordering::Release);
    }

    /// Who looks on now.
    #[inline]
    pub(crate) fn observer(&self) -> Option<&dyn Observer> {
        if !self.watched.load(Ordering::Relaxed) {
            return None;
        }
        self.observer.get().map(AsRef::as_ref)
    }

    /// Who records.
    #[inline]
    pub fn recorder(&self) -> Option<&dyn Observer> {
        self.observer().filter(|observer| observer.is_recording())
    }

    /// A replay that answers in place of all other tasks.
    #[inline]
    pub(crate) fn replay(&self) -> Option<&dyn Observer> {
        self.observer().filter(|observer| observer.replays())
    }

    /// How many recorders have come so far, those that are gone included.
    pub(crate) fn came(&self) -> u64 {
        self.observer.get().map_or(0, |observer| observer.came())
    }
}
