//! One trial: a seed, its faults, and what the checks say of the run.

use std::sync::{Arc, LazyLock, Mutex};

use ctos::{
    boot::{BootEvent, Observer},
    config::App,
    simulation::{EventSink, Faults, Run, Setup, run_shared},
    task::Phase,
    time::Clock,
};

use crate::{
    app::{self, Policy},
    breach::Breach,
    checks,
    ledger::Ledger,
};

static ENDS: LazyLock<App> = LazyLock::new(|| app::app(Policy::Ends));
static RETURNS: LazyLock<App> = LazyLock::new(|| app::app(Policy::Returns));

fn app_of(policy: Policy) -> &'static App {
    match policy {
        Policy::Ends => &ENDS,
        Policy::Returns => &RETURNS,
    }
}

/// A run and everything that is wrong with it.
pub struct Trial {
    pub run: Run,
    pub wrong: Vec<String>,
    pub messages: usize,
    pub calls_late: usize,
    /// Chassis that came back.
    pub returned: usize,
}

/// Runs a seed.
pub fn trial(policy: Policy, seed: u64, faults: Faults, breach: Option<Breach>) -> Trial {
    let (run, ledger) = simulate(policy, seed, faults, breach, None);
    let broken = breach.is_some();
    let wrong = checks::all(app_of(policy), &run, &ledger, broken);
    let book = ledger.book();
    Trial {
        messages: book.sent.len(),
        calls_late: checks::late(&book),
        returned: book.returned,
        wrong,
        run,
    }
}

/// The event log of a seed.
pub fn events(policy: Policy, seed: u64, faults: Faults) -> Vec<String> {
    let lines = Arc::new(Mutex::new(Vec::new()));
    let seen = lines.clone();
    let sink: EventSink = Arc::new(move |line: &str| seen.lock().unwrap().push(line.to_owned()));
    simulate(policy, seed, faults, None, Some(sink));
    std::mem::take(&mut lines.lock().unwrap())
}

fn simulate(
    policy: Policy,
    seed: u64,
    faults: Faults,
    breach: Option<Breach>,
    events: Option<EventSink>,
) -> (Run, Ledger) {
    // What a task panics with on purpose is no news.
    std::panic::set_hook(Box::new(|_| ()));
    let mut app = app_of(policy).clone();
    app.seed = seed;
    let clock = Clock::virtual_clock();
    let ledger = Ledger::new(clock.clone());
    let registry = app::registry(&ledger);
    let watched = ledger.clone();
    let observer: Observer = Arc::new(move |event: &BootEvent| match event {
        BootEvent::Stopping { .. } => {
            watched.book().stopping = Some(watched.clock.now());
        }
        BootEvent::PhaseDone {
            phase: Phase::Run, ..
        } => watched.book().running = true,
        BootEvent::ChassisFailed { chassis, .. } => {
            watched.book().failures.push((chassis.clone(), None));
        }
        // One whose task failed is stopped in order first, and works on until then.
        BootEvent::Restarting { chassis, .. } => {
            let now = watched.clock.now();
            let mut book = watched.book();
            let mut open = book.failures.iter_mut().rev();
            if let Some(failure) = open.find(|(name, _)| name == chassis) {
                failure.1 = Some(now);
            }
        }
        BootEvent::Restarted { .. } => watched.book().returned += 1,
        _ => {}
    });
    let setup = Setup {
        clock,
        faults,
        events,
        tamper: breach.map(|breach| breach.tamper(seed)),
        ..Setup::default()
    };
    let run = run_shared(Arc::new(app), Arc::new(registry), setup, &observer);
    let _ = std::panic::take_hook();
    (run.unwrap(), ledger)
}
