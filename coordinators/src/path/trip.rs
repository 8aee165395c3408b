//! The data objects that the nets of `path` exchange through the DOM, by name and type.

use mcs::Joints;
use serde::{Deserialize, Serialize};

use crate::{outcome::Failure, strategy::Figures};

/// Where to go: written by the Dispatcher.
pub const TRIP: &str = "trip";
/// Which way was chosen, and why: written by the Coordinator.
pub const CHOSEN: &str = "chosen_way";
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

/// [`CHOSEN`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Chosen {
    /// The trip's command.
    pub command: u32,
    /// The step, from where to where.
    pub context: String,
    /// The numbers of the ways that were open, the chosen one first.
    pub figures: Vec<Figures>,
}

/// One way that was tried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tried {
    /// Its name.
    pub way: String,
    /// How long it took, s.
    pub seconds: f64,
    /// What came of it: words about the way, or why it led nowhere.
    pub ended: Result<String, Failure>,
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

impl Account {
    /// What there is to say of it, line by line.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        let mut lines: Vec<String> = self
            .tried
            .iter()
            .map(
                |Tried {
                     way,
                     seconds,
                     ended,
                 }| match ended {
                    Ok(about) => format!("{}: {way}, {about}{seconds:.1} s", self.context),
                    Err(failure) => format!(
                        "{}: {way} failed after {seconds:.1} s: {}",
                        self.context, failure.reason
                    ),
                },
            )
            .collect();
        lines.extend(self.problem.as_ref().map(|failure| failure.reason.clone()));
        if !self.figures.is_empty() {
            let figures: Vec<String> = self.figures.iter().map(ToString::to_string).collect();
            lines.push(format!(
                "believed of {}: {}",
                self.context,
                figures.join(", ")
            ));
        }
        lines
    }
}
