//! How late a function with a period of 4.5 ms runs. A processor of ours, with and without real-time priority
//! and spinning, stands beside a bare loop around `clock_nanosleep` and `tokio::time::interval`. All run on an
//! idle machine, and with every CPU busy.
//!
//! ```text
//! cargo bench -p ctos --bench wakeup             # 5 s a cell
//! cargo bench -p ctos --bench wakeup -- --quick  # 1 s a cell
//! ```

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a benchmark may end when the machine refuses something, and says what it measured"
)]

use std::{
    ffi::OsString,
    num::NonZeroU64,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use ctos::{
    boot::{End, Launcher, boot, run_chassis},
    config::{App, load_texts},
    message::Message,
    registry::Registry,
    sync::{CyclicHandle, Histogram, Tick},
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::{Clock, Instant},
};
use rustix::{
    thread::{ClockId, clock_nanosleep_absolute, set_current_timer_slack},
    time::Timespec,
};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// The servo period of the testbed.
const PERIOD: Duration = Duration::from_micros(4500);

/// The first argument of a process that is a chassis and not the benchmark.
const CHASSIS: &str = "bench-chassis";

/// Lateness of one cell, ns.
#[derive(Debug, Clone, Copy)]
struct Lateness {
    p50: f64,
    p99: f64,
    max: f64,
}

impl Lateness {
    fn of(histogram: &Histogram) -> Self {
        let ns = |duration: Duration| duration.as_nanos() as f64;
        Self {
            p50: ns(histogram.quantile(0.5)),
            p99: ns(histogram.quantile(0.99)),
            max: ns(histogram.max()),
        }
    }
}

/// A processor of ours in a process of its own.
struct Servo {
    length: Duration,
    cyclic: Option<CyclicHandle>,
}

impl EventHandler for Servo {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let cyclic = cx.cyclic(PERIOD, |_: &Tick| ());
            let statistics = cyclic.statistics().clone();
            self.cyclic = Some(cyclic);
            let (cx2, length) = (cx.clone(), self.length);
            cx.spawn(async move {
                cx2.sleep(length).await;
                let Lateness { p50, p99, max } = Lateness::of(&statistics.lateness);
                let refused = cx2
                    .chassis()
                    .realtime()
                    .iter()
                    .any(|grant| grant.refusals().count() > 0);
                cx2.finish(AppResult {
                    ok: true,
                    text: format!("{p50} {p99} {max} {refused}"),
                    json: "{}".to_owned(),
                });
            });
        }
        Ok(())
    }
}

fn app(processor: &str) -> App {
    let text = format!(
        "[app]\nuntil = \"servo\"\n[chassis.cage]\nprocessors.servo = {{ period_s = 0.0045, {processor} }}\n\
         [task.servo]\nhandler = \"servo\"\non = \"cage/servo\"\n"
    );
    load_texts(&[("app.toml", &text)], &[], &[]).unwrap_or_else(|findings| panic!("{findings}"))
}

fn registry(length: Duration) -> Registry {
    let mut registry = Registry::new();
    registry.handler("servo", &[], move |_| {
        Ok(Servo {
            length,
            cyclic: None,
        })
    });
    registry
}

fn ours(processor: &str, length: Duration) -> Lateness {
    let seconds = length.as_secs().to_string();
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: [CHASSIS, processor, &seconds].map(OsString::from).to_vec(),
    };
    let outcome = boot(
        app(processor),
        registry(length),
        &launcher,
        &(Arc::new(|_: &_| ()) as _),
    )
    .unwrap();
    let End::Finished(result) = outcome.end else {
        panic!("{outcome:?}");
    };
    let words: Vec<&str> = result.text.split(' ').collect();
    if words[3] == "true" {
        println!("  (not everything was granted to the next line)");
    }
    Lateness {
        p50: words[0].parse().unwrap(),
        p99: words[1].parse().unwrap(),
        max: words[2].parse().unwrap(),
    }
}

