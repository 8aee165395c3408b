//! Booting an app: for real, with a process for each chassis, or in virtual time in this one.

use std::sync::Arc;

use ctos_bootstrap::bootstrap::contained;
use ctos_config::{App, TimeMode};
use ctos_core::registry::Registry;
use ctos_host::boot as host;
use ctos_simulation::{self as simulation, Faults, Setup};
use ctos_time::Clock;

pub use ctos_bootstrap::bootstrap::{
    BootError, BootEvent, BootState, ChassisState, End, Observer, Outcome, Progress, StopStep,
};
pub use ctos_host::boot::{ChildError, Launcher, run_chassis};
pub use ctos_link::transport::{Address, AddressError};
pub use ctos_message::frame::Counts;
pub use ctos_simulation::{Fault, FaultKind};

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
    boot_with(&clock, app, registry, launcher, &[], observer)
}

/// [`boot`] on a [`clock`] that the caller can read too, for the time in its log; it decides between real and virtual
/// time. `options` are what chassis on other hosts are told besides the app (how much to log), as `launcher` tells
/// those of this host.
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
        let setup = host::Setup {
            launcher,
            options,
            observer: &contained(observer),
        };
        host::boot(clock, &app, &registry, &setup)
    } else {
        let setup = Setup {
            clock: clock.clone(),
            ..Setup::default()
        };
        simulation::run_shared(app, registry, setup, observer).map(|run| run.outcome)
    }
}

/// Runs `app` to its end in one thread on the virtual clock, whatever its `time.mode` is, and lets
/// `faults` happen to it.
///
/// # Errors
/// [`BootError::NoChassis`] when a fault names a chassis that the app has not.
pub fn simulate(
    app: App,
    registry: Registry,
    faults: &[Fault],
    observer: &Observer,
) -> Result<Outcome, BootError> {
    let setup = Setup {
        faults: Faults::of_script("faults", faults.to_vec()),
        ..Setup::default()
    };
    simulation::run(app, registry, setup, observer).map(|run| run.outcome)
}
