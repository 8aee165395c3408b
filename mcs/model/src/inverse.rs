//! Inverse kinematics: in closed form where the arm has one, else by search. Every pose that has no joint positions
//! gets a named reason.

mod closed;
mod error;
mod puma;
mod search;

pub use closed::ClosedForm;
pub use error::IkError;
pub use puma::{Branch, Elbow, IkSolution, IkSolutions, Puma, Shoulder, Singular, Wrist};
pub use search::{Preferences, Search};

#[cfg(test)]
mod tests;