/// The same with real-time priority and exact timers, in a thread of its own: as early as the kernel wakes anybody.
fn realtime_nanosleep(length: Duration) -> Lateness {
    let thread = std::thread::spawn(move || {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let priority = ThreadPriority::Crossplatform(80_u8.try_into().unwrap());
        let granted = set_thread_priority_and_policy(thread_native_id(), priority, fifo).is_ok();
        let exact = set_current_timer_slack(NonZeroU64::new(1)).is_ok();
        if !granted || !exact {
            println!("  (not everything was granted to the next line but one)");
        }
        nanosleep(length)
    });
    thread.join().unwrap()
}

/// What everybody would write first.
fn nanosleep(length: Duration) -> Lateness {
    let histogram = Histogram::default();
    let clock = Clock::real();
    let origin = clock.origin_ns().unwrap();
    let mut due = clock.now();
    while due < Instant::START + length {
        due = due + PERIOD;
        let until = origin + due.as_nanos();
        let until = Timespec {
            tv_sec: i64::try_from(until / 1_000_000_000).unwrap(),
            tv_nsec: i64::try_from(until % 1_000_000_000).unwrap(),
        };
        clock_nanosleep_absolute(ClockId::Monotonic, &until).unwrap();
        histogram.record(clock.now().since(due));
    }
    Lateness::of(&histogram)
}

fn tokio_interval(length: Duration) -> Lateness {
    let histogram = Histogram::default();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .unwrap();
    runtime.block_on(async {
        let mut interval = tokio::time::interval(PERIOD);
        // The first one is at once.
        let end = interval.tick().await + length;
        loop {
            let due = interval.tick().await;
            if due > end {
                break;
            }
            histogram.record(due.elapsed());
        }
    });
    Lateness::of(&histogram)
}

/// Keeps every CPU busy until it is told to stop.
fn busy(stop: &Arc<AtomicBool>) -> Vec<std::thread::JoinHandle<()>> {
    let count = std::thread::available_parallelism().map_or(2, usize::from);
    let spin = |_| {
        let stop = stop.clone();
        std::thread::spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                std::hint::spin_loop();
            }
        })
    };
    (0..count).map(spin).collect()
}

fn table(condition: &str, length: Duration) {
    println!(
        "\n{condition}, {} s a line          p50 us     p99 us     max us   p99 to nanosleep's",
        length.as_secs()
    );
    let bare = nanosleep(length);
    let cells = [
        ("tokio::time::interval", tokio_interval(length)),
        ("clock_nanosleep", bare),
        ("clock_nanosleep, real-time", realtime_nanosleep(length)),
        ("processor", ours("spin_us = 0", length)),
        ("processor, spinning", ours("spin_us = 80", length)),
        (
            "processor, real-time",
            ours("realtime = true, spin_us = 0", length),
        ),
        (
            "processor, real-time, spinning",
            ours("realtime = true", length),
        ),
    ];
    for (name, Lateness { p50, p99, max }) in cells {
        println!(
            "{name:<32} {:>10.2} {:>10.2} {:>10.2} {:>10.4}",
            p50 / 1e3,
            p99 / 1e3,
            max / 1e3,
            p99 / bare.p99
        );
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [first, processor, seconds, _, name, _, address, _, origin] = arguments.as_slice()
        && first == CHASSIS
    {
        let registry = registry(Duration::from_secs(seconds.parse().unwrap()));
        let (address, origin): (ctos::boot::Address, u64) =
            (address.parse().unwrap(), origin.parse().unwrap());
        run_chassis(app(processor), registry, name, &address, origin).unwrap();
        return;
    }
    let quick = arguments.iter().any(|argument| argument == "--quick");
    let length = Duration::from_secs(if quick { 1 } else { 5 });
    table("idle", length);
    let stop = Arc::new(AtomicBool::new(false));
    let spinning = busy(&stop);
    table("all CPUs busy", length);
    stop.store(true, Ordering::Relaxed);
    for thread in spinning {
        thread.join().unwrap();
    }
}
