//! A call there and back, and messages one way: between two tasks of one processor, of two processors
//! and of two processes. Beside each stands the same with bare tokio channels or a bare socket.
//!
//! The tasks run in processes that this program boots. A benchmark asks the calling task over a socket
//! to make [`BATCH`] calls at once, so the request itself does not count.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark may end when the machine refuses something"
)]

use std::{
    ffi::OsString,
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::Arc,
    thread::JoinHandle,
};

use ctos::{
    boot::{Launcher, Observer, boot, run_chassis},
    config::{App, load_texts},
    message::{Command, CommandInfo, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
};
use divan::{Bencher, counter::ItemsCount};
use serde::Deserialize;
use tokio::sync::{mpsc, oneshot};

/// Calls, or messages, that are measured together.
const BATCH: u32 = 1000;

/// The first argument of a process that is a chassis and not the benchmark.
const CHASSIS: &str = "bench-chassis";

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [first, far, port, _, name, _, address, _, origin] if first == CHASSIS => {
            let app = app(far, port.parse().unwrap());
            let address = address.parse().unwrap();
            run_chassis(app, registry(), name, &address, origin.parse().unwrap()).unwrap();
        }
        _ => divan::main(),
    }
}

/// As much as fits beside the header in a cache line: the 64 bytes of a small message.
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
            Tell::CODE => message.open::<Tell>()?.1.ok(()),
            _ => cx.default_processing(message),
        }
    }
}

#[derive(Deserialize)]
struct Args {
    port: u16,
}

struct Near {
    port: u16,
}

impl EventHandler for Near {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let socket = TcpStream::connect(("127.0.0.1", self.port))?;
            cx.spawn(serve(cx.clone(), socket));
        }
        Ok(())
    }
}

/// Makes calls as the benchmark orders them. While it waits for an order its processor stands still,
/// and nothing else is to be done there.
async fn serve(cx: Context, mut socket: TcpStream) {
    let far = cx.task("far").await.unwrap();
    let mut order = [0];
    while socket.read_exact(&mut order).is_ok() {
        let data = Data::default();
        for _ in 0..BATCH {
            if order == [Order::Ask as u8] {
                cx.call(&far, Ask { data }).await.unwrap();
            } else {
                cx.send(&far, Tell { data }).await.unwrap();
            }
        }
        // What was sent has also been handled when this is answered.
        cx.call(&far, Ask { data }).await.unwrap();
        socket.write_all(&[0]).unwrap();
    }
    cx.finish(AppResult {
        ok: true,
        text: String::new(),
        json: String::new(),
    });
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    const NONE: [CommandInfo; 0] = [];
    registry.handler("near", &NONE, |cx: &Context| {
        let Args { port } = cx.args::<Args>()?;
        Ok(Near { port })
    });
    registry.handler("far", &[Ask::INFO, Tell::INFO], |_| Ok(Far));
    registry
}

fn app(far: &str, port: u16) -> App {
    let other = if far.starts_with('b') {
        "[chassis.b]"
    } else {
        ""
    };
    let text = format!(
        "{other}
        [app]
        until = \"near\"
        [chassis.a]
        processors.main = {{}}
        processors.second = {{}}
        [task.near]
        handler = \"near\"
        on = \"a/main\"
        args.port = {port}
        [task.far]
        handler = \"far\"
        on = \"{far}\"
        "
    );
    load_texts(&[("bench.toml", &text)], &[], &[]).unwrap()
}

#[derive(Clone, Copy)]
enum Order {
    Ask,
    Tell,
}

/// A booted app whose local task does as it is told.
struct Booted {
    socket: Option<TcpStream>,
    boot: Option<JoinHandle<()>>,
}

impl Booted {
    fn with_far_on(far: &str) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let launcher = Launcher {
            program: std::env::current_exe().unwrap(),
            arguments: [CHASSIS, far, &port.to_string()]
                .map(OsString::from)
                .to_vec(),
        };
        let app = app(far, port);
        let boot = std::thread::spawn(move || {
            let observer: Observer = Arc::new(|_| ());
            boot(app, registry(), &launcher, &observer).unwrap();
        });
        let (socket, _) = listener.accept().unwrap();
        socket.set_nodelay(true).unwrap();
        Self {
            socket: Some(socket),
            boot: Some(boot),
        }
    }

    fn batch(&mut self, order: Order) {
        let socket = self.socket.as_mut().expect("open until it is dropped");
        socket.write_all(&[order as u8]).unwrap();
        socket.read_exact(&mut [0]).unwrap();
    }
}

impl Drop for Booted {
    fn drop(&mut self) {
        drop(self.socket.take());
        if let Some(boot) = self.boot.take() {
            boot.join().unwrap();
        }
    }
}

fn measure(bencher: Bencher, far: &str, order: Order) {
    let mut booted = Booted::with_far_on(far);
    booted.batch(order);
    bencher
        .counter(ItemsCount::new(BATCH))
        .bench_local(|| booted.batch(order));
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap()
}

type Asked = (Data, oneshot::Sender<u64>);

