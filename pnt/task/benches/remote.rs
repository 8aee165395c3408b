//! The cost of a token to another net, against a message call to the same place. That net is on the same
//! processor, on another one of the same chassis, or in another process.
//!
//! A command is answered when two tokens have moved: to another net and back, or through two places of the
//! same net. Half of the difference is what it costs that a token is remote. `--pin` keeps both processes on
//! one core, `--pin2` gives each a core of its own. With `--local` there is one row, of the net on the same
//! processor.

#![allow(
    clippy::panic,
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    clippy::print_stdout,
    reason = "a benchmark ends where something is wrong, and prints"
)]

use std::{
    ffi::OsString,
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{End, Launcher, Observer, boot, run_chassis},
    config::{App, load_texts},
    diagnostic::Source,
    message::{CommandInfo, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase, TaskRef},
    time::{Clock, Instant},
};
use pnt_language::compile;
use pnt_task::{
    library::Library,
    task::{COMMANDS, NetTask, PutTape, Settings},
};

ctos::command! {
    /// Answers with one number.
    struct Ask { data: u64 } => u64, 1, "ask"
}

/// Where the other net is: the name of the place, its chassis and its processor.
const PLACES: [(&str, &str, &str); 3] = [
    ("the same processor", "a", "main"),
    ("another processor", "a", "other"),
    ("another process", "b", "main"),
];

const LIMIT: Duration = Duration::from_millis(500);
const ROUNDS: usize = 5;

/// Two tokens, through places of the same net.
const LOCAL: &str = "net local
place free = 1, there, back
command go -> gone
transition t
  in free
  tape go
  out there
transition v
  in there
  out back
transition u
  in back
  out free
  write gone
";

/// The same, there and back through the net of a place.
fn pair(place: usize) -> [(String, String); 2] {
    let here = format!(
        "net here{place}\nplace free = 1, back\ncommand go -> gone\ntransition t\n  in free\n  tape go\n  out there@there{place}\ntransition u\n  in back\n  out free\n  write gone\n"
    );
    let there = format!(
        "net there{place}\nplace there\ntransition v\n  in there\n  out back@here{place}\n"
    );
    [
        (format!("here{place}"), here),
        (format!("there{place}"), there),
    ]
}

fn app(spin: &str, places: usize) -> App {
    let mut text = format!(
        "[app]\nuntil = \"driver\"\n{spin}\n[chassis.a]\nprocessors.main = {{}}\nprocessors.other = {{}}\n"
    );
    if places == PLACES.len() {
        text.push_str("[chassis.b]\nprocessors.main = {}\n");
    }
    let mut task = |name: &str, handler: &str, (on, processor): (&str, &str)| {
        text.push_str(&format!(
            "[task.{name}]\nhandler = \"{handler}\"\non = \"{on}/{processor}\"\n"
        ));
    };
    let main = ("a", "main");
    task("driver", "driver", main);
    task("local", "local", main);
    for (place, (_, on, processor)) in PLACES.iter().enumerate().take(places) {
        task(&format!("here{place}"), &format!("here{place}"), main);
        let other = (*on, *processor);
        task(&format!("there{place}"), &format!("there{place}"), other);
        task(&format!("ask{place}"), "ask", other);
    }
    load_texts(&[("remote.toml", text.as_str())], &[], &[]).unwrap()
}

fn registry(places: usize) -> Registry {
    let mut registry = Registry::new();
    let pairs = (0..places).flat_map(pair);
    let local = ("local".to_owned(), LOCAL.to_owned());
    for (name, text) in pairs.chain([local]) {
        let net = compile::net(&Source::new("remote.net", text)).unwrap();
        registry.handler(&name, &COMMANDS, move |cx| {
            NetTask::with_settings(cx, net.clone(), Library::new(()), None, Settings::default())
        });
    }
    registry.function::<Ask, _, _>("ask", |_, Ask { data }| async move { Ok(data) });
    const NONE: [CommandInfo; 0] = [];
    registry.handler("driver", &NONE, move |_| Ok(Driver { places }));
    registry
}

struct Driver {
    places: usize,
}

impl EventHandler for Driver {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (cx, places) = (cx.clone(), self.places);
            cx.clone().spawn(async move {
                let lines = measure(&cx, places).await;
                cx.finish(AppResult {
                    ok: true,
                    text: lines.join("\n"),
                    json: "{}".to_owned(),
                });
            });
        }
        Ok(())
    }
}

