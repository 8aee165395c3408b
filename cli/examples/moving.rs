//! A task that `ctos move` takes to another processor or process, with what it has counted.
//!
//! ```text
//! cargo run --example moving -- boot app.toml
//! ctos move sink cage
//! ```

use std::process::ExitCode;

use ctos::{
    message::Command,
    registry::Registry,
    task::{Context, Handled, HandlerError, Handover},
};
use serde::{Deserialize, Serialize};

/// Counts, and tells how often it has.
#[derive(Serialize, Deserialize, Command)]
#[command(reply = u64, code = 0x0001)]
struct Count {}

struct Sink(u64);

#[ctos::handler]
impl Sink {
    #[command]
    fn count(&mut self, _: Count) -> u64 {
        self.0 += 1;
        self.0
    }
}

impl Handover for Sink {
    type State = u64;

    fn hand_over(&mut self) -> Result<u64, HandlerError> {
        Ok(self.0)
    }

    fn take_over(&mut self, _: &Context, count: u64) -> Handled {
        self.0 = count;
        Ok(())
    }
}

fn main() -> ExitCode {
    let mut registry = Registry::new();
    registry.handover("sink", &Sink::COMMANDS, |_| Ok(Sink(0)));
    cli::commands::main(registry)
}
