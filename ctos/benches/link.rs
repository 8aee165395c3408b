//! A call and an image between two processes, over every kind of link on one host. Their peer is a raw
//! blocking socket that carries the same bytes.
//!
//! What counts is the ratio in one run: figures on a virtual machine are mostly wake-ups, and depend on
//! where the system puts the threads. `--pin` keeps everything on one core, `--pin2` the two processes on
//! two. `--only shm` leaves out the other links of ours (`tcp`, `unix`, `shm`).

#![allow(
    clippy::panic,
    clippy::unwrap_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a benchmark ends where something is wrong, and prints"
)]

use std::{
    ffi::OsString,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    os::unix::net::{UnixListener, UnixStream},
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    Blob,
    boot::{Launcher, Observer, boot, run_chassis},
    config::load_texts,
    message::{Command as _, CommandInfo, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::Clock,
};

ctos::command! {
    /// Answers with as many bytes as it got, or with none.
    pub struct Echo { pub back: bool, pub bytes: Blob } => Blob, 1, "echo"
}

struct Echoes;

impl EventHandler for Echoes {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        if message.command() != Echo::CODE {
            return cx.default_processing(message);
        }
        let (Echo { back, bytes }, reply) = message.open::<Echo>()?;
        reply.ok(if back { bytes } else { Blob::default() })
    }
}

/// One thing that is measured.
struct Case {
    name: &'static str,
    /// Bytes.
    size: usize,
    /// They come back.
    back: bool,
    /// How often at most.
    most: usize,
}

const CASES: [Case; 2] = [
    Case {
        name: "call, 64 B there and back",
        size: 64,
        back: true,
        most: 200_000,
    },
    Case {
        name: "image, 750 kB there",
        size: 750_000,
        back: false,
        most: 5_000,
    },
];

/// The configuration pins the processors: a process that is kept on one core from outside never spins.
const SPINNING: &str = "same_host=shm;spin_us=50;chassis.a.processors.main={cpu=0,spin_us=0};chassis.b.processors.main={cpu=1,spin_us=0}";

/// The same with what each processor spins of its own accord.
const SPINNING_ITSELF: &str = "same_host=shm;spin_us=0;chassis.a.processors.main={cpu=0,spin_us=50};chassis.b.processors.main={cpu=1,spin_us=50}";

const LIMIT: Duration = Duration::from_millis(1_500);

struct Caller;

impl EventHandler for Caller {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let cx = cx.clone();
        cx.clone().spawn(async move {
            let far = cx.task("far").await.unwrap();
            let mut lines = Vec::new();
            for Case {
                size, back, most, ..
            } in CASES
            {
                let mut times = Vec::new();
                let clock = Clock::real();
                // As the raw peers do, the same bytes again and again.
                let all = Blob::from(vec![1; size]);
                while times.len() < most && clock.now().since_start() < LIMIT {
                    let bytes = all.clone();
                    let began = clock.now();
                    cx.call(&far, Echo { back, bytes }).await.unwrap();
                    times.push((clock.now() - began).as_nanos() as u64);
                }
                lines.push(median(times).to_string());
            }
            cx.finish(AppResult {
                ok: true,
                text: lines.join(" "),
                json: "{}".to_owned(),
            });
        });
        Ok(())
    }
}

fn median(mut times: Vec<u64>) -> u64 {
    // The first calls find no route yet.
    times.drain(..times.len() / 10);
    times.sort_unstable();
    times[times.len() / 2]
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    registry.handler("echoes", &[Echo::INFO], |_| Ok(Echoes));
    const NONE: [CommandInfo; 0] = [];
    registry.handler("caller", &NONE, |_| Ok(Caller));
    registry
}

const APP: &str = r#"
    [app]
    until = "caller"
    [chassis.a]
    [chassis.b]
    [task.caller]
    handler = "caller"
    on = "a"
    [task.far]
    handler = "echoes"
    on = "b"
"#;

fn app(sets: &str) -> ctos::config::App {
    let sets: Vec<String> = sets.split(';').map(str::to_owned).collect();
    load_texts(&[("link.toml", APP)], &sets, &[]).unwrap()
}

/// Medians of an app's cases, ns.
fn through(sets: &str, pin: Option<[usize; 2]>) -> Vec<u64> {
    let pins = pin.map_or(String::new(), |pins| format!("{},{}", pins[0], pins[1]));
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: ["link-chassis", sets, &pins].map(OsString::from).to_vec(),
    };
    let text: Arc<Mutex<String>> = Arc::default();
    let said: Arc<Mutex<Vec<String>>> = Arc::default();
    let hears = said.clone();
    let observer: Observer =
        Arc::new(move |event| hears.lock().unwrap().push(format!("{event:?}")));
    let outcome = boot(app(sets), registry(), &launcher, &observer).unwrap();
    match outcome.end {
        ctos::boot::End::Finished(result) => *text.lock().unwrap() = result.text,
        other => panic!("{other:?}: {:#?}", said.lock().unwrap()),
    }
    let text = text.lock().unwrap();
    text.split(' ')
        .map(|number| number.parse().unwrap())
        .collect()
}

fn pin(cpu: Option<usize>) {
    if let Some(cpu) = cpu {
        let mut set = rustix::thread::CpuSet::new();
        set.set(cpu);
        rustix::thread::sched_setaffinity(None, &set).unwrap();
    }
}

