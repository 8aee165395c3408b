//! Table 1.2 of the technical report, all its rows, in one run on this machine. Beside them stand a raw
//! tokio socket that carries the same bytes, and the cost of 10,000 flavors in one manager.
//!
//! What counts are the ratios of one run. The raw peer and the daemon take turns, so that a machine that is
//! busy with other work disturbs both. `--pin` keeps everything on one core, `--pin2` the two processes on two.

#![allow(
    clippy::panic,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a benchmark ends where something is wrong, and prints"
)]

use ctos::boot::{End, Launcher, Observer, boot, run_chassis};
use ctos::config::{App, load_texts};
use ctos::registry::Registry;
use ctos::system::AppResult;
use ctos::task::{Context as TaskContext, Handled, Phase};
use ctos::time::Clock;
use sorma::daemon::{self, Tasks};
use sorma::ipc::{self, Host};
use sorma::{Class, Context, Dictionary, Outcome, Request, ServiceObject, Sorm, Transport};
use std::ffi::OsString;
use std::hint::black_box;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};

/// Does nothing.
struct Nop;

impl ServiceObject for Nop {
    fn exec(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        black_box(io);
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, _io: &mut Transport) -> Outcome {
        Ok(())
    }

    fn dump(&self) -> String {
        String::new()
    }
}

fn classes(sorm: &Sorm) {
    sorm.register(Class::new("nop", "1", |_, _| Ok(Box::new(Nop))));
}

#[inline(never)]
fn function(io: &mut Transport) -> Outcome {
    black_box(io);
    Ok(())
}

/// Opaque bytes there and back.
const SIZES: [usize; 2] = [64, 64 * 1024];

/// Rounds of raw and protected in turn, and how long each measures each size.
const ROUNDS: usize = 5;
const LIMIT: Duration = Duration::from_millis(400);

fn median(mut times: Vec<u64>) -> f64 {
    // The first calls find no route yet.
    times.drain(..times.len() / 10);
    times.sort_unstable();
    times.get(times.len() / 2).map_or(f64::NAN, |ns| *ns as f64)
}

/// The least time of a call over batches, ns.
fn fastest(batch: u32, mut call: impl FnMut()) -> f64 {
    let clock = Clock::real();
    let begun = clock.now();
    let mut least = f64::INFINITY;
    while clock.now().since(begun) < LIMIT {
        let start = clock.now();
        for _ in 0..batch {
            call();
        }
        let took = clock.now().since(start).as_nanos() as f64 / f64::from(batch);
        least = least.min(took);
    }
    least
}

// -- in one process ---------------------------------------------------------------------------------

fn in_process() {
    let sorm = Sorm::new(Dictionary::new());
    classes(&sorm);
    let handle = sorm.get("nop").unwrap();
    let mut io = Transport::default();
    let plain: &mut dyn FnMut(&mut Transport) -> Outcome = &mut |io| function(io);
    let plain = black_box(plain);
    let f = fastest(10_000, || drop(function(black_box(&mut io))));
    let v = fastest(10_000, || drop(plain(black_box(&mut io))));
    let shared = fastest(10_000, || handle.exec(&sorm, black_box(&mut io)));
    let mut claim = handle.claim().unwrap();
    let held = fastest(10_000, || claim.exec(&sorm, black_box(&mut io)));
    drop(claim);
    let s = fastest(1000, || drop(sorm.dispatch(black_box("nop@self EXEC"))));
    let line = "nop@self EXEC FMSG 10 0.1 -2.5 3.25e-3 4 5.125 -6.0625 7e7 0.3333333333333333 9 3.141592653589793";
    let s10 = fastest(1000, || drop(sorm.dispatch(black_box(line))));
    println!("F       function call                       {f:>10.1} ns");
    println!("V       plain virtual call                  {v:>10.1} ns");
    println!(
        "TO      by reference, held (Claim)          {held:>10.1} ns  {:>6.2} of V",
        held / v
    );
    println!(
        "TO      by reference, any thread (Handle)   {shared:>10.1} ns  {:>6.2} of V",
        shared / v
    );
    println!(
        "S       text, nop@self EXEC                 {:>10.3} us",
        s / 1e3
    );
    println!(
        "S+10f   text with 10 floats both ways       {:>10.3} us  {:>6.3} us on top of S",
        s10 / 1e3,
        (s10 - s) / 1e3
    );
    let folder = tempfile::tempdir().unwrap();
    let host = Host {
        root: Some(folder.path().join("shm")),
        ..Host::new("bench", Clock::real())
    };
    let mut dictionary = Dictionary::new();
    let recipe = ["-floats", "64", "-slots", "8"];
    dictionary.add("shmem_w.bench", recipe.map(str::to_owned).to_vec());
    let sorm = Sorm::new(dictionary);
    ipc::register(&sorm, &host);
    match sorm.get("shmem_w.bench") {
        Ok(writer) => {
            let mut io = Transport::default();
            let m = fastest(1000, || {
                io.floats.resize(64, 0.5);
                writer.exec(&sorm, black_box(&mut io));
            });
            assert!(io.is_ok(), "{:?}", io.reports);
            println!("M       shmem_w EXEC, 64 floats             {m:>10.1} ns");
        }
        Err(report) => println!("M       not measured: {report}"),
    }
}

