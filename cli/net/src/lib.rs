//! The commands of `ctos net`, a file each: tools for authors of nets, and interventions in running ones. Knows no
//! robot: how an app is read comes from the program.

pub mod check;
pub mod control;
pub mod convert;
pub mod fmt;
pub mod lsp;
pub mod perf;
pub mod play;

use ctos::{
    config::{App, Selection},
    diagnostic::Findings,
};

/// How the program reads an app, with the top-level tables that it turns into tasks.
pub type ReadApp = fn(&Selection) -> Result<App, Findings>;
