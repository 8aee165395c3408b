//! A frame of 750 kB that is made in shared memory, sent from one process to another and answered. With calls of
//! ours and with iceoryx2 (publish-subscribe both ways); asleep until it comes, and polling all the time.
//!
//! `cargo bench -p peers --features iceoryx2 --bench frames -- --pin | --pin2`: both processes on one core, or
//! on two. The bytes of a frame are not counted: neither side writes or reads them all.

#![allow(
    clippy::panic,
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::cast_precision_loss,
    missing_docs,
    reason = "a benchmark ends where something is wrong, and prints"
)]

use std::{
    ffi::OsString,
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
    sync::Arc,
    time::Duration,
};

use ctos::{
    Blob,
    boot::{End, Launcher, Observer, boot, run_chassis},
    config::{App, load_texts},
    message::{CommandInfo, Message},
    registry::Registry,
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::Clock,
};
use iceoryx2::{
    port::{listener::Listener, publisher::Publisher},
    prelude::*,
    service::port_factory::{event, publish_subscribe},
};

const FRAME: usize = 750_000;
const LIMIT: Duration = Duration::from_millis(800);
const ROUNDS: usize = 5;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The median of the later of many times, us.
fn timed(mut once: impl FnMut()) -> f64 {
    let clock = Clock::real();
    let mut times = Vec::new();
    while clock.now().since_start() < LIMIT {
        let began = clock.now();
        once();
        times.push((clock.now() - began).as_secs_f64() * 1e6);
    }
    times.drain(..times.len() / 10);
    median(times)
}

fn pin(cpu: &str) {
    if let Ok(cpu) = cpu.parse() {
        let mut set = rustix::thread::CpuSet::new();
        set.set(cpu);
        rustix::thread::sched_setaffinity(None, &set).unwrap();
    }
}

// -- ours ------------------------------------------------------------------------------------------

ctos::command! {
    /// A frame; answered when it is there.
    pub struct Frame { pub bytes: Blob } => u64, 1, "frame"
}

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
            let clock = Clock::real();
            let mut times = Vec::new();
            while clock.now().since_start() < LIMIT {
                let began = clock.now();
                let bytes = Blob::from(vec![0; FRAME]);
                cx.call(&far, Frame { bytes }).await.unwrap();
                times.push((clock.now() - began).as_secs_f64() * 1e6);
            }
            times.drain(..times.len() / 10);
            cx.finish(AppResult {
                ok: true,
                text: median(times).to_string(),
                json: "{}".to_owned(),
            });
        });
        Ok(())
    }
}

/// A processor that polls all the time does so on a core of its own. The configuration says which, for a process
/// that is kept on one core from outside never does it.
fn app(spin: &str) -> App {
    let processor = |cpu: u8| match spin {
        "0" => String::new(),
        // The links spin, and not the processor before them.
        _ => format!("processors.main = {{ cpu = {cpu}, spin_us = 0 }}\n"),
    };
    let (one, two) = (processor(0), processor(1));
    let text = format!(
        "[app]\nuntil = \"caller\"\nspin_us = {spin}\n[chassis.a]\n{one}[chassis.b]\n{two}[task.caller]\nhandler = \"caller\"\non = \"a\"\n[task.far]\nhandler = \"far\"\non = \"b\"\n"
    );
    load_texts(&[("frames.toml", text.as_str())], &[], &[]).unwrap()
}

fn registry() -> Registry {
    const NONE: [CommandInfo; 0] = [];
    let mut registry = Registry::new();
    registry.function::<Frame, _, _>("far", |_, Frame { bytes }| async move {
        Ok(bytes.first().copied().map_or(0, u64::from))
    });
    registry.handler("caller", &NONE, |_| Ok(Caller));
    registry
}

fn ours(spin: &str, pins: [&str; 2]) -> f64 {
    let [one, two] = if spin == "0" { pins } else { ["", ""] };
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: ["frames-chassis", spin, one, two]
            .map(OsString::from)
            .to_vec(),
    };
    let observer: Observer = Arc::new(|_| {});
    let outcome = boot(app(spin), registry(), &launcher, &observer).unwrap();
    match outcome.end {
        End::Finished(result) => result.text.parse().unwrap(),
        other => panic!("{other:?}"),
    }
}

// -- iceoryx2 --------------------------------------------------------------------------------------

fn node() -> Node<ipc::Service> {
    set_log_level(LogLevel::Error);
    NodeBuilder::new().create::<ipc::Service>().unwrap()
}

fn name(of: &str, run: &str) -> ServiceName {
    format!("frames/{of}/{run}").as_str().try_into().unwrap()
}

fn bell(node: &Node<ipc::Service>, of: &str, run: &str) -> event::PortFactory<ipc::Service> {
    let service = node.service_builder(&name(of, run)).event();
    service.open_or_create().unwrap()
}

