//! What is measured, and how it is shown.

use std::time::Instant;

use crate::{
    booted::{self, Booted},
    contenders::{self, Floor, Kameo, Kanal, Pair, Ractor, RactorOneWay, Server, Tokio, TokioIdle},
    ctos_side::{Ctos, CtosIdle, CtosOneWay},
};

/// Rounds; odd, so that there is a middle one.
const ROUNDS: usize = 15;

pub fn all() {
    let parts: Vec<String> = std::env::args().skip(1).collect();
    let wanted = |part: &str| parts.is_empty() || parts.iter().any(|one| one == part);
    let cpus = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    println!("{cpus} CPUs; medians of {ROUNDS} rounds");
    if wanted("local") {
        calls(
            "call between two tasks on one processor",
            vec![
                ("ctos", Box::new(Ctos::new(&[""]))),
                ("tokio mpsc + oneshot", Box::new(Tokio::new(Server::Here))),
                ("ractor", Box::new(Ractor::new(Server::Here))),
                ("kameo", Box::new(Kameo::new(Server::Here))),
            ],
            10_000,
        );
    }
    if wanted("core") {
        // The threads of all contenders are started pinned to the core that the callers run on.
        on_thread_pinned_to(0, || {
            let server = Server::Thread(Some(0));
            let processors = ["cpu = 0", "cpu = 0"];
            calls(
                "call between two threads of one core",
                vec![
                    ("ctos, as booted", Box::new(Booted::start(&processors))),
                    ("ctos", Box::new(Ctos::new(&processors))),
                    ("tokio mpsc + oneshot", Box::new(Tokio::new(server))),
                    ("ractor", Box::new(Ractor::new(server))),
                    ("kameo", Box::new(Kameo::new(server))),
                    ("kanal", Box::new(Kanal::new(Some(0)))),
                ],
                5_000,
            );
        });
    }
    if wanted("cores") && cpus > 1 {
        // Made before: a thread that may use one CPU only makes processors that never spin.
        let ctos = Ctos::new(&["cpu = 1", "cpu = 0"]);
        on_thread_pinned_to(0, || {
            let server = Server::Thread(Some(1));
            calls(
                "call between two cores",
                vec![
                    ("ctos", Box::new(ctos)),
                    ("one word, spinning", Box::new(Floor::new(Some(1)))),
                    ("tokio mpsc + oneshot", Box::new(Tokio::new(server))),
                    ("ractor", Box::new(Ractor::new(server))),
                    ("kameo", Box::new(Kameo::new(server))),
                    ("kanal", Box::new(Kanal::new(Some(1)))),
                ],
                1_000,
            );
        });
    }
    if wanted("oneway") {
        for producers in [1, 4] {
            one_way(producers);
        }
    }
    if wanted("idle") {
        idle();
    }
}

fn on_thread_pinned_to(cpu: usize, work: impl FnOnce() + Send) {
    std::thread::scope(|scope| {
        scope.spawn(|| {
            contenders::pin(Some(cpu));
            work();
        });
    });
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// What so much work took: by the clock, and of all CPUs together.
#[derive(Clone, Copy)]
struct Sample {
    wall_ns: f64,
    cpu_ns: f64,
}

fn cpu_ns() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 * 1e9 + time.tv_nsec as f64 + booted::cpu_ns()
}

fn sample(work: &mut dyn FnMut(u32), count: u32) -> Sample {
    let (cpu, begin) = (cpu_ns(), Instant::now());
    work(count);
    let (took, each) = (begin.elapsed(), f64::from(count));
    Sample {
        wall_ns: took.as_nanos() as f64 / each,
        cpu_ns: (cpu_ns() - cpu) / each,
    }
}

