//! Petri net transducers: text form, execution, analysis, the task that runs a net.
//!
//! A net translates commands on its input tape into actions and answers on its output tape
//! (architecture report, sections 6 and 7). Here is nothing but the names of three crates, from bottom to top:
//!
//! - `pnt-language`: [`draft`], [`text`], [`builder`], [`timing`], [`pnml`], [`tina`], [`mod@format`], [`net`],
//!   [`compile`], [`data`], [`expression`], [`exec`], [`language`];
//! - `pnt-analysis`: [`compose`], [`analysis`], [`check`], [`invariants`], [`stochastic`];
//! - `pnt-task`: [`library`], [`store`], [`stream`], [`layout`], [`task`].
//!
//! The first two know no clock, no task, no link and no robot. The third runs a net on the runtime.

pub use pnt_analysis::{analysis, check, compose, invariants, stochastic};
pub use pnt_language::{
    builder, compile, data, draft, exec, expression, format, language, net, pnml, text, timing,
    tina,
};
pub use pnt_task::{layout, library, store, stream, task};

/// The pages of `docs` whose examples are run as tests.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../../docs/running-nets.md")]
    mod running_nets {}
    #[doc = include_str!("../../docs/durable-state.md")]
    mod durable_state {}
}
