//! What the others make of a chassis whose process is stopped, goes on, or is killed.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use ctos::{
    boot::{BootEvent, End, Observer, Outcome},
    task::Phase,
};
use libtest_mimic::Failed;
use rustix::process::{Pid, Signal, kill_process};

use crate::{Placement, boot_case};

/// What is done to the process of chassis `b` before phase run.
#[derive(Clone, Copy)]
enum Deed {
    /// It is stopped, and goes on after so long.
    StopFor(Duration),
    /// It is stopped, and goes on when the app is being taken down.
    StopUntilGivenUp,
    /// It is killed.
    Kill,
}

fn signal(pid: u32, signal: Signal) {
    let pid = Pid::from_raw(i32::try_from(pid).unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

/// Longer than the time after which a peer is given up: when the first has noticed, the others have
/// too.
const LONG: Duration = Duration::from_millis(1_500);

fn go_on_after(pid: u32, time: Duration) {
    std::thread::spawn(move || {
        std::thread::sleep(time);
        signal(pid, Signal::CONT);
    });
}

/// What came of a run, and what its chassis logged.
#[derive(Debug)]
struct Ran {
    outcome: Outcome,
    log: Vec<String>,
}

impl Ran {
    /// Whether the app was not bothered by what happened.
    fn did_well(&self) -> bool {
        matches!(&self.outcome.end, End::Finished(result) if result.ok)
    }

    fn failed(&self) -> Failed {
        format!("{:?}\n{}", self.outcome, self.log.join("\n")).into()
    }
}

fn run(placement: &str, timeout: &'static str, deed: Deed) -> Result<Ran, Failed> {
    let placement = Placement::ALL.iter().find(|one| one.name == placement);
    let placement = placement.ok_or("there is no such placement")?;
    let victim = Arc::new(Mutex::new(0));
    let lines = Arc::new(Mutex::new(Vec::new()));
    let log = lines.clone();
    let observer: Observer = Arc::new(move |event| {
        let mut victim = victim.lock().unwrap();
        match (event, deed) {
            (BootEvent::Started { chassis, pid, .. }, _) if chassis == "b" => {
                *victim = pid.unwrap()
            }
            (
                BootEvent::PhaseDone {
                    phase: Phase::Connect,
                    ..
                },
                deed,
            ) => match deed {
                Deed::Kill => signal(*victim, Signal::KILL),
                Deed::StopUntilGivenUp => signal(*victim, Signal::STOP),
                Deed::StopFor(time) => {
                    signal(*victim, Signal::STOP);
                    go_on_after(*victim, time);
                }
            },
            (BootEvent::Log { line, .. }, _) => log.lock().unwrap().push(line.clone()),
            (BootEvent::Stopping { .. }, Deed::StopUntilGivenUp) => go_on_after(*victim, LONG),
            _ => {}
        }
    });
    let case = "calls_cross_in_both_directions";
    let outcome = boot_case(placement, case, 1, &[timeout], &observer)?;
    drop(observer);
    let log = std::mem::take(&mut *lines.lock().unwrap());
    Ok(Ran { outcome, log })
}

/// One that is stopped for less than the time goes on as if nothing had happened.
pub fn stopped_in_time(placement: &str) -> Result<(), Failed> {
    let deed = Deed::StopFor(Duration::from_millis(400));
    let ran = run(placement, "peer_timeout_s=20", deed)?;
    if !ran.did_well() || !ran.outcome.casualties.is_empty() {
        return Err(ran.failed());
    }
    Ok(())
}

/// How often the wrong one may be the first to miss a chassis.
const RACES: u32 = 10;

/// One that is stopped for longer is given up, is told so when it goes on, and ends itself.
pub fn stopped_for_too_long(placement: &str) -> Result<(), Failed> {
    let mut ran = run(placement, "peer_timeout_s=0.4", Deed::StopUntilGivenUp)?;
    // The task on the other chassis may miss it first and end the app; then it goes on in time. And the app may
    // be done before the signal has come.
    for _ in 0..RACES {
        match &ran.outcome.end {
            End::Finished(_) if ran.outcome.casualties.is_empty() => {}
            _ => break,
        }
        ran = run(placement, "peer_timeout_s=0.4", Deed::StopUntilGivenUp)?;
    }
    let ended = ("b".to_owned(), "ended with exit code 6".to_owned());
    if ran.did_well() || !ran.outcome.casualties.contains(&ended) {
        return Err(ran.failed());
    }
    Ok(())
}

/// The death of a process is noticed at once, and not after the time.
pub fn killed(placement: &str) -> Result<(), Failed> {
    let ran = run(placement, "peer_timeout_s=3000", Deed::Kill)?;
    let mut casualties = ran.outcome.casualties.iter();
    let killed = casualties.any(|(name, how)| name == "b" && how.contains("SIGKILL"));
    if ran.did_well() || !killed || ran.outcome.took > Duration::from_secs(60) {
        return Err(ran.failed());
    }
    Ok(())
}
