//! One suite for every way in which two tasks can be placed. What holds on one processor must hold
//! between threads, over simulated links and over every kind of link between processes, whole or injured.
//!
//! Each trial boots an app of its own. Its own `main`, because the chassis of the real placements are
//! processes of this program.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may end where it finds something wrong, and its tasks panic on purpose"
)]

mod app;
mod cases;
mod peer;
mod signals;

use std::{
    ffi::OsString,
    io::Write as _,
    panic::AssertUnwindSafe,
    path::Path,
    process::ExitCode,
    sync::{Arc, Mutex, PoisonError, mpsc},
    time::Duration,
};

use ctos::boot::{Address, BootEvent, End, Launcher, Observer, Outcome, boot, run_chassis};
use ctos::security::{Role, make_key};
use libtest_mimic::{Arguments, Failed, Trial};

use app::Placement;
use cases::{CASES, Case};

/// The first argument of a process that is a chassis and not the tests.
const CHASSIS: &str = "conformance-chassis";

/// Between a case and its settings on the command line of a chassis.
const SEPARATOR: &str = ";";

/// A trial that takes longer hangs.
const WATCHDOG: Duration = Duration::from_secs(120);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|first| first == CHASSIS) {
        return chassis(&arguments);
    }
    let cases = Placement::ALL.iter().flat_map(|placement| {
        CASES.iter().map(move |case| {
            let name = format!("{}::{}", placement.name, case.name);
            Trial::test(name, move || watched(move || run(placement, case)))
        })
    });
    let signals = LINKS.iter().flat_map(|placement| {
        SIGNALS.iter().map(move |(name, test)| {
            let name = format!("{placement}::{name}");
            Trial::test(name, move || watched(move || test(placement)))
        })
    });
    let trials = cases.chain(signals).collect();
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// The placements whose links show how a process fares.
const LINKS: &[&str] = &[
    "two_chassis_shm",
    "two_chassis_unix",
    "two_chassis_tcp",
    #[cfg(feature = "zenoh")]
    "two_chassis_zenoh",
];

type SignalTest = fn(&str) -> Result<(), Failed>;

const SIGNALS: [(&str, SignalTest); 3] = [
    (
        "one_that_is_stopped_and_goes_on_in_time_is_not_missed",
        signals::stopped_in_time,
    ),
    (
        "one_that_is_stopped_for_too_long_is_told_so_and_ends",
        signals::stopped_for_too_long,
    ),
    ("one_that_is_killed_is_missed_at_once", signals::killed),
];

/// Runs a trial on a thread of its own and gives up on it when it hangs.
fn watched(trial: impl FnOnce() -> Result<(), Failed> + Send + 'static) -> Result<(), Failed> {
    let (sender, done) = mpsc::channel();
    std::thread::spawn(move || {
        let result = std::panic::catch_unwind(AssertUnwindSafe(trial));
        let _ = sender.send(result.unwrap_or_else(|_| Err("the boot panicked".into())));
    });
    done.recv_timeout(WATCHDOG)
        .unwrap_or_else(|_| Err(format!("hangs; nothing came for {WATCHDOG:?}").into()))
}

/// Makes the keys that some placements need, once for all runs.
fn make_keys() -> Result<(), Failed> {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _one = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let keys = Path::new(app::KEYS);
    if keys.exists() {
        return Ok(());
    }
    let begun = keys.with_extension(std::process::id().to_string());
    make_key(&begun.join("cell"), Role::Boot)?;
    // A trial of another process may have been faster.
    if std::fs::rename(&begun, keys).is_err() && keys.exists() {
        std::fs::remove_dir_all(&begun)?;
    }
    Ok(())
}

/// Boots the app of a case, with further settings of its own.
fn boot_case(
    placement: &Placement,
    case: &str,
    seed: u64,
    sets: &[&str],
    observer: &Observer,
) -> Result<Outcome, Failed> {
    make_keys()?;
    let own = placement.own_sets();
    let sets: Vec<&str> = sets
        .iter()
        .copied()
        .chain(own.iter().map(String::as_str))
        .collect();
    let case_and_sets = [&[case], &sets[..]].concat().join(SEPARATOR);
    let launcher = Launcher {
        program: std::env::current_exe()?,
        arguments: [CHASSIS, placement.name, &case_and_sets]
            .map(OsString::from)
            .to_vec(),
    };
    let app = placement.app(seed, case, &sets);
    Ok(boot(app, app::registry(), &launcher, observer)?)
}

fn run(placement: &Placement, case: &Case) -> Result<(), Failed> {
    // A schedule drawn from another seed is another interleaving.
    for seed in placement.seeds.clone() {
        let log: Arc<std::sync::Mutex<Vec<String>>> = Arc::default();
        let lines = log.clone();
        let observer: Observer = Arc::new(move |event| {
            if let BootEvent::Log { line, .. } = event {
                lines.lock().unwrap().push(line.clone());
            }
        });
        let outcome = boot_case(placement, case.name, seed, &[], &observer)?;
        let log = log.lock().unwrap().join("\n");
        match outcome.end {
            End::Finished(result) if result.ok => {}
            End::Finished(result) => {
                return Err(format!("seed {seed}: {}\n{log}", result.text).into());
            }
            end => {
                let casualties = outcome.casualties;
                return Err(format!("seed {seed}: {end:?}, {casualties:?}\n{log}").into());
            }
        }
        if !outcome.casualties.is_empty() {
            return Err(format!("seed {seed}: {:?}\n{log}", outcome.casualties).into());
        }
    }
    Ok(())
}

/// The process of one chassis: `conformance-chassis PLACEMENT CASE --chassis NAME --boot ADDRESS --origin NS`.
fn chassis(arguments: &[String]) -> ExitCode {
    let [_, placement, case, _, name, _, address, _, origin] = arguments else {
        return ExitCode::from(2);
    };
    let placement = Placement::ALL.iter().find(|one| one.name == *placement);
    let (Some(placement), Ok(address), Ok(origin)) =
        (placement, address.parse::<Address>(), origin.parse())
    else {
        return ExitCode::from(2);
    };
    let (case, sets) = case.split_once(SEPARATOR).unwrap_or((case, ""));
    let sets: Vec<&str> = sets.split_terminator(SEPARATOR).collect();
    let app = placement.app(1, case, &sets);
    match run_chassis(app, app::registry(), name, &address, origin) {
        Ok(code) => ExitCode::from(u8::try_from(code).unwrap_or(255)),
        Err(error) => {
            // The boot shows what a chassis writes there.
            let _ = writeln!(std::io::stderr(), "{error}");
            ExitCode::from(4)
        }
    }
}