/// A line for each place.
async fn measure(cx: &Context, places: usize) -> Vec<String> {
    let mut lines = Vec::new();
    let local = cx.task("local").await.unwrap();
    for (place, (name, ..)) in PLACES.iter().enumerate().take(places) {
        let here = cx.task(&format!("here{place}")).await.unwrap();
        let ask = cx.task(&format!("ask{place}")).await.unwrap();
        let mut rounds = Vec::new();
        for _ in 0..ROUNDS {
            let call = calls(cx, &ask).await;
            let (own, other) = (commands(cx, &local).await, commands(cx, &here).await);
            let token = (other - own) / 2.0;
            rounds.push((token / call, token, call));
        }
        rounds.sort_by(|one, other| one.0.total_cmp(&other.0));
        let (ratio, token, call) = rounds[ROUNDS / 2];
        lines.push(format!(
            "{name:<20} token {token:>7.2} us, call {call:>7.2} us, ratio {ratio:.2} ({:.2} to {:.2})",
            rounds[0].0,
            rounds[ROUNDS - 1].0
        ));
    }
    lines
}

/// The median of calls, us, each timed with a few others after it, since the clock takes a part of one.
const GROUP: u64 = 16;

async fn calls(cx: &Context, to: &TaskRef) -> f64 {
    let mut times = Vec::new();
    let clock = Clock::real();
    while clock.now().since_start() < LIMIT {
        let began = clock.now();
        for data in 0..GROUP {
            cx.call(to, Ask { data }).await.unwrap();
        }
        times.push(since(&clock, began));
    }
    median(times)
}

async fn commands(cx: &Context, to: &TaskRef) -> f64 {
    let mut times = Vec::new();
    let clock = Clock::real();
    while clock.now().since_start() < LIMIT {
        let began = clock.now();
        for _ in 0..GROUP {
            let put = PutTape {
                symbol: "go".to_owned(),
                arguments: Vec::new(),
            };
            cx.call(to, put).await.unwrap();
        }
        times.push(since(&clock, began));
    }
    median(times)
}

fn since(clock: &Clock, began: Instant) -> f64 {
    (clock.now() - began).as_secs_f64() * 1e6 / GROUP as f64
}

fn median(mut times: Vec<f64>) -> f64 {
    // The first ones find no route yet.
    times.drain(..times.len() / 10);
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn pin(cpu: Option<usize>) {
    if let Some(cpu) = cpu {
        let mut set = rustix::thread::CpuSet::new();
        set.set(cpu);
        rustix::thread::sched_setaffinity(None, &set).unwrap();
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    if let [
        "remote-chassis",
        spin,
        pins,
        places,
        _,
        name,
        _,
        address,
        _,
        origin,
    ] = words[..]
    {
        let mut pins = pins.split(',').map(|pin| pin.parse().ok());
        pin(pins.nth(usize::from(name == "b")).flatten());
        let boot = address.parse().unwrap();
        let places = places.parse().unwrap();
        let (app, registry) = (app(spin, places), registry(places));
        run_chassis(app, registry, name, &boot, origin.parse().unwrap()).unwrap();
        return;
    }
    // Without `--bench` this is a test that the benchmark is compiled in.
    if !words.contains(&"--bench") {
        return;
    }
    let pins = match () {
        () if words.contains(&"--pin") => "0,0",
        () if words.contains(&"--pin2") => "0,1",
        () => "",
    };
    let places = if words.contains(&"--local") {
        1
    } else {
        PLACES.len()
    };
    for spin in ["spin_us = 0", "spin_us = 50"] {
        let launcher = Launcher {
            program: std::env::current_exe().unwrap(),
            arguments: ["remote-chassis", spin, pins, &places.to_string()]
                .map(OsString::from)
                .to_vec(),
        };
        let said: Arc<Mutex<Vec<String>>> = Arc::default();
        let hears = said.clone();
        let observer: Observer =
            Arc::new(move |event| hears.lock().unwrap().push(format!("{event:?}")));
        let outcome = boot(app(spin, places), registry(places), &launcher, &observer).unwrap();
        match outcome.end {
            End::Finished(result) => println!("{spin}, the other net on\n{}", result.text),
            other => panic!("{other:?}: {:#?}", said.lock().unwrap()),
        }
    }
}
