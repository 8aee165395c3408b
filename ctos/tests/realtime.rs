//! Synchronous functions and real time in processes of their own, as a user's app has them.
//!
//! Its own main, because the chassis it boots are processes of the same program. Their allocator and their log
//! end the process when they are used on an armed thread. That shows that the loop of a processor uses neither.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may end where it finds something wrong"
)]
#![allow(
    unsafe_code,
    reason = "an allocator can be written in no other way; this one hands every call on unchanged"
)]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    ffi::OsString,
    io::Write,
    panic::AssertUnwindSafe,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    time::Duration,
};

use ctos::{
    boot::{End, Launcher, Outcome, boot, run_chassis},
    config::{App, load_texts},
    message::Message,
    realtime::Grant,
    registry::Registry,
    sync::{CyclicHandle, Signal, Synchronous, Tick},
    system::AppResult,
    task::{Context, EventHandler, Handled, Phase},
    time::Clock,
};
use libtest_mimic::{Arguments, Failed, Trial};
use tracing::{Event, Metadata, Subscriber, span};

/// The first argument of a process that is a chassis and not the tests.
const CHASSIS: &str = "realtime-chassis";

/// A trial that takes longer hangs.
const WATCHDOG: Duration = Duration::from_secs(60);

thread_local! {
    static ARMED: Cell<bool> = const { Cell::new(false) };
}

fn forbid(what: &[u8]) {
    // A thread that is ending has no such cell any more, and is not armed.
    if ARMED
        .try_with(|armed| armed.replace(false))
        .unwrap_or(false)
    {
        let _ = std::io::stderr().write_all(what);
        std::process::abort();
    }
}

struct Aborting;

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Aborting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        forbid(b"allocates\n");
        // SAFETY: the caller keeps the promises of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        forbid(b"frees\n");
        // SAFETY: the caller keeps the promises of `dealloc`.
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        forbid(b"reallocates\n");
        // SAFETY: the caller keeps the promises of `realloc`.
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Aborting = Aborting;

/// A log that nobody may write to while armed.
struct Silence;

impl Subscriber for Silence {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }
    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        forbid(b"logs\n");
        span::Id::from_u64(1)
    }
    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}
    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}
    fn event(&self, _: &Event<'_>) {
        forbid(b"logs\n");
    }
    fn enter(&self, _: &span::Id) {}
    fn exit(&self, _: &span::Id) {}
}

/// What a function does in one of its ticks, besides being called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sin {
    None,
    Allocates,
    Logs,
}

/// A task with five synchronous functions, the last of which ends the app after some hundred ticks.
struct Servo {
    sin: Sin,
    functions: Vec<CyclicHandle>,
}

impl Servo {
    fn schedule(&mut self, cx: &Context) -> Handled {
        let (go, done) = (Arc::new(AtomicBool::new(false)), Signal::new());
        let (begun, ended) = (go.clone(), done.clone());
        let sin = self.sin;
        let law = move |tick: &Tick| match sin {
            Sin::Allocates if tick.count.is_multiple_of(50) => {
                drop(std::hint::black_box(vec![1_u8; 64]))
            }
            Sin::Logs if tick.count.is_multiple_of(50) => {
                tracing::debug!(count = tick.count, "a tick")
            }
            _ => {}
        };
        // Late on purpose, now and then: what skips ticks must not allocate either.
        let clock = Clock::real();
        let slow = move |tick: &Tick| {
            // By the clock: how long the processor takes for a pause is its own business.
            if tick.count.is_multiple_of(16) {
                let end = clock.now() + Duration::from_millis(3);
                while clock.now() < end {
                    std::hint::spin_loop();
                }
            }
        };
        let mut armed = 0_u64;
        let last = move |_: &Tick| {
            if go.load(Ordering::Acquire) {
                armed += 1;
                ARMED.set(armed < 400);
            }
            if armed == 400 {
                done.raise();
            }
        };
        self.functions = vec![
            cx.schedule(Synchronous::new("end", last).reads_previous(["torque"]))?,
            cx.schedule(
                Synchronous::new("law", law)
                    .reads(["position"])
                    .writes(["torque"]),
            )?,
            cx.schedule(Synchronous::new("sense", |_: &Tick| ()).writes(["position"]))?,
            cx.schedule(Synchronous::new("slow", slow).every(4).phase(1))?,
            cx.cyclic(Duration::from_millis(2), |_: &Tick| ()),
        ];
        let cx2 = cx.clone();
        cx.spawn(async move {
            // Nothing comes to this processor any more, once this task has entered its last phase.
            cx2.sleep(Duration::from_millis(300)).await;
            begun.store(true, Ordering::Release);
            ended.wait().await;
            let names: Vec<String> = cx2
                .chassis()
                .cyclics()
                .into_iter()
                .map(|(name, _)| name)
                .collect();
            let missed: u64 = cx2
                .chassis()
                .cyclics()
                .iter()
                .map(|(_, of)| of.missed())
                .sum();
            cx2.finish(AppResult {
                ok: missed > 0,
                text: names.join(" "),
                json: "{}".to_owned(),
            });
        });
        Ok(())
    }
}

impl EventHandler for Servo {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        match phase {
            Phase::Run => self.schedule(cx),
            Phase::Create | Phase::Connect => Ok(()),
        }
    }
}

/// A task that says what its chassis was granted.
struct Grants;