fn frames(
    node: &Node<ipc::Service>,
    run: &str,
) -> publish_subscribe::PortFactory<ipc::Service, [u8], ()> {
    let service = node.service_builder(&name("there", run));
    let service = service.publish_subscribe::<[u8]>();
    service.open_or_create().unwrap()
}

fn answers(
    node: &Node<ipc::Service>,
    run: &str,
) -> publish_subscribe::PortFactory<ipc::Service, u64, ()> {
    let service = node.service_builder(&name("back", run));
    let service = service.publish_subscribe::<u64>();
    service.open_or_create().unwrap()
}

/// Waits until there is something, with a bell or without.
fn wait_for<T>(bell: Option<&Listener<ipc::Service>>, mut there: impl FnMut() -> Option<T>) -> T {
    loop {
        if let Some(there) = there() {
            return there;
        }
        match bell {
            Some(bell) => drop(bell.blocking_wait(|_| {}).unwrap()),
            None => std::hint::spin_loop(),
        }
    }
}

/// The process that gets the frames.
fn receive(run: &str, asleep: bool) {
    let node = node();
    let there = bell(&node, "rings", run);
    let there = there.listener_builder().create().unwrap();
    let back = bell(&node, "answers", run);
    let back = back.notifier_builder().create().unwrap();
    let frames = frames(&node, run).subscriber_builder().create().unwrap();
    let answers = answers(&node, run).publisher_builder().create().unwrap();
    println!("ready");
    loop {
        let frame = wait_for(asleep.then_some(&there), || frames.receive().unwrap());
        answers.send_copy(u64::from(frame[0])).unwrap();
        if asleep {
            back.notify().unwrap();
        }
    }
}

struct Receiver(Child);

impl Drop for Receiver {
    fn drop(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// A frame as the shared memory has it.
#[allow(
    unsafe_code,
    reason = "the bytes lie in memory that the system has mapped, and filled with zeros: any value is a byte"
)]
fn send(frames: &Publisher<ipc::Service, [u8], ()>) {
    let frame = frames.loan_slice_uninit(FRAME).unwrap();
    let frame = unsafe { frame.assume_init() };
    frame.send().unwrap();
}

fn theirs(asleep: bool, pins: [&str; 2]) -> f64 {
    let run = format!("{}-{asleep}", std::process::id());
    let node = node();
    let there = bell(&node, "rings", &run);
    let there = there.notifier_builder().create().unwrap();
    let back = bell(&node, "answers", &run);
    let back = back.listener_builder().create().unwrap();
    let frames = frames(&node, &run);
    let frames = frames.publisher_builder().initial_max_slice_len(FRAME);
    let frames = frames.create().unwrap();
    let answers = answers(&node, &run).subscriber_builder().create().unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["frames-receiver", &run, &asleep.to_string(), pins[1]])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let stdout = child.stdout.take().unwrap();
    let _receiver = Receiver(child);
    BufReader::new(stdout).read_line(&mut said).unwrap();
    assert_eq!(said, "ready\n");
    let everywhere = rustix::thread::sched_getaffinity(None).unwrap();
    pin(pins[0]);
    let median = timed(|| {
        send(&frames);
        if asleep {
            there.notify().unwrap();
        }
        wait_for(asleep.then_some(&back), || answers.receive().unwrap());
    });
    rustix::thread::sched_setaffinity(None, &everywhere).unwrap();
    median
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [
            "frames-chassis",
            spin,
            one,
            two,
            _,
            name,
            _,
            address,
            _,
            origin,
        ] => {
            pin(if name == "a" { one } else { two });
            let boot = address.parse().unwrap();
            run_chassis(app(spin), registry(), name, &boot, origin.parse().unwrap()).unwrap();
            return;
        }
        ["frames-receiver", run, asleep, cpu] => {
            pin(cpu);
            return receive(run, asleep == "true");
        }
        _ => {}
    }
    // Without `--bench` this is a test that the benchmark is compiled in.
    if !words.contains(&"--bench") {
        return;
    }
    let pins = match () {
        () if words.contains(&"--pin") => ["0", "0"],
        () if words.contains(&"--pin2") => ["0", "1"],
        () => ["", ""],
    };
    for (asleep, spin) in [(true, "0"), (false, "50")] {
        if !asleep && pins == ["0", "0"] {
            // Who looks all the time on the only core keeps the other from it.
            continue;
        }
        let rounds = (0..ROUNDS).map(|_| (ours(spin, pins), theirs(asleep, pins)));
        let rounds: Vec<(f64, f64)> = rounds.collect();
        let of = |which: &dyn Fn(&(f64, f64)) -> f64| median(rounds.iter().map(which).collect());
        println!(
            "750 kB in place, {}: ours {:.2} us, iceoryx2 {:.2} us, ratio {:.2}",
            if asleep { "asleep" } else { "looking for it" },
            of(&|round| round.0),
            of(&|round| round.1),
            of(&|round| round.0 / round.1),
        );
    }
}
