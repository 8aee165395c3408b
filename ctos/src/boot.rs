//! Booting an app: for real, with a process for each chassis, or in virtual time in this one.

mod child;
mod parent;

use std::{ffi::OsString, num::NonZeroU64, panic::AssertUnwindSafe, path::PathBuf, sync::Arc};

use tokio::sync::oneshot;

use crate::{
    agent::{self, Agent},
    bootstrap::{self, Bootstrap, EndSlot},
    chassis::Chassis,
    config::{App, ProcessorConfig, TimeMode},
    message::{CommandInfo, Tid},
    names::{self, TidServer},
    processor::{Processor, panic_text},
    registry::Registry,
    runner::{TaskSpec, record, start_task},
    simulation, system,
    task::{Context, EventHandler},
    time::{Clock, Instant},
};

pub use crate::bootstrap::{BootEvent, End, Observer};
pub use child::{ChildError, run_chassis};

/// The environment variable that carries the secret of a run to the chassis started for it.
pub const TOKEN_VARIABLE: &str = "CTOS_RUN_TOKEN";

/// How to start the process of a chassis: this program with these arguments, after which come
/// `--chassis NAME --boot ADDRESS --origin NANOSECONDS`.
#[derive(Debug, Clone)]
pub struct Launcher {
    /// The program, usually this one.
    pub program: PathBuf,
    /// What to call it with: a subcommand, the configuration's file and its `--set`s.
    pub arguments: Vec<OsString>,
}

/// How an app ended, and what became of its processes.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Why it ended.
    pub end: End,
    /// Chassis that ended otherwise than they should have: name and how.
    pub casualties: Vec<(String, String)>,
    /// How long it ran, in its own time.
    pub took: std::time::Duration,
}

