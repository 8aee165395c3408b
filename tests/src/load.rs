//! Tasks that load a running app and keep account of every message, for tests that move, kill and record
//! them. Senders number what they send, the sink checks what it is given, the judge compares.

use std::{cell::RefCell, collections::BTreeMap, rc::Rc, time::Duration};

use ctos::{
    message::{Command, Message, Replier},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, HandlerError, Handover, Phase},
};
use serde::{Deserialize, Serialize};

/// How long something that must come may take.
const LIMIT: Duration = Duration::from_secs(20);
/// Between two looks.
const PAUSE: Duration = Duration::from_millis(10);

ctos::command! {
    /// The next number of a sender.
    pub struct Note { pub sender: String, pub urgent: bool, pub number: u64 } => u64, 1, "note"
}
ctos::command! {
    /// What was noted.
    pub struct Read => Account, 2, "read"
}
ctos::command! {
    /// Sends no more, and tells how many of each priority were sent and which were not taken.
    pub struct Enough => Sent, 3, "enough"
}
ctos::command! {
    /// Is answered so much later.
    pub struct Linger { pub time_s: f64 } => (), 4, "linger"
}

/// What a sink was given.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Account {
    /// Messages by sender and priority: the last number and how many.
    taken: BTreeMap<String, (u64, u64)>,
    /// What was doubled or out of order.
    wrong: Vec<String>,
    /// The chassis it has been on, in order.
    places: Vec<String>,
}

/// What a sender sent.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Sent {
    normal: u64,
    urgent: u64,
    failed: Vec<String>,
}

/// Keeps account.
struct Sink(Account);

impl Sink {
    fn note(&mut self, note: &Note) -> u64 {
        let lane = format!("{} {}", note.sender, note.urgent);
        let (last, count) = self.0.taken.entry(lane).or_default();
        if note.number != *last + 1 {
            let (number, sender) = (note.number, &note.sender);
            let line = format!("{number} of {sender} after {last}");
            self.0.wrong.push(line);
        }
        *last = note.number;
        *count += 1;
        *count
    }
}

impl EventHandler for Sink {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Note::CODE => {
                let (note, reply) = message.open::<Note>()?;
                let count = self.note(&note);
                reply.ok(count)
            }
            Read::CODE => {
                let (Read {}, reply) = message.open::<Read>()?;
                reply.ok(self.0.clone())
            }
            Linger::CODE => {
                let (Linger { time_s }, reply) = message.open::<Linger>()?;
                cx.sleep(Duration::from_secs_f64(time_s)).await;
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            self.0.places.push(cx.chassis().name().to_owned());
            tracing::warn!(task = cx.name(), places = self.0.places.len(), "is here");
        }
        Ok(())
    }
}

impl Handover for Sink {
    type State = Account;

    fn hand_over(&mut self) -> Result<Account, HandlerError> {
        Ok(std::mem::take(&mut self.0))
    }

    fn take_over(&mut self, _: &Context, account: Account) -> Handled {
        self.0 = account;
        Ok(())
    }
}

/// Arguments of [`Sender`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct SenderArgs {
    to: String,
    /// Between two messages, s.
    pause_s: f64,
}

/// Sends numbers of both priorities, by turns with and without waiting for the reply.
struct Sender {
    args: SenderArgs,
    /// Who wants to know when the last one is sent.
    enough: Rc<RefCell<Option<Replier<Enough>>>>,
}

impl EventHandler for Sender {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Enough::CODE => {
                let (Enough {}, reply) = message.open::<Enough>()?;
                *self.enough.borrow_mut() = Some(reply);
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (args, here, enough) = (self.args.clone(), cx.clone(), self.enough.clone());
            cx.spawn(async move {
                let mut sent = Sent::default();
                if let Err(error) = send_all(&here, &args, &enough, &mut sent).await {
                    sent.failed.push(error.to_string());
                }
                loop {
                    if let Some(reply) = enough.borrow_mut().take() {
                        // A reply cannot fail.
                        let _ = reply.ok(sent.clone());
                        return;
                    }
                    here.sleep(PAUSE).await;
                }
            });
        }
        Ok(())
    }
}