type Contender = (&'static str, Box<dyn FnMut(u32)>);

/// Measures all of them in turn, round by round, and shows the medians. The ratio is ours, the first,
/// over theirs.
fn rounds(title: &str, contenders: &mut Vec<Contender>, batch: u32) {
    if std::env::args().any(|argument| argument == "only=ctos") {
        contenders.retain(|(name, _)| *name == "ctos");
    }
    let mut samples = vec![Vec::new(); contenders.len()];
    for (_, work) in &mut *contenders {
        work(batch / 4);
    }
    for _ in 0..ROUNDS {
        for ((_, work), samples) in contenders.iter_mut().zip(&mut samples) {
            samples.push(sample(work, batch));
        }
    }
    println!("\n{title}: ns by the clock, ctos over it; ns of CPU, ctos over it");
    let middle = |samples: &Vec<Sample>| Sample {
        wall_ns: median(samples.iter().map(|sample| sample.wall_ns)),
        cpu_ns: median(samples.iter().map(|sample| sample.cpu_ns)),
    };
    let Some(ours) = samples.first().map(middle) else {
        return;
    };
    for ((name, _), samples) in contenders.iter().zip(&samples) {
        let Sample { wall_ns, cpu_ns } = middle(samples);
        let (wall, cpu) = (ours.wall_ns / wall_ns, ours.cpu_ns / cpu_ns);
        println!("  {name:24} {wall_ns:10.1} {wall:8.3}    {cpu_ns:10.1} {cpu:8.3}");
    }
}

fn calls(title: &str, contenders: Vec<(&'static str, Box<dyn Pair>)>, batch: u32) {
    let mut contenders: Vec<Contender> = contenders
        .into_iter()
        .map(|(name, mut pair)| {
            let work: Box<dyn FnMut(u32)> = Box::new(move |count| pair.calls(count));
            (name, work)
        })
        .collect();
    rounds(title, &mut contenders, batch);
}

fn one_way(producers: u8) {
    let mut ctos = CtosOneWay::new(producers);
    let mut ractor = RactorOneWay::new();
    let many = u32::from(producers);
    let mut contenders: Vec<Contender> = vec![
        ("ctos", Box::new(move |count| ctos.send(count))),
        ("ractor", Box::new(move |count| ractor.send(many, count))),
        (
            "tokio mpsc",
            Box::new(move |count| contenders::tokio_one_way(many, count)),
        ),
        (
            "crossbeam",
            Box::new(move |count| contenders::crossbeam_one_way(many, count)),
        ),
        (
            "kanal",
            Box::new(move |count| contenders::kanal_one_way(many, count)),
        ),
        (
            "flume",
            Box::new(move |count| contenders::flume_one_way(many, count)),
        ),
    ];
    let title = format!("message one way, {producers} to 1, 64 B, bounded (ractor: not)");
    rounds(&title, &mut contenders, 200_000);
}

/// Resident memory of this process, bytes.
fn resident() -> f64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = statm
        .split_whitespace()
        .nth(1)
        .and_then(|pages| pages.parse::<f64>().ok());
    pages.unwrap_or(0.0) * 4096.0
}

fn idle() {
    const COUNT: u32 = 100_000;
    // An argument picks one of the two, so that each can be measured in a process of its own.
    // Neither is freed, so the second reuses no memory of the first.
    let part = std::env::args().nth(2);
    let mut results = Vec::new();
    let mut measure = |name: &'static str, spawn: &mut dyn FnMut(), ask: &mut dyn FnMut()| {
        let before = resident();
        let begin = Instant::now();
        spawn();
        let each = begin.elapsed().as_nanos() as f64 / f64::from(COUNT);
        let bytes = (resident() - before) / f64::from(COUNT);
        let begin = Instant::now();
        ask();
        let first = begin.elapsed().as_nanos() as f64 / contenders::WINDOW as f64;
        results.push((name, each, bytes, first));
    };
    if part.as_deref() != Some("tokio") {
        let mut ctos = CtosIdle::new();
        let cell = std::cell::RefCell::new(&mut ctos);
        measure("ctos", &mut || cell.borrow_mut().spawn(COUNT), &mut || {
            cell.borrow_mut().ask_all();
        });
        std::mem::forget(ctos);
    }
    if part.as_deref() != Some("ctos") {
        let mut tokio = TokioIdle::new();
        let cell = std::cell::RefCell::new(&mut tokio);
        measure(
            "tokio task + mpsc",
            &mut || cell.borrow_mut().spawn(COUNT),
            &mut || {
                cell.borrow_mut().ask_all();
            },
        );
        std::mem::forget(tokio);
    }
    println!("\n{COUNT} idle tasks: ns to start one, bytes resident for one, ns of a first call");
    for (name, each, bytes, first) in results {
        println!("  {name:24} {each:10.0} ns {bytes:10.0} B {first:10.0} ns");
    }
}
