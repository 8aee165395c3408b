//! The book of a site: which of its jobs wait, which are lent to whom, and how they ended. Data and rules only: it sends
//! nothing and knows no task.
//!
//! Safe without any clock: an epoch is never given twice, the book says yes to the beginning of one epoch of a job only,
//! and a job that has begun waits for its cell. Clocks decide only when a job that has not begun is lent anew.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use ctos::time::Instant;
use serde::{Deserialize, Serialize};

use crate::wire::{Attempt, Job, JobNumber, Judge, Outcome, Overdue, Report};

/// So often a job is tried that cells could not do; then it has failed.
const TRIES: usize = 3;

/// What a cell began while its lease held has ended so long after the lease.
const LAST_STEP: Duration = Duration::from_secs(60);

/// Where a job stands.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stand {
    /// It waits for a cell.
    Waits,
    /// A cell may work on it, and has not begun with what cannot be undone.
    Lent {
        /// The cell's agent.
        cell: Arc<str>,
        /// The epoch.
        epoch: u64,
        /// When the cell has given it up for sure, by the operator's clock, ns.
        until_ns: u64,
    },
    /// The cell has begun, or may have: nobody else gets it before the cell has said how it ended.
    Begun {
        /// The cell's agent.
        cell: Arc<str>,
        /// The epoch.
        epoch: u64,
        /// When the lease has ended for sure, by the operator's clock, ns.
        until_ns: u64,
    },
    /// It has ended, and the company does not know yet.
    Over(Outcome),
}

/// A job in the book.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// What is to be done.
    pub job: Job,
    /// Where it stands.
    pub stand: Stand,
    /// The attempts that have ended.
    pub attempts: Vec<Attempt>,
}

/// The book.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Book {
    /// Number of the last job that was taken from the company.
    taken: u64,
    /// The last epoch that was given.
    epoch: u64,
    /// Jobs whose ends the company does not know.
    jobs: BTreeMap<JobNumber, Entry>,
    /// Jobs that ended as they should, and otherwise.
    ended: (u64, u64),
    /// How often a cell died.
    deaths: u64,
}

fn at(moment: Instant) -> u64 {
    u64::try_from(moment.since_start().as_nanos()).unwrap_or(u64::MAX)
}

impl Book {
    /// Takes a job if its number is the next. Returns the number of the last one taken.
    pub fn take(&mut self, number: u64, job: Job) -> u64 {
        if number == self.taken + 1 {
            self.taken = number;
            let (stand, attempts) = (Stand::Waits, Vec::new());
            let entry = Entry {
                job,
                stand,
                attempts,
            };
            self.jobs.insert(entry.job.number, entry);
        }
        self.taken
    }

    /// Lends a waiting job to a cell. Returns the epoch.
    pub fn lend(
        &mut self,
        job: JobNumber,
        cell: &str,
        now: Instant,
        lease: Duration,
    ) -> Option<u64> {
        let entry = self.jobs.get_mut(&job)?;
        if entry.stand != Stand::Waits {
            return None;
        }
        self.epoch += 1;
        entry.stand = Stand::Lent {
            cell: cell.into(),
            epoch: self.epoch,
            until_ns: at(now + lease),
        };
        Some(self.epoch)
    }

    /// Whether a cell may begin with a job for good. Asked again, the answer is the same.
    pub fn begin(&mut self, job: JobNumber, epoch: u64) -> bool {
        let Some(entry) = self.jobs.get_mut(&job) else {
            return false;
        };
        match &entry.stand {
            Stand::Lent {
                cell,
                epoch: lent,
                until_ns,
            } if *lent == epoch => {
                let (cell, until_ns) = (cell.clone(), *until_ns);
                entry.stand = Stand::Begun {
                    cell,
                    epoch,
                    until_ns,
                };
                true
            }
            Stand::Begun { epoch: begun, .. } => *begun == epoch,
            _ => false,
        }
    }

    /// A cell has said how its work ended. What it says of an epoch that does not count any more changes nothing.
    pub fn report(&mut self, report: Report) {
        let Some(entry) = self.jobs.get_mut(&report.job) else {
            return;
        };
        let counts = match &entry.stand {
            Stand::Lent { epoch, .. } | Stand::Begun { epoch, .. } => *epoch == report.epoch,
            Stand::Waits | Stand::Over(_) => false,
        };
        if !counts {
            return;
        }
        let outcome = report.attempt.outcome;
        if outcome != Outcome::GivenUp {
            entry.attempts.push(report.attempt);
        }
        entry.stand = match outcome {
            Outcome::GivenUp => Stand::Waits,
            Outcome::NotCarried if entry.attempts.len() < TRIES => Stand::Waits,
            outcome => Stand::Over(outcome),
        };
        match entry.stand {
            Stand::Over(Outcome::Carried) => self.ended.0 += 1,
            Stand::Over(_) => self.ended.1 += 1,
            _ => {}
        }
    }

