//! What the tasks of a fleet say to each other.
//!
//! A job goes from the company to a site once and for good, under a number of that site. The site's operator lends it to a
//! cell, under an epoch that is never given twice. Nothing physical is done before the operator has said yes to that epoch.

use std::sync::Arc;

use ctos::message::Command;
use scene_summary::Mark;
use serde::{Deserialize, Serialize};

/// Number of a job, from 1.
pub type JobNumber = u64;

/// What is to be done: a disc goes from one field of a board to another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Job {
    /// Its number.
    pub number: JobNumber,
    /// `COLUMN,ROW` where the disc lies.
    pub from: Arc<str>,
    /// `COLUMN,ROW` where it shall lie.
    pub to: Arc<str>,
}

/// How work on a job ended: the answers of the net, which are those of `carry`, and one more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Outcome {
    /// The disc lies where it shall.
    Carried,
    /// Nothing was done in the end, and nothing will be.
    NotCarried,
    /// No disc was there.
    NothingAtFrom,
    /// The target was not free.
    Occupied,
    /// The lease ended first; nothing was done.
    GivenUp,
}

impl Outcome {
    /// All, with the symbols that nets write for them.
    pub const ALL: [(Self, &'static str); 5] = [
        (Self::Carried, "carried"),
        (Self::NotCarried, "not_carried"),
        (Self::NothingAtFrom, "nothing_at_from"),
        (Self::Occupied, "occupied"),
        (Self::GivenUp, "given_up"),
    ];

    /// That of an output symbol.
    #[must_use]
    pub fn of(symbol: &str) -> Option<Self> {
        let mut all = Self::ALL.iter();
        all.find(|(_, known)| *known == symbol).map(|(one, _)| *one)
    }

    /// Its symbol.
    #[must_use]
    pub fn symbol(self) -> &'static str {
        let mut all = Self::ALL.iter();
        all.find(|(one, _)| *one == self)
            .map_or("", |(_, symbol)| *symbol)
    }
}

/// One attempt at a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attempt {
    /// The agent of the cell.
    pub cell: String,
    /// The version of its net and arguments; 0 where a person has said how it ended.
    pub version: u64,
    /// How it ended.
    pub outcome: Outcome,
}

/// Offers a service to a trader for a while; an earlier offer of the same task is replaced.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(code = 0x0101)]
pub struct Offer {
    /// What is offered, for example `carry`.
    pub service: String,
    /// The task that offers it.
    pub from: String,
    /// `attribute=value ...`, as for service objects.
    pub attributes: String,
    /// How long the offer stands, ms.
    pub stands_ms: u64,
}

/// An offer that meets what was asked for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Offered {
    /// The task that offers.
    pub from: String,
    /// Its attributes.
    pub attributes: String,
}

/// Asks a trader for offers, the best first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = Vec<Offered>, code = 0x0102)]
pub struct Seek {
    /// The service.
    pub service: String,
    /// Requirements and preferences, in the words of the dictionary: `load<1 -most reliability`.
    pub wanted: String,
    /// So many offers are enough.
    pub most: u32,
}

/// Gives a job to a site for good. Answered with the number of the last job that the site has taken.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = u64, code = 0x0103)]
pub struct Take {
    /// Counts the jobs given to this site, from 1. One that is not the next is not taken.
    pub number: u64,
    /// The job.
    pub job: Job,
}

/// Tells the company how a job ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(code = 0x0104)]
pub struct Ended {
    /// The job.
    pub job: JobNumber,
    /// The site's operator.
    pub site: String,
    /// How it ended.
    pub outcome: Outcome,
    /// All attempts, oldest first.
    pub attempts: Vec<Attempt>,
}

/// Lends a job to a cell. Answered with whether the cell works on it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = bool, code = 0x0105)]
pub struct Lend {
    /// The job.
    pub job: Job,
    /// Never given twice by the same operator.
    pub epoch: u64,
    /// How long the cell may work on it, ms from when it hears of it.
    pub lease_ms: u64,
}

/// Asks the operator whether a cell may begin with what cannot be undone. Answered with whether it may.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = bool, code = 0x0106)]
pub struct Begin {
    /// The job.
    pub job: JobNumber,
    /// The epoch under which it was lent.
    pub epoch: u64,
}

