//! What can be proved and computed about nets before they run. From bottom to top:
//!
//! - [`compose`]: all nets of an app as one system; [`analysis`]: what can be proved about it;
//!   [`check`]: that as findings in the net texts;
//! - [`invariants`]: what no firing of a net by itself can change;
//! - [`stochastic`]: how fast a net goes that says what its transitions take.
//!
//! Knows no clock, no task, no link and no robot; of the runtime it uses only the findings and the field counts
//! of types.

pub mod analysis;
pub mod check;
pub mod compose;
pub mod invariants;
pub mod stochastic;