/// An app that could not be brought up at all.
#[derive(Debug, thiserror::Error)]
pub enum BootError {
    /// A socket or a process could not be had.
    #[error("{what}: {error}")]
    Io {
        /// What was attempted.
        what: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// A mishap names a chassis that the app has not, or the one that boots where that cannot be.
    #[error("there is no chassis `{chassis}` to which {what} could happen")]
    NoChassis {
        /// The name.
        chassis: String,
        /// What should have happened to it.
        what: &'static str,
    },
    /// A chassis ended, or said no, before it was connected.
    #[error("chassis `{chassis}` did not start: {reason}")]
    Chassis {
        /// Its name.
        chassis: String,
        /// What it said last.
        reason: String,
    },
    /// A chassis was not connected in time.
    #[error("chassis {} did not connect within {limit_s} s; give them more time with `app.phase_timeout_s`", .chassis.join(", "))]
    Late {
        /// Their names.
        chassis: Vec<String>,
        /// The limit, s.
        limit_s: f64,
    },
}

/// What was attempted when the system said no.
pub(crate) fn io(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> BootError {
    let what = what.into();
    move |error| BootError::Io { what, error }
}

/// The clock that an app of this mode runs on, at its start.
#[must_use]
pub fn clock(mode: TimeMode) -> Clock {
    match mode {
        TimeMode::Real => Clock::real(),
        TimeMode::Virtual => Clock::virtual_clock(),
    }
}

/// Boots `app`, waits for its end and takes it down. In virtual time `launcher` is not used.
///
/// # Errors
/// [`BootError`] when the processes cannot be started or connected; nothing is left running.
pub fn boot(
    app: App,
    registry: Registry,
    launcher: &Launcher,
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let clock = clock(app.time);
    boot_on(&clock, app, registry, launcher, observer)
}

/// [`boot`] on a [`clock`] that the caller can read too, for the time in its log. The clock decides
/// between real and virtual time.
///
/// # Errors
/// As [`boot`].
pub fn boot_on(
    clock: &Clock,
    app: App,
    registry: Registry,
    launcher: &Launcher,
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let observer = contained(observer);
    let (app, registry) = (Arc::new(app), Arc::new(registry));
    if clock.origin_ns().is_some() {
        parent::boot(clock, &app, &registry, launcher, &observer)
    } else {
        simulation::run(clock, app, registry, &[], &observer)
    }
}

/// What goes wrong in a simulated app, and when: for tests of what the others make of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Mishap {
    /// The process of a chassis ends at once, as by `kill -9`.
    Kill {
        /// Its name.
        chassis: String,
        /// When.
        at: Instant,
    },
    /// The link between two chassis breaks for good; what is under way is lost. Each then holds the
    /// other for gone. `boot` is the name of the chassis that boots.
    Cut {
        /// One end.
        one: String,
        /// The other end.
        other: String,
        /// When.
        at: Instant,
    },
    /// The link between two chassis stands still; what is sent meanwhile arrives afterwards.
    Stall {
        /// One end.
        one: String,
        /// The other end.
        other: String,
        /// From when.
        at: Instant,
        /// Until when.
        until: Instant,
    },
}

/// Runs `app` to its end in one thread on the virtual clock, whatever its `time.mode` is, and lets
/// `mishaps` happen to it.
///
/// # Errors
/// [`BootError::NoChassis`] when a mishap names a chassis that the app has not.
pub fn simulate(
    app: App,
    registry: Registry,
    mishaps: &[Mishap],
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let (app, registry) = (Arc::new(app), Arc::new(registry));
    let clock = Clock::virtual_clock();
    simulation::run(&clock, app, registry, mishaps, &contained(observer))
}

/// Starts the tasks of the runtime itself on processor 0 of `chassis`. Their queues exist when this
/// returns, so no message to them is lost however soon it comes.
pub(crate) fn start_system_tasks(chassis: &Arc<Chassis>, observer: &Observer, end: &EndSlot) {
    let agent = system::agent_tid(chassis.index());
    start(chassis, "agent", agent, &agent::COMMANDS, |_| {
        Agent::default()
    });
    if chassis.index() == 0 {
        let tidsvr = system::TID_SERVER;
        start(chassis, "tidsvr", tidsvr, &names::COMMANDS, |_| {
            TidServer::default()
        });
        let (observer, end) = (observer.clone(), end.clone());
        let bootstrap = system::BOOTSTRAP;
        start(
            chassis,
            "bootstrap",
            bootstrap,
            &bootstrap::COMMANDS,
            move |_| Bootstrap::new(observer.clone(), end.clone()),
        );
    }
}

fn start<H: EventHandler>(
    chassis: &Arc<Chassis>,
    name: &'static str,
    tid: Tid,
    commands: &[CommandInfo],
    build: impl Fn(&Context) -> H + Send + Sync + 'static,
) {
    let Some((_, processor)) = chassis.processors.first() else {
        return;
    };
    let spec = TaskSpec {
        record: record(name, tid, None),
        config: None,
        commands: commands.to_vec(),
        build: Arc::new(move |cx| Ok(Box::new(build(cx)))),
    };
    chassis.add_task(spec.record.clone());
    let home = chassis.clone();
    processor.inject(move |processor| {
        if let Err(error) = start_task(&home, processor, spec) {
            tracing::error!(task = name, error = %error, "a task of the runtime did not start");
        }
    });
}

/// A processor's thread, from outside.
pub(crate) struct ProcessorThread {
    /// Ends, one way or the other, when the thread has dropped everything it ran.
    pub(crate) ended: oneshot::Receiver<()>,
}

/// Starts a thread for each processor of `chassis`.
///
/// # Errors
/// When the system refuses a thread; those that were started are stopped.
pub(crate) fn start_processors(chassis: &Arc<Chassis>) -> std::io::Result<Vec<ProcessorThread>> {
    let configured = chassis
        .app
        .chassis
        .iter()
        .find(|config| config.name == chassis.name());
    let mut threads = Vec::new();
    for (name, handle) in &chassis.processors {
        let handle = handle.clone();
        let clock = chassis.clock.clone();
        let config = configured
            .and_then(|config| config.processors.iter().find(|one| one.name == *name))
            .cloned();
        let (ending, ended) = oneshot::channel::<()>();
        let started = std::thread::Builder::new()
            .name(format!("{}/{name}", chassis.name()))
            .spawn(move || {
                let _ending = ending;
                // Timers of this thread end at their deadline and not up to 50 us after it.
                let _ = rustix::thread::set_current_timer_slack(NonZeroU64::new(1));
                if let Some(config) = config {
                    prepare_thread(&config);
                }
                Processor::new(handle, clock).run();
            });
        if let Err(error) = started {
            chassis.stop_processors();
            return Err(error);
        }
        threads.push(ProcessorThread { ended });
    }
    Ok(threads)
}

/// An observer whose panics (a closed terminal, say) do not take the boot with them: the app must
/// still be stopped in order.
fn contained(observer: &Observer) -> Observer {
    let observer = observer.clone();
    Arc::new(move |event| {
        let shown = AssertUnwindSafe(|| observer(event));
        if let Err(panic) = std::panic::catch_unwind(shown) {
            let text = panic_text(panic.as_ref());
            tracing::error!(panic = %text, "whoever watches the boot panicked");
        }
    })
}

/// Pins the calling thread and makes it real-time, where the configuration asks for it and the
/// system permits it; says so clearly where it does not.
fn prepare_thread(config: &ProcessorConfig) {
    if let Some(cpu) = config
        .cpu
        .filter(|cpu| *cpu < rustix::thread::CpuSet::MAX_CPU)
    {
        let mut set = rustix::thread::CpuSet::new();
        set.set(cpu);
        if let Err(error) = rustix::thread::sched_setaffinity(None, &set) {
            tracing::warn!(processor = %config.name, cpu, error = %error, "not pinned");
        }
    }
    if config.realtime {
        let priority = config.priority.unwrap_or(80);
        let wanted = thread_priority::ThreadPriorityValue::try_from(priority)
            .map(thread_priority::ThreadPriority::Crossplatform);
        let policy = thread_priority::ThreadSchedulePolicy::Realtime(
            thread_priority::RealtimeThreadSchedulePolicy::Fifo,
        );
        let result = wanted
            .map_err(|error| error.to_string())
            .and_then(|wanted| {
                thread_priority::set_thread_priority_and_policy(
                    thread_priority::thread_native_id(),
                    wanted,
                    policy,
                )
                .map_err(|error| format!("{error:?}"))
            });
        match result {
            Ok(()) => tracing::debug!(processor = %config.name, priority, "real-time"),
            Err(error) => {
                tracing::warn!(processor = %config.name, priority, error = %error, "not real-time; periods may be missed under load");
            }
        }
    }
}