fn nth_cpu(pins: &str, chassis: &str) -> Option<usize> {
    let mut pins = pins.split(',').filter_map(|pin| pin.parse().ok());
    if chassis == "a" {
        pins.next()
    } else {
        pins.nth(1)
    }
}

/// A raw socket: the length of what comes back, the length of what follows, and that.
fn serve_raw(mut stream: impl Read + Write) {
    let mut head = [0; 8];
    while stream.read_exact(&mut head).is_ok() {
        let number = |at: usize| u32::from_le_bytes(head[at..at + 4].try_into().unwrap()) as usize;
        let mut bytes = vec![0; number(4)];
        stream.read_exact(&mut bytes).unwrap();
        bytes.resize(number(0).max(1), 0);
        stream.write_all(&bytes).unwrap();
    }
}

fn call_raw(mut stream: impl Read + Write) -> Vec<u64> {
    let mut medians = Vec::new();
    for Case {
        size, back, most, ..
    } in CASES
    {
        let answer = if back { size } else { 1 };
        let mut message = vec![1; 8 + size];
        message[..4].copy_from_slice(&(answer as u32).to_le_bytes());
        message[4..8].copy_from_slice(&(size as u32).to_le_bytes());
        let mut into = vec![0; answer];
        let mut times = Vec::new();
        let clock = Clock::real();
        while times.len() < most && clock.now().since_start() < LIMIT {
            let began = clock.now();
            stream.write_all(&message).unwrap();
            stream.read_exact(&mut into).unwrap();
            times.push((clock.now() - began).as_nanos() as u64);
        }
        medians.push(median(times));
    }
    medians
}

fn raw_child(kind: &str, place: &str, cpu: Option<usize>) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args([
            "link-raw",
            kind,
            place,
            &cpu.map_or(String::new(), |cpu| cpu.to_string()),
        ])
        .stdin(Stdio::null())
        .spawn()
        .unwrap()
}

fn raw(kind: &str, pins: Option<[usize; 2]>) -> Vec<u64> {
    let pins_of = |index: usize| pins.map(|pins| pins[index]);
    let medians = |call: &(dyn Fn() -> Vec<u64> + Sync)| {
        // A thread of its own, so that the pin does not outlive it.
        let pinned = || {
            pin(pins_of(0));
            call()
        };
        std::thread::scope(|scope| scope.spawn(pinned).join().unwrap())
    };
    if kind == "tcp" {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut child = raw_child(
            kind,
            &listener.local_addr().unwrap().to_string(),
            pins_of(1),
        );
        let (stream, _) = listener.accept().unwrap();
        stream.set_nodelay(true).unwrap();
        let found = medians(&|| call_raw(&stream));
        drop(stream);
        child.wait().unwrap();
        return found;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("raw");
    let listener = UnixListener::bind(&path).unwrap();
    let mut child = raw_child(kind, path.to_str().unwrap(), pins_of(1));
    let (stream, _) = listener.accept().unwrap();
    let found = medians(&|| call_raw(&stream));
    drop(stream);
    child.wait().unwrap();
    found
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["link-chassis", sets, pins, _, name, _, address, _, origin] => {
            pin(nth_cpu(pins, name));
            let boot = address.parse().unwrap();
            run_chassis(app(sets), registry(), name, &boot, origin.parse().unwrap()).unwrap();
            return;
        }
        ["link-raw", kind, place, cpu] => {
            pin(cpu.parse().ok());
            if kind == "tcp" {
                let stream = TcpStream::connect(place).unwrap();
                stream.set_nodelay(true).unwrap();
                return serve_raw(stream);
            }
            return serve_raw(UnixStream::connect(place).unwrap());
        }
        _ => {}
    }
    // Without `--bench` this is a test that the benchmark is compiled in.
    if !words.contains(&"--bench") {
        return;
    }
    let pins = if words.contains(&"--pin") {
        Some([0, 0])
    } else if words.contains(&"--pin2") {
        Some([0, 1])
    } else {
        None
    };
    let peers = [
        ("raw TCP", raw("tcp", pins)),
        ("raw Unix socket", raw("unix", pins)),
    ];
    let ours = [
        ("TCP", 0, "same_host=tcp"),
        ("Unix socket", 1, "same_host=unix"),
        ("shared memory", 1, "same_host=shm"),
        ("shared memory, 50 us spin", 1, SPINNING),
        ("shared memory, its own spin", 1, SPINNING_ITSELF),
        ("shared memory, no spin", 1, "same_host=shm;spin_us=0"),
    ];
    let only = words.iter().skip_while(|word| **word != "--only").nth(1);
    let ours: Vec<_> = ours
        .into_iter()
        .filter(|(_, _, sets)| only.is_none_or(|only| sets.contains(only)))
        .map(|(name, peer, sets)| {
            let spins = [SPINNING, SPINNING_ITSELF].contains(&sets);
            let pins = pins.filter(|pins| !spins || pins[0] == pins[1]);
            (name, peer, through(sets, pins))
        })
        .collect();
    for (index, case) in CASES.iter().enumerate() {
        println!("{}, median us", case.name);
        for (name, medians) in &peers {
            println!("  {name:<28} {:>9.2}", medians[index] as f64 / 1e3);
        }
        for (name, peer, medians) in &ours {
            let (us, raw) = (
                medians[index] as f64 / 1e3,
                peers[*peer].1[index] as f64 / 1e3,
            );
            println!(
                "  {name:<28} {us:>9.2}  {:>5.2} of the {}",
                us / raw,
                peers[*peer].0
            );
        }
    }
}
