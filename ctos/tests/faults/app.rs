//! The app that is tried: every way in which tasks deal with each other, over four chassis.

use std::time::Duration;

use ctos::{
    config::{App, load_texts},
    message::{Command, CommandInfo, Message, Replier},
    registry::Registry,
    sync::{CyclicHandle, Tick},
    system::{AppResult, Ping},
    task::{Context, EventHandler, Handled, Phase, StopReason, TaskRef},
};
use futures_util::future::join_all;
use rand::{RngExt, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use crate::ledger::{Ledger, Step};

ctos::command! {
    /// A message that is only sent.
    pub struct Item { pub id: u64, pub to: String, pub from: String } => (), 1, "item"
}
ctos::command! {
    /// Asks for twice a number and one.
    pub struct Ask { pub id: u64, pub to: String, pub from: String, pub number: u64, pub hops: u8 } => u64, 2, "ask"
}
ctos::command! {
    /// Takes the token and passes it on.
    pub struct Token { pub number: u64 } => (), 3, "token"
}

const COMMANDS: [CommandInfo; 3] = [Item::INFO, Ask::INFO, Token::INFO];

/// How long tasks send and call.
const LIFE: Duration = Duration::from_millis(1200);
/// How long what was sent then may still be under way.
const DRAIN: Duration = Duration::from_secs(3);

/// How long a task may take to answer, and all of them to be back after the worst that happens.
const PING: Duration = Duration::from_secs(1);
const RETURN: Duration = Duration::from_secs(60);

const CHASSIS: [&str; 4] = ["a", "b", "c", "d"];
const SINKS: usize = 8;
const SERVERS: usize = 4;
const RING: usize = 4;

/// What becomes of a chassis that dies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// The app ends with it.
    Ends,
    /// It is started again.
    Returns,
}

/// The app, without its seed.
pub fn app(policy: Policy) -> App {
    let returns = policy == Policy::Returns;
    let mut text =
        String::from("[app]\nuntil = \"conductor\"\nphase_timeout_s = 8.0\nstop_timeout_s = 0.3\n");
    for chassis in CHASSIS {
        let first = if chassis == "b" {
            "stop_first = true\n"
        } else {
            ""
        };
        text +=
            &format!("[chassis.{chassis}]\n{first}processors.one = {{}}\nprocessors.two = {{}}\n");
        if returns {
            text += "restart = \"on-failure\"\nmax_restarts = 1000\nrestart_backoff_s = 0.02\non_task_failure = \"restart-chassis\"\n";
        }
    }
    let place = |index: usize| {
        let processor = ["one", "two"][index / 4 % 2];
        format!("{}/{processor}", CHASSIS[index % 4])
    };
    let mut task = |name: String, kind: &str, on: String, more: &str| {
        text += &format!("[task.{name}]\nhandler = \"{kind}\"\non = \"{on}\"\n{more}\n");
    };
    let restarted = "restart = \"always\"\nmax_restarts = 100000";
    for index in 0..SINKS {
        // A short queue makes senders wait.
        let queue = if index % 2 == 0 { "queue = 4\n" } else { "" };
        let more = format!("{queue}{restarted}");
        task(format!("sink{index}"), "sink", place(index), &more);
    }
    for index in 0..SERVERS {
        task(
            format!("server{index}"),
            "server",
            place(index + 1),
            restarted,
        );
    }
    // A token that dies with a chassis is nobody's fault.
    for index in 0..if returns { 0 } else { RING } {
        task(format!("ring{index}"), "ring", place(index * 3), "");
    }
    if returns {
        // Its chassis fails with it.
        task("server4".to_owned(), "server", place(2), "");
    }
    for index in 0..4 {
        task(format!("sender{index}"), "sender", place(index), "");
        task(format!("caller{index}"), "caller", place(index + 4), "");
    }
    task("shaky".to_owned(), "shaky", place(6), "");
    task("stubborn".to_owned(), "stubborn", place(3), "");
    task("conductor".to_owned(), "conductor", place(0), "");
    load_texts(&[("faults.toml", &text)], &[], &[]).unwrap()
}

