//! What must hold in every run, checked from its ledger and from outside.

use std::{collections::BTreeSet, time::Duration};

use ctos::{
    boot::End,
    call::Fault,
    config::App,
    simulation::{self, FaultKind, Run, Site},
    task::Phase,
    time::Instant,
};

use crate::ledger::{Book, Ledger, Sent, Step};

/// Timers end at the nanosecond; a clock that drifts rounds.
const ROUNDING: Duration = Duration::from_micros(1);

/// Everything that is wrong with a run. Where a rule of the links is `broken` on purpose, the run may end in any way.
pub fn all(app: &App, run: &Run, ledger: &Ledger, broken: bool) -> Vec<String> {
    let mut book = ledger.book();
    let mut wrong = std::mem::take(&mut book.wrong);
    let check = Check {
        app,
        run,
        book: &book,
    };
    check.calls_end_in_time(&mut wrong);
    check.what_was_taken_was_handled(&mut wrong);
    check.nothing_fails_without_a_reason(&mut wrong);
    check.names_are_unique(&mut wrong);
    check.phases_are_all_or_nothing(&mut wrong);
    check.nothing_is_left(&mut wrong);
    check.the_stop_is_bounded(&mut wrong);
    check.the_end_has_a_reason(broken, &mut wrong);
    wrong
}

/// How many messages were given up by their senders.
pub fn late(book: &Book) -> usize {
    let ends = book.sent.iter().filter_map(|sent| sent.ended.as_ref());
    ends.filter(|(_, _, result)| matches!(result, Err(Fault::Deadline { .. })))
        .count()
}

struct Check<'a> {
    app: &'a App,
    run: &'a Run,
    book: &'a Book,
}