/// Sends until it is told that it is enough, or something goes wrong.
async fn send_all(
    cx: &Context,
    args: &SenderArgs,
    enough: &RefCell<Option<Replier<Enough>>>,
    sent: &mut Sent,
) -> Result<(), HandlerError> {
    let sink = cx.wait_for_task(&args.to, LIMIT).await?;
    while enough.borrow().is_none() {
        let urgent = (sent.normal + sent.urgent).is_multiple_of(3);
        let number = if urgent {
            sent.urgent + 1
        } else {
            sent.normal + 1
        };
        let note = Note {
            sender: cx.name().to_owned(),
            urgent,
            number,
        };
        match (urgent, number % 2) {
            (true, _) => cx.send(&sink, note).high_priority().deadline(LIMIT).await?,
            (false, 0) => cx.send(&sink, note).deadline(LIMIT).await?,
            (false, _) => {
                let count = cx.call(&sink, note).deadline(LIMIT).await?;
                if count != number {
                    return Err(format!("number {number} was counted as {count}").into());
                }
            }
        }
        if urgent {
            sent.urgent = number;
        } else {
            sent.normal = number;
        }
        cx.sleep(Duration::from_secs_f64(args.pause_s)).await;
    }
    Ok(())
}

/// Arguments of [`Judge`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct JudgeArgs {
    sink: String,
    senders: Vec<String>,
    /// After so many moves it is enough.
    moves: usize,
}

/// Ends the app with what became of all messages.
struct Judge(JudgeArgs);

impl EventHandler for Judge {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (args, here) = (self.0.clone(), cx.clone());
            cx.spawn(async move {
                let (ok, text) = match judged(&here, &args).await {
                    Ok(text) => (true, text),
                    Err(error) => (false, error.to_string()),
                };
                here.finish(AppResult {
                    ok,
                    json: serde_json::json!({ "ok": ok, "text": text }).to_string(),
                    text,
                });
            });
        }
        Ok(())
    }
}

/// Waits for the moves, has the sending stopped, and compares.
async fn judged(cx: &Context, args: &JudgeArgs) -> Result<String, HandlerError> {
    let sink = cx.wait_for_task(&args.sink, LIMIT).await?;
    loop {
        // It is not there while its chassis is started again.
        let account = cx.call(&sink, Read {}).deadline(LIMIT).await;
        if account.is_ok_and(|account| account.places.len() > args.moves) {
            break;
        }
        cx.sleep(PAUSE).await;
    }
    let mut sent = BTreeMap::new();
    for name in &args.senders {
        let sender = cx.task(name).await?;
        let account = cx.call(&sender, Enough {}).deadline(LIMIT).await?;
        if !account.failed.is_empty() {
            return Err(format!("{name} failed: {:?}", account.failed).into());
        }
        sent.insert(format!("{name} false"), account.normal);
        sent.insert(format!("{name} true"), account.urgent);
    }
    let began = cx.now();
    loop {
        let account = cx.call(&sink, Read {}).deadline(LIMIT).await?;
        let taken: BTreeMap<String, u64> = account
            .taken
            .iter()
            .map(|(lane, (_, count))| (lane.clone(), *count))
            .collect();
        let all: u64 = taken.values().sum();
        if !account.wrong.is_empty() {
            return Err(format!("doubled or out of order: {:?}", account.wrong).into());
        }
        if taken == sent {
            let places = account.places.join(" ");
            return Ok(format!(
                "all {all} messages came once and in order; {places}"
            ));
        }
        if cx.now().since(began) > LIMIT {
            return Err(format!("sent {sent:?}, taken {taken:?}").into());
        }
        cx.sleep(PAUSE).await;
    }
}

/// Arguments of [`Holder`].
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct HolderArgs {
    holds: String,
    time_s: f64,
}

/// Keeps a sink at one message for a while, again and again.
struct Holder(HolderArgs);

impl EventHandler for Holder {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (args, here) = (self.0.clone(), cx.clone());
            cx.spawn(async move {
                let time_s = args.time_s;
                let Ok(task) = here.wait_for_task(&args.holds, LIMIT).await else {
                    return;
                };
                while here
                    .call(&task, Linger { time_s })
                    .deadline(Duration::MAX)
                    .await
                    .is_ok()
                {}
            });
        }
        Ok(())
    }
}

/// Adds the handlers of this file.
pub fn register(registry: &mut Registry) {
    registry.handover("test.sink", &[Note::INFO, Read::INFO, Linger::INFO], |_| {
        Ok(Sink(Account::default()))
    });
    let sender = registry.handler("test.sender", &[Enough::INFO], |cx| {
        let args = cx.args()?;
        let enough = Rc::default();
        Ok(Sender { args, enough })
    });
    sender.args::<SenderArgs>();
    let judge = registry.handler("test.judge", &[], |cx| Ok(Judge(cx.args()?)));
    judge.args::<JudgeArgs>();
    let holder = registry.handler("test.holder", &[], |cx| Ok(Holder(cx.args()?)));
    holder.args::<HolderArgs>();
}
