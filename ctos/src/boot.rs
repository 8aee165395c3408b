//! Booting an app: for real, with a process for each chassis, or in virtual time in this one.

mod child;
mod mesh;
mod parent;
pub(crate) mod processes;
pub(crate) mod spawn;

use std::{
    ffi::OsString,
    num::NonZeroUsize,
    panic::AssertUnwindSafe,
    path::PathBuf,
    sync::{Arc, Mutex, mpsc},
};

use tokio::sync::oneshot;

use crate::{
    agent::{self, Agent},
    bootstrap::{self, Bootstrap, Seat},
    chassis::Chassis,
    config::{App, TimeMode},
    contain::panic_text,
    context::Context,
    handler::EventHandler,
    lock::lock,
    message::{CommandInfo, Tid},
    names::{self, TidServer},
    realtime::{self, Grant},
    registry::{Recipe, Registry},
    remote::HostError,
    runner::{TaskSpec, start_task},
    semaphore::{self, server::SemaphoreServer},
    simulation::{self, Faults, Setup},
    system,
    time::Clock,
};

pub use crate::frame::Counts;
pub use crate::link::transport::{Address, AddressError};
pub use crate::simulation::Mishap;
pub use crate::{
    bootstrap::{BootEvent, End, Observer, StopStep},
    report::{BootState, ChassisState},
};
pub use child::{ChildError, run_chassis};

/// The environment variable that carries the secret of a run to the chassis started for it.
pub const TOKEN_VARIABLE: &str = "CTOS_RUN_TOKEN";

/// The environment variable that says how often the chassis has been started; the first time is 1, which
/// is also what its absence means.
pub const INCARNATION_VARIABLE: &str = "CTOS_INCARNATION";

