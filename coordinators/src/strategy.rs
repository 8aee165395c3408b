//! Strategies: several ways of one step, and which of them to try first (CIRSSE report 108, section 6: Coordinators with several
//! strategies, errors solved locally and passed up only when not).
//!
//! [`belief`] is what has been seen of each way, by context, and the choice: the way most likely to succeed for its cost. [`step`] is
//! what a Coordinator keeps of the step in work, and [`shown`] what people see of it. A Coordinator tries the ways in that order until one succeeds, and passes up the reasons of all when none does. What has
//! been seen is part of the state that a durable net keeps.

pub mod belief;
pub mod shown;
pub mod step;

pub use belief::{Belief, Candidate, Choice, Figures};
pub use step::Step;
