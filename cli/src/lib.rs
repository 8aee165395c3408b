//! The programs `ctos`, which checks and boots apps whose event handlers are those of this workspace, and
//! [`scott`], which asks service objects.
//!
//! [`program`] gathers what every configuration can name; [`commands`] holds one file per command.
//! A program with event handlers of its own calls [`commands::main`] with its own registry.

pub mod commands;
pub mod display;
pub mod exit;
pub mod log;
mod page;
pub mod panel;
pub mod program;
pub mod scott;
pub mod show;
