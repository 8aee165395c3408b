//! What running a net costs around its firings, in one chassis, on the real clock, with a real redb file.
//! Measured are commands per second of a durable net and of one that is not, and a token to another net
//! beside a message call. Then the time from one action's end to the start of the action that it enables. The
//! last is also measured to another process, which `-- processes` measures alone.

#![allow(
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    clippy::panic,
    clippy::print_stdout,
    reason = "a benchmark may end when its input is wrong; its figures are rounded"
)]

use std::{cell::RefCell, future::IntoFuture as _, rc::Rc, sync::Arc};

use bench::Bench;
use ctos::{
    config::load_texts,
    diagnostic::Source,
    message::{Command, CommandInfo, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, Phase, TaskRef},
};
use divan::{Bencher, counter::ItemsCount};
use futures_util::future::join_all;
use pnt_language::compile;
use pnt_task::{
    library::{Action, Library},
    task::{COMMANDS, NetTask, PutTape, Settings},
};

/// Commands, or calls, that are measured together.
const BATCH: usize = 4096;

/// Commands that wait for their answers at a time.
const AT_ONCE: usize = 512;

/// Actions of which the start is timed.
const ACTIONS: u32 = 20_000;

#[path = "running/processes.rs"]
mod processes;

fn main() {
    if processes::is_child() {
        return;
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let is_given = |word: &str| arguments.iter().any(|given| given == word);
    // Without `--bench` this is a test that the benchmark is compiled in.
    let measures = is_given("--bench");
    if measures && is_given("processes") {
        return processes::latency(&arguments);
    }
    latency();
    if measures {
        processes::latency(&[]);
    }
    divan::main();
}

ctos::command! {
    /// Begins to fire.
    struct Begin => (), 0x0700, "begin"
}
ctos::command! {
    /// Answers with one number.
    struct Ask { data: u64 } => u64, 0x0701, "ask"
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

/// What a net's function adds to.
type Starts = Arc<std::sync::Mutex<Vec<u64>>>;

struct Nets {
    bench: Bench,
    tasks: Vec<TaskRef>,
    /// Removed with everything in it.
    _folder: tempfile::TempDir,
}

fn nets(texts: &[&str], durable: bool, starts: &Starts) -> Nets {
    let folder = tempfile::tempdir().unwrap();
    let mut registry = Registry::new();
    let commands: Vec<CommandInfo> = COMMANDS.iter().copied().chain([Begin::INFO]).collect();
    let mut names = Vec::new();
    for text in texts {
        let net = compile::net(&Source::new("bench.net", *text)).unwrap();
        let settings = Settings {
            durable,
            store: folder.path().display().to_string(),
            ..Settings::default()
        };
        let starts = starts.clone();
        let name = net.name().to_owned();
        registry.handler(&name, &commands, move |cx| {
            let starts = starts.clone();
            let library = Library::new(()).action("note", move |action: Action<()>| {
                let now = action.cx().now().as_nanos();
                starts.lock().unwrap().push(now);
                async { Ok(()) }
            });
            let settings = settings.clone();
            NetTask::with_settings(cx, net.clone(), library, None, settings).map(Net)
        });
        names.push(name);
    }
    registry.function::<Ask, _, _>("ask", |_, Ask { data }| async move { Ok(data) });
    let text = "[app]\nname = \"bench\"\n[chassis.a]\nprocessors.main = {}\n[task.unused]\nhandler = \"ask\"\non = \"a\"\n";
    let app = load_texts(&[("app.toml", text)], &[], &[]).unwrap();
    let bench = Bench::start(app, registry).unwrap();
    let mut tasks = Vec::new();
    for (name, slot) in names.iter().map(String::as_str).chain(["ask"]).zip(0..) {
        let started = bench.tasks(name, 1, slot, 1).unwrap();
        bench.name(&started[0]);
        tasks.extend(started);
    }
    let to = tasks.clone();
    let begun = bench.run(1, move |cx| async move {
        for net in to.iter().take(to.len() - 1) {
            cx.call(net, Begin {}).await.unwrap();
        }
    });
    begun.unwrap();
    Nets {
        bench,
        tasks,
        _folder: folder,
    }
}

/// A command that is read and answered in one firing.
const ECHO: &str = "net echo\nplace free = 1\ncommand go -> gone\ntransition t\n  in free\n  tape go\n  out free\n  write gone\n";

/// A command that sends a token to another net and waits until it is back.
const HERE: &str = "net here\nplace free = 1, back\ncommand go -> gone\ntransition t\n  in free\n  tape go\n  out there@there\ntransition u\n  in back\n  out free\n  write gone\n";
const THERE: &str = "net there\nplace there\ntransition t\n  in there\n  out back@here\n";

fn put() -> PutTape {
    PutTape {
        symbol: "go".to_owned(),
        arguments: Vec::new(),
    }
}

/// Puts [`BATCH`] commands, so many at a time, and waits for all answers.
async fn commands(cx: Context, to: TaskRef, at_once: usize) {
    for _ in 0..BATCH / at_once {
        let calls = (0..at_once).map(|_| cx.call(&to, put()).into_future());
        for answer in join_all(calls).await {
            answer.unwrap();
        }
    }
}

/// Firings per second of a net whose every firing answers somebody, durable and not.
#[divan::bench(args = [false, true], max_time = 10)]
fn answered_firings(bencher: Bencher, durable: bool) {
    let nets = nets(&[ECHO], durable, &Starts::default());
    let to = nets.tasks[0].clone();
    bencher.counter(ItemsCount::new(BATCH)).bench(|| {
        let to = to.clone();
        let work = move |cx| commands(cx, to, AT_ONCE);
        nets.bench.run(1, work).unwrap();
    });
}

/// Calls of a plain task, one after the other.
#[divan::bench]
fn message_calls(bencher: Bencher) {
    let nets = nets(&[ECHO], false, &Starts::default());
    let to = nets.tasks[1].clone();
    bencher.counter(ItemsCount::new(BATCH)).bench(|| {
        let to = to.clone();
        let work = move |cx: Context| async move {
            for data in 0..BATCH as u64 {
                cx.call(&to, Ask { data }).await.unwrap();
            }
        };
        nets.bench.run(1, work).unwrap();
    });
}

/// Commands, one after the other, that are answered at once.
#[divan::bench]
fn commands_answered_at_once(bencher: Bencher) {
    let nets = nets(&[ECHO], false, &Starts::default());
    let to = nets.tasks[0].clone();
    bencher.counter(ItemsCount::new(BATCH)).bench(|| {
        let to = to.clone();
        let work = move |cx| commands(cx, to, 1);
        nets.bench.run(1, work).unwrap();
    });
}

/// Commands, one after the other, for each of which two tokens travel: what they take longer than the
/// ones above, halved, is a remote token.
#[divan::bench]
fn commands_over_two_remote_tokens(bencher: Bencher) {
    let nets = nets(&[HERE, THERE], false, &Starts::default());
    let to = nets.tasks[0].clone();
    bencher.counter(ItemsCount::new(BATCH)).bench(|| {
        let to = to.clone();
        let work = move |cx| commands(cx, to, 1);
        nets.bench.run(1, work).unwrap();
    });
}

/// The time from the start of an action that ends at once to the start of the one that it enables.
fn latency() {
    let text = "net ring\nplace p = 1, q\ncommand go -> gone\ntransition t\n  in p\n  tape go\n  out q\ntransition a\n  in q\n  do note\n  out q\ntransition never\n  in q*2\n  out q, p\n  write gone\n";
    let starts = Starts::default();
    let nets = nets(&[text], false, &starts);
    let (to, seen) = (nets.tasks[0].clone(), starts.clone());
    let work = move |cx: Context| async move {
        let given_up = Rc::new(RefCell::new(false));
        let put = cx.call(&to, put()).into_future();
        let waited = async {
            while seen.lock().unwrap().len() < ACTIONS as usize {
                cx.sleep(std::time::Duration::from_millis(1)).await;
            }
            *given_up.borrow_mut() = true;
        };
        // The command is never answered: the call is dropped when enough was seen.
        let (put, waited) = (std::pin::pin!(put.into_future()), std::pin::pin!(waited));
        futures_util::future::select(put, waited).await;
    };
    nets.bench.run(1, work).unwrap();
    let starts = starts.lock().unwrap();
    let mut gaps: Vec<u64> = starts.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_unstable();
    let at = |share: f64| gaps[((gaps.len() - 1) as f64 * share) as usize] as f64 / 1e3;
    println!(
        "from an action to the next one's start, in a chassis: median {:.2} us, p99 {:.2} us, p99.9 {:.2} us (wanted: p99 below 5)",
        at(0.5),
        at(0.99),
        at(0.999)
    );
}
