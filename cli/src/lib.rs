//! The programs `ctos`, which checks and boots apps whose event handlers are those of this workspace, and
//! [`scott`], which asks service objects.
//!
//! [`program`] gathers what every configuration can name; [`commands`] has the command line and the commands that start
//! apps. What compiles beside it is used from here by one name: [`exit`] codes, [`display`] and [`scott`].
//! A program with event handlers of its own calls [`commands::main`] with its own registry.

pub mod commands;
pub mod log;
pub mod program;

/// Says to every service object of this process which revision it was compiled from, and when.
pub fn tell_build() {
    sorma::built(env!("CTOS_BUILD_REVISION"), env!("CTOS_BUILD_TIME"));
}

pub use cli_common::exit;
pub use cli_display as display;
pub use cli_scott as scott;