/// The handlers of the app, which write what they do into `ledger`.
pub fn registry(ledger: &Ledger) -> Registry {
    let mut registry = Registry::new();
    for kind in [
        "sink",
        "server",
        "ring",
        "sender",
        "caller",
        "shaky",
        "stubborn",
        "conductor",
    ] {
        let ledger = ledger.clone();
        registry.handler(kind, &COMMANDS, move |cx: &Context| {
            Ok(Actor::new(kind, cx, ledger.clone()))
        });
    }
    registry
}

struct Actor {
    kind: &'static str,
    ledger: Ledger,
    rng: ChaCha8Rng,
    incarnation: u32,
    cyclic: Option<CyclicHandle>,
}

impl Actor {
    fn new(kind: &'static str, cx: &Context, ledger: Ledger) -> Self {
        ledger.built(cx);
        let mut book = ledger.book();
        book.alive += 1;
        // What it began in an earlier life has ended with that.
        book.active.remove(cx.name());
        let incarnation = book.incarnations.entry(cx.name().to_owned()).or_default();
        *incarnation += 1;
        let incarnation = *incarnation;
        drop(book);
        // Another incarnation draws other numbers, or it would panic at the same ones again.
        let rng = cx.rng(&format!("actor {incarnation}"));
        Self {
            kind,
            ledger,
            rng,
            incarnation,
            cyclic: None,
        }
    }

    fn one_in(&mut self, count: u32) -> bool {
        self.rng.random_range(0..count) == 0
    }

    fn millis(&mut self, most: u64) -> Duration {
        Duration::from_micros(self.rng.random_range(0..most * 1000))
    }

    fn breaks(&self, cx: &Context, how: &str) -> ! {
        self.ledger.book().broken.insert(cx.name().to_owned());
        panic!("{how}");
    }

    async fn item(&mut self, cx: &Context, item: Item, reply: Replier<Item>) -> Handled {
        self.ledger.begins(cx, item.id, &item.to, &item.from);
        if self.one_in(10) {
            let busy = self.millis(5);
            cx.sleep(busy).await;
        }
        if self.one_in(200) {
            self.breaks(cx, "a sink breaks down");
        }
        reply.ok(())
    }

    async fn ask(&mut self, cx: &Context, ask: Ask, reply: Replier<Ask>) -> Handled {
        self.ledger.begins(cx, ask.id, &ask.to, &ask.from);
        let answer = ask.number * 2 + 1;
        match self.rng.random_range(0..100) {
            0 => self.breaks(cx, "a server breaks down"),
            1..4 => return reply.fail("not today"),
            // Dropped without an answer.
            4..7 => return Ok(()),
            7..25 => {
                let busy = self.millis(20);
                cx.sleep(busy).await;
            }
            25..45 => {
                // Answered later, while others are served.
                let (later, cx2) = (self.millis(100), cx.clone());
                cx.spawn(async move {
                    cx2.sleep(later).await;
                    let _ = reply.ok(answer);
                });
                return Ok(());
            }
            45..60 if ask.hops > 0 => {
                // Waits for another server, which may wait for this one.
                let other = format!("server{}", self.rng.random_range(0..SERVERS));
                let deadline = Duration::from_millis(self.rng.random_range(1..200));
                let next = resolve(cx, &self.ledger, &other).await?;
                let further = call(cx, &self.ledger, &next, deadline, false, ask.hops - 1).await;
                return match further {
                    Ok(()) => reply.ok(answer),
                    Err(error) => reply.fail(error),
                };
            }
            _ => {}
        }
        reply.ok(answer)
    }

