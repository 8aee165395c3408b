//! What the programs `ctos` and `scott` share: output, exit codes, tables, and how a running app is reached. Also
//! how a page is served, the files of records, and the names of forms of nets. Knows no command, no net and no
//! service object.

pub mod client;
pub mod exit;
pub mod form;
pub mod page;
pub mod records;
pub mod remote;
pub mod show;
pub mod table;
