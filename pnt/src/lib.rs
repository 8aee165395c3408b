//! Petri net transducers: text form, execution, analysis.
//!
//! A net translates commands on its input tape into actions and answers on its output tape
//! (architecture report, sections 6 and 7). From bottom to top:
//!
//! - [`draft`]: a net as a person wrote it, and its printed form; [`text`]: the parser;
//! - [`builder`]: a net made in Rust;
//! - [`timing`]: when a transition fires;
//! - [`pnml`] and [`tina`]: nets of other tools; [`mod@format`]: files of any of these forms;
//! - [`net`]: the compiled net, coordination structures expanded; [`compile`]: how it is made;
//! - [`exec`]: markings, two-phase firing, tape: state plus input gives new state plus effects;
//! - [`language`]: what may come on an input tape;
//! - [`compose`]: all nets of an app as one system; [`analysis`]: what can be proved about it;
//!   [`check`]: that as findings that point into the net texts;
//! - [`invariants`]: what no firing of a net by itself can change;
//! - [`stochastic`]: how fast a net goes that says what its transitions take.
//!
//! These know no clock, no task, no link and no robot; of the runtime they use only the findings. On
//! top of them, and on the runtime:
//!
//! - [`library`]: the functions that a net names; [`store`]: what survives a crash; [`task`]: the event
//!   handler that runs a net; [`stream`]: what a net does, as numbered events for displays and records;
//!   [`layout`]: where its nodes are drawn.

pub mod analysis;
pub mod builder;
pub mod check;
pub mod compile;
pub mod compose;
mod digest;
pub mod draft;
pub mod exec;
pub mod format;
#[cfg(test)]
mod fuzz;
pub mod invariants;
pub mod language;
pub mod layout;
pub mod library;
pub mod net;
pub mod pnml;
mod ready;
pub mod stochastic;
pub mod store;
pub mod stream;
pub mod task;
pub mod text;
pub mod timing;
pub mod tina;

/// The pages of `docs` whose examples are run as tests.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/running-nets.md")]
    mod running_nets {}
}
