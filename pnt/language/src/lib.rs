//! The language of nets: how a net is written, what it is, how it fires. From bottom to top:
//!
//! - [`draft`]: a net as a person wrote it, and its printed form; [`text`]: the parser;
//! - [`builder`]: a net made in Rust;
//! - [`timing`]: when a transition fires;
//! - [`pnml`] and [`tina`]: nets of other tools; [`mod@format`]: files of any of these forms;
//! - [`net`]: the compiled net, coordination structures expanded; [`compile`]: how it is made;
//! - [`data`] that a net declares, and each [`expression`] over it;
//! - [`exec`]: markings, two-phase firing, tape: state plus input gives new state plus effects;
//! - [`language`]: what may come on an input tape.
//!
//! Knows no clock, no task, no link and no robot; of the runtime it uses only the findings.

pub mod builder;
pub mod compile;
pub mod data;
mod digest;
pub mod draft;
mod enough;
pub mod exec;
pub mod expression;
pub mod format;
#[cfg(test)]
mod fuzz;
pub mod language;
pub mod net;
pub mod pnml;
mod ready;
pub mod text;
pub mod timing;
pub mod tina;