    /// What the task does by itself once everybody runs.
    fn play(&mut self, cx: &Context) {
        let (cx2, ledger) = (cx.clone(), self.ledger.clone());
        match self.kind {
            "sender" => cx.spawn(send_all(cx2, ledger)),
            "caller" => cx.spawn(call_all(cx2, ledger)),
            "conductor" => cx.spawn(conduct(cx2, ledger)),
            "ring" if cx.name() == "ring0" => cx.spawn(async move {
                let first = resolve(&cx2, &ledger, "ring1").await.unwrap();
                // A task that does not take it ends the ring.
                let _ = cx2.send(&first, Token { number: 0 }).await;
            }),
            "sink" => {
                let mut last = 0;
                let ledger = self.ledger.clone();
                let tick = move |tick: &Tick| {
                    if tick.count <= last || tick.count != last + 1 + tick.missed {
                        let text = format!("tick {} after {last}: {tick:?}", tick.count);
                        ledger.book().wrong.push(text);
                    }
                    last = tick.count;
                };
                self.cyclic = Some(cx.cyclic(Duration::from_millis(7), tick));
            }
            _ => {}
        }
    }
}

impl Drop for Actor {
    fn drop(&mut self) {
        self.ledger.book().alive -= 1;
    }
}

impl EventHandler for Actor {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Item::CODE => {
                let (item, reply) = message.open::<Item>()?;
                self.item(cx, item, reply).await
            }
            Ask::CODE => {
                let (ask, reply) = message.open::<Ask>()?;
                self.ask(cx, ask, reply).await
            }
            Token::CODE => {
                let (Token { number }, _) = message.open::<Token>()?;
                self.ledger.token(cx, number);
                cx.sleep(Duration::from_millis(1)).await;
                if self.ledger.book().quiet {
                    return Ok(());
                }
                let here: usize = cx.name()[4..].parse()?;
                let next = format!("ring{}", (here + 1) % RING);
                let next = resolve(cx, &self.ledger, &next).await?;
                let _ = cx.send(&next, Token { number: number + 1 }).await;
                Ok(())
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        self.ledger.phase(cx, self.incarnation, phase, Step::Enters);
        let takes = self.millis(3);
        cx.sleep(takes).await;
        if phase == Phase::Connect && self.incarnation == 1 {
            for name in ["sink3", "server2", "sink0"] {
                resolve(cx, &self.ledger, name).await?;
            }
        }
        if self.kind == "shaky" && self.one_in(36) {
            match self.rng.random_range(0..3) {
                0 => return Err("it does not start".into()),
                1 => panic!("it breaks down while it starts"),
                _ => std::future::pending::<()>().await,
            }
        }
        self.ledger
            .phase(cx, self.incarnation, phase, Step::Entered);
        if phase == Phase::Run {
            self.play(cx);
        }
        Ok(())
    }

    async fn stop(&mut self, cx: &Context, _reason: &StopReason) -> Handled {
        let now = self.ledger.clock.now();
        self.ledger.book().stops.insert(cx.name().to_owned(), now);
        if self.kind == "stubborn" && self.one_in(4) {
            std::future::pending::<()>().await;
        }
        Ok(())
    }
}

async fn resolve(
    cx: &Context,
    ledger: &Ledger,
    name: &str,
) -> Result<TaskRef, ctos::task::NameError> {
    let task = cx.task(name).await?;
    ledger.resolved(name, task.tid());
    Ok(task)
}

fn deadline(rng: &mut ChaCha8Rng) -> Duration {
    let millis = [5, 50, 400, 2000].choose(rng).copied();
    Duration::from_millis(millis.unwrap())
}

/// Sends one message and writes down how it ended.
async fn send(cx: &Context, ledger: &Ledger, to: &TaskRef, deadline: Duration, urgent: bool) {
    let item = Item {
        id: ledger.sends(cx, to, urgent, deadline, false),
        to: to.name().to_owned(),
        from: cx.name().to_owned(),
    };
    let id = item.id;
    let mut send = cx.send(to, item).deadline(deadline);
    if urgent {
        send = send.high_priority();
    }
    let result = send.await.map_err(|error| error.fault);
    ledger.ended(cx, id, result);
}