impl Check<'_> {
    fn chassis_of(&self, task: &str) -> &str {
        self.app.task(task).map_or("", |task| task.chassis.as_str())
    }

    /// Whether a chassis did not live to the end.
    fn is_lost(&self, chassis: &str) -> bool {
        let mut casualties = self.run.outcome.casualties.iter();
        casualties.any(|(name, _)| name == chassis)
    }

    /// Whether a process of a chassis that was there at `time` died later, also if the chassis came back.
    fn has_failed(&self, chassis: &str, time: Instant) -> bool {
        let mut failures = self.book.failures.iter();
        failures.any(|(name, dead)| name == chassis && dead.is_none_or(|dead| dead >= time))
    }

    /// For how long at most the faults of its own chassis kept a task from running.
    fn held_up(&self, chassis: &str) -> Duration {
        let mut held = Duration::ZERO;
        for fault in &self.run.faults {
            if fault.site != Site::Chassis(chassis.to_owned()) {
                continue;
            }
            let lasts = fault.until.map(|until| until.since(fault.at));
            match fault.kind {
                FaultKind::Freeze => held += lasts.unwrap(),
                FaultKind::Slow { per_step } => held += lasts.unwrap() + per_step,
                _ => {}
            }
        }
        // Measured by a clock that may run fast.
        held + held / 50 + ROUNDING
    }

    /// Every call and every send ends, at its deadline at the latest.
    fn calls_end_in_time(&self, wrong: &mut Vec<String>) {
        for sent in &self.book.sent {
            let chassis = self.chassis_of(&sent.from);
            let limit = sent.deadline + self.held_up(chassis);
            match &sent.ended {
                Some((end, _, _)) if end.since(sent.began) > limit => {
                    wrong.push(format!("ended late, limit {limit:?}: {sent:?}"));
                }
                None if self.outlived(sent, limit) => {
                    wrong.push(format!("never ended: {sent:?}"));
                }
                _ => {}
            }
        }
    }

    /// Whether the sender of a message that did not end was there for longer than `limit`.
    fn outlived(&self, sent: &Sent, limit: Duration) -> bool {
        let chassis = self.chassis_of(&sent.from);
        if self.is_lost(chassis) || self.has_failed(chassis, sent.began_true) {
            return false;
        }
        // A panic of the sender ends what it waited for.
        if self.book.incarnations.get(&sent.from) > Some(&1) {
            return false;
        }
        let over = Instant::START + self.run.outcome.took;
        let end = self.book.stops.get(&sent.from).copied().unwrap_or(over);
        end.since(sent.began_true) > limit + limit / 50
    }

    /// What a receiver has taken it handles, unless it died or was stopped before.
    fn what_was_taken_was_handled(&self, wrong: &mut Vec<String>) {
        let finished = matches!(self.run.outcome.end, End::Finished(_));
        for sent in &self.book.sent {
            let taken = matches!(sent.ended, Some((_, _, Ok(()))));
            if !taken || sent.begun.is_some() {
                continue;
            }
            let chassis = self.chassis_of(&sent.to);
            let died = self.is_lost(chassis) || self.has_failed(chassis, sent.began_true);
            // An app that finishes has waited until all was handled.
            // Between two handlers there is none to be told of the stop, nor to handle anything.
            let told = self.book.stops.contains_key(&sent.to);
            let stopped = !finished && (told || self.book.broken.contains(&sent.to));
            if !died && !stopped || sent.is_call {
                wrong.push(format!("taken and never handled: {sent:?}"));
            }
        }
    }

    /// Without faults of the world, what fails does so because the receiver said so or was busy.
    fn nothing_fails_without_a_reason(&self, wrong: &mut Vec<String>) {
        if !self.run.faults.is_empty() {
            return;
        }
        let patient = Duration::from_secs(2);
        for sent in &self.book.sent {
            let Some((_, _, Err(fault))) = &sent.ended else {
                continue;
            };
            // What ends with the app needs no other reason.
            if self.book.stopping.is_some() && sent.ended_true >= self.book.stopping {
                continue;
            }
            let excused = match fault {
                // A sink is done with its queue in less.
                Fault::Deadline { .. } => sent.is_call || sent.deadline < patient,
                Fault::Full { .. } | Fault::Stopping => true,
                Fault::Refused { .. } | Fault::NoReply | Fault::Panicked { .. } => sent.is_call,
                _ => false,
            };
            if !excused {
                wrong.push(format!("failed though nothing went wrong: {sent:?}"));
            }
        }
    }

    /// A name leads to one task, and a task has one name.
    fn names_are_unique(&self, wrong: &mut Vec<String>) {
        let mut seen = BTreeSet::new();
        for (name, tids) in &self.book.tids {
            let once = tids.iter().all(|tid| seen.insert(*tid));
            // One for each process that its chassis has had.
            let failures = self.book.failures.iter();
            let lives = 1 + failures
                .filter(|(chassis, _)| chassis == self.chassis_of(name))
                .count();
            if tids.is_empty() || tids.len() > lives || !once {
                wrong.push(format!("`{name}` leads to {tids:?}"));
            }
        }
    }

    /// Nobody enters a phase before all have acknowledged the one before, and an app that runs has
    /// all of its tasks in its last phase.
    fn phases_are_all_or_nothing(&self, wrong: &mut Vec<String>) {
        let mut acknowledged: BTreeSet<(Phase, &str)> = BTreeSet::new();
        let all = self.app.tasks.len();
        for (task, incarnation, phase, step) in &self.book.phases {
            match step {
                // One that is built anew is brought to where the old one was.
                Step::Entered => {
                    if !acknowledged.insert((*phase, task)) && *incarnation == 1 {
                        wrong.push(format!("{task} entered {phase} twice"));
                    }
                }
                Step::Enters => {
                    let before = Phase::ALL.iter().rfind(|before| *before < phase);
                    let ready = before.is_none_or(|before| {
                        acknowledged.iter().filter(|(one, _)| one == before).count() == all
                    });
                    if !ready {
                        wrong.push(format!("{task} enters {phase} before all are there"));
                    }
                }
            }
        }
        let running = acknowledged
            .iter()
            .filter(|(phase, _)| *phase == Phase::Run);
        if self.book.running && running.count() != all {
            wrong.push("the app runs, and not all of its tasks".to_owned());
        }
        let failed = matches!(self.run.outcome.end, End::PhaseFailed { .. });
        if failed && self.book.running {
            wrong.push("the boot failed, and the app ran".to_owned());
        }
        // Every task that was built has been told to stop, if its chassis was there to be told.
        for task in &self.app.tasks {
            let built = self.book.incarnations.contains_key(&task.name);
            let told = self.book.stops.contains_key(&task.name);
            let failed = self.failed(&task.name);
            if built
                && !told
                && !failed
                && !self.is_lost(&task.chassis)
                && !self.has_failed(&task.chassis, Instant::START)
                // There is no handler to tell between two of them.
                && !self.book.broken.contains(&task.name)
                && !self.is_cut_off(&task.chassis)
            {
                wrong.push(format!("{} was never told to stop", task.name));
            }
        }
    }

    /// Whether a task ended by itself, as a panic in a phase makes it.
    fn failed(&self, task: &str) -> bool {
        match &self.run.outcome.end {
            End::TaskFailed { task: name, .. } => name == task,
            End::PhaseFailed { failures, .. } => failures.iter().any(|(name, _)| name == task),
            _ => false,
        }
    }

    /// Whether faults may have kept the order to stop from a chassis.
    fn is_cut_off(&self, chassis: &str) -> bool {
        self.run
            .faults
            .iter()
            .any(|fault| match (fault.kind, &fault.site) {
                (FaultKind::Freeze | FaultKind::Slow { .. }, Site::Chassis(name)) => {
                    name == chassis || name == "boot"
                }
                (FaultKind::Cut, _) => false,
                (_, Site::Link(one, other)) => {
                    (one == "boot" && other == chassis) || (other == "boot" && one == chassis)
                }
                _ => false,
            })
    }

    /// Whatever the end, no handler is left.
    fn nothing_is_left(&self, wrong: &mut Vec<String>) {
        if self.book.alive != 0 {
            wrong.push(format!("{} handlers outlived the app", self.book.alive));
        }
    }

    /// An orderly stop takes no longer than its limits together.
    fn the_stop_is_bounded(&self, wrong: &mut Vec<String>) {
        let Some(began) = self.book.stopping else {
            return;
        };
        let steps = u32::try_from(self.app.tasks.len() + self.app.chassis.len()).unwrap();
        let limits = self.app.stop_timeout * steps;
        let limit = limits + limits / 50 + self.held_up("boot");
        let took = (Instant::START + self.run.outcome.took).since(began);
        if took > limit {
            wrong.push(format!("the stop took {took:?}, its limits are {limit:?}"));
        }
    }

    /// An app ends because it is done, because it did not start, or because something was lost.
    fn the_end_has_a_reason(&self, broken: bool, wrong: &mut Vec<String>) {
        let can_lose = |fault: &simulation::Fault| {
            let silent = fault.until.map(|until| until.since(fault.at));
            match fault.kind {
                FaultKind::Kill => true,
                FaultKind::Break | FaultKind::Stall | FaultKind::Freeze => {
                    silent > Some(Duration::from_millis(500))
                }
                _ => false,
            }
        };
        let lost = self.run.faults.iter().any(can_lose);
        let reasonable = match &self.run.outcome.end {
            End::Finished(result) => result.ok,
            End::PhaseFailed { failures, .. } => {
                let shaky = failures.iter().all(|(task, _)| task == "shaky");
                shaky || !self.run.faults.is_empty()
            }
            // A task's failure is that of its chassis alone once the app has been up.
            End::TaskFailed { task, .. } if task == "server4" => !self.book.running,
            End::TaskFailed { task, .. } => task == "shaky",
            End::ChassisDown { .. } | End::GivenUp { .. } => lost,
            End::Interrupted | End::Stopped | End::Stuck | End::Breakpoint { .. } => false,
        };
        if !reasonable && !broken {
            wrong.push(format!("it ended with {:?}", self.run.outcome.end));
        }
    }
}