async fn answer_all(mut asked: mpsc::Receiver<Asked>) {
    while let Some((data, reply)) = asked.recv().await {
        let _ = reply.send(data[0]);
    }
}

async fn ask_batch(ask: &mpsc::Sender<Asked>) {
    for _ in 0..BATCH {
        let (reply, answer) = oneshot::channel();
        ask.send((Data::default(), reply)).await.unwrap();
        answer.await.unwrap();
    }
}

async fn tell_batch(tell: &mpsc::Sender<Data>, taken: &mut mpsc::Receiver<()>) {
    for _ in 0..BATCH {
        tell.send(Data::default()).await.unwrap();
    }
    taken.recv().await.unwrap();
}

async fn take_all(mut told: mpsc::Receiver<Data>, taken: mpsc::Sender<()>) {
    let mut count = 0;
    while told.recv().await.is_some() {
        count += 1;
        if count % BATCH == 0 {
            taken.send(()).await.unwrap();
        }
    }
}

#[divan::bench_group]
mod call_on_one_processor {
    use super::*;

    #[divan::bench]
    fn ctos(bencher: Bencher) {
        measure(bencher, "a/main", Order::Ask);
    }

    #[divan::bench]
    fn tokio_mpsc_and_oneshot(bencher: Bencher) {
        let runtime = runtime();
        let (ask, asked) = mpsc::channel(64);
        runtime.spawn(answer_all(asked));
        bencher.counter(ItemsCount::new(BATCH)).bench_local(|| {
            let ask = ask.clone();
            runtime.block_on(async {
                let asking = tokio::spawn(async move { ask_batch(&ask).await });
                asking.await.unwrap();
            });
        });
    }
}

#[divan::bench_group]
mod call_between_processors {
    use super::*;

    #[divan::bench]
    fn ctos(bencher: Bencher) {
        measure(bencher, "a/second", Order::Ask);
    }

    #[divan::bench]
    fn tokio_mpsc_and_oneshot(bencher: Bencher) {
        let (ask, asked) = mpsc::channel(64);
        let other = std::thread::spawn(move || runtime().block_on(answer_all(asked)));
        let here = runtime();
        bencher
            .counter(ItemsCount::new(BATCH))
            .bench_local(|| here.block_on(ask_batch(&ask)));
        drop(ask);
        other.join().unwrap();
    }
}

#[divan::bench_group]
mod call_between_processes {
    use super::*;

    #[divan::bench]
    fn ctos(bencher: Bencher) {
        measure(bencher, "b", Order::Ask);
    }

    /// The bytes of the same frames over a blocking socket between two threads.
    #[divan::bench]
    fn bare_tcp(bencher: Bencher) {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address: SocketAddr = listener.local_addr().unwrap();
        let other = std::thread::spawn(move || {
            let (mut socket, _) = listener.accept().unwrap();
            socket.set_nodelay(true).unwrap();
            let mut request = [0; 36];
            while socket.read_exact(&mut request).is_ok() {
                socket.write_all(&[0; 29]).unwrap();
            }
        });
        let mut socket = TcpStream::connect(address).unwrap();
        socket.set_nodelay(true).unwrap();
        bencher.counter(ItemsCount::new(BATCH)).bench_local(|| {
            for _ in 0..BATCH {
                socket.write_all(&[0; 36]).unwrap();
                socket.read_exact(&mut [0; 29]).unwrap();
            }
        });
        drop(socket);
        other.join().unwrap();
    }
}

#[divan::bench_group]
mod one_way_on_one_processor {
    use super::*;

    #[divan::bench]
    fn ctos(bencher: Bencher) {
        measure(bencher, "a/main", Order::Tell);
    }

    #[divan::bench]
    fn tokio_mpsc(bencher: Bencher) {
        let runtime = runtime();
        let (tell, told) = mpsc::channel(64);
        let (taken, mut all_taken) = mpsc::channel(1);
        runtime.spawn(take_all(told, taken));
        bencher
            .counter(ItemsCount::new(BATCH))
            .bench_local(|| runtime.block_on(tell_batch(&tell, &mut all_taken)));
    }
}

#[divan::bench_group]
mod one_way_between_processors {
    use super::*;

    #[divan::bench]
    fn ctos(bencher: Bencher) {
        measure(bencher, "a/second", Order::Tell);
    }

    #[divan::bench]
    fn tokio_mpsc(bencher: Bencher) {
        let (tell, told) = mpsc::channel(64);
        let (taken, mut all_taken) = mpsc::channel(1);
        let other = std::thread::spawn(move || runtime().block_on(take_all(told, taken)));
        let here = runtime();
        bencher
            .counter(ItemsCount::new(BATCH))
            .bench_local(|| here.block_on(tell_batch(&tell, &mut all_taken)));
        drop(tell);
        other.join().unwrap();
    }
}

#[divan::bench_group]
mod one_way_between_processes {
    use super::*;

    #[divan::bench]
    fn ctos(bencher: Bencher) {
        measure(bencher, "b", Order::Tell);
    }
}
