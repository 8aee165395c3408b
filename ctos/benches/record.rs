//! What recording costs: calls and one-way messages between two tasks, recorded and not, in turns.
//!
//! Two apps are booted, one of which is recorded to a file; rounds of both are interleaved, so that
//! what else the machine does hits both. Prints medians and the ratio of the rates, and what the record
//! lacks: a rate that is kept by dropping events is none.

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
    path::Path,
    sync::Arc,
    thread::JoinHandle,
};

use ctos::{
    boot::{Launcher, Observer, boot, run_chassis},
    config::{App, load_texts},
    message::{Command, Message},
    record::scan,
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::Clock,
};

/// Calls, or messages, of one round.
const BATCH: u32 = 2000;
/// Rounds of each, and after `--quick`.
const ROUNDS: usize = 200;
const QUICK: usize = 40;
/// The first argument of a process that is a chassis and not the benchmark.
const CHASSIS: &str = "bench-chassis";

type Data = [u64; 8];

ctos::command! {
    /// Answers with one number.
    struct Ask { data: Data } => u64, 1, "ask"
}
ctos::command! {
    /// Is taken, and that is all.
    struct Tell { data: Data } => (), 2, "tell"
}

struct Far;

impl EventHandler for Far {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            Ask::CODE => {
                let (Ask { data }, reply) = message.open::<Ask>()?;
                reply.ok(data[0])
            }
            Tell::CODE => {
                let (Tell { .. }, reply) = message.open::<Tell>()?;
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
        for _ in 0..BATCH {
            let data = Data::default();
            if order == [0] {
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

fn app(file: &str, port: u16) -> App {
    let record = if file == "none" {
        String::new()
    } else {
        format!("[record]\nfile = {file:?}\nbuffer_mb = 256\nmax_mb = 100_000\n")
    };
    let text = format!(
        "{record}[app]\nuntil = \"near\"\n[chassis.a]\n[task.near]\nhandler = \"near\"\non = \"a\"\n\
         args.port = {port}\n[task.far]\nhandler = \"far\"\non = \"a\"\n"
    );
    load_texts(&[("bench.toml", &text)], &[], &[]).unwrap()
}

/// A booted app.
struct Booted {
    socket: TcpStream,
    boot: JoinHandle<()>,
}

impl Booted {
    fn new(file: &str) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let launcher = Launcher {
            program: std::env::current_exe().unwrap(),
            arguments: [CHASSIS, file, &port.to_string()]
                .map(OsString::from)
                .to_vec(),
        };
        let app = app(file, port);
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
        clock.now().since(began).as_nanos() as f64 / f64::from(BATCH)
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
    if let [first, file, port, _, name, _, address, _, origin] = arguments.as_slice()
        && first == CHASSIS
    {
        let app = app(file, port.parse().unwrap());
        let (address, origin): (ctos::boot::Address, u64) =
            (address.parse().unwrap(), origin.parse().unwrap());
        run_chassis(app, registry(), name, &address, origin).unwrap();
        return;
    }
    let quick = arguments.iter().any(|argument| argument == "--quick");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.mcap");
    let clock = Clock::real();
    let mut plain = Booted::new("none");
    let mut recorded = Booted::new(file.to_str().unwrap());
    println!(
        "{:<10}{:>12}{:>14}{:>12}",
        "ns each", "plain", "recorded", "rate kept"
    );
    for (order, name) in [(0, "call"), (1, "one-way")] {
        let (mut without, mut with) = (Vec::new(), Vec::new());
        for _ in 0..if quick { QUICK } else { ROUNDS } {
            without.push(plain.round(&clock, order));
            with.push(recorded.round(&clock, order));
        }
        let (without, with) = (median(&mut without), median(&mut with));
        println!(
            "{name:<10}{without:>12.0}{with:>14.0}{:>11.0}%",
            100.0 * without / with
        );
    }
    plain.end();
    recorded.end();
    let run = scan(Path::new(&file.with_file_name("run.a.mcap")), |_| ()).unwrap();
    println!(
        "the record holds {} lines and lacks {}",
        run.lines(),
        run.lost
    );
}