impl EventHandler for Grants {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let grants = cx.chassis().realtime();
            let grant = grants.first().ok_or("no grant is known")?;
            let policy = format!("{:?}", thread_priority::thread_schedule_policy());
            cx.finish(AppResult {
                ok: (grant.scheduler == Grant::Granted) == policy.contains("Fifo"),
                text: format!(
                    "{} {:?} {:?} {}",
                    grant.processor,
                    grant.priority,
                    grant.timer_slack,
                    grant.pinned.refusal().unwrap_or("pinned")
                ),
                json: "{}".to_owned(),
            });
        }
        Ok(())
    }
}

fn registry() -> Registry {
    let mut registry = Registry::new();
    for (name, sin) in [
        ("servo", Sin::None),
        ("allocates", Sin::Allocates),
        ("logs", Sin::Logs),
    ] {
        registry.handler(name, &[], move |_| {
            Ok(Servo {
                sin,
                functions: Vec::new(),
            })
        });
    }
    registry.handler("grants", &[], |_| Ok(Grants));
    registry
}

/// An app of one task on one processor.
fn app(handler: &str, processor: &str) -> App {
    let text = format!(
        "[app]\nuntil = \"task\"\n[chassis.cage]\nprocessors.servo = {{ {processor} }}\n\
         [task.task]\nhandler = \"{handler}\"\non = \"cage/servo\"\n"
    );
    load_texts(&[("app.toml", &text)], &[], &[]).unwrap_or_else(|findings| panic!("{findings}"))
}

fn run(handler: &str, processor: &str) -> Outcome {
    let launcher = Launcher {
        program: std::env::current_exe().unwrap(),
        arguments: [CHASSIS, handler, processor].map(OsString::from).to_vec(),
    };
    boot(
        app(handler, processor),
        registry(),
        &launcher,
        &(Arc::new(|_: &_| ()) as _),
    )
    .unwrap()
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [first, handler, processor, _, name, _, address, _, origin] = arguments.as_slice()
        && first == CHASSIS
    {
        tracing::subscriber::set_global_default(Silence).unwrap();
        let (address, origin): (ctos::boot::Address, u64) =
            (address.parse().unwrap(), origin.parse().unwrap());
        let code = run_chassis(app(handler, processor), registry(), name, &address, origin);
        return ExitCode::from(u8::try_from(code.unwrap_or(4)).unwrap_or(255));
    }
    let trials = CASES
        .iter()
        .map(|(name, case)| Trial::test(*name, move || watched(*case)))
        .collect();
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// Runs a trial on a thread of its own and gives up on it when it hangs.
fn watched(case: fn()) -> Result<(), Failed> {
    let (sender, done) = mpsc::channel();
    std::thread::spawn(move || {
        let _ = sender.send(std::panic::catch_unwind(AssertUnwindSafe(case)));
    });
    match done.recv_timeout(WATCHDOG) {
        Ok(Ok(())) => Ok(()),
        Ok(Err(panic)) => Err(panic
            .downcast_ref::<String>()
            .map_or("it panicked", String::as_str)
            .into()),
        Err(_) => Err(format!("hangs; nothing came for {WATCHDOG:?}").into()),
    }
}

const CASES: [(&str, fn()); 5] = [
    (
        "the_loop_of_a_processor_allocates_nothing_and_logs_nothing",
        the_loop_allocates_nothing,
    ),
    (
        "what_a_function_does_wrong_in_the_loop_is_seen",
        what_is_wrong_is_seen,
    ),
    (
        "a_required_processor_that_is_refused_undoes_the_boot",
        required_and_refused,
    ),
    (
        "without_being_required_a_refusal_is_kept_as_data",
        refused_but_kept,
    ),
    ("what_was_granted_is_what_the_thread_has", granted),
];

/// Enough for ticks to be in time most of the time, wherever this runs.
const TICKS: &str = "period_s = 0.001, spin_us = 50";

fn the_loop_allocates_nothing() {
    let outcome = run("servo", TICKS);
    let End::Finished(result) = &outcome.end else {
        panic!("{outcome:?}");
    };
    assert_eq!(
        result.text,
        "task.cyclic task.end task.law task.sense task.slow"
    );
    assert!(
        result.ok,
        "no tick was ever missed, so skipping was not tried: {outcome:?}"
    );
    assert_eq!(outcome.casualties, []);
}

fn what_is_wrong_is_seen() {
    for handler in ["allocates", "logs"] {
        let outcome = run(handler, TICKS);
        let aborted = [(
            "cage".to_owned(),
            "aborted with signal 6 (SIGABRT)".to_owned(),
        )];
        assert_eq!(outcome.casualties, aborted, "{outcome:?}");
    }
}

fn required_and_refused() {
    let outcome = run("grants", "realtime = \"require\", cpu = 1023");
    let End::PhaseFailed { phase, failures } = &outcome.end else {
        panic!("{outcome:?}");
    };
    assert_eq!(*phase, Phase::Create);
    let (who, why) = &failures[0];
    assert_eq!(who, "processor cage/servo");
    assert!(
        why.starts_with("realtime = \"require\", but it was refused "),
        "{why}"
    );
    assert!(
        why.contains("its CPU: ") && why.contains("instead of 1023"),
        "{why}"
    );
}

fn refused_but_kept() {
    let outcome = run("grants", "cpu = 1023");
    let End::Finished(result) = &outcome.end else {
        panic!("{outcome:?}");
    };
    let begin = "cage/servo None Granted ";
    assert!(result.text.starts_with(begin), "{result:?}");
    assert!(result.text.contains("instead of 1023"), "{result:?}");
}

fn granted() {
    let outcome = run("grants", "realtime = true, priority = 7");
    let End::Finished(result) = &outcome.end else {
        panic!("{outcome:?}");
    };
    assert!(result.ok, "{outcome:?}");
    assert_eq!(result.text, "cage/servo Some(7) Granted pinned");
}
