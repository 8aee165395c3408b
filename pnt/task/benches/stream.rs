//! What displays cost the net that they follow. Measured are the firings per second of one net at full
//! speed on the real clock, alone and with 1, 10 and 100 displays. All are in one run and one chassis;
//! displays have a processor of their own, as they have in an app. Rounds with displays stand between
//! rounds without, and each is compared with its neighbours, so that what else the machine does falls on
//! both.
//!
//! The second figure is by the processor time of the net's thread: other programs on the core do not count.

#![allow(
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    clippy::print_stdout,
    reason = "a benchmark may end when its input is wrong; its figures are rounded"
)]

use std::{
    future::IntoFuture as _,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use bench::Bench;
use ctos::{
    config::load_texts,
    diagnostic::Source,
    message::{Command, CommandInfo, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, Phase, TaskRef},
};
use futures_util::future::join_all;
use pnt_language::{compile, exec::Conflicts};
use pnt_task::{
    library::Library,
    stream::{Follow, Mark},
    task::{COMMANDS, NetTask, PutTape},
};

/// Displays of a round.
const DISPLAYS: [usize; 3] = [1, 10, 100];
/// Rounds with each number of them.
const ROUNDS: usize = 31;
/// Commands of a round, each of which is one firing, and those that wait at a time.
const COMMANDS_A_ROUND: usize = 120 * AT_ONCE;
const AT_ONCE: usize = 512;

/// A command that is read and answered in one firing.
const ECHO: &str = "net echo\nplace free = 1\ncommand go -> gone\ntransition t\n  in free\n  tape go\n  out free\n  write gone\n";

ctos::command! {
    /// Begins to fire.
    struct Begin => (), 0x0700, "begin"
}

/// A net that begins when it is told to, since there is no boot.
struct Net(NetTask);

impl EventHandler for Net {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() == Begin::CODE {
            let (Begin {}, reply) = message.open::<Begin>()?;
            self.0.phase(cx, Phase::Run).await?;
            return reply.ok(());
        }
        self.0.handle(cx, message).await
    }
}

fn net() -> (Bench, TaskRef) {
    let net = compile::net(&Source::new("bench.net", ECHO)).unwrap();
    let mut registry = Registry::new();
    let commands: Vec<CommandInfo> = COMMANDS.iter().copied().chain([Begin::INFO]).collect();
    registry.handler("echo", &commands, move |cx| {
        let library = Library::new(());
        Ok(Net(NetTask::new(
            cx,
            net.clone(),
            library,
            Conflicts::Declared,
            None,
        )))
    });
    let text = "[app]\nname = \"bench\"\n[chassis.a]\nprocessors.main = {}\nprocessors.displays = {}\n[task.unused]\nhandler = \"echo\"\non = \"a\"\n";
    let app = load_texts(&[("app.toml", text)], &[], &[]).unwrap();
    let bench = Bench::start(app, registry).unwrap();
    let task = bench.tasks("echo", 1, 0, 1).unwrap().remove(0);
    bench.name(&task);
    let to = task.clone();
    let begun = bench.run(1, move |cx| async move { cx.call(&to, Begin {}).await });
    begun.unwrap().unwrap();
    (bench, task)
}

/// Follows until `ended`, as fast as it is answered.
async fn display(cx: &Context, to: &TaskRef, ended: &AtomicBool, answers: &AtomicU64) {
    let mut after: Option<Mark> = None;
    while !ended.load(Ordering::Relaxed) {
        let follow = Follow {
            after,
            patience_ms: 20,
        };
        after = Some(cx.call(to, follow).await.unwrap().mark);
        answers.fetch_add(1, Ordering::Relaxed);
    }
}

/// Processor time of this thread, ns.
fn processor_ns() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split(' ').next().unwrap().parse().unwrap()
}

/// What a round took: ns by the clock, and by the processor of the net's thread.
async fn fire(cx: Context, to: TaskRef) -> (u64, u64) {
    let put = || PutTape {
        symbol: "go".to_owned(),
        arguments: Vec::new(),
    };
    let (clock, processor) = (cx.now(), processor_ns());
    for _ in 0..COMMANDS_A_ROUND / AT_ONCE {
        let calls = (0..AT_ONCE).map(|_| cx.call(&to, put()).into_future());
        for answer in join_all(calls).await {
            answer.unwrap();
        }
    }
    (
        cx.now().as_nanos() - clock.as_nanos(),
        processor_ns() - processor,
    )
}

/// A round with so many displays; and how many answers these got.
fn round(bench: &Bench, net: &TaskRef, displays: usize) -> ((u64, u64), u64) {
    let ended = Arc::new(AtomicBool::new(false));
    let answers = Arc::new(AtomicU64::new(0));
    let (to, until, got) = (net.clone(), ended.clone(), answers.clone());
    let watched = bench.begin(2, move |cx| async move {
        join_all((0..displays).map(|_| display(&cx, &to, &until, &got))).await;
    });
    let to = net.clone();
    let took = bench.run(1, move |cx| fire(cx, to)).unwrap();
    ended.store(true, Ordering::Relaxed);
    watched.unwrap().recv().unwrap();
    (took, answers.load(Ordering::Relaxed))
}

fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

fn main() {
    let (bench, net) = net();
    let alone = || round(&bench, &net, 0).0;
    alone();
    let mut before = alone();
    let mut rates = Vec::new();
    let mut ratios = DISPLAYS.map(|_| (Vec::new(), Vec::new(), 0));
    for _ in 0..ROUNDS {
        for (displays, (clock, processor, answers)) in DISPLAYS.into_iter().zip(&mut ratios) {
            let (took, got) = round(&bench, &net, displays);
            let after = alone();
            // A rate is so many firings by the time they took: the same number in all rounds.
            let ratio = |with: u64, a: u64, b: u64| (a + b) as f64 / 2.0 / with as f64;
            clock.push(ratio(took.0, before.0, after.0));
            processor.push(ratio(took.1, before.1, after.1));
            *answers += got;
            rates.push(COMMANDS_A_ROUND as f64 * 1e9 / after.0 as f64);
            before = after;
        }
    }
    println!(
        "alone: {:.2} million firings/s, median of {}",
        median(rates.clone()) / 1e6,
        rates.len()
    );
    for (displays, (clock, processor, answers)) in DISPLAYS.into_iter().zip(ratios) {
        println!(
            "{displays:>3} displays: rate {:.4} of that alone, by processor time {:.4} (medians of {ROUNDS}); {} answers",
            median(clock),
            median(processor),
            answers
        );
    }
}