    /// Jobs that have begun, and whose cell has not said how they ended although no step of it can go on any more.
    pub fn overdue(&self, now: Instant) -> impl Iterator<Item = Overdue> {
        let last = at(now);
        self.jobs.values().filter_map(move |entry| {
            let Stand::Begun {
                cell,
                epoch,
                until_ns,
            } = &entry.stand
            else {
                return None;
            };
            let over_ns = until_ns.saturating_add(at(Instant::START + LAST_STEP));
            (over_ns <= last).then(|| Overdue {
                job: entry.job.clone(),
                epoch: *epoch,
                cell: cell.to_string(),
            })
        })
    }

    /// A person has seen how a job ended that is [overdue](Self::overdue). What the cell says later changes nothing.
    ///
    /// # Errors
    /// The job is not overdue.
    pub fn judge(&mut self, judge: &Judge, now: Instant) -> Result<(), String> {
        let Judge {
            job,
            epoch,
            carried,
        } = *judge;
        let overdue = self.overdue(now).find(|one| one.job.number == job);
        let Some(Overdue { cell, .. }) = overdue.filter(|one| one.epoch == epoch) else {
            return Err(format!(
                "job {job} does not wait for a person: it has ended, or its cell may still say how it ended"
            ));
        };
        let outcome = match carried {
            true => Outcome::Carried,
            false => Outcome::NotCarried,
        };
        let attempt = Attempt {
            cell,
            version: 0,
            outcome,
        };
        self.report(Report {
            job,
            epoch,
            attempt,
        });
        Ok(())
    }

    /// Takes back a job that was lent under an epoch and has not begun.
    pub fn take_back(&mut self, job: JobNumber, epoch: u64) {
        if let Some(entry) = self.jobs.get_mut(&job)
            && matches!(&entry.stand, Stand::Lent { epoch: lent, .. } if *lent == epoch)
        {
            entry.stand = Stand::Waits;
        }
    }

    /// A cell has died: takes back what it has and has not begun. Returns those jobs.
    pub fn gone(&mut self, gone: &str) -> Vec<JobNumber> {
        self.deaths += 1;
        self.take_back_if(|cell, _| cell == gone)
    }

    /// Takes back what has not begun and whose cell has given it up for sure. Returns those jobs.
    pub fn expire(&mut self, now: Instant) -> Vec<JobNumber> {
        let now = at(now);
        self.take_back_if(|_, until_ns| until_ns <= now)
    }

    fn take_back_if(&mut self, which: impl Fn(&str, u64) -> bool) -> Vec<JobNumber> {
        let mut taken = Vec::new();
        for (number, entry) in &mut self.jobs {
            if matches!(&entry.stand, Stand::Lent { cell, until_ns, .. } if which(cell, *until_ns))
            {
                entry.stand = Stand::Waits;
                taken.push(*number);
            }
        }
        taken
    }

    /// The clock has begun anew, with the app: leases count from now on.
    pub fn begin_again(&mut self, now: Instant, lease: Duration) {
        for entry in self.jobs.values_mut() {
            if let Stand::Lent { until_ns, .. } | Stand::Begun { until_ns, .. } = &mut entry.stand {
                *until_ns = (*until_ns).min(at(now + lease));
            }
        }
    }

    /// The company knows how a job ended.
    pub fn forget(&mut self, job: JobNumber) {
        if matches!(self.jobs.get(&job), Some(entry) if matches!(entry.stand, Stand::Over(_))) {
            self.jobs.remove(&job);
        }
    }

    /// All that stands in it.
    #[must_use]
    pub fn entries(&self) -> &BTreeMap<JobNumber, Entry> {
        &self.jobs
    }

    /// Jobs that wait, oldest first.
    pub fn waiting(&self) -> impl Iterator<Item = &Job> {
        let waits = |entry: &&Entry| entry.stand == Stand::Waits;
        self.jobs.values().filter(waits).map(|entry| &entry.job)
    }

    /// The cell that has a job.
    #[must_use]
    pub fn holder(entry: &Entry) -> Option<&str> {
        match &entry.stand {
            Stand::Lent { cell, .. } | Stand::Begun { cell, .. } => Some(cell),
            Stand::Waits | Stand::Over(_) => None,
        }
    }

    /// How many jobs ended as they should, and how many otherwise.
    #[must_use]
    pub fn ended(&self) -> (u64, u64) {
        self.ended
    }

