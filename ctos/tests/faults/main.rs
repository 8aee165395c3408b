//! The runtime under faults: a purpose-built app over four chassis, a thousand seeds per fault profile,
//! and what must hold in every one of them. And the other way round: links that break the rules are
//! caught by these checks.
//!
//! A failure names its seed. To run it alone, say `CTOS_FAULT_SEEDS=17..18`.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may end where it finds something wrong, and says what it tried; its tasks panic on purpose"
)]

mod app;
mod breach;
mod checks;
mod ledger;
mod run;

use std::ops::Range;

use ctos::{
    diagnostic::Source,
    simulation::{Faults, shrink},
};

use app::Policy;
use breach::Breach;
use run::{Trial, trial};

/// How many seeds a profile is tried with.
const SEEDS: Range<u64> = 0..16;

/// So many findings are shown of one seed.
const SHOWN: usize = 12;

/// A list of faults that is longer than this says nothing to a person.
const SHRINK_TRIALS: usize = 200;

fn seeds() -> Range<u64> {
    let Ok(text) = std::env::var("CTOS_FAULT_SEEDS") else {
        return SEEDS;
    };
    let ends = text.split_once("..").unwrap();
    ends.0.parse().unwrap()..ends.1.parse().unwrap()
}

/// What the trials of a profile came to, so that a profile under which nothing happens is noticed.
#[derive(Debug, Default)]
struct Tally {
    finished: usize,
    boot_failed: usize,
    lost: usize,
    faults: usize,
    messages: usize,
    calls_late: usize,
    returned: usize,
}

/// Tries all seeds; what is wrong in the first that fails is shown with fewer faults.
fn try_all(profile: &str) -> Tally {
    try_with(Policy::Ends, &Faults::built_in(profile).unwrap())
}

fn try_with(policy: Policy, faults: &Faults) -> Tally {
    let mut tally = Tally::default();
    for seed in seeds() {
        let trial = trial(policy, seed, faults.clone(), None);
        if !trial.wrong.is_empty() {
            report(policy, faults.name(), seed, &trial);
        }
        tally.add(&trial);
    }
    tally
}

impl Tally {
    fn add(&mut self, trial: &Trial) {
        use ctos::boot::End;
        match trial.run.outcome.end {
            End::Finished(_) => self.finished += 1,
            End::PhaseFailed { .. } | End::TaskFailed { .. } => self.boot_failed += 1,
            _ => self.lost += 1,
        }
        self.faults += trial.run.faults.len();
        self.messages += trial.messages;
        self.calls_late += trial.calls_late;
        self.returned += trial.returned;
    }
}

fn report(policy: Policy, profile: &str, seed: u64, trial: &Trial) -> ! {
    let fewer = shrink(&trial.run.faults, SHRINK_TRIALS, |script| {
        let faults = Faults::of_script("fewer", script.to_vec());
        !run::trial(policy, seed, faults, None).wrong.is_empty()
    });
    let fewer: Vec<String> = fewer.iter().map(ToString::to_string).collect();
    let shown = trial.wrong.get(..SHOWN).unwrap_or(&trial.wrong);
    panic!(
        "profile `{profile}`, seed {seed}: {} findings: {shown:#?}\nends with {:?}\nit still fails with these of its {} faults:\n{}",
        trial.wrong.len(),
        trial.run.outcome,
        trial.run.faults.len(),
        fewer.join("\n")
    );
}

#[test]
fn without_faults_every_promise_holds_and_every_app_that_starts_finishes() {
    let tally = try_all("none");
    println!("{tally:?}");
    assert_eq!(tally.lost, 0, "{tally:?}");
    assert!(tally.messages > 300 * seeds().count(), "{tally:?}");
}

#[test]
fn under_light_faults_every_promise_holds_and_no_chassis_is_lost() {
    let tally = try_all("light");
    println!("{tally:?}");
    assert_eq!(tally.lost, 0, "{tally:?}");
    assert!(
        tally.faults > 0 && tally.finished > tally.boot_failed,
        "{tally:?}"
    );
}

#[test]
fn under_rough_faults_every_promise_holds_and_no_chassis_is_lost() {
    let tally = try_all("rough");
    println!("{tally:?}");
    assert_eq!(tally.lost, 0, "{tally:?}");
    assert!(
        tally.calls_late > 0 && tally.finished > tally.boot_failed,
        "{tally:?}"
    );
}

#[test]
fn under_hostile_faults_every_promise_holds_whatever_is_lost() {
    let tally = try_all("hostile");
    println!("{tally:?}");
    assert!(tally.lost > 0 && tally.finished > 0, "{tally:?}");
}

/// Chassis die again and again, on a network that loses and delays.
fn deaths() -> Faults {
    let text = include_str!("deaths.toml");
    Faults::parse(&Source::new("deaths.toml", text)).unwrap()
}

#[test]
fn chassis_that_die_come_back_with_their_names_and_every_promise_holds() {
    let tally = try_with(Policy::Returns, &deaths());
    println!("{tally:?}");
    // More than one death a run, and nearly all runs come to their end all the same.
    assert!(tally.returned > seeds().count(), "{tally:?}");
    assert!(tally.finished * 10 > seeds().count() * 9, "{tally:?}");
}

#[test]
fn an_app_whose_chassis_come_back_is_the_same_for_one_seed() {
    for seed in 0..2 {
        let one = run::events(Policy::Returns, seed, deaths());
        assert_eq!(
            one,
            run::events(Policy::Returns, seed, deaths()),
            "seed {seed}"
        );
    }
}

/// Links that break one rule: over some seeds, the checks must say so in these words.
#[track_caller]
fn must_catch(breach: Breach, words: &str) {
    let mut said = Vec::new();
    for seed in 0..20 {
        let wrong = trial(Policy::Ends, seed, Faults::none(), Some(breach)).wrong;
        if wrong.iter().any(|text| text.contains(words)) {
            return;
        }
        said.extend(wrong);
    }
    let first: Vec<_> = said.iter().take(10).collect();
    panic!("no `{words}` among {} findings: {first:#?}", said.len());
}

#[test]
fn a_frame_that_arrives_twice_is_caught_by_the_suite() {
    must_catch(Breach::Duplicate, "delivered twice");
}

#[test]
fn frames_that_change_places_are_caught_by_the_suite() {
    must_catch(Breach::Swap, "out of order");
}

#[test]
fn a_frame_that_is_lost_is_caught_by_the_suite() {
    must_catch(Breach::Lose, "though nothing went wrong");
}

#[test]
fn a_frame_that_reaches_another_task_is_caught_by_the_suite() {
    must_catch(Breach::Misdeliver, "was sent to");
}

#[test]
fn one_seed_is_one_run_event_for_event() {
    for profile in ["none", "rough", "hostile"] {
        for seed in 0..2 {
            let faults = Faults::built_in(profile).unwrap();
            let one = run::events(Policy::Ends, seed, faults.clone());
            assert_eq!(
                one,
                run::events(Policy::Ends, seed, faults),
                "`{profile}`, seed {seed}"
            );
            assert!(one.len() > 100, "`{profile}`, seed {seed}");
        }
    }
}

#[test]
fn the_faults_of_a_run_given_as_a_list_make_the_same_run() {
    for seed in 0..3 {
        let faults = Faults::built_in("hostile").unwrap();
        let one = trial(Policy::Ends, seed, faults.clone(), None);
        let list = Faults::of_script("list", one.run.faults.clone());
        assert_eq!(
            run::events(Policy::Ends, seed, faults),
            run::events(Policy::Ends, seed, list),
            "seed {seed}"
        );
    }
}
