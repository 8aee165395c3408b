//! What kept a Coordinator from doing what it was asked, as a type from the Execution Level up to the
//! command. Only what a net names may be skipped. Knows no net, and of tasks only their errors
//! (`HandlerError`).

use std::fmt;

use ctos::task::HandlerError;
use mcs::client::{MotionError, Outcome as Motion};
use serde::{Deserialize, Serialize};
use vss::command::{Outcome as Vision, VisionError};

/// Which kind of thing was in the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Outcome {
    /// The position, or the way to it, is out of reach of the arm. Another may be in reach.
    Unreachable,
    /// A camera did not see what it looked for. It may at another position.
    Unseen,
    /// A protective stop holds, or the app is being stopped.
    Stopped,
    /// An emergency stop took drive power away.
    Estopped,
    /// A guard ended the motion.
    Guard,
    /// Hardware, control or a computation failed.
    Fault,
    /// A task that is needed is gone or does not answer.
    Lost,
    /// The request does not fit what it was made to.
    Refused,
    /// What was to be taken is not there.
    Absent,
    /// Something stands already where a thing was to be set down.
    Occupied,
    /// Another thing touches what was to be taken.
    Stuck,
    /// The way would lead too near to something. The arm has not begun it.
    Blocked,
}

impl Outcome {
    /// All of them, in the order of their codes.
    pub const ALL: [Self; 12] = [
        Self::Unreachable,
        Self::Unseen,
        Self::Stopped,
        Self::Estopped,
        Self::Guard,
        Self::Fault,
        Self::Lost,
        Self::Refused,
        Self::Absent,
        Self::Occupied,
        Self::Stuck,
        Self::Blocked,
    ];

    /// Its number for programs, from 1. A number keeps its meaning.
    #[must_use]
    pub fn code(self) -> u16 {
        self as u16 + 1
    }

    /// The one of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|outcome| outcome.to_string() == name)
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unreachable => "unreachable",
            Self::Unseen => "unseen",
            Self::Stopped => "stopped",
            Self::Estopped => "estopped",
            Self::Guard => "guard",
            Self::Fault => "fault",
            Self::Lost => "lost",
            Self::Refused => "refused",
            Self::Absent => "absent",
            Self::Occupied => "occupied",
            Self::Stuck => "stuck",
            Self::Blocked => "blocked",
        })
    }
}

impl From<Motion> for Outcome {
    fn from(outcome: Motion) -> Self {
        match outcome {
            Motion::Unreachable => Self::Unreachable,
            Motion::Stopped => Self::Stopped,
            Motion::Estopped => Self::Estopped,
            Motion::Guard => Self::Guard,
            Motion::Fault => Self::Fault,
            Motion::Lost => Self::Lost,
            Motion::Refused => Self::Refused,
        }
    }
}

impl From<Vision> for Outcome {
    fn from(outcome: Vision) -> Self {
        match outcome {
            Vision::Unseen => Self::Unseen,
            Vision::Fault => Self::Fault,
            Vision::Lost => Self::Lost,
            Vision::Refused => Self::Refused,
        }
    }
}

/// Why something was not done: the kind, and the words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{outcome}: {reason}")]
pub struct Failure {
    /// Which kind of thing was in the way.
    pub outcome: Outcome,
    /// In words.
    pub reason: String,
}

impl Failure {
    /// A failure of a kind, in words.
    #[must_use]
    pub fn new(outcome: Outcome, reason: impl ToString) -> Self {
        Self {
            outcome,
            reason: reason.to_string(),
        }
    }
}

impl From<MotionError> for Failure {
    fn from(error: MotionError) -> Self {
        Self::new(error.outcome.into(), error.reason)
    }
}

impl From<VisionError> for Failure {
    fn from(error: VisionError) -> Self {
        Self::new(error.outcome.into(), error.reason)
    }
}

/// What failed without a kind was this side's own: the data object manager, for example.
impl From<HandlerError> for Failure {
    fn from(error: HandlerError) -> Self {
        Self::new(Outcome::Fault, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_and_names_are_as_they_are_told_to_other_programs() {
        let told = Outcome::ALL.map(|outcome| format!("{} {outcome}", outcome.code()));
        let expected = "1 unreachable, 2 unseen, 3 stopped, 4 estopped, 5 guard, 6 fault, 7 lost, 8 refused, 9 absent, \
                        10 occupied, 11 stuck, 12 blocked";
        assert_eq!(told.join(", "), expected);
        for outcome in Outcome::ALL {
            assert_eq!(Outcome::named(&outcome.to_string()), Some(outcome));
        }
        assert_eq!(Outcome::named("ocupied"), None);
    }
}
