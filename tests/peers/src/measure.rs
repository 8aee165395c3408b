//! What is measured, and how it is shown.

use std::time::Instant;

use crate::{
    contenders::{self, Floor, Kameo, Kanal, Pair, Ractor, RactorOneWay, Server, Tokio, TokioIdle},
    ctos_side::{Ctos, CtosIdle, CtosOneWay},
};

/// Rounds; odd, so that there is a middle one.
const ROUNDS: usize = 15;

pub fn all() {
    let parts: Vec<String> = std::env::args().skip(1).collect();
    let wanted = |part: &str| parts.is_empty() || parts.iter().any(|one| one == part);
    let cpus = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    println!("{cpus} CPUs, {ROUNDS} rounds; medians, and how many times the first contender's");
    if wanted("local") {
        calls(
            "call between two tasks on one processor, ns",
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
            calls(
                "call between two threads of one core, ns",
                vec![
                    ("ctos", Box::new(Ctos::new(&["cpu = 0", "cpu = 0"]))),
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
        on_thread_pinned_to(0, || {
            let server = Server::Thread(Some(1));
            calls(
                "call between two cores, ns",
                vec![
                    ("ctos", Box::new(Ctos::new(&["cpu = 1", "cpu = 0"]))),
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

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn show(title: &str, unit: &str, results: &[(&str, f64)]) {
    println!("\n{title}");
    let first = results.first().map_or(1.0, |result| result.1);
    for (name, value) in results {
        println!("  {name:24} {value:10.3} {unit:6} x {:8.3}", value / first);
    }
}

fn calls(title: &str, mut contenders: Vec<(&str, Box<dyn Pair>)>, batch: u32) {
    let mut times = vec![Vec::new(); contenders.len()];
    for (_, contender) in &mut contenders {
        contender.calls(batch / 4);
    }
    for _ in 0..ROUNDS {
        for ((_, contender), times) in contenders.iter_mut().zip(&mut times) {
            let begin = Instant::now();
            contender.calls(batch);
            times.push(begin.elapsed().as_nanos() as f64 / f64::from(batch));
        }
    }
    let names = contenders.iter().map(|contender| contender.0);
    let results: Vec<_> = names.zip(times.into_iter().map(median)).collect();
    show(title, "ns", &results);
}

fn one_way(producers: u8) {
    const COUNT: u32 = 200_000;
    let mut ctos = CtosOneWay::new(producers);
    let mut ractor = RactorOneWay::new();
    let many = u32::from(producers);
    let mut contenders: Vec<(&str, Box<dyn FnMut()>)> = vec![
        ("ctos", Box::new(move || ctos.send(COUNT))),
        ("ractor", Box::new(move || ractor.send(many, COUNT))),
        (
            "tokio mpsc",
            Box::new(move || contenders::tokio_one_way(many, COUNT)),
        ),
        (
            "crossbeam",
            Box::new(move || contenders::crossbeam_one_way(many, COUNT)),
        ),
        (
            "kanal",
            Box::new(move || contenders::kanal_one_way(many, COUNT)),
        ),
        (
            "flume",
            Box::new(move || contenders::flume_one_way(many, COUNT)),
        ),
    ];
    let mut rates = vec![Vec::new(); contenders.len()];
    for _ in 0..ROUNDS {
        for ((_, send), rates) in contenders.iter_mut().zip(&mut rates) {
            let begin = Instant::now();
            send();
            rates.push(f64::from(COUNT) / begin.elapsed().as_secs_f64() / 1e6);
        }
    }
    let names = contenders.iter().map(|contender| contender.0);
    let results: Vec<_> = names.zip(rates.into_iter().map(median)).collect();
    let title = format!("messages one way, {producers} to 1, 64 B, bounded (ractor: not)");
    show(&title, "M/s", &results);
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
    // Each in a process of its own would be cleaner; what is freed by one round is used by the next,
    // so memory is taken from the first round only, and the order is such that nothing is there yet.
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
