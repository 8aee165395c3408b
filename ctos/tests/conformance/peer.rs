//! The tasks that the cases play with.

use std::collections::BTreeMap;

use ctos::{
    Blob,
    message::{Command, CommandInfo, Message, Replier},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError, Handover},
};
use serde::{Deserialize, Serialize};

/// A value with a bit of everything that messages carry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Value {
    Nothing,
    Pair(f64, Option<i64>),
    Named { text: String, list: Vec<f32> },
}

ctos::command! {
    /// Answers what it was given.
    pub struct Echo { pub value: Value } => Value, 1, "echo"
}
ctos::command! {
    /// Answers bytes with the same bytes.
    pub struct Mirror { pub bytes: Blob } => Blob, 2, "mirror"
}
ctos::command! {
    /// Answers with so many bytes.
    pub struct Produce { pub size: usize } => Blob, 3, "produce"
}
ctos::command! {
    /// Is refused.
    pub struct Refuse => (), 4, "refuse"
}
ctos::command! {
    /// Is never answered.
    pub struct Forget => (), 5, "forget"
}
ctos::command! {
    /// Panics.
    pub struct Panic => (), 6, "panic"
}
ctos::command! {
    /// Is answered when `release` says so.
    pub struct Hold { pub number: u32 } => u32, 7, "hold"
}
ctos::command! {
    /// Answers what is held, in this order.
    pub struct Release { pub order: Vec<u32> } => (), 8, "release"
}
ctos::command! {
    /// Is written down.
    pub struct Note { pub sender: u32, pub number: u32 } => (), 9, "note"
}
ctos::command! {
    /// What was written down.
    pub struct Log => Vec<(u32, u32)>, 10, "log"
}
ctos::command! {
    /// Keeps the handler busy until the gate opens.
    pub struct Block => (), 11, "block"
}
ctos::command! {
    /// Sends notes 0 to `count` to a task, as sender `sender`.
    pub struct Flood { pub to: String, pub sender: u32, pub count: u32 } => (), 12, "flood"
}
ctos::command! {
    /// Calls `echo` of a task so many times, each within its own deadline, ms, and tells how many
    /// calls were answered.
    pub struct CallOther { pub to: String, pub count: u32, pub deadline_ms: u64 } => u32, 13, "call_other"
}
ctos::command! {
    /// Makes the other of two tasks call back while this one waits for it.
    pub struct CallBack { pub to: String, pub back: String } => u32, 14, "call_back"
}
ctos::command! {
    /// Answers with the trace and the time left, µs, of this message, and of those it leads to when it is
    /// passed on along `to`.
    pub struct Trail { pub to: Vec<String> } => Vec<(u64, Option<u64>)>, 15, "trail"
}
ctos::command! {
    /// Is answered when the gate opens.
    pub struct Wait => (), 1, "wait"
}
ctos::command! {
    /// How many wait at the gate.
    pub struct Waiting => usize, 2, "waiting"
}
ctos::command! {
    /// Opens the gate for those who wait.
    pub struct Open => (), 3, "open"
}

/// Under the code of `echo`, but other data.
#[derive(Debug, Serialize, Deserialize)]
pub struct WrongEcho {
    pub value: u8,
}

impl Command for WrongEcho {
    type Reply = Value;
    const CODE: u16 = Echo::CODE;
    const NAME: &'static str = "echo";
    const DOC: &'static str = "Not an echo.";
}

ctos::command! {
    /// Nobody takes this.
    pub struct Fly => (), 0x0999, "fly"
}

const COMMANDS: [CommandInfo; 15] = [
    Echo::INFO,
    Mirror::INFO,
    Produce::INFO,
    Refuse::INFO,
    Forget::INFO,
    Panic::INFO,
    Hold::INFO,
    Release::INFO,
    Note::INFO,
    Log::INFO,
    Block::INFO,
    Flood::INFO,
    CallOther::INFO,
    CallBack::INFO,
    Trail::INFO,
];

#[derive(Default)]
struct Peer {
    held: BTreeMap<u32, Replier<Hold>>,
    notes: Vec<(u32, u32)>,
}