// -- 10,000 flavors ---------------------------------------------------------------------------------

/// Bytes that this process has in memory.
fn resident() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|line| line.starts_with("VmRSS:"));
    let kilobytes: f64 = line
        .unwrap()
        .split_whitespace()
        .nth(1)
        .unwrap()
        .parse()
        .unwrap();
    kilobytes * 1024.0
}

fn flavors() {
    const COUNT: usize = 10_000;
    let mut dictionary = Dictionary::new();
    for index in 0..COUNT {
        dictionary.add(format!("nop.f{index}"), Vec::new());
    }
    let sorm = Sorm::new(dictionary);
    classes(&sorm);
    let one = {
        sorm.get("nop.f0").unwrap();
        fastest(1000, || drop(sorm.get(black_box("nop.f0")).unwrap()))
    };
    let before = resident();
    let clock = Clock::real();
    let begun = clock.now();
    for index in 0..COUNT {
        sorm.get(&format!("nop.f{index}")).unwrap();
    }
    let built = clock.now().since(begun).as_nanos() as f64 / COUNT as f64;
    let memory = (resident() - before) / COUNT as f64;
    let names: Vec<String> = (0..1000)
        .map(|index| format!("nop.f{}", index * 7919 % COUNT))
        .collect();
    let mut at = 0;
    let found = fastest(1000, || {
        at = (at + 1) % names.len();
        drop(sorm.get(black_box(&names[at])).unwrap());
    });
    println!("{COUNT} flavors in one manager");
    println!("        finding one, alone                  {one:>10.1} ns");
    println!(
        "        finding one of {COUNT}                {found:>10.1} ns  {:>6.2} of alone",
        found / one
    );
    println!(
        "        building one                        {:>10.3} us",
        built / 1e3
    );
    println!("        memory of one                       {memory:>10.0} B");
}

// -- between processes ------------------------------------------------------------------------------

struct Caller {
    sorm: Sorm,
}

#[ctos::handler]
impl Caller {
    #[phase]
    async fn phase(&mut self, cx: &TaskContext, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let (here, sorm) = (cx.clone(), self.sorm.clone());
        cx.spawn(async move {
            let comm = Tasks::of(&here);
            let mut medians = Vec::new();
            for size in SIZES {
                let request: Request = "nop@far EXEC".parse().unwrap();
                let mut bytes = sorma::Opaque::from(vec![1; size]);
                let mut times = Vec::new();
                let clock = Clock::real();
                while clock.now().since_start() < LIMIT {
                    let mut request = request.clone();
                    request.body.opaque = bytes;
                    let began = clock.now();
                    let reply = sorm.ask(&comm, request).await;
                    times.push(clock.now().since(began).as_nanos() as u64);
                    assert!(reply.body.is_ok(), "{:?}", reply.body.reports);
                    bytes = reply.body.opaque;
                }
                medians.push(median(times).to_string());
            }
            here.finish(AppResult {
                ok: true,
                text: medians.join(" "),
                json: String::new(),
            });
        });
        Ok(())
    }
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    daemon::register(&mut registry, Dictionary::new(), |_, sorm| classes(sorm));
    registry.handler("caller", &Caller::COMMANDS, |cx| {
        let sorm = daemon::manager(cx, Dictionary::new())?;
        Ok(Caller { sorm })
    });
    registry
}

const APP: &str = r#"
    app.until = "caller"
    [chassis.a]
    [chassis.b]
    [task.caller]
    handler = "caller"
    on = "a"
    [task.far]
    handler = "sorma.daemon"
    on = "b"
"#;

fn app(kind: &str) -> App {
    let sets = [format!("app.same_host=\"{kind}\"")];
    load_texts(&[("table.toml", APP)], &sets, &[]).unwrap()
}