/// Calls, checks the answer and writes down how it ended.
async fn call(
    cx: &Context,
    ledger: &Ledger,
    to: &TaskRef,
    deadline: Duration,
    urgent: bool,
    hops: u8,
) -> Result<(), ctos::call::CallError> {
    let id = ledger.sends(cx, to, urgent, deadline, true);
    let ask = Ask {
        id,
        to: to.name().to_owned(),
        from: cx.name().to_owned(),
        number: id * 7,
        hops,
    };
    let mut call = cx.call(to, ask).deadline(deadline);
    if urgent {
        call = call.high_priority();
    }
    let result = call.await;
    if let Ok(answer) = &result
        && *answer != id * 14 + 1
    {
        let text = format!("{} got the answer {answer} to {}", cx.name(), id * 7);
        ledger.book().wrong.push(text);
    }
    let told = result
        .as_ref()
        .map(|_| ())
        .map_err(|error| error.fault.clone());
    ledger.ended(cx, id, told);
    result.map(|_| ())
}

/// Sends bursts of both priorities, to one sink at a time, until it is quiet.
async fn send_all(cx: Context, ledger: Ledger) {
    ledger.book().active.insert(cx.name().to_owned());
    let mut rng = cx.rng("sends");
    while !ledger.book().quiet {
        let sink = format!("sink{}", rng.random_range(0..SINKS));
        if let Ok(sink) = resolve(&cx, &ledger, &sink).await {
            let mut burst: Vec<futures_util::future::LocalBoxFuture<'_, ()>> = Vec::new();
            for _ in 0..rng.random_range(1..10) {
                let urgent = rng.random_range(0..4) == 0;
                let deadline = deadline(&mut rng);
                burst.push(Box::pin(send(&cx, &ledger, &sink, deadline, urgent)));
            }
            join_all(burst).await;
        }
        cx.sleep(Duration::from_micros(rng.random_range(0..40_000)))
            .await;
    }
    ledger.book().active.remove(cx.name());
}

fn servers_of(cx: &Context) -> usize {
    let tasks = cx.app().tasks.iter();
    tasks.filter(|task| task.handler == "server").count()
}

/// Calls servers, several at once, until it is quiet.
async fn call_all(cx: Context, ledger: Ledger) {
    ledger.book().active.insert(cx.name().to_owned());
    let mut rng = cx.rng("calls");
    while !ledger.book().quiet {
        let mut servers = Vec::new();
        for _ in 0..rng.random_range(1..4) {
            let servers_there = servers_of(&cx);
            let server = format!("server{}", rng.random_range(0..servers_there));
            servers.extend(resolve(&cx, &ledger, &server).await.ok());
        }
        let calls = servers.iter().map(|server| {
            let urgent = rng.random_range(0..4) == 0;
            call(&cx, &ledger, server, deadline(&mut rng), urgent, 2)
        });
        let calls: Vec<_> = calls.collect();
        join_all(calls).await;
        cx.sleep(Duration::from_micros(rng.random_range(0..40_000)))
            .await;
    }
    ledger.book().active.remove(cx.name());
}

/// The tasks that do not answer to their names, though they are given time.
async fn names_missing(cx: &Context, ledger: &Ledger) -> Vec<String> {
    let mut missing: Vec<String> = cx
        .app()
        .tasks
        .iter()
        .map(|task| task.name.clone())
        .collect();
    missing.retain(|name| name != cx.name());
    let began = cx.now();
    // A chassis may be on its way back, and a link broken for a while.
    while !missing.is_empty() && cx.now().since(began) < RETURN {
        let mut left = Vec::new();
        for name in missing {
            let answers = match resolve(cx, ledger, &name).await {
                Ok(task) => cx.call(&task, Ping {}).deadline(PING).await.is_ok(),
                Err(_) => false,
            };
            if !answers {
                left.push(name);
            }
        }
        missing = left;
        cx.sleep(PING / 10).await;
    }
    missing
}

/// Lets everybody play for a while, waits until all is over, and ends the app.
async fn conduct(cx: Context, ledger: Ledger) {
    cx.sleep(LIFE).await;
    ledger.book().quiet = true;
    while !ledger.book().active.is_empty() {
        cx.sleep(Duration::from_millis(100)).await;
    }
    cx.sleep(DRAIN).await;
    for name in &names_missing(&cx, &ledger).await {
        let text = format!("`{name}` does not answer to its name in the end");
        ledger.book().wrong.push(text);
    }
    cx.finish(AppResult {
        ok: true,
        text: "played".to_owned(),
        json: String::new(),
    });
}
