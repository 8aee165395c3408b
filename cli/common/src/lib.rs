//! What the programs `ctos` and `scott` share: what a person sees, exit codes, tables, how a running app is reached, and
//! how a page is served. Knows no command, no net and no service object.

pub mod client;
pub mod exit;
pub mod page;
pub mod remote;
pub mod show;
pub mod table;