fn pin(cpu: Option<usize>) {
    if let Some(cpu) = cpu {
        let mut set = rustix::thread::CpuSet::new();
        set.set(cpu);
        rustix::thread::sched_setaffinity(None, &set).unwrap();
    }
}

fn cpu(pins: &str, second: bool) -> Option<usize> {
    let (first, other) = pins.split_once(',')?;
    let word = if second { other } else { first };
    word.parse().ok()
}

fn protected(kind: &str, pins: &str) -> Vec<f64> {
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: ["table-chassis", kind, pins].map(OsString::from).to_vec(),
    };
    let observer: Observer = Arc::new(|_| ());
    let outcome = boot(app(kind), registry(), &launcher, &observer).unwrap();
    match outcome.end {
        End::Finished(result) => result
            .text
            .split(' ')
            .map(|ns| ns.parse().unwrap())
            .collect(),
        other => panic!("{other:?}"),
    }
}

fn runtime() -> tokio::runtime::Runtime {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_io().build().unwrap()
}

/// Sends back what it gets, in pieces of each size that its caller says.
fn serve_raw(address: &str) {
    runtime().block_on(async {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.set_nodelay(true).unwrap();
        while let Ok(size) = stream.read_u32().await {
            let mut bytes = vec![0; size as usize];
            stream.read_exact(&mut bytes).await.unwrap();
            stream.write_all(&bytes).await.unwrap();
        }
    });
}

fn raw(pins: &str) -> Vec<f64> {
    let work = || {
        pin(cpu(pins, false));
        runtime().block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap().to_string();
            let mut child: Child = Command::new(std::env::current_exe().unwrap())
                .args(["table-raw", &address, pins])
                .stdin(Stdio::null())
                .spawn()
                .unwrap();
            let (mut stream, _) = listener.accept().await.unwrap();
            stream.set_nodelay(true).unwrap();
            let mut medians = Vec::new();
            for size in SIZES {
                let mut message = (size as u32).to_be_bytes().to_vec();
                message.resize(4 + size, 1);
                let mut into = vec![0; size];
                let mut times = Vec::new();
                let clock = Clock::real();
                while clock.now().since_start() < LIMIT {
                    let began = clock.now();
                    stream.write_all(&message).await.unwrap();
                    stream.read_exact(&mut into).await.unwrap();
                    times.push(clock.now().since(began).as_nanos() as u64);
                }
                medians.push(median(times));
            }
            drop(stream);
            child.wait().unwrap();
            medians
        })
    };
    // A thread of its own, so that the pin does not outlive it.
    std::thread::scope(|scope| scope.spawn(work).join().unwrap())
}

fn between_processes(pins: &str) {
    const KINDS: [&str; 3] = ["tcp", "unix", "shm"];
    let mut ours = vec![vec![Vec::new(); SIZES.len()]; KINDS.len()];
    let mut theirs = vec![Vec::new(); SIZES.len()];
    for _ in 0..ROUNDS {
        for (at, ns) in raw(pins).into_iter().enumerate() {
            theirs[at].push(ns);
        }
        for (kind, ours) in KINDS.iter().zip(&mut ours) {
            for (at, ns) in protected(kind, pins).into_iter().enumerate() {
                ours[at].push(ns);
            }
        }
    }
    let middle = |times: &[f64]| {
        let mut times = times.to_vec();
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    };
    println!("P_AA    protected, one host, two processes: median of {ROUNDS} rounds' medians");
    for (at, size) in SIZES.iter().enumerate() {
        let peer = middle(&theirs[at]);
        println!(
            "        {size:>6} B  raw tokio TCP            {:>10.2} us",
            peer / 1e3
        );
        for (kind, ours) in KINDS.iter().zip(&ours) {
            let time = middle(&ours[at]);
            println!(
                "        {size:>6} B  execSvc over {kind:<12}{:>10.2} us  {:>6.2} of raw tokio TCP",
                time / 1e3,
                time / peer
            );
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["table-chassis", kind, pins, _, name, _, address, _, origin] => {
            pin(cpu(pins, name != "a"));
            let boot = address.parse().unwrap();
            run_chassis(app(kind), registry(), name, &boot, origin.parse().unwrap()).unwrap();
            return;
        }
        ["table-raw", address, pins] => {
            pin(cpu(pins, true));
            return serve_raw(address);
        }
        _ => {}
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
    flavors();
    in_process();
    between_processes(pins);
}
