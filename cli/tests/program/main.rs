//! The program as its users run it: its commands, its examples and the pages that tell of them. One program holds all
//! of these tests, because each program of tests links everything that `cli` is made of.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may end where it cannot be set up or finds something wrong"
)]

mod answers;
mod arguments;
mod authoring;
mod bad_nets;
mod build;
mod common;
mod hello;
/// The event handlers of the example, for tests that are in the same process.
#[path = "../../examples/hello.rs"]
#[allow(dead_code, reason = "its main function is not run here")]
mod hello_example;
mod lines;
mod lsp;
mod made;
mod motion;
mod nets;
mod offline;
mod panel;
mod programs;
mod proving;
mod readme;
mod reference;
mod replay;
mod requests;
mod running;
mod scott;
mod sim;
mod written;