impl EventHandler for Peer {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Echo::CODE => {
                let (Echo { value }, reply) = message.open::<Echo>()?;
                reply.ok(value)
            }
            Mirror::CODE => {
                let (Mirror { bytes }, reply) = message.open::<Mirror>()?;
                reply.ok(bytes)
            }
            Produce::CODE => {
                let (Produce { size }, reply) = message.open::<Produce>()?;
                reply.ok(vec![7; size].into())
            }
            Refuse::CODE => Err("the arm is cold".into()),
            Forget::CODE => Ok(()),
            Panic::CODE => panic!("as it was told"),
            Hold::CODE => {
                let (Hold { number }, reply) = message.open::<Hold>()?;
                self.held.insert(number, reply);
                Ok(())
            }
            Release::CODE => {
                let (Release { order }, reply) = message.open::<Release>()?;
                for number in order {
                    let held = self.held.remove(&number).ok_or("it is not held")?;
                    held.ok(number * 10)?;
                }
                reply.ok(())
            }
            Note::CODE => {
                let (Note { sender, number }, reply) = message.open::<Note>()?;
                self.notes.push((sender, number));
                reply.ok(())
            }
            Log::CODE => {
                let (Log {}, reply) = message.open::<Log>()?;
                reply.ok(self.notes.clone())
            }
            Block::CODE => {
                let (Block {}, reply) = message.open::<Block>()?;
                let gate = cx.task("gate").await?;
                cx.call(&gate, Wait {}).await?;
                reply.ok(())
            }
            Flood::CODE => {
                let (flood, reply) = message.open::<Flood>()?;
                let to = cx.task(&flood.to).await?;
                for number in 0..flood.count {
                    let sender = flood.sender;
                    cx.send(&to, Note { sender, number }).await?;
                }
                reply.ok(())
            }
            CallOther::CODE => {
                let (request, reply) = message.open::<CallOther>()?;
                let to = cx.task(&request.to).await?;
                let deadline = std::time::Duration::from_millis(request.deadline_ms);
                let mut answered = 0;
                for _ in 0..request.count {
                    let value = Value::Nothing;
                    let called = cx.call(&to, Echo { value }).deadline(deadline);
                    answered += u32::from(called.await.is_ok());
                }
                reply.ok(answered)
            }
            CallBack::CODE => {
                let (request, reply) = message.open::<CallBack>()?;
                let to = cx.task(&request.to).await?;
                let back = CallOther {
                    to: request.back,
                    count: 1,
                    deadline_ms: 50,
                };
                reply.ok(cx.call(&to, back).await?)
            }
            Trail::CODE => {
                let left = message.deadline().map(|deadline| {
                    let left = deadline.since(cx.now()).as_micros();
                    u64::try_from(left).unwrap_or(u64::MAX)
                });
                let mut trail = vec![(message.trace(), left)];
                let (Trail { mut to }, reply) = message.open::<Trail>()?;
                if let Some(next) = to.pop() {
                    let next = cx.task(&next).await?;
                    trail.extend(cx.call(&next, Trail { to }).await?);
                }
                reply.ok(trail)
            }
            _ => cx.default_processing(message),
        }
    }
}

impl Handover for Peer {
    type State = Vec<(u32, u32)>;

    fn hand_over(&mut self) -> Result<Self::State, HandlerError> {
        Ok(std::mem::take(&mut self.notes))
    }

    fn take_over(&mut self, _: &Context, notes: Self::State) -> Handled {
        self.notes = notes;
        Ok(())
    }
}

#[derive(Default)]
struct Gate {
    waiting: Vec<Replier<Wait>>,
}

impl EventHandler for Gate {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Wait::CODE => {
                let (Wait {}, reply) = message.open::<Wait>()?;
                self.waiting.push(reply);
                Ok(())
            }
            Waiting::CODE => {
                let (Waiting {}, reply) = message.open::<Waiting>()?;
                reply.ok(self.waiting.len())
            }
            Open::CODE => {
                let (Open {}, reply) = message.open::<Open>()?;
                for waiting in self.waiting.drain(..) {
                    waiting.ok(())?;
                }
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

pub fn register(registry: &mut Registry) {
    registry.handler("suite.peer", &COMMANDS, |_| Ok(Peer::default()));
    registry.handover("suite.roamer", &COMMANDS, |_| Ok(Peer::default()));
    let gate = [Wait::INFO, Waiting::INFO, Open::INFO];
    registry.handler("suite.gate", &gate, |_| Ok(Gate::default()));
}
