//! What recording costs: calls and one-way messages between two tasks, recorded and not, in turns.
//!
//! Two apps are booted, one of which is recorded to a file. The bench interleaves rounds of both, so that other
//! load of the machine hits both. The two tasks share a processor, or have one each, or are two processes. The
//! handler of the message works for 0, 1, 10 or 100 us, since the share of the recording depends on that work.
//! Prints medians and the median ratio of the rates, and what the record lacks: a rate that is kept by dropping
//! events is none.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a benchmark prints, and may end when the machine refuses something"
)]

use std::{
    ffi::OsString,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    sync::Arc,
    thread::JoinHandle,
    time::Duration,
};

use ctos::{
    boot::{Launcher, Observer, boot, run_chassis},
    config::{App, load_texts},
    message::{Command, Message},
    record::{Filter, scan_only},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::Clock,
};

/// Calls, or messages, of one round, by the work of the handler in us; an order names its place.
const WORK: [(u64, u32); 4] = [(0, 2000), (1, 2000), (10, 500), (100, 100)];
/// Rounds of each, and after `--quick`.
const ROUNDS: usize = 200;
const QUICK: usize = 40;
/// Where the other task is, and how the configuration says it.
const PLACES: [(&str, &str); 3] = [
    ("the same processor", "on = 'a/main'"),
    ("another processor", "on = 'a/other'"),
    ("another process", "on = 'b'"),
];
/// The first argument of a process that is a chassis and not the benchmark.
const CHASSIS: &str = "bench-chassis";

/// The work in us, and seven numbers more.
type Data = [u64; 8];

ctos::command! {
    /// Answers with one number.
    struct Ask { data: Data } => u64, 1, "ask"
}
ctos::command! {
    /// Is taken, and that is all.
    struct Tell { data: Data } => (), 2, "tell"
}

/// Works for so long, and asks the runtime for nothing meanwhile: that would be in the record.
fn work(micros: u64) {
    let clock = Clock::real();
    let end = clock.now() + Duration::from_micros(micros);
    while micros > 0 && clock.now() < end {
        std::hint::spin_loop();
    }
}

struct Far;

impl EventHandler for Far {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Ask::CODE => {
                let (Ask { data }, reply) = message.open::<Ask>()?;
                work(data[0]);
                reply.ok(data[0])
            }
            Tell::CODE => {
                let (Tell { data }, reply) = message.open::<Tell>()?;
                work(data[0]);
                reply.ok(())
            }
            _ => cx.default_processing(message),
        }
    }
}

#[derive(serde::Deserialize)]
struct Args {
    port: u16,
}

/// Does what the benchmark orders over a socket: a byte, answered by a byte.
struct Near(u16);

impl EventHandler for Near {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let socket = TcpStream::connect(("127.0.0.1", self.0))?;
            socket.set_nodelay(true)?;
            cx.spawn(obey(cx.clone(), socket));
        }
        Ok(())
    }
}

async fn obey(cx: Context, mut socket: TcpStream) {
    let far = cx.task("far").await.unwrap();
    let mut order = [0];
    while socket.read_exact(&mut order).is_ok() {
        let (one_way, place) = (order[0] >= 4, usize::from(order[0] % 4));
        let (micros, batch) = WORK[place];
        for _ in 0..batch {
            let data = [micros, 0, 0, 0, 0, 0, 0, 0];
            if !one_way {
                cx.call(&far, Ask { data }).await.unwrap();
            } else {
                cx.send(&far, Tell { data }).await.unwrap();
            }
        }
        socket.write_all(&order).unwrap();
    }
    cx.finish(AppResult {
        ok: true,
        text: String::new(),
        json: "{}".to_owned(),
    });
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    registry.handler("near", &[], |cx| Ok(Near(cx.args::<Args>()?.port)));
    registry.handler("far", &[Ask::INFO, Tell::INFO], |_| Ok(Far));
    registry
}