/// Tells the operator how work on a job ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(code = 0x0107)]
pub struct Report {
    /// The job.
    pub job: JobNumber,
    /// The epoch under which it was lent.
    pub epoch: u64,
    /// How it ended.
    pub attempt: Attempt,
}

/// The net asks its agent whether what cannot be undone may begin: whether the lease holds and the operator agrees.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = bool, code = 0x0108)]
pub struct MayBegin {
    /// The epoch of the job.
    pub epoch: u64,
}

/// The net asks its agent whether the lease of a job still holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = bool, code = 0x0109)]
pub struct Holds {
    /// The epoch of the job.
    pub epoch: u64,
}

/// Has a stand-in do a step.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = bool, code = 0x010a)]
pub struct Do {
    /// The step, of the file of times; empty: what it takes to be asked.
    pub step: String,
    /// The job.
    pub job: JobNumber,
    /// The epoch under which it was lent; for the last word on what was done.
    pub epoch: u64,
}

/// Ends all that is done under an epoch, for ever, and tells whether the disc lies where it shall.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = bool, code = 0x010b)]
pub struct Settle {
    /// The job.
    pub job: JobNumber,
    /// The epoch.
    pub epoch: u64,
}

/// Asks a cell for another version of its net, or of the arguments of a task, or its operator for that. Answered with the
/// version that it runs, or with why it was refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = Result<u64, String>, code = 0x010c)]
pub struct Install {
    /// The agent of the cell.
    pub cell: String,
    /// Counts the orders to install something, over all cells; one that is older than the last is not followed.
    pub order: u64,
    /// The version.
    pub version: u64,
    /// The task of the cell that gets other arguments; none: the net is replaced.
    pub task: Option<String>,
    /// The name of its file.
    pub file: String,
    /// Its text; empty for the arguments of the app.
    pub text: String,
}

/// Gives a task of a cell other arguments over those of the app. Answered with why it does not take them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = Result<(), String>, code = 0x010f)]
pub struct Configure {
    /// The name of their file.
    pub file: String,
    /// Its text; empty for the arguments of the app alone.
    pub text: String,
}

/// A person has seen how a job ended whose cell does not say so. Answered with why that does not count.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = Result<(), String>, code = 0x0110)]
pub struct Judge {
    /// The job.
    pub job: JobNumber,
    /// The epoch under which it was lent.
    pub epoch: u64,
    /// Whether it was carried.
    pub carried: bool,
}

/// How the cells of a site stand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Cells that were heard of.
    pub cells: u32,
    /// Cells that are at work.
    pub working: u32,
    /// Cells that are not heard of now.
    pub silent: u32,
    /// Jobs that wait for a cell.
    pub waiting: u32,
    /// Jobs that ended as they should.
    pub carried: u64,
    /// Jobs that ended otherwise.
    pub failed: u64,
    /// How often a cell died.
    pub deaths: u64,
}

/// How a cell stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum CellState {
    /// It has no job.
    Idle,
    /// It has a job.
    Working,
    /// It is not heard of now.
    Silent,
    /// It has begun a job, and does not say how that ended: a person has to look.
    Overdue,
}

/// A job that waits for a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Overdue {
    /// The job.
    pub job: Job,
    /// The epoch under which it was lent.
    pub epoch: u64,
    /// The agent of the cell that has begun it.
    pub cell: String,
}

/// Asks an operator how its cells stand: all together, and each that stands otherwise than at a moment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(reply = Overview, code = 0x010d)]
pub struct Look {
    /// The moment; none: each of them.
    pub after: Option<Mark>,
}

/// How many cells stand how, and which stand otherwise than before.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Overview {
    /// What to look from next.
    pub mark: Mark,
    /// All together.
    pub counts: Counts,
    /// Cells whose state is new.
    pub cells: Vec<(String, CellState)>,
    /// All jobs that wait for a person.
    pub overdue: Vec<Overdue>,
}

/// A task tells itself that it is time to look what is to be done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Command)]
#[command(code = 0x010e)]
pub(crate) struct Turn {}