/// The environment variable that tells a chassis that its standard input ends with the agent that started
/// it.
pub(crate) const TETHER_VARIABLE: &str = "CTOS_TETHERED";

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
    /// The keys of `[security]` cannot be used.
    #[error("the keys of [security] cannot be used: {0}")]
    Keys(String),
    /// A chassis ended, or said no, before it was connected.
    #[error("chassis `{chassis}` did not start: {reason}")]
    Chassis {
        /// Its name.
        chassis: String,
        /// What it said last.
        reason: String,
    },
    /// Hosts cannot take their chassis.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Hosts(Vec<HostError>),
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
pub(crate) fn io_error(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> BootError {
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
    boot_with(clock, app, registry, launcher, &[], observer)
}

/// [`boot_on`] for apps that may have chassis on other hosts: `options` are what those are told besides
/// the app (how much to log), as `launcher` tells those of this host.
///
/// # Errors
/// As [`boot`]; also [`BootError::Hosts`].
pub fn boot_with(
    clock: &Clock,
    app: App,
    registry: Registry,
    launcher: &Launcher,
    options: &[String],
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let (app, registry) = (Arc::new(app), Arc::new(registry));
    if clock.origin_ns().is_some() {
        let setup = parent::Setup {
            launcher,
            options,
            observer: &contained(observer),
        };
        parent::boot(clock, &app, &registry, &setup)
    } else {
        let setup = Setup {
            clock: clock.clone(),
            ..Setup::default()
        };
        simulation::run_shared(app, registry, setup, observer).map(|run| run.outcome)
    }
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
    let setup = Setup {
        faults: Faults::of_script("mishaps", mishaps.to_vec()),
        ..Setup::default()
    };
    simulation::run(app, registry, setup, observer).map(|run| run.outcome)
}

/// Starts the tasks of the runtime itself on processor 0 of `chassis`. Their queues exist when this
/// returns, so no message to them is lost however soon it comes. `seat` is for the chassis that boots.
pub(crate) fn start_system_tasks(chassis: &Arc<Chassis>, seat: Option<&Seat>) {
    let agent = system::agent_tid(chassis.index());
    start(chassis, "agent", agent, &agent::COMMANDS, |_| {
        Agent::default()
    });
    if let Some(seat) = seat {
        let tidsvr = system::TID_SERVER;
        start(chassis, "tidsvr", tidsvr, &names::COMMANDS, |_| {
            TidServer::default()
        });
        let (seat, service) = (seat.clone(), system::BOOTSTRAP);
        let semsvr = system::SEMAPHORE_SERVER;
        start(
            chassis,
            "semsvr",
            semsvr,
            &semaphore::server::COMMANDS,
            |_| SemaphoreServer::default(),
        );
        start(
            chassis,
            "bootstrap",
            service,
            &bootstrap::COMMANDS,
            move |_| Bootstrap::new(seat.clone()),
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
    let recipe = Recipe {
        commands: commands.into(),
        build: Box::new(move |cx| Ok(Box::new(build(cx)))),
    };
    let spec = TaskSpec::new(name, tid, None, Arc::new(recipe), processor);
    let record = spec.record.clone();
    let home = chassis.clone();
    processor.inject(move |processor| {
        if let Err(error) = start_task(&home, processor, spec) {
            tracing::error!(task = name, error = %error, "a task of the runtime did not start");
        }
    });
    // After the order to start it, so that no message comes before that.
    chassis.add_task(record);
}

/// A processor's thread, from outside.
pub(crate) struct ProcessorThread {
    /// Ends, one way or the other, when the thread has dropped everything it ran.
    pub(crate) ended: oneshot::Receiver<()>,
}

/// Starts a thread for each processor of `chassis`. When it returns, it is known what the system granted
/// to each ([`Chassis::realtime`]).
///
/// # Errors
/// When the system refuses a thread; those that were started are stopped.
pub(crate) fn start_processors(chassis: &Arc<Chassis>) -> std::io::Result<Vec<ProcessorThread>> {
    let configs =
        || (0..chassis.processors.len()).filter_map(|index| chassis.processor_config(index));
    let memory = if configs().any(|config| config.realtime) {
        realtime::lock_memory()
    } else {
        Grant::NotAsked
    };
    let cpus = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let mut threads = Vec::new();
    let (prepared, grants) = mpsc::channel();
    // Nothing runs before it is known what was granted: the agent asks.
    let gate = Arc::new(Mutex::new(()));
    let closed = lock(&gate);
    for (index, (name, handle)) in chassis.processors.iter().enumerate() {
        if let Some(config) = chassis.processor_config(index) {
            handle.set_spin(ctos_config::placement::spin(&chassis.app, config, cpus));
            handle.set_shares_core(ctos_config::placement::shares(&chassis.app, config, cpus));
        }
        let (home, memory, prepared) = (chassis.clone(), memory.clone(), prepared.clone());
        let gate = gate.clone();
        let (ending, ended) = oneshot::channel::<()>();
        let started = std::thread::Builder::new()
            .name(format!("{}/{name}", chassis.name()))
            .spawn(move || {
                let _ending = ending;
                let config = home.processor_config(index);
                let grant = realtime::prepare_thread(home.name(), config, &memory);
                // Nobody listens when another thread could not be had.
                let _ = prepared.send((index, grant));
                drop(prepared);
                drop(lock(&gate));
                if let Some(processor) = home.processor(index) {
                    if let Some(place) = home.park_of(index) {
                        processor.handle.parker.set(place);
                    }
                    drop(home);
                    processor.run();
                }
            });
        if let Err(error) = started {
            chassis.stop_processors();
            return Err(error);
        }
        threads.push(ProcessorThread { ended });
    }
    drop(prepared);
    let mut grants: Vec<_> = grants.iter().collect();
    grants.sort_by_key(|(index, _)| *index);
    let configured = grants.into_iter().map(|(_, grant)| grant);
    // The first belongs to the runtime, which asks for nothing.
    chassis.set_realtime(configured.skip(1).inspect(|grant| grant.log()).collect());
    drop(closed);
    Ok(threads)
}

/// An observer whose panics (a closed terminal, say) do not take the boot with them: the app must
/// still be stopped in order.
pub(crate) fn contained(observer: &Observer) -> Observer {
    let observer = observer.clone();
    Arc::new(move |event| {
        let shown = AssertUnwindSafe(|| observer(event));
        if let Err(panic) = std::panic::catch_unwind(shown) {
            let text = panic_text(panic.as_ref());
            tracing::error!(panic = %text, "whoever watches the boot panicked");
        }
    })
}