fn app(file: &str, port: u16, place: &str) -> App {
    let record = if file == "none" {
        String::new()
    } else {
        format!("[record]\nfile = {file:?}\nbuffer_mb = 256\nmax_mb = 100_000\n")
    };
    let text = format!(
        "{record}[app]\nuntil = \"near\"\n[chassis.a]\nprocessors = {{ main = {{}}, other = {{}} }}\n[chassis.b]\n\
         [task.near]\nhandler = \"near\"\non = \"a/main\"\nargs.port = {port}\n\
         [task.far]\nhandler = \"far\"\n{place}\n"
    );
    load_texts(&[("bench.toml", &text)], &[], &[]).unwrap()
}

/// A booted app.
struct Booted {
    socket: TcpStream,
    boot: JoinHandle<()>,
}

impl Booted {
    fn new(file: &str, on: &str) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let launcher = Launcher {
            program: std::env::current_exe().unwrap(),
            arguments: [CHASSIS, file, &port.to_string(), on]
                .map(OsString::from)
                .to_vec(),
        };
        let app = app(file, port, on);
        let boot = std::thread::spawn(move || {
            let observer: Observer = Arc::new(|_| ());
            boot(app, registry(), &launcher, &observer).unwrap();
        });
        let (socket, _) = listener.accept().unwrap();
        socket.set_nodelay(true).unwrap();
        Self { socket, boot }
    }

    /// ns for each call or message of a round.
    fn round(&mut self, clock: &Clock, order: u8) -> f64 {
        let began = clock.now();
        self.socket.write_all(&[order]).unwrap();
        self.socket.read_exact(&mut [0]).unwrap();
        clock.now().since(began).as_nanos() as f64 / f64::from(WORK[usize::from(order % 4)].1)
    }

    fn end(self) {
        drop(self.socket);
        self.boot.join().unwrap();
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [first, file, port, on, _, name, _, address, _, origin] = arguments.as_slice()
        && first == CHASSIS
    {
        let app = app(file, port.parse().unwrap(), on);
        let (address, origin): (ctos::boot::Address, u64) =
            (address.parse().unwrap(), origin.parse().unwrap());
        run_chassis(app, registry(), name, &address, origin).unwrap();
        return;
    }
    let quick = arguments.iter().any(|argument| argument == "--quick");
    for (place, on) in PLACES {
        println!("the other task is on {place}");
        compare(on, if quick { QUICK } else { ROUNDS });
    }
}

/// Both apps in turns, with the other task at that place.
fn compare(on: &str, rounds: usize) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.mcap");
    let clock = Clock::real();
    let mut plain = Booted::new("none", on);
    let mut recorded = Booted::new(file.to_str().unwrap(), on);
    println!(
        "{:<10}{:>10}{:>12}{:>14}{:>12}",
        "ns each", "work, us", "plain", "recorded", "rate kept"
    );
    for order in 0..8_u8 {
        let name = if order < 4 { "call" } else { "one-way" };
        let micros = WORK[usize::from(order % 4)].0;
        let (mut without, mut with, mut kept) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..rounds {
            let plain = plain.round(&clock, order);
            let recorded = recorded.round(&clock, order);
            without.push(plain);
            with.push(recorded);
            kept.push(100.0 * plain / recorded);
        }
        let (without, with) = (median(&mut without), median(&mut with));
        let kept = median(&mut kept);
        println!("{name:<10}{micros:>10}{without:>12.0}{with:>14.0}{kept:>11.0}%");
    }
    plain.end();
    recorded.end();
    for chassis in ["a", "b"] {
        let file = file.with_file_name(format!("run.{chassis}.mcap"));
        let run = scan_only(&file, &Filter::default(), |_| ()).unwrap();
        println!(
            "the record of {chassis} holds {} lines and lacks {}",
            run.lines(),
            run.lost
        );
    }
}
