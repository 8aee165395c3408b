//! The data objects that the nets of `path` exchange through the DOM, by name and type.

use mcs::Joints;
use serde::{Deserialize, Serialize};

use crate::{
    dispatching::Told,
    outcome::Failure,
    strategy::{
        Figures,
        step::{self, Tried},
    },
};

/// Where to go: written by the Dispatcher.
pub const TRIP: &str = "trip";
/// The way around everything that was planned: written by the Coordinator.
pub const PLANNED: &str = "planned_way";
/// How a trip went: written by the Coordinator.
pub const ACCOUNT: &str = "account";

/// [`TRIP`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trip {
    /// Number of the command since the Dispatcher started, from 1.
    pub command: u32,
    /// The place, by its name.
    pub to: String,
    /// Joint positions there, rad or m.
    pub goal: Joints,
}

/// [`ACCOUNT`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Account {
    /// The trip's command.
    pub command: u32,
    /// The step, from where to where.
    pub context: String,
    /// The ways, in the order in which they were tried.
    pub tried: Vec<Tried>,
    /// Why the trip could not be done at all, if that has nothing to do with a way.
    pub problem: Option<Failure>,
    /// What is believed of all ways of this step by now.
    pub figures: Vec<Figures>,
}

impl Told for Account {
    fn command(&self) -> u32 {
        self.command
    }

    fn lines(&self) -> Vec<String> {
        let tried = self.tried.iter().map(|tried| tried.line(&self.context));
        let mut lines: Vec<String> = tried.collect();
        lines.extend(self.problem.as_ref().map(|failure| failure.reason.clone()));
        if !self.figures.is_empty() {
            let figures = step::in_words(&self.figures);
            lines.push(format!("believed of {}: {figures}", self.context));
        }
        lines
    }

    fn failures(&self) -> Vec<Failure> {
        let tried = self.tried.iter();
        let failed = tried.filter_map(|tried| tried.ended.as_ref().err().cloned());
        failed.chain(self.problem.clone()).collect()
    }
}