    /// How often a cell died.
    #[must_use]
    pub fn deaths(&self) -> u64 {
        self.deaths
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn job(number: JobNumber) -> Job {
        Job {
            number,
            from: "1,1".into(),
            to: "2,2".into(),
        }
    }

    fn report(job: JobNumber, epoch: u64, outcome: Outcome) -> Report {
        let cell = "c".to_owned();
        let version = 1;
        Report {
            job,
            epoch,
            attempt: Attempt {
                cell,
                version,
                outcome,
            },
        }
    }

    const LEASE: Duration = Duration::from_secs(30);

    #[test]
    fn a_job_that_has_begun_is_never_lent_to_another_cell_before_its_cell_says_how_it_ended() {
        let mut book = Book::default();
        assert_eq!(book.take(1, job(7)), 1);
        let now = Instant::START;
        let epoch = book.lend(7, "a", now, LEASE).unwrap();
        assert!(book.begin(7, epoch));
        assert_eq!(book.expire(now + LEASE * 9), [0; 0]);
        assert_eq!(book.gone("a"), [0; 0]);
        assert_eq!(book.lend(7, "b", now, LEASE), None);
        book.report(report(7, epoch, Outcome::GivenUp));
        assert_eq!(book.lend(7, "b", now, LEASE), Some(epoch + 1));
        assert!(!book.begin(7, epoch));
    }

    #[test]
    fn a_person_says_how_a_job_ended_only_when_its_cell_can_do_nothing_more_and_the_cell_changes_nothing_then()
     {
        let mut book = Book::default();
        book.take(1, job(7));
        let begun = Instant::START;
        let epoch = book.lend(7, "a", begun, LEASE).unwrap();
        let judge = |carried| Judge {
            job: 7,
            epoch,
            carried,
        };
        let late = begun + LEASE + LAST_STEP;
        assert!(book.judge(&judge(true), late).is_err(), "it has not begun");
        assert!(book.begin(7, epoch));
        assert_eq!(book.overdue(begun + LEASE).count(), 0);
        assert!(book.judge(&judge(true), begun + LEASE).is_err());
        let overdue: Vec<_> = book.overdue(late).map(|one| one.cell).collect();
        assert_eq!(overdue, ["a"]);
        let other = Judge {
            epoch: epoch + 1,
            ..judge(true)
        };
        assert!(book.judge(&other, late).is_err());
        assert_eq!(book.judge(&judge(false), late), Ok(()));
        book.report(report(7, epoch, Outcome::Carried));
        let again = book.lend(7, "b", late, LEASE);
        assert_eq!(again, Some(epoch + 1), "it is tried again elsewhere");
        assert!(!book.begin(7, epoch));
        assert!(book.judge(&judge(true), late).is_err());
    }

    #[test]
    fn a_job_is_taken_once_however_often_it_is_given() {
        let mut book = Book::default();
        assert_eq!(book.take(1, job(7)), 1);
        let epoch = book.lend(7, "a", Instant::START, LEASE).unwrap();
        book.report(report(7, epoch, Outcome::Carried));
        book.forget(7);
        assert_eq!(book.take(1, job(7)), 1);
        assert_eq!(book.take(3, job(9)), 1);
        assert!(book.entries().is_empty());
        assert_eq!(book.ended(), (1, 0));
    }

    proptest! {
        /// Whatever is said in whatever order, also late and twice, one epoch of a job at most is told that it may begin
        /// and not told to end before another one is.
        #[test]
        fn no_two_epochs_of_a_job_may_begin(said in prop::collection::vec((0_u8..7, 1_u64..6), 1..60)) {
            let mut book = Book::default();
            book.take(1, job(1));
            let (mut now, mut begun) = (Instant::START, None);
            for (what, epoch) in said {
                match what {
                    0 => { book.lend(1, "a", now, LEASE); }
                    1 => if book.begin(1, epoch) {
                        prop_assert!(begun.is_none_or(|other| other == epoch));
                        begun = Some(epoch);
                    },
                    2 => {
                        // Only who was told to begin has something to give up.
                        book.report(report(1, epoch, Outcome::GivenUp));
                        if begun == Some(epoch) {
                            begun = None;
                        }
                    }
                    3 => { book.gone("a"); }
                    4 => { book.expire(now); now = now + LEASE / 2; }
                    5 => {
                        let judge = Judge { job: 1, epoch, carried: false };
                        if book.judge(&judge, now).is_ok() {
                            prop_assert_eq!(begun, Some(epoch));
                            begun = None;
                        }
                    }
                    _ => book.take_back(1, epoch),
                }
            }
        }
    }
}
